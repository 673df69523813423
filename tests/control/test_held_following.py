"""An arm that follows a leader while a person attends to it, in simulated time: its ends, and its speed."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import pytest
from tests.control.test_following import Arm

from hexwire.control.loop.owner import RobotOwner, release
from hexwire.control.motion.following import following_rules
from hexwire.control.motion.held_following import HeldFollowing
from hexwire.control.motion.path_check import PathCheck
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.serve import FakeClock
from hexwire.motion.safety import StopReason

PERIOD, SILENCE = 0.04, 0.25


class Rig:
    """A leader and its follower, and somebody who attends to it as long as `heard` grows."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        self.leader, self.follower = Arm(self.clock, leader=True), Arm(self.clock)
        for arm in (self.leader, self.follower):
            arm.driver.attach()
        self.follower.driver.torque(True)
        self.leader.driver.torque(False)
        self.check = PathCheck.of(self.follower.driver, None)
        self.attended, self.heard, self.lost = True, self.clock(), ""
        self.ends: list[str] = []
        self.owner = RobotOwner(
            self.follower.driver, borrowed=True, command_rate=1 / PERIOD, sleep=self.clock.advance
        )
        self.owner.connect()
        self.begin()

    def begin(self) -> HeldFollowing:
        """Begin once more."""
        self.attended, self.heard, self.lost = True, self.clock(), ""
        self.ends.clear()
        leader, follower = self.leader.driver, self.follower.driver
        speeds = {joint.name: 0.5 * joint.max_speed for joint in follower.model.joints}
        self.controller = HeldFollowing(
            following_rules(leader, follower, self.check, max_speed=speeds),
            leader.read_positions,
            leader.now,
            PERIOD,
            age=lambda: self.clock() - self.heard,
            silence=SILENCE,
            check=self.check,
            lost=lambda: self.lost,
            on_end=self.ends.append,
        )
        self.owner.group.members = (self.controller,)
        return self.controller

    def run(self, seconds: float) -> list[float]:
        """Goals of the first joint, degrees."""
        end, goals = self.clock() + seconds, []
        first = self.follower.driver.model.joints[0]
        while self.clock() < end:
            if self.attended:
                self.heard = self.clock()
            self.owner.turn()
            goals.append(math.degrees(first.counts_to_angle(self.follower.goals[0])))
        return goals


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    release(made.follower.driver, made.owner)


def test_it_ends_for_good_in_every_way_and_the_follower_holds(rig: Rig) -> None:
    leader = rig.leader

    def fall_silent() -> None:
        leader.device.wire.faults = FaultPlan(("silent:1",))

    ways: dict[str, Callable[[], object]] = {
        "whoever held it is heard no more": lambda: setattr(rig, "attended", False),
        "released": lambda: rig.controller.release("released"),
        "the leader is unplugged": lambda: setattr(rig, "lost", "the leader is unplugged"),
        "the leader has been silent for 2 s": fall_silent,
        "the leader was stopped, so the follower holds": leader.driver.stop,
        "torque was switched off": lambda: rig.follower.driver.torque(False, ["gripper"]),
        "no answer from gripper for more than 1 s; check the servo": lambda: setattr(
            rig.follower.device.wire, "faults", FaultPlan(("silent:6",))
        ),
        "stopped by a test": lambda: rig.owner.group.stop(StopReason("asked", "stopped by a test")),
    }
    for why, end in ways.items():
        rig.begin()
        leader.made.servos[0].motion.position += 60
        rig.run(0.3)
        assert rig.controller.note == "the follower has met the leader", why
        assert not rig.ends, why
        end()
        rig.run(2.2 if end is fall_silent else 1.2 if "answer" in why else 0.3)
        assert rig.ends == [why]
        assert not rig.controller.busy, why
        goals = rig.follower.goals
        leader.device.wire.faults = rig.follower.device.wire.faults = FaultPlan(())
        leader.driver.resume()
        rig.attended, rig.lost = True, ""
        leader.made.servos[0].motion.position -= 40
        rig.run(0.2)
        assert rig.follower.goals == goals, f"{why}: it moves again"
        rig.follower.driver.torque(True)


def test_a_leader_that_jumps_or_was_silent_makes_no_follower_jump(rig: Rig) -> None:
    servo, most = rig.leader.made.servos[0], math.degrees(rig.follower.driver.model.joints[0].max_speed)
    rig.run(0.5)

    def fastest(goals: list[float]) -> float:
        return max(abs(b - a) for a, b in itertools.pairwise(goals)) / PERIOD

    servo.motion.position += 500
    # What a hand moves is followed at half of its limits, as was asked for, but not faster.
    assert 0.4 * most < fastest(rig.run(0.4)) < 0.55 * most
    rig.run(1.0)
    rig.leader.device.wire.faults = FaultPlan(("silent:1",))
    rig.run(0.5)
    assert "the leader is silent" in rig.controller.note
    servo.motion.position -= 500
    rig.leader.device.wire.faults = FaultPlan(())
    # After a pause the arms meet again.
    goals = rig.run(0.5)
    assert 0.1 * most < fastest(goals) < 0.25 * most
    assert not rig.ends
