"""The far sides of `bench_ros2`, in processes of their own, straight on Eclipse Zenoh.

`router ENDPOINT` is a router; `bare ENDPOINT` publishes joint states at 100 Hz and answers questions, with nothing
but Zenoh; `client ENDPOINT` listens, sends goals and asks, as lines of JSON say. Times
are of the monotonic clock, which is the same in all processes.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import threading
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src"))

import zenoh

from zenoh_ros2.distributions import Distribution
from zenoh_ros2.keys import data_key
from zenoh_ros2.types import Types
from zenoh_ros2.zenoh_session import ZenohSettings

NAMES = [f"J{i}" for i in range(1, 8)]
CONTROLLER = "joint_trajectory_controller"
BARE = "bench/bare"
_TYPES = Types(Distribution.JAZZY)
_QUERY = _TYPES.service("control_msgs/srv/QueryTrajectoryState")
_STATE = _TYPES.message("sensor_msgs/msg/JointState")
_PERIOD = 0.01
_GID = bytes(range(16))
# Behind the four bytes of the header: seconds and nanoseconds of the stamp.
_STAMP = struct.Struct("<iI")


def opened(endpoint: str, mode: str = "peer") -> Any:
    """A session, set up as `rmw_zenoh` does it."""
    config = zenoh.Config()
    rows = {"mode": mode, "listen/endpoints": [endpoint], "scouting/multicast/enabled": False}
    if mode == "peer":
        rows = ZenohSettings(connect=(endpoint,)).rows()
    for key, value in rows.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def beside(number: int) -> bytes:
    """What stands beside a message or a request."""
    return struct.pack("<qqB16s", number, time.time_ns(), len(_GID), _GID)


def joint_state() -> bytes:
    """A message as long as the node's."""
    return _STATE.serialize(_STATE(name=NAMES, position=[0.1] * 7, velocity=[0.0] * 7, effort=[]))


def answer_of(names: list[str]) -> bytes:
    """An answer as long as the node's."""
    zeros = [0.0] * len(names)
    response = _QUERY.response
    return response.serialize(
        response(success=True, name=names, position=zeros, velocity=zeros, acceleration=zeros)
    )


