"""The Hex7Bot behind its board, and its servos alone on an adapter.

Owns their records. Must not know the link sets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hexwire.inputs import read_text
from hexwire.model.arms import ArmRecord

if TYPE_CHECKING:
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
    from hexwire.model.shapes import ArmShapes

__all__ = ["ARM", "SERVOS"]


def _kinematics(links: str) -> Hex7BotModel:
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
    from hexwire.model.arms.hex7bot.links import link_set, parse_link_set

    if links.lower().endswith(".toml") or "/" in links:
        return Hex7BotModel(parse_link_set(read_text(links), file=links))
    return Hex7BotModel(link_set(links))


def _shapes(model: Hex7BotModel) -> ArmShapes:
    from hexwire.model.arms.hex7bot.shapes import make_hex7bot_shapes

    return make_hex7bot_shapes(model)


ARM = ArmRecord(
    name="hex7bot",
    title="Hex7Bot",
    driver="hexwire.drivers.hex7bot:Hex7BotDriver",
    kinematics=_kinematics,
    link_sets=True,
    shapes=_shapes,
    gripper="J7",
    closed_at_maximum=True,
    # The same as in the parameter files of the ROS 1 package.
    poses={
        "home": (-0.087, 0.960, -0.044, 0.0, 0.0, 0.0),
        "ready": (-0.087, 0.904, 0.499, 0.0, 1.029, 0.0),
        "rest": (-0.087, 2.007, 0.305, 0.0, 0.0, 0.0),
    },
    pose_speed=0.3,
    # With another link set the arm may touch itself in it: that of V1 does.
    poses_of_links={"rest": ("A", "B")},
    emulated="sim://hex7bot",
    emulate="hexwire.emulator.serve_sim:emulate_hex7bot",
    place=1,
)

SERVOS = ArmRecord(
    name="sevenbot",
    title="the servos of a Hex7Bot",
    driver="hexwire.drivers.bus_arm:SevenBotArm",
    gripper="J7",
    closed_at_maximum=True,
)
