"""What the node passes between ROS and the arm, in simulated time: everything of it but Zenoh and the process."""

from __future__ import annotations

import json
import logging
import math
import threading
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.control.arm_bench import guide
from tests.motion.arms import HOME, NAMES
from tests.ros2.front_bench import CONTROLLER, TICK, WALL, Front, Goal, running

from hexwire.errors import DeviceError
from hexwire.ros2.hardware_interface import NAME
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.names import parse_remap
from zenoh_ros2.node import NodeOptions
from zenoh_ros2.qos import Reliability

AT = f"/{CONTROLLER}"
ACTION = f"{AT}/follow_joint_trajectory/_action"
STREAM = "/forward_position_controller/commands"
POSES = {f"poses__home__{name}": angle for name, angle in {"J1": -0.087, "J2": 0.96, "J3": -0.044}.items()}


@pytest.fixture
def front() -> Iterator[Front]:
    with running(allow_partial_joints_goal=True, hardware_id="arm-7", **POSES) as front:
        front.enable()
        yield front


def aside(front: Front, angle: float = 0.2) -> dict[str, float]:
    return {"J1": front.where("J1") + angle}


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


# -- what is published ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", ["/joint_states", "/robot_joint_states"])
def test_joint_states_have_the_stamps_of_their_samples(front: Front, topic: str) -> None:
    before = len(front.topic(topic).sent)
    front.turn(1.0)
    messages = front.topic(topic).sent[before:]
    assert 95 <= len(messages) <= 101
    assert all(tuple(message.name) == NAMES for message in messages)
    assert all(len(m.position) == len(m.velocity) == len(NAMES) and not m.effort for m in messages)
    stamps = [seconds(message.header.stamp) for message in messages]
    assert {round(b - a, 3) for a, b in pairwise(stamps)} == {0.01}
    assert 0.0 <= front.now_ns() * 1e-9 - stamps[-1] < 0.03
    assert front.near(dict(zip(NAMES, messages[-1].position, strict=True)), 0.002)


def test_the_stamp_of_a_state_is_that_of_its_newest_sample(front: Front) -> None:
    told: list[Any] = []
    front.owner._on_state = lambda state, published: told.append((state, published))
    front.until(lambda: told)
    state, published = told[-1]
    for age in (0.0, 0.125):
        front.front._publish_state(state, replace(published, age=age))
        stamp = seconds(front.topic("/joint_states").sent[-1].header.stamp)
        assert stamp == pytest.approx(WALL + state.stamp - age, abs=1e-3), f"{age} s old"


@pytest.mark.slow
def test_nothing_is_made_that_nobody_reads(front: Front) -> None:
    states, other = front.topic("/joint_states"), front.topic("/robot_joint_states")
    states.has_readers = False
    before, others = len(states.sent), len(other.sent)
    front.turn(0.5)
    assert len(states.sent) == before
    assert len(other.sent) > others + 40
    controller = front.topic(f"{AT}/controller_state")
    controller.has_readers = False
    before = len(controller.sent)
    front.turn(0.5)
    assert len(controller.sent) == before


@pytest.mark.slow
def test_the_state_of_the_controller_says_what_is_wanted_and_what_is(front: Front) -> None:
    goal = Goal(front, (2.0, aside(front, 0.5)))
    assert goal.accepted
    front.turn(1.0)
    state, said = front.topic(f"{AT}/controller_state").sent[-1], front.topic("/joint_states").sent[-1]
    assert tuple(state.joint_names) == NAMES
    assert list(state.feedback.positions) == pytest.approx(list(said.position), abs=0.03)
    for wanted, seen, off in zip(
        state.reference.positions, state.feedback.positions, state.error.positions, strict=True
    ):
        assert off == pytest.approx(wanted - seen, abs=1e-9)
    assert 0.7 < seconds(state.reference.time_from_start) < 1.2
    # 50 a second, where joint states come 100 times.
    count = len(front.topic(f"{AT}/controller_state").sent)
    front.turn(1.0)
    assert len(front.topic(f"{AT}/controller_state").sent) == pytest.approx(count + 50, abs=2)


