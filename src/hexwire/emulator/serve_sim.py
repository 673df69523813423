"""`sim://hex7bot`, `sim://so101`: an emulated arm inside the program that opens it, behind an ordinary link.

Owns the link; whoever reads it drives the emulator, so there is no process or terminal, and no thread but the one
that notices stalls of this program. The entry-point group ``hexwire.links`` names it: no other room imports it.
"""

from __future__ import annotations

import re
import threading
import time
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

from hexwire.errors import LinkBusyError, LinkClosedError, UsageError
from hexwire.link.base import Link, LinkKind
from hexwire.model.arms import record_of, simulated_arms
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel

from .board import make_hex7bot_board
from .bus_arms import make_bus_arm
from .bus_device import BusDevice
from .hand import Hands
from .physics import PhysicsTwin
from .serve_hand import HandServer, inside_name
from .stalls import STALLS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hexwire.link.url import LinkUrl
    from hexwire.model.arm import ArmModel

    from .serve import ServedDevice
    from .servo import EmulatedServo

__all__ = ["SIM_OPTIONS", "SimArm", "SimBusLink", "SimLink", "emulate_bus_arm", "emulate_hex7bot", "make_sim_link"]

SIM_OPTIONS = ("seed", "physics", "name")
"""The options that every emulated arm has."""

_SERVO_BAUD = 115200
"""Rate of the servo bus of the emulated board, as set by the chapter's sketch."""
_BUS_BAUD = 1_000_000
"""Rate of a servo bus without a board."""
_STEP = 0.0005
"""Shortest wait between two steps of the emulator, seconds."""
_LOOK = 0.02
"""Seconds between two looks for a hand."""
_NAME = re.compile(r"[A-Za-z0-9_.]{1,40}")


@dataclass(frozen=True, slots=True)
class SimArm:
    """What `sim://NAME` opens.

    Attributes:
        device: The emulated board or bus.
        servos: Its servos.
        model: Its joints, which a hand can move.
        rates: The rate of a servo bus as the only item; None for a board.
        physics: What `PhysicsTwin` simulates, if that is not `model`.
    """

    device: ServedDevice
    servos: Sequence[EmulatedServo]
    model: ArmModel
    rates: list[int] | None = None
    physics: Hex7BotModel | None = None


def emulate_hex7bot(url: LinkUrl, *, seed: int, start: float) -> SimArm:
    """A Hex7Bot with its board; the option ``dialect`` is 1 or 2."""
    url.check_keys(("dialect", *SIM_OPTIONS))
    dialect = url.integer("dialect", 2, 1, 2)
    board = make_hex7bot_board(dialect=dialect, baud=_SERVO_BAUD, seed=seed, start=start)
    return SimArm(board, board.wire.servos, HEX7BOT, physics=Hex7BotModel())


def emulate_bus_arm(url: LinkUrl, *, seed: int, start: float) -> SimArm:
    """The servos of an arm's assembly; the options ``leader`` and ``any_horns`` are as in `make_bus_arm`."""
    url.check_keys(("leader", "any_horns", *SIM_OPTIONS))
    leader, any_horns = url.yes_no("leader", False), url.yes_no("any_horns", False)
    arm = make_bus_arm(url.netloc, leader=leader, any_horns=any_horns, seed=seed, start=start)
    rates = [_BUS_BAUD]
    return SimArm(BusDevice(arm.servos, paced=True, host_baud=lambda: rates[0]), arm.servos, arm.model, rates)


def make_sim_link(url: LinkUrl) -> SimLink:
    """Make the link of an emulated arm.

    All have the options `SIM_OPTIONS`: ``seed``, ``physics`` (1: in MuJoCo) and ``name``, by which
    `hexwire sim hand` tells arms of one kind apart. The arm's record says by `ArmRecord.emulate` what makes it, a
    function like those above; without it `emulate_bus_arm` does.

    Raises:
        UsageError: There is no such emulated arm, an option is wrong, or MuJoCo is not installed.
    """
    robot = url.netloc
    record = record_of(robot)
    if record is None or not record.simulated or url.path not in ("", "/"):
        known = [f"sim://{name}" for name in simulated_arms()]
        raise UsageError(f"{url.text}: there is no such emulated arm; write {', '.join(known[:-1])} or {known[-1]}")
    make: Callable[..., SimArm] = emulate_bus_arm
    if record.emulate:
        make = EntryPoint(robot, record.emulate, "hexwire.arms").load()
    name = url.query.get("name", "")
    if "name" in url.query and not _NAME.fullmatch(name):
        raise UsageError(f"{url.text}: name must have 1 to 40 letters, digits, points and underscores")
    arm = make(url, seed=url.integer("seed", 0, 0, 2**31), start=time.monotonic())
    if url.yes_no("physics", False):
        PhysicsTwin(arm.servos, arm.physics or arm.model)
    hands = Hands(arm.servos, arm.model)
    if arm.rates is None:
        return SimLink(url.text, arm.device, hands=hands, robot=robot, name=name)
    return SimBusLink(url.text, arm.device, arm.rates, hands=hands, robot=robot, name=name)


