"""What pages may ask the studio for by name: each call has typed arguments, and the rights that it needs.

Owns the table of calls and the check of their arguments. `Studio.call` runs them. Must not know sockets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import msgspec

from hexwire.errors import LinkLostError, StoppedError, UsageError

from .access import Right

if TYPE_CHECKING:
    from hexwire.bus.backup import ServoBackup
    from hexwire.epochs import Token

    from .bus_source import BusSource
    from .cameras import Cameras
    from .fleet_watch import FleetWatch
    from .holds import Holds
    from .live import Live
    from .page_process import PageProcess
    from .plugged import Plugged
    from .recordings import Recordings
    from .source import ArmSource, Source
    from .tabs import Tab
    from .urdf_folder import UrdfFolder
    from .wire_feed import WireFeed

__all__ = [
    "Arguments",
    "Asked",
    "Call",
    "CallHost",
    "CallLane",
    "Named",
    "OfServo",
    "Switched",
    "all_calls",
    "call",
    "find_call",
]


class CallLane(Enum):
    """Where a call is carried out, in turn with the others there of sessions with the same right."""

    WAITS = "some threads, which may wait for the arm"
    COMPUTES = "one thread, which must not wait for the arm; no step of it may hold the interpreter for long"
    FILES = "one thread, which waits for the process for files"


class Arguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The arguments of a call; those of one that has none."""


class Named(Arguments, frozen=True):
    """The arguments of a call about a pose, a file, an arm: what has this name."""

    name: str


class OfServo(Arguments, frozen=True):
    """The arguments of a call about one servo of the bus."""

    servo: int


class Switched(Arguments, frozen=True):
    """The arguments of a call that switches something."""

    on: bool


class CallHost(Protocol):
    """What calls need of their studio."""

    source: Source
    holds: Holds
    live: Live
    fleet: FleetWatch
    plugged: list[Plugged] | None
    recordings: Recordings
    cameras: Cameras
    wire: WireFeed
    files: dict[Right, PageProcess]
    settings: dict[str, object]
    urdf: UrdfFolder | None

    @property
    def first(self) -> object:
        """The first run of an arm: `first_run_calls.FirstRuns`, which has its calls."""

    def arms(self) -> dict[str, Any]:
        """The arms that a page can reach, for JSON."""

    def emulated(self, arm: ArmSource) -> str:
        """What a person should know of an emulated arm that this program has started; empty for others."""

    def need_control(self, tab: Tab) -> None:
        """Check that a tab may command now; raises `LeaseError`."""

    def take(self, tab: Tab, *, force: bool = False) -> None:
        """Give a tab control; raises `LeaseError`."""

    def open(self, tab: Tab, url: str, robot: str | None = None) -> None:
        """Open an arm for a tab, in place of what is open; raises `HexwireError`."""

    def open_bus(self, tab: Tab, url: str = "") -> None:
        """Open a servo bus for a tab, in place of what is open; raises `HexwireError`."""

    def close_source(self, tab: Tab) -> None:
        """Close what is open, for a tab; raises `LeaseError`."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Who asks, and when.

    Attributes:
        studio: The studio.
        tab: The tab that asks.
        present: What was open when the call came.
        arrived: When the call came, relative to stops; None if nothing was open.
    """

    studio: CallHost
    tab: Tab
    present: ArmSource | BusSource | None
    arrived: Token | None

    @property
    def bus(self) -> BusSource:
        """The servo bus that was open when the call came; raises `LinkLostError` if it is not open any more."""
        bus = self.studio.source.need_bus()
        if bus is not self.present:
            raise LinkLostError("this servo bus was closed; load the page again")
        return bus

    @property
    def arm(self) -> ArmSource:
        """The arm that was open when the call came; raises `LinkLostError` if it is not open any more."""
        arm = self.studio.source.need_arm()
        if arm is not self.present:
            raise LinkLostError("this arm was closed; load the page again")
        return arm

    @property
    def files(self) -> PageProcess:
        """The process for the files of pages; only calls in its lane ask it."""
        return self.studio.files[self.tab.right]

    @property
    def backups(self) -> list[ServoBackup]:
        """The backups of what was open when the call came, newest last; raises as `bus` and `arm`."""
        return self.arm.backups if self.studio.source.bus is None else self.bus.backups

    def known(self, *servo_ids: int) -> tuple[int, ...]:
        """These servos of the bus, each once.

        Raises:
            UsageError: One was not found on it, such as 254, at which all servos listen.
            LinkLostError: As `bus`.
        """
        found = self.bus.bench.servo_ids
        for servo_id in servo_ids:
            if servo_id not in found:
                raise UsageError(f"servo {servo_id} was not found on this bus; search first")
        return tuple(dict.fromkeys(servo_ids))

    def refuse_if_stopped_since(self) -> None:
        """Check that no stop came after the call.

        Raises:
            StoppedError: One came.
        """
        present, arrived = self.present, self.arrived
        if present is not None and arrived is not None and present.stopped_since(arrived):
            raise StoppedError.unsent("the call of a page", 0, "a stop came after it")


@dataclass(frozen=True, slots=True)
class Call:
    """One call.

    Attributes:
        name: Its name.
        kind: Its arguments.
        act: What it does, in a thread. Returns what JSON can hold, or JSON as `msgspec.Raw`.
        right: Which right a session needs.
        control: The tab must have control, and no stop since it was asked.
        lane: Where it is carried out for a tab.
    """

    name: str
    kind: type[Arguments]
    act: Callable[[Asked, Any], object]
    right: Right
    control: bool
    lane: Callable[[Tab], CallLane]

    def read(self, args: Mapping[str, object]) -> Arguments:
        """Check arguments from a page.

        Raises:
            UsageError: One is missing, unknown or of another kind.
        """
        try:
            return msgspec.convert(args, self.kind)
        except (msgspec.ValidationError, RecursionError) as error:
            raise UsageError(f"the call {self.name} cannot be read: {error}") from None


_calls: dict[str, Call] = {}
_A = TypeVar("_A", bound=Arguments)
_Act = Callable[[Asked, _A], object]


def call(
    name: str,
    kind: type[_A],
    *,
    right: Right = Right.WATCH,
    control: bool = False,
    lane: CallLane | Callable[[Tab], CallLane] = CallLane.WAITS,
) -> Callable[[_Act[_A]], _Act[_A]]:
    """Add a function to what pages may ask for; see `Call`."""
    where = (lambda _: lane) if isinstance(lane, CallLane) else lane

    def add(act: _Act[_A]) -> _Act[_A]:
        _calls[name] = Call(name, kind, act, right, control, where)
        return act

    return add


def find_call(name: str) -> Call:
    """The call of that name.

    Raises:
        UsageError: There is none.
    """
    found = _calls.get(name)
    if found is None:
        raise UsageError(f"there is no call {name[:20]!r}")
    return found


def all_calls() -> list[Call]:
    """All calls."""
    return list(_calls.values())
