"""Kinematics of an arm by the robot's name and the name or file of its link set.

Owns which robots have a geometry, and is the one place of this room that reads a file: a link set that people
wrote. Must not know drivers, nor what is done with a model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.inputs import read_text

if TYPE_CHECKING:
    from .kinematics import KinematicModel

__all__ = ["ROBOTS", "kinematics_or_none", "make_kinematics"]

ROBOTS = ("hex7bot", "puma260")
"""Robots that have a geometry."""


def make_kinematics(robot: str, links: str = "A", *, for_motion: bool = False) -> KinematicModel:
    """Kinematics of a robot by name.

    Args:
        robot: One of `ROBOTS`.
        links: Link set of the 7Bot: a published one by name, or the path of a TOML file. Of no account for others.
        for_motion: With limits that the robot's joints allow as well, where the two differ.

    Raises:
        UsageError: No such robot or link set, or the link set's file cannot be read or has a mistake.
    """
    if robot == "puma260":
        from .puma260 import Puma260Model

        return Puma260Model()
    if robot != "hex7bot":
        raise UsageError(f"no geometry is known for robot {robot!r}; choose one of {', '.join(ROBOTS)}")
    from .hex7bot_kinematics import Hex7BotModel
    from .hex7bot_links import link_set, parse_link_set

    if links.lower().endswith(".toml") or "/" in links:
        model = Hex7BotModel(parse_link_set(read_text(links), file=links))
    else:
        model = Hex7BotModel(link_set(links))
    return model.within_arm() if for_motion else model


def kinematics_or_none(robot: str, links: str = "A", *, for_motion: bool = False) -> KinematicModel | None:
    """As `make_kinematics`, but None for a robot without a geometry."""
    return make_kinematics(robot, links, for_motion=for_motion) if robot in ROBOTS else None
