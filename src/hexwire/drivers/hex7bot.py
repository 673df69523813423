"""`Hex7BotDriver`: the chapter's driver, for a controller board of either dialect.

Owns what both dialects share: attaching, the host's limits, detection of a reset or replaced board, and the
standing orders (watchdog, reports) that a reset clears and that are sent again. `board1` and `board2` are the
dialects. Must not know links or callers.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from hexwire.arguments import DATA, FLAG, SECONDS, WHOLE, or_none, rows_of
from hexwire.errors import NotSupportedError, UsageError
from hexwire.ipc.session import Session
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.motion.limits import check_target
from hexwire.session.effects import Effect, effect_of, packet_only_reads
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, command_name
from hexwire.wire.commands import ALL_FIELDS, LimitRow, OffsetRow
from hexwire.wire.servo_table import TABLE_REGISTERS

from .abilities import (
    OnboardPaths,
    OwnWatchdog,
    RefilledPaths,
    ServoPing,
    ServoTables,
    SilenceCheck,
    StateReports,
    Watchdog,
)
from .base import ProbeReport, StopMode
from .board import Board
from .board1 import Board1
from .board2 import Board2
from .board_reset import warn_of_reset
from .session_driver import SessionDriver
from .stop_memory import CalmBoard, StopMemory

if TYPE_CHECKING:
    from hexwire.link.diagnose import Finding

    from .timed_path import TimedPath

__all__ = ["FLAGS_ONLY", "Hex7BotDriver", "StandingOrders"]

FLAGS_ONLY = 0
"""Fields of the shortest state: positions and the board's flags."""


class StandingOrders:
    """The standing orders of one attached board.

    Attributes:
        watchdog: Seconds and mode; None if it is off.
        report: Seconds between reports, and their fields; None if reports are off.
        due: The board may have lost its orders; `give_back` sends them again.
        given_back: Number of times that the orders were sent again.
    """

    def __init__(self) -> None:
        self.watchdog: tuple[float, StopMode] | None = None
        self.report: tuple[float, int] | None = None
        self.due = False
        self.given_back = 0
        self._tripped = False

    def arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """Arm the board's watchdog, or disarm it with 0 s, and keep that as an order."""
        self._arm(board, timeout, mode)
        self.watchdog = (timeout, mode) if timeout else None

    def _arm(self, board: Board, timeout: float, mode: StopMode) -> None:
        """Send WATCHDOG. On older firmware it clears the flag of a tripped watchdog, so read the flag first."""
        if not board.keeps_trip:
            self.explain(board.read(FLAGS_ONLY))
            if self._tripped and not timeout:
                # The arm is stopped: keep the flag, so that other programs see the cause. `resume` clears both.
                return
        board.watchdog(timeout, mode)

    def give_back(self, board: Board) -> None:
        """Send all orders to a board that lost them; call it again until it succeeds.

        Raises:
            NotSupportedError: The reconnected board does not support them; the orders are dropped.
            HexwireError: The board does not answer, or refuses.
        """
        watchdog, report = self.watchdog, self.report
        if (watchdog and not board.has_watchdog) or (report and not board.reports_states):
            self.watchdog = self.report = None
            self.due = False
            raise NotSupportedError(
                f"the reconnected board speaks dialect {board.dialect}, which has no watchdog and no reports: "
                "both are off now"
            )
        if watchdog:
            self._arm(board, *watchdog)
        if report:
            board.report(*report)
        self.due = False
        self.given_back += 1

    def explain(self, state: JointState) -> JointState:
        """Return the state with the cause of a stop, even if the board no longer knows it."""
        self._tripped = state.stopped and (self._tripped or state.watchdog_tripped)
        return replace(state, watchdog_tripped=True) if self._tripped != state.watchdog_tripped else state

    def resumed(self) -> None:
        """Forget the cause of a stop that has ended."""
        self._tripped = False


_log = logging.getLogger(__name__)