def test_whoever_comes_late_gets_the_description() -> None:
    with running(publish_tf=True) as front:
        (message,) = front.topic("/robot_description").sent
        assert front.topic("/robot_description").qos.latched
        assert message.data.startswith("<?xml")
        assert all(f'<joint name="{joint}"' in message.data for joint in NAMES)
        (fixed,) = front.topic("/tf_static").sent
        moving = front.newest("/tf")
        assert front.topic("/tf_static").qos.latched
        assert (front.topic("/tf").qos.latched, front.topic("/tf").qos.depth) == (False, 100)
        frames = {each.child_frame_id for each in [*fixed.transforms, *moving.transforms]}
        assert len(frames) == message.data.count("<joint name=")
    with running(robot_description="<robot name='mine'/>") as front:
        assert front.topic("/robot_description").sent[0].data == "<robot name='mine'/>"
        assert "/tf" not in front.node.publishers
    with running(robot="sevenbot") as front:
        assert "/robot_description" not in front.node.publishers, "it has no geometry"
        assert front.newest("/joint_states").name


@pytest.mark.parametrize("distribution", list(Distribution), ids=lambda each: each.value)
def test_messages_are_those_of_the_distribution(distribution: Distribution) -> None:
    with running(distribution=distribution.value, allow_partial_joints_goal=True) as front:
        front.enable()
        assert Goal(front, (0.5, aside(front, 0.1))).result() == (4, 0, "")
        state = front.newest(f"{AT}/controller_state")
        assert hasattr(state, "desired") == (distribution is Distribution.HUMBLE)
        feedback = front.topic(f"{ACTION}/feedback").sent[-1].feedback
        old = distribution in (Distribution.HUMBLE, Distribution.JAZZY)
        assert hasattr(feedback, "index") != old


def test_diagnostics_name_the_node_and_the_arm(front: Front) -> None:
    said = front.topic("/diagnostics").sent
    before = len(said)
    front.turn(3.05)
    assert len(said) == before + 3, "one a second"
    names = [f"{NAME}: {part}" for part in ("link", "board", *(f"{n} (servo {i})" for i, n in enumerate(NAMES)))]
    assert [row.name for row in said[-1].status] == names
    assert {row.hardware_id for row in said[-1].status} == {"arm-7"}
    assert {row.level for row in said[-1].status} == {0}
    assert abs(seconds(said[-1].header.stamp) - front.now_ns() * 1e-9) <= 1.0
    before = len(said)
    front.trigger("stop")
    # A change is told at once.
    front.until(lambda: len(said) > before and said[-1].status[1].level, 0.5)
    board = said[-1].status[1]
    assert (board.level, board.message) == (1, "stopped: requested by service")


# -- commands ----------------------------------------------------------------------------------------------------


def test_a_trajectory_moves_the_arm_and_an_empty_one_holds_it(front: Front) -> None:
    target, start = aside(front, 0.6), front.positions
    front.trajectory((2.0, target))
    front.turn(1.0)
    assert not front.near(start)
    front.trajectory()
    stood = front.still()
    assert not front.near(target)
    front.trajectory((1.0, {"J1": stood["J1"] - 0.1}))
    front.turn(2.0)
    assert front.near({"J1": stood["J1"] - 0.1})


@pytest.mark.slow
def test_a_wrong_trajectory_is_logged_and_moves_nothing(front: Front, caplog: pytest.LogCaptureFixture) -> None:
    before = front.positions
    for angles, text in (
        ({"elbow": 0.0}, "'elbow' unknown"),
        ({"J1": math.nan}, "nan"),
        ({"J1": 9.0}, "limits"),
    ):
        caplog.clear()
        front.trajectory((2.0, angles))
        (said,) = warnings(caplog)
        assert said.startswith(f"{CONTROLLER}/joint_trajectory refused: ")
        assert text in said
        front.turn(1.0)
    assert front.near(before, 0.002)


