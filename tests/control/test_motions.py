"""One motion from beginning to end, with an emulated board in simulated time."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from tests.drivers.arms import Arm
from tests.motion.arms import rest_to_rest

from hexwire.control import run_motion
from hexwire.control.motion.motions import MotionObserver, MotionOptions, check_path
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    CommandRefusedError,
    DeviceError,
    GoalError,
    LinkLostError,
    ServoError,
    StoppedError,
    UsageError,
)
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.pose import Pose
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.motion.checks import InJoints
from hexwire.motion.line import Line
from hexwire.motion.trajectory import Spline


class Watched(MotionObserver):
    """Notes everything; `do` is called with every state."""

    def __init__(self, do: Any = lambda state: None) -> None:
        self.said: list[tuple[str, Any]] = []
        self.states: list[JointState] = []
        self.do = do

    def powered(self, joints: Any) -> None:
        self.said.append(("powered", tuple(joints)))

    def unwatched(self, seconds: float) -> None:
        self.said.append(("unwatched", round(seconds, 2)))

    def sent(self, sent: SentTarget) -> None:
        self.said.append(("sent", [name for name, _ in sent.positions]))

    def started(self, timing: Any) -> None:
        self.said.append(("started", None))

    def seen(self, state: JointState) -> None:
        self.states.append(state)
        self.do(state)


class Bench:
    def __init__(self, dialect: int = 2, faults: tuple[str, ...] = ()) -> None:
        self.arm = Arm(dialect, 115200, faults)
        self.robot = self.arm.driver
        self.targets: list[tuple[float, JointTarget]] = []
        write = self.robot.write

        def noted(target: JointTarget) -> SentTarget:
            self.targets.append((self.arm.clock.time, target))
            return write(target)

        self.robot.write = noted  # type: ignore[method-assign]

    def options(self, **given: Any) -> MotionOptions:
        # The board would keep the time: see test_timed_motion.py.
        return MotionOptions(clock=self.arm.clock, sleep=self.arm.wait, **{"host_timed": True, **given})

    def way(self, joint: str = "J4", by: float = 0.5, seconds: float = 1.0) -> Spline:
        here = self.robot.read()[joint].position
        return rest_to_rest((joint,), (here,), (here + by,), seconds)

    def target(self, joint: str = "J4", by: float = 0.5, seconds: float = 1.0) -> JointTarget:
        return JointTarget.of({joint: self.robot.read()[joint].position + by}, seconds)


def test_a_trajectory_is_followed_to_its_end() -> None:
    bench, watched = Bench(), Watched()
    way = bench.way()
    result = run_motion(bench.robot, way, bench.options(), observer=watched)
    assert result.arrived
    assert result.require() is result
    assert result.why == ""
    assert bench.robot.read()["J4"].position == pytest.approx(way.goal[0], abs=0.01)
    seen = [state["J4"].position for state in watched.states]
    assert max(b - a for a, b in pairwise(seen)) < 0.1
    assert result.timing.late == result.timing.skipped == 0
    state = bench.arm.board.state
    assert (state.stopped, state.watchdog_timeout) == (False, 0.0)


def test_targets_are_sent_in_order_one_a_cycle() -> None:
    bench = Bench()
    run_motion(bench.robot, bench.way(), bench.options())
    times = [t for t, _ in bench.targets]
    # A read takes its time on the line; the cycles start at the period all the same.
    assert [b - a for a, b in pairwise(times)] == pytest.approx([0.05] * (len(times) - 1), abs=0.01)
    assert all(target.duration == pytest.approx(0.075) for _, target in bench.targets)


def test_legs_follow_each_other() -> None:
    bench = Bench()
    there = bench.way()
    back = rest_to_rest(("J4",), there.goal, there.start, 1.0)
    result = run_motion(bench.robot, [there, back], bench.options())
    assert result.arrived
    assert bench.robot.read()["J4"].position == pytest.approx(there.start[0], abs=0.01)
    middle = [target.positions[0][1] for _, target in bench.targets]
    assert max(middle) == pytest.approx(there.goal[0], abs=1e-6)


def test_the_watchdog_is_armed_during_the_motion() -> None:
    bench = Bench()
    armed: list[float] = []
    watched = Watched(lambda state: armed.append(bench.arm.board.state.watchdog_timeout))
    run_motion(bench.robot, bench.way(), bench.options(), observer=watched)
    assert set(armed) == {1.0}
    assert run_motion(bench.robot, bench.target(by=-0.1), bench.options(), observer=watched).arrived
    assert set(armed) == {1.0}


def test_a_path_that_is_not_allowed_is_refused_and_nothing_is_sent() -> None:
    bench = Bench()
    with pytest.raises(UsageError, match=r"J4 would turn at .*; nothing was sent"):
        run_motion(bench.robot, bench.way(seconds=0.1), bench.options())
    with pytest.raises(UsageError, match="outside its limits"):
        run_motion(bench.robot, bench.target(by=3.0), bench.options())
    down = JointTarget.of({"J2": math.radians(25), "J3": math.radians(62)}, 3.0)
    low = bench.options(table=0.06)
    with pytest.raises(UsageError, match="below the table"):
        run_motion(bench.robot, down, low)
    assert bench.targets == []
    assert bench.arm.torques() == [False] * 7


def test_a_path_is_checked_once() -> None:
    bench = Bench()
    path = check_path(bench.robot, bench.way(), bench.options())
    assert path.reports[0].duration == 1.0
    assert run_motion(bench.robot, path, bench.options()).arrived
    two = [bench.way("J4"), bench.way("J5")]
    with pytest.raises(UsageError, match="must move the same joints"):
        check_path(bench.robot, two)
    with pytest.raises(UsageError, match=r"^a motion is a trajectory, several of them, .*; this is \[\]$"):
        check_path(bench.robot, [])


def test_a_line_is_slowed_down_where_its_joints_need_that() -> None:
    bench, model = Bench(), Hex7BotModel()
    where = bench.robot.read().positions
    angles = model.from_joints(where)
    x, y, z = model.forward(angles).position
    goal = Pose((x + 0.02, y, z + 0.02), model.forward(angles).rotation)
    quick = InJoints(Line(model, angles, goal, speed=0.5, acceleration=5.0), model)
    (leg,) = check_path(bench.robot, quick, bench.options(), start=where).legs
    assert leg.duration > quick.duration
    for name, row in zip(
        leg.names, zip(*(s.acceleration for _, s in leg.samples(0.001)), strict=True), strict=True
    ):
        assert max(map(abs, row)) <= HEX7BOT.joint(name).max_acceleration
    plain = bench.way()
    assert check_path(bench.robot, plain, bench.options()).legs == (plain,), (
        "what is given in joints is run as it is"
    )


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_target_is_one_write_where_a_watchdog_stands_by_and_short_steps_where_not(dialect: int) -> None:
    bench, watched = Bench(dialect), Watched()
    result = run_motion(bench.robot, bench.target(seconds=3.0), bench.options(grace=5.0), observer=watched)
    assert result.arrived
    assert result.powered == (("J4",) if dialect == 2 else tuple(result.powered))
    assert result.sent is not None
    assert result.sent.duration == pytest.approx(3.0, abs=0.01)
    said = [what for what, _ in watched.said]
    if dialect == 2:
        assert len(bench.targets) == 1
        assert said == ["powered", "sent", "started"]
    else:
        assert len(bench.targets) > 3
        assert max(target.duration for _, target in bench.targets) == pytest.approx(1.0)
        assert said == ["powered", "unwatched", "sent", "started"]


def test_without_waiting_it_is_sent_and_left_to_the_board() -> None:
    bench = Bench()
    result = run_motion(bench.robot, bench.target(), bench.options(), wait=False)
    assert (result.arrived, result.stopped, result.why) == (None, None, "")
    assert len(bench.targets) == 1
    assert bench.arm.board.state.watchdog_timeout == 0.0


def test_a_joint_that_does_not_arrive_is_named() -> None:
    bench = Bench(faults=("hot:4",))
    result = run_motion(bench.robot, bench.target("J5"), bench.options(grace=1.0))
    assert result.arrived is False
    assert [row.joint for row in result.off] == ["J5"]
    assert result.why.startswith("did not arrive: J5 is ")
    with pytest.raises(ServoError, match="did not arrive: J5"):
        result.require()


def test_a_silent_servo_gets_no_torque_and_nothing_moves() -> None:
    bench = Bench(faults=("silent:4",))
    with pytest.raises(ServoError, match=r"^the position of J5 is unknown: no answer"):
        run_motion(bench.robot, JointTarget.of({"J5": 0.1}, 1.0), bench.options())
    assert bench.targets == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"flags": (int(JointFlag.TORQUE_ON),) * 3 + (0,) * 4}, "no torque on J4; enable it first"),
        (
            {"flags": (int(JointFlag.TORQUE_ON | JointFlag.SILENT),) * 7, "age": (9.0,) * 7},
            r"no answer from J4 for more than 0\.5 s",
        ),
    ],
)
def test_a_joint_that_is_not_ready_after_torque_is_on_is_not_moved(change: dict[str, Any], says: str) -> None:
    bench = Bench()
    bench.robot.torque(True)
    way = bench.way()
    read, reads = bench.robot.read, iter(range(1000))

    def changed() -> JointState:
        state = read()
        return replace(state, **change) if next(reads) > 2 else state

    bench.robot.read = changed  # type: ignore[method-assign]  # torque or the servo is lost at this moment
    with pytest.raises(GoalError, match=says):
        run_motion(bench.robot, way, bench.options())
    assert bench.targets == []
    assert bench.arm.board.state.watchdog_timeout == 0.0


@pytest.mark.parametrize(
    ("joint", "room", "kind", "says"),
    [
        # Its servo reports no load.
        ("J1", 30, "following", "J1 is .* off its path"),
        ("J5", 10, "collision", "J5 hit something: load .* off its path"),
    ],
)
def test_a_jam_stops_the_arm_by_load_and_distance_or_by_distance_alone(
    joint: str, room: int, kind: str, says: str
) -> None:
    bench = Bench()
    shaft = bench.arm.board.wire.servos[int(joint[1]) - 1].motion
    shaft.obstacle = (shaft.position - room, shaft.position + room)
    result = run_motion(bench.robot, bench.way(joint), bench.options())
    assert result.stopped is not None
    assert result.stopped.kind == kind
    assert re.fullmatch(f"stopped: {says}", result.why)
    assert not result.arrived
    assert bench.arm.board.state.stopped


@pytest.mark.parametrize("what", ["way", "target"])
@pytest.mark.parametrize("after", [0, 8])
def test_a_joint_that_vanishes_from_the_states_ends_it(what: str, after: int) -> None:
    bench = Bench()
    bench.robot.torque(True)
    motion = bench.way() if what == "way" else bench.target()
    read, reads = bench.robot.read, iter(range(1000))

    def lossy() -> JointState:
        state = read()
        return state if next(reads) < after else replace(state, names=("J0", *state.names[1:]))

    bench.robot.read = lossy  # type: ignore[method-assign]  # a driver that loses a joint
    with pytest.raises(DeviceError, match=r"the robot reports the joints J0, J2, .*; correct its driver"):
        run_motion(bench.robot, motion, bench.options())
    assert bench.arm.board.state.stopped is (after > 0)


@pytest.mark.parametrize("what", ["way", "target"])
def test_a_stop_from_elsewhere_ends_the_motion_even_if_resumed_at_once(what: str) -> None:
    bench = Bench()
    motion = bench.way() if what == "way" else bench.target()

    def stop(state: JointState) -> None:
        if len(watched.states) == 5:
            bench.robot.stop()
            bench.robot.resume()
            held.append((len(bench.targets), bench.arm.board.wire[3].registers.get("target_position")))

    held: list[tuple[int, int]] = []
    watched = Watched(stop)
    result = run_motion(bench.robot, motion, bench.options(), observer=watched)
    assert result.stopped is not None
    assert "stop" in str(result.stopped)
    assert (len(bench.targets), bench.arm.board.wire[3].registers.get("target_position")) == held[0]
    assert bench.arm.board.state.watchdog_timeout == 0.0


def test_a_stop_from_another_thread_ends_it() -> None:
    bench = Bench()

    def stop(state: JointState) -> None:
        if len(watched.states) == 5:
            thread = threading.Thread(target=bench.robot.stop)
            thread.start()
            thread.join()
            sent.append(len(bench.targets))

    sent: list[int] = []
    watched = Watched(stop)
    result = run_motion(bench.robot, bench.way(), bench.options(), observer=watched)
    assert result.stopped is not None
    assert len(bench.targets) == sent[0]
    assert bench.arm.board.state.stopped


def test_an_arm_that_is_stopped_does_not_set_out() -> None:
    bench = Bench()
    bench.robot.torque(True)
    bench.robot.stop()
    sent, place = len(bench.targets), bench.arm.shaft(3)
    for motion in (bench.way(), bench.target()):
        with pytest.raises(StoppedError, match=r"^a stop command has stopped the arm; `hexwire resume` ends that$"):
            run_motion(bench.robot, motion, bench.options())
    assert (len(bench.targets), bench.arm.shaft(3)) == (sent, pytest.approx(place))


def test_a_stop_between_read_and_write_is_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()

    def refuse(target: JointTarget) -> SentTarget:
        raise StoppedError("JOINT_MOVE", 5, "the arm is stopped")

    way = bench.way()
    monkeypatch.setattr(bench.robot, "write", refuse)
    result = run_motion(bench.robot, way, bench.options())
    assert result.stopped is not None
    assert result.stopped.kind == "board"


def test_a_robot_that_fails_is_stopped_and_the_error_comes_out() -> None:
    bench = Bench()

    def gone(state: JointState) -> None:
        if len(watched.states) == 5:
            raise LinkLostError("unplugged")

    watched = Watched(gone)
    with pytest.raises(LinkLostError, match="unplugged") as caught:
        run_motion(bench.robot, bench.way(), bench.options(), observer=watched)
    state = bench.arm.board.state
    assert (state.stopped, state.watchdog_timeout) == (True, 0.0), "now, and not when the error is forgotten"
    assert str(caught.value) == "unplugged"


def test_a_refused_target_comes_out_and_stops_nothing_that_did_not_move() -> None:
    bench = Bench()

    def refuse(target: JointTarget) -> SentTarget:
        raise CommandRefusedError("JOINT_MOVE", 4, "no torque")

    bench.robot.write = refuse  # type: ignore[method-assign]
    with pytest.raises(CommandRefusedError):
        run_motion(bench.robot, bench.target(), bench.options())


@pytest.mark.parametrize("what", ["way", "target"])
def test_ctrl_c_stops_the_arm_first_and_then_the_watchdog(what: str) -> None:
    bench = Bench()
    motion = bench.way() if what == "way" else bench.target()

    def interrupt(state: JointState) -> None:
        if len(watched.states) == 8:
            raise KeyboardInterrupt

    watched = Watched(interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_motion(bench.robot, motion, bench.options(), observer=watched)
    state = bench.arm.board.state
    assert (state.stopped, state.watchdog_timeout, state.watchdog_trips) == (True, 0.0, 0)


@pytest.mark.parametrize("dialect", [1, 2])
@pytest.mark.parametrize("what", ["way", "target"])
def test_it_ends_where_the_caller_wants_it_to(what: str, dialect: int) -> None:
    bench = Bench(dialect)
    bench.robot.torque(True)
    motion = bench.way(seconds=4.0) if what == "way" else bench.target(seconds=4.0)
    begin = bench.arm.clock.time
    result = run_motion(
        bench.robot, motion, bench.options(), until=lambda state: bench.arm.clock.time > begin + 2.0
    )
    assert result.cut
    assert result.why == ""
    assert not bench.arm.board.state.stopped
    here = bench.robot.read()["J4"].position
    bench.arm.wait(5.0)
    assert bench.robot.read()["J4"].position == pytest.approx(here, abs=0.03)


@pytest.mark.parametrize("what", ["way", "target"])
def test_a_target_takes_the_place_of_what_was_ended(what: str) -> None:
    bench = Bench()
    motion = bench.way(seconds=2.0) if what == "way" else bench.target(seconds=2.0)
    rest = bench.target(by=0.1)
    begin = bench.arm.clock.time
    result = run_motion(
        bench.robot, motion, bench.options(), until=lambda _: rest if bench.arm.clock.time > begin + 1.0 else None
    )
    assert result.cut
    bench.arm.wait(3.0)
    assert bench.robot.read()["J4"].position == pytest.approx(rest.positions[0][1], abs=0.01)


@pytest.mark.parametrize("what", ["way", "target"])
def test_a_replacement_motion_is_void_after_a_stop(what: str) -> None:
    bench = Bench()

    def until(state: JointState) -> JointTarget | None:
        if bench.arm.clock.time < begin + 0.5:
            return None
        bench.robot.stop()
        bench.robot.resume()
        return rest

    motion = bench.way(seconds=2.0) if what == "way" else bench.target(seconds=2.0)
    rest = bench.target(by=0.1)
    begin = bench.arm.clock.time
    result = run_motion(bench.robot, motion, bench.options(), until=until)
    assert rest not in [target for _, target in bench.targets]
    assert result.stopped is not None


@pytest.mark.parametrize("wait", [True, False])
@pytest.mark.parametrize("when", ["check", "torque", "first read"])
@pytest.mark.parametrize("what", ["way", "target"])
def test_a_stop_before_it_sets_out_voids_it_though_it_is_resumed_at_once(
    what: str, when: str, wait: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench()
    motion = bench.way() if what == "way" else bench.target()
    robot = bench.robot
    stops: list[None] = []

    def stop_after(call: Any) -> Any:
        def stopped(*given: Any, **named: Any) -> Any:
            result = call(*given, **named)
            if not stops:
                stops.append(None)
                thread = threading.Thread(target=lambda: (robot.stop(), robot.resume()))
                thread.start()
                thread.join()
            return result

        return stopped

    if when == "check":
        check = PathCheck.trajectory if what == "way" else PathCheck.limits
        monkeypatch.setattr(PathCheck, check.__name__, stop_after(check))
    elif when == "torque":
        monkeypatch.setattr(robot, "torque", stop_after(robot.torque))
    else:
        robot.torque(True)
        monkeypatch.setattr(robot, "read", stop_after(robot.read))
    try:
        result = run_motion(robot, motion, bench.options(), wait=wait)
    except StoppedError:
        pass
    else:
        assert result.stopped is not None
        assert not result.arrived
    assert stops
    assert bench.targets == []
    assert bench.arm.board.state.watchdog_timeout == 0.0


def test_switching_torque_on_for_a_path_is_reported() -> None:
    bench, watched = Bench(), Watched()
    assert run_motion(bench.robot, bench.way(), bench.options(), observer=watched).powered == ("J4",)
    assert watched.said[0] == ("powered", ("J4",))


@pytest.mark.parametrize("joint", ["J2", "J3"])
def test_what_cannot_be_checked_since_a_joint_is_silent_moves_nothing_unless_the_check_is_off(joint: str) -> None:
    bench = Bench(faults=("silent:2",))
    with pytest.raises(ServoError, match="the position of J3 is unknown: no answer"):
        run_motion(bench.robot, JointTarget.of({joint: 0.1}, 1.0), bench.options())
    assert bench.targets == []
    how = replace(bench.options(), check_geometry=False)
    assert run_motion(bench.robot, bench.target("J2", 0.1), how).arrived


@pytest.mark.parametrize("what", ["way", "target"])
@pytest.mark.parametrize("error", [None, KeyboardInterrupt(), LinkLostError("gone")])
def test_a_caller_makes_the_arm_safe_in_place_of_a_stop(what: str, error: BaseException | None) -> None:
    bench = Bench()
    armed: list[float] = []

    @contextmanager
    def safe() -> Iterator[None]:
        try:
            yield
        finally:
            armed.append(bench.arm.board.state.watchdog_timeout)
            bench.robot.torque(False)

    watched = Watched()

    def fail(state: JointState) -> None:
        if error is not None and len(watched.states) == 10:
            raise error

    watched.do = fail
    motion = bench.way() if what == "way" else bench.target()
    with nullcontext() if error is None else pytest.raises(type(error)):
        assert run_motion(bench.robot, motion, bench.options(), observer=watched, safe=safe()).arrived
    assert armed == [1.0]
    state = bench.arm.board.state
    assert (state.stopped, state.watchdog_timeout) == (False, 0.0)
    assert not any(bench.arm.torques())


def test_two_motions_at_once_are_refused_and_the_first_keeps_its_watchdog() -> None:
    bench = Bench()
    bench.robot.torque(True)
    armed: list[float] = []

    def another(state: JointState) -> None:
        if len(watched.states) == 5:
            for motion in (bench.target("J5", 0.1, 0.3), bench.way("J5", 0.1, 0.3)):
                with pytest.raises(UsageError, match="already in motion"):
                    run_motion(bench.robot, motion, bench.options())
        armed.append(bench.arm.board.state.watchdog_timeout)

    watched = Watched(another)
    assert run_motion(bench.robot, bench.way(), bench.options(), observer=watched).arrived
    assert set(armed) == {1.0}
    assert run_motion(bench.robot, bench.way(by=-0.1), bench.options()).arrived, "that is over"


def test_a_watchdog_that_cannot_be_disarmed_is_an_error_not_an_arrival() -> None:
    bench = Bench()
    bench.robot.torque(True)
    disarm = bench.robot.watchdog

    def refuse(timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        if not timeout:
            raise DeviceError("no answer to WATCHDOG")
        disarm(timeout, mode)

    bench.robot.watchdog = refuse  # type: ignore[method-assign]  # a line that fails at the end only
    with pytest.raises(DeviceError, match="no answer to WATCHDOG"):
        run_motion(bench.robot, bench.way("J5", 0.1, 0.3), bench.options())


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_target_is_refused_while_a_joint_that_it_does_not_name_moves(dialect: int) -> None:
    bench = Bench(dialect)
    options = bench.options()
    run_motion(bench.robot, bench.target("J2", 0.3, 6.0), options, wait=False)
    sent = len(bench.targets)
    with pytest.raises(UsageError, match=r"^still moving: J2; wait until .*; nothing was sent$"):
        run_motion(bench.robot, bench.target("J4", 0.1), options, wait=False)
    assert len(bench.targets) == sent
    run_motion(bench.robot, bench.target("J7", 0.1), options, wait=False)  # which no path can hit
    bench.arm.clock.advance(6.0)
    run_motion(bench.robot, bench.target("J4", 0.1), options, wait=False)


def test_a_stall_of_the_program_does_not_disturb_a_single_target() -> None:
    bench = Bench()
    goal = bench.target(seconds=1.0)
    begun: list[float] = []

    def stall(state: JointState) -> None:
        if not begun and bench.targets:
            begun.append(bench.arm.clock.time)
            bench.arm.wait(0.8)

    result = run_motion(bench.robot, goal, bench.options(), observer=Watched(stall))
    assert result.arrived
    # It takes the time that it was given.
    assert bench.arm.clock.time - begun[0] < 1.3
    assert len(bench.targets) == 1
