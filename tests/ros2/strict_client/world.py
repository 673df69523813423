"""A router, the node `hexwire-ros2` as a process with an emulated arm, and a strict participant."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.link.far_ends import free_port
from tests.ros2.strict_client.action import ActionClient, Goal, goal, point
from tests.ros2.strict_client.parameters import ParameterClient
from tests.ros2.strict_client.wire import LATCHED, ROSOUT, Participant, ServiceClient, Subscription, router
from tests.waits import until

PROGRAM = Path(sys.executable).with_name("hexwire-ros2")
NODE = "/hardware_interface"
CONTROLLER = "/joint_trajectory_controller"
ACTION = f"{CONTROLLER}/follow_joint_trajectory"
JOINT_STATE = "sensor_msgs/msg/JointState"
# The arm moves as fast as it may, and an emulated servo on a stalled machine is late.
PATIENT = ("constraints.goal_time:=20.0", "constraints.stopped_velocity_tolerance:=0.2")


class NodeProcess:
    def __init__(
        self,
        port: int,
        folder: Path,
        *parameters: str,
        arguments: tuple[str, ...] = (),
        env: dict[str, str] | None = None,
        by_file: bool = False,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        config = folder / "session.json5"
        config.write_text(
            json.dumps(
                {
                    "mode": "peer",
                    "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
                    "listen": {"endpoints": ["tcp/127.0.0.1:0"]},
                    "scouting": {"multicast": {"enabled": False}},
                    "timestamping": {"enabled": True},
                }
            )
        )
        command = [str(PROGRAM), "--ros-args"]
        for parameter in parameters:
            command += ["-p", parameter]
        command += arguments
        clean = {
            name: text
            for name, text in os.environ.items()
            if not name.startswith(("ROS_", "ZENOH_", "RMW_", "HEXWIRE_"))
        }
        where = {"ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["tcp/127.0.0.1:{port}"]'}
        if by_file:
            where = {"ZENOH_SESSION_CONFIG_URI": str(config)}
        self._log = folder / "node.log"
        with self._log.open("ab") as log:
            self.process = subprocess.Popen(
                command,
                env={**clean, "HOME": str(folder), **where, **(env or {})},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    @property
    def said(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def check(self) -> None:
        assert self.process.poll() is None, f"the node ended with {self.process.returncode}\n{self.said[-3000:]}"

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        if self.process.poll() is None:
            self.process.send_signal(how)
        try:
            return self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(30)
            raise AssertionError(f"the node does not end after {how.name}\n{self.said[-3000:]}") from None

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(30)


class Arm:
    """The node as a client knows it: by its names."""

    def __init__(
        self, me: Participant, port: int, node: NodeProcess, full_name: str = NODE, prefix: str = ""
    ) -> None:
        self.me = me
        self.port = port
        self.node = node
        self.name = full_name
        self.prefix = prefix
        until(self._there, f"{full_name} is in the graph", lambda: node.said[-2000:], 60)
        self.joint_states = me.subscribe(f"{prefix}/joint_states", JOINT_STATE)
        self.rosout = me.subscribe("/rosout", "rcl_interfaces/msg/Log", ROSOUT)
        self.action = ActionClient(me, f"{prefix}{ACTION}")
        self.parameters = ParameterClient(me, full_name)
        self._services: dict[tuple[str, str], ServiceClient] = {}
        self.names: list[str] = list(self.joint_states.take().message.name)

    def _there(self) -> bool:
        self.node.check()
        # All of it: the action's last endpoint, and the parameters.
        tokens = self.me.graph.tokens
        return bool(
            tokens(kind="NN", full_node=self.name)
            and tokens(topic=f"{self.prefix}{ACTION}/_action/get_result", kind="SS")
            and tokens(topic=f"{self.name}/list_parameters")
            and tokens(topic=f"{self.name}/enable")
            and tokens(topic=f"{self.name}/teach/play")
            and tokens(topic=f"{self.prefix}/joint_states", kind="MP")
        )

    def service(self, name: str, kind: str) -> ServiceClient:
        if (name, kind) not in self._services:
            self._services[name, kind] = self.me.client(name, kind)
        return self._services[name, kind]

    def trigger(self, leaf: str) -> Any:
        return self.service(f"{self.name}/{leaf}", "std_srvs/srv/Trigger").call()

    def enable(self, on: bool = True) -> Any:
        return self.service(f"{self.name}/enable", "std_srvs/srv/SetBool").call(data=on)

    def positions(self) -> dict[str, float]:
        self.joint_states.take_all()
        message = self.joint_states.take().message
        return dict(zip(message.name, message.position, strict=True))

    def near(self, moves: dict[str, float] | None = None) -> list[float]:
        """Where the joints are, each moved by what is said."""
        at = self.positions()
        return [at[name] + (moves or {}).get(name, 0.0) for name in self.names]

    def short_goal(self, by: float = 0.1, seconds: float = 0.6) -> dict[str, Any]:
        """J1 moves a little, and back towards the middle."""
        at = self.positions()[self.names[0]]
        return goal(self.names, [point(self.near({self.names[0]: -by if at > 0 else by}), seconds)])

    def long_goal(self, seconds: float = 30.0) -> dict[str, Any]:
        return self.short_goal(0.3, seconds)

    def send(self, sent: dict[str, Any]) -> Goal:
        return self.action.send(sent)

    def rest(self) -> None:
        """No goal, torque on, no stop: what every test starts with."""
        self.action.cancel()
        self.trigger("reset")
        answer = self.enable()
        assert answer.success, answer.message
        until(lambda: not self._active(), "no goal is active")
        for subscription in (self.action.feedback, self.action.status, self.rosout, self.joint_states):
            subscription.take_all()

    def _active(self) -> bool:
        received = self.action.status.take_all()
        if received:
            self._last = received[-1].message
        last = getattr(self, "_last", None)
        return last is not None and any(status.status in (1, 2, 3) for status in last.status_list)


@contextmanager
def running(
    folder: Path,
    *parameters: str,
    port: int | None = None,
    constraints: tuple[str, ...] = PATIENT,
    **options: Any,
) -> Iterator[tuple[int, NodeProcess]]:
    """A node at a router of its own, or at that of another."""
    with contextlib.ExitStack() as stack:
        if port is None:
            port = free_port()
            stack.enter_context(router(port))
        node = NodeProcess(
            port, folder, "port:=sim://hex7bot", "watchdog:=20.0", *constraints, *parameters, **options
        )
        stack.callback(node.kill)
        try:
            yield port, node
        except BaseException:
            print(node.said[-6000:])
            raise
        node.check()


def latched(me: Participant, topic: str, name: str) -> Subscription:
    return me.subscribe(topic, name, LATCHED)


def wall() -> float:
    return time.time()