@pytest.mark.slow
def test_query_state_says_where_the_arm_is_meant_to_be(front: Front) -> None:
    at_rest = front.call(f"{AT}/query_state")
    assert at_rest.success
    assert tuple(at_rest.name) == NAMES
    assert front.near(dict(zip(NAMES, at_rest.position, strict=True)))
    assert set(at_rest.velocity) == {0.0}
    target, time = aside(front, 0.6), front.node.types.message("builtin_interfaces/msg/Time")
    front.trajectory((4.0, target))
    front.turn(0.5)
    now = time(sec=front.now_ns() // 10**9, nanosec=front.now_ns() % 10**9)
    at_once, then = (front.call(f"{AT}/query_state", **asked) for asked in ({}, {"time": now}))
    assert list(at_once.position) == pytest.approx(list(then.position), abs=1e-6), "a time of zero is now"
    later = round(WALL + front.clock())
    middle, end = (front.call(f"{AT}/query_state", time=time(sec=later + wait)) for wait in (1, 9))
    assert target["J1"] - 0.6 < middle.position[0] < target["J1"]
    assert middle.velocity[0] > 0.0
    assert end.position[0] == pytest.approx(target["J1"])
    refused = front.call(f"{AT}/query_state", time=time(sec=1))
    assert not refused.success
    assert "is not available" in refused.message
    front.trigger("stop")
    assert "stopped" in front.call(f"{AT}/query_state").message


def stream(front: Front, target: dict[str, float], count: int) -> None:
    """Set-points at 50 Hz, for all joints."""
    where = {**front.positions, **target}
    for _ in range(count):
        front.send(STREAM, data=[where[joint] for joint in NAMES])
        front.turn(0.02)


def test_set_points_of_a_forward_command_controller_are_followed(
    front: Front, caplog: pytest.LogCaptureFixture
) -> None:
    target = aside(front)
    stream(front, target, 60)
    assert front.near(target)
    assert warnings(caplog) == []
    front.send(STREAM, data=[0.1])
    (said,) = warnings(caplog)
    assert said.startswith("forward_position_controller/commands refused: data has 1 values for the 7 joints J1, ")


def test_set_points_that_go_on_through_a_stop_move_nothing_after_the_reset(
    front: Front, caplog: pytest.LogCaptureFixture
) -> None:
    target = aside(front, 1.1)
    start = front.positions
    stream(front, target, 6)
    assert not front.near(start, 0.05)
    front.trigger("stop")
    stood = front.still(0.5)
    assert not front.near(target, 0.3)
    stream(front, target, 40)
    front.trigger("reset")
    stream(front, target, 50)
    assert front.near(stood, 0.002)
    front.turn(0.6)
    assert any("commands refused: they have come since before" in text for text in warnings(caplog))
    stream(front, target, 50)
    assert not front.near(stood, 0.1), "after a pause they begin anew"


@pytest.mark.parametrize("topic", [STREAM, "/joint_commands"])
def test_set_points_that_the_network_holds_back_through_a_stop_have_not_paused(front: Front, topic: str) -> None:
    target = aside(front, 1.1)
    values = [(front.positions | target)[joint] for joint in NAMES]
    fields = {"data": values} if topic == STREAM else {"name": [*NAMES], "position": values}
    sent = front.now_ns()

    def follow(count: int) -> None:
        nonlocal sent
        for _ in range(count):
            sent += 20_000_000
            front.node.subscriptions[topic].receive(sent, **fields)
            front.turn(0.02)

    start = front.positions
    follow(6)
    assert not front.near(start, 0.05)
    front.trigger("stop")
    stood = front.still(0.5)
    front.trigger("reset")
    front.turn(1.0)
    follow(40)
    assert front.near(stood, 0.002)


def test_set_points_with_gains_are_followed_and_what_has_no_effect_is_said(
    front: Front, caplog: pytest.LogCaptureFixture
) -> None:
    target = aside(front)
    for _ in range(60):
        front.send(
            "/joint_commands", name=["J1"], position=[target["J1"]], kp_position=[1.0], kd_position=[], effort=[]
        )
        front.turn(0.02)
    assert front.near(target)
    assert warnings(caplog) == ["joint_commands: the servos take positions only; ignored: kp_position"], (
        "once a minute"
    )
    caplog.clear()
    front.send("/joint_commands", name=["J1"], position=[target["J1"]], kp_position=[1.0, 2.0])
    assert warnings(caplog) == ["joint_commands refused: kp_position has 2 values for 1 names"]


def test_what_waits_is_the_newest_for_streams_and_all_else_in_order(front: Front) -> None:
    depth = {name: row.qos.depth for name, row in front.node.subscriptions.items()}
    assert depth == {STREAM: 1, "/joint_commands": 1, "/robot_joint_commands": 1, f"{AT}/joint_trajectory": 10}
    assert {name for name, row in front.node.services.items() if row.urgent} == {f"/{NAME}/stop"}


# -- goals -------------------------------------------------------------------------------------------------------


def test_a_goal_is_reached_with_feedback_and_states_on_the_way(front: Front) -> None:
    target = aside(front, 0.3)
    goal = Goal(front, (1.5, target))
    assert goal.accepted
    assert goal.result() == (4, 0, "")
    assert front.near(target)
    feedback = front.topic(f"{ACTION}/feedback").sent
    assert {each.goal_id.uuid for each in feedback} == {goal.id.uuid}
    times = [seconds(each.feedback.desired.time_from_start) for each in feedback]
    assert len(times) == pytest.approx(20 * 1.5, abs=8)
    assert times == sorted(set(times))
    assert times[0] < 0.2
    assert 1.3 < times[-1] < 2.0
    states = [row.status for each in front.topic(f"{ACTION}/status").sent for row in each.status_list]
    assert states == [2, 4]


def test_a_stop_aborts_a_goal_and_refuses_others_until_reset(front: Front) -> None:
    target = aside(front, 0.6)
    goal = Goal(front, (6.0, target))
    front.turn(1.0)
    assert front.trigger("stop").endswith("; all joints confirmed it; at rest")
    status, code, text = goal.result()
    assert (status, code) == (6, -1)
    assert "stopped" in text
    stood = front.still()
    assert not Goal(front, (2.0, target)).accepted
    assert "stopped" in front.refused("go_to/home")
    front.trigger("reset")
    assert front.near(stood, 0.002)
    assert Goal(front, (2.0, target)).result()[0] == 4


# -- services ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stop_voids_what_was_sent_before_it_and_is_read_after_it(
    front: Front, caplog: pytest.LogCaptureFixture
) -> None:
    """A long trajectory waits for its check as the stop comes: it is void, also after the reset."""
    target, busy, go = aside(front, 0.6), threading.Event(), threading.Event()
    front.front._trajectories.put(lambda: (busy.set(), go.wait(30.0)))
    assert busy.wait(30.0)
    row = front.node.types.message("trajectory_msgs/msg/JointTrajectoryPoint")(positions=[target["J1"]])
    row.time_from_start.sec = 2
    front.send(f"{AT}/joint_trajectory", joint_names=["J1"], points=[row])
    front.trigger("stop")
    front.trigger("reset")
    before = front.positions
    go.set()
    front.checked()
    front.turn(2.0)
    assert front.near(before, 0.002)
    assert any("joint_trajectory refused: " in text for text in warnings(caplog))
    front.trajectory((2.0, target))
    front.turn(2.5)
    assert front.near(target), "what comes after it is followed"


