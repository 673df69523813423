"""The trajectory of an emulated board: its commands, its state, and the targets that it sends in its own time.

Owns the life of a trajectory as in PROTOCOL.md section 6.7, from the start to each of its ends, and the checks and
answers of its five commands. Its geometry is in `board_path`. Knows no frames; what is due goes to the servos as a
job of the board.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

from hexwire.wire.board_trajectory import (
    POINTS_HEAD_SIZE,
    BeginReply,
    BeginRequest,
    PathFlag,
    PathState,
    PathStatus,
    PointsRequest,
    StartReply,
    StartRequest,
    parse_points,
    point_size,
)
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import LimitRow
from hexwire.wire.registers import Series

from .board_bus import BoardBus, Clock, Job, Wait
from .board_orders import BoardOrders
from .board_path import BoardPath
from .board_state import BoardState, JointSlot
from .gate import RefusedError

__all__ = ["LEAD_MS", "BoardTrajectory", "PointsMessage", "TrajectoryCommands"]

LEAD_MS = 24
_LEAD = LEAD_MS / 1000
_PERIOD = 0.009
"""Seconds between two targets, if the polling cycle is over by then or there is none."""
_LONGEST = 0.011
"""Seconds after which targets go ahead of the polling cycle. A sync read on the line takes 8 ms more, and 13 ms
if a servo is silent."""
_NEAR = 64
"""Counts that a joint may be away from point 0 at the start."""
_GRACE = 0.150
"""Seconds in which a joint that missed an answer may give one."""
_ACTIVE = (PathState.RUNNING, PathState.BRAKING)
_COUNTER = 0xFFFF


class BoardTrajectory:
    """The one trajectory of a board.

    Args:
        state: What the board knows.
        bus: Its servos.
        clock: The board's time.

    Attributes:
        number: Its id.
        state: Its state, as of the last `update`.
        mask: Its joints, by index.
        joints: The same.
        path: Its path; None if there was none since the reset.
        start_at: The board's time at which it starts or has started.
        late: How often a target was sent later than `LEAD_MS` after the one before.
    """

    def __init__(self, state: BoardState, bus: BoardBus, clock: Clock) -> None:
        self.number = 0
        self.state = PathState.NONE
        self.mask = 0
        self.joints: list[JointSlot] = []
        self.path: BoardPath | None = None
        self.start_at = 0.0
        self.late = 0
        self._board = state
        self._bus = bus
        self._clock = clock
        self._orders = BoardOrders(state, bus, clock)
        self._flags = PathFlag(0)
        self._end = PathState.DONE
        self._lost: set[int] = set()
        self._doubtful_since: dict[int, float] = {}
        self._sent_at: float | None = None
        self._sent_up_to = 0.0
        self._next_at = 0.0
        self._cycle = 0

    @property
    def active(self) -> bool:
        """Whether it runs or brakes."""
        return self.state in _ACTIVE

    @property
    def outlives_host(self) -> bool:
        """Whether the watchdog lets it finish."""
        wanted = self.active and bool(self._flags & PathFlag.OUTLIVES_HOST)
        return wanted and self.path is not None and self.path.whole

    @property
    def due_at(self) -> float | None:
        """When `step` is due; None if never."""
        if self.state is PathState.WAITING:
            return self.start_at
        if not self.active:
            return None
        return self._next_at if self._bus.cycles == self._cycle else min(self._next_at, self._earliest)

    @property
    def _earliest(self) -> float:
        return self._next_at - _LONGEST + _PERIOD

    def due(self, now: float) -> bool:
        """Whether `step` is due."""
        due_at = self.due_at
        return due_at is not None and due_at <= now

    # -- orders -------------------------------------------------------------------------------------

    def begin(self, request: BeginRequest) -> BoardPath:
        """Replace a trajectory that has not started or is over; nothing moves."""
        self.number, self.mask, self._flags = request.id, request.mask, PathFlag(request.flags)
        self.joints = [j for i, j in enumerate(self._board.joints) if request.mask >> i & 1]
        hermite, fine = bool(self._flags & PathFlag.HERMITE), bool(self._flags & PathFlag.FINE)
        self.path = BoardPath(len(self.joints), hermite=hermite, brake=request.brake_ms / 1000, fine=fine)
        self.late = 0
        self.state = PathState.LOADING
        return self.path

    def check_joints(self) -> None:
        """Check that all joints can start.

        Raises:
            RefusedError: One cannot.
        """
        joints, path = self.joints, self.path
        assert path is not None
        if any(j.present and not j.torque_on for j in joints):
            raise RefusedError(Status.TORQUE_OFF)
        if any(not j.present or j.unsure or j.sampled_at is None for j in joints):
            raise RefusedError(Status.SERVO_SILENT)
        if any(j.mode for j in joints):
            raise RefusedError(Status.SERVO_FAULT)
        if any(abs(j.position - p) > _NEAR for j, p in zip(joints, path.first_positions, strict=True)):
            raise RefusedError(Status.BAD_RANGE)

    def schedule(self, start_at: float) -> None:
        """Start at this time of the board."""
        self.start_at = start_at
        self.state = PathState.WAITING

    def run(self) -> None:
        """Start; the joints were checked."""
        assert self.path is not None
        self.path.start(self.start_at)
        self.state, self._end = PathState.RUNNING, PathState.DONE
        self._lost.clear()
        self._doubtful_since.clear()
        self._sent_at, self._sent_up_to, self._next_at = None, self.start_at, self.start_at
        for joint in self.joints:
            joint.following = True

    def abort(self) -> None:
        """Come to rest on the path; one that has not started ends at once."""
        if self.state in (PathState.LOADING, PathState.WAITING):
            self._finish(PathState.ABORTED)
        elif self.state is PathState.RUNNING:
            self._brake(PathState.ABORTED)

    def stop(self) -> None:
        """A STOP arrived, or the watchdog tripped."""
        if self.state is not PathState.NONE and not self.state.over:
            self._finish(PathState.STOPPED)

    # -- time ---------------------------------------------------------------------------------------

    def update(self) -> None:
        """Note what has happened to it up to now."""
        path, now = self.path, self._clock()
        if path is None or not self.active:
            return
        path.advance(now + _LEAD)
        if path.braking and self.state is PathState.RUNNING:
            self.state, self._end = PathState.BRAKING, PathState.DRY
        self._watch_joints(now)
        rest_at = path.rest_at
        if not self.state.over and rest_at is not None and rest_at <= now and rest_at <= self._sent_up_to:
            self._finish(self._end)

    def step(self) -> Job:
        """Do what is due: start, or send the next targets."""
        if self.state is PathState.WAITING:
            yield from self._orders.look_at(self.joints)
            self._check_and_run()
        elif self.active:
            yield from self._bus.refresh()
        self.update()
        if not self.active:
            return
        now = self._clock()
        if self._sent_at is not None and now - self._sent_at > _LEAD:
            self.late = min(self.late + 1, _COUNTER)
        self._sent_at, self._next_at, self._cycle = now, now + _LONGEST, self._bus.cycles
        for legacy in (True, False):
            yield from self._send(legacy=legacy)
            if self.state.over:
                return
        self._sent_up_to = now + _LEAD

    def _check_and_run(self) -> None:
        """The moment of the start has come."""
        try:
            if self._board.maintenance:
                raise RefusedError(Status.FORBIDDEN)
            if self.path is None or not self.path.can_start:
                raise RefusedError(Status.BAD_RANGE)
            self.check_joints()
        except RefusedError:
            self._finish(PathState.FAULT)
        else:
            self.run()

    def _send(self, *, legacy: bool) -> Job:
        """Send the targets of the moment to all joints of one kind that certainly have torque."""
        assert self.path is not None
        places = zip(self.joints, self.path.positions(self._clock() + _LEAD), strict=True)
        targets = [(j, self._orders.clamp(j, place)) for j, place in places if self._takes_targets(j)]
        duration = max(LEAD_MS, self._orders.slowest(targets))
        group = [(j, p) for j, p in targets if (j.series is Series.SEVEN_BOT) == legacy]
        if group:
            yield from self._bus.move(group, duration)

    # -- joints -------------------------------------------------------------------------------------

    def _takes_targets(self, joint: JointSlot) -> bool:
        return joint.servo_id not in self._lost and self._is_certain(joint)

    @staticmethod
    def _is_certain(joint: JointSlot) -> bool:
        """Whether a joint answers, has torque and is in position mode, read since anything may have changed it."""
        return joint.present and joint.torque_on and not joint.unsure and not joint.mode

    def _watch_joints(self, now: float) -> None:
        """Leave out joints that lost their torque or are silent, and brake."""
        for joint in self.joints:
            if joint.servo_id in self._lost:
                continue
            if self._is_certain(joint):
                self._doubtful_since.pop(joint.servo_id, None)
            elif not joint.torque_on or now - self._doubtful_since.setdefault(joint.servo_id, now) >= _GRACE:
                self._lost.add(joint.servo_id)
        if self._lost:
            self._brake(PathState.FAULT)
        if len(self._lost) == len(self.joints):
            self._finish(PathState.FAULT)

    # -- ends ---------------------------------------------------------------------------------------

    def _brake(self, end: PathState) -> None:
        """Brake, with this state at the end; the first cause counts, except that a fault is always told."""
        assert self.path is not None
        if self.state is PathState.RUNNING or end is PathState.FAULT:
            self._end = end
        self.state = PathState.BRAKING
        self.path.brake(self._clock() + _LEAD)

    def _finish(self, state: PathState) -> None:
        self.state = state
        for joint in self.joints:
            joint.following = False


_BRAKE_MS = range(20, 2001)
_FLAGS = sum(PathFlag)
_INDEX = 0xFFFF
_CLOCK = 1 << 32
_FARTHEST_US = 10_000_000
_LOADS = (PathState.LOADING, PathState.WAITING, PathState.RUNNING)
_STARTS = (PathState.LOADING, PathState.WAITING)

Answer = Generator[Wait, bytes | None, bytes]


class TrajectoryCommands:
    """The commands of one board's trajectory.

    Each takes the body of the request and returns that of the answer. It raises `RefusedError`, or
    `RemoteProtocolError` for a wrong length.

    Args:
        state: What the board knows.
        trajectory: Its trajectory.
        orders: Orders to its servos.
        clock: The board's time.
    """

    def __init__(self, state: BoardState, trajectory: BoardTrajectory, orders: BoardOrders, clock: Clock) -> None:
        self._board = state
        self._trajectory = trajectory
        self._orders = orders
        self._clock = clock
        self.handlers: dict[int, Callable[[bytes], Answer]] = {
            Command.TRAJECTORY_BEGIN: self._begin,
            Command.TRAJECTORY_POINTS: self._points,
            Command.TRAJECTORY_START: self._start,
            Command.TRAJECTORY_STATUS: self._status,
            Command.TRAJECTORY_ABORT: self._abort,
        }

    def _begin(self, body: bytes) -> Answer:
        request = BeginRequest.parse(body)
        sound = request.mask and not request.mask >> len(self._board.joints)
        if not sound or request.flags & ~_FLAGS or request.brake_ms not in _BRAKE_MS:
            raise RefusedError(Status.BAD_RANGE)
        self._orders.refuse_motion()
        trajectory = self._trajectory
        trajectory.update()
        if trajectory.active:
            raise RefusedError(Status.BUSY)
        path = trajectory.begin(request)
        yield from ()
        return BeginReply(trajectory.number, trajectory.state, path.capacity, LEAD_MS).serialize()

    def _points(self, body: bytes) -> Answer:
        request = PointsRequest.parse(body)
        path = self.check_points(request)
        trajectory = self._trajectory
        joints = len(trajectory.joints)
        if not request.count or len(request.data) != request.count * point_size(joints, hermite=path.hermite):
            raise RefusedError(Status.BAD_LENGTH)
        self.check_loads()
        points = parse_points(request.data, joints, hermite=path.hermite)
        path.put(request.first, points, self.limits(), last=request.last == 1)
        trajectory.update()
        yield from ()
        return self.report()

    def check_points(self, request: PointsRequest) -> BoardPath:
        """Check the fixed part of POINTS; returns the path.

        Raises:
            RefusedError: It is refused.
        """
        path = self._path_of(request.id)
        if request.last > 1:
            raise RefusedError(Status.BAD_RANGE)
        self._orders.refuse_if_stopped()
        self._trajectory.update()
        return path

    def check_loads(self) -> None:
        """Check that the trajectory takes points.

        Raises:
            RefusedError: It does not.
        """
        self._trajectory.update()
        if self._trajectory.state not in _LOADS:
            raise RefusedError(Status.BAD_RANGE)

    def limits(self) -> list[LimitRow]:
        """Limits of the joints of the trajectory."""
        return [limit for i, limit in enumerate(self._board.limits) if self._trajectory.mask >> i & 1]

    def points_message(self) -> PointsMessage:
        """A taker of points that come in fragments."""
        return PointsMessage(self, self._trajectory)

    def _start(self, body: bytes) -> Answer:
        request = StartRequest.parse(body)
        trajectory = self._trajectory
        self._path_of(request.id)
        if request.now > 1:
            raise RefusedError(Status.BAD_RANGE)
        self._orders.refuse_motion()
        self._check_start(request)
        yield from self._orders.look_at(trajectory.joints)
        # Looking took time.
        start_at = self._check_start(request)
        trajectory.check_joints()
        trajectory.schedule(start_at)
        time_us = self._board.clock_us(start_at) if request.now else request.time_us
        return StartReply(trajectory.number, trajectory.state, time_us).serialize()

    def _check_start(self, request: StartRequest) -> float:
        """The board's time of the start, if there is something to start.

        Raises:
            RefusedError: There is not, or the time is wrong.
        """
        trajectory = self._trajectory
        trajectory.update()
        if trajectory.state not in _STARTS or not self._path_of(request.id).can_start:
            raise RefusedError(Status.BAD_RANGE)
        now = self._clock()
        if request.now:
            return now
        ahead = (request.time_us - self._board.clock_us(now)) % _CLOCK
        if ahead >= _FARTHEST_US:
            raise RefusedError(Status.BAD_RANGE)
        return now + ahead / 1e6

    def _status(self, body: bytes) -> Answer:
        if body:
            raise RefusedError(Status.BAD_LENGTH)
        self._trajectory.update()
        yield from ()
        return self.report()

    def _abort(self, body: bytes) -> Answer:
        if len(body) != 1:
            raise RefusedError(Status.BAD_LENGTH)
        self._path_of(body[0])
        trajectory = self._trajectory
        trajectory.update()
        trajectory.abort()
        yield from ()
        return bytes((trajectory.number, trajectory.state))

    def _path_of(self, number: int) -> BoardPath:
        """The path of the trajectory, if it is the one that is meant.

        Raises:
            RefusedError: It has another id, or there is none.
        """
        path = self._trajectory.path
        if path is None or number != self._trajectory.number:
            raise RefusedError(Status.BAD_RANGE)
        return path

    def report(self) -> bytes:
        """The body of STATUS and of the answer to POINTS."""
        trajectory = self._trajectory
        path = trajectory.path
        time_us = self._board.clock_us(self._clock())
        if path is None:
            return PathStatus(0, PathState.NONE, 0, 0, 0, 0, time_us).serialize()
        counts = (path.next & _INDEX, path.towards & _INDEX, path.free, trajectory.late)
        return PathStatus(trajectory.number, trajectory.state, *counts, time_us).serialize()


class PointsMessage:
    """A TRAJECTORY_POINTS that comes in pieces: points are checked as they come, and count when all are there.

    Args:
        commands: The commands of the trajectory.
        trajectory: The trajectory.
    """

    head_size = POINTS_HEAD_SIZE

    def __init__(self, commands: TrajectoryCommands, trajectory: BoardTrajectory) -> None:
        self._commands = commands
        self._trajectory = trajectory
        self._path: BoardPath | None = None
        self._last = False
        self._rest = b""

    def begin(self, head: bytes, check_length: Callable[[int], None]) -> None:
        """Check the fixed part; `check_length` gets the length of the whole body.

        Raises:
            RefusedError: It is refused.
        """
        request = PointsRequest.parse(head)
        path = self._commands.check_points(request)
        if not request.count:
            raise RefusedError(Status.BAD_LENGTH)
        check_length(POINTS_HEAD_SIZE + request.count * self._size(path))
        self._commands.check_loads()
        path.begin_coming(request.first, request.count)
        self._path, self._last = path, request.last == 1

    def take(self, data: bytes) -> Job:
        """Check the points that are complete.

        Raises:
            RefusedError: One is refused, or the trajectory takes none any more.
        """
        path = self._path
        assert path is not None
        self._commands.check_loads()
        data = self._rest + data
        size = self._size(path)
        whole = len(data) // size * size
        self._rest = data[whole:]
        path.come(
            parse_points(data[:whole], len(self._trajectory.joints), hermite=path.hermite), self._commands.limits()
        )
        yield from ()

    def finish(self) -> bytes:
        """Count them all; returns the body of the reply."""
        assert self._path is not None
        self._path.end_coming(last=self._last)
        self._trajectory.update()
        return self._commands.report()

    def drop(self) -> None:
        """Forget what has come."""
        if self._path is not None:
            self._path.drop_coming()

    def _size(self, path: BoardPath) -> int:
        return point_size(len(self._trajectory.joints), hermite=path.hermite)
