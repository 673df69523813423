"""When a path of a robot starts: the order, and its correction while the path waits.

Owns the time that was meant and the one that the robot keeps. Must not know what the path is.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.errors import CommandRefusedError, StoppedError

if TYPE_CHECKING:
    from hexwire.drivers.timed_path import PathStart, TimedPath
    from hexwire.motion.waypoints import Trajectory

__all__ = ["SOON", "StartOrder", "first_start"]

_log = logging.getLogger(__name__)

SOON = 0.005
"""Seconds: a start that is nearer than this is ordered as one at once."""
_AIM = 0.05
"""Seconds before a start until which its time may still be corrected."""
_LATER = (0.1, 0.2, 0.4)
"""Seconds from now to a start that is tried after one whose time has passed."""
_UNSURE = 0.02
"""Seconds before a start in which it may have passed on the robot's clock, which is known to some milliseconds."""


class StartOrder:
    """The start of one path after the other.

    Args:
        clock: Host's clock, seconds.

    Attributes:
        given: When the robot starts or has started; None if it has no path.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._wanted = clock, 0.0
        self.given: PathStart | None = None

    def give(self, path: TimedPath, begins: float) -> float:
        """Order a start, as `TimedPath.start`; returns by how many seconds the robot is later than meant.

        If its time has passed when the robot gets the order, a later one is tried, a few times.
        """
        self._wanted = begins
        for later in _LATER:
            at_once = self._wanted - self._clock() <= SOON
            try:
                return self._order(path, at_once=at_once) - begins
            except StoppedError:
                raise
            except CommandRefusedError as error:
                now = self._clock()
                if at_once or self._wanted - now > _UNSURE:
                    raise
                _log.warning("an order to start came too late (%s); the robot starts in %g s", error, later)
                self._wanted = now + later
        return self._order(path, at_once=False) - begins

    def _order(self, path: TimedPath, *, at_once: bool) -> float:
        self.given = path.start(None if at_once else self._wanted)
        return self.given.time

    def correct(self, path: TimedPath) -> float:
        """Order the start again: the longer the clocks have been compared, the better its time is known.

        Returns:
            By how much the robot is later than after the order before, seconds.

        Raises:
            StoppedError: A stop ended the path.
        """
        before = self.given
        if before is None or self._wanted - self._clock() < _AIM:
            return 0.0
        try:
            self.given = path.start(self._wanted)
        except StoppedError:
            raise
        except CommandRefusedError as error:
            # Such as after a stall: the order before holds.
            _log.debug("the start is not corrected: %s", error)
            return 0.0
        return self.given.time - before.time


def first_start(planned: Sequence[tuple[Trajectory, float]]) -> float:
    """When the first motion of a plan begins that is not over when the next one does.

    Args:
        planned: At least one motion, and when it begins, seconds.
    """
    *before, (_, begins) = planned
    return min([begins, *(began for path, began in before if began + path.duration > begins + SOON)])