def ask(session: Any, key: str, payload: bytes, number: int, timeout: float = 10.0) -> bytes:
    """Ask as ROS's clients do; returns the answer."""
    replies = session.get(
        key,
        payload=payload,
        attachment=beside(number),
        timeout=timeout,
        target=zenoh.QueryTarget.ALL_COMPLETE,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    for reply in replies:
        if reply.ok is not None:
            return bytes(reply.ok.payload.to_bytes())
    raise RuntimeError(f"no answer from {key}")


class Client:
    """Asks and listens.

    Args:
        session: Open.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self._numbers = iter(range(1, 1 << 30))
        self._action = _TYPES.action("control_msgs/action/FollowJointTrajectory")

    def listen(self, key: str, seconds: float) -> list[tuple[float, float]]:
        """Arrival times and stamps of everything at a key."""
        rows: list[tuple[float, float]] = []

        def arrived(sample: Any) -> None:
            second, nano = _STAMP.unpack_from(bytes(sample.payload.to_bytes()), 4)
            rows.append((time.monotonic(), second + 1e-9 * nano))

        subscriber = self._session.declare_subscriber(key, zenoh.handlers.Callback(arrived, indirect=False))
        time.sleep(seconds)
        subscriber.undeclare()
        return rows

    def enable(self) -> None:
        """Give the arm torque."""
        switch = _TYPES.service("std_srvs/srv/SetBool")
        data = switch.request.serialize(switch.request(data=True))
        answer = switch.response.parse(self._call("hardware_interface/enable", switch, data))
        if not answer.success:
            raise RuntimeError(answer.message)

    def goals(self, count: int) -> list[float]:
        """Small moves of J1 there and back; when each was sent."""
        here = self._position()
        send, result = self._action.send_goal, self._action.get_result
        name = f"{CONTROLLER}/follow_joint_trajectory/_action"
        sent = []
        for i in range(count):
            number = os.urandom(16)
            goal = self._goal([here[0] + (0.1 if i % 2 == 0 else 0.0), *here[1:]])
            uuid = _TYPES.message("unique_identifier_msgs/msg/UUID")(uuid=list(number))
            data = send.request.serialize(send.request(goal_id=uuid, goal=goal))
            # Anywhere in the raster of the commands, not always just after one.
            time.sleep(0.2 + 0.013 * (i % 7))
            sent.append(time.monotonic())
            if not send.response.parse(self._call(f"{name}/send_goal", send, data)).accepted:
                raise RuntimeError(f"goal {i} was refused")
            data = result.request.serialize(result.request(goal_id=uuid))
            ended = result.response.parse(self._call(f"{name}/get_result", result, data))
            if ended.status != 4:
                raise RuntimeError(f"goal {i} did not succeed: {ended.result.error_string}")
        return sent

    def services(self, count: int, wait: float) -> dict[str, list[float]]:
        """Seconds of a service, and of a question of the same lengths without ROS, one after the other."""
        request = _QUERY.request.serialize(_QUERY.request())
        ros = self._key(f"{CONTROLLER}/query_state", _QUERY)
        times: dict[str, list[float]] = {"service": [], "bare": []}
        for i in range(count):
            for name, key in sorted({"service": ros, "bare": BARE}.items(), reverse=bool(i % 2)):
                time.sleep(wait)
                begin = time.perf_counter()
                answer = ask(self._session, key, request, next(self._numbers))
                times[name].append(time.perf_counter() - begin)
                if name == "service" and not _QUERY.response.parse(answer).success:
                    raise RuntimeError("the service failed")
        return times

    def _position(self) -> list[float]:
        found: list[list[float]] = []
        come = threading.Event()

        def arrived(sample: Any) -> None:
            found.append(list(_STATE.parse(bytes(sample.payload.to_bytes())).position))
            come.set()

        key = data_key(0, "/joint_states", _STATE.dds_name, _STATE.hash)
        subscriber = self._session.declare_subscriber(key, zenoh.handlers.Callback(arrived, indirect=False))
        if not come.wait(10.0):
            raise RuntimeError("no joint states")
        subscriber.undeclare()
        return found[-1]

    def _goal(self, positions: list[float]) -> Any:
        point = _TYPES.message("trajectory_msgs/msg/JointTrajectoryPoint")
        duration = _TYPES.message("builtin_interfaces/msg/Duration")
        trajectory = _TYPES.message("trajectory_msgs/msg/JointTrajectory")
        points = [
            point(positions=positions, velocities=[0.0] * 7, time_from_start=duration(sec=0, nanosec=500_000_000))
        ]
        return self._action.goal(trajectory=trajectory(joint_names=NAMES, points=points))

    def _key(self, name: str, service: Any) -> str:
        return data_key(0, f"/{name}", service.dds_name, service.hash)

    def _call(self, name: str, service: Any, data: bytes) -> bytes:
        return ask(self._session, self._key(name, service), data, next(self._numbers))


def client(endpoint: str) -> None:
    """Take orders until there are none."""
    session = opened(endpoint)
    worker = Client(session)
    print("ready", flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        print(json.dumps(getattr(worker, order.pop("what"))(**order)), flush=True)
    session.close()


def bare(endpoint: str) -> None:
    """Publish at a rate, on absolute deadlines, and answer."""
    session = opened(endpoint)
    answer = answer_of(NAMES)

    def asked(query: Any) -> None:
        query.reply(BARE, answer, attachment=query.attachment)
        query.drop()

    queryable = session.declare_queryable(BARE, zenoh.handlers.Callback(asked, indirect=False), complete=True)
    publisher = session.declare_publisher("bench/states")
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    print("ready", flush=True)
    message = bytearray(joint_state())
    due, number = time.monotonic(), 0
    while not ended.is_set():
        number += 1
        now = time.time_ns()
        _STAMP.pack_into(message, 4, now // 1_000_000_000, now % 1_000_000_000)
        publisher.put(bytes(message), attachment=beside(number))
        due += _PERIOD
        time.sleep(max(0.0, due - time.monotonic()))
    queryable.undeclare()
    session.close()


def router(endpoint: str) -> None:
    """Be a router until there are no more orders."""
    session = opened(endpoint, "router")
    print("ready", flush=True)
    sys.stdin.read()
    session.close()


if __name__ == "__main__":
    {"router": router, "bare": bare, "client": client}[sys.argv[1]](*sys.argv[2:])
