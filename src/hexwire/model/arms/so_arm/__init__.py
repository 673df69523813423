"""The SO-100 and the SO-101.

Owns their records, and those of arms with the same joints and other links (`so_arm`).

Sources: ids, servo models, gear ratios and part numbers from the makers' bill of materials, and the vendor's list
(STS3215-C001: 7.4 V, 1:345; C018: 12 V, 1:345; C044: 7.4 V, 1:191; C046: 7.4 V, 1:147); ranges from the URDF
`so101_new_calib` of TheRobotStudio/SO-ARM100; that the stops lie 5 degrees further out is assumed. The wrist turns
without end: only its cable limits it. An SO-100 has the same servos, and a range of the elbow that is a little
smaller. Centres of mass are rounded from that URDF, in one plane; the SO-100 has nearly the same links. Torques
that carry the arm are computed from these masses: 0.86 N m for an arm stretched out level, 0.46 N m at the elbow; a
servo stalls at 1.9 N m with 7.4 V and at about 1.35 N m with 5 V.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.model.arms import ArmRecord, Assembly, AssemblyJoint, Go, Rod, Seek

if TYPE_CHECKING:
    from hexwire.model.arms.so_arm.kinematics import SoArmModel
    from hexwire.model.arms.so_arm.links import SoArmLinks
    from hexwire.model.shapes import ArmShapes

__all__ = ["SO100", "SO101", "so_arm"]

# At the start the arm is folded, as it is put down before it is switched on.
_PAN = AssemblyJoint(
    "shoulder_pan",
    "in the base; it turns the whole arm",
    low=-110.0,
    high=110.0,
    leader_gears=191,
    leader_part="C044",
)
_LIFT = AssemblyJoint(
    "shoulder_lift",
    "at the shoulder; it leans the upper arm",
    low=-100.0,
    high=100.0,
    start=-95.0,
    weight=0.12,
    force=0.75,
    upright=True,
    leader_gears=345,
    leader_part="C001",
)
_ELBOW = AssemblyJoint(
    "elbow_flex",
    "at the elbow; it bends the forearm",
    low=-96.8,
    high=96.8,
    start=90.0,
    weight=0.1,
    force=0.5,
    leader_gears=191,
    leader_part="C044",
)
_WRIST = AssemblyJoint(
    "wrist_flex",
    "at the wrist; it bends the gripper",
    low=-95.0,
    high=95.0,
    start=50.0,
    weight=0.04,
    leader_gears=147,
    leader_part="C046",
)
_ROLL = AssemblyJoint(
    "wrist_roll",
    "behind the gripper; it rolls it",
    low=-157.2,
    high=162.8,
    endless=True,
    leader_gears=147,
    leader_part="C046",
)
_GRIPPER = AssemblyJoint(
    "gripper",
    "in the gripper; it moves the jaw or trigger",
    low=-10.0,
    high=100.0,
    leader_gears=147,
    leader_part="C046",
)
_ASSEMBLY = Assembly(
    (_PAN, _LIFT, _ELBOW, _WRIST, _ROLL, _GRIPPER),
    gears=345,
    part="C001 for 7.4 V, C018 for 12 V",
    servo_models=("sts3215", "sts3250"),
    picture=(
        "             {3}-------{4}-{5}-{6}",
        "            /",
        "           /",
        "         {2}",
        "          |",
        "         {1}",
        "      =========== base",
    ),
    # The gripper is raised first, because it may lie on the table. The upper arm leans back to its stop and the
    # forearm folds to its own, as the arm is put down; then the forearm points up, where wrist, gripper and base
    # are free to turn; then the upper arm is upright for the other stop of the elbow, and comes down only with the
    # forearm level and the gripper raised.
    search=(
        Seek("wrist_flex", -1),
        Go({"wrist_flex": -40.0}),
        Seek("shoulder_lift", -1),
        Seek("elbow_flex", 1),
        Go({"elbow_flex": 0.0}),
        Seek("wrist_flex", 1),
        Go({"wrist_flex": -45.0}),
        Seek("gripper", -1),
        Seek("gripper", 1),
        Go({"gripper": 45.0}),
        Seek("shoulder_pan", -1),
        Seek("shoulder_pan", 1),
        Go({"shoulder_pan": 0.0}),
        Go({"shoulder_lift": 0.0}),
        Seek("elbow_flex", -1),
        Seek("shoulder_lift", 1),
        Go({"shoulder_lift": 0.0}),
        Go({"elbow_flex": 0.0}),
        Go({"shoulder_lift": -92.0}),
        Go({"elbow_flex": 88.0, "wrist_flex": 40.0}),
    ),
)
_RODS = {
    # From the axis of shoulder_lift, because the joint before it is elsewhere in the two arms.
    "shoulder": Rod((-0.0004, 0.0, -0.0292), 0.0621, 0.1, reference="shoulder_lift"),
    "upper_arm": Rod((0.0084, 0.0, 0.0898), 0.116, 0.103),
    "lower_arm": Rod((0.0981, 0.0, 0.0032), 0.135, 0.104),
    "wrist": Rod((0.0386, 0.0, 0.0), 0.0611, 0.079),
    "gripper_body": Rod((0.0252, 0.0, 0.0), 0.0981, 0.087),
    "jaw": Rod((0.03, 0.0, 0.0), 0.07, 0.012, in_plane=True),
}


def so_arm(name: str, title: str, driver: str, links: Callable[[], SoArmLinks]) -> ArmRecord:
    """The record of an arm with the joints of an SO-101.

    Args:
        name: Name of the robot.
        title: As a person calls it.
        driver: As in `ArmRecord`.
        links: Returns its links.
    """

    def kinematics(_: str) -> SoArmModel:
        from hexwire.model.arms.so_arm.kinematics import SoArmModel

        return SoArmModel(links())

    def shapes(model: SoArmModel) -> ArmShapes:
        from hexwire.model.arms.so_arm.shapes import make_so_arm_shapes

        return make_so_arm_shapes(model)

    return ArmRecord(
        name=name,
        title=title,
        driver=driver,
        kinematics=kinematics,
        shapes=shapes,
        rods=_RODS,
        gripper="gripper",
        poses={"home": (0.0, 0.0, 0.0, 0.0, 0.0)},
        emulated=f"sim://{name}",
        assembly=_ASSEMBLY,
    )


def _published(name: str) -> Callable[[], SoArmLinks]:
    def links() -> SoArmLinks:
        from hexwire.model.arms.so_arm.links import SO_ARMS

        return SO_ARMS[name]

    return links


SO101 = replace(so_arm("so101", "SO-101", "hexwire.drivers.bus_arm:So101Arm", _published("so101")), place=2)
SO100 = replace(
    so_arm("so100", "SO-100", "hexwire.drivers.bus_arm:So100Arm", _published("so100")),
    place=3,
    assembly=replace(
        _ASSEMBLY,
        # The makers of the SO-100 take the gears of its leader out: its servos have no part number of their own.
        joints=tuple(
            replace(joint, leader_part="")
            for joint in (_PAN, _LIFT, replace(_ELBOW, low=-90.0, high=90.0), _WRIST, _ROLL, _GRIPPER)
        ),
    ),
)
