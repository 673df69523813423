"""Set-points with gains, to the emulated PUMA 260, which obeys them, and to an arm that does not."""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from tests.control.arm_bench import make_bench
from tests.few import few
from tests.motion.arms import HOME

from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.set_point_stream import JointCommandStream
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator.puma import EmulatedPuma
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import NotSupportedError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.control_law import ControlLaw
from hexwire.model.state import JointTarget
from hexwire.ros1.messages import _OSRF
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import COMMAND_ARRAYS, JointCommands
from zenoh_ros2.types import Types

STIFF = {"kp_position": 8.0, "kd_position": 1.5}
QUIET = 2.0


def message(names: list[str], **fields: list[float]) -> Any:
    return SimpleNamespace(**{**dict.fromkeys(COMMAND_ARRAYS, ()), "name": names, **fields})


class Bench:
    """All of a node but ROS, around the emulated controller in simulated time."""

    def __init__(self, **params: Any) -> None:
        self.clock = FakeClock(1000.0)
        self.puma = EmulatedPuma(start=self.clock.time)
        handle = IpcHandle.from_link(
            BoardLink(self.puma.connect(), self.clock),
            ModuleType.PUMA260_HOST_IO_TRX,
            ModuleType.PUMA260_RBT_IO_SVR,
        )
        settings, _ = read_settings({"robot": "puma260", "port": "tcp://127.0.0.1:1", **params}, Faults())
        robot = Puma260Driver(Session(handle))
        self.arm = ControlledArm(robot, settings, clock=self.clock, sleep=self.clock.sleep)
        self.stream = JointCommandStream(self.arm)
        self.arm.connect()
        self.arm.owner.group.members = tuple(self.arm.controllers.values())
        robot.torque(True)
        self.turn(0.2)

    def turn(self, seconds: float) -> None:
        end = self.clock.time + seconds
        while self.clock.time < end:
            self.arm.owner.turn()

    def play(self, what: Any, seconds: float) -> set[str]:
        """Publish at 50 Hz; returns what was said."""
        said = set()
        for _ in range(round(seconds * 50)):
            said.add(self.stream.follow(what))
            self.turn(0.02)
        return said

    def sent(self) -> list[JointCommands]:
        """The joint commands that came since the last call."""
        found = [each for each in self.puma.executed if isinstance(each, JointCommands)]
        self.puma.executed.clear()
        return found

    @property
    def with_gains(self) -> list[str]:
        return [name for name, gains in zip(PUMA260.names, self.puma._gains, strict=True) if gains is not None]

    def where(self, joint: str) -> float:
        return self.puma.position[PUMA260.names.index(joint)]


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.arm.shutdown()


def test_a_message_in_ros_has_these_fields() -> None:
    names = [line.split()[1] for line in _OSRF["JointCommands"][1].splitlines()]
    assert names == ["header", "name", *COMMAND_ARRAYS]
    assert list(Types().message("osrf_msgs/msg/JointCommands")()._fields) == names


def test_gains_reach_the_controller_with_every_set_point_and_it_obeys_them(bench: Bench) -> None:
    what = message(["J2", "J4"], position=[0.2, -0.1], **{name: [value] * 2 for name, value in STIFF.items()})
    assert bench.play(what, 3.0) == {""}
    sent = bench.sent()
    assert len(sent) >= 50, "one a command period"
    assert {each.name for each in sent} == {("J2", "J4")}
    assert {(each.kp_position, each.kd_position) for each in sent} == {((8.0, 8.0), (1.5, 1.5))}
    assert bench.with_gains == ["J2", "J4"]
    assert [bench.where(name) for name in ("J2", "J4")] == pytest.approx([0.2, -0.1], abs=0.01)
    # The controller's law, and not its own loop: a spring of 8 Nm/rad gives way by 0.05 rad to 0.4 Nm.
    assert bench.play(message(["J2"], position=[0.2], effort=[0.4], kp_position=[8.0], kd_position=[1.5]), 3.0) == {
        ""
    }
    assert bench.where("J2") == pytest.approx(0.25, abs=0.01)


def test_positions_with_gains_are_led_within_the_speed_limits(bench: Bench) -> None:
    bench.play(message(["J1"], position=[0.8], kp_position=[30.0], kd_position=[4.0]), 1.0)
    told = [each.position[0] for each in bench.sent()]
    most = PUMA260.joints[0].max_speed * bench.arm.owner.command_period
    assert len(told) > 3
    assert max(b - a for a, b in zip([0.0, *told], told, strict=False)) < 1.6 * most


@few("how", ["silence", "plain set-points", "a goal", "other joints"], "silence", "a goal")
def test_joints_are_given_back_to_the_controllers_own_loop(bench: Bench, how: str) -> None:
    weak = message(["J1"], position=[0.1], effort=[0.3], kp_position=[2.0], kd_position=[0.6])
    bench.play(weak, 3.0)
    there = bench.where("J1")
    assert there > 0.15, "it gives way to the effort"
    if how == "silence":
        bench.turn(0.7)
    elif how == "plain set-points":
        bench.play(message(["J1"], position=[0.1]), 0.2)
    elif how == "a goal":
        here = tuple(bench.puma.position)
        goal = TrajectoryGoal(PUMA260.names, (Point(1.0, (0.1, *here[1:])),))
        bench.arm.command("", goal)
        bench.turn(0.2)
    else:
        bench.play(message(["J3"], position=[0.1]), 0.2)
    assert not bench.with_gains
    bench.turn(QUIET)
    assert not bench.puma.moving
    ends = {"silence": there, "other joints": there, "plain set-points": 0.1, "a goal": 0.1}
    assert bench.where("J1") == pytest.approx(ends[how], abs=0.01), "an effort that has ended moves nothing"


