"""The PUMA 260.

Owns its record. Must not know its links.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.model.arms import ArmRecord

if TYPE_CHECKING:
    from hexwire.model.arms.puma260.kinematics import Puma260Model
    from hexwire.model.shapes import ArmShapes

__all__ = ["ARM"]


def _kinematics(_: str) -> Puma260Model:
    from hexwire.model.arms.puma260.kinematics import Puma260Model

    return Puma260Model()


def _shapes(_: Puma260Model) -> ArmShapes:
    from hexwire.model.arms.puma260.shapes import make_puma260_shapes

    return make_puma260_shapes()


ARM = ArmRecord(
    name="puma260",
    title="PUMA 260",
    driver="hexwire.drivers.puma260:Puma260Driver",
    kinematics=_kinematics,
    shapes=_shapes,
    poses={"home": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "ready": (0.0, -0.8, -0.4, 0.0, 1.2, 0.0)},
    pose_speed=0.3,
    unit=1.0,
    port="tcp://192.168.1.175:15030",
    emulated="tcp://127.0.0.1:15030",
    emulator="hexwire sim puma260",
)
