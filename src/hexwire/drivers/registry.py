"""Robots by name, found through the entry-point group ``hexwire.robots``.

Owns the lookup. A package that adds a robot names its `RobotDriver` class there; nothing here lists robots.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from hexwire.errors import UsageError

from .base import RobotDriver

__all__ = ["load_driver", "robot_names"]

_GROUP = "hexwire.robots"


def robot_names() -> tuple[str, ...]:
    """Names of the robots that are installed, in order."""
    return tuple(sorted({point.name for point in entry_points(group=_GROUP)}))


def load_driver(name: str) -> type[RobotDriver]:
    """The driver class of a robot.

    Raises:
        UsageError: No such robot is installed; the text lists those that are.
    """
    for point in entry_points(group=_GROUP):
        if point.name == name:
            driver = point.load()
            if not (isinstance(driver, type) and issubclass(driver, RobotDriver)):
                raise UsageError(f"entry point {point.value!r} of robot {name!r} is no RobotDriver class")
            return driver
    raise UsageError(f"no robot {name!r}; installed are {', '.join(robot_names()) or 'none'}")
