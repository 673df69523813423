"""`RemoteRobot`: a shared arm as a `RobotDriver`.

Owns what a client keeps: the newest state, the lease and its heartbeat, the offset of the owner's clock, the
trajectories that the arm's server follows for it, how one of these is a `TimedPath`, and a warning when states stop
arriving. Must not know the bytes of a robot.
"""

from __future__ import annotations

import getpass
import logging
import math
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self

from hexwire.arguments import FLAG, SECONDS, WHOLE, Wanted, one_of
from hexwire.control.loop.outcomes import Outcome, Reason
from hexwire.control.motion.goals import MAX_POINTS
from hexwire.drivers.abilities import Counters, Leased, OnboardPaths, OwnWatchdog, ServoPing, StateReports
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.timed_path import PathReport, PathStart, PathState, TimedPath, TimedPoint
from hexwire.drivers.values import ProbeReport, StopMode
from hexwire.errors import (
    GoalError,
    HexwireError,
    LeaseError,
    LinkLostError,
    LinkPermissionError,
    RemoteProtocolError,
    UsageError,
)
from hexwire.model.state import JointState, JointTarget, NewestState, SentTarget
from hexwire.motion.trajectory import Spline, Waypoint
from hexwire.system import user_id

from . import messages as m
from .address import Address
from .clock import ClockOffset
from .failures import restore
from .names import ClientRole, Keys
from .node import NoAnswerError, Node, Publisher, load_zenoh
from .questions import Questions, ask
from .rows import arm_model, as_probe_report, joint_names, sent_target
from .set_points import LONGEST, SharedSetPoints
from .states import ArrivedStates
from .trajectories import follow_message

if TYPE_CHECKING:
    from hexwire.link.diagnose import Finding

__all__ = ["GoalPath", "RemoteRobot", "Silence", "whoami"]

_SOON, _PER_SECOND = 0.4, 0.02
"""Seconds from the order to the start, and more for each second of the path: the server checks all of it before."""
_ATTEMPTS = 3
"""Orders of which each has twice as much time to reach the server."""
_SETTLED = 0.3
"""Seconds after the end of a path until which its server may still wait for the joints to stand still."""


class _Server(Protocol):
    """What a path needs of `RemoteRobot`."""

    def follow(self, path: Spline, start: float, *, anywhere: bool = False) -> int: ...

    def goal(self, number: int) -> m.Goal: ...

    def cancel(self, number: int) -> None: ...

    @property
    def clock_offset(self) -> tuple[float, float]: ...


