"""The node `hardware_interface` in the test's process: real but for Zenoh and the robot, in simulated time.

Messages and requests are those that others send and read; the arm is emulated. Nothing passes but by `turn`.
"""

from __future__ import annotations

import functools
import math
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from tests.control.arm_bench import Bench
from tests.drivers.arms import Arm as EmulatedArm
from tests.waits import turn_while_it_waits
from zenoh_ros2_tests.fake_node import Call, FakeNode, FakePublisher

from hexwire.control.requests import arm_node
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.ros2 import hardware_interface
from hexwire.ros2.hardware_interface import NAME, HardwareInterface
from hexwire.ros2.settings import load_settings
from zenoh_ros2.node import NodeOptions
from zenoh_ros2.types import Types

WALL = 1_700_000_000.0
"""Unix time at which the simulated time is 0."""
TICK = 0.1
"""Seconds between two looks of the main loop."""
CONTROLLER = "joint_trajectory_controller"
ACTION = "control_msgs/action/FollowJointTrajectory"


class Turns:
    """In place of `Shutdown`: the main loop waits here until the test lets it go on."""

    def __init__(self, patience: float) -> None:
        self.interrupts = self.requested = self.listening = False
        self.waiting, self._go = threading.Semaphore(0), threading.Semaphore(0)

    def listen(self) -> None:
        self.listening = True

    def request(self) -> None:
        self.requested = True

    def wait(self, seconds: float) -> bool:
        self.waiting.release()
        self._go.acquire()
        return self.requested

    def next(self) -> None:
        """Let it look once more."""
        self._go.release()


_types = functools.cache(Types)
"""The same for all nodes: a type is compiled when it is first used."""


