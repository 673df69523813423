"""The commands for a trajectory on an emulated board: what is refused, and the bodies of the answers.

Owns checks and answers of the five commands of PROTOCOL.md section 6.7. Knows no frames; the trajectory itself is
in `board_trajectory`.
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

from .board_jobs import Clock, Job, Wait
from .board_orders import BoardOrders
from .board_path import BoardPath
from .board_state import BoardState
from .board_trajectory import LEAD_MS, Trajectory
from .gate import RefusedError

__all__ = ["PointsMessage", "TrajectoryCommands"]

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

    def __init__(self, state: BoardState, trajectory: Trajectory, orders: BoardOrders, clock: Clock) -> None:
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

    def __init__(self, commands: TrajectoryCommands, trajectory: Trajectory) -> None:
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
