"""A motion that was recorded, as an arm plays it: the way to where it begins, its checks, and the speed that fits.

Owns what is offered where it is too fast for the limits: nothing is slowed down without being asked. Must not know
who asks, nor files.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError
from hexwire.motion.checks import speed_that_fits

from ..loop.outcomes import Reason
from .motions import check_path
from .via import approached

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.motion.trajectory import Trajectory

    from .motion_options import MotionOptions
    from .path_check import CheckedPath

__all__ = ["check_played", "fits_words"]


def fits_words(factor: float) -> str:
    """That a motion which is too fast keeps the limits at a factor of its speed."""
    return f"it keeps the limits at {factor:g} of its speed"


def check_played(
    robot: RobotDriver,
    make: Callable[[float], Trajectory],
    factor: float,
    here: Mapping[str, float],
    options: MotionOptions,
    *,
    repeat: int = 1,
    speed: float = 0.5,
    fit: bool = False,
    advice: str = "--speed {factor}, or --fit",
) -> CheckedPath:
    """Check a recorded motion, and the way to where it begins; nothing moves.

    Args:
        robot: Attached.
        make: Makes the motion at a factor of its speed.
        factor: The factor that is wanted.
        here: Where all joints are, radians.
        options: As for `check_path`.
        repeat: How often it is played.
        speed: Share of the speed limits on the way to its beginning.
        fit: Play it more slowly if it is too fast, at the largest factor that keeps the limits.
        advice: How a person asks for that.

    Raises:
        GoalError: The path is not allowed; the text says at which factor it is.
        UsageError: As `check_path`.
    """

    def checked(factor: float) -> CheckedPath:
        legs = approached(robot.model, make(factor), here, repeat, speed=speed)
        return check_path(robot, legs, options, start=here)

    try:
        return checked(factor)
    except GoalError as error:
        fits = None
        if error.reason == Reason.PATH_NOT_ALLOWED:
            fits = speed_that_fits(make, robot.model, factor)
        if fits is None or fits == factor:
            raise
        try:
            path = checked(fits)
        except GoalError:
            # Not only its speed is wrong.
            raise error from None
        if fit:
            return replace(path, slowed=f"played at {fits:g} of its speed, at which it keeps the limits")
        why, how = str(error).removesuffix("; nothing was sent"), advice.format(factor=f"{fits:g}")
        raise GoalError(f"{why}; {fits_words(fits)}: {how}; nothing was sent", reason=error.reason) from None
