"""What zenoh-ros2-sdk sees and does, as JSON on standard output; runs in the environment of the witnesses.

    python zenoh_sdk.py PORT NODE FOLDER

The SDK loads definitions from GitHub if it is not given any: it is given all, so nothing is fetched.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# GitPython looks for git when it is imported; nothing here needs it.
os.environ["GIT_PYTHON_REFRESH"] = "quiet"

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_service_names_and_types, get_topic_info, get_topic_names_and_types
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession
from zenoh_ros2_sdk.utils import compute_service_type_hash

STORE = get_typestore(Stores.ROS2_JAZZY)
PATIENCE = 30.0


def eventually(question: Callable[[], Any], enough: Callable[[Any], bool]) -> Any:
    """The first answer that is enough, or the last one.

    The SDK asks once, and a session that has just been opened knows neither all tokens nor all ways at once.
    """
    deadline = time.monotonic() + PATIENCE
    while not enough(answer := question()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return answer


def came(answer: Any) -> bool:
    return answer is not None


def definition(name: str) -> str:
    return STORE.generate_msgdef(name, ros_version=2)[0]


def record(folder: Path, topics: dict[str, str]) -> dict[str, dict[str, Any]]:
    """A bag of what is published at topics, as `ros2 bag record` writes it; what rosbags reads in it, by topic."""
    session = ZenohSession.get_instance().session
    heard: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in topics}

    def note(topic: str) -> Callable[[Any], None]:
        return lambda sample: heard[topic].append((time.time_ns(), bytes(sample.payload.to_bytes())))

    listeners = [session.declare_subscriber(f"0{topic}/**", note(topic)) for topic in topics]
    eventually(lambda: min(map(len, heard.values())), lambda count: count >= 3)
    for listener in listeners:
        listener.undeclare()
    # In this thread: the writer is for one, and a listener may still have been at work.
    rows = {topic: list(messages) for topic, messages in heard.items()}
    with Writer(folder, version=9) as bag:
        for topic, kind in topics.items():
            place = bag.add_connection(topic, kind, typestore=STORE)
            for stamp, data in rows[topic]:
                bag.write(place, stamp, data)
    found: dict[str, dict[str, Any]] = {topic: {"heard": len(each), "read": 0} for topic, each in rows.items()}
    with AnyReader([folder]) as reader:
        for place, _, data in reader.messages():
            message = reader.deserialize(data, place.msgtype)
            found[place.topic]["read"] += 1
            found[place.topic]["names"] = list(getattr(message, "name", ()))
            found[place.topic]["status"] = [row.name for row in getattr(message, "status", ())]
    return found


LIFECYCLE = "lifecycle_msgs/srv"
NOTHING = "# nothing\n"


def drive_lifecycle(node: str, at: dict[str, Any]) -> list[Any]:
    """States of a managed node, and whether changes succeeded: deactivated, and activated again."""
    state = "lifecycle_msgs/State current_state\n"
    asked = "lifecycle_msgs/Transition transition\n"
    rows = {"get_state": ("GetState", NOTHING, state), "change_state": ("ChangeState", asked, "bool success\n")}
    inner = {name: definition(name) for name in ("lifecycle_msgs/msg/State", "lifecycle_msgs/msg/Transition")}
    clients = {}
    for name, (kind, request, response) in rows.items():
        definitions = {"request_definition": request, "response_definition": response}
        code = compute_service_type_hash(f"{LIFECYCLE}/{kind}", **definitions, dependencies=inner)
        clients[name] = ROS2ServiceClient(
            f"{node}/{name}", f"{LIFECYCLE}/{kind}", type_hash=code, **definitions, **at
        )
    transition = ZenohSession.get_instance().store.types["lifecycle_msgs/msg/Transition"]

    def call(name: str, **fields: Any) -> Any:
        return eventually(lambda: clients[name].call(**fields), came)

    seen = [call("get_state").current_state.label]
    for number, label in ((4, "deactivate"), (3, "activate")):
        seen.append(bool(call("change_state", transition=transition(id=number, label=label)).success))
        seen.append(call("get_state").current_state.label)
    for client in clients.values():
        client.close()
    return seen


def main(port: int, node: str, folder: Path) -> dict[str, Any]:
    at = {"router_ip": "127.0.0.1", "router_port": port, "domain_id": 0}
    ZenohSession.get_instance("127.0.0.1", port).store.register(STORE.fielddefs)
    seen: dict[str, Any] = {}
    where = {"router_ip": "127.0.0.1", "router_port": port, "domain_id": 0, "timeout": 2.0}

    topics = {"/joint_states", "/joint_trajectory_controller/joint_trajectory", "/robot_description", "/rosout"}
    services = {f"{node}/reset", f"{node}/get_state", f"{node}/list_parameters"}
    seen["topics"] = eventually(lambda: dict(get_topic_names_and_types(**where)), topics.issubset)
    seen["services"] = eventually(lambda: dict(get_service_names_and_types(**where)), services.issubset)
    info = eventually(
        lambda: get_topic_info("/joint_states", verbose=True, **where),
        lambda found: bool(found and found.publishers),
    )
    seen["publishers"] = [end.node_name for end in info.publishers]

    def hear(topic: str, name: str, count: int, wait: float = PATIENCE, **more: Any) -> list[Any]:
        heard: queue.Queue[Any] = queue.Queue()
        subscriber = ROS2Subscriber(
            topic, name, heard.put, msg_definition=definition(name), type_hash=STORE.hash_rihs01(name), **at, **more
        )
        try:
            return [heard.get(timeout=wait) for _ in range(count)]
        finally:
            subscriber.close()

    states = hear("/joint_states", "sensor_msgs/msg/JointState", 20)
    seen["joints"] = states[0].name
    seen["positions"] = [float(position) for position in states[-1].position]
    seen["stamps"] = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in states]
    latched = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)

    def description() -> str | None:
        with contextlib.suppress(queue.Empty):
            return str(hear("/robot_description", "std_msgs/msg/String", 1, 3.0, qos=latched)[0].data)
        return None

    seen["description"] = eventually(description, came)

    # An empty text counts as none.
    request, response = "# nothing\n", "bool success\nstring message\n"
    seen["trigger_hash"] = compute_service_type_hash(
        "std_srvs/srv/Trigger", request_definition=request, response_definition=response
    )
    client = ROS2ServiceClient(
        f"{node}/reset",
        "std_srvs/srv/Trigger",
        request_definition=request,
        response_definition=response,
        type_hash=seen["trigger_hash"],
        **at,
    )
    answer = eventually(client.call, came)
    seen["reset"] = [bool(answer.success), answer.message] if answer is not None else None
    client.close()

    name = "trajectory_msgs/msg/JointTrajectory"
    publisher = ROS2Publisher(
        "/joint_trajectory_controller/joint_trajectory",
        name,
        msg_definition=definition(name),
        type_hash=STORE.hash_rihs01(name),
        **at,
    )
    types = ZenohSession.get_instance().store.types
    import numpy as np

    before = seen["positions"]
    by = -0.15 if before[0] > 0 else 0.15
    goal = np.array([before[0] + by, *before[1:]])
    none = np.array([], dtype=np.float64)
    point = types["trajectory_msgs/msg/JointTrajectoryPoint"](
        positions=goal,
        velocities=none,
        accelerations=none,
        effort=none,
        time_from_start=types["builtin_interfaces/msg/Duration"](sec=1, nanosec=0),
    )
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")

    def distance() -> float:
        publisher.publish(header=header, joint_names=list(seen["joints"]), points=[point])
        last = hear("/joint_states", "sensor_msgs/msg/JointState", 150)[-1]
        return abs(float(last.position[0]) - goal[0])

    near = 0.05
    seen["reached"] = bool(eventually(distance, lambda left: left < near) < near)
    publisher.close()
    seen["lifecycle"] = drive_lifecycle(node, at)
    kinds = {"/joint_states": "sensor_msgs/msg/JointState", "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
    seen["bag"] = record(folder / "bag", kinds)
    ZenohSession.get_instance().close()
    return seen


if __name__ == "__main__":
    json.dump(main(int(sys.argv[1]), sys.argv[2], Path(sys.argv[3])), sys.stdout)
