from __future__ import annotations

import math
import threading
from itertools import pairwise

import pytest
from tests.drivers.arms import Arm
from tests.motion import arms
from tests.motion.arms import HOME, FakeRobot

from hexwire.control.loop import MotionLoop, RateLoop
from hexwire.errors import LimitError, LinkLostError, StoppedError, UsageError
from hexwire.model.hex7bot import HEX7BOT
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.follower import Follower
from hexwire.motion.trajectory import Quintic
from hexwire.motion.waypoints import PointToPoint


class FakeTime:
    """A clock that only sleep and work advance; `oversleep` seconds are added to each sleep."""

    def __init__(self, oversleep: float = 0.0) -> None:
        self.now = 1000.0
        self.oversleep = oversleep
        self.slept: list[float] = []

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.slept.append(seconds)
        self.now += seconds + self.oversleep


def make(rate: float, time: FakeTime, **options: float) -> RateLoop:
    return RateLoop(rate, clock=time.clock, sleep=time.sleep, **options)


def test_cycles_start_on_the_raster_whatever_a_cycle_takes() -> None:
    time = FakeTime()
    loop = make(10, time)
    starts = []
    for due in loop.ticks(0.5):
        starts.append((due, time.now - 1000.0))
        time.now += 0.03 * len(starts) % 0.09
    assert [due for due, _ in starts] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert [now for _, now in starts] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert loop.counters.late == loop.counters.skipped == 0
    assert loop.achieved == pytest.approx(10.0)
    assert time.now - 1000.0 == pytest.approx(0.5), "the last cycle has its whole period"


def test_oversleeping_does_not_add_up() -> None:
    time = FakeTime(oversleep=0.004)
    loop = make(100, time)
    starts = [time.now - 1000.0 for _ in loop.ticks(1.0)]
    assert len(starts) == 100
    assert starts[-1] == pytest.approx(0.99 + 0.004)
    assert loop.counters.worst == pytest.approx(0.004)
    assert loop.counters.late == 99
    assert loop.counters.late_by == pytest.approx(99 * 0.004)
    assert loop.counters.skipped == 0


def test_a_cycle_just_over_its_period_makes_the_next_late_but_skips_nothing() -> None:
    time = FakeTime()
    loop = make(10, time, tolerance=0.01)
    starts = []
    for due in loop.ticks(0.4):
        starts.append(due)
        time.now += 0.105 if len(starts) == 1 else 0.0
    assert starts == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert loop.counters.skipped == 0
    assert loop.counters.late == 0
    assert loop.counters.worst == pytest.approx(0.005)


def test_deadlines_that_were_run_over_are_skipped_not_made_up_for() -> None:
    time = FakeTime()
    loop = make(10, time)
    starts = []
    for due in loop.ticks(1.0):
        starts.append((due, time.now - 1000.0))
        time.now += 0.35 if len(starts) == 2 else 0.0
    # The second cycle lasts from 0.1 to 0.45: those due at 0.2, 0.3 and 0.4 never start.
    assert [due for due, _ in starts] == pytest.approx([0.0, 0.1, 0.5, 0.6, 0.7, 0.8, 0.9])
    assert [now for _, now in starts] == pytest.approx([0.0, 0.1, 0.5, 0.6, 0.7, 0.8, 0.9])
    assert loop.counters.skipped == 3
    assert loop.counters.cycles == 7
    assert loop.achieved == pytest.approx(6 / 0.9)


@pytest.mark.parametrize(("duration", "cycles"), [(0.3, 3), (0.31, 4), (0.1, 1), (0.05, 1), (0.0, 0)])
def test_how_many_cycles_a_duration_has(duration: float, cycles: int) -> None:
    time = FakeTime()
    loop = make(10, time)
    assert len(list(loop.ticks(duration))) == loop.counters.cycles == cycles


def test_it_goes_on_for_ever_if_not_told() -> None:
    time = FakeTime()
    loop = make(1000, time)
    for due in loop.ticks():
        if due > 5:
            break
    assert loop.counters.cycles == 5002
    assert loop.achieved == pytest.approx(1000)


def test_before_two_cycles_there_is_no_rate() -> None:
    loop = make(10, FakeTime())
    assert loop.achieved == 0.0
    next(loop.ticks())
    assert loop.achieved == 0.0


