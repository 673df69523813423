from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import LimitError, UsageError
from hexwire.model.gripper import jaws_of
from hexwire.motion.following import Behind, Following, FollowStep, GripForce
from hexwire.motion.teleop import Action

ARM = load_profile("so101").model
HOME = dict.fromkeys(ARM.names, 0.0)
PERIOD = 0.01
JAWS = jaws_of(ARM)
assert JAWS is not None
HOME["gripper"] = JAWS.opened


class Run:
    """A follower that gets to each set-point at once, unless a test says otherwise."""

    def __init__(self, rules: Following, positions: Mapping[str, float] = HOME) -> None:
        self.rules, self.positions, self.now = rules, dict(positions), 100.0
        self.loads = dict.fromkeys(ARM.names, 0.0)
        self.fixed: set[str] = set()

    def cycle(self, leader: Mapping[str, float], age: float = 0.0) -> FollowStep:
        self.now += PERIOD
        step = self.rules.update(leader, age, self.positions, self.loads, self.now)
        self.positions |= {name: angle for name, angle in step.positions.items() if name not in self.fixed}
        return step

    def cycles(self, leader: Mapping[str, float], count: int) -> FollowStep:
        for _ in range(count):
            step = self.cycle(leader)
        return step


def test_it_meets_the_leader_slowly_and_follows_fast() -> None:
    run = Run(Following(ARM, ARM, share=0.1))
    leader = HOME | {"elbow_flex": 1.0}
    joint = ARM.joint("elbow_flex")
    first = run.cycles(leader, 2).positions["elbow_flex"]
    assert first == pytest.approx(0.1 * joint.max_speed * PERIOD)
    while not (step := run.cycle(leader)).met:
        assert step.action is Action.MOVE
    run.cycles(leader, 50)
    assert run.positions == pytest.approx(leader)
    step = run.cycle(HOME | {"elbow_flex": -1.0})
    assert joint.guided_speed > joint.max_speed
    assert step.positions["elbow_flex"] == pytest.approx(1.0 - min(joint.guided_speed * PERIOD, math.radians(12.0)))


angles = st.floats(-4.0, 4.0) | st.just(math.nan)


@given(st.lists(st.tuples(angles, angles, st.floats(0.0, 0.5)), min_size=1, max_size=30))
def test_no_set_point_jumps_or_leaves_the_limits(leads: list[tuple[float, float, float]]) -> None:
    run = Run(Following(ARM, ARM))
    for pan, jaws, age in leads:
        before = dict(run.positions)
        step = run.cycle(HOME | {"shoulder_pan": pan, "gripper": jaws}, age)
        for name, angle in step.positions.items():
            joint = ARM.joint(name)
            assert joint.minimum <= angle <= joint.maximum
            assert abs(angle - before[name]) <= joint.guided_speed * PERIOD + 1e-9
        if math.isnan(pan) or math.isnan(jaws) or age >= 0.25:
            assert step.action is not Action.MOVE


def test_a_silent_leader_holds_the_follower_once_and_it_meets_again() -> None:
    run = Run(Following(ARM, ARM))
    leader = HOME | {"elbow_flex": 0.5}
    assert run.cycles(leader, 400).met
    assert run.cycle(leader, age=0.3).action is Action.HOLD
    assert run.cycle(leader, age=0.3).action is Action.IDLE
    assert not run.cycle(leader | {"elbow_flex": -0.5}).met


def test_unknown_positions_of_the_follower_move_nothing() -> None:
    run = Run(Following(ARM, ARM), HOME | {"elbow_flex": math.nan})
    step = run.cycle(HOME)
    assert (step.action, step.positions) == (Action.IDLE, {})
    assert "follower are unknown" in step.note


def test_arms_that_face_each_other() -> None:
    run = Run(Following(ARM, ARM, mirror=frozenset(["shoulder_pan"])))
    run.cycles(HOME | {"shoulder_pan": 0.4, "elbow_flex": 0.3}, 500)
    assert run.positions["shoulder_pan"] == pytest.approx(-0.4)
    assert run.positions["elbow_flex"] == pytest.approx(0.3)