_MAX_WATCHDOG = 60.0
_MIN_WATCHDOG = 0.05
_MIN_PERIOD = 0.005
_MAX_PERIOD = 10.0
_NO_BOOT = 1.5
_QUICK_FIELDS = tables.STATE_FIELD_LOAD | tables.STATE_FIELD_AGE
_FEEDS = 3.0
"""Requests per watchdog time-out while this program only receives reports."""


class Hex7BotDriver(SessionDriver, StateReports, OwnWatchdog, RefilledPaths, ServoPing, ServoTables, SilenceCheck):
    """The Hex7Bot, or any arm behind a board with the same protocol.

    `ioctl` takes the command codes of `hexwire.wire.command_frame.Command` with a body as in PROTOCOL.md section 6,
    and returns the reply's body; dialect 1 supports TRANSACT only.

    Args:
        session: A session; opened by `attach`.
        model: The arm.
        boot_window: Seconds to wait for a board that is booting. If None, 5; over datagrams, which reset no board,
            1.5.
        dialect: Try this dialect only; both if None.
    """

    _arguments: ClassVar = {
        "maintenance": {"on": FLAG},
        "store_limits": {"rows": or_none(rows_of(LimitRow))},
        "store_offsets": {"rows": rows_of(OffsetRow)},
        "transact": {"packet": DATA, "reply_length": WHOLE, "timeout": SECONDS},
    }

    def __init__(
        self,
        session: Session,
        model: ArmModel = HEX7BOT,
        *,
        boot_window: float | None = None,
        dialect: int | None = None,
    ) -> None:
        super().__init__(session)
        self.model = model
        self._boot_window = boot_window
        self._only_dialect = dialect
        self._board: Board | None = None
        self._generation = 0
        self._orders = StandingOrders()
        self._last: JointState | None = None
        self._aimed: dict[str, float] = {}
        self._restarts = 0
        self._memory = StopMemory("")
        self._warned = False

    @property
    def dialect(self) -> int:
        """Dialect of the attached board."""
        return self._attached().dialect

    @property
    def command_rate(self) -> float:
        return super().command_rate if self._board is None else self._board.command_rate

    def can(self, kind: type[object]) -> bool:
        """Watchdog, reports and paths are the board's."""
        board = self._board
        if issubclass(kind, Watchdog):
            return board is not None and board.has_watchdog
        if issubclass(kind, StateReports):
            return board is not None and board.reports_states
        if issubclass(kind, OnboardPaths):
            return board is not None and board.times_motion
        return super().can(kind)

    # -- attaching and detaching --------------------------------------------------------------------

    def attach(self) -> None:
        """Open the session and negotiate, waiting for a board that boots.

        Nothing is sent that moves anything. But opening a port resets the board, and one with the chapter's sketch
        then drives the arm to its middle pose: a warning is logged before, unless hexwire's firmware is known to be
        there.
        """
        session = self.session
        self._check_directions()
        # A gateway has opened its boards' ports before, and warns itself; the chapter's firmware works behind none.
        opens = not session.ipc.behind_gateway
        if opens and not self._warned:
            # Once, and not at each attempt of a program that looks for a lost board.
            self._warned = warn_of_reset(session.ipc.link)
        session.open()
        try:
            ids = [joint.servo_id for joint in self.model.joints]
            window = self._boot_window
            if window is None:
                window = _NO_BOOT if session.ipc.keeps_messages else tables.BOOT_WINDOW
            session.negotiate(boot_window=window, ping_ids=ids, dialect=self._only_dialect)
            self._board = board = self._meet()
        except BaseException:
            session.close()
            raise
        if opens:
            CalmBoard(session.ipc.link).note(calm=board.dialect != tables.PROTO_CHAPTER)
        self._warned = False
        self._memory = StopMemory("" if board.keeps_stop else self.url)
        if self._memory.stopped:
            session.epochs.assume_stopped()
        self._generation = session.generation
        self._last = None
        self._restarts = session.board_restarts
        self._aimed.clear()
        self._orders = StandingOrders()

    def _meet(self) -> Board:
        """Make the `Board` of the dialect that the session negotiated."""
        negotiated = self.session.negotiated
        if negotiated is not None and negotiated.identity is not None:
            return Board2(self.session, self.model, negotiated.identity)
        return Board1(self.session, self.model)

    def detach(self, *, torque_off: bool = False) -> None:
        board, self._board = self._board, None
        try:
            if board is not None and torque_off and self.session.is_open:
                self.session.epochs.free(partial(board.torque, False, None))
        finally:
            self.session.close()

    def probe(self) -> ProbeReport:
        board = self._attached()
        joints = board.probe_joints()
        counters = {f"board_{k}": v for k, v in board.stats().items()}
        counters |= self.host_counters()
        # An IDENTIFY ends the reports.
        self._orders.due |= self._orders.report is not None
        facts = board.facts()
        return ProbeReport(
            robot=self.model.name,
            link=self.url,
            dialect=board.dialect,
            firmware=facts.firmware,
            boot_id=facts.boot_id,
            capabilities=facts.capabilities,
            stopped=facts.stopped,
            joints=joints,
            counters=counters,
            maintenance=facts.maintenance,
            unprotected=board.unprotected,
        )

    def host_counters(self) -> dict[str, int]:
        connection = self.session.connection
        counters, decoder = connection.counters, connection.decoder.counters
        return {
            "requests": counters.requests,
            "replies": counters.replies,
            "retries": counters.retries,
            "timeouts": counters.timeouts,
            "stale_frames": counters.stale,
            "reports": counters.reports,
            "bad_frames": decoder.bad_frames,
            "bytes_dropped": decoder.bytes_dropped,
            "reconnects": self.session.reconnects,
        }

    # -- reading and writing ------------------------------------------------------------------------

    def read(self) -> JointState:
        state = self._orders.explain(self._attached().read())
        self._remember(state)
        return state

    def write(self, target: JointTarget) -> SentTarget:
        with self._calling("a move"):
            board = self._attached()
            if self._last is None:
                self.read()
            # A target is checked from the end of the previous one, unless a state was read in between.
            present = ({} if self._last is None else self._last.positions) | self._aimed
            sent = board.move(check_target(self.model, target, present), present)
            self._aimed.update(sent.positions)
            self._keep_armed()
            return sent

    def path(
        self,
        joints: Sequence[str] | None = None,
        *,
        smooth: bool = True,
        brake: float | None = None,
        outlives: bool = False,
    ) -> TimedPath:
        with self._calling("a path"):
            board = self._attached()
            path = board.path(joints, smooth=smooth, brake=brake, outlives=outlives)
            self._aimed.clear()
            self._keep_armed()
            return path

    def left_path(self) -> tuple[str, ...]:
        return self._attached().left_path()

    def clear_path(self, joints: Sequence[str] | None = None) -> bool:
        with self._calling("the end of a path"):
            return self._attached().clear_path(joints)

    def stream(self, period: float, timeout: float = 1.0, *, slow: float | None = None) -> Iterator[JointState]:
        """Yield the states that the board reports every `period` seconds.

        Ends the reports when the caller stops iterating. Continues after a reconnection and after a reset of the
        board; ends if a connected board sends no report for `timeout` seconds. Also feeds the watchdog, since a
        caller that only iterates sends nothing.

        Args:
            period: Seconds between reports.
            timeout: Seconds without a report after which the board is polled.
            slow: If given, reports are short, so that a slow line carries more of them. They leave out velocities,
                which a board reads in turns and which would be old, and voltage, temperature and current, which are
                requested every `slow` seconds.

        Raises:
            NotSupportedError: The board speaks dialect 1.
            ReplyTimeoutError: The board no longer answers.
            UsageError: The period is outside 0.005..10 s.
        """
        if not _MIN_PERIOD <= period <= _MAX_PERIOD:
            raise UsageError(f"a report every {period:g} s is outside {_MIN_PERIOD:g}..{_MAX_PERIOD:g} s")
        fields = ALL_FIELDS if slow is None else _QUICK_FIELDS
        self._attached().report(period, fields)
        orders = self._orders
        orders.report = (period, fields)
        silence = max(timeout, 2 * period)
        fed, asked = self.session.now(), -math.inf
        whole: JointState | None = None
        try:
            while True:
                board = self._attached()
                for frame, arrived in self.session.reports(silence):
                    if self.session.generation != self._generation:
                        board = self._attached()
                    if orders.watchdog is not None and self.session.now() - fed >= orders.watchdog[0] / _FEEDS:
                        # Any frame feeds it; the state also shows whether it has tripped already.
                        orders.explain(board.read(FLAGS_ONLY))
                        fed = self.session.now()
                    if slow is not None and self.session.now() - asked >= slow:
                        whole, asked = board.read(), self.session.now()
                    # Another board of the channel may report too.
                    if frame.cmd == Command.JOINT_STATE and frame.src == self.session.connection.remote:
                        state = orders.explain(board.decode_state(frame.body, frame, arrived, whole))
                        self._remember(state)
                        yield state
                # No reports: the port was lost, the board was reset, or it ended the reports.
                given_back = orders.given_back
                yield self.read()
                if orders.given_back == given_back:
                    return
        finally:
            orders.report = None
            if self.session.is_open and self._board is not None and self._board.reports_states:
                self._board.report(0.0)

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        with self._calling("torque on" if on else "torque off", freeing=not on):
            confirmed = self._attached().torque(on, joints)
            self._keep_armed()
            return confirmed

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        # Send nothing before a stop, not even the watchdog order of a board that was reset.
        if self._board is None:
            raise self._not_attached()
        with self.session.epochs.stopping():
            if self.session.generation != self._generation:
                self._after_reconnect()
            try:
                return self._board.stop(mode)
            finally:
                self._memory.remember()

    def resume(self) -> None:
        with self._calling("resume", freeing=True):
            self._attached().resume()
            self._memory.forget()
            self._orders.resumed()

    @property
    def stop_kept_by(self) -> str:
        return "board" if self._board is None or self._board.keeps_stop else self._memory.kept_by

    @property
    def watchdog_armed(self) -> bool:
        return self._orders.watchdog is not None

    def ping(self, servo_id: int) -> int | None:
        return self._attached().ping(servo_id)

    def explain_silence(self) -> list[Finding]:
        from .checkup import explain_no_board

        return explain_no_board(self.session.ipc.link)

    # -- settings -----------------------------------------------------------------------------------

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Have the board stop the arm when it receives nothing for `timeout` seconds; 0 disarms the watchdog.

        Raises:
            NotSupportedError: The board speaks dialect 1.
            UsageError: The timeout is outside 0.05..60 s.
        """
        if timeout and not _MIN_WATCHDOG <= timeout <= _MAX_WATCHDOG:
            raise UsageError(f"a watchdog of {timeout:g} s is outside {_MIN_WATCHDOG:g}..{_MAX_WATCHDOG:g} s")
        self._orders.arm(self._attached(), timeout, mode)

    def maintenance(self, on: bool) -> None:
        """Switch maintenance on or off: while it is on, `transact` can write servo settings, and nothing moves.

        A stop, a trip of the watchdog and a reset end it too.

        Raises:
            NotSupportedError: The board speaks dialect 1, or its firmware has no maintenance.
            CommandRefusedError: A joint has torque.
            StoppedError: A stop is latched.
        """
        with self._calling("maintenance"):
            self._attached().maintenance(on)

    def limits(self) -> tuple[LimitRow, ...]:
        """Read the limits that the board has stored, in counts, in its joint order."""
        return self._attached().limits()

    def store_limits(self, rows: Sequence[LimitRow] | None = None) -> tuple[LimitRow, ...]:
        """Store limits on the board, those of the model if None; returns the limits that it then has."""
        if rows is None:
            rows = [
                LimitRow(*joint.count_limits, round(joint.max_speed / joint.scale)) for joint in self.model.joints
            ]
        with self._calling("store limits"):
            return self._attached().store_limits(rows)

    def offsets(self) -> tuple[OffsetRow, ...]:
        """Read the neutral counts and signs that the board has stored."""
        return self._attached().offsets()

    def store_offsets(self, rows: Sequence[OffsetRow]) -> tuple[OffsetRow, ...]:
        """Store neutral counts and signs on the board; returns what it then has."""
        with self._calling("store offsets"):
            return self._attached().store_offsets(rows)

    def board_counters(self) -> dict[str, int]:
        return self._attached().stats()

    def transact(self, packet: bytes, reply_length: int, timeout: float = 0.02) -> bytes:
        """Send one raw servo packet and return the bytes of its answer.

        Args:
            packet: A whole packet, as `hexwire.wire.servo_packet` builds it.
            reply_length: Bytes of the answer; 0 for none.
            timeout: Seconds that the board waits for the answer.

        Raises:
            NotSupportedError: A dialect-1 board cannot process it.
        """
        with nullcontext() if packet_only_reads(packet) else self._calling("a servo packet"):
            return self._attached().transact(packet, reply_length, timeout)

    def read_table(self, joint: str, first: int = 0, count: int | None = None) -> bytes:
        servo_id = self.model.joint(joint).servo_id
        return self._attached().read_table(servo_id, first, TABLE_REGISTERS - first if count is None else count)

    def write_table(self, joint: str, first: int, data: bytes) -> None:
        with self._calling("write registers"):
            self._attached().write_table(self.model.joint(joint).servo_id, first, data)

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        effect = effect_of(tables.PROTO_HEXWIRE, sub_cmd, data)
        if effect in (Effect.NONE, Effect.STOP):
            return self._attached().command(sub_cmd, data)
        with self._calling(command_name(sub_cmd), freeing=effect is not Effect.ACT):
            return self._attached().command(sub_cmd, data)

    def may_move(self, sub_cmd: int, data: bytes = b"") -> bool:
        # Pump and valve act, but move no joint.
        return sub_cmd != Command.IO and effect_of(tables.PROTO_HEXWIRE, sub_cmd, data) is Effect.ACT

    # -- after resets and reconnections -------------------------------------------------------------

    def _calling(self, what: str, *, freeing: bool = False) -> AbstractContextManager[object]:
        """Make everything inside part of one call, whose unsent requests a stop cancels."""
        return self.session.epochs.calling(what, freeing=freeing)

    def _attached(self) -> Board:
        if self._board is None:
            raise self._not_attached()
        if self.session.generation != self._generation:
            self._after_reconnect()
        if self._orders.due:
            self._orders.give_back(self._board)
        return self._board

    @staticmethod
    def _not_attached() -> UsageError:
        return UsageError("the driver is not attached; call attach() first")

    def _after_reconnect(self) -> None:
        """Start again: after a reconnection the board may be another one, or may have been reset."""
        self._generation = self.session.generation
        self._last = None
        self._aimed.clear()
        self._board = self._meet()
        self._orders.due = True

    def _remember(self, state: JointState) -> None:
        self._last = state
        if self._aimed:
            self._aimed.clear()
        self._keep_armed()

    def _keep_armed(self) -> None:
        """Detect a reset or a reconnection after an exchange, and send the board its lost orders again."""
        if self.session.board_restarts != self._restarts:
            self._restarts = self.session.board_restarts
            _log.warning("%s: the board was reset", self.session.ipc.link.url)
            self._orders.due = True
        if self.session.generation != self._generation:
            self._after_reconnect()
        if self._orders.due and self._board is not None:
            self._orders.give_back(self._board)
