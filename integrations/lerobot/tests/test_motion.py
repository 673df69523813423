"""How an arm follows actions, in simulated time: as fast as its servos can, within the limits that it is given."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from itertools import pairwise

import pytest
from lerobot_robot_hexwire import HexwireSO101
from simulated import PERIOD, Sim, go

FASTEST = 312.0
"""Degrees per second that the data sheet of its servos says."""
PAN = "shoulder_pan.pos"


class Run:
    """A robot that has met its first action, for motion of one joint.

    Attributes:
        sent: Degrees by which what was sent is behind what was asked, of each action.
        lag: Likewise of the arm at the next observation.
    """

    def __init__(self, sim: Sim, robot: HexwireSO101, *, observing: bool = True) -> None:
        self.sim, self.robot, self.observing = sim, robot, observing
        self.sent: list[float] = []
        self.lag: list[float] = []
        self.rest = robot.get_observation()
        for _ in range(60):
            self.step(0.0)
        self.sent.clear()
        self.lag.clear()

    def step(self, angle: float) -> float:
        """Ask for an angle; returns what was sent."""
        if self.observing:
            self.lag.append(abs(self.robot.get_observation()[PAN] - angle))
        sent = self.robot.send_action(self.rest | {PAN: angle})[PAN]
        self.sent.append(abs(sent - angle))
        goal = self.sim.servos[0].registers.get("goal_position")
        assert self.robot._arm.values.value("shoulder_pan", self._angle(goal)) == pytest.approx(sent)
        self.sim.clock.advance(PERIOD)
        return sent

    def _angle(self, counts: int) -> float:
        return self.robot._arm.driver.model.joint("shoulder_pan").counts_to_angle(counts)

    def follow(self, path: Callable[[float], float], seconds: float) -> None:
        began = self.sim.clock()
        while self.sim.clock() - began < seconds:
            self.step(path(self.sim.clock() - began))


def made(monkeypatch: pytest.MonkeyPatch, *, observing: bool = True, **options: object) -> Run:
    sim = Sim(monkeypatch)
    robot = sim.device(table_mm=None, **options)
    robot.connect()
    return Run(sim, robot, observing=observing)


def sine(hertz: float) -> Callable[[float], float]:
    return lambda t: 40.0 * math.sin(math.tau * hertz * t)


@pytest.mark.parametrize("observing", [True, False])
def test_a_fast_swing_is_sent_as_it_is_asked(monkeypatch: pytest.MonkeyPatch, observing: bool) -> None:
    """251 degrees per second: more than the limits of planned motion, less than the servo can."""
    run = made(monkeypatch, observing=observing)
    run.follow(sine(1.0), 3.0)
    assert max(run.sent) < 0.1
    assert not run.robot.clipped
    if observing:
        assert max(run.lag) < 15.0


def test_what_the_servo_cannot_do_is_told_once_counted_and_returned(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    run = made(monkeypatch)
    caplog.set_level(logging.WARNING)
    run.follow(sine(1.5), 3.0)
    assert 5.0 < max(run.sent) < 28.0
    assert run.robot.clipped["shoulder_pan speed"] > 10
    told = [row.message for row in caplog.records]
    assert told.count("shoulder_pan is led faster than it may move, and comes later") == 1
    assert len(told) == len(run.robot.clipped)


@pytest.mark.parametrize(("most", "fastest"), [(None, FASTEST), (90.0, 90.0), (200.0, 200.0)])
def test_a_jump_is_followed_at_the_speed_that_is_configured(
    monkeypatch: pytest.MonkeyPatch, most: float | None, fastest: float
) -> None:
    speed = None if most is None else dict.fromkeys(("shoulder_pan",), most)
    if speed is not None:
        speed |= dict.fromkeys(("shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"), 10.0)
    run = made(monkeypatch, max_speed=speed)
    began, before = run.sim.clock(), 0.0
    while (sent := run.step(80.0)) < 79.9:
        assert sent - before <= fastest * PERIOD + 0.3
        before = sent
    seconds = run.sim.clock() - began
    assert seconds == pytest.approx(80.0 / fastest, abs=0.1)
    assert run.robot.clipped["shoulder_pan speed"] > 5


def test_a_configured_acceleration_is_kept_and_passes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    most = 600.0
    run = made(monkeypatch, max_acceleration=most)
    places = [0.0, 0.0]
    while len(places) < 120:
        places.append(run.step(60.0))
    speeds = [(b - a) / PERIOD for a, b in pairwise(places)]
    changes = [(b - a) / PERIOD for a, b in pairwise(speeds)]
    # A count of 0.09 degrees is 5 degrees per second in a cycle.
    assert max(map(abs, changes)) <= most * 1.2 + 400.0
    assert max(speeds) == pytest.approx(math.sqrt(most * 60.0), rel=0.15)
    assert max(places) <= 60.1
    assert places[-1] == pytest.approx(60.0, abs=0.1)
    assert "shoulder_pan acceleration" in run.robot.clipped


def test_a_blocked_joint_is_not_led_away(monkeypatch: pytest.MonkeyPatch) -> None:
    run = made(monkeypatch)
    servo = run.sim.servos[0]
    servo.motion.obstacle = (None, servo.motion.position + 10.0)
    for _ in range(120):
        sent = run.step(80.0)
    assert sent - run.robot.get_observation()[PAN] == pytest.approx(12.0, abs=0.5)
    assert "shoulder_pan held" in run.robot.clipped


def test_actions_beyond_the_limits_are_told_and_counted(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    run = made(monkeypatch)
    caplog.set_level(logging.WARNING)
    run.follow(lambda t: min(80.0 * t, 130.0), 3.0)
    assert run.step(130.0) < 115.0
    assert run.robot.clipped["shoulder_pan limits"] > 10
    assert [row.message for row in caplog.records] == ["shoulder_pan is led beyond its limits"]


def test_the_first_action_and_one_after_a_pause_are_still_met_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    run = made(monkeypatch)
    run.sim.clock.advance(2.0)
    before = 0.0
    for _ in range(30):
        sent = run.step(70.0)
        # A fifth of 180 degrees per second.
        assert sent - before <= 36.0 * PERIOD + 0.2
        before = sent
    assert run.robot.clipped.keys() == {"shoulder_pan meeting"}


def test_a_speed_that_the_servos_do_not_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Sim(monkeypatch).device(max_speed=400.0)
    with pytest.raises(ValueError, match="shoulder_pan reaches 312 degrees a second, not 400"):
        robot.connect()
    assert not robot.is_connected


def test_the_way_to_the_first_action_is_told_and_counted(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(table_mm=None)
    robot.connect()
    caplog.set_level(logging.WARNING)
    far = robot.get_observation() | {PAN: 30.0}
    go(sim, robot, far, 0.5)
    assert [row.message for row in caplog.records] == ["shoulder_pan goes slowly to where it is led, at first"]
    assert robot.clipped == {"shoulder_pan meeting": 30}
    go(sim, robot, far, 3.0)
    counted = robot.clipped["shoulder_pan meeting"]
    go(sim, robot, far, 1.0)
    assert robot.clipped["shoulder_pan meeting"] == counted
    robot.disconnect()


def test_a_limit_of_distance_is_told_once_and_counted(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sim = Sim(monkeypatch)
    robot = sim.device(table_mm=None, max_relative_target=5.0)
    robot.connect()
    rest = robot.get_observation()
    go(sim, robot, rest, 1.0)
    caplog.set_level(logging.WARNING)
    before = robot.get_observation()[PAN]
    sent = robot.send_action(rest | {PAN: before + 30.0})
    assert sent[PAN] <= before + 5.1
    go(sim, robot, rest | {PAN: before + 30.0}, 0.1)
    assert [row.message for row in caplog.records] == ["shoulder_pan is led further at once than it may go"]
    assert robot.clipped["shoulder_pan distance"] > 3
    robot.disconnect()
