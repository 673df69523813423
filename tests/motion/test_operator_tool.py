"""A guided tool moves straight, and jogs that begin, change and are released at random keep all limits."""

from __future__ import annotations

import random
from itertools import product

import numpy as np
import pytest
from tests.few import few
from tests.motion.arms import ARMS, EXCESS

from hexwire.model.arm import ArmModel
from hexwire.model.geometry import make_kinematics
from hexwire.motion.moving import State
from hexwire.motion.operator_tool import OperatorTool
from hexwire.motion.teleop import Action, JogMode, StickMap, Teleop

STICK = StickMap(axes=tuple(range(8)), dead_man=0, mode=1, close=2, open=3, dead_zone=0.0)
REST = (0.0,) * 8


def jogged(arm: ArmModel, chance: random.Random, mode: JogMode, period: float) -> np.ndarray:
    """The set-points of a jog of three deflections and a release, in even cycles; the arm follows at once."""
    model = make_kinematics(arm.name, for_motion=True)
    rules = Teleop(arm, model, STICK, mode=mode, share=chance.choice((0.3, 1.0)), linear=0.15, angular=1.2)
    start = [chance.uniform(r.minimum, r.maximum) for r in model.ranges]
    positions = {j.name: chance.uniform(j.minimum, j.maximum) for j in arm.joints} | model.to_joints(start)
    now, places = 0.0, [tuple(positions.values())]
    rules.update(REST, 0, 0.0, positions, now)
    rules.update(REST, 1, 0.0, positions, now)
    held = [chance.sample(range(6), chance.choice((1, 1, 2))) for _ in range(3)]
    axes: tuple[float, ...]
    for some in held:
        axes = tuple(chance.choice((-1.0, 1.0, chance.uniform(-1, 1))) if k in some else 0.0 for k in range(8))
        for _ in range(max(1, round(chance.uniform(0.02, 0.6) / period))):
            now += period
            jog = rules.update(axes, 1, 0.0, positions, now)
            assert jog.action is Action.MOVE
            positions = dict(jog.positions)
            places.append(tuple(positions.values()))
    while True:
        now += period
        jog = rules.update(axes, 0, 0.0, positions, now)
        if jog.action is Action.IDLE:
            return np.array([places[0]] * 3 + places + [places[-1]] * 3)
        assert jog.action in (Action.MOVE, Action.HOLD)
        if jog.action is Action.HOLD:
            # Nothing moves that could brake.
            places.append(places[-1])
        else:
            positions = dict(jog.positions)
            places.append(tuple(positions.values()))


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_the_joints_have_the_velocities_and_accelerations_of_the_tool(arm: ArmModel) -> None:
    model = make_kinematics(arm.name, for_motion=True)
    tool = OperatorTool(arm, model)
    off = (0.5, -0.4, 0.3, 0.2, 0.5, 0.1)  # the middle of all ranges may be singular
    middle = model.to_joints([0.5 * (r.minimum + r.maximum) + x for r, x in zip(model.ranges, off, strict=False)])
    joints: dict[str, State] = {name: (angle, 0.0, 0.0) for name, angle in middle.items()}
    speeds: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 6
    tips = []
    rows = [list(joints.values())]
    for _ in range(12):
        joints, speeds = tool.step(joints, speeds, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0), 0.01)
        rows.append(list(joints.values()))
        tips.append(model.forward(model.from_joints({name: state[0] for name, state in joints.items()})).position)
    assert np.ptp([tip[:2] for tip in tips], axis=0).max() < 1e-6, "it is straight"
    assert tips[-1][2] - tips[0][2] > 1e-4
    p, v, a = np.moveaxis(np.array(rows), -1, 0)
    assert np.abs((p[2:] - p[:-2]) / 0.02 - v[1:-1]).max() < 60.0 * 0.01**2
    assert np.abs((v[2:] - v[:-2]) / 0.02 - a[1:-1]).max() < 60.0 * 0.01


@few(
    "arm, mode, jogs",
    product(ARMS, JogMode, (40, 6)),
    *((arm, list(JogMode)[i % len(JogMode)], 6) for i, arm in enumerate(ARMS)),
)
def test_a_jog_keeps_all_limits_while_it_begins_changes_and_ends(arm: ArmModel, mode: JogMode, jogs: int) -> None:
    chance = random.Random(f"jog {arm.name} {mode.value}")
    moved = 0
    for i in range(jogs):
        period = chance.choice((0.005, 0.02, 0.05))
        places = jogged(arm, chance, mode, period)
        moved += bool(np.ptp(places, axis=0).max() > 0.01)
        for k, joint in enumerate(arm.joints):
            # A joint that begins outside its limits goes no further out.
            assert min(joint.minimum, places[0, k]) - 1e-9 <= places[:, k].min(), (i, joint.name)
            assert places[:, k].max() <= max(joint.maximum, places[0, k]) + 1e-9, (i, joint.name)
            for order, most in enumerate((joint.max_speed, joint.max_acceleration, joint.max_jerk), 1):
                change = np.abs(np.diff(places[:, k], order)).max() / period**order
                assert change <= EXCESS * most, (i, joint.name, order, period, change / most)
    assert moved >= jogs // 4, "many can move"
