"""`Board`: the interface of a Hex7Bot controller board, whichever dialect it speaks.

Owns the protocol between `hex7bot` and the dialects, `board1` and `board2`. Must not know either of them, sessions
or callers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol

from hexwire.wire.commands import ALL_FIELDS, LimitRow, OffsetRow

if TYPE_CHECKING:
    from hexwire.model.state import JointState, JointTarget, SentTarget
    from hexwire.wire.command_frame import Frame

    from .timed_path import TimedPath
    from .values import JointProbe, StopMode

__all__ = ["Board", "BoardFacts"]


class BoardFacts(NamedTuple):
    """What a board reported about itself when it was last probed.

    Attributes:
        firmware: As in ``2.0.1``; empty if it does not say.
        boot_id: Changes at every reset; None if it has none.
        capabilities: Names of its abilities.
        stopped: A stop is latched.
        maintenance: The board allows writes to servo settings, and no motion.
    """

    firmware: str
    boot_id: int | None
    capabilities: tuple[str, ...]
    stopped: bool
    maintenance: bool


class Board(Protocol):
    """One attached board. Angles are in radians, times in seconds.

    A call that the board does not support raises `NotSupportedError` and sends nothing. Every other call raises a
    `LinkError` or `ReplyTimeoutError` if the board does not answer, and `CommandRefusedError` if it refuses.
    """

    # -- properties; nothing is sent ------------------------------------------------------------------

    @property
    def dialect(self) -> int:
        """Number of the dialect, for display."""
        ...

    @property
    def times_motion(self) -> bool:
        """Whether the board follows a path in its own time."""
        ...

    def path(self, joints: Sequence[str] | None, *, smooth: bool, brake: float | None, outlives: bool) -> TimedPath:
        """Begin a path; see `OnboardPaths.path`."""
        ...

    def left_path(self) -> tuple[str, ...]:
        """Joints on a path that outlives its program; see `OnboardPaths.left_path`."""
        ...

    def clear_path(self, joints: Sequence[str] | None) -> bool:
        """End such a path; see `OnboardPaths.clear_path`."""
        ...

    @property
    def command_rate(self) -> float:
        """Targets per second that the line can carry while the state is also read."""
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
        """Identify the servos; ends reports."""
        ...

    def facts(self) -> BoardFacts:
        """What the board reported at the last `probe_joints`, or when it was found; sends nothing."""
        ...

    def stats(self) -> dict[str, int]:
        """The board's counters since its reset; empty if it has none."""
        ...

    def read(self, fields: int = ALL_FIELDS) -> JointState:
        """Read the state of all joints; a silent servo raises no error.

        Args:
            fields: Bits of `STATE_FIELD_...`: values to read besides positions, where the board can omit them.
        """
        ...

    def report(self, period: float, fields: int = ALL_FIELDS) -> None:
        """Have the board report its state every `period` seconds; 0 ends the reports."""
        ...

    def decode_state(self, body: bytes, frame: Frame, now: float, slow: JointState | None = None) -> JointState:
        """Decode a report that arrived at `now`."""
        ...

    # -- motion ---------------------------------------------------------------------------------------

    def move(self, target: JointTarget, present: Mapping[str, float]) -> SentTarget:
        """Send joints to a target that is within the model's limits.

        Args:
            target: Its duration keeps the speed limits.
            present: Angles of the joints when the motion begins, as far as they are known.
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
        """Have the board stop the arm when it receives nothing for `timeout` seconds; 0 disarms the watchdog."""
        ...

    # -- servos and settings --------------------------------------------------------------------------

    def ping(self, servo_id: int) -> int | None:
        """Error byte of a servo, or None if it does not answer."""
        ...

    def transact(self, packet: bytes, reply_length: int, timeout: float) -> bytes:
        """Send one raw servo packet; returns the bytes of its answer."""
        ...

    def read_table(self, servo_id: int, first: int, count: int) -> bytes:
        """Read many registers of a servo by one request; raw."""
        ...

    def write_table(self, servo_id: int, first: int, data: bytes) -> None:
        """Write many registers of a servo by one request; those that differ."""
        ...

    def command(self, cmd: int, body: bytes) -> bytes:
        """Send a command by its code, with a body as in PROTOCOL.md section 6; returns the reply's body."""
        ...

    def maintenance(self, on: bool) -> None:
        """Switch maintenance on (servo settings can be written, nothing moves) or off."""
        ...

    def limits(self) -> tuple[LimitRow, ...]:
        """Read the limits that the board has stored, in its joint order."""
        ...

    def store_limits(self, rows: Sequence[LimitRow]) -> tuple[LimitRow, ...]:
        """Store limits; returns the limits that the board then has."""
        ...

    def offsets(self) -> tuple[OffsetRow, ...]:
        """Read the neutral counts and signs that the board has stored, in its joint order."""
        ...

    def store_offsets(self, rows: Sequence[OffsetRow]) -> tuple[OffsetRow, ...]:
        """Store neutral counts and signs; returns what the board then has."""
        ...
