"""Several shared arms in one program: their settings, their start and their end.

Owns the order of start and shutdown, and the file that names arms. Must not know the command line.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from hexwire.control.arm import Arm
from hexwire.control.lease import Lease
from hexwire.control.setting import Faults
from hexwire.control.settings_reader import read_settings
from hexwire.control.shared import SharedArm
from hexwire.errors import DeviceError, LinkBusyError, UsageError
from hexwire.inputs import parse_toml, read_text
from hexwire.new_file import make_folder

from .names import check_name
from .network import Network, endpoints_of, local_socket
from .server import ArmServer

__all__ = ["ArmSettings", "Service", "read_service_file"]

_NETWORK_KEYS = ("listen", "router", "ca", "cert", "key", "access")


@dataclass(frozen=True, slots=True)
class ArmSettings:
    """One arm to share.

    Attributes:
        name: Its name; that of the robot if empty.
        settings: Settings of `hexwire.control.settings` by name.
    """

    name: str
    settings: Mapping[str, object]


class _Served:
    """One arm, from its start to its end."""

    def __init__(self, arm: ArmSettings, network: Network, lease: float, server: str) -> None:
        self._settings, driver = read_settings(arm.settings, Faults())
        self.name = check_name(arm.name or driver.model.name)
        self.arm = Arm(driver, self._settings)
        self.shared = SharedArm(self.arm, Lease(timeout=lease))
        self._network, self._server_text = network, server
        self.server: ArmServer | None = None

    @contextlib.contextmanager
    def running(self, started: float) -> Iterator[None]:
        path = local_socket(self.name)
        with _only_server(self.name, path):
            network = replace(self._network, listen=(*endpoints_of([path]), *self._network.listen))
            self.arm.connect()
            try:
                self.arm.start()
                self.shared.start()
                node = network.open(wait=False)
                try:
                    self.server = ArmServer(self.shared, self.name, node, server=self._server_text, started=started)
                    try:
                        self.server.start()
                        yield
                    finally:
                        self.server.close()
                finally:
                    node.close()
            finally:
                # In this order: no order comes any more, then the arm stops if it moves.
                self.shared.shutdown()
                self.arm.shutdown()


class Service:
    """Shares arms for a `with` block.

    Args:
        arms: The arms.
        network: How others reach them, besides programs of this user on this machine.
        lease: Seconds of silence after which a lease is lost.
        server: This program, in words.
    """

    def __init__(
        self, arms: Sequence[ArmSettings], network: Network, *, lease: float = 0.5, server: str = ""
    ) -> None:
        # All settings before anything is opened.
        self._arms = [_Served(arm, network, lease, server) for arm in arms]
        names = [served.name for served in self._arms]
        if len(set(names)) != len(names):
            raise UsageError(f"a name occurs twice: {', '.join(sorted(names))}")
        self._network = network
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        started = time.time()
        with ExitStack() as stack:
            for served in self._arms:
                stack.enter_context(served.running(started))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def lines(self) -> list[str]:
        """What is shared, a line for each arm."""
        where = "" if not self._network.listen else f", also at {', '.join(self._network.listen)}"
        return [
            f"{served.name}: {served.arm.owner.robot.url} as zenoh:{served.name}{where}" for served in self._arms
        ]

    def check(self) -> None:
        """Check that all arms are still shared.

        Raises:
            HexwireError: One is not.
        """
        for served in self._arms:
            if served.arm.owner.crash is not None:
                raise DeviceError(f"{served.name}: the program failed: {served.arm.owner.crash}")
            if served.server is not None and served.server.conflict:
                raise UsageError(served.server.conflict)


@contextlib.contextmanager
def _only_server(name: str, path: Path) -> Iterator[None]:
    """Be the only server of that name by this user on this machine."""
    make_folder(path.parent)
    lock = os.open(path.with_suffix(".name"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise LinkBusyError(
                f"the name {name} is already served on this machine; choose another --name"
            ) from None
        yield
    finally:
        os.close(lock)


def read_service_file(file: str) -> tuple[list[ArmSettings], dict[str, Any]]:
    """Read a file with arms.

    Returns:
        The arms, and the arguments of a `Network`.

    Raises:
        ConfigError: It cannot be read, or something in it is wrong.
    """
    top = parse_toml(read_text(file), file).table(("arms", "network"), ("arms",))
    arms = [
        ArmSettings(check_name(name), {key: value.value for key, value in item.table().items()})
        for name, item in top["arms"].table().items()
    ]
    if not arms:
        raise UsageError(f'{file} names no arm; write [arms."lab/arm1"]')
    folder = Path(file).resolve().parent
    network: dict[str, Any] = {}
    if "network" in top:
        for key, item in top["network"].table(_NETWORK_KEYS).items():
            if key in ("listen", "router"):
                network["connect" if key == "router" else key] = tuple(row.text() for row in item.rows(most=8))
            else:
                network[key] = str(folder / item.text())
    return arms, network