def test_a_message_that_is_only_read_after_the_stop_is_void(front: Front) -> None:
    """The stop goes ahead of what has arrived: what has its turn before the stop's own mark is void."""
    passed: list[Any] = []
    front.front._passed.put = passed.append  # type: ignore[method-assign,assignment]  # its turn comes later
    front.trigger("stop")
    front.trigger("reset")
    target, before = aside(front, 0.6), front.positions
    front.trajectory((2.0, target))
    assert passed == [None]
    mark = front.arm.mark()
    front.arm.void()
    assert front.arm.mark() != mark
    front.trigger("stop")
    assert len(passed) == 2
    front.trigger("reset")
    front.turn(1.0)
    assert front.near(before, 0.05)


@pytest.mark.slow
def test_a_pose_is_answered_on_arrival(front: Front) -> None:
    front.trajectory((1.0, aside(front, 0.3)))
    front.turn(1.5)
    assert front.trigger("go_to/home") == "at home"
    assert front.near({"J1": -0.087, "J2": 0.96})


def test_torque_is_switched_by_service(front: Front) -> None:
    for on in (False, True):
        front.enable(on)
        assert front.torques() == [on] * len(NAMES)


@pytest.mark.slow
def test_a_taught_motion_is_latched_saved_and_played(tmp_path: Path) -> None:
    with running(teach_directory=str(tmp_path)) as front:
        front.enable()
        assert "no torque" in front.trigger("teach/start")
        assert not any(front.torques())
        guide(front, "J1", 0.3)
        words = front.trigger("teach/stop")
        assert words.startswith("taught ")
        assert all(front.torques())
        led_to = front.where("J1")
        (message,) = front.topic(f"/{NAME}/taught").sent
        assert front.topic(f"/{NAME}/taught").qos.latched
        assert tuple(message.joint_names) == NAMES
        assert message.points[-1].positions[0] == pytest.approx(led_to, abs=0.03)
        saved = json.loads(Path(words.rpartition(" saved as ")[2]).read_text())
        assert saved["joint_names"] == list(NAMES)
        assert front.trigger("teach/play").startswith("played")
        assert front.near({"J1": led_to})
        assert "is not in teach mode" in front.refused("teach/stop")


