"""A `TimedPath` on a board of dialect 2: radians to counts, seconds to ticks, and the board's clock.

Owns the translation, which points the board has, and offset and drift of its clock, with bounds that hold. Must not
know links or callers.

The board read its clock between the times of a request and of its reply, so every exchange bounds the difference
of the clocks from both sides. Two of them bound the drift. Together they give an interval for any time, which is
right as long as the drift is even over the exchanges that are kept; its middle is the estimate, half its width the
uncertainty.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from hexwire.errors import CommandRefusedError, LimitError, StoppedError, UsageError
from hexwire.units import decimal
from hexwire.wire.board_trajectory import (
    POINT_TIME,
    BeginReply,
    BeginRequest,
    PathFlag,
    PathPoint,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
    point_size,
    serialize_points,
)
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.tables import FRAME_OVERHEAD

from .replies import check_reply
from .timed_path import REST_POINTS, PathReport, PathStart, PathState, TimedPath, TimedPoint

if TYPE_CHECKING:
    from hexwire.model.arm import JointModel
    from hexwire.session.events import Reply

__all__ = [
    "DRIFT",
    "MOST_BODY",
    "Board2Path",
    "BoardTime",
    "ClockRelation",
    "HostTime",
    "WrappingClock",
    "begin_request",
]

DRIFT = 0.01
"""Difference in rate that the clocks may have, unless exchanges tell a smaller one. Boards with a ceramic resonator
are specified to 0.5 %."""
_KEPT = 24
"""Exchanges that are kept."""
_SPAN = 60.0
"""Seconds for which one is kept: with a change of temperature the drift changes."""
_SLOT = 1.0
"""Seconds in which only the shortest exchange is kept, apart from the newest."""


class HostTime(NamedTuple):
    """A time of the host's clock, seconds, and how far off it may be."""

    time: float
    uncertainty: float


class _Exchange(NamedTuple):
    board: float
    earliest: float
    latest: float


class WrappingClock:
    """Makes a clock of 32 bits in microseconds, which wraps after 71.6 minutes, one that does not; in seconds."""

    def __init__(self) -> None:
        self._last: int | None = None

    def read(self, time_us: int) -> float:
        """The time that a board has sent; at most half a wrap before or after the one before."""
        self._last = self._near(time_us)
        return self._last * 1e-6

    def near(self, time_us: int) -> float:
        """Another time, at most half a wrap before or after the last one that was read."""
        return self._near(time_us) * 1e-6

    def _near(self, time_us: int) -> int:
        last = time_us if self._last is None else self._last
        return last + ((time_us - last + 0x80000000) & 0xFFFFFFFF) - 0x80000000


class ClockRelation:
    """Relates the clock of one board to the host's. All times are in seconds."""

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque()
        self._slowest, self._fastest = 1.0 - DRIFT, 1.0 + DRIFT

    def __bool__(self) -> bool:
        """Whether there was an exchange."""
        return bool(self._exchanges)

    @property
    def drift(self) -> float:
        """How much faster the host's clock runs than the board's; 1e-6 is a millionth."""
        return (self._slowest + self._fastest) / 2.0 - 1.0

    def add(self, sent: float, received: float, board: float) -> None:
        """Note an exchange.

        Args:
            sent: Host's clock when the request began; plus the time that it takes on the line, if that is known.
            received: Host's clock when the reply was there; minus the time that it takes on the line.
            board: The board's clock when it made the reply.

        Raises:
            UsageError: The reply came before the request.
        """
        if not sent <= received:
            raise UsageError(f"an exchange cannot end ({received:g} s) before it begins ({sent:g} s)")
        kept = self._exchanges
        if kept and board < kept[-1].board:
            # The board was reset.
            kept.clear()
        # In a slot of time only the shortest one tells something; but never without the newest.
        while len(kept) > 1 and board - kept[-2].board < _SLOT:
            a, b = kept[-2], kept[-1]
            if a.latest - a.earliest <= b.latest - b.earliest:
                kept.pop()
            else:
                del kept[-2]
        kept.append(_Exchange(board, sent, received))
        while len(kept) > _KEPT or kept[-1].board - kept[0].board > _SPAN:
            kept.popleft()
        self._bound_drift()
        while self._is_contradiction():
            # The drift was not even, or the host's clock was set.
            kept.popleft()
            self._bound_drift()

    def host_time(self, board: float) -> HostTime:
        """The host's time at a time of the board's clock.

        Raises:
            UsageError: There was no exchange yet.
        """
        earliest, latest = self._interval(board)
        return HostTime((earliest + latest) / 2.0, (latest - earliest) / 2.0)

    def board_time(self, host: float) -> float:
        """The board's time at a time of the host's clock, as good as `host_time` there; raises likewise."""
        if not self._exchanges:
            raise UsageError("the clocks were not compared yet")
        guess = self._exchanges[-1].board
        # The relation bends a little at each exchange, so the first step is not exact.
        for _ in range(3):
            guess += (host - self.host_time(guess).time) / (1.0 + self.drift)
        return guess

    def _interval(self, board: float) -> tuple[float, float]:
        if not self._exchanges:
            raise UsageError("the clocks were not compared yet")
        slow, fast = self._slowest, self._fastest
        ways = [(each, board - each.board) for each in self._exchanges]
        earliest = max(each.earliest + (slow if way >= 0.0 else fast) * way for each, way in ways)
        latest = min(each.latest + (fast if way >= 0.0 else slow) * way for each, way in ways)
        return earliest, latest

    def _bound_drift(self) -> None:
        slow, fast = 1.0 - DRIFT, 1.0 + DRIFT
        kept = list(self._exchanges)
        for i, a in enumerate(kept):
            for b in kept[i + 1 :]:
                if (span := b.board - a.board) > 0.0:
                    slow = max(slow, (b.earliest - a.latest) / span)
                    fast = min(fast, (b.latest - a.earliest) / span)
        self._slowest, self._fastest = slow, fast

    def _is_contradiction(self) -> bool:
        if len(self._exchanges) < 2:
            return False
        if self._slowest > self._fastest:
            return True
        return any(earliest > latest for earliest, latest in (self._interval(e.board) for e in self._exchanges))


