"""What the node does when something fails: itself, its master, the board, a servo, whoever started it."""

from __future__ import annotations

import json
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.ros1.ros_world import JOINTS, NODE, Arm, PtyBoard, World, free_port, near, still
from tests.waits import until

TARGET = {"J1": 0.6}
SETTINGS = (
    "_allow_partial_joints_goal:=true",
    "_enable_on_start:=true",
    # An emulator and a node of 100 states a second get behind on a busy machine, and what is late looks lost.
    "_publish_rate:=25",
    # A busy machine stalls longer than the usual 1 s.
    "_watchdog:=10.0",
    "_constraints:={goal_time: 3.0, stopped_velocity_tolerance: 0.2}",
)


@pytest.fixture
def own_arm(world: World, tmp_path: Path) -> Iterator[Arm]:
    """An arm and a node that a test may break."""
    namespace = f"own{len(list(world.folder.glob('own*')))}"
    board = PtyBoard(world.folder / namespace)
    try:
        node = world.node(f"__ns:={namespace}", f"_port:={board.port}", *SETTINGS)
        yield Arm(world, node, f"/{namespace}/", board)
        print(world.report())
        node.kill_all()
    finally:
        board.close()


def _moving(arm: Arm) -> None:
    """Begin a motion that takes long."""
    start = arm.board.positions
    arm.send("move", TARGET, 6.0)
    arm.client.wait_active(key="move", feedback=4)
    until(lambda: not near(start, arm.board.positions, 0.02), "it moves", arm.node.report)


def _held(arm: Arm) -> dict[str, float]:
    """The arm stands somewhere on its way, and its servos hold it."""
    stood = still(lambda: arm.board.positions)
    assert not near(TARGET, stood, 0.1)
    assert all(servo.torque_on for servo in arm.board.board.wire.servos)
    return stood


# -- the node ends ---------------------------------------------------------------------------------------------


def test_ended_during_a_move_the_arm_is_held(own_arm: Arm) -> None:
    _moving(own_arm)
    # ROS warns of an action server that is started twice, and of a publisher that waits for its readers.
    assert not [text for text in ("action server", "queue_size") if text in own_arm.node.err]
    own_arm.world.run("rosnode", "kill", f"{own_arm.namespace}hardware_interface")
    assert own_arm.node.wait() == 0
    assert "Traceback" not in own_arm.node.err
    _held(own_arm)
    # Its client hears of it, one way or the other.
    assert own_arm.result("move")["state"] == "ABORTED"


@pytest.mark.slow
def test_newer_node_of_the_same_name_takes_over(own_arm: Arm) -> None:
    _moving(own_arm)
    newer = own_arm.world.node(f"__ns:={own_arm.namespace.strip('/')}", f"_port:={own_arm.board.port}", *SETTINGS)
    assert own_arm.node.wait() == 0
    _held(own_arm)
    assert own_arm.result("move")["state"] == "ABORTED"
    arm = Arm(own_arm.world, newer, own_arm.namespace, own_arm.board)
    arm.trigger("reset")
    arm.enable()
    arm.moves("after", TARGET, 2.0)
    assert newer.end() == 0


# -- the robot fails ------------------------------------------------------------------------------------------


def _published(arm: Arm) -> set[str]:
    return set(arm.position())


def test_servo_lost_at_rest_is_reported_and_the_others_continue(arm: Arm) -> None:
    arm.board.faults("silent:5")
    until(lambda: _published(arm) == set(JOINTS) - {"J6"}, "J6 is left out", arm.node.report)
    arm.diagnosed("J6 (servo 5)", 2)
    arm.board.faults()
    until(lambda: _published(arm) == set(JOINTS), "J6 is back", arm.node.report)
    arm.diagnosed("J6 (servo 5)", 0)


# -- the start fails --------------------------------------------------------------------------------------------


def _one_line(text: str) -> str:
    (line,) = text.splitlines()
    assert line.startswith("error: ")
    return str(line)


@pytest.mark.slow
def test_port_of_another_node_is_left_alone(arm: Arm) -> None:
    second = arm.world.run(*NODE, "__ns:=second", f"_port:={arm.board.port}", "_connect_timeout:=0.2", status=1)
    assert "another" in _one_line(second.err) or "in use" in second.err
    arm.moves("one", {"J1": arm.position()["J1"] + 0.05}, 0.5)


SOON = """
from hexwire.cli import ros1
ros1._find_ros()
from hexwire.ros1 import node
node._MASTER_WAIT = 1.0
ros1.main()
"""
# Waits a second for its master instead of five.
IMPATIENT = (sys.executable, "-c", SOON)


def test_without_a_master_it_ends_with_a_line(world: World) -> None:
    nowhere = f"http://127.0.0.1:{free_port()}"
    program = world.run(*IMPATIENT, f"_port:={world.folder / 'none'}", status=1, ROS_MASTER_URI=nowhere)
    line = _one_line(program.err)
    assert nowhere in line
    assert "roscore" in line