class GoalPath(TimedPath):
    """A path of one shared arm; made by `RemoteRobot.path`.

    It ends, and the joints come to rest on it, when this program loses the lease.

    Args:
        server: The arm.
        joints: Names.
        now: This program's clock, seconds.
    """

    def __init__(
        self, server: _Server, joints: Sequence[str], *, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.joints, self.lead = tuple(joints), 0.0
        self.capacity = self.request = MAX_POINTS
        self._server, self._now = server, now
        self._points: list[TimedPoint] = []
        self._whole = False
        self._number: int | None = None
        self._began = self._ends = 0.0

    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        if self._number is not None:
            raise UsageError("the server of a shared arm takes no points after the start")
        begin = len(self._points) if first is None else first
        if not 0 <= begin <= len(self._points):
            raise UsageError(f"there are {len(self._points)} points; none can be sent as number {begin}")
        del self._points[begin:]
        taken = points[: self.capacity - begin]
        self._points.extend(taken)
        self._whole = last and len(taken) == len(points)
        return len(taken)

    def start(self, at: float | None = None) -> PathStart:
        if not self._whole or len(self._points) < 2:
            raise UsageError(f"the server of a shared arm takes a path of 2 to {self.capacity} points at once")
        path = Spline(self.joints, [Waypoint(p.time, p.positions, p.velocities) for p in self._points])
        soon, attempt = _SOON + _PER_SECOND * path.duration, 1
        while self._number is None:
            begins = self._now() + soon if at is None else at
            try:
                # From where the joints are: under load they rest beside what they were told.
                self._number = self._server.follow(path, begins, anywhere=True)
            except GoalError as error:
                if error.reason != Reason.TOO_LATE or at is not None or attempt == _ATTEMPTS:
                    raise
                soon, attempt = 2.0 * soon, attempt + 1
            else:
                self._began, self._ends = begins, begins + path.duration
        _, doubt = self._server.clock_offset
        return PathStart(self._began, doubt)

    def report(self) -> PathReport:
        sent = len(self._points)
        if self._number is None:
            return PathReport(PathState.LOADING, sent, 0, self.capacity - sent, 0)
        state, why = self._state(self._number)
        return PathReport(state, sent, 0, 0, 0, why)

    def _state(self, number: int) -> tuple[PathState, str]:
        try:
            row = self._server.goal(number)
        except GoalError as error:
            return PathState.NONE, str(error)
        now = self._now()
        if row.outcome == Outcome.SUCCEEDED:
            return PathState.DONE, ""
        if not row.outcome:
            if now > self._ends + _SETTLED:
                # Where exactly the joints are to be, this program judges itself.
                return PathState.DONE, ""
            return (PathState.RUNNING if now >= self._began else PathState.WAITING), ""
        return (PathState.STOPPED if row.reason == Reason.STOPPED else PathState.ABORTED), row.text

    def abort(self) -> PathState:
        if self._number is not None:
            self._server.cancel(self._number)
        return PathState.ABORTED


_log = logging.getLogger(__name__)
_QUIET = 0.8
"""Seconds without a state before the warning: a server sends at least one every 0.4 s."""
_STALLED = 0.5
"""A longer time between two calls of `look`, in seconds, means that this program itself was halted."""
_TIMEOUT = 2.0
"""Seconds for an answer that does not need the arm's line."""
_SLOW = 25.0
"""Seconds for an answer that does: a probe of an arm with silent servos takes long."""
_BEATS = 5.0
"""Heartbeats per time-out of the lease, or of the watchdog if that is shorter."""
_LOOK = 0.1
"""Most seconds between two checks whether states still arrive."""
_SHARE = 0.5
"""Part of this time-out for which a heartbeat waits for its answer; then the next one is sent."""
_EXCHANGES = 4
"""Measurements of the owner's clock at the beginning."""
_SILENCE = 1.0
"""Seconds without a state after which `read` asks for the reason; as long as the server answers, it waits on."""


def whoami() -> str:
    """This program, for display at other computers."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):
        user = f"user {user_id()}"
    program = Path(sys.argv[0] or "python").name
    shown = f"{user}@{socket.gethostname()} ({program}, process {os.getpid()})"
    # A name out of a file system may have bytes that are no text.
    return shown.encode(errors="replace").decode()


class Silence:
    """Logs a warning when the states of an arm stop arriving, once for each pause.

    Args:
        url: Address of the arm, for the text.
        since: When the first state could have come, seconds of this program's monotonic clock.
    """

    def __init__(self, url: str, since: float) -> None:
        self._url, self._since = url, since
        self._looked, self._told = since, False

    def look(self, now: float, arrived: float) -> None:
        """Check for a pause; to be called several times a second.

        Args:
            now: Seconds of this program's monotonic clock.
            arrived: When the newest state arrived; minus infinity if none has.
        """
        stalled, self._looked = now - self._looked > _STALLED, now
        silent = now - max(arrived, self._since)
        if silent < _QUIET:
            if self._told:
                _log.warning("%s: its states arrive again", self._url)
            self._told = False
        elif not self._told and not stalled:
            self._told = True
            none = "no state has arrived" if arrived == -math.inf else "its states have stopped arriving"
            _log.warning("%s: %s for %.1f s; is its server halted, or the network down?", self._url, none, silent)


class RemoteRobot(RobotDriver, OwnWatchdog, StateReports, OnboardPaths, Leased, ServoPing, Counters):
    """An arm that `hexwire serve` shares.

    Reading needs no lease. The first order takes it; a lease that was lost is not taken again by itself, but by
    `take` or `resume`. `detach` gives it back, and a motion that was begun runs to its end.

    Args:
        address: Where it is.
        facts: What its server says of it.
    """

    _arguments: ClassVar[dict[str, dict[str, Wanted]]] = {
        "follow": {"path": one_of(Spline), "start": SECONDS, "anywhere": FLAG, "confirm": FLAG},
        "check_path": {"path": one_of(Spline)},
        "goal": {"number": WHOLE},
        "confirm": {"number": WHOLE},
        "cancel": {"number": WHOLE},
    }

    def __init__(self, address: Address, facts: m.Facts) -> None:
        super().__init__()
        self.address = address
        self.model = arm_model(facts)
        self._facts, self._keys = facts, Keys(address.name)
        self._node: Node | None = None
        # The session in which the facts were requested; `attach` continues with it.
        self._opened: Node | None = None
        self._commands_as = ClientRole.OBSERVER
        self._me = whoami()
        self._clock = ClockOffset()
        # Both the thread of a call and that of the heartbeat add to it.
        self._comparing = threading.Lock()
        self._states = ArrivedStates(address.text, self._clock)
        self._questions = Questions(address)
        # One order at a time, so that they arrive in the order of their numbers.
        self._ordering = threading.RLock()
        self._lease, self._last_lease, self._sequence, self._timeout = 0, 0, 0, facts.timeout
        self._lost = ""
        self._watchdog, self._watchdog_mode = 0.0, StopMode.HOLD
        self._used = time.monotonic()
        # When the last order that was done was made.
        self._ordered = -math.inf
        self._discarded = -math.inf
        self._refused = 0
        self._set_points = SharedSetPoints(address.text)
        # Made when the first stream begins.
        self._publish: Publisher | None = None
        self._keeper: threading.Thread | None = None
        self._ending = threading.Event()

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """Ask the server at an address for the arm's model; the driver is not attached yet.

        Args:
            url: As in ``zenoh:lab/arm1?router=tls/lab-pc:7447``.
            **options: ``robot``: the name that the model must have, or the robot whose geometry it has.

        Raises:
            UsageError: The address is wrong, or the arm is another model.
            LinkError: There is no such arm, or this program has no right to ask.
        """
        robot = options.pop("robot", None)
        if options:
            raise UsageError(f"a shared arm has no option {', '.join(sorted(options))}; its server has it")
        address = Address.parse(url)
        # Before anybody is advised to start a server: without it there is none.
        load_zenoh()
        node = address.network().open()
        try:
            facts = m.convert(ask(node, address, Keys(address.name).ask, m.Ask("facts"), _TIMEOUT).value, m.Facts)
            if robot not in (None, facts.robot, facts.geometry or None):
                raise UsageError(f"{address.text} is a {facts.robot}, not a {robot}; its server names the robot")
            driver = cls(address, facts)
        except BaseException:
            node.close()
            raise
        driver._opened = node
        return driver

    # -- properties -----------------------------------------------------------------------------------

    @property
    def url(self) -> str:
        return self.address.text

    @property
    def is_attached(self) -> bool:
        return self._node is not None

    @property
    def watchdog_armed(self) -> bool:
        return self._watchdog > 0

    @property
    def command_rate(self) -> float:
        return self._facts.command_rate

    def can(self, kind: type[object]) -> bool:
        """Its server has a watchdog; whether the arm has one, or executes paths, is the board's."""
        if issubclass(kind, OwnWatchdog):
            return self._facts.watchdog
        if issubclass(kind, OnboardPaths):
            return self._facts.times_motion and super().can(kind)
        return super().can(kind)

    @property
    def stop_kept_by(self) -> str:
        return "board" if self._facts.kept == "board" else "server"

    @property
    def round_trips(self) -> Sequence[float]:
        return self._questions.round_trips

    @property
    def holder(self) -> str:
        """Who holds the lease, in words; empty if nobody does."""
        self._states.refresh()
        newest = self._states.newest
        return newest.holder if newest is not None else self._facts.holder

    @property
    def held(self) -> str:
        """Why the arm holds, in words: somebody lost the lease; empty if it does not."""
        self._states.refresh()
        newest = self._states.newest
        return newest.held if newest is not None else ""

    @property
    def clock_offset(self) -> tuple[float, float]:
        """Offset of the owner's monotonic clock (owner = here + offset) and its uncertainty, seconds."""
        return self._clock.at(time.monotonic())

    def host_counters(self) -> dict[str, int]:
        refused = self._refused + self._set_points.refused
        states, counters = self._states, {**self._questions.counters, "refused": refused}
        return {**counters, "states": states.seen, "lost_states": states.lost, "damaged": states.damaged}

    def board_counters(self) -> dict[str, int]:
        rows = self._question(m.Ask("counters"))
        if not isinstance(rows, dict) or not all(isinstance(value, int) for value in rows.values()):
            raise RemoteProtocolError("not counters")
        return {str(key): value for key, value in rows.items()}

    # -- connection -----------------------------------------------------------------------------------

    def attach(self) -> None:
        if self._node is not None:
            return
        node = self._session()
        try:
            self._commands_as = self.address.role_by(node.cert)
            for _ in range(_EXCHANGES):
                sent = time.monotonic()
                answer = ask(node, self.address, self._keys.ask, m.Ask("clock"), _TIMEOUT)
                self._clock.add(sent, answer.clock, time.monotonic())
            states = ArrivedStates(self.url, self._clock, node.inbox(self._keys.state))
        except BaseException:
            node.close()
            raise
        self._node, self._states, self._lost, self._lease, self._publish = node, states, "", 0, None
        self._set_points.begin(0)
        self._ending = threading.Event()
        self._used = time.monotonic()
        self._keeper = threading.Thread(target=self._keep, args=(node, self._ending), name="lease", daemon=True)
        self._keeper.start()

    def _session(self) -> Node:
        """The session in which the facts were requested if it is still connected, otherwise a new one."""
        node, self._opened = self._opened, None
        if node is not None:
            if node.connections:
                return node
            node.close()
        return self.address.network().open()

    def detach(self, *, torque_off: bool = False) -> None:
        if self._node is None:
            self.abort()
            return
        try:
            if torque_off:
                self.torque(False)
            if self._lease:
                with suppress(HexwireError):
                    self.release(finish=True)
        finally:
            self.abort()

    def abort(self) -> None:
        nodes, self._node, self._opened = (self._node, self._opened), None, None
        self._ending.set()
        self._states.close()
        for node in nodes:
            if node is not None:
                node.close()
        # A thread that is in Zenoh when the interpreter ends would abort the program.
        if self._keeper is not None and self._keeper is not threading.current_thread():
            self._keeper.join(_TIMEOUT)

    # -- the lease ------------------------------------------------------------------------------------

    def take(self, *, force: bool | None = None) -> None:
        with self._ordering:
            force = self.address.take if force is None else force
            sent = time.monotonic()
            answer = self._exchange(
                self._keys.lease(self._role),
                m.Take(self._me, force, self._watchdog, int(self._watchdog_mode), self._lease),
                _TIMEOUT,
            )
            if type(answer.value) is not int or answer.value <= 0:
                raise RemoteProtocolError("not a lease")
            # The first order follows at once, and the owner's computer may have been restarted since the last time.
            self._compare(sent, answer.clock, time.monotonic())
            self._used = time.monotonic()
            if answer.value != self._lease:
                self._sequence = 0
            self._lost, self._lease, self._last_lease = "", answer.value, answer.value
            number = answer.details.get("lease")
            self._set_points.begin(number if type(number) is int else 0)

    def release(self, *, finish: bool = False) -> None:
        """Give the lease back.

        Args:
            finish: A motion that was begun runs to its end; otherwise the arm holds.
        """
        with self._ordering:
            if finish:
                self._settle()
            lease, self._lease = self._lease, 0
            self._set_points.begin(0)
            if lease:
                self._exchange(self._keys.lease(self._role), m.Leave(lease, finish), _TIMEOUT)

    def _settle(self) -> None:
        """Wait until the states tell what became of the published set-points, which the end of the lease voids."""
        deadline = time.monotonic() + _TIMEOUT
        with suppress(HexwireError):
            while self._set_points.waits and (left := deadline - time.monotonic()) > 0.0:
                self._states.next(self._so_far(), min(left, _LOOK))
                self._look_at_set_points()
        if (error := self._set_points.take_error()) is not None:
            _log.warning("%s: the last set-points were not done: %s", self.url, error)

    @property
    def _role(self) -> ClientRole:
        role = self._commands_as
        if role is ClientRole.OBSERVER:
            cert = self._attached().cert
            whose = f"the certificate {cert} is not an operator's" if cert else "the address says so"
            raise LinkPermissionError(
                f"{self.url}: an observer may read and stop, but not command it ({whose})", url=self.url
            )
        return role

    # -- reading --------------------------------------------------------------------------------------

    def read(self) -> JointState:
        """The first state that arrives after the call; a long request of another program delays it.

        Raises:
            LeaseError: The watchdog is armed, so that this program moves the arm, but the lease was lost.
        """
        self._use()
        since = self._so_far()
        while (state := self._next(since, _SILENCE)) is None:
            self._ask_why()
            self._check_set_points(reads=True)
            if time.monotonic() - since > _SLOW:
                raise LinkLostError(f"{self.url} answers, but its robot sends no states", url=self.url)
        self._check_set_points(reads=True, stopped=state.stopped)
        return state

    def newest(self) -> NewestState:
        """The newest state that has arrived; waits only for the first one. It may be from before the last order.

        Raises:
            LeaseError: As `read`.
        """
        self._use()
        self._attached()
        state = self._states.latest()
        self._check_lease()
        self._check_set_points(reads=True, stopped=state is not None and state.stopped)
        return super().newest() if state is None else NewestState(state, max(0.0, self.now() - state.stamp))

    def stream(self, period: float, timeout: float = 1.0, *, slow: float | None = None) -> Iterator[JointState]:
        """States at this period, or at that of the server if it is longer; `slow` has no effect. See `read`."""
        if not 0 < period < math.inf:
            raise UsageError(f"a period of {period:g} s is invalid")
        due = self._so_far()
        while True:
            state = self._next(max(due, self._discarded), timeout)
            if state is None:
                self._ask_why()
                return
            # Half a period early is in time, to keep the average rate.
            due = max(due + period, time.monotonic() - period)
            self._use()
            self._check_set_points(reads=True, stopped=state.stopped)
            yield state
            due = max(due, self._states.arrived + 0.5 * period)

    def discard_reports(self) -> None:
        self._discarded = self._so_far()

    def _so_far(self) -> float:
        """The present time; only states that arrive later count."""
        self._states.refresh()
        return time.monotonic()

    def _next(self, since: float, patience: float) -> JointState | None:
        self._attached()
        state = self._states.next(since, patience)
        self._check_lease()
        return state

    def _check_lease(self) -> None:
        # The arm no longer does what this program believes, and nobody would stop the program otherwise.
        if self._lost and self._watchdog:
            raise LeaseError(self._lost)

    def _ask_why(self) -> None:
        """Raise the reason why no states arrive: no such arm, no right, or no answer."""
        self._exchange(self._keys.ask, m.Ask("clock"), _TIMEOUT)

    # -- orders ---------------------------------------------------------------------------------------

    def write(self, target: JointTarget) -> SentTarget:
        """Send a target; see `RobotDriver.write`.

        After five short ones that follow each other closely, further ones are sent without waiting for answers. The
        result is then what was asked for, with the limited and silent joints of one before. If one is refused, the
        next order raises the error once a state tells so, and if none follows for 0.25 s, whatever reads does.
        Only that the arm is stopped is no error of a state, which shows it.
        """
        names, angles = zip(*target.positions, strict=True)
        value = self._order("a move", m.Write(names, angles, target.duration, target.guided))
        if value is None:
            set_points = self._set_points
            return SentTarget(target.positions, target.duration, set_points.clamped, set_points.silent)
        return sent_target(value)

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        names = None if joints is None else tuple(joints)
        return joint_names(self._order("torque", m.Torque(on, names), freeing=not on))

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        value = self._order("a special command", m.Ioctl(sub_cmd, bytes(data)))
        if not isinstance(value, bytes):
            raise RemoteProtocolError("not bytes")
        return value

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Stop it; see `RobotDriver.stop`. Torque off is for operators and maintainers.

        Raises:
            LinkPermissionError: It is stopped, but holds, since this program may not switch torque off.
        """
        return self._stop(m.StopRequest(self._me, int(mode), self._lease, self._sequence))

    def stop_own(self) -> tuple[str, ...]:
        """Stop it, but raise `LeaseError` if another program has taken it from this one, and may be moving it."""
        return self._stop(m.StopRequest(self._me, key=self._last_lease, sequence=self._sequence, own=True))

    def _stop(self, request: m.StopRequest) -> tuple[str, ...]:
        node = self._attached()
        with self.epochs.stopping():
            answer, kept = self._questions.stop(node, self._commands_as, request, _SLOW)
            self._states.require(answer.done)
            self._set_points.answered(request.sequence, time.monotonic(), set_point=False)
            names = joint_names(answer.value)
        if kept:
            # Outside the block: an error inside would count as an unconfirmed stop.
            raise LinkPermissionError(f"{self.url} is stopped and holds, with torque: {kept}", url=self.url)
        return names

    def resume(self) -> None:
        token = self.epochs.token("resume", freeing=True)
        with self.epochs.using(token):
            if self._lost:
                # At the request of a person: after a loss of the lease this takes it again.
                self.take()
            self._order("resume", m.Resume(), freeing=True)
            self.epochs.resumed(token)

    def watchdog(self, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Have the server stop the arm when this program makes no call for `timeout` seconds; 0 disarms it.

        It belongs to the lease: without one, it is armed when the lease is taken. Whatever it is, a lease is lost
        when nothing comes from this program at all, and the arm then holds.

        Raises:
            UsageError: The timeout is outside 0.05..60 s.
        """
        if timeout and not 0.05 <= timeout <= 60.0:
            raise UsageError(f"a watchdog of {timeout:g} s is outside 0.05..60 s")
        self._watchdog, self._watchdog_mode = timeout, mode
        if self._lease:
            self._order("the watchdog", m.Watchdog(timeout, int(mode)))

    def _order(self, what: str, order: m.Order, *, freeing: bool = False, slow: bool = False) -> Any:
        token = self.epochs.token(what, freeing=freeing)
        with self.epochs.using(token), self._ordering:
            self._use()
            if not self._lease:
                if self._lost:
                    raise LeaseError(f"{self._lost}; take the lease again")
                self.take()
            if not freeing:
                self._check_set_points()
            made = time.monotonic()
            self._sequence += 1
            offset, doubt = self._clock.at(made)
            self.epochs.check(token, what)
            envelope = m.Envelope(self._lease, self._sequence, made + offset, doubt, order)
            set_point = isinstance(order, m.Write) and order.duration <= LONGEST
            if set_point and self._published(envelope, made):
                return None
            slow = slow or not isinstance(order, m.Write | m.Watchdog | m.Cancel | m.Confirm)
            try:
                answer = self._exchange(self._keys.order(self._role), envelope, _SLOW if slow else _TIMEOUT)
            except LeaseError as error:
                self._refused += 1
                if error.lost:
                    self._lose(error.reason)
                raise
            self._ordered = made
            self._states.require(answer.done)
            self._set_points.answered(envelope.sequence, made, set_point=set_point)
            return answer.value

    def _published(self, envelope: m.Envelope, now: float) -> bool:
        """Publish a set-point if it belongs to a stream; returns whether it did."""
        set_points = self._set_points
        if not set_points.runs(now):
            return False
        if self._publish is None:
            self._publish = self._attached().publisher_in_order(self._keys.order(self._role))
        # An older server does not subscribe, and an access file of before allows nobody to.
        if not self._publish.is_wanted:
            return False
        set_points.published(envelope.sequence, now)
        self._states.require_dealt(set_points.lease, envelope.sequence)
        self._publish(m.encode(envelope))
        return True

    def _look_at_set_points(self) -> None:
        self._set_points.look(self._states.newest, self._states.arrived)

    def _check_set_points(self, *, reads: bool = False, stopped: bool = False) -> None:
        """Raise the error of a published set-point that was refused; see `SharedSetPoints.take_error_of_read`."""
        self._look_at_set_points()
        set_points = self._set_points
        if reads:
            error = set_points.take_error_of_read(time.monotonic(), stopped=stopped)
        else:
            error = set_points.take_error()
        if error is None:
            return
        self._states.require_dealt(0, 0)
        if isinstance(error, LeaseError) and error.lost:
            error = self._why_lost(error)
            self._lose(error.reason)
        raise error

    def _why_lost(self, known: LeaseError) -> LeaseError:
        """Why the lease was lost: the server knows, even if whoever took it has given it back since."""
        if not self._lease:
            return LeaseError(self._lost)
        try:
            self._exchange(self._keys.lease(self._role), m.Beat(self._lease), _TIMEOUT)
        except LeaseError as told:
            return told
        except HexwireError:
            # What the state has told is true, too.
            return known
        return known

    def _lose(self, why: str) -> None:
        self._lease, self._lost = 0, why or "the lease was lost"
        self._set_points.lose(LeaseError(self._lost))

    def _asked(self, question: m.Ask) -> m.Answer:
        self._use()
        return self._exchange(self._keys.ask, question, _TIMEOUT)

    # -- trajectories that the server follows --------------------------------------------------------

    def follow(self, path: Spline, start: float, *, anywhere: bool = False, confirm: bool = False) -> int:
        """Have the arm's server follow a trajectory from a time on, so that the network cannot disturb it.

        The server checks it, and refuses one that cannot begin in time. It ends, and the joints hold, when this
        program loses the lease.

        Args:
            path: Begins where the joints are.
            start: When it begins, seconds of this program's monotonic clock.
            anywhere: Lead the joints from where they are to its second point, and not only from its first one.
            confirm: It begins only if `confirm` is called before the start (see `control.sharing.shared_goals`).

        Returns:
            Its number, for `goal`, `confirm` and `cancel`.

        Raises:
            GoalError: It is refused; nothing moves.
        """
        offset, _ = self._clock.at(time.monotonic())
        value = self._order(
            "a trajectory", follow_message(path, start + offset, anywhere=anywhere, confirm=confirm), slow=True
        )
        if not isinstance(value, int):
            raise RemoteProtocolError("not the number of a trajectory")
        return value

    def path(
        self,
        joints: Sequence[str] | None = None,
        *,
        smooth: bool = True,
        brake: float | None = None,
        outlives: bool = False,
    ) -> GoalPath:
        """Begin a path that the arm's server follows; see `OnboardPaths.path`.

        The server takes it whole, and the time in which it brakes is the server's.

        Raises:
            NotSupportedError: The arm's board keeps no time.
            UsageError: `outlives` is asked for: a motion ends with the lease.
        """
        OnboardPaths.of(self)
        if outlives:
            raise UsageError("a motion of a shared arm does not go on without the program that began it")
        names = self.model.names if joints is None else [self.model.joint(name).name for name in joints]
        return GoalPath(self, names)

    def check_path(self, path: Spline) -> None:
        """Have the arm's server check a trajectory from its first point on; nothing moves. Needs the lease.

        Raises:
            GoalError: It is not allowed.
        """
        self._order("the check of a trajectory", follow_message(path, check=True), slow=True)

    def goal(self, number: int) -> m.Goal:
        """What became of a trajectory; times are of the owner's clock (see `clock_offset`)."""
        return m.convert(self._asked(m.Ask("goal", number)).value, m.Goal)

    def confirm(self, number: int) -> None:
        """Let a trajectory begin that waits for it.

        Raises:
            GoalError: It will not begin: it is not ready, has ended, or it is too late.
        """
        self._order("the start of a trajectory", m.Confirm(number))

    def cancel(self, number: int) -> None:
        """End a trajectory, before or after its start; the joints hold."""
        self._order("the end of a trajectory", m.Cancel(number))

    # -- questions ------------------------------------------------------------------------------------

    def probe(self) -> ProbeReport:
        return as_probe_report(self._question(m.Ask("probe")), self.url)

    def ping(self, servo_id: int) -> int | None:
        value = self._question(m.Ask("ping", servo_id))
        if value is None or isinstance(value, int):
            return value
        raise RemoteProtocolError("not an error byte")

    def examine(self) -> list[Finding]:
        from hexwire.link.diagnose import Finding, Level

        # Its line is busy with the arm, which may be moving.
        said = f"{self._facts.port} at {self._facts.host or 'its server'} is not examined through the server"
        advice = "if in doubt, end the server and run 'hexwire doctor' there"
        return [*super().examine(), Finding(Level.UNKNOWN, "port", said, advice)]

    def _question(self, question: m.Ask) -> Any:
        self._use()
        return self._exchange(self._keys.ask, question, _SLOW).value

    def _exchange(self, key: str, message: Any, timeout: float) -> m.Answer:
        return self._questions.ask(self._attached(), key, message, timeout)

    def _attached(self) -> Node:
        if self._node is None:
            raise UsageError("the driver is not attached; call attach() first")
        return self._node

    def _use(self) -> None:
        self._used = time.monotonic()

    # -- the heartbeat --------------------------------------------------------------------------------

    def _compare(self, sent: float, other: float, received: float) -> None:
        """Compare the clocks by an exchange; see `ClockOffset.add`."""
        with self._comparing:
            self._clock.add(sent, other, received)

    def _keep(self, node: Node, ending: threading.Event) -> None:
        """Renew the lease and follow the owner's clock, in a thread of its own."""
        measured, server, sent = time.monotonic(), 0, -math.inf
        step = min(self._timeout / _BEATS, _LOOK)
        silence = Silence(self.url, measured)
        while not ending.wait(step):
            # By a heartbeat the watchdog learns of calls, too, such as those that only read.
            limit = min(self._timeout, self._watchdog or math.inf)
            step = min(limit / _BEATS, _LOOK)
            self._states.refresh()
            self._look_at_set_points()
            lease, now, newest = self._lease, time.monotonic(), self._states.newest
            silence.look(now, self._states.arrived)
            # Another server may have another clock: its computer was restarted.
            sender = newest.server if newest is not None else 0
            compared = sender == server and now - measured < self._clock.period(now)
            # An order that was done has renewed the lease as well.
            renewed = max(sent, self._ordered, self._set_points.renewed) if compared else sent
            # Half a step early counts as in time.
            if now - renewed < limit / _BEATS - 0.5 * step:
                continue
            sent = now
            if not lease and compared:
                continue
            beat = m.Beat(lease, now - self._used)
            key, message = (self._keys.lease(self._role), beat) if lease else (self._keys.ask, m.Ask("clock"))
            try:
                # Not `ask`, which would search for the reason of a missing answer while the lease runs out.
                answer = m.decode(node.ask(key, m.encode(message), _SHARE * limit), m.Answer)
            except (NoAnswerError, HexwireError):
                continue
            if not answer.kind:
                measured, server = time.monotonic(), sender
                self._compare(now, answer.clock, measured)
            elif lease and self._lease == lease:
                error = restore(answer.kind, answer.text, answer.details)
                if isinstance(error, LeaseError) and error.lost:
                    self._lose(error.reason)