_POINTS_HEAD = 5
_MOST_POINTS = 255
MOST_BODY = 208
"""Bytes of the longest body that fits one frame of a board."""
_FINE = 8
_MOST_TICKS = 0xFFFF
_BITS_PER_BYTE = 10
_PLENTY = 0.6
"""Seconds of a path with which a board can be without points to rest for a request or two: a 7Bot
needs 0.44 to brake."""
_COUNTS_16 = 32767
_ON_ITS_WAY = (PathState.RUNNING, PathState.BRAKING, PathState.DONE)


class BoardTime:
    """The board's clock, as far as requests have shown it.

    Args:
        now: Host's clock.
        baud: Of the line; 0 if bytes take no time that is known.

    Attributes:
        now: The host's clock.
    """

    def __init__(self, now: Callable[[], float], baud: int) -> None:
        self.now, self._baud = now, baud
        self._wrapping = WrappingClock()
        self.relation = ClockRelation()

    def unwrap(self, time_us: int) -> float:
        """A time of the board's clock near that of the last exchange, without wraps, seconds."""
        return self._wrapping.near(time_us)

    def note(self, reply: Reply, request: int, time_us: int) -> float:
        """Take the board's clock from a reply that has just arrived; returns it in seconds, without wraps.

        Args:
            reply: The reply.
            request: Bytes of the request's body.
            time_us: The clock in its body.
        """
        board = self._wrapping.read(time_us)
        received = self.now()
        sent = received - reply.rtt
        if reply.attempts > 1:
            # The answer may be to an earlier attempt, and its clock of before this one.
            return board
        if self._baud:
            # The board cannot have read its clock before the request was there, nor after it began to answer.
            seconds = _BITS_PER_BYTE / self._baud
            up = (FRAME_OVERHEAD + request) * seconds
            down = (FRAME_OVERHEAD + len(reply.body)) * seconds
            if up + down < reply.rtt:
                sent, received = sent + up, received - down
        self.relation.add(sent, received, board)
        return board


