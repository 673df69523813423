"""What a node says whose time zenoh-ros2-sdk makes, as JSON; in the environment of the witnesses.

    python sdk_clock.py PORT

It publishes `/clock` at half speed, which starts at 1000 s, until the node has had it for 50 states.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from typing import Any

# GitPython looks for git when it is imported; nothing here needs it.
os.environ["GIT_PYTHON_REFRESH"] = "quiet"

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

STORE = get_typestore(Stores.ROS2_JAZZY)
CLOCK, STATE = "rosgraph_msgs/msg/Clock", "sensor_msgs/msg/JointState"
START, STEP, PATIENCE = 1000.0, 0.02, 30.0


def main(port: int) -> list[list[float]]:
    """Stamps of states, each with the time that was simulated when it came."""
    at = {"router_ip": "127.0.0.1", "router_port": port, "domain_id": 0}
    session = ZenohSession.get_instance("127.0.0.1", port)
    session.store.register(STORE.fielddefs)
    of = {kind: {"msg_definition": STORE.generate_msgdef(kind, ros_version=2)[0]} for kind in (CLOCK, STATE)}
    now, rows, done = START, list[list[float]](), threading.Event()

    def hear(state: Any) -> None:
        stamp = state.header.stamp.sec + state.header.stamp.nanosec * 1e-9
        # Zero until the node has the clock.
        if stamp and not done.is_set():
            rows.append([stamp, now])
            if len(rows) == 50:
                done.set()

    clock = ROS2Publisher("/clock", CLOCK, type_hash=STORE.hash_rihs01(CLOCK), **of[CLOCK], **at)
    states = ROS2Subscriber("/joint_states", STATE, hear, type_hash=STORE.hash_rihs01(STATE), **of[STATE], **at)
    instant, deadline = session.store.types["builtin_interfaces/msg/Time"], time.monotonic() + PATIENCE
    while not done.wait(STEP) and time.monotonic() < deadline:
        now += STEP / 2
        clock.publish(clock=instant(sec=int(now), nanosec=int(now % 1 * 1e9)))
    states.close()
    clock.close()
    return rows


if __name__ == "__main__":
    json.dump(main(int(sys.argv[1])), sys.stdout)