# -- parameters and life cycle -----------------------------------------------------------------------------------


def parameter(front: Front, name: str) -> Any:
    """The value of a parameter, as its message has it."""
    (value,) = front.call(f"/{NAME}/get_parameters", names=[name]).values
    return value


def set_parameter(front: Front, name: str, value: float | str) -> str:
    """Set a parameter; returns why that was refused."""
    make = front.node.types.message
    kind = {"type": 3, "double_value": value} if isinstance(value, float) else {"type": 4, "string_value": value}
    row = make("rcl_interfaces/msg/Parameter")(name=name, value=make("rcl_interfaces/msg/ParameterValue")(**kind))
    (result,) = front.call(f"/{NAME}/set_parameters", parameters=[row]).results
    assert result.successful == (not result.reason)
    return str(result.reason)


def test_every_parameter_is_listed_with_its_value_and_what_it_is_for(front: Front) -> None:
    listed = front.call(f"/{NAME}/list_parameters").result
    wanted = {"port", "use_sim_time", "poses.home.J1", "constraints.goal_time", "constraints.J1.goal", "joints"}
    assert wanted <= set(listed.names)
    assert parameter(front, "port").string_value == "/dev/null"
    assert parameter(front, "poses.home.J2").double_value == 0.96
    assert parameter(front, "joints").string_array_value == list(NAMES)
    watchdog, rate = front.call(f"/{NAME}/describe_parameters", names=["watchdog", "diagnostics_rate"]).descriptors
    assert (watchdog.read_only, rate.read_only) == (True, False)
    assert "silence after which the board stops the arm" in watchdog.description


@pytest.mark.slow
def test_a_parameter_takes_effect_and_a_wrong_value_is_refused_with_the_reason(front: Front) -> None:
    assert set_parameter(front, "frame_id", "base_link") == ""
    assert front.newest("/joint_states").header.frame_id == "base_link"
    assert set_parameter(front, "hardware_id", "left") == ""
    assert set_parameter(front, "diagnostics_rate", 5.0) == ""
    front.turn(1.0)
    before = len(front.topic("/diagnostics").sent)
    front.turn(2.0)
    assert len(front.topic("/diagnostics").sent) == pytest.approx(before + 10, abs=1)
    assert front.diagnosed("link").hardware_id == "left"
    assert set_parameter(front, "constraints.J1.goal", 0.25) == ""
    assert parameter(front, "constraints.J1.goal").double_value == 0.25
    assert front.arm.settings.controllers[0].tolerances.goal["J1"].position == 0.25
    assert "must be above 0" in set_parameter(front, "pose_speed", -1.0)
    assert "read-only" in set_parameter(front, "port", "/dev/zero")
    assert "type" in set_parameter(front, "pose_speed", "fast")


def test_the_life_cycle_says_whether_the_arm_can_move(front: Front) -> None:
    def label() -> str:
        front.turn(2 * TICK)
        return str(front.call(f"/{NAME}/get_state").current_state.label)

    def change(number: int) -> bool:
        transition = front.node.types.message("lifecycle_msgs/msg/Transition")(id=number)
        return bool(front.call(f"/{NAME}/change_state", transition=transition).success)

    assert label() == "active"
    assert change(4)
    assert label() == "inactive"
    assert change(3), "it ends the stop of deactivate"
    assert label() == "active"
    front.trigger("stop")
    assert label() == "inactive"
    assert not change(3), "it does not end another stop"
    front.trigger("reset")
    assert label() == "active"
    front.enable(False)
    assert label() == "inactive"
    assert change(3)
    assert all(front.torques())