def test_a_blocked_joint_keeps_its_set_point_near() -> None:
    run = Run(Following(ARM, ARM))
    run.fixed = {"elbow_flex"}
    step = run.cycles(HOME | {"elbow_flex": 1.5}, 1000)
    assert step.positions["elbow_flex"] == pytest.approx(math.radians(12.0))


def test_a_joint_that_moves_is_led_further_than_one_that_is_blocked() -> None:
    start = HOME | {"elbow_flex": -1.5}
    run = Run(Following(ARM, ARM), start)
    run.cycles(start, 10)
    run.fixed = {"elbow_flex"}
    leads, speed = [], math.radians(200.0)
    for _ in range(100):
        run.positions["elbow_flex"] += speed * PERIOD
        step = run.cycle(HOME | {"elbow_flex": 1.6})
        leads.append(step.positions["elbow_flex"] - run.positions["elbow_flex"])
        if run.positions["elbow_flex"] > 0.8:
            break
    # As far as it gets in a tenth of a second.
    assert max(leads) == pytest.approx(math.radians(12.0) + 0.1 * speed, rel=0.05)
    assert step.behind["elbow_flex"] is Behind.HELD
    # A hand that pushes it the other way gives it nothing.
    run.positions["elbow_flex"] -= 0.5
    step = run.cycle(HOME | {"elbow_flex": 1.6})
    assert step.positions["elbow_flex"] - run.positions["elbow_flex"] <= math.radians(12.0) + 1e-9


def test_why_a_joint_is_behind() -> None:
    run = Run(Following(ARM, ARM))
    assert not run.cycle(HOME | {"elbow_flex": 1.0, "wrist_flex": 9.0}).behind, "it has not met the leader yet"
    run.cycles(HOME, 300)
    step = run.cycle(HOME | {"elbow_flex": 1.0, "wrist_flex": 9.0})
    assert step.behind == {"elbow_flex": Behind.SPEED, "wrist_flex": Behind.SPEED}
    assert run.cycles(HOME | {"wrist_flex": 9.0}, 200).behind == {"wrist_flex": Behind.LIMITS}


@given(
    st.lists(st.tuples(st.floats(-1.5, 1.5), st.integers(1, 20)), min_size=1, max_size=15),
    st.floats(1.0, 5.0),
    st.floats(2.0, 60.0),
)
def test_limits_of_speed_and_acceleration_are_kept_wherever_it_is_led(
    legs: list[tuple[float, int]], speed: float, acceleration: float
) -> None:
    run = Run(
        Following(ARM, ARM, speeds={"shoulder_pan": speed}, accelerations={"shoulder_pan": acceleration}, share=1.0)
    )
    places, velocity = [0.0], 0.0
    for pan, cycles in legs:
        for _ in range(cycles):
            places.append(run.cycle(HOME | {"shoulder_pan": pan}).positions["shoulder_pan"])
            after = (places[-1] - places[-2]) / PERIOD
            assert abs(after) <= speed + 1e-9
            assert abs(after - velocity) <= acceleration * PERIOD + 1e-9
            velocity = after
    end = run.cycles(HOME | {"shoulder_pan": legs[-1][0]}, 700)
    assert end.positions["shoulder_pan"] == pytest.approx(legs[-1][0], abs=1e-6)


def test_limits_that_make_no_sense_are_refused() -> None:
    with pytest.raises(UsageError, match=r"the acceleration of gripper must be above 0, not -57"):
        Following(ARM, ARM, accelerations={"gripper": -1.0})
    with pytest.raises(UsageError, match=r"gripper reaches 312 degrees a second, not 57.*free_speed_deg_per_s"):
        Following(ARM, ARM, speeds={"gripper": 10.0})
    with pytest.raises(UsageError, match="nobody"):
        Following(ARM, ARM, speeds={"nobody": 1.0})


