"""Kinematics and shapes of an arm by the robot's name, and by the name or file of its link set.

Owns how a record of `hexwire.model.arms` becomes a model for motion. Must not know drivers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.errors import UsageError

from .arms import arm_with_geometry, record_of

if TYPE_CHECKING:
    from .arm import ArmModel
    from .kinematics import KinematicModel
    from .shapes import ArmShapes

__all__ = ["kinematics_for", "kinematics_or_none", "make_kinematics", "make_shapes"]


def make_kinematics(robot: str, links: str = "A", *, for_motion: bool = False) -> KinematicModel:
    """Kinematics of a robot by name.

    Args:
        robot: One of `hexwire.model.arms.arms_with_geometry`.
        links: Link set of the 7Bot: the name of a published one, or the path of a TOML file. Ignored for others.
        for_motion: Restrict the limits to those of the robot's joints, if they differ.

    Raises:
        UsageError: No such robot or link set, or the link set's file cannot be read or contains an error.
    """
    make = arm_with_geometry(robot).kinematics
    assert make is not None
    model = make(links)
    return model.within_arm() if for_motion else model


def kinematics_or_none(robot: str, links: str = "A", *, for_motion: bool = False) -> KinematicModel | None:
    """As `make_kinematics`, but None for a robot without a geometry."""
    record = record_of(robot)
    if record is None or record.kinematics is None:
        return None
    return make_kinematics(robot, links, for_motion=for_motion)


def kinematics_for(arm: ArmModel, links: str = "A") -> KinematicModel | None:
    """Kinematics to move an arm, with the limits of its joints; None for an arm without a geometry.

    Args:
        arm: The arm, for example one with a calibration of its own.
        links: As in `make_kinematics`.

    Raises:
        UsageError: As `make_kinematics`.
    """
    model = kinematics_or_none(arm.kind, links, for_motion=True)
    return None if model is None else model.for_arm(arm)


def make_shapes(model: KinematicModel) -> ArmShapes:
    """What the arm of a model looks like.

    Raises:
        UsageError: There are no shapes for this model.
    """
    record = record_of(model.name)
    if record is None or record.shapes is None:
        raise UsageError(f"no shapes are known for {model.name}")
    return record.shapes(model)