@pytest.mark.slow
def test_a_master_that_never_answers_counts_as_absent(world: World) -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        uri = f"http://127.0.0.1:{mute.getsockname()[1]}"
        program = world.run(*IMPATIENT, f"_port:={world.folder / 'none'}", status=1, ROS_MASTER_URI=uri)
    assert uri in _one_line(program.err)


@pytest.mark.slow
def test_settings_that_ros_does_not_take_end_it_with_a_line(world: World) -> None:
    assert "ROS_MASTER_URI" in _one_line(world.run(*NODE, status=2, ROS_MASTER_URI="nowhere").err)
    assert "{" in _one_line(world.run(*NODE, "__ns:=wrong", "_poses:={", status=2).err)
    assert "namespace" in _one_line(world.run(*NODE, "__ns:=1 x", status=2).err)


@pytest.mark.slow
def test_wrong_parameters_are_reported_at_once_and_forgotten_by_the_master(world: World) -> None:
    port = str(world.folder / "none")
    node = (*NODE, "__ns:=forgotten", f"_port:={port}", "_connect_timeout:=0.2")
    line = _one_line(world.run(*node, "_watchdog:=-1", "_publish_rat:=5", "_joints:=[J9]", status=2).err)
    assert "3 parameters are wrong" in line
    for text in ("~watchdog: -1", "~publish_rat: unknown, did you mean ~publish_rate?", "'J9'"):
        assert text in line
    assert "/forgotten/" not in world.run("rosparam", "list").out
    # The same without the mistakes is not refused, but there is no such port.
    assert port in _one_line(world.run(*node, status=1).err)


ALONE = """
import json, logging
from functools import partial
from types import SimpleNamespace as Made
from hexwire.cli import ros1
ros1._find_ros()
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.teach import Taught
from hexwire.ros1 import node
told = {name: [] for name in ("deleted", "logged", "taught", "followed")}
node.rospy.delete_param = told["deleted"].append
node._delete_params(["_rate:=5", "__ns:=left", "joint_states:=js", "_poses:={"])
handler = node._ToRos()
note = lambda name, text, *said: told["logged"].append([name, text % said])
handler._LEVELS = [(level, partial(note, log.__name__)) for level, log in handler._LEVELS]
node.rospy.logdebug = partial(note, "logdebug")
for level in (logging.CRITICAL, logging.ERROR, logging.WARNING, logging.INFO, logging.DEBUG):
    handler.emit(logging.LogRecord("hexwire", level, "", 0, logging.getLevelName(level), (), None))
desired = Made(position=(0.1,), velocity=(0.2,), acceleration=(0.3,))
asked = []
arm = Made(query=lambda *what: asked.append(what) or desired, controllers={"one": Made(joints=("J1",))})
answer = node.HardwareInterface._query_state(Made(_arm=arm), "one", Made(time=node.rospy.Time(0)))
told["query"] = [answer.name, answer.position, answer.velocity, answer.acceleration]
node.time = Made(monotonic=lambda: 50.0)
node.rospy.rostime.set_rostime_initialized(True)
stamps = []
for now in (0.0, 1.5, 1.75, 1000.0):
    node.rospy.rostime._set_rostime(node.rospy.Time.from_sec(now))
    stamps.append(node._stamp(48.5).to_sec())
told["simulated"] = [stamps, node._stamp(51.0).to_sec()]
node.HardwareInterface._query_state(Made(_arm=arm), "one", Made(time=node.rospy.Time(1002)))
told["asked"] = asked
progress = Made(
    stamp=49.0, names=("J1",), desired=desired, position=(0.4,), velocity=(0.5,), error=(-0.3,)
)
state = node.HardwareInterface._progress(node.control_msgs().JointTrajectoryControllerState, progress)
told["progress"] = [
    [state.header.stamp.to_sec(), state.joint_names],
    [state.desired.positions, state.desired.velocities, state.desired.accelerations],
    [state.actual.positions, state.actual.velocities, state.error.positions, state.error.velocities],
]
streams = []
node.rospy.Subscriber = lambda topic, kind, call, **how: streams.append((topic, call, how))
front = Made(_arm=Made(controllers=()), _joint_commands=Made(follow=told["followed"].append))
front._follow = lambda topic, call: call()
front._on_joint_commands = partial(node.HardwareInterface._on_joint_commands, front)
node.HardwareInterface._offer_controllers(front)
for topic, call, how in streams:
    call([topic, how])
front = Made(_settings=Made(model=HEX7BOT), _taught=Made(publish=told["taught"].append))
node.HardwareInterface._publish_taught(front, Taught(("J1",), (0.0, 2.0), ((0.1,), (0.5,))))
told["taught"] = [
    [message.joint_names, [[point.time_from_start.to_sec(), point.positions] for point in message.points]]
    for message in told["taught"]
]
print(json.dumps(told))
"""


