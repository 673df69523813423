"""The arms that `hexwire serve` shares, out of a file or of a command line, checked before anything is opened.

Owns the file, and the checks that concern several arms.

    lease = 0.5                           # seconds of silence after which a lease is lost

    [arms."lab/arm1"]                     # a table for each arm, with settings of hexwire.control.requests.settings
    robot = "so101"
    port = "/dev/serial/by-id/usb-..."

    [arms."lab/arm2"]
    robot = "sim"                         # an emulated Hex7Bot in this program

    [network]                             # as the options of the command
    listen = ["tls/0.0.0.0:7447"]
    ca = "ca.pem"
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.control.requests.setting import Faults, Setting
from hexwire.control.requests.settings_reader import read_settings
from hexwire.control.sharing.lease import TIMEOUT
from hexwire.drivers.registry import PORT_VARIABLE, is_address
from hexwire.errors import LinkError, UsageError
from hexwire.inputs import Item, parse_toml, read_text
from hexwire.link.ports import find_only_board

from .names import check_name

if TYPE_CHECKING:
    from hexwire.control.requests.settings import Settings
    from hexwire.drivers.base import RobotDriver

__all__ = ["SIMULATED", "ServedArm", "read_arms", "read_service_file"]

SIMULATED = "sim"
"""The robot that needs no hardware."""
_SIMULATED = {"robot": "hex7bot", "port": "sim://hex7bot"}
_LEASE = Setting("lease", TIMEOUT, "silence after which a lease is lost", "s", low=0.1, high=60.0)
_NETWORK_KEYS = ("listen", "router", "ca", "cert", "key", "access")
_MOST_ENDPOINTS = 8
_MOST_ARMS = 128
"""Arms of one program. An owner takes 2.3 % of a core at 100 Hz, and 0.3 % at 20 Hz (docs/figures-sharing.md): 43
at the one rate take all of the time of a program, 128 at the other half of it. More need several programs."""


@dataclass(frozen=True, slots=True)
class ServedArm:
    """One arm to share.

    Attributes:
        name: Its name, checked.
        settings: Its settings.
        driver: Its driver, not attached.
        lease: Seconds of silence after which a lease is lost.
    """

    name: str
    settings: Settings
    driver: RobotDriver
    lease: float = TIMEOUT


@dataclass(slots=True)
class _Faults(Faults):
    """The faults of one arm, with the place of each in its file."""

    arm: Item | None = None

    def add(self, name: str, text: object) -> None:
        # Named explicitly: `super()` does not work in a class with slots that dataclass makes anew.
        Faults.add(self, f"{self.place(name)}{name}", text)

    def place(self, name: str = "") -> str:
        """What stands before the name of a setting: line and column, and the arm."""
        if self.arm is None:
            return ""
        item = self.arm
        for key in name.split("/"):
            item = item.step(key)
        line, column = item.line_and_column
        return f"{f'{line}:{column}: ' if line else ''}{self.arm.where}."


def read_arms(
    given: Mapping[str, Mapping[str, object]],
    *,
    lease: float = TIMEOUT,
    place: Item | None = None,
    find_port: Callable[[], str] = find_only_board,
) -> list[ServedArm]:
    """Check arms and build their drivers, as `read_settings` does.

    Args:
        given: Settings of `hexwire.control.requests.settings`, and ``lease``, by the name of the arm; the only arm
            may have an empty name, for that of its model.
        lease: Seconds of silence after which a lease is lost, for an arm that names none.
        place: The table that they come from, for errors.
        find_port: Finds the port of a single arm that names none.

    Raises:
        UsageError: Something is wrong; the text lists the first faults with their places.
        LinkNotFoundError: A single arm names no port, and none is found.
    """
    texts: list[str] = []
    arms: list[ServedArm] = []
    ports: dict[str, str] = {}
    for name, rows in given.items():
        faults = _Faults(arm=None if place is None else place.step(name))
        values = dict(rows)
        if not values.get("controllers"):
            # A client's motion names the joints that it moves.
            values.setdefault("allow_partial_joints_goal", True)
        own = faults.read(_LEASE, values.pop("lease", lease))
        _simulated(values, faults)
        # The only likely board cannot be several arms.
        finder = find_port if len(given) == 1 else functools.partial(_no_port, faults)
        _refuse_shared(values, faults)
        try:
            settings, driver = read_settings(values, faults, find_port=finder)
        except LinkError:
            if len(given) == 1:
                raise
            texts += faults.texts
            continue
        except UsageError as error:
            texts += faults.texts or [f"{faults.place()}{error}"]
            continue
        url = driver.url
        # Each address of an emulated arm is another one.
        if url in ports and not url.startswith(f"{SIMULATED}:"):
            faults.add("port", f"{url} is the port of {ports[url]}, too")
            texts += faults.texts
        ports[url] = name
        arms.append(ServedArm(check_name(name or driver.model.name), settings, driver, own))
    Faults(texts).check(place.file if place else "")
    return arms


def _simulated(values: dict[str, object], faults: Faults) -> None:
    if values.get("robot") != SIMULATED:
        return
    if "port" in values:
        faults.add("port", f"the robot {SIMULATED} has none; leave it out")
    values |= _SIMULATED


def _refuse_shared(values: dict[str, object], faults: Faults) -> None:
    port = values.get("port") or os.environ.get(PORT_VARIABLE)
    if isinstance(port, str) and is_address(port):
        faults.add("port", f"{port} is shared already; start the server with --router to reach it from elsewhere")
        # No question to its server is needed.
        values["port"] = _SIMULATED["port"]


def _no_port(faults: Faults) -> str:
    faults.add("port", "is missing")
    raise LinkError("an arm without a port")


def read_service_file(
    file: str, *, lease: float = TIMEOUT, find_port: Callable[[], str] = find_only_board
) -> tuple[list[ServedArm], dict[str, Any]]:
    """Read a file with arms.

    Args:
        file: Its path.
        lease: As in `read_arms`, unless the file says otherwise.
        find_port: As in `read_arms`.

    Returns:
        The arms, and the arguments of a `Network`.

    Raises:
        UsageError: It cannot be read, or something in it is wrong: the text has the place.
    """
    top = parse_toml(read_text(file), file).table(("arms",), ("network", "lease"))
    if "lease" in top:
        lease = top["lease"].number(_LEASE.low, _LEASE.high, _LEASE.unit)
    rows: dict[str, dict[str, object]] = {}
    given = top["arms"].table()
    if len(given) > _MOST_ARMS:
        raise top["arms"].fault(
            f"names {len(given)} arms; one program shares at most {_MOST_ARMS}: use several files"
        )
    for name, item in given.items():
        try:
            check_name(name)
        except UsageError as error:
            raise item.fault(str(error).removeprefix(f"{name!r} ")) from None
        rows[name] = {key: value.value for key, value in item.table().items()}
        for key, value in rows[name].items():
            # TOML reads [arms.lab.arm1] as a table in a table.
            if isinstance(value, dict) and not {"robot", "port"}.isdisjoint(value):
                raise item.fault(f'contains an arm: write its name in quotes, [arms."{name}/{key}"]')
    if not rows:
        raise top["arms"].fault('names no arm; write [arms."lab/arm1"]')
    network: dict[str, Any] = {}
    if "network" in top:
        folder = Path(file).resolve().parent
        for key, item in top["network"].table((), _NETWORK_KEYS).items():
            if key in ("listen", "router"):
                endpoints: Sequence[str] = [row.text() for row in item.rows(most=_MOST_ENDPOINTS)]
                network["connect" if key == "router" else key] = tuple(endpoints)
            else:
                network[key] = str(folder / item.text())
    return read_arms(rows, lease=lease, place=top["arms"], find_port=find_port), network
