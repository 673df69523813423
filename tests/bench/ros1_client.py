"""The far side of `bench_ros1`, in processes of its own: Debian's Python with Debian's rospy.

`listen TOPIC SECONDS` prints when messages came and were stamped, `publish TOPIC RATE` is a bare publisher of joint
states, `send` and `echo` tell how long one way takes, `goals COUNT` sends goals and prints when, `services COUNT`
calls a service. Times are of the monotonic clock, which is the same in all processes.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "src"))

import actionlib
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectoryPoint

NAMES = [f"J{i}" for i in range(1, 8)]


def listen(topic: str, seconds: str) -> None:
    """Arrival times and sample stamps of everything on a topic; says when the first has come."""
    rows: list[tuple[float, float]] = []
    rospy.Subscriber(
        topic,
        JointState,
        lambda m: rows.append((time.monotonic(), m.header.stamp.to_sec())),
        queue_size=1000,
        tcp_nodelay=True,
    )
    end = time.monotonic() + float(seconds)
    while not rows and time.monotonic() < end:
        time.sleep(0.01)
    print("messages come", file=sys.stderr, flush=True)
    time.sleep(float(seconds))
    print(json.dumps(rows))


def publish(topic: str, rate: str) -> None:
    """Seven joints at a rate, on absolute deadlines, until the node is shut down."""
    publisher = rospy.Publisher(topic, JointState, queue_size=10)
    message = JointState(name=NAMES, position=[0.0] * 7, velocity=[0.0] * 7)
    due = time.monotonic()
    while not rospy.is_shutdown():
        message.header.stamp = rospy.Time.now()
        publisher.publish(message)
        due += 1.0 / float(rate)
        time.sleep(max(0.0, due - time.monotonic()))


def echo(there: str) -> None:
    """Print when each message came; the reference for how long one way takes."""
    rospy.Subscriber(
        there,
        Float64,
        lambda m: print(json.dumps([m.data, time.monotonic()]), flush=True),
        queue_size=10,
        tcp_nodelay=True,
    )
    print("ready", flush=True)
    rospy.spin()


def send(there: str, count: str) -> None:
    """Send the time, now and then."""
    publisher = rospy.Publisher(there, Float64, queue_size=10, tcp_nodelay=True)
    while publisher.get_num_connections() == 0:
        time.sleep(0.01)
    for _ in range(int(count)):
        publisher.publish(time.monotonic())
        time.sleep(0.05)


def goals(count: str) -> None:
    """Small moves of J1 there and back, one after the other; prints when each goal was sent."""
    from hexwire.ros1.messages import control_msgs

    messages = control_msgs()
    here = list(rospy.wait_for_message("joint_states", JointState, 10).position)
    client = actionlib.SimpleActionClient("follow_joint_trajectory", messages.FollowJointTrajectoryAction)
    if not client.wait_for_server(rospy.Duration(10)):
        sys.exit("the node offers no action")
    sent = []
    for i in range(int(count)):
        goal = messages.FollowJointTrajectoryGoal()
        goal.trajectory.joint_names = NAMES
        there = [here[0] + (0.1 if i % 2 == 0 else 0.0), *here[1:]]
        goal.trajectory.points = [
            JointTrajectoryPoint(positions=there, velocities=[0.0] * 7, time_from_start=rospy.Duration(0.5))
        ]
        # Anywhere in the raster of the commands, not always just after one.
        time.sleep(0.2 + 0.013 * (i % 7))
        sent.append(time.monotonic())
        client.send_goal(goal)
        if not client.wait_for_result(rospy.Duration(10)) or client.get_state() != 3:
            sys.exit(f"goal {i} did not succeed: {client.get_goal_status_text()}")
    print(json.dumps(sent))


def services(count: str) -> None:
    """Seconds that each call of a service takes, over one connection."""
    from hexwire.ros1.messages import control_srvs

    rospy.wait_for_service("query_state", 10)
    proxy = rospy.ServiceProxy("query_state", control_srvs().QueryTrajectoryState, persistent=True)
    times = []
    for _ in range(int(count)):
        time.sleep(0.005)
        begin = time.perf_counter()
        proxy(time=rospy.Time.now())
        times.append(time.perf_counter() - begin)
    print(json.dumps(times))


if __name__ == "__main__":
    rospy.init_node("bench", anonymous=True)
    parts = {"listen": listen, "publish": publish, "echo": echo, "send": send, "goals": goals, "services": services}
    parts[sys.argv[1]](*sys.argv[2:])