def test_what_the_node_passes_on_without_a_master(world: World) -> None:
    assert json.loads(world.run("env", sys.executable, "-c", ALONE).out) == {
        # Names of the node and remappings are no parameters of a refused command line.
        "deleted": ["~rate", "~poses"],
        "logged": [
            ["logerr", "CRITICAL"],
            ["logerr", "ERROR"],
            ["logwarn", "WARNING"],
            ["loginfo", "INFO"],
            ["logdebug", "DEBUG"],
        ],
        "query": [["J1"], [0.1], [0.2], [0.3]],
        # Now, and two seconds after the time of a simulation.
        "asked": [["one", 0.0], ["one", 2.0]],
        # A sample that is older than the simulation has its present time, and none has a later one.
        "simulated": [[0.0, 1.5, 0.25, 998.5], 1000.0],
        "progress": [[999.0, ["J1"]], [[0.1], [0.2], [0.3]], [[0.4], [0.5], [-0.3], [-0.3]]],
        # Of a stream of set-points only the newest counts.
        "followed": [["joint_commands", {"queue_size": 1, "tcp_nodelay": True}]],
        "taught": [[["J1"], [[0.0, [0.1]], [2.0, [0.5]]]]],
    }


@pytest.mark.slow
def test_an_address_of_another_machine_is_reported(world: World) -> None:
    port = world.folder / "elsewhere"
    board = world.board(port)
    node = world.start(*NODE, "__ns:=elsewhere", f"_port:={port}", ROS_IP="192.0.2.7")
    node.said("no other node can reach this one at http://192.0.2.7:")
    assert node.end() == 0
    board.end()


@pytest.mark.slow
def test_without_a_place_for_log_files_it_still_speaks(world: World) -> None:
    node = (*NODE, "__ns:=silent", f"_port:={world.folder / 'none'}", "_connect_timeout:=3600")
    program = world.start(*node, ROS_LOG_DIR="/proc/none")
    until(lambda: "waiting for it" in program.out, "it speaks", program.report)
    assert program.end() == 0


@pytest.mark.slow
def test_ended_while_it_waits_for_a_board(world: World) -> None:
    node = world.start(*NODE, "__ns:=waits", f"_port:={world.folder / 'none'}", "_connect_timeout:=3600")
    node.said("waiting for it")
    world.run("rosnode", "kill", "/waits/hardware_interface")
    assert node.wait() == 0
    assert "Traceback" not in node.err


@pytest.mark.slow
def test_waits_for_a_board_that_is_plugged_in_later(world: World) -> None:
    port = world.folder / "later"
    node = world.start(*NODE, "__ns:=later", f"_port:={port}", "_connect_timeout:=60")
    node.said("waiting for it")
    world.board(port)
    node.said("is ready at")
    assert node.end() == 0


# -- the master fails -------------------------------------------------------------------------------------------


def test_master_that_hangs_dies_and_is_restarted(own_world: World) -> None:
    """A motion needs no master, nor does the stop at a fault; afterwards everything is registered again."""
    world = own_world
    board = PtyBoard(world.folder / "arm")
    world.client.set_param(name="robot_description", value="<robot/>")
    try:
        node = world.node(f"_port:={board.port}", *SETTINGS)
        arm = Arm(world, node, board=board)
        topics = arm.client.topics()
        _moving(arm)
        world.master.process.send_signal(signal.SIGSTOP)
        try:
            board.faults("silent:0")
            until(lambda: board.board.state.stopped, "the arm is stopped", node.report)
            assert arm.result("move")["state"] == "ABORTED"
        finally:
            world.master.process.send_signal(signal.SIGCONT)
        board.faults()
        until(lambda: set(arm.position()) == set(JOINTS), "J1 is back", node.report)
        arm.trigger("reset")
        # Whether J1 has torque is known again only after where it is.
        arm.enable()
        arm.send("move", TARGET, 4.0)
        arm.client.wait_active(key="move", feedback=4)
        world.master.end()
        world.drop_client()
        until(lambda: near(TARGET, board.positions), "it is there", node.report)
        world.master = world.start_master()
        assert world.master.running
        ours = [row for row in topics if "somebody" not in row[0] and "rosout" not in row[0]]
        until(lambda: all(row in arm.client.topics() for row in ours), "topics are back", node.report)
        assert arm.client.get_param(name="/hardware_interface/port") == board.port
        assert arm.client.get_param(name="/robot_description") == "<robot/>"
        assert near(arm.position(), board.positions)
        arm.trigger("stop")
        arm.trigger("reset")
        arm.moves("back", {"J1": 0.3}, 3.0)
        assert node.end() == 0
    finally:
        board.close()


def test_master_that_forgot_a_service_is_told_again(arm: Arm) -> None:
    arm.client.forget(node="/hardware_interface", service=arm.service("stop"))
    assert arm.trigger("stop")