def test_a_joint_outside_its_limits_goes_back_slowly_and_then_follows() -> None:
    """As after a calibration, when an arm without torque leans on a stop."""
    joint = ARM.joint("elbow_flex")

    def check(before: Mapping[str, float], goal: Mapping[str, float]) -> None:
        for name, angle in goal.items():
            if not ARM.joint(name).minimum <= angle <= ARM.joint(name).maximum:
                raise LimitError(f"{name} is outside its limits")

    run = Run(Following(ARM, ARM, share=0.1, check=check), HOME | {"elbow_flex": joint.maximum + 0.5})
    step = run.cycle(HOME)
    assert step.positions["elbow_flex"] == joint.maximum
    assert step.least == pytest.approx(0.5 / (0.1 * joint.max_speed))
    assert (run.cycle(HOME).least, run.cycles(HOME, 2000).note) == (0.0, "")
    assert run.positions == pytest.approx(HOME)


def test_where_the_follower_must_not_go_it_stays() -> None:
    def check(before: Mapping[str, float], goal: Mapping[str, float]) -> None:
        if goal["elbow_flex"] > 0.2:
            raise LimitError("the table is in the way")

    run = Run(Following(ARM, ARM, check=check))
    step = run.cycles(HOME | {"elbow_flex": 1.0}, 500)
    assert step.note == "the table is in the way"
    assert 0.1 < step.positions["elbow_flex"] <= 0.2
    assert run.cycles(HOME, 500).positions == pytest.approx(HOME)


def test_a_tool_at_the_table_slides_along_it() -> None:
    def check(before: Mapping[str, float], goal: Mapping[str, float]) -> None:
        if goal["shoulder_lift"] > 0.5:
            raise LimitError("the tool would be 9 mm below the table; nothing was sent")

    run = Run(Following(ARM, ARM, share=1.0, check=check))
    leader = HOME | {"shoulder_lift": 0.8, "shoulder_pan": 0.6, "elbow_flex": -0.4}
    step = run.cycles(leader, 300)
    assert step.note == "the tool would be 9 mm below the table"
    assert step.positions["shoulder_pan"] == pytest.approx(0.6)
    assert step.positions["elbow_flex"] == pytest.approx(-0.4)
    assert 0.45 < step.positions["shoulder_lift"] <= 0.5
    assert step.behind == {}, "it has not met the leader"
    met = run.cycles(HOME, 600)
    assert met.met
    assert run.cycles(leader, 300).behind == {"shoulder_lift": Behind.FORBIDDEN}
    assert run.cycles(leader | {"shoulder_lift": 0.2}, 300).positions["shoulder_lift"] == pytest.approx(0.2)


# --- the gripper ---------------------------------------------------------------------------------------------


def test_jaws_of_different_travel_open_alike() -> None:
    wide = replace(
        ARM,
        joints=tuple(replace(j, minimum=-0.2, maximum=0.8) if j.name == "gripper" else j for j in ARM.joints),
    )
    run = Run(Following(wide, ARM, grip=GripForce(JAWS)))
    run.cycles(HOME | {"gripper": 0.3}, 500)
    assert JAWS.share(run.positions["gripper"]) == pytest.approx(0.5)


@pytest.mark.parametrize("most", [0.1, 0.2, 0.35])
def test_the_gripper_presses_no_harder_on_what_it_holds(most: float) -> None:
    grip = GripForce(JAWS, most, math.radians(3.0))
    # Something is between the jaws, half open: the servo strains the more, the further its set-point is closed.
    block = JAWS.angle(0.5)
    run = Run(Following(ARM, ARM, grip=grip), HOME | {"gripper": block})
    run.fixed = {"gripper"}
    closed = HOME | {"gripper": JAWS.closed}
    hard = 0
    for _ in range(200):
        step = run.cycle(closed)
        strain = abs(step.positions["gripper"] - block)
        run.loads["gripper"] = min(1.0, strain / math.radians(8.0))
        hard += strain > grip.squeeze + 1e-9
        assert strain <= math.radians(12.0)
    # A stiff servo presses with the load that it may, and one that is not with 3 degrees.
    assert abs(step.positions["gripper"] - block) == pytest.approx(min(grip.squeeze, most * math.radians(8.0)))
    # It pushes harder only until it is sure that something is there.
    assert hard * PERIOD <= 0.25
    # It lets go when the leader opens.
    run.fixed = set()
    run.loads["gripper"] = 0.0
    assert JAWS.share(run.cycles(HOME, 300).positions["gripper"]) == pytest.approx(1.0)