class Board2Path(TimedPath):
    """A path on one board; made by `Board2.path`.

    Args:
        ask: Sends a request that acts.
        look: Sends a request that only reads.
        joints: Of the path, in the board's order.
        clock: The board's clock.
        reply: To TRAJECTORY_BEGIN.
        smooth: The points have velocities.
        fine: Their positions are sent in eighths of a count.
        whole: Points that need several frames may be one request, in fragments.
    """

    def __init__(
        self,
        ask: Callable[[int, bytes], Reply],
        look: Callable[[int, bytes], Reply],
        joints: Sequence[JointModel],
        clock: BoardTime,
        reply: BeginReply,
        *,
        smooth: bool,
        fine: bool = False,
        whole: bool = False,
    ) -> None:
        self._unit, self._whole, self._room = _FINE if fine else 1, whole, reply.capacity
        self._ask, self._look, self._rows, self._clock = ask, look, tuple(joints), clock
        self.joints = tuple(joint.name for joint in joints)
        self.capacity, self.lead = reply.capacity, reply.lead_ms / 1000.0
        self._number, self._smooth = reply.id, smooth
        self.request = (MOST_BODY - _POINTS_HEAD) // point_size(len(self._rows), hermite=smooth)
        # Points that the board has, as ticks and angles, from the one of this index on: others cannot be replaced.
        self._oldest = 0
        self._kept: list[tuple[int, tuple[float, ...]]] = []
        # Points behind them, with which it comes to rest if nothing else comes.
        self._rest: tuple[TimedPoint, ...] = ()
        self._started, self._noted = False, 0.0

    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        sent = self._oldest + len(self._kept)
        begin = sent if first is None else first
        if begin != 0 and not self._oldest < begin <= sent:
            raise UsageError(f"the robot has points {self._oldest} to {sent}; none can be sent as number {begin}")
        before = self._kept[begin - self._oldest - 1] if begin else None
        rows, kept = self._rows_of(points, before)
        each, done = _MOST_POINTS, 0
        while done < len(rows):
            # Only what comes after all other points may be a message in fragments, and only if all of it fits.
            fits = self._room if self._whole and begin + done == sent and not self._rest else 0
            most = max(self.request, fits)
            # What comes behind these, if they replace some, is gone as soon as they are there.
            until = kept[min(done + min(each, most), len(rows)) - 1][0]
            fewer = min(each, max(1, most - REST_POINTS))
            stops = rest is not None and (self._soon_dry(until) or len(rows) - done <= fewer)
            stop: tuple[TimedPoint, ...] = ()
            if rest is not None and stops and not (last and len(rows) - done <= fewer):
                stop = tuple(rest(points[min(done + fewer, len(rows)) - 1]))
            if stop:
                most = fewer
            elif rest is not None and not stops:
                # The rest comes with the last of them.
                most = min(most, len(rows) - done - 1)
            some = rows[done : done + min(each, most)]
            place = done + len(some)
            end = last and place == len(rows)
            request = PointsRequest(
                self._number,
                int(end or bool(stop)),
                (begin + done) & 0xFFFF,
                len(some) + len(stop),
                serialize_points([*some, *self._rows_of(stop, kept[place - 1])[0]]),
            ).serialize()
            reply = self._ask(Command.TRAJECTORY_POINTS, request)
            if reply.status == Status.BUSY:
                if len(some) == 1:
                    break
                # Perhaps fewer of them fit.
                each = max(1, min(len(some) // 2, self.report().room - len(stop)))
                continue
            try:
                check_reply(reply)
            except CommandRefusedError as error:
                if not (done and self._started) or isinstance(error, StoppedError):
                    raise
                break
            self._kept[begin + done - self._oldest :] = kept[done:place]
            self._rest = stop
            done = place
            sent = self._oldest + len(self._kept)
            self._note(reply, len(request))
        return done

    def _soon_dry(self, until: int) -> bool:
        """Whether a path up to some ticks must have points to rest, even if it is continued by the next request."""
        if not self._started:
            return False
        left = (until - self._kept[0][0]) * POINT_TIME if self._kept else 0.0
        return left - (self._clock.now() - self._noted) < _PLENTY

    def start(self, at: float | None = None) -> PathStart:
        if not self._clock.relation:
            self.report()
        relation = self._clock.relation
        time_us = 0 if at is None else round(relation.board_time(at) * 1e6) & 0xFFFFFFFF
        body = StartRequest(self._number, int(at is None), time_us).serialize()
        reply = StartReply.parse(check_reply(self._ask(Command.TRAJECTORY_START, body)).body)
        self._started = True
        # The unwrapped time is near that of the last exchange.
        board = self._clock.unwrap(reply.time_us)
        return PathStart(*relation.host_time(board))

    def report(self) -> PathReport:
        reply = check_reply(self._look(Command.TRAJECTORY_STATUS, b""))
        return self._note(reply, 0)

    def _note(self, reply: Reply, request: int) -> PathReport:
        status = PathStatus.parse(reply.body)
        self._room, self._noted = status.free, self._clock.now()
        self._clock.note(reply, request, status.time_us)
        sent = self._oldest + len(self._kept)
        if status.id != self._number or status.state is PathState.NONE:
            # Another program began another one, or the board was reset.
            return PathReport(PathState.NONE, sent, 0, 0, status.late)
        # The board counts modulo 65536.
        total = sent + len(self._rest)
        towards = max(0, total - ((total - status.towards) & 0xFFFF))
        if 0 < towards - 1 - self._oldest <= len(self._kept):
            del self._kept[: towards - 1 - self._oldest]
            self._oldest = towards - 1
        state, stop, room = status.state, None, status.free + len(self._rest)
        if self._rest and state in _ON_ITS_WAY and towards >= sent:
            # Nothing has come in time.
            state = PathState.DRY if state is PathState.DONE else PathState.BRAKING
            stop = self._rest[-1].positions
        return PathReport(state, sent, towards, room, status.late, rest=stop)

    def abort(self) -> PathState:
        reply = check_reply(self._ask(Command.TRAJECTORY_ABORT, bytes((self._number,))))
        return PathState(reply.body[1])

    def _rows_of(
        self, points: Sequence[TimedPoint], before: tuple[int, tuple[float, ...]] | None
    ) -> tuple[list[PathPoint], list[tuple[int, tuple[float, ...]]]]:
        """The points in the units of the wire, and as ticks and angles; checked."""
        rows, kept = [], []
        for point in points:
            self._check_shape(point)
            ticks = round(point.time / POINT_TIME)
            if before is None:
                if ticks != 0:
                    raise UsageError(f"a path begins at 0 s, not at {decimal(point.time, 3)} s")
                way = 0
            else:
                way = ticks - before[0]
                if not 0 < way <= _MOST_TICKS:
                    text = "after it, and at most 6.5 s" if way > 0 else "after the one before"
                    raise UsageError(f"the point at {decimal(point.time, 3)} s must come {text}")
                self._check_speed(point, before[1], way * POINT_TIME)
            rows.append(self._row(point, way))
            before = ticks, point.positions
            kept.append(before)
        return rows, kept

    def _check_shape(self, point: TimedPoint) -> None:
        have = len(point.positions) == len(self._rows)
        if not have or (point.velocities is not None) != self._smooth:
            shape = "positions and velocities" if self._smooth else "positions alone"
            raise UsageError(f"a point of this path has {shape} of {', '.join(self.joints)}")
        for joint, angle in zip(self._rows, point.positions, strict=True):
            joint.check(angle)
        for joint, speed in zip(self._rows, point.velocities or (), strict=False):
            if not abs(speed) <= joint.max_speed:
                fast = decimal(math.degrees(abs(speed)), 3)
                raise LimitError(f"{joint.name} would pass a point at {fast} deg/s, which is above its speed limit")

    def _check_speed(self, point: TimedPoint, before: tuple[float, ...], seconds: float) -> None:
        for joint, a, b in zip(self._rows, before, point.positions, strict=True):
            # One count more, or an eighth, since positions are rounded.
            if abs(b - a) > joint.max_speed * seconds + joint.scale / self._unit:
                way, time = decimal(math.degrees(abs(b - a)), 3), decimal(seconds, 4)
                raise LimitError(f"{joint.name} would turn {way} deg in {time} s, which is above its speed limit")

    def _row(self, point: TimedPoint, ticks: int) -> PathPoint:
        unit = self._unit
        counts = tuple(
            min(max(joint.angle_to_counts(angle, unit), joint.count_limits[0] * unit), joint.count_limits[1] * unit)
            for joint, angle in zip(self._rows, point.positions, strict=True)
        )
        if point.velocities is None:
            return PathPoint(ticks, counts)
        speeds = tuple(
            round(joint.sign * speed / joint.scale)
            for joint, speed in zip(self._rows, point.velocities, strict=True)
        )
        return PathPoint(ticks, counts, tuple(max(-_COUNTS_16, min(_COUNTS_16, speed)) for speed in speeds))


def begin_request(
    number: int, mask: int, brake: float, *, smooth: bool, outlives: bool, fine: bool = False
) -> BeginRequest:
    """The request for a new path; raises UsageError if the braking time is out of range."""
    if not 0.02 <= brake <= 2.0:
        raise UsageError(f"a path comes to rest in 0.02..2 s, not in {brake:g} s")
    wanted = {PathFlag.HERMITE: smooth, PathFlag.OUTLIVES_HOST: outlives, PathFlag.FINE: fine}
    flags = sum(flag for flag, wants in wanted.items() if wants)
    return BeginRequest(number, flags, mask, math.ceil(1000 * brake - 1e-6))
