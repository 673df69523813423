"""The ROS 2 node `hardware_interface`: passes messages between ROS and `hexwire.control`.

Owns topics, services and actions, and the node's start and shutdown. Must not decide anything about the arm:
`control` does.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from hexwire.control.loop.workers import Worker
from hexwire.control.requests.arm_node import ArmNode
from hexwire.control.requests.set_point_stream import SetPointStream
from hexwire.errors import DeviceError, HexwireError
from hexwire.model.geometry import make_shapes
from hexwire.model.urdf import make_urdf
from zenoh_ros2 import (
    LATCHED,
    ActionServer,
    Deferred,
    Descriptor,
    Inbox,
    Lifecycle,
    Node,
    NodeOptions,
    ParameterServer,
    Publisher,
    Qos,
    Reliability,
    Role,
    State,
    Types,
    nanoseconds_of,
)

from . import arm_lifecycle
from .actions import FOLLOW_JOINT_TRAJECTORY, ActionClient, ActionGoals
from .reports import (
    CONTROLLER_STATE,
    DIAGNOSTICS,
    JOINT_STATE,
    TRAJECTORY,
    TRANSFORMS,
    Reports,
    Transforms,
)
from .ros_clock import RosClock
from .settings import NodeSettings, changed, descriptor_of
from .values import ARRAY, delay_of, of_array, of_joint_state, trajectory_of

if TYPE_CHECKING:
    from hexwire.control.loop.controller import TrajectoryController
    from hexwire.control.loop.known_state import KnownState
    from hexwire.control.loop.outcomes import Progress
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught


__all__ = ["NAME", "HardwareInterface"]

_log = logging.getLogger(__name__)

NAME = "hardware_interface"
"""Name of the node, if it is not remapped."""
COMMANDS = "forward_position_controller/commands"
"""Topic of set-points, named as the usual forward command controller for positions."""
WITH_GAINS, JOINT_COMMANDS = "joint_commands", "osrf_msgs/msg/JointCommands"
"""Topic and type of set-points with gains, as in ROS 1."""

CLOCK, STRING = "rosgraph_msgs/msg/Clock", "std_msgs/msg/String"
TRIGGER, SWITCH, QUERY = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool", "control_msgs/srv/QueryTrajectoryState"

_TICK = 0.2
"""Seconds between two looks at what changes seldom."""
_RESULTS_WAIT = 0.2
"""Seconds to wait until the last results are on their way."""
_LOOK_AROUND = 1.0
"""Seconds in which another node of the same name is found, or has vanished."""
_TRAJECTORIES = 10
"""Trajectories that may wait for their path check."""
_MOST_CALLS = 16
"""Services that may be at work at the same time."""
_MOST_PASSED = 1000
"""Stops that have gone ahead of what still waits."""
_NEWEST = Qos(depth=1)
_CLOCK_QOS = Qos(depth=1, reliability=Reliability.BEST_EFFORT)
_CLOSE_WAIT = 1.0


class HardwareInterface(ArmNode[ActionGoals]):
    """The node. `run` is its main loop; most other methods are callbacks.

    Args:
        options: Name, namespace, remapping rules and Zenoh's settings.
        settings: The node's parameters.
        robot: Not attached.
    """

    def __init__(self, options: NodeOptions, settings: NodeSettings, robot: RobotDriver) -> None:
        self._settings = settings
        self._types = types = Types(settings.distribution)
        self._reports = Reports(types)
        self._node = Node(options, types)
        super().__init__(robot, settings.arm, settings.own["diagnostics_rate"])
        self._clock = RosClock(time.time_ns, time.monotonic, simulated=settings.use_sim_time)
        self._goals = ActionGoals(self._arm, types.action(FOLLOW_JOINT_TRAJECTORY).result, self._clock.now)
        self._commands = SetPointStream(self._arm)
        self._trajectories = Worker("trajectories", _TRAJECTORIES)
        self._passed: Inbox[None] = self._node.callbacks.inbox(_MOST_PASSED, lambda _: self._arm.void())
        self._calls = threading.BoundedSemaphore(_MOST_CALLS)
        self._stop_calls = threading.BoundedSemaphore(_MOST_CALLS)
        self._states: dict[str, Publisher] = {}
        self._frames: Transforms | None = None
        self._for_manager: Publisher | None = None
        self._tf: Publisher | None = None
        self._lifecycle: Lifecycle | None = None

    def run(self) -> int:
        """Connect, offer topics, services and actions, and run until a signal ends it; returns the exit status.

        Raises:
            LinkError: The robot's port cannot be opened.
            RosError: The Zenoh session cannot be opened.
            DeviceError: The robot does not answer, another node has this name, or the node failed.
        """
        odd = list(self._settings.warnings)
        if self._settings.use_sim_time:
            odd.append("use_sim_time is set: stamps come from /clock, but the arm runs in real time")
        self._listen(odd)
        try:
            with self._opened_node():
                return self._serve()
        except KeyboardInterrupt:
            return 0

    @contextmanager
    def _opened_node(self) -> Iterator[None]:
        try:
            self._node.open()
            yield
        finally:
            self._node.close()

    def _serve(self) -> int:
        try:
            self._refuse_namesake()
            self._offer_topics()
            self._offer_parameters()
            carry_out, present = (
                partial(arm_lifecycle.carry_out, self._arm),
                partial(arm_lifecycle.state_of, self._arm),
            )
            self._lifecycle = Lifecycle(self._node, self._types, carry_out, present, HexwireError)
            self._arm.connect()
            self._shutdown.interrupts = False
            # Once more: it takes a moment until all others are known.
            self._refuse_namesake()
            self._offer_controllers()
            self._goals.start()
            self._arm.start()
            self._offer_services()
            _log.info("%s is ready at %s", self._settings.arm.model.name, self._settings.arm.port)
            while not self._shutdown.wait(_TICK):
                self._tick()
        finally:
            had_goals = self._make_safe(_CLOSE_WAIT)
            self._trajectories.close(_CLOSE_WAIT)
            if self._lifecycle is not None:
                self._lifecycle.mirror(State.FINALIZED)
            if had_goals:
                time.sleep(_RESULTS_WAIT)
        return 0

    def _refuse_namesake(self) -> None:
        """Two nodes of one name would both follow what is meant for one."""
        deadline = time.monotonic() + _LOOK_AROUND
        while self._namesakes():
            if time.monotonic() >= deadline:
                name = self._node.full_name
                raise DeviceError(
                    f"there is a node {name} already; end it, or give this one another namespace: "
                    "--ros-args -r __ns:=/NAMESPACE"
                )
            time.sleep(_TICK)

    def _namesakes(self) -> int:
        mine = self._node.namespace, self._node.name
        found = [each for each in self._node.graph.find(Role.NODE) if (each.namespace, each.node) == mine]
        return len(found) - 1

    def _tick(self) -> None:
        if (due := self._diagnostics_due()) is not None:
            rows, url = due
            hardware_id = self._settings.own["hardware_id"] or url
            self._diagnostics.publish(
                self._reports.diagnostics(rows, self._clock.now() / 1e9, self._node.name, hardware_id)
            )
        for name, publisher in self._states.items():
            self._arm.controllers[name].monitored = publisher.has_readers
        if self._lifecycle is not None:
            self._lifecycle.mirror(arm_lifecycle.state_of(self._arm))

    # -- topics, services, actions --------------------------------------------------------------------

    def _offer_topics(self) -> None:
        node, own = self._node, self._settings.own
        if self._clock.simulated:
            node.subscribe("/clock", CLOCK, self._on_clock, _CLOCK_QOS)
        self._joint_states = node.publisher("joint_states", JOINT_STATE)
        if own["joint_states_topic"]:
            self._for_manager = node.publisher(own["joint_states_topic"], JOINT_STATE)
        self._diagnostics = node.publisher("/diagnostics", DIAGNOSTICS)
        self._taught = node.publisher("~/taught", TRAJECTORY, LATCHED)
        kinematics = self._settings.arm.kinematics
        text = own["robot_description"] or ("" if kinematics is None else make_urdf(kinematics))
        if text and own["publish_robot_description"]:
            description = node.publisher("robot_description", STRING, LATCHED)
            description.publish(self._types.message(STRING)(data=text))
        if own["publish_tf"] and kinematics is not None:
            self._frames = Transforms(self._types, make_shapes(kinematics))
            self._tf = node.publisher("/tf", TRANSFORMS, Qos(depth=100))
            fixed = node.publisher("/tf_static", TRANSFORMS, LATCHED)
            fixed.publish(self._frames.fixed(self._reports.stamp(self._clock.now() / 1e9)))

    def _offer_parameters(self) -> None:
        server = ParameterServer(
            self._node,
            self._types,
            on_set=self._on_parameters,
            ros_time=self._clock.now,
            refused_by=HexwireError,
        )
        settings = self._settings
        for name, value in settings.flat().items():
            row, read_only = settings.row(name), not settings.may_change(name)
            said = Descriptor(read_only=read_only) if row is None else descriptor_of(row, read_only=read_only)
            server.declare(name, value, said)
        server.offer()

    def _on_parameters(self, changes: Mapping[str, object]) -> None:
        settings = changed(self._settings, changes)
        self._arm.adopt(settings.arm)
        self._settings = settings
        self._watch.period = 1.0 / settings.own["diagnostics_rate"]

    def _offer_controllers(self) -> None:
        node = self._node
        node.tell_type(self._types.action(FOLLOW_JOINT_TRAJECTORY))
        for name in self._arm.controllers:
            at = self._settings.topic(name)
            self._states[name] = node.publisher(f"{at}/controller_state", CONTROLLER_STATE)
            node.subscribe(f"{at}/joint_trajectory", TRAJECTORY, partial(self._on_trajectory, name))
            ActionServer(
                node,
                self._types,
                f"{at}/follow_joint_trajectory",
                FOLLOW_JOINT_TRAJECTORY,
                on_goal=partial(self._goals.on_goal, name),
                on_cancel=partial(self._goals.on_cancel, name),
                ros_time=self._clock.now,
            )
            node.service(f"{at}/query_state", QUERY, partial(self._query_state, name))
        node.subscribe(COMMANDS, ARRAY, self._on_commands, _NEWEST)
        topic = self._settings.own["joint_commands_topic"]
        if topic:
            node.subscribe(topic, JOINT_STATE, partial(self._on_joint_commands, topic), _NEWEST)
        if topic != WITH_GAINS:
            node.subscribe(WITH_GAINS, JOINT_COMMANDS, self._on_with_gains, _NEWEST)

    def _offer_services(self) -> None:
        node = self._node
        for name, call in self._requests().items():
            node.service(f"~/{name}", TRIGGER, partial(self._on_trigger, call))
        node.service("~/enable", SWITCH, self._on_enable)
        node.service("~/stop", TRIGGER, self._on_stop, urgent=True)

    def _on_stop(self, request: Any) -> Any:
        response = self._types.service(TRIGGER).response
        # What arrived before it may still wait to be read.
        self._passed.put(None)
        # One stop answers all who ask before it begins; whether this one is answered or not.
        stopped = self._stops.ask("requested by service")
        busy = "so many stop the arm that this is not answered; it is being stopped"
        return self._in_turn(response, partial(self._stopped, stopped), self._stop_calls, busy)

    def _on_trigger(self, call: Callable[[Token], str], request: Any) -> Any:
        response = self._types.service(TRIGGER).response
        return self._in_turn(response, partial(call, self._arm.mark()))

    def _on_enable(self, request: Any) -> Any:
        response = self._types.service(SWITCH).response
        return self._in_turn(response, partial(self._arm.enable, request.data, self._arm.mark()))

    def _in_turn(
        self,
        response: Callable[..., Any],
        call: Callable[[], str],
        calls: threading.BoundedSemaphore | None = None,
        busy: str = "the node is busy with other services; try again",
    ) -> Any:
        """Answer later, unless too many services are at work."""
        calls = calls or self._calls
        if not calls.acquire(blocking=False):
            return response(success=False, message=busy)

        def work() -> str:
            try:
                return call()
            finally:
                calls.release()

        return self._answer_later(response, work)

    def _answer_later(self, response: Callable[..., Any], call: Callable[[], str]) -> Deferred:
        """Answer in a thread of its own, since the call waits for the arm."""
        answer = Deferred()

        def work() -> None:
            try:
                success, message = self._outcome(call)
                answer.answer(response(success=success, message=message))
            except Exception as error:  # noqa: BLE001  # logged, and told to the client
                # The client must get an answer.
                _log.exception("a service failed")
                answer.answer(response(success=False, message=f"the node failed: {error!r}"))

        threading.Thread(target=work, name="service", daemon=True).start()
        return answer

    def _query_state(self, name: str, request: Any) -> Any:
        response = self._types.service(QUERY).response
        try:
            desired = self._arm.query(name, delay_of(request.time, self._clock.now()))
        except HexwireError as error:
            return response(success=False, message=str(error))
        return response(
            success=True,
            name=self._arm.controllers[name].joints,
            position=desired.position,
            velocity=desired.velocity,
            acceleration=desired.acceleration,
        )

    def _on_clock(self, message: Any, sent: int) -> None:
        self._clock.take(nanoseconds_of(message.clock))

    # -- commands -------------------------------------------------------------------------------------

    def _on_trajectory(self, name: str, message: Any, sent: int) -> None:
        topic = f"{self._settings.topic(name)}/joint_trajectory"
        now, received, asked = self._clock.now(), self._arm.owner.now(), self._arm.mark()

        def follow() -> None:
            goal = partial(trajectory_of, message, now)
            self._follow(topic, lambda: self._arm.command(name, goal(), received=received, asked=asked))

        # Reading a long one takes long, and its path check longer.
        if not self._trajectories.put(follow):
            self._warn(f"{topic} refused: too many trajectories wait for their check")

    def _on_commands(self, message: Any, sent: int) -> None:
        joints = [joint for controller in self._arm.controllers.values() for joint in controller.joints]
        self._follow(COMMANDS, lambda: self._commands.follow(of_array(message, joints), sent / 1e9))

    def _on_with_gains(self, message: Any, sent: int) -> None:
        self._follow(WITH_GAINS, lambda: self._joint_commands.follow(message, sent / 1e9))

    def _on_joint_commands(self, topic: str, message: Any, sent: int) -> None:
        def follow() -> None:
            if positions := of_joint_state(message):
                self._arm.set_points(positions, near=self._settings.near)

        self._follow(topic, follow)

    # -- publishing -----------------------------------------------------------------------------------

    def _publish_state(self, state: JointState, published: KnownState) -> None:
        own = self._settings.own
        wall = self._clock.stamp(state.stamp - published.age)
        # For every state: nothing is made that nobody reads, and the same bytes go to both topics.
        both = self._joint_states, self._for_manager
        readers = [publisher for publisher in both if publisher is not None and publisher.has_readers]
        if readers:
            payload = self._reports.joint_state(published, wall, own["frame_id"])
            for publisher in readers:
                publisher.publish_serialized(payload)
        if self._tf is not None and self._frames is not None and self._tf.has_readers:
            positions = dict(zip(published.names, published.position, strict=True))
            self._tf.publish(self._frames.moving(positions, self._reports.stamp(wall)))
        self._publish_progress(own["state_publish_rate"], own["action_monitor_rate"])

    def _publish_controller(self, name: str, controller: TrajectoryController, progress: Progress) -> None:
        publisher = self._states.get(name)
        if publisher is not None and publisher.has_readers:
            wall, elapsed = self._clock.stamp(progress.stamp), progress.stamp - controller.begins
            publisher.publish(self._reports.controller_state(progress, wall, elapsed))

    def _publish_feedback(self, client: ActionClient, progress: Progress, elapsed: float) -> None:
        wall, goal = self._clock.stamp(progress.stamp), client.handle.goal
        client.handle.publish_feedback(self._reports.feedback(progress, wall, goal, elapsed))

    def _publish_taught(self, taught: Taught) -> None:
        self._taught.publish(self._reports.taught(taught, self._settings.arm.model))
