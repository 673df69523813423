"""Pick something up here and put it down there: poses of the tool tip, straight lines, and the gripper.

    python examples/pick_and_place.py [PORT]

For a Hex7Bot; its geometry turns positions in metres into joint angles.
"""

import sys
from collections.abc import Sequence

import hexwire
from hexwire.control import run_motion
from hexwire.model.gripper import jaws_of
from hexwire.model.pose import Pose
from hexwire.motion.checks import InJoints
from hexwire.motion.line import Line
from hexwire.motion.optimal import time_optimal

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"
DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # columns are the axes of a tool that points down
HERE, THERE = (-0.08, 0.20), (0.08, 0.20)
ABOVE, AT = 0.14, 0.10

model = hexwire.Hex7BotModel()
SPEED, ACCELERATION = [1.2] * 6, [6.0] * 6  # rad/s, rad/s^2


def angles_of(arm: hexwire.RobotDriver) -> Sequence[float]:
    """The joint angles as the geometry counts them."""
    return model.from_joints(arm.read().positions)


def over(arm: hexwire.RobotDriver, place: tuple[float, float]) -> None:
    """The fastest way to a point above a place."""
    start = angles_of(arm)
    goal = model.best(Pose((*place, ABOVE), DOWN), near=start).angles
    names = [joint.name for joint in model.ranges]
    run_motion(arm, InJoints(time_optimal(names, start, goal, SPEED, ACCELERATION), model)).require()


def straight(arm: hexwire.RobotDriver, place: tuple[float, float], height: float) -> None:
    """A straight line up or down."""
    run_motion(arm, InJoints(Line(model, angles_of(arm), Pose((*place, height), DOWN)), model)).require()


def grip(arm: hexwire.RobotDriver, share: float) -> None:
    """Open the gripper: 1 is fully open, 0 closed."""
    jaws = jaws_of(arm.model)
    assert jaws is not None
    angle = jaws.angle(share)
    run_motion(arm, hexwire.JointTarget.of({jaws.joint: angle}, duration=0.5)).require()


with hexwire.connect(port) as arm:
    for place, before, after in ((HERE, 0.8, 0.2), (THERE, 0.2, 0.8)):
        over(arm, place)
        grip(arm, before)
        straight(arm, place, AT)
        grip(arm, after)
        straight(arm, place, ABOVE)
        x, y, z = model.forward(angles_of(arm)).position
        print(f"tip at {1e3 * x:.0f} {1e3 * y:.0f} {1e3 * z:.0f} mm, gripper {after:.0%} open")
    arm.torque(False)
