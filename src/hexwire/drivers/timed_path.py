"""`TimedPath`: a motion that the robot executes in its own time, sent ahead point by point.

Owns its values and its interface. Must not know boards, frames or counts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hexwire.wire.board_trajectory import PathState

__all__ = ["REST_POINTS", "PathReport", "PathStart", "PathState", "TimedPath", "TimedPoint"]

REST_POINTS = 3
"""Most points that bring the joints to rest if nothing else is sent."""


class TimedPoint(NamedTuple):
    """A point of a path.

    Attributes:
        time: Seconds since the start of the path; 0 for the first point.
        positions: Radians, of the joints of the path in its order.
        velocities: Radians per second, of the same; None on a path that is straight between its points.
    """

    time: float
    positions: tuple[float, ...]
    velocities: tuple[float, ...] | None = None


class PathStart(NamedTuple):
    """When a path starts.

    Attributes:
        time: Host's clock, seconds.
        uncertainty: How far off that may be, seconds.
    """

    time: float
    uncertainty: float


class PathReport(NamedTuple):
    """Where a path is.

    Attributes:
        state: Of the path.
        sent: Points that the robot has received.
        towards: Index of the point towards which the joints move.
        room: Points that it can take now.
        late: Times that the robot's own targets came late, counted modulo 65536.
        why: Why it ended, in words, if the robot says more than the state.
        rest: Where the joints come to rest, radians, if that is not on the path: on points that were sent for the
            case that no further ones come. The state is `BRAKING` then, and `DRY` when they are there.
    """

    state: PathState
    sent: int
    towards: int
    room: int
    late: int
    why: str = ""
    rest: tuple[float, ...] | None = None


class TimedPath(ABC):
    """A path that was begun. Nothing moves before `start`.

    A stop ends it, and it is never continued; begin another one. If this program stalls, the robot goes on while it
    has points; then it comes to rest on the path.

    Attributes:
        joints: Names, in the order of every point.
        capacity: Points that the robot can hold.
        request: Points of one request that replaces others, at most, with those to rest.
        lead: Seconds by which its targets are ahead of its clock.
    """

    joints: tuple[str, ...]
    capacity: int
    request: int
    lead: float

    @abstractmethod
    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        """Send the next points, as many as the robot has room for.

        Args:
            points: In order; times increase.
            last: The last of them ends the path. Counts only if all are taken.
            first: Index of the first of them: points from there on are replaced. The next one if None.
            rest: If `last` is not set: at most `REST_POINTS` points that bring the joints to rest after one of
                these; empty if there are none. They count as no points of the path: what is sent next replaces
                them, and if nothing is, the path ends with them.

        Returns:
            How many were taken; send the others later.

        Raises:
            LimitError: A point is beyond a joint's limits, or too far from the one before; nothing was sent.
            StoppedError: A stop ended the path.
            CommandRefusedError: The path has ended, or the robot refuses the points. If it refuses later ones of a
                path that was started, the next call says so.
        """

    @abstractmethod
    def start(self, at: float | None = None) -> PathStart:
        """Start the path.

        Args:
            at: Host's clock, seconds; less than 10 s ahead. Now if None.

        Raises:
            StoppedError: A stop ended the path.
            CommandRefusedError: A joint has no torque, or is not at the first point; or there is not enough of
                the path; or the time has passed.
        """

    @abstractmethod
    def report(self) -> PathReport:
        """Ask where the path is."""

    @abstractmethod
    def abort(self) -> PathState:
        """Bring the joints to rest on the path; without effect after its end. Returns the state then."""