def test_a_stop_ends_the_gains_and_the_stream(bench: Bench) -> None:
    what = message(["J1"], position=[0.5], kp_position=[8.0], kd_position=[1.5])
    bench.play(what, 0.5)
    bench.arm.stop("by the test")
    assert (bench.puma.stopped, bench.with_gains) == (True, [])
    at = bench.where("J1")
    with pytest.raises(UsageError, match="the arm is stopped"):
        bench.stream.follow(what)
    bench.arm.reset()
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(at, abs=1e-3)


def test_a_host_that_dies_leaves_no_joint_running(bench: Bench) -> None:
    bench.play(message(["J1"], position=[0.0], effort=[0.5]), 0.1)
    assert bench.with_gains == ["J1"]
    bench.clock.advance(0.6)
    bench.puma.step(bench.clock.time)
    at = bench.where("J1")
    bench.clock.advance(2.0)
    bench.puma.step(bench.clock.time)
    assert not bench.with_gains
    assert bench.where("J1") == pytest.approx(at, abs=0.1)


IGNORED: list[tuple[dict[str, list[float]], str]] = [
    ({}, ""),
    ({"effort": [0.0, 0.0], "kp_position": [0.0, 0.0]}, ""),
    ({"kp_position": [9.0, 9.0], "velocity": [0.1, 0.1], "i_effort_max": [1.0, 1.0]}, ""),
    ({"velocity": [0.1, 0.0]}, "joints without an effort or a gain; ignored: velocity"),
    (
        {"velocity": [0.1, 0.1], "kp_position": [9.0, 0.0], "i_effort_min": [0.0, -1.0]},
        "joints without an effort or a gain; ignored: velocity, i_effort_min",
    ),
]


@pytest.mark.parametrize(("fields", "ignored"), IGNORED)
def test_only_what_has_no_effect_is_told(bench: Bench, fields: dict[str, list[float]], ignored: str) -> None:
    assert bench.play(message(["J1", "J4"], position=[0.05, 0.05], **fields), 0.2) == {ignored}
    assert bench.with_gains == [
        name for name, gain in zip(("J1", "J4"), fields.get("kp_position", [0.0, 0.0]), strict=True) if gain
    ]


def test_servos_take_positions_only() -> None:
    bench = make_bench()
    stream = JointCommandStream(bench.arm)
    what = message(["J1"], position=[HOME["J1"] + 0.1], effort=[1.0], kp_position=[1.0])
    assert stream.follow(what) == "the servos take positions only; ignored: effort, kp_position"
    bench.turn(1.0)
    assert bench.where("J1") == pytest.approx(HOME["J1"] + 0.1, abs=0.01)
    with pytest.raises(NotSupportedError, match="hex7bot takes positions only"):
        bench.arm.owner.robot.write(JointTarget((("J1", 0.0),), 1.0, (("J1", ControlLaw(effort=1.0)),)))


WRONG: list[tuple[list[str], dict[str, list[float]], str]] = [
    (["J1", "J1"], {"position": [0.0, 0.0]}, "named twice: J1, J1"),
    (["J1"], {"position": [0.0, 0.0]}, "position has 2 values for 1 names"),
    (["J1"], {"position": [0.0], "kp_position": [1.0, 1.0]}, "kp_position has 2 values for 1 names"),
    (["J1"], {"position": [math.nan]}, "the position of J1 is nan, not a number"),
    (["J1"], {"position": [0.0], "effort": [math.inf]}, "the effort of J1 is inf, not a number"),
    ([], {"position": [1.0]}, "position has 1 values for 0 names"),
    (["J1"], {"effort": [1.0]}, "no positions"),
    (["J1"], {"position": [9.0], "kp_position": [1.0]}, "outside its limits"),
    (["J9"], {"position": [0.0], "kp_position": [1.0]}, "no joint 'J9'"),
]


@pytest.mark.parametrize(("names", "fields", "error"), WRONG)
def test_what_is_wrong_is_refused_and_nothing_is_sent(
    bench: Bench, names: list[str], fields: dict[str, list[float]], error: str
) -> None:
    bench.sent()
    with pytest.raises(UsageError, match=error):
        bench.stream.follow(message(names, **fields))
    bench.turn(0.2)
    assert not bench.sent()


def test_two_controllers_with_and_without_gains_at_once() -> None:
    arms: dict[str, Any] = {"arm": {"joints": ["J1", "J2", "J3"]}, "wrist": {"joints": ["J4", "J5", "J6"]}}
    bench = Bench(controllers=arms)
    bench.play(message(["J1", "J5"], position=[0.1, 0.1], kp_position=[8.0, 0.0], kd_position=[1.5, 0.0]), 2.0)
    sent = bench.sent()
    assert {each.name for each in sent} == {("J1",), ("J5",)}
    assert all(bool(each.kp_position) is (each.name == ("J1",)) for each in sent)
    assert bench.with_gains == ["J1"]
    assert [bench.where(name) for name in ("J1", "J5")] == pytest.approx([0.1, 0.1], abs=0.01)
    bench.arm.shutdown()
