"""Which of the arms that can be emulated in this program can play a recording.

Must not know how one is emulated (`twin`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.drivers.registry import load_driver
from hexwire.model.arms import simulated_arms

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["model_of", "twin_for"]


def twin_for(robot: str, joints: Sequence[str]) -> str:
    """The emulated arm that can play a recording; empty if there is none."""
    if robot in simulated_arms():
        return robot
    return next((name for name in simulated_arms() if joints and set(joints) <= set(model_of(name).names)), "")


@functools.cache
def model_of(robot: str) -> ArmModel:
    """The joints of an arm that can be emulated."""
    return load_driver(robot).from_url(f"sim://{robot}").model
