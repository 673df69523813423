"""At most one owner of a robot in a program: two would send targets in turn and disarm each other's watchdog.

Owns the record of robots and their owners. Must not know what an owner does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver


__all__ = ["claim", "release"]

# By the robot's `id`, which stays the robot's as long as its owner exists, since the owner refers to it.
_owners: WeakValueDictionary[int, object] = WeakValueDictionary()


def claim(robot: RobotDriver, owner: object) -> None:
    """Make this the owner of a robot.

    Raises:
        UsageError: Another owner has it.
    """
    if _owners.setdefault(id(robot), owner) is not owner:
        raise UsageError("the robot is already in motion for another caller; wait until that ends, or stop it")


def release(robot: RobotDriver, owner: object) -> None:
    """Give a robot up; without effect if another owner has it."""
    if _owners.get(id(robot)) is owner:
        del _owners[id(robot)]