@pytest.mark.parametrize("load", [0.9, math.nan])
def test_jaws_that_move_freely_hold_nothing_whatever_their_load(load: float) -> None:
    run = Run(Following(ARM, ARM, grip=GripForce(JAWS)))
    run.cycles(HOME, 50)
    # Turning fast needs as much of the motor as pressing; now and then it brakes.
    for cycle in range(200):
        run.loads["gripper"] = load if cycle % 10 else -load
        run.cycle(HOME | {"gripper": JAWS.closed})
    assert JAWS.share(run.positions["gripper"]) == pytest.approx(0.0)


def test_a_load_that_is_unknown_now_and_then_does_not_hide_what_the_jaws_hold() -> None:
    run = Run(Following(ARM, ARM, grip=GripForce(JAWS)), HOME | {"gripper": JAWS.angle(0.5)})
    run.fixed = {"gripper"}
    for cycle in range(100):
        ahead = abs(run.cycle(HOME | {"gripper": JAWS.closed}).positions["gripper"] - JAWS.angle(0.5))
        run.loads["gripper"] = math.nan if cycle % 3 else ahead / math.radians(12.0)
    assert ahead == pytest.approx(math.radians(3.0))


def test_what_pushes_the_jaws_open_is_pressed_from_where_it_stands() -> None:
    grip = GripForce(JAWS)
    run = Run(Following(ARM, ARM, grip=grip), HOME | {"gripper": JAWS.angle(0.5)})
    run.fixed = {"gripper"}
    run.loads["gripper"] = 0.5
    run.cycles(HOME | {"gripper": JAWS.closed}, 20)
    run.positions["gripper"] = JAWS.angle(0.6)
    step = run.cycles(HOME | {"gripper": JAWS.closed}, 30)
    assert 0.0 < abs(step.positions["gripper"] - JAWS.angle(0.6)) <= grip.squeeze


def test_what_slips_out_is_let_go() -> None:
    run = Run(Following(ARM, ARM, grip=GripForce(JAWS)))
    closed = HOME | {"gripper": JAWS.closed}
    run.cycles(HOME, 5)
    run.fixed, run.positions["gripper"], run.loads["gripper"] = {"gripper"}, JAWS.angle(0.5), 0.5
    held = run.cycles(closed, 20).positions["gripper"]
    run.loads["gripper"] = 0.0
    run.positions["gripper"] = JAWS.angle(0.3)
    run.fixed = set()
    assert JAWS.share(held) > 0.4
    assert JAWS.share(run.cycles(closed, 300).positions["gripper"]) == pytest.approx(0.0)


def test_what_is_taken_out_is_let_go_slowly() -> None:
    grip = GripForce(JAWS)
    run = Run(Following(ARM, ARM, grip=grip))
    closed = HOME | {"gripper": JAWS.closed}
    run.cycles(HOME, 5)
    run.fixed, run.positions["gripper"], run.loads["gripper"] = {"gripper"}, JAWS.angle(0.5), 0.5
    step = run.cycles(closed, 20)
    assert step.behind == {"gripper": Behind.GRIP}
    # Now nothing is between the jaws: they come to their set-point, and press on nothing.
    run.fixed, run.loads["gripper"] = set(), 0.0
    gone = run.cycles(closed, 5).positions["gripper"]
    later = run.cycles(closed, 10).positions["gripper"]
    share = 0.2 * ARM.joint("gripper").max_speed
    assert abs(later - gone) <= share * 10 * PERIOD + 1e-9
    assert JAWS.share(run.cycles(closed, 500).positions["gripper"]) == pytest.approx(0.0)


# --- what cannot be -----------------------------------------------------------------------------------------


def test_arms_with_different_joints_are_refused() -> None:
    fewer = replace(ARM, joints=ARM.joints[:5])
    with pytest.raises(UsageError, match="cannot lead so101: it has no gripper; the joints must match"):
        Following(fewer, ARM)


@pytest.mark.parametrize("share", [0.0, 1.1, math.nan])
def test_shares_that_make_no_sense_are_refused(share: float) -> None:
    with pytest.raises(UsageError, match="share of the speed limits"):
        Following(ARM, ARM, share=share)
    with pytest.raises(UsageError, match="gripper's force"):
        GripForce(JAWS, share)
