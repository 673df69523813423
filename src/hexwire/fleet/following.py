"""Trajectories that the server of a shared arm follows for a client: sent with a start time, watched, ended.

Owns the conversion of the start time to the owner's clock. Must not know how an order proves its right.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from hexwire.arguments import FLAG, SECONDS, WHOLE, Wanted, one_of
from hexwire.errors import NotSupportedError, RemoteProtocolError, UsageError
from hexwire.motion.waypoints import Spline

from . import messages as m
from .clock import ClockOffset
from .goal_path import GoalPath
from .questions import decoded
from .trajectories import follow_message

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["Following"]


class Following(ABC):
    """The part of a `RemoteRobot` that follows trajectories."""

    _arguments: ClassVar[dict[str, dict[str, Wanted]]] = {
        "follow": {"path": one_of(Spline), "start": SECONDS, "anywhere": FLAG, "confirm": FLAG},
        "check_path": {"path": one_of(Spline)},
        "goal": {"number": WHOLE},
        "confirm": {"number": WHOLE},
        "cancel": {"number": WHOLE},
    }
    _clock: ClockOffset
    _facts: m.Facts
    model: ArmModel

    @abstractmethod
    def _order(self, what: str, order: m.Order, *, freeing: bool = False, slow: bool = False) -> Any:
        """Send an order; returns the value of its answer."""

    @abstractmethod
    def _asked(self, question: m.Ask) -> m.Answer:
        """The answer to a question that is answered at once."""

    def follow(self, path: Spline, start: float, *, anywhere: bool = False, confirm: bool = False) -> int:
        """Have the arm's server follow a trajectory from a time on, so that the network cannot disturb it.

        The server checks it, and refuses one that cannot begin in time. It ends, and the joints hold, when this
        program loses the lease.

        Args:
            path: Begins where the joints are.
            start: When it begins, seconds of this program's monotonic clock.
            anywhere: Lead the joints from where they are to its second point, and not only from its first one.
            confirm: It begins only if `confirm` is called before the start (see `control.shared_goals.CONFIRM`).

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

    @property
    def times_motion(self) -> bool:
        """Whether the arm's board keeps the time, so that neither its server nor this program disturbs a motion."""
        return self._facts.times_motion

    @property
    def refills_paths(self) -> bool:
        """The server takes a trajectory whole."""
        return False

    def path(
        self,
        joints: Sequence[str] | None = None,
        *,
        smooth: bool = True,
        brake: float | None = None,
        outlives: bool = False,
    ) -> GoalPath:
        """Begin a path that the arm's server follows; see `RobotDriver.path`. The braking time is the server's.

        Raises:
            NotSupportedError: The arm's board keeps no time.
            UsageError: `outlives` is asked for: a motion ends with the lease.
        """
        if not self.times_motion:
            raise NotSupportedError(f"{self.model.name} follows no path in its own time")
        if outlives:
            raise UsageError("a motion of a shared arm does not go on without the program that began it")
        names = self.model.names if joints is None else [self.model.joint(name).name for name in joints]
        return GoalPath(self, names)

    @property
    @abstractmethod
    def clock_offset(self) -> tuple[float, float]:
        """Offset of the owner's clock, and its uncertainty, seconds."""

    def check_path(self, path: Spline) -> None:
        """Have the arm's server check a trajectory from its first point on; nothing moves. Needs the lease.

        Raises:
            GoalError: It is not allowed.
        """
        self._order("the check of a trajectory", follow_message(path, check=True), slow=True)

    def goal(self, number: int) -> m.Goal:
        """What became of a trajectory; times are of the owner's clock (see `clock_offset`)."""
        row: m.Goal = decoded(self._asked(m.Ask("goal", number)), m.Goal)
        return row

    def confirm(self, number: int) -> None:
        """Let a trajectory begin that waits for it.

        Raises:
            GoalError: It will not begin: it is not ready, has ended, or it is too late.
        """
        self._order("the start of a trajectory", m.Confirm(number))

    def cancel(self, number: int) -> None:
        """End a trajectory, before or after its start; the joints hold."""
        self._order("the end of a trajectory", m.Cancel(number))