@pytest.mark.parametrize("rate", [0, -1, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="makes no sense"):
        RateLoop(rate)


# -- the loop that moves a robot -----------------------------------------------------------------------


def moving(rate: float = 20.0) -> tuple[MotionLoop, FakeRobot, arms.FakeTime]:
    time = arms.FakeTime()
    robot = FakeRobot(time)
    loop = MotionLoop(robot, Follower(HEX7BOT), rate, clock=time.clock, sleep=time.sleep)
    loop.run(0.1)
    return loop, robot, time


def way_of_j1(goal: float, seconds: float = 1.0) -> PointToPoint:
    return PointToPoint(("J1",), Quintic((HOME["J1"],), (HOME["J1"] + goal,), seconds))


def test_the_robot_follows_to_the_end() -> None:
    loop, robot, _ = moving()
    loop.follow(way_of_j1(0.8))
    seen: list[float] = []
    assert loop.run(5.0, until_done=True, each=lambda s: seen.append(s["J1"].position)) is None
    assert loop.follower.done
    loop.run(0.2)
    assert robot.read()["J1"].position == pytest.approx(HOME["J1"] + 0.8)
    assert seen == sorted(seen)
    assert loop.timing.counters.late == 0


def test_targets_are_sent_in_order_one_a_cycle() -> None:
    loop, robot, _ = moving()
    loop.follow(way_of_j1(0.8))
    loop.run(5.0, until_done=True)
    times = [t for t, _ in robot.targets]
    assert all(b - a == pytest.approx(0.05) for a, b in pairwise(times))
    assert all(target.duration == pytest.approx(0.075) for _, target in robot.targets)


def test_a_jam_stops_the_robot() -> None:
    loop, robot, _ = moving()
    loop.follow(way_of_j1(0.8))
    loop.run(0.3)
    robot.jammed = {"J1": HOME["J1"] + 0.02}
    reason = loop.run(5.0, until_done=True)
    assert reason is not None
    assert reason.kind == "collision"
    assert robot.stops == 1
    count = len(robot.targets)
    loop.run(0.5)
    assert len(robot.targets) == count, "nothing is sent to a stopped arm"


def test_emergency_stop_reaches_the_robot_at_once_and_stays() -> None:
    loop, robot, _ = moving()
    loop.follow(way_of_j1(0.8))
    loop.run(0.2)
    count = len(robot.targets)
    loop.emergency_stop("the red button")
    assert robot.stops == 1
    assert str(loop.run(1.0)) == "the red button"
    assert len(robot.targets) == count
    with pytest.raises(LimitError, match="red button"):
        loop.set_point({"J1": HOME["J1"]})


def test_emergency_stop_from_another_thread() -> None:
    loop, robot, _ = moving()
    loop.follow(way_of_j1(0.8))
    thread = threading.Thread(target=loop.emergency_stop)
    thread.start()
    thread.join()
    assert str(loop.run(1.0)) == "emergency stop"
    assert robot.stops == 1


def test_set_points_and_hold() -> None:
    loop, robot, _ = moving()
    loop.set_point({"J1": HOME["J1"] + 0.05})
    loop.cycle()
    assert robot.targets[-1][1].positions == (("J1", pytest.approx(HOME["J1"] + 0.05)),)
    loop.hold()
    count = len(robot.targets)
    loop.run(0.5)
    assert len(robot.targets) == count


def test_a_stop_between_read_and_write_is_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, robot, _ = moving()

    def refuse(target: JointTarget) -> None:
        raise StoppedError("JOINT_MOVE", 5, "the arm is stopped")

    monkeypatch.setattr(robot, "write", refuse)
    loop.follow(way_of_j1(0.8))
    reason = loop.run(1.0, until_done=True)
    assert reason is not None
    assert reason.kind == "board"


def test_a_robot_that_fails_is_stopped_and_the_error_comes_out(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, robot, _ = moving()

    def gone() -> JointState:
        raise LinkLostError("unplugged")

    monkeypatch.setattr(robot, "read", gone)
    loop.follow(way_of_j1(0.8))
    with pytest.raises(LinkLostError):
        loop.run(1.0)
    assert robot.stops == 1
    assert loop.follower.reason is not None
    assert loop.follower.reason.kind == "lost"


def test_a_stop_voids_what_is_followed_though_it_is_resumed_at_once() -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    loop = MotionLoop(arm.driver, Follower(arm.driver.model), clock=arm.clock, sleep=arm.wait)
    loop.cycle()
    positions = arm.driver.read().positions
    loop.set_point({"J4": positions["J4"] + 0.5})
    loop.cycle()
    # Another thread stops and resumes between two cycles, which no state shows.
    arm.driver.stop()
    arm.driver.resume()
    held = arm.board.wire[3].registers.get("target_position")
    reason = loop.run(1.0)
    assert reason is not None
    assert "stop" in str(reason)
    assert arm.board.wire[3].registers.get("target_position") == held
    assert arm.board.state.watchdog_timeout == 0
