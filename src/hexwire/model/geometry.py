"""Kinematics of an arm by the robot's name and the name or file of its link set, and its shapes.

Owns the list of robots with a geometry, and is the only module of this package that reads a file: a user's link
set. Must not know drivers, nor how a model is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.inputs import read_text

if TYPE_CHECKING:
    from .arm import ArmModel
    from .kinematics import KinematicModel
    from .shapes import ArmShapes

__all__ = ["ROBOTS", "kinematics_for", "kinematics_or_none", "make_kinematics", "make_shapes"]

ROBOTS = ("hex7bot", "puma260", "so100", "so101")
"""Robots that have a geometry."""


def make_kinematics(robot: str, links: str = "A", *, for_motion: bool = False) -> KinematicModel:
    """Kinematics of a robot by name.

    Args:
        robot: One of `ROBOTS`.
        links: Link set of the 7Bot: the name of a published one, or the path of a TOML file. Ignored for others.
        for_motion: Restrict the limits to those of the robot's joints, if they differ.

    Raises:
        UsageError: No such robot or link set, or the link set's file cannot be read or contains an error.
    """
    if robot == "puma260":
        from .puma260 import Puma260Model

        return Puma260Model()
    if robot in {"so100", "so101"}:
        from .so_arm import SoArmModel
        from .so_arm_links import so_arm_links

        return SoArmModel(so_arm_links(robot))
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


def kinematics_for(arm: ArmModel, links: str = "A") -> KinematicModel | None:
    """Kinematics to move an arm, with the limits of its joints; None for an arm without a geometry.

    Args:
        arm: The arm, for example one with a calibration of its own.
        links: As in `make_kinematics`.

    Raises:
        UsageError: As `make_kinematics`.
    """
    model = kinematics_or_none(arm.geometry or arm.name, links, for_motion=True)
    return None if model is None else model.for_arm(arm)


def make_shapes(model: KinematicModel) -> ArmShapes:
    """What the arm of a model looks like.

    Raises:
        UsageError: There are no shapes for this model.
    """
    from .hex7bot_kinematics import Hex7BotModel
    from .puma260 import Puma260Model
    from .so_arm import SoArmModel

    if isinstance(model, Hex7BotModel):
        from .hex7bot_shapes import make_hex7bot_shapes

        return make_hex7bot_shapes(model)
    if isinstance(model, SoArmModel):
        from .so_arm_shapes import make_so_arm_shapes

        return make_so_arm_shapes(model)
    if isinstance(model, Puma260Model):
        from .puma260_shapes import make_puma260_shapes

        return make_puma260_shapes()
    raise UsageError(f"no shapes are known for {model.name}")
