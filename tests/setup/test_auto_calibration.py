"""The order of motions of an automatic calibration, and its machine on states made by hand."""

from __future__ import annotations

import math
import re

import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.model.arm import ArmModel
from hexwire.model.arms import Go, Seek
from hexwire.model.arms.so_arm import SO101
from hexwire.model.arms.so_arm.kinematics import SoArmModel
from hexwire.model.state import JointFlag, JointState
from hexwire.setup.auto_calibration import COUNT, AutoCalibration

PROFILE = load_profile("so101").model
BEYOND = 5.0
"""Degrees by which a stop may lie beyond the published end of a range."""
assert SO101.assembly is not None
SEARCH = SO101.assembly.search
FOLDED = {"shoulder_lift": -95.0, "elbow_flex": 90.0, "wrist_flex": 50.0, "gripper": 0.0}


def heights(angles: dict[str, float]) -> float:
    """Lowest of elbow, wrist and tip, metres, in the worst roll of the gripper."""
    kinematics = SoArmModel()
    lowest = math.inf
    for roll in range(-180, 180, 30):
        pose = [math.radians(angles.get(r.name, roll)) for r in kinematics.ranges]
        points = (kinematics.elbow(pose), kinematics.wrist(pose), kinematics.forward(pose).position)
        lowest = min(lowest, *(point[2] for point in points))
    return lowest


def test_the_order_keeps_the_arm_off_the_table() -> None:
    here = FOLDED | {"shoulder_pan": 0.0}
    known: dict[str, set[int]] = {name: set() for name in PROFILE.names}
    lowest = math.inf
    for step in SEARCH:
        there = dict(here)
        if isinstance(step, Go):
            for name in step.angles:
                assert known[name], f"{name} is not known yet"
            there |= step.angles
        else:
            joint = PROFILE.joint(step.joint)
            end = math.degrees(joint.maximum if step.direction > 0 else joint.minimum)
            there[step.joint] = end + step.direction * BEYOND
            known[step.joint].add(step.direction)
        for i in range(11):
            way = {name: here[name] + (there[name] - here[name]) * i / 10 for name in here}
            if step is not SEARCH[0] or i > 2:
                # It begins on the table, with the gripper lying there.
                lowest = min(lowest, heights(way))
        here = there
        if isinstance(step, Seek):
            here[step.joint] -= step.direction * 7.0
    assert lowest > 0.02
    assert all(len(known[name]) == 2 for name in PROFILE.names if name != "wrist_roll")


class Plant:
    """One joint that follows its target until it meets a stop."""

    def __init__(self, auto: AutoCalibration, low: float, high: float, place: float) -> None:
        self.auto, self.low, self.high, self.place = auto, low, high, place
        self.now, self.load, self.current = 0.0, 0.3, 0.7
        self.flags = JointFlag(0)
        self.wobble = 0.0

    def turn(self) -> None:
        self.now += 0.02
        state = JointState(
            names=("a",),
            position=(round(self.place) * COUNT,),
            velocity=(0.0,),
            load=(self.load,),
            current=(self.current,),
            voltage=(7.0,),
            temperature=(30.0,),
            flags=(int(self.flags),),
            age=(0.0,),
            stamp=self.now,
            stopped=False,
        )
        self.auto.judge(state, (0.0,), self.now)
        target = self.auto.cycle(state, self.now, 0.03)
        if target is not None:
            goal = dict(target.positions)["a"] / COUNT
            assert abs(goal - round(self.place)) < 32.0, "a target leads its joint too far"
            self.place = max(self.low, min(self.high, goal)) if self.load else self.place

    def run(self, seconds: float = 60.0) -> AutoCalibration:
        while not self.auto.over and self.now < seconds:
            self.turn()
        return self.auto


def plant(low: float = -900.0, high: float = 1100.0, place: float = 0.0) -> Plant:
    joint = PROFILE.joint("wrist_flex")
    one = ArmModel(
        "one",
        (type(joint)("a", 1, "sts_sms", 0, 1, 0.0, COUNT, -1000 * COUNT, 1000 * COUNT, 1.0),),
    )
    plan = (Seek("a", -1), Seek("a", 1), Go({"a": 0.0}))
    return Plant(AutoCalibration(one, plan=plan), low, high, place)


