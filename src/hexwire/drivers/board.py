"""`Board`: what a Hex7Bot controller board is asked, whichever dialect it speaks.

Owns the protocol between `hex7bot` and the dialects, `board1` and `board2`. Must not know either of them, sessions
or who asks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

from hexwire.wire.commands import ALL_FIELDS

if TYPE_CHECKING:
    from hexwire.model.state import JointState, JointTarget, SentTarget
    from hexwire.wire.command_frame import Frame
    from hexwire.wire.commands import LimitRow, OffsetRow

    from .values import JointProbe, StopMode

__all__ = ["Board", "BoardFacts"]


class BoardFacts(NamedTuple):
    """What a board said of itself when it was probed last.

    Attributes:
        firmware: As in ``2.0.1``; empty if it does not say.
        boot_id: Changes at every reset; None if it has none.
        capabilities: Words for what it can do.
        stopped: A stop is latched.
        maintenance: It lets settings of servos be written, and nothing move.
    """

    firmware: str
    boot_id: int | None
    capabilities: tuple[str, ...]
    stopped: bool
    maintenance: bool


class Board(Protocol):
    """One attached board. Angles are radians, times seconds.

    What a board cannot do raises `NotSupportedError` and sends nothing. Every other call raises a `LinkError` or
    `ReplyTimeoutError` where the board is not there, and `CommandRefusedError` where it refuses.
    """

    # -- what it is, without asking it ----------------------------------------------------------------

    @property
    def dialect(self) -> int:
        """Number of the dialect, for people."""
        ...

    @property
    def command_rate(self) -> float:
        """Targets a second that the line takes, besides being read."""
        ...

    @property
    def has_watchdog(self) -> bool:
        """Whether `watchdog` works."""
        ...

    @property
    def reports_states(self) -> bool:
        """Whether `report` works."""
        ...

    @property
    def keeps_stop(self) -> bool:
        """Whether the board keeps a stop from one program to the next."""
        ...

    @property
    def keeps_trip(self) -> bool:
        """Whether nothing but `resume` makes the board forget that its watchdog has tripped."""
        ...

    @property
    def unprotected(self) -> str:
        """As `ProbeReport.unprotected`."""
        ...

    # -- state ----------------------------------------------------------------------------------------

    def probe_joints(self) -> tuple[JointProbe, ...]:
        """Ask who is there; ends reports."""
        ...

    def facts(self) -> BoardFacts:
        """What it said of itself at the last `probe_joints`, or when it was found; asks nobody."""
        ...

    def stats(self) -> dict[str, int]:
        """Its counters since its reset; empty if it counts nothing."""
        ...

    def read(self, fields: int = ALL_FIELDS) -> JointState:
        """The state of all joints; a silent servo does not raise.

        Args:
            fields: Bits of `STATE_FIELD_...`: what is wanted besides positions, where the board can leave it out.
        """
        ...

    def report(self, period: float, fields: int = ALL_FIELDS) -> None:
        """Have it send states every `period` seconds; 0 ends that."""
        ...

    def decode_state(self, body: bytes, frame: Frame, now: float) -> JointState:
        """A state out of a report that arrived at `now`."""
        ...

    # -- motion ---------------------------------------------------------------------------------------

    def move(self, target: JointTarget, present: Mapping[str, float]) -> SentTarget:
        """Send joints to a target that is within the model's limits.

        Args:
            target: With a duration that is not too short.
            present: Where joints are, or will be, when it begins; as far as that is known.
        """
        ...

    def torque(self, on: bool, joints: Sequence[str] | None) -> tuple[str, ...]:
        """As `RobotDriver.torque`."""
        ...

    def stop(self, mode: StopMode) -> tuple[str, ...]:
        """As `RobotDriver.stop`."""
        ...

    def resume(self) -> None:
        """End a stop, if none came since this was called."""
        ...

    def watchdog(self, timeout: float, mode: StopMode) -> None:
        """Have it stop by itself when nothing comes for `timeout` seconds; 0 = never."""
        ...

    # -- servos and settings --------------------------------------------------------------------------

    def ping(self, servo_id: int) -> int | None:
        """Error byte of a servo, or None if it does not answer."""
        ...

    def transact(self, packet: bytes, reply_length: int, timeout: float) -> bytes:
        """One raw servo packet, and the bytes of its answer."""
        ...

    def command(self, cmd: int, body: bytes) -> bytes:
        """A command by its code with a body as in PROTOCOL.md section 6; returns the reply's body."""
        ...

    def maintenance(self, on: bool) -> None:
        """Let settings of servos be written, and nothing move; or end that."""
        ...

    def limits(self) -> tuple[LimitRow, ...]:
        """The limits it has stored, in its joint order."""
        ...

    def store_limits(self, rows: Sequence[LimitRow]) -> tuple[LimitRow, ...]:
        """Store limits; returns what it has then."""
        ...

    def offsets(self) -> tuple[OffsetRow, ...]:
        """The neutral counts and signs it has stored, in its joint order."""
        ...

    def store_offsets(self, rows: Sequence[OffsetRow]) -> tuple[OffsetRow, ...]:
        """Store neutral counts and signs; returns what it has then."""
        ...
