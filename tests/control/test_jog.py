"""Jog: joints move while the hold lasts, and hold when it ends; refused values move nothing."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import pytest
from tests.few import few
from tests.model.states import make_state
from tests.motion.arms import ARMS, EXCESS, at_rest

from hexwire.control.motion.jog import JogController, JogRequest, read_request
from hexwire.control.motion.path_check import PathCheck
from hexwire.errors import GoalError, LimitError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.safety import StopReason

_NAMES = HEX7BOT.names
_FIRST, _SECOND = _NAMES[0], _NAMES[1]


def _state(torque: bool = True, **moved: float) -> JointState:
    flags = (int(JointFlag.TORQUE_ON) if torque else 0,) * len(_NAMES)
    middle = [0.5 * (joint.minimum + joint.maximum) for joint in HEX7BOT.joints]
    place = [moved.get(name, angle) for name, angle in zip(_NAMES, middle, strict=True)]
    return make_state(*place, names=_NAMES, velocity=(0.0,) * len(_NAMES), flags=flags, stamp=1.0)


class _Hold:
    """A jog in simulated time; the joints follow at once."""

    def __init__(self, request: JogRequest, **moved: float) -> None:
        kinematics = kinematics_for(HEX7BOT)
        self.jog = JogController(HEX7BOT, kinematics, PathCheck(HEX7BOT, None, None))
        self.age, self.now = 0.0, 10.0
        self.state = _state(**moved)
        self.jog.begin(request, lambda: self.age, self.state)

    def turn(self) -> Any:
        self.now += 0.02
        target = self.jog.cycle(self.state, self.now, 0.03)
        if target is not None:
            self.state = _state(**{**self.state.positions, **dict(target.positions)})
        return target

    def where(self, name: str) -> float:
        return self.state.positions[name]


def test_a_joint_moves_at_its_share_of_the_speed_limit_while_held() -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}, speed=0.5))
    for _ in range(20):
        hold.turn()
    before = hold.where(_FIRST)
    for _ in range(10):
        target = hold.turn()
        assert [name for name, _ in target.positions] == [_FIRST]
    way = 0.5 * HEX7BOT.joint(_FIRST).max_speed * 0.2
    assert hold.where(_FIRST) - before == pytest.approx(way)


@pytest.mark.parametrize("age", [0.25, math.inf])
def test_without_signs_of_life_the_joint_brakes_and_stays(age: float) -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}))
    places = []
    for _ in range(20):
        hold.turn()
        places.append(hold.where(_FIRST))
    hold.age = age
    while (target := hold.turn()) is not None:
        assert [name for name, _ in target.positions] == [_FIRST]
        places.append(hold.where(_FIRST))
    speeds = [(b - a) / 0.02 for a, b in pairwise(places)]
    limit = HEX7BOT.joint(_FIRST).max_acceleration
    assert speeds[18] == pytest.approx(0.3 * HEX7BOT.joint(_FIRST).max_speed)
    assert all(0.0 <= a - b <= 1.001 * 0.02 * limit for a, b in pairwise(speeds[18:]))
    assert speeds[-1] < 0.02
    hold.age = 0.0
    assert hold.turn() is None
    assert not hold.jog.busy


def test_a_stop_ends_it_and_a_reset_does_not_continue_it() -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}))
    hold.turn()
    hold.jog.stop(StopReason("asked", "a test"))
    hold.jog.reset()
    assert hold.turn() is None


@few("arm", ARMS, ARMS[0], ARMS[-1])
def test_drags_whose_goals_move_keep_all_limits_and_come_to_rest_at_the_last(arm: ArmModel) -> None:
    """Wherever a goal goes while its joint moves: further, to the other side, just ahead of it, where it is."""
    some = random.Random(f"drags of {arm.name}")
    for number in range(15):
        joint = some.choice(arm.joints)
        where = {each.name: 0.5 * (each.minimum + each.maximum) for each in arm.joints}
        place, period = where[joint.name], some.choice((0.01, 0.02, 0.05))
        margin = 0.1 * (joint.maximum - joint.minimum)

        def near(place: float, joint: JointModel = joint, margin: float = margin) -> float:
            reach = some.choice((0.0, 0.05, 1.0))
            return max(joint.minimum + margin, min(joint.maximum - margin, place + some.uniform(-reach, reach)))

        speed = some.choice((0.2, 1.0))
        jog = JogController(arm, None, PathCheck.limits_only(arm))
        request = JogRequest(goals={joint.name: near(place)}, speed=speed)
        jog.begin(request, lambda: 0.0, at_rest(arm, list(where.values())))
        now, places = 10.0, [place] * 3
        for turn in range(5000):
            if turn < 200 and some.random() < 0.1:
                request = JogRequest(goals={joint.name: near(place)}, speed=speed)
                jog.update(request)
            now += period
            target = jog.cycle(at_rest(arm, list(where.values())), now, 1.5 * period)
            assert target is not None
            place = where[joint.name] = dict(target.positions)[joint.name]
            places.append(place)
            if turn > 200 and max(abs(past - request.goals[joint.name]) for past in places[-20:]) <= 1e-5:
                break
        else:
            pytest.fail(f"{number}: {joint.name} did not come to rest at its goal")
        change = places
        for limit in (joint.max_speed, joint.max_acceleration, joint.max_jerk):
            change = [(b - a) / period for a, b in pairwise(change)]
            assert max(map(abs, change)) <= EXCESS * limit, (number, joint.name)


@pytest.mark.parametrize("way", [0.1, -0.4, 2e-3])
def test_a_drag_comes_to_rest_at_its_goal(way: float) -> None:
    start = _state().positions[_FIRST]
    hold = _Hold(JogRequest(goals={_FIRST: start + way}, speed=1.0))
    places = []
    for _ in range(60):
        hold.turn()
        places.append(hold.where(_FIRST))
    assert max((place - start) / way for place in places) <= 1.0 + 1e-9
    assert places[-1] == pytest.approx(start + way, abs=1e-6)


def test_jog_in_space_moves_the_tip_along_its_axis() -> None:
    kinematics = kinematics_for(HEX7BOT)
    assert kinematics is not None
    pose = {"J1": 0.0, "J2": 1.4, "J3": 0.6, "J4": 0.0, "J5": 0.5, "J6": 0.0}
    named = dict(zip(kinematics.joint_names, pose.values(), strict=True))
    hold = _Hold(JogRequest(tool=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), speed=0.5), **named)
    before = kinematics.forward(kinematics.from_joints(hold.state.positions)).position
    for _ in range(12):
        hold.turn()
    after = kinematics.forward(kinematics.from_joints(hold.state.positions)).position
    assert after[2] - before[2] > 0.005
    assert math.dist(after[:2], before[:2]) < 0.001


def test_a_joint_without_torque_does_not_begin() -> None:
    jog = JogController(HEX7BOT, None, PathCheck(HEX7BOT, None, None))
    with pytest.raises(GoalError, match="no torque"):
        jog.begin(JogRequest(directions={_FIRST: 1.0}), lambda: 0.0, _state(torque=False))
    assert not jog.busy


def test_another_joint_or_kind_needs_a_new_hold() -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}))
    for other in (JogRequest(directions={_SECOND: 1.0}), JogRequest(goals={_FIRST: 0.0})):
        with pytest.raises(UsageError, match="release first"):
            hold.jog.update(other)
    hold.jog.update(JogRequest(directions={_FIRST: -1.0}))
    before = hold.where(_FIRST)
    hold.turn()
    hold.turn()
    assert hold.where(_FIRST) < before


@pytest.mark.parametrize(
    ("kind", "args"),
    [
        ("joint", {}),
        ("joint", {"directions": {}}),
        ("joint", {"directions": {"J1": 1.5}}),
        ("joint", {"directions": {"J1": math.nan}}),
        ("joint", {"directions": {"J1": "1"}}),
        ("joint", {"directions": {"elbow": 1.0}}),
        ("joint", {"directions": {"J1": 1.0}, "speed": 2.0}),
        ("joint", {"directions": {"J1": 1.0}, "force": 2.0}),
        ("space", {"tool": [1, 0, 0]}),
        ("space", {"tool": [1, 0, 0, 0, 0, True]}),
        ("drag", {"goals": ["J1"]}),
        ("fly", {}),
    ],
)
def test_a_malformed_request_is_refused(kind: str, args: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        read_request(kind, args, HEX7BOT)


def test_a_drag_beyond_a_limit_is_refused() -> None:
    with pytest.raises(LimitError):
        read_request("drag", {"goals": {"J1": 9.0}}, HEX7BOT)


def test_a_brake_ends_the_hold_as_its_release_does() -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}))
    for _ in range(5):
        hold.turn()
    before = hold.where(_FIRST)
    assert hold.jog.brake("the lease was lost")
    assert not hold.jog.moving
    places = [hold.where(_FIRST) for _ in range(30) if hold.turn() is not None]
    assert places[0] > before
    assert all(a <= b for a, b in pairwise(places))
    assert places[-1] > places[0]
    assert not hold.jog.busy
    assert not hold.jog.brake("again")


def test_after_a_stall_no_joint_moves_to_where_it_would_have_braked() -> None:
    hold = _Hold(JogRequest(directions={_FIRST: 1.0}))
    for _ in range(5):
        hold.turn()
    hold.now += 2.0
    hold.age = 2.0
    assert hold.turn() is None
    assert not hold.jog.busy
