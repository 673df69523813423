"""A ROS 2 client without a ROS installation: print where the arm is, and move one joint.

    hexwire fleet router                                            # or rmw_zenoh's; each in a terminal of its own
    hexwire-ros2 --ros-args -p port:=/dev/ttyUSB0 -p enable_on_start:=true
    python examples/ros2_client.py

Needs `hexwire[ros2]`. With rclpy, the topics, types and fields are the same.
"""

import threading
import time
from typing import Any

from hexwire import ros_node

positions: dict[str, float] = {}
arrived = threading.Event()


def take(message: Any, stamp: int) -> None:
    """Remember a sensor_msgs/msg/JointState."""
    positions.update(zip(message.name, message.position, strict=True))
    arrived.set()


with ros_node("ros2_client") as node:
    JointTrajectory = node.types.message("trajectory_msgs/msg/JointTrajectory")
    Point = node.types.message("trajectory_msgs/msg/JointTrajectoryPoint")
    Duration = node.types.message("builtin_interfaces/msg/Duration")
    node.subscribe("joint_states", "sensor_msgs/msg/JointState", take)
    command = node.publisher("joint_trajectory_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory")
    if not arrived.wait(10) or not positions:
        raise SystemExit("no joint_states: does hexwire-ros2 run, and the router?")
    while not command.subscriber_count():
        time.sleep(0.05)

    names, goal = list(positions), positions | {"J1": positions["J1"] + 0.2}
    print("J1 is at", round(positions["J1"], 3), "rad")
    point = Point(positions=[goal[name] for name in names], time_from_start=Duration(sec=1))
    command.publish(JointTrajectory(joint_names=names, points=[point]))

    end = time.monotonic() + 5
    while abs(positions["J1"] - goal["J1"]) > 0.02 and time.monotonic() < end:
        time.sleep(0.05)
    print("J1 is at", round(positions["J1"], 3), "rad")