class Front(Bench):
    """The node, its arm, and what others send and get.

    Args:
        patch: Takes the node's clocks, its session and its thread away.
        params: Parameters by flat name.
        options: Name, namespace and remapping rules.
    """

    def __init__(
        self, patch: pytest.MonkeyPatch, params: Mapping[str, object], options: NodeOptions | None = None
    ) -> None:
        self.emulated = EmulatedArm(2, 0, (), attach=False)
        self.clock, self.board, self.link = self.emulated.clock, self.emulated.board, self.emulated.link
        self.track, self.jammed, self.error = [], {}, list[BaseException]()
        self.time = SimpleNamespace(
            monotonic=self.clock,
            time=lambda: WALL + self.clock(),
            time_ns=self.now_ns,
            # At the start and at the end, when nobody else lets time pass.
            sleep=self.clock.sleep,
        )
        for module, name, what in (
            (hardware_interface, "Node", self._make_node),
            (hardware_interface, "Types", _types),
            (arm_node, "ControlledArm", self._make_arm),
            (arm_node, "Shutdown", Turns),
            (hardware_interface, "time", self.time),
            (arm_node, "time", self.time),
        ):
            patch.setattr(module, name, what)
        settings, _ = load_settings({"port": "/dev/null", **params}, {})
        self.front = HardwareInterface(options or NodeOptions(NAME), settings, self.emulated.driver)
        self.turns: Any = self.front._shutdown
        self._thread = threading.Thread(target=self._run, name="front", daemon=True)
        self._due = self.clock()

    def now_ns(self) -> int:
        return round((WALL + self.clock()) * 1e9)

    def _make_node(self, options: NodeOptions, types: Any) -> FakeNode:
        self.node = FakeNode(types, options=options)
        return self.node

    def _make_arm(self, robot: Any, settings: Any, **calls: Any) -> ControlledArm:
        self.arm = ControlledArm(robot, settings, clock=self.clock, sleep=self.clock.sleep, **calls)
        self.owner = self.arm.owner
        self.owner.start = self._begin  # type: ignore[method-assign]  # `turn` does what its thread does
        return self.arm

    def _begin(self, members: Any) -> None:
        self.owner.group.members = members

    def _run(self) -> None:
        try:
            self.status = self.front.run()
        except BaseException as error:  # noqa: BLE001  # judged by the test
            self.error.append(error)
        finally:
            self.turns.waiting.release()

    def open(self) -> None:
        """Start the node, and wait until it is ready."""
        self._thread.start()
        self._look()
        self.turn(0.2)

    def close(self) -> None:
        """End it, as a signal does, if it has not ended."""
        self.turns.requested = True
        self.turns.next()
        self._thread.join(30.0)
        assert not self._thread.is_alive()

    def _look(self) -> None:
        assert self.turns.waiting.acquire(timeout=30.0), "the main loop hangs"

    def _step(self) -> None:
        super()._step()
        if self.clock() >= self._due and self._thread.is_alive():
            self._due = self.clock() + TICK
            self.turns.next()
            self._look()

    # -- what others do -----------------------------------------------------------------------------------------

    def topic(self, name: str) -> FakePublisher:
        return self.node.publishers[name]

    def newest(self, name: str) -> Any:
        """The newest message of a topic; time passes until there is one from now on."""
        sent = self.topic(name).sent
        before = len(sent)
        self.until(lambda: len(sent) > before)
        return sent[-1]

    def send(self, topic: str, /, **fields: Any) -> None:
        """A message of somebody arrives."""
        self.node.subscriptions[topic].receive(self.now_ns(), **fields)

    def call(self, service: str, /, **fields: Any) -> Any:
        """Ask a service; time passes while it waits for the arm."""
        before = set(threading.enumerate())
        call = self.node.call(service, **fields)
        for thread in set(threading.enumerate()) - before:
            if thread.name in ("service", "lifecycle"):
                turn_while_it_waits(thread, self._step)
        self._answered(call)
        return call.response

    def _answered(self, call: Call) -> None:
        deadline = time.monotonic() + 30.0
        while call.response is None:
            assert time.monotonic() < deadline, "no answer"
            time.sleep(0.001)

    def trigger(self, name: str) -> str:
        """Call a service of this node that must succeed."""
        answer = self.call(f"/{NAME}/{name}")
        assert answer.success, answer.message
        return str(answer.message)

    def refused(self, name: str) -> str:
        """Call a service of this node that must not succeed."""
        answer = self.call(f"/{NAME}/{name}")
        assert not answer.success, answer.message
        return str(answer.message)

    def enable(self, on: bool = True) -> None:
        answer = self.call(f"/{NAME}/enable", data=on)
        assert answer.success, answer.message

    def point(self, seconds: float, angles: Mapping[str, float]) -> Any:
        make = self.node.types.message
        since = make("builtin_interfaces/msg/Duration")(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
        return make("trajectory_msgs/msg/JointTrajectoryPoint")(
            positions=list(angles.values()), time_from_start=since
        )

    def trajectory(self, *points: tuple[float, Mapping[str, float]]) -> None:
        """A trajectory arrives by topic, and is checked."""
        names = list(points[0][1]) if points else []
        self.send(
            f"/{CONTROLLER}/joint_trajectory", joint_names=names, points=[self.point(*point) for point in points]
        )
        self.checked()

    def checked(self) -> None:
        """Wait until all trajectories that have come are checked."""
        self._reached(self.front._trajectories.put)

    def told(self) -> None:
        """Wait until clients have been told of all ends of goals so far: their thread needs real time."""
        self._reached(self.front._goals._work.put)

    @staticmethod
    def _reached(put: Callable[[Callable[[], object]], object]) -> None:
        """Wait until a thread has done what waits for it."""
        done = threading.Event()
        put(done.set)
        assert done.wait(30.0)

    @property
    def positions(self) -> dict[str, float]:
        """Where the shafts really are, radians."""
        return {name: self.where(name) for name in self.arm.settings.model.names}

    def near(self, angles: Mapping[str, float], tolerance: float = 0.03) -> bool:
        return all(math.isclose(angle, self.where(name), abs_tol=tolerance) for name, angle in angles.items())

    def still(self, seconds: float = 0.5) -> dict[str, float]:
        """Where it is, once nothing moves any more."""
        while True:
            before = self.positions
            self.turn(seconds)
            if self.near(before, 0.002):
                return before

    def diagnosed(self, part: str) -> Any:
        """The newest row of a part."""
        message = self.newest("/diagnostics")
        (row,) = [each for each in message.status if each.name == f"{NAME}: {part}"]
        return row


class Goal:
    """A goal that a client has sent; as `tests.ros2.node_world.Goal`."""

    def __init__(self, front: Front, *points: tuple[float, Mapping[str, float]], **fields: Any) -> None:
        self._front, self._at = front, f"/{CONTROLLER}/follow_joint_trajectory/_action"
        make = front.node.types.message
        self.id = make("unique_identifier_msgs/msg/UUID")(uuid=uuid.uuid4().bytes)
        trajectory = make("trajectory_msgs/msg/JointTrajectory")(
            joint_names=list(points[0][1]), points=[front.point(*point) for point in points]
        )
        goal = front.node.types.action(ACTION).goal(trajectory=trajectory, **fields)
        self.accepted = bool(front.call(f"{self._at}/send_goal", goal_id=self.id, goal=goal).accepted)

    def result(self) -> tuple[int, int, str]:
        """Status, error code and text, once it has ended; time passes until then."""
        call = self._front.node.call(f"{self._at}/get_result", goal_id=self.id)

        def answered() -> bool:
            self._front.told()
            return call.response is not None

        self._front.until(answered)
        answer = call.response
        return answer.status, answer.result.error_code, answer.result.error_string


@contextmanager
def running(options: NodeOptions | None = None, **params: object) -> Iterator[Front]:
    """A node that is ready, and ended afterwards.

    Args:
        options: As in `Front`.
        params: Parameters by flat name, with two underscores for each dot.
    """
    with pytest.MonkeyPatch.context() as patch:
        front = Front(patch, {name.replace("__", "."): value for name, value in params.items()}, options)
        try:
            front.open()
            yield front
        finally:
            front.close()