# -- start and end -----------------------------------------------------------------------------------------------


def test_names_follow_namespace_and_remappings() -> None:
    rules = (
        "joint_states:=js",
        "joint_trajectory_controller/follow_joint_trajectory/_action/send_goal:=go",
        "~/stop:=/halt",
    )
    options = NodeOptions(NAME, "/left", remaps=tuple(map(parse_remap, rules)))
    with running(options, frame_id="left_base") as front:
        assert front.newest("/left/js").header.frame_id == "left_base"
        assert {"/left/go", "/halt", f"/left/{NAME}/reset"} <= set(front.node.services)
        assert "/diagnostics" in front.node.publishers
        assert "/left/joint_states" not in front.node.publishers
        assert front.call("/halt").success


@pytest.mark.slow
def test_several_controllers_have_topics_of_their_own() -> None:
    shares = {"controllers__arm__joints": list(NAMES[:6]), "controllers__hand__joints": ["J7"]}
    with running(**shares) as front:
        front.enable()
        target = {"J7": front.where("J7") + 0.1}
        front.send("/hand/joint_trajectory", joint_names=["J7"], points=[front.point(1.0, target)])
        front.checked()
        front.turn(1.5)
        assert front.near(target)
        assert tuple(front.newest("/arm/controller_state").joint_names) == NAMES[:6]
        assert tuple(front.call("/hand/query_state").name) == ("J7",)


def test_a_second_node_of_the_same_name_does_not_touch_the_arm() -> None:
    with pytest.MonkeyPatch.context() as patch:
        front = Front(patch, {})
        front.node.graph.add(front.node.token("2"))
        # Otherwise it would wait here for its end.
        front.turns.request()
        front.turns.next()
        with pytest.raises(
            DeviceError, match=rf"there is a node /{NAME} already; end it, or give this one another"
        ):
            front.front.run()
        assert front.board.state.watchdog_timeout == 0.0, "its arm was not touched"
        assert not front.link.written
        assert not front.node.opened


def test_a_namesake_that_vanishes_meanwhile_is_none() -> None:
    with pytest.MonkeyPatch.context() as patch:
        front = Front(patch, {})
        token, sleep = front.node.token("2"), front.clock.sleep
        front.node.graph.add(token)

        def meanwhile(seconds: float) -> None:
            sleep(seconds)
            front.node.graph.remove(token)

        front.time.sleep = meanwhile
        front.open()
        front.close()
        assert (front.error, front.status) == ([], 0)


def test_warnings_of_the_settings_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO), running(use_sim_time=True, open_loop_control=True):
        pass
    said = [record.getMessage() for record in caplog.records]
    assert "use_sim_time is set: stamps come from /clock, but the arm runs in real time" in said
    assert any(text.startswith("open_loop_control") for text in said)
    assert any(text.startswith("hex7bot is ready at ") for text in said)


def test_with_use_sim_time_stamps_and_goals_follow_the_clock_of_the_simulation() -> None:
    with running(use_sim_time=True, allow_partial_joints_goal=True) as front:
        clock = front.node.subscriptions["/clock"]
        assert (clock.qos.reliability, clock.qos.depth) == (Reliability.BEST_EFFORT, 1)
        make = front.node.types.message
        stamp = make("builtin_interfaces/msg/Time")
        header = make("std_msgs/msg/Header")
        assert front.newest("/joint_states").header.stamp == stamp()
        front.enable()
        dated = {"header": header(stamp=stamp(sec=52)), "joint_names": ["J1"]}
        there = {"points": [front.point(1.0, {"J1": HOME["J1"] + 0.2})]}
        front.send(f"/{CONTROLLER}/joint_trajectory", **dated, **there)
        front.checked()
        assert not front.controller.busy, "nobody knows when that is"
        answer = front.call(f"/{CONTROLLER}/query_state", time=stamp(sec=52))
        assert (answer.success, answer.message.partition(",")[0]) == (False, "it has a time")
        front.send("/clock", clock=stamp(sec=50, nanosec=500_000_000))
        front.turn(0.1)
        assert front.newest("/joint_states").header.stamp == stamp(sec=50, nanosec=500_000_000)
        assert front.newest("/diagnostics").header.stamp == stamp(sec=50, nanosec=500_000_000)
        front.send(f"/{CONTROLLER}/joint_trajectory", **dated, **there)
        front.checked()
        assert front.controller.begins - front.clock() == pytest.approx(1.5, abs=1e-6), "the rest is real time"


