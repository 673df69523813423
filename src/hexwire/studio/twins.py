"""Which arms can be emulated in this program, and which of them can play a recording.

Owns the list. Must not know how one is emulated (`twin`).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.drivers.registry import load_driver

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["TWINS", "model_of", "twin_for"]

TWINS = ("hex7bot", "so101", "so100")
"""Arms that can be emulated in this program."""


def twin_for(robot: str, joints: Sequence[str]) -> str:
    """The emulated arm that can play a recording; empty if there is none."""
    if robot in TWINS:
        return robot
    return next((name for name in TWINS if joints and set(joints) <= set(model_of(name).names)), "")


@functools.cache
def model_of(robot: str) -> ArmModel:
    """The joints of an arm that can be emulated."""
    return load_driver(robot).from_url(f"sim://{robot}").model
