"""The rules of teleoperation, on synthetic sticks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import PUMA260, Puma260Model
from hexwire.model.geometry import kinematics_for
from hexwire.model.gripper import jaws_of
from hexwire.model.pose import rotation_between
from hexwire.motion.fence import Fence
from hexwire.motion.teleop import Action, Jog, JogMode, StickMap, Teleop, within_limits

DEAD_MAN = 1 << 4
MODE = 1 << 7
REST = (0.0,) * 8
HALF = {joint.name: 0.5 * (joint.minimum + joint.maximum) for joint in PUMA260.joints}
# Away from limits and singular poses.
PUMA_POSE = dict(zip(PUMA260.names, (0.5, -0.8, -0.3, 0.2, 0.5, 0.1), strict=True))


class Hand:
    """Holds the stick, and is an arm that follows at once unless told otherwise."""

    def __init__(self, rules: Teleop, positions: dict[str, float], period: float = 0.02) -> None:
        self.rules = rules
        self.positions = dict(positions)
        self.period = period
        self.now = 100.0
        self.follows = True

    def cycle(self, buttons: int = DEAD_MAN, age: float = 0.0, **axes: float) -> Jog:
        values = [0.0] * 8
        for name, value in axes.items():
            values[int(name[1:])] = value
        self.now += self.period
        jog = self.rules.update(values, buttons, age, self.positions, self.now)
        if jog.action is Action.MOVE and self.follows:
            self.positions = dict(jog.positions)
        return jog

    def begin(self) -> None:
        self.cycle(buttons=0)
        assert self.cycle().action is Action.MOVE

    def push(self, cycles: int = 40, **axes: float) -> Jog:
        """Hold the stick until the speed is the wanted one."""
        for _ in range(cycles):
            jog = self.cycle(**axes)
        return jog


def puma(mode: JogMode = JogMode.JOINT, **options: float) -> Hand:
    return Hand(Teleop(PUMA260, Puma260Model(), mode=mode, **options), PUMA_POSE)


def test_full_deflection_is_the_share_of_the_speed_limit() -> None:
    hand = puma(share=0.5)
    hand.begin()
    for _ in range(20):
        hand.cycle(a0=1.0)
    before = hand.positions["J1"]
    for _ in range(50):
        hand.cycle(a0=1.0)
    assert hand.positions["J1"] - before == pytest.approx(0.5 * PUMA260.joints[0].max_speed, rel=1e-6)
    assert {name: hand.positions[name] for name in PUMA260.names[1:]} == {
        name: PUMA_POSE[name] for name in PUMA260.names[1:]
    }


def test_nothing_moves_without_the_button() -> None:
    hand = puma()
    for _ in range(10):
        assert hand.cycle(buttons=0, a0=1.0) == Jog(Action.IDLE, {})
    assert hand.positions == PUMA_POSE


def let_go(hand: Hand, **given: float) -> list[float]:
    """The speeds of J1 from before the release on until nothing is sent any more."""
    places = [hand.positions["J1"]]
    while (jog := hand.cycle(a0=1.0, **given)).action is Action.MOVE:
        places.append(jog.positions["J1"])
    assert jog.action is Action.IDLE, "the last target is that of rest"
    return [(b - a) / hand.period for a, b in pairwise(places)]


@pytest.mark.parametrize("mode", JogMode)
def test_released_the_joints_brake_within_their_limits_and_rest(mode: JogMode) -> None:
    hand, joint = puma(mode, share=1.0, linear=0.3), PUMA260.joint("J1")
    hand.begin()
    before = 0.0
    for _ in range(15):
        place = hand.positions["J1"]
        hand.cycle(a0=1.0)
        before = (hand.positions["J1"] - place) / hand.period
    speeds = [before, *let_go(hand, buttons=0)]
    assert abs(before) > 0.09
    assert len(speeds) * hand.period > abs(before) / joint.max_acceleration
    for a, b in pairwise(speeds):
        assert abs(b) <= abs(a) + 0.02, "but for the acceleration that it had"
        assert abs(b - a) <= 1.001 * joint.max_acceleration * hand.period
    assert abs(speeds[-1]) < 0.02
    assert hand.cycle(buttons=0, a0=1.0).action is Action.IDLE


def test_pressed_again_the_joints_come_to_rest_first() -> None:
    hand = puma(share=1.0)
    hand.begin()
    for _ in range(5):
        hand.cycle(a0=1.0)
    hand.cycle(buttons=0)
    places = []
    for _ in range(30):
        jog = hand.cycle()
        assert jog.action is Action.MOVE
        places.append(jog.positions["J1"])
    assert all(a <= b + 1e-12 for a, b in pairwise(places)), "it does not go back to where the arm was measured"


def test_a_joint_that_does_not_follow_is_held_at_once() -> None:
    hand = puma(share=1.0)
    hand.begin()
    hand.follows = False
    while not hand.cycle(a0=1.0).note:
        pass
    assert hand.cycle(buttons=0).action is Action.HOLD
    assert hand.cycle(buttons=0).action is Action.IDLE


@pytest.mark.parametrize("released", [False, True])
@pytest.mark.parametrize("where", ["limit", "table"])
def test_the_joints_brake_before_a_place_where_the_arm_must_not_go(where: str, released: bool) -> None:
    hand, joint = puma(share=1.0), PUMA260.joint("J1")
    edge = PUMA_POSE["J1"] + 0.3 if where == "table" else joint.maximum

    def check(before: Mapping[str, float], goal: Mapping[str, float]) -> None:
        if where == "table" and goal["J1"] > edge:
            raise LimitError("the table")

    hand.rules = Teleop(PUMA260, Puma260Model(), share=1.0, check=check)
    hand.begin()
    hand.positions["J1"] = edge - 0.2
    hand.begin()
    places = [hand.positions["J1"]] * 2
    while hand.positions["J1"] < edge - 0.03:
        assert hand.cycle(a0=1.0).action is Action.MOVE
        places.append(hand.positions["J1"])
    noted = set()
    for _ in range(60):
        jog = hand.cycle(buttons=0 if released else DEAD_MAN, a0=1.0)
        assert jog.action is not Action.HOLD
        noted.add(jog.note)
        places.append(hand.positions["J1"])
    assert max(places) <= edge
    assert released or edge - places[-1] < 2e-3
    assert noted == {""} if released else ("the table" if where == "table" else "J1 at the limit") in noted
    speeds = [(b - a) / hand.period for a, b in pairwise(places)]
    changes = [(b - a) / hand.period for a, b in pairwise(speeds)]
    assert max(map(abs, changes)) <= 1.001 * joint.max_acceleration
    assert max(abs(b - a) for a, b in pairwise(changes)) <= 1.001 * joint.max_jerk * hand.period


def test_after_a_stop_nothing_brakes() -> None:
    hand = puma()
    hand.begin()
    hand.cycle(a0=1.0)
    hand.rules.drop()
    assert hand.cycle(buttons=0).action is Action.IDLE


@pytest.mark.parametrize("age", [0.25, 10.0, math.inf, math.nan])
def test_a_lost_channel_brakes_and_wants_the_button_released(age: float) -> None:
    hand = puma()
    hand.begin()
    hand.cycle(a0=1.0)
    lost = hand.cycle(age=age, a0=1.0)
    assert lost.action is Action.MOVE
    assert lost.note
    let_go(hand, age=age)
    assert hand.cycle(age=age).action is Action.IDLE
    # It comes back with the button still down: that must not move anything.
    for _ in range(5):
        back = hand.cycle(a0=1.0)
        assert (back.action, back.note) == (Action.IDLE, "release the dead-man button first")
    hand.begin()


def test_a_button_that_is_down_from_the_start_counts_for_nothing() -> None:
    hand = puma()
    assert hand.cycle().action is Action.IDLE
    assert hand.cycle(a0=1.0).action is Action.IDLE
    assert hand.positions == PUMA_POSE


def test_an_axis_counts_only_after_it_was_at_rest() -> None:
    hand = puma()
    hand.cycle(buttons=0, a0=1.0)
    for _ in range(10):
        # Pushed before the button, and a trigger that rests at its end.
        hand.cycle(a0=1.0, a6=-1.0)
    assert hand.positions == PUMA_POSE
    hand.cycle(a0=0.0, a6=-1.0)
    hand.cycle(a0=1.0, a6=-1.0)
    assert hand.positions["J1"] > PUMA_POSE["J1"]
    assert hand.positions["J5"] == PUMA_POSE["J5"]


def test_the_dead_zone_and_no_jump_behind_it() -> None:
    hand = puma()
    hand.begin()
    hand.cycle(a0=0.12)
    assert hand.positions == PUMA_POSE
    for _ in range(10):
        hand.cycle(a0=0.121)
    assert 0 < hand.positions["J1"] - PUMA_POSE["J1"] < 1e-3


def test_limits_hold_the_joint_and_say_so() -> None:
    hand = puma(share=1.0)
    hand.positions = HALF | {"J1": PUMA260.joints[0].maximum - 0.01}
    hand.begin()
    for _ in range(50):
        jog = hand.cycle(a0=1.0)
    assert hand.positions["J1"] == pytest.approx(PUMA260.joints[0].maximum, abs=1e-6)
    assert jog.note == "J1 at the limit"
    # A joint that stands outside comes back, and goes no further.
    hand = puma()
    outside = PUMA260.joints[0].maximum + 0.1
    hand.positions = HALF | {"J1": outside}
    hand.begin()
    hand.cycle(a0=1.0)
    assert hand.positions["J1"] == outside
    hand.cycle(a0=-1.0)
    assert hand.positions["J1"] < outside


def test_a_joint_that_is_held_fast_does_not_leap_later() -> None:
    hand = puma(share=1.0)
    hand.begin()
    hand.follows = False
    for _ in range(500):
        jog = hand.cycle(a0=1.0)
    assert jog.positions["J1"] - PUMA_POSE["J1"] <= math.radians(10.001)
    assert jog.note == "the arm does not follow"


def test_a_program_that_stood_still_makes_no_leap() -> None:
    hand = puma(share=1.0)
    hand.begin()
    hand.cycle()
    hand.now += 60.0
    hand.cycle(a0=1.0)
    assert hand.positions["J1"] - PUMA_POSE["J1"] <= PUMA260.joints[0].max_jerk * 0.1**3 / 6.0 + 1e-9


def test_positions_that_are_not_known_move_nothing() -> None:
    hand = puma()
    hand.begin()
    hand.positions["J3"] = math.nan
    assert hand.cycle(a0=1.0).action is Action.HOLD


@pytest.mark.parametrize(("axis", "which", "sign"), [("a0", 0, 1), ("a1", 1, -1), ("a4", 2, -1)])
def test_cartesian_jog_moves_the_tool_straight(axis: str, which: int, sign: int) -> None:
    model = Puma260Model()
    hand = puma(JogMode.CARTESIAN, linear=0.03)
    hand.begin()
    start = model.forward(model.from_joints(hand.positions))
    hand.push(**{axis: 1.0})
    before = model.forward(model.from_joints(hand.positions))
    for _ in range(50):
        assert hand.cycle(**{axis: 1.0}).note == ""
    after = model.forward(model.from_joints(hand.positions))
    moved = [b - a for a, b in zip(before.position, after.position, strict=True)]
    expected = [0.0, 0.0, 0.0]
    expected[which] = sign * 0.03
    assert moved == pytest.approx(expected, abs=1e-6)
    aside = [abs(b - a) for a, b in zip(start.position, after.position, strict=True)]
    assert [way for i, way in enumerate(aside) if i != which] == pytest.approx([0.0, 0.0], abs=1e-6)
    for row, other in zip(start.rotation, after.rotation, strict=True):
        assert row == pytest.approx(other, abs=1e-6)


def test_cartesian_jog_turns_the_tool_in_its_place() -> None:
    model = Puma260Model()
    hand = puma(JogMode.CARTESIAN)
    before = model.forward(model.from_joints(hand.positions))
    hand.begin()
    hand.push(a7=1.0)
    begun = model.forward(model.from_joints(hand.positions))
    hand.push(25, a7=1.0)
    after = model.forward(model.from_joints(hand.positions))
    assert after.position == pytest.approx(before.position, abs=1e-6)
    axis, angle = rotation_between(begun.rotation, after.rotation)
    assert angle == pytest.approx(0.4 * 0.5, abs=1e-6)
    assert axis == pytest.approx((0, 0, 1), abs=1e-6)


def test_cartesian_jog_of_the_hex7bot_with_its_gripper() -> None:
    model = Hex7BotModel()
    angles = tuple(0.5 * (r.minimum + r.maximum) for r in model.ranges)
    start = {joint.name: 0.0 for joint in HEX7BOT.joints} | dict(model.to_joints(angles))
    start |= {"J2": start["J2"] + 0.2, "J5": 0.4}
    hand = Hand(Teleop(HEX7BOT, model, mode=JogMode.CARTESIAN, linear=0.03), start)
    hand.begin()
    hand.push(15, a4=1.0)
    before = model.forward(model.from_joints(hand.positions))
    for _ in range(20):
        jog = hand.cycle(buttons=DEAD_MAN | 1, a4=1.0)
    assert jog.note == ""
    after = model.forward(model.from_joints(hand.positions))
    assert after.position[2] - before.position[2] == pytest.approx(-0.03 * 0.4, abs=1e-6)
    assert after.position[:2] == pytest.approx(before.position[:2], abs=1e-6)
    # It needs 0.275 s to its speed, and loses half of that.
    assert hand.positions["J7"] == pytest.approx(0.3 * HEX7BOT.joints[6].max_speed * (0.4 - 0.1375))


def test_the_edge_of_the_reach_refuses_and_lets_go_back() -> None:
    model = Puma260Model()
    hand = puma(JogMode.CARTESIAN, linear=0.2)
    hand.begin()
    notes = [hand.cycle(a4=-1.0).note for _ in range(1000)]
    assert notes[-1]
    at_the_edge = model.forward(model.from_joints(hand.positions))
    hand.push(60, a4=1.0)
    back = model.forward(model.from_joints(hand.positions))
    assert back.position[2] < at_the_edge.position[2] - 0.01


def test_the_mode_changes_only_while_nothing_moves() -> None:
    hand = puma()
    hand.begin()
    hand.cycle(buttons=DEAD_MAN | MODE)
    assert hand.rules.mode is JogMode.JOINT
    hand.cycle(buttons=MODE)
    assert hand.rules.mode is JogMode.JOINT  # it went down with the dead-man button
    hand.cycle(buttons=0)
    hand.cycle(buttons=MODE)
    hand.cycle(buttons=MODE)
    assert hand.rules.mode is JogMode.CARTESIAN
    hand.cycle(buttons=0)
    hand.cycle(buttons=MODE)
    assert hand.rules.mode is JogMode.JOINT


def test_invalid_values_are_refused() -> None:
    for share in (0.0, 1.1, -1.0, math.nan):
        with pytest.raises(UsageError):
            Teleop(PUMA260, share=share)
    with pytest.raises(UsageError, match="no Cartesian jog"):
        Teleop(PUMA260, mode=JogMode.CARTESIAN)
    with pytest.raises(UsageError):
        StickMap(dead_zone=1.0)


STEP = st.tuples(
    st.lists(st.floats(-1, 1) | st.sampled_from([math.nan, -1.0, 1.0, 0.0]), max_size=10),
    st.integers(0, 0xFFFFFFFF) | st.sampled_from([0, DEAD_MAN, DEAD_MAN | 3]),
    st.sampled_from([0.0, 0.1, 0.3, math.inf]),
    st.floats(0, 0.2),
)


@given(st.sampled_from(list(JogMode)), st.lists(STEP, max_size=30))
def test_any_stick_keeps_the_rules(mode: JogMode, steps: list[tuple[list[float], int, float, float]]) -> None:
    rules = Teleop(PUMA260, Puma260Model(), mode=mode, share=1.0)
    positions, now, moved = dict(PUMA_POSE), 0.0, False
    for axes, buttons, age, dt in steps:
        now += dt
        jog = rules.update(axes, buttons, age, positions, now)
        if not buttons & DEAD_MAN or age >= 0.25:
            assert moved or jog.action is not Action.MOVE, "only to brake"
        moved = jog.action is Action.MOVE
        if jog.action is Action.MOVE:
            for joint in PUMA260.joints:
                assert joint.minimum <= jog.positions[joint.name] <= joint.maximum
                moved_by = abs(jog.positions[joint.name] - positions[joint.name])
                assert moved_by <= joint.max_speed * dt + 2e-9
            positions = dict(jog.positions)


def test_the_arm_keeps_its_coupling_limit_and_can_be_led_back() -> None:
    model = Hex7BotModel()
    start = {joint.name: joint.offset for joint in HEX7BOT.joints} | {"J3": HEX7BOT.joint("J3").offset + 0.7}

    def check(before: Mapping[str, float], goal: Mapping[str, float]) -> None:
        if found := Fence(model, None).check_end(before, {**before, **goal}):
            raise LimitError("; ".join(found.values()))

    hand = Hand(Teleop(HEX7BOT, model, StickMap(axes=(0, 1, 2, 3, 6, 7)), check=check), start)
    hand.begin()
    notes = {hand.cycle(a1=1.0).note for _ in range(200)}
    assert any(note.startswith("elbow folded") for note in notes)
    assert model.coupling_excess(model.from_joints(hand.positions)) == 0.0
    there = hand.positions["J2"]
    assert there > start["J2"] + 0.3
    hand.cycle(a1=-1.0)
    assert hand.cycle(a1=-1.0).note == ""
    assert hand.positions["J2"] < there


@pytest.mark.parametrize(("axis", "turn"), [("a3", (1, 0, 0)), ("a6", (0, 1, 0)), ("a7", (0, 0, 1))])
@pytest.mark.parametrize("push", [1.0, -0.56])
def test_cartesian_jog_turns_about_each_axis(axis: str, turn: tuple[int, int, int], push: float) -> None:
    model = Puma260Model()
    hand = puma(JogMode.CARTESIAN, angular=0.2)
    hand.begin()
    place = model.forward(model.from_joints(hand.positions)).position
    hand.push(20, **{axis: push})
    before = model.forward(model.from_joints(hand.positions))
    for _ in range(5):
        assert hand.cycle(**{axis: push}).note == ""
    after = model.forward(model.from_joints(hand.positions))
    assert after.position == pytest.approx(place, abs=1e-6)
    about, angle = rotation_between(before.rotation, after.rotation)
    # 0.56 is half way from the dead zone to the end.
    share = math.copysign(1.0 if push == 1.0 else 0.5, push)
    assert angle == pytest.approx(abs(share) * 0.2 * 0.1, abs=1e-6)
    assert about == pytest.approx([math.copysign(1.0, share) * part for part in turn], abs=1e-4)


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (1, -1), (4, -1), (3, 1), (6, 1), (7, 1)])
def test_every_axis_moves_its_joint_and_half_deflection_half_as_fast(axis: int, sign: int) -> None:
    hand = puma()
    joint = PUMA260.joints[(0, 1, 4, 3, 6, 7).index(axis)]
    hand.begin()
    hand.push(**{f"a{axis}": 0.56})
    before = dict(hand.positions)
    hand.cycle(**{f"a{axis}": 0.56})
    moved = {name: hand.positions[name] - before[name] for name in PUMA260.names}
    expected = dict.fromkeys(PUMA260.names, 0.0) | {joint.name: sign * 0.5 * 0.3 * joint.max_speed * 0.02}
    assert moved == pytest.approx(expected, abs=1e-12)


def test_an_axis_that_is_missing_out_of_range_or_not_assigned_moves_nothing() -> None:
    rules = Teleop(PUMA260, None, StickMap(axes=(None, 1, -1)))
    rules.update((0.0, 0.0), 0, 0.0, PUMA_POSE, 0.0)
    rules.update((0.0, 0.0), DEAD_MAN, 0.0, PUMA_POSE, 0.02)
    for axes in ((), (1.01, -1.01), (math.nan, math.nan)):
        assert rules.update(axes, DEAD_MAN, 0.0, PUMA_POSE, 0.04).positions == PUMA_POSE
    jog = rules.update((1.0, -1.0), DEAD_MAN, 0.0, PUMA_POSE, 0.06)
    # The first of a motion is that of the jerk.
    step = 60.0 * 0.02**3 / 6.0
    assert jog.positions == pytest.approx({**PUMA_POSE, "J2": PUMA_POSE["J2"] - step, "J3": PUMA_POSE["J3"] - step})


def test_a_joint_moves_back_from_either_limit_and_not_beyond_it() -> None:
    for end, axis, sign in (("maximum", "a0", 1.0), ("minimum", "a0", -1.0)):
        hand = puma(share=1.0)
        edge = getattr(PUMA260.joints[0], end)
        hand.positions = HALF | {"J1": edge}
        hand.begin()
        assert hand.cycle(**{axis: sign}).note == "J1 at the limit"
        assert hand.positions["J1"] == edge
        assert hand.cycle(**{axis: -sign}).note == ""
        assert (hand.positions["J1"] - edge) * sign < 0
    two = puma(share=1.0)
    two.positions = HALF | {joint.name: joint.maximum for joint in PUMA260.joints[:2]}
    two.begin()
    assert two.cycle(a0=1.0, a1=-1.0).note == "J1, J2 at the limit"


def test_the_gripper_opens_and_closes_between_its_limits() -> None:
    model, joint = Hex7BotModel(), HEX7BOT.joints[6]
    home = {each.name: each.offset for each in HEX7BOT.joints}
    close, open_, both = DEAD_MAN | 1, DEAD_MAN | 2, DEAD_MAN | 3
    for kinematics in (model, None):
        hand = Hand(Teleop(HEX7BOT, kinematics, share=0.5), {**home, "J7": joint.maximum - 1e-3})
        hand.begin()
        for _ in range(20):
            hand.cycle(buttons=close)
        assert hand.positions["J7"] == pytest.approx(joint.maximum, abs=1e-6)
        for _ in range(25):
            before = hand.positions["J7"]
            hand.cycle(buttons=open_)
        assert hand.positions["J7"] == pytest.approx(before - 0.5 * joint.max_speed * 0.02)
        for _ in range(25):
            before = hand.positions["J7"]
            hand.cycle(buttons=both)
        assert hand.positions["J7"] == before
        hand.positions["J7"] = joint.minimum + 1e-3
        hand.cycle(buttons=0)
        hand.begin()
        for _ in range(20):
            hand.cycle(buttons=open_)
        assert hand.positions["J7"] == pytest.approx(joint.minimum, abs=1e-6)
        assert {name: hand.positions[name] for name in HEX7BOT.names[:6]} == {n: home[n] for n in HEX7BOT.names[:6]}


@pytest.mark.parametrize("arm", [HEX7BOT, load_profile("so101").model], ids=lambda arm: arm.name)
def test_the_button_that_closes_closes_the_jaws_of_any_arm(arm: ArmModel) -> None:
    jaws = jaws_of(arm)
    assert jaws is not None
    hand = Hand(Teleop(arm, kinematics_for(arm)), {each.name: each.inside(0.3) for each in arm.joints})
    hand.begin()
    before = jaws.share(hand.positions[jaws.joint])
    for _ in range(20):
        hand.cycle(buttons=DEAD_MAN | 1)
    assert jaws.share(hand.positions[jaws.joint]) < before


@pytest.mark.parametrize(("close", "open_"), [(0, 1), (2, 3), (9, 8)])
def test_any_two_buttons_may_be_those_of_the_gripper(close: int, open_: int) -> None:
    home = {each.name: each.offset for each in HEX7BOT.joints}
    hand = Hand(Teleop(HEX7BOT, None, stick=StickMap(close=close, open=open_)), home)
    for button in (close, open_, 5):
        hand.begin()
        before = hand.positions["J7"]
        hand.cycle(buttons=DEAD_MAN | 1 << button)
        moved = hand.positions["J7"] - before
        while hand.cycle(buttons=0).action is not Action.IDLE:
            pass
        assert (moved > 0, moved < 0) == (button == close, button == open_)


def test_a_tool_whose_joint_lags_stays_on_its_line() -> None:
    hand = puma(JogMode.CARTESIAN, linear=0.2)
    hand.begin()
    hand.follows = False
    seen = [hand.cycle(a4=1.0) for _ in range(200)]
    assert seen[0].note == ""
    assert seen[-1].note == "the arm does not follow"
    ahead = [abs(seen[-1].positions[name] - PUMA_POSE[name]) for name in PUMA260.names]
    assert math.radians(5) < max(ahead) <= math.radians(10)
    model = Puma260Model()
    first, last = (model.forward(model.from_joints(p)).position for p in (PUMA_POSE, seen[-1].positions))
    assert last[:2] == pytest.approx(first[:2], abs=1e-6), "the whole step is undone, not one joint's"
    assert seen[-2].positions == seen[-1].positions


def test_a_stall_moves_as_far_as_a_tenth_of_a_second() -> None:
    for pause, counted in ((0.05, 0.05), (0.1, 0.1), (3.0, 0.1), (-1.0, 0.0)):
        hand = puma(share=1.0)
        hand.begin()
        hand.period = pause
        hand.cycle(a0=1.0)
        moved = hand.positions["J1"] - PUMA_POSE["J1"]
        assert moved == pytest.approx(PUMA260.joints[0].max_jerk * counted**3 / 6.0, abs=1e-12)


@pytest.mark.parametrize(("pause", "rests"), [(0.14, False), (0.16, True)])
def test_after_a_stall_a_motion_begins_from_rest(pause: float, rests: bool) -> None:
    hand, axes = puma(share=1.0), (1.0, *REST[1:])
    hand.begin()
    hand.push(a0=1.0)

    def step(buttons: int) -> float:
        before = hand.positions["J1"]
        jog = hand.rules.update(axes, buttons, 0.0, hand.positions, hand.now, lead=0.05)
        hand.positions |= jog.positions
        return (hand.positions["J1"] - before) / PUMA260.joints[0].max_speed

    assert step(DEAD_MAN) == 0.0, "no time has passed"
    hand.now += pause
    # Of a tenth of a second.
    assert step(DEAD_MAN) == pytest.approx(60.0 * 1e-3 / 6.0 / PUMA260.joints[0].max_speed if rests else 0.1)
    hand.now += 0.02
    hand.push(a0=1.0)
    step(DEAD_MAN)
    hand.now += pause
    assert (step(0) == 0.0) is rests, "what has come to rest does not brake any more"


def test_a_joint_that_lags_is_followed_evenly() -> None:
    """It comes to where it was told to be 0.12 s later."""
    joint = HEX7BOT.joint("J1")
    hand = Hand(Teleop(HEX7BOT, None, share=1.0), {each.name: each.offset for each in HEX7BOT.joints})
    hand.begin()
    hand.follows = False
    told = [hand.positions["J1"]] * 7
    notes = set()
    for _ in range(60):
        jog = hand.cycle(a0=1.0)
        notes.add(jog.note)
        told.append(jog.positions["J1"])
        hand.positions["J1"] = told[-7]
    assert notes == {""}
    speeds = [(b - a) / hand.period for a, b in pairwise(told)]
    assert max(abs(b - a) for a, b in pairwise(speeds)) <= 1.001 * joint.max_acceleration * hand.period
    assert min(speeds[20:]) > 0.9
    assert max(a - b for a, b in zip(told[6:], told[:-6], strict=True)) < math.radians(9.0)


def test_near_a_singular_pose_the_tool_is_slower() -> None:
    # Near a stretched wrist a turn needs much faster joints than elsewhere.
    near = PUMA_POSE | {"J5": 0.02}
    model = Puma260Model()
    hand = Hand(Teleop(PUMA260, model, mode=JogMode.CARTESIAN, angular=2.0), near)
    hand.begin()
    moved = []
    for _ in range(60):
        before = model.forward(model.from_joints(hand.positions)).rotation
        was = dict(hand.positions)
        assert hand.cycle(a3=1.0).note == ""
        moved.append(rotation_between(before, model.forward(model.from_joints(hand.positions)).rotation)[1] / 0.04)
        for joint in PUMA260.joints:
            assert abs(hand.positions[joint.name] - was[joint.name]) <= joint.max_speed * 0.02 + 2e-9
    assert max(moved) < 0.5
    assert min(moved[15:]) > 0.3


def test_a_lost_channel_says_whether_there_ever_was_one() -> None:
    hand = puma(stale=0.5)
    hand.begin()
    assert hand.cycle(age=0.49).action is Action.MOVE
    assert hand.cycle(age=0.5).note == "the joystick's channel is silent"
    assert hand.cycle(age=math.inf).note == "no joystick"
    # A motion begins where the arm is, however far it was led meanwhile.
    hand.positions["J1"] = 1.5
    hand.begin()
    assert hand.positions["J1"] == 1.5


def test_buttons_and_numbers_that_a_map_may_have() -> None:
    assert StickMap(dead_zone=0.0).dead_zone == 0.0
    for zone in (-0.1, 1.0, math.nan):
        with pytest.raises(UsageError, match="a dead zone"):
            StickMap(dead_zone=zone)
    assert Teleop(PUMA260, share=1.0).mode is JogMode.JOINT
    rules = Teleop(PUMA260, None, StickMap(dead_man=0, mode=1))
    hand = Hand(rules, PUMA_POSE)
    hand.cycle(buttons=0)
    assert hand.cycle(buttons=1).action is Action.MOVE
    hand.cycle(buttons=0)
    hand.cycle(buttons=2)
    assert rules.mode is JogMode.JOINT, "without kinematics there is one mode"


def test_the_check_is_given_what_is_sent_and_where_that_begins() -> None:
    seen: list[tuple[dict[str, float], dict[str, float]]] = []
    rules = Teleop(
        PUMA260, Puma260Model(), share=0.5, check=lambda before, goal: seen.append((dict(before), dict(goal)))
    )
    outside = PUMA260.joints[1].maximum + 0.1
    hand = Hand(rules, HALF | {"J2": outside})
    hand.begin()
    assert not seen, "nothing new"
    jog = hand.cycle(a0=1.0)
    before, goal = seen[0]
    assert before == HALF | {"J2": outside}
    assert goal == {name: angle for name, angle in jog.positions.items() if name != "J2"}
    assert within_limits(PUMA260, jog.positions) == goal
    # Then, where the joints would come to rest.
    assert all(a[1].items() <= b[0].items() for a, b in pairwise(seen))
    assert seen[-1][1]["J1"] > goal["J1"]
