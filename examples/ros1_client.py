"""A ROS 1 client: wait for the arm, print where it is, and move one joint.

    hexwire-ros1 _port:=/dev/ttyUSB0 _enable_on_start:=true     # in another terminal, beside roscore
    python examples/ros1_client.py

Needs ROS 1's Python packages (`apt install python3-rospy python3-sensor-msgs python3-trajectory-msgs`).
"""

import rospy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

rospy.init_node("ros1_client")
command = rospy.Publisher("command", JointTrajectory, queue_size=1)


def positions() -> dict[str, float]:
    """Joint positions by name, radians."""
    message = rospy.wait_for_message("joint_states", JointState, timeout=10)
    return dict(zip(message.name, message.position, strict=True))


here = positions()
print("J1 is at", round(here["J1"], 3), "rad")
while not command.get_num_connections():
    rospy.sleep(0.05)

goal = JointTrajectory(joint_names=list(here))
point = JointTrajectoryPoint(positions=list((here | {"J1": here["J1"] + 0.2}).values()))
point.time_from_start = rospy.Duration(1.0)
goal.points.append(point)
command.publish(goal)

end = rospy.Time.now() + rospy.Duration(5)
while abs(positions()["J1"] - point.positions[0]) > 0.02 and rospy.Time.now() < end:
    rospy.sleep(0.05)
print("J1 is at", round(positions()["J1"], 3), "rad")