class SimLink(Link):
    """A link to a device in this process, in real time. The device lives on while the link is closed.

    Args:
        url: What the link calls itself.
        device: The emulated board or bus.
        hands: The joints that other programs of this user may move by hand while the link is open.
        robot: Kind of the arm, for those programs.
        name: Its name among arms of its kind.
    """

    kind = LinkKind.STREAM
    max_message = None

    def __init__(
        self,
        url: str,
        device: ServedDevice,
        *,
        hands: Hands | None = None,
        robot: str = "",
        name: str = "",
    ) -> None:
        self.url, self.device = url, device
        self._door = None if hands is None else HandServer(inside_name(robot, name), hands)
        self._next_look = 0.0
        self._open = self._woken = False
        self._unread = b""
        # Guards the device and all of the above.
        self._changed = threading.Condition()

    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        with self._changed:
            if self._open:
                raise LinkBusyError(f"{self.url} is open already", url=self.url)
            if self._door is not None:
                self._door.open()
            self._open, self._woken = True, False
            STALLS.open(self)
            # What was sent to nobody is lost.
            self._run()
            self._unread = b""

    def close(self) -> None:
        with self._changed:
            self._open = False
            STALLS.close(self)
            if self._door is not None:
                self._door.close()
            self._changed.notify_all()

    def wake(self) -> None:
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def flush_input(self) -> int:
        with self._changed:
            self._run()
            unread, self._unread = self._unread, b""
            return len(unread)

    def write(self, data: bytes, deadline: float | None = None) -> None:
        with self._changed:
            self._check()
            # What was due before these bytes comes first: a watchdog that has expired is not fed by them.
            self._run()
            if data:
                self.device.receive(data, time.monotonic())
                self._changed.notify_all()

    def read(self, deadline: float | None) -> bytes:
        with self._changed:
            while True:
                self._check()
                self._run()
                if self._unread:
                    unread, self._unread = self._unread, b""
                    return unread
                if self._woken:
                    self._woken = False
                    return b""
                now = time.monotonic()
                if deadline is not None and now >= deadline:
                    return b""
                look = None if self._door is None else self._next_look
                due = [t for t in (deadline, self.device.next_event_time(), look) if t is not None]
                self._changed.wait(max(min(due) - now, _STEP) if due else None)

    def stalled(self, seconds: float) -> float:
        return STALLS.seconds(time.monotonic() - seconds)

    def _run(self) -> None:
        now = time.monotonic()
        if self._door is not None and now >= self._next_look:
            self._next_look = now + _LOOK
            self._door.step(now)
        self.device.step(now)
        self._unread += self.device.data_to_send()

    def _check(self) -> None:
        if not self._open:
            raise LinkClosedError(f"{self.url} is closed", url=self.url)


class SimBusLink(SimLink):
    """A link to servos without a board: it has a line rate, and servos at another rate do not understand it.

    Args:
        url: As in `SimLink`.
        device: The servos.
        rates: Its rate, as the only item; the device reads it there.
        hands: As in `SimLink`.
        robot: As in `SimLink`.
        name: As in `SimLink`.
    """

    def __init__(
        self,
        url: str,
        device: ServedDevice,
        rates: list[int],
        *,
        hands: Hands | None = None,
        robot: str = "",
        name: str = "",
    ) -> None:
        super().__init__(url, device, hands=hands, robot=robot, name=name)
        self._rates = rates

    @property
    def baud(self) -> int:
        """Bits per second."""
        return self._rates[0]

    def set_baud(self, baud: int) -> None:
        """Change the rate; bytes on their way keep theirs."""
        with self._changed:
            self._run()
            self._rates[0] = baud