@pytest.mark.parametrize("place", [-900.0, -850.0, 0.0, 1100.0])
def test_both_stops_are_found_from_anywhere(place: float) -> None:
    parts = plant(place=place)
    auto = parts.run()
    assert auto.fault == ""
    assert auto.ranges == {"a": (-894, 1094)}
    assert parts.place == pytest.approx(100.0, abs=1.0)
    assert auto.step == auto.steps == 3
    assert auto.doing == ""


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (-800.0, 900.0, "a turns by 149 deg and not by about 176: it met something"),
        (-900.0, 1500.0, "a turned by 203 deg without meeting a stop: is its horn loose"),
        (-9000.0, 0.0, "without meeting a stop"),
    ],
)
def test_a_range_that_cannot_be_is_refused(low: float, high: float, said: str) -> None:
    assert said in plant(low, high).run().fault


def test_a_stop_that_is_elsewhere_each_time_is_refused() -> None:
    parts, moved = plant(), False
    while not parts.auto.over:
        parts.turn()
        if parts.place == parts.low:
            moved = True
        elif moved and parts.place > parts.low + 60:
            parts.low += 10.0
            moved = False
    assert parts.auto.fault == "a stops elsewhere each time: is something soft in its way?"


def test_a_joint_that_stands_still_without_pushing_is_no_stop() -> None:
    for load, current in ((0.05, 0.7), (0.3, 0.01)):
        parts = plant()
        for _ in range(20):
            parts.turn()
        parts.low = parts.place
        parts.load, parts.current = load, current
        assert "a stands still but does not push" in parts.run().fault


def test_a_joint_that_reports_no_current_is_judged_by_its_load() -> None:
    parts = plant()
    parts.current = math.nan
    assert parts.run().fault == ""


def test_silence_and_faults() -> None:
    parts = plant()
    for _ in range(50):
        parts.turn()
    parts.flags = JointFlag.SILENT
    for _ in range(14):
        parts.turn()
    assert parts.auto.fault == ""
    assert parts.run(parts.now + 1.0).fault == "a fell silent: check cable and power"
    parts = plant()
    parts.flags = JointFlag.OVERLOAD
    assert parts.run(1.0).fault == "a reports overload"


def test_one_late_answer_after_this_computer_stalled_is_no_silence() -> None:
    parts = plant()
    for _ in range(50):
        parts.turn()
    parts.now += 2.0
    parts.flags = JointFlag.SILENT
    for _ in range(4):
        parts.turn()
    parts.flags = JointFlag(0)
    assert parts.run().fault == ""


def test_every_fault_on_a_computer_that_is_too_slow_says_so() -> None:
    def silent(parts: Plant) -> None:
        parts.flags = JointFlag.SILENT

    def pushed(parts: Plant) -> None:
        parts.place += 400.0

    def braked(parts: Plant) -> None:
        parts.low = parts.high = parts.place

    for happens in (silent, pushed, braked):
        for late in (0.12, 0.5, 2.0, 9.0):
            parts = plant()
            for _ in range(50):
                parts.turn()
            for _ in range(8):
                parts.now += late
                parts.turn()
            happens(parts)
            while not parts.auto.over:
                parts.now += late
                parts.turn()
            said = re.match(r"this computer is too slow: it lost ([\d.]+) of the last 5 s", parts.auto.fault)
            assert said, (happens, late)
            assert 0.3 <= float(said[1]) <= 5.0
    # What a servo itself reports is true on any computer.
    parts = plant()
    parts.turn()
    parts.now += 3.0
    parts.flags = JointFlag.OVERLOAD
    assert parts.run(parts.now + 1.0).fault == "a reports overload"


def test_nothing_is_sent_before_every_position_is_known() -> None:
    parts = plant()
    parts.flags = JointFlag.SILENT
    parts.turn()
    assert parts.auto.doing == "a: looks for its lower stop"
    assert not parts.auto.moving
    assert math.isnan(parts.auto.positions["a"])


def test_a_failure_that_the_caller_saw_is_kept() -> None:
    parts = plant()
    parts.turn()
    parts.auto.fail("first")
    parts.auto.fail("second")
    assert parts.run().fault == "first"


def test_a_weak_position_gain_needs_a_longer_lead() -> None:
    joint = PROFILE.joints[0]
    one = ArmModel("one", (joint,))
    usual, weak = (AutoCalibration(one, plan=(), gains={joint.name: gain}) for gain in (32, 16))
    leads = [auto._pushes[joint.name].lead for auto in (usual, weak)]
    assert leads == pytest.approx([0.3 * 64 + 12, 0.3 * 128 + 12])