def test_at_the_end_the_arm_is_stopped_clients_are_told_and_the_node_vanishes() -> None:
    with running(allow_partial_joints_goal=True) as front:
        front.enable()
        target = aside(front, 0.6)
        goal = Goal(front, (6.0, target))
        front.turn(1.0)
        call = front.node.call(f"{ACTION}/get_result", goal_id=goal.id)
        assert not front.turns.interrupts, "an arm that moves is made safe first"
        waited: list[float] = []
        front.time.sleep = waited.append
        front.close()
        assert waited == [0.2], "until the last results are on their way"
        assert call.response.status == 6
        assert "the program ends" in call.response.result.error_string
        assert front.status == 0
        assert front.board.state.stopped
        assert all(front.torques())
        assert not front.node.opened
        states = [each.goal_state.label for each in front.topic(f"/{NAME}/transition_event").sent]
        assert states[-1] == "finalized"
        assert front.turns.listening


def test_torque_is_taken_at_the_end_where_that_is_asked_for() -> None:
    with running(torque_off_at_exit=True) as front:
        front.enable()
    assert not any(front.torques())


def test_a_programming_error_in_the_owner_ends_the_node() -> None:
    with running() as front:
        front.owner.crash = ZeroDivisionError("by the test")
        front.turns.next()
        front._thread.join(30.0)
    (error,) = front.error
    assert isinstance(error, DeviceError)
    assert "the node failed: ZeroDivisionError('by the test')" in str(error)


def test_ctrl_c_before_there_is_an_arm_ends_it_at_once() -> None:
    with pytest.MonkeyPatch.context() as patch:
        front = Front(patch, {})

        def interrupted() -> None:
            assert front.turns.interrupts, "nothing must be made safe yet"
            raise KeyboardInterrupt

        front.arm.connect = interrupted  # type: ignore[method-assign]  # as a signal does while it waits for a board
        assert front.front.run() == 0
        assert not front.node.opened


def test_servo_lost_during_a_move_stops_the_arm_and_is_left_out(front: Front) -> None:
    goal = Goal(front, (6.0, aside(front, 0.6)))
    front.turn(1.0)
    front.silence("J1")
    status, _, text = goal.result()
    assert status == 6
    assert "J1" in text
    front.until(lambda: tuple(front.newest("/joint_states").name) == NAMES[1:])
    assert front.diagnosed("J1 (servo 0)").level == 2
    assert front.diagnosed("J2 (servo 1)").level == 0
    assert not Goal(front, (1.0, {"J2": front.where("J2")})).accepted


def test_unplugged_during_a_move_and_plugged_in_again(front: Front) -> None:
    target = aside(front, 0.6)
    goal = Goal(front, (6.0, target))
    front.turn(1.0)
    front.link.lost = True
    status, _, text = goal.result()
    assert status == 6
    assert "unplugged" in text
    link = front.diagnosed("link")
    assert (link.level, link.message.partition(":")[0]) == (2, "not connected")
    assert "cannot be reached" in front.refused("reset")
    assert not Goal(front, (3.0, target)).accepted
    front.link.lost = False
    front.until(lambda: front.owner.connected)
    assert tuple(front.newest("/joint_states").name) == NAMES, "by itself"
    stood = front.still()
    # The rate is that of the last two seconds, of which it was unplugged for a part.
    front.until(lambda: front.diagnosed("link").level == 0)
    assert not Goal(front, (3.0, target)).accepted
    front.trigger("reset")
    assert front.near(stood, 0.002)
    front.enable()
    assert Goal(front, (2.0, target)).result()[0] == 4
