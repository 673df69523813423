"""The ROS 1 node `hardware_interface`: passes messages between ROS and `hexwire.control`.

Owns topics, services, actions, the parameter server, and the node's start and shutdown. The only module that
imports rospy. Must not decide anything about the arm: `control` does.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.client import HTTPException
from logging.handlers import QueueHandler, QueueListener
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from xmlrpc.client import Error as XmlRpcError

import actionlib
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rosgraph.roslogging import RosStreamHandler
from rospy.impl import registration
from rospy.impl.rosout import RosOutHandler
from sensor_msgs.msg import JointState as JointStateMessage
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hexwire.control.loop.stamps import StampClock
from hexwire.control.requests.arm_node import ArmNode
from hexwire.control.requests.diagnostics import Row, RowLevel
from hexwire.control.requests.teach_mode import to_points, tolerance_of
from hexwire.errors import DeviceError, HexwireError, UsageError

from .actions import ActionClient, ActionGoals
from .messages import control_msgs, control_srvs, osrf_msgs
from .parameters import load_parameters
from .values import trajectory_of

if TYPE_CHECKING:
    from hexwire.control.loop.controller import TrajectoryController
    from hexwire.control.loop.known_state import KnownState
    from hexwire.control.loop.outcomes import Progress
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught


__all__ = ["run"]

# Not rospy's log functions: a line to /rosout calls the master, and no thread that the arm needs may wait for it.
_log = logging.getLogger(__name__)

_NAME = "hardware_interface"
_MASTER_WAIT, _MASTER_PERIOD = 5.0, 1.0
_TICK = 0.1
_MASTER_TROUBLE = (OSError, HTTPException, XmlRpcError, rosgraph.MasterException, rospy.ROSException)
"""Errors of calls to a master that is not running, or to another program at its address."""
_SHUTDOWN_WAIT = 15.0
_RESULTS_WAIT = 0.2
"""Seconds to wait until the last results are sent: rospy sends in its own threads, and drops what is queued."""
_ADDRESS_WAIT = 2.0
_QUEUE = 10
_LEVELS = {
    RowLevel.OK: DiagnosticStatus.OK,
    RowLevel.WARNING: DiagnosticStatus.WARN,
    RowLevel.ERROR: DiagnosticStatus.ERROR,
    RowLevel.STALE: DiagnosticStatus.STALE,
}


def run(argv: list[str]) -> int:
    """Run the node until a signal or ROS ends it.

    Args:
        argv: ROS remapping arguments, without the program's name.

    Returns:
        Exit status.

    Raises:
        UsageError: Parameters are wrong, and the text names the first ones; or ROS settings are wrong.
        LinkError: The robot's port cannot be opened.
        DeviceError: There is no master, the robot does not answer, or the node failed.
    """
    _wait_for_master()
    # A reader of a pipe or a file needs each line at once.
    with suppress(AttributeError):
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # not every stream has it
    _init_node(argv)
    with _logging_to_ros():
        try:
            try:
                node = HardwareInterface()
            except UsageError:
                _delete_params(argv)
                raise
            return node.run()
        finally:
            rospy.signal_shutdown("the node has ended")


class HardwareInterface(ArmNode[ActionGoals]):
    """The node. `run` is its main loop; most other methods are callbacks."""

    def __init__(self) -> None:
        self._given = rospy.get_param("~", {})
        self._description = rospy.get_param("robot_description", None)
        self._parameters, robot = load_parameters(self._given)
        self._settings = self._parameters.settings
        super().__init__(robot, self._settings, self._parameters.diagnostics_rate)
        self._states: dict[str, rospy.Publisher] = {}
        self._servers: list[actionlib.ActionServer] = []
        self._ended = threading.Event()
        self._control = control_msgs()
        self._goals = ActionGoals(self._arm, self._control.FollowJointTrajectoryResult, rospy.Time.now)

    def run(self) -> int:
        """Connect, offer topics, services and actions, and run until the shutdown."""
        odd = list(self._parameters.warnings)
        if rospy.get_param("/use_sim_time", False):
            odd.append("use_sim_time is set: stamps come from /clock, but the arm runs in real time")
        self._listen(odd)
        rospy.on_shutdown(self._on_ros_shutdown)
        try:
            self._joint_states = rospy.Publisher("joint_states", JointStateMessage, queue_size=_QUEUE)
            self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=_QUEUE)
            self._taught = rospy.Publisher("~taught", JointTrajectory, queue_size=1, latch=True)
            self._arm.connect()
            self._shutdown.interrupts = False
            self._offer_controllers()
            self._goals.start()
            self._arm.start()
            self._offer_services()
            threading.Thread(target=self._watch_master, name="master", daemon=True).start()
            _log.info("%s is ready at %s", self._settings.model.name, self._settings.port)
            while not self._shutdown.wait(_TICK) and not rospy.is_shutdown():
                self._tick()
        except KeyboardInterrupt:
            return 0
        finally:
            if self._make_safe(_RESULTS_WAIT):
                time.sleep(_RESULTS_WAIT)
            for server in self._servers:
                # Otherwise its timer publishes to a closed topic, which prints a traceback.
                with server.lock:
                    server.started = False
            self._ended.set()
        return 0

    def _on_ros_shutdown(self) -> None:
        """Shut down for ROS, as after `rosnode kill` or for a newer node with our name.

        ROS closes the topics when this returns.
        """
        if threading.current_thread() is not threading.main_thread():
            _leave_rosout()
            os.kill(os.getpid(), signal.SIGTERM)
            self._ended.wait(_SHUTDOWN_WAIT)

    def _tick(self) -> None:
        if (due := self._diagnostics_due()) is not None:
            rows, url = due
            message = DiagnosticArray()
            message.header.stamp = rospy.Time.now()
            message.status = [self._status(row, self._parameters.hardware_id or url) for row in rows]
            self._diagnostics.publish(message)

    @staticmethod
    def _status(row: Row, hardware_id: str) -> Any:
        """A row as a DiagnosticStatus according to REP-107."""
        return DiagnosticStatus(
            level=_LEVELS[row.level],
            name=f"{rospy.get_name().strip('/')}: {row.name}",
            message=row.text,
            hardware_id=hardware_id,
            values=[KeyValue(key, value) for key, value in row.values],
        )

    # -- topics, services, actions --------------------------------------------------------------------

    def _offer_controllers(self) -> None:
        for name in self._arm.controllers:
            at = f"{name}/" if name else ""
            self._states[name] = rospy.Publisher(
                f"{at}state", self._control.JointTrajectoryControllerState, queue_size=_QUEUE
            )
            rospy.Subscriber(
                f"{at}command",
                JointTrajectory,
                partial(self._on_command, name),
                queue_size=_QUEUE,
                tcp_nodelay=True,
            )
            server = actionlib.ActionServer(
                f"{at}follow_joint_trajectory",
                self._control.FollowJointTrajectoryAction,
                partial(self._goals.on_goal, name),
                partial(self._goals.on_cancel, name),
                auto_start=False,
            )
            server.start()
            self._servers.append(server)
            rospy.Service(f"{at}query_state", control_srvs().QueryTrajectoryState, partial(self._query_state, name))
        rospy.Subscriber(
            "joint_commands", osrf_msgs().JointCommands, self._on_joint_commands, queue_size=1, tcp_nodelay=True
        )

    def _offer_services(self) -> None:
        mark, stop = self._arm.mark, partial(self._stops.ask, "requested by service")
        calls = {name: lambda call=call: call(mark()) for name, call in self._requests().items()}
        for name, call in {"stop": lambda: self._stopped(stop()), **calls}.items():
            rospy.Service(f"~{name}", Trigger, lambda _, call=call: TriggerResponse(*self._outcome(call)))
        rospy.Service(
            "~enable",
            SetBool,
            lambda asked: SetBoolResponse(*self._outcome(partial(self._arm.enable, asked.data, mark()))),
        )

    def _query_state(self, name: str, request: Any) -> Any:
        # A time of zero means now, as in a stamp.
        delay = 0.0 if request.time.is_zero() else (request.time - rospy.Time.now()).to_sec()
        try:
            desired = self._arm.query(name, delay)
        except HexwireError as error:
            raise rospy.ServiceException(str(error)) from None
        return control_srvs().QueryTrajectoryStateResponse(
            name=self._arm.controllers[name].joints,
            position=desired.position,
            velocity=desired.velocity,
            acceleration=desired.acceleration,
        )

    # -- commands -------------------------------------------------------------------------------------

    def _on_command(self, name: str, message: Any) -> None:
        self._follow("command", lambda: self._arm.command(name, trajectory_of(message, rospy.Time.now())))

    def _on_joint_commands(self, message: Any) -> None:
        self._follow("joint_commands", lambda: self._joint_commands.follow(message))

    # -- publishing -----------------------------------------------------------------------------------

    def _publish_state(self, state: JointState, published: KnownState) -> None:
        message = JointStateMessage()
        message.header.stamp = _stamp(state.stamp - published.age)
        message.header.frame_id = self._parameters.frame_id
        message.name = published.names
        message.position = published.position
        message.velocity = published.velocity
        self._joint_states.publish(message)
        self._publish_progress(self._parameters.state_publish_rate, self._parameters.action_monitor_rate)

    def _publish_controller(self, name: str, controller: TrajectoryController, progress: Progress) -> None:
        publisher = self._states.get(name)
        if publisher is not None and publisher.get_num_connections():
            publisher.publish(self._progress(self._control.JointTrajectoryControllerState, progress))

    def _publish_feedback(self, client: ActionClient, progress: Progress, elapsed: float) -> None:
        client.handle.publish_feedback(self._progress(self._control.FollowJointTrajectoryFeedback, progress))

    @staticmethod
    def _progress(kind: Any, progress: Progress) -> Any:
        message = kind()
        message.header.stamp = _stamp(progress.stamp)
        message.joint_names = progress.names
        message.desired = JointTrajectoryPoint(
            positions=progress.desired.position,
            velocities=progress.desired.velocity,
            accelerations=progress.desired.acceleration,
        )
        message.actual = JointTrajectoryPoint(positions=progress.position, velocities=progress.velocity)
        message.error = JointTrajectoryPoint(
            positions=progress.error,
            velocities=[d - v for d, v in zip(progress.desired.velocity, progress.velocity, strict=True)],
        )
        return message

    def _publish_taught(self, taught: Taught) -> None:
        message = JointTrajectory(joint_names=taught.names)
        message.points = [
            JointTrajectoryPoint(positions=point.positions, time_from_start=rospy.Duration.from_sec(point.time))
            for point in to_points(taught, tolerance_of(self._settings.model))
        ]
        self._taught.publish(message)

    # -- the master -----------------------------------------------------------------------------------

    def _watch_master(self) -> None:
        """Register again after a restart of the master, which rospy does not do."""
        _check_own_address()
        master = rosgraph.Master(rospy.get_name())
        # Neither the master's process id (the same again in a container) nor our name (registered by each log line)
        # shows a restart; a service does.
        service = rospy.resolve_name("~stop")
        while not self._shutdown.wait(_MASTER_PERIOD):
            with suppress(*_MASTER_TROUBLE):
                try:
                    master.lookupService(service)
                except rosgraph.MasterError:
                    if not self._shutdown.requested and not _replaced(master):
                        self._register_again()

    def _register_again(self) -> None:
        _log.warning("the master does not know this node, was it restarted? Registering everything again")
        rospy.set_param("~", self._given)
        if self._description is not None and not rospy.has_param("robot_description"):
            rospy.set_param("robot_description", self._description)
        topics, services = registration.get_topic_manager(), registration.get_service_manager()
        kinds = registration.Registration
        for kind, rows in (
            (kinds.PUB, topics.get_publications()),
            (kinds.SUB, topics.get_subscriptions()),
            (kinds.SRV, services.get_services()),
        ):
            for name, what in rows:
                registration.get_registration_listeners().notify_added(name, what, kind)


_STAMPS = StampClock(time.time, time.monotonic)


def _stamp(moment: float) -> Any:
    """ROS time of a monotonic time."""
    if rospy.rostime.is_wallclock():
        return rospy.Time.from_sec(_STAMPS.stamp(moment))
    # Simulated time runs at its own rate, or stands still.
    now = rospy.Time.now()
    ago = rospy.Duration.from_sec(max(0.0, time.monotonic() - moment))
    return now - ago if now > rospy.Time(ago.secs, ago.nsecs) else now


def _wait_for_master() -> None:
    # rospy would wait for it forever, without a message.
    uri = rosgraph.get_master_uri()
    deadline = time.monotonic() + _MASTER_WAIT
    # A program may accept the connection and never answer.
    socket.setdefaulttimeout(_MASTER_WAIT)
    try:
        while not rosgraph.is_master_online():
            if time.monotonic() >= deadline:
                raise DeviceError(f"no ROS master at {uri}; start roscore, or set ROS_MASTER_URI to where it runs")
            time.sleep(_TICK)
    except ValueError:
        text = f"ROS_MASTER_URI is {uri!r}, not a URI such as http://localhost:11311"
        raise UsageError(text) from None
    finally:
        socket.setdefaulttimeout(None)


def _init_node(argv: list[str]) -> None:
    if not rosgraph.names.is_legal_name(rospy.get_namespace()):
        raise UsageError(f"{rospy.get_namespace()!r} is not a ROS namespace; use letters, digits and underscores")
    try:
        # This node handles signals: rospy's handlers would close the topics before the arm is safe.
        rospy.init_node(_NAME, argv=["hexwire-ros1", *argv], disable_signals=True)
    except TypeError:
        # rospy reads values as YAML, where `zenoh:` is a table with an empty value.
        raise UsageError("ROS rejects these arguments: a value ends in a colon or has an empty element") from None
    except (ValueError, rospy.ROSException) as error:
        raise UsageError(f"ROS rejects these arguments: {' '.join(str(error).split())}") from None
    logger = logging.getLogger("rosout")
    # If ROS cannot write its log files, it does not log to the screen either.
    if not any(isinstance(handler, RosStreamHandler) for handler in logger.handlers):
        logger.addHandler(RosStreamHandler())
        logger.setLevel(logging.INFO)


def _delete_params(argv: list[str]) -> None:
    """Delete parameters set by a refused command line: the master would keep them for the next start."""
    for name in (arg.partition(":=")[0] for arg in argv):
        if name.startswith("_") and not name.startswith("__"):
            with suppress(KeyError, *_MASTER_TROUBLE):
                rospy.delete_param(f"~{name[1:]}")


def _check_own_address() -> None:
    """Warn if other nodes cannot connect to the address that this node registered, as with a wrong ROS_IP."""
    uri = rospy.get_node_uri()
    parts = urlsplit(uri)
    try:
        socket.create_connection((parts.hostname, parts.port), _ADDRESS_WAIT).close()
    except (OSError, ValueError):
        _log.warning("no other node can reach this one at %s; set ROS_IP to an address of this machine", uri)


class _ToRos(logging.Handler):
    """Passes hexwire's log records to ROS."""

    _LEVELS = ((logging.ERROR, rospy.logerr), (logging.WARNING, rospy.logwarn), (logging.INFO, rospy.loginfo))

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        log = next((log for level, log in self._LEVELS if record.levelno >= level), rospy.logdebug)
        log("%s", text)


@contextmanager
def _logging_to_ros() -> Iterator[None]:
    logger = logging.getLogger("hexwire")
    # In a separate thread: a line to /rosout calls the master, and the arm must not wait for a master.
    lines: queue.SimpleQueue[logging.LogRecord | None] = queue.SimpleQueue()
    listener, handler = QueueListener(lines, _ToRos()), QueueHandler(lines)
    before = logger.level, logger.propagate
    logger.addHandler(handler)
    # Otherwise rospy's root handler writes each record to its file a second time.
    logger.propagate = False
    logger.setLevel(logging.INFO)
    listener.start()
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.level, logger.propagate = before
        listener.stop()


def _replaced(master: Any) -> bool:
    """Whether a newer node has our name. Registering again would end it; the master will shut this one down."""
    try:
        return bool(master.lookupNode(rospy.get_name()) != rospy.get_node_uri())
    except rosgraph.MasterError:
        return False


def _leave_rosout() -> None:
    """Stop logging to /rosout: each line registers this node, and the master would end a newer node of our name."""
    logger = logging.getLogger("rosout")
    for handler in list(logger.handlers):
        if isinstance(handler, RosOutHandler):
            logger.removeHandler(handler)
