from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.puma_motion import FRICTION, INERTIA, Gains, Path, gains_of
from hexwire.model.control_law import ControlLaw
from hexwire.wire.robot_bodies import JointCommands, TrajectoryPoints


@st.composite
def paths(draw: st.DrawFn) -> tuple[TrajectoryPoints, tuple[float, ...], tuple[float, ...]]:
    angle = st.floats(-3, 3)
    steps = draw(st.lists(st.floats(0.01, 3), min_size=1, max_size=8))
    first = draw(st.sampled_from([0.0, 0.5]))
    times = tuple(first + sum(steps[:i]) for i in range(len(steps)))
    row = st.tuples(angle, angle)
    rows = st.lists(row, min_size=len(times), max_size=len(times)).map(tuple)
    made = TrajectoryPoints(times, draw(rows), draw(st.just(()) | rows))
    return made, draw(row), draw(row)


@given(paths())
def test_a_path_goes_through_its_waypoints_without_a_jump(case: tuple[TrajectoryPoints, ...]) -> None:
    trajectory, origin, velocity = case
    path = Path(trajectory, origin, velocity)
    assert path.duration == trajectory.times[-1]
    for when, point in zip(trajectory.times, trajectory.positions, strict=True):
        assert path.at(when) == pytest.approx(point, abs=1e-9)
    if trajectory.times[0] > 0:
        assert path.at(0.0) == pytest.approx(origin)
    assert path.at(path.duration + 100) == trajectory.positions[-1]
    # Continuous: close times give close places.
    for i in range(50):
        t = path.duration * i / 50
        here, there = path.at(t), path.at(t + 1e-7)
        assert all(abs(a - b) < 1e-3 for a, b in zip(here, there, strict=True))


def test_a_path_starts_as_fast_as_the_joint_is_and_ends_at_rest() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((0.5,), (1.0,))), (0.0,), (0.3,))
    assert path.at(1e-6)[0] / 1e-6 == pytest.approx(0.3, abs=1e-3)
    assert (path.at(2.0)[0] - path.at(2.0 - 1e-6)[0]) / 1e-6 == pytest.approx(0.0, abs=1e-3)


def test_speeds_at_waypoints_are_kept() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((0.5,), (1.0,)), ((0.8,), (-0.2,))), (0.0,), (0.0,))
    for when, speed in ((1.0, 0.8), (2.0 - 1e-6, -0.2)):
        assert (path.at(when)[0] - path.at(when - 1e-6)[0]) / 1e-6 == pytest.approx(speed, abs=1e-3)


def test_a_turning_point_is_not_overshot() -> None:
    path = Path(TrajectoryPoints((1.0, 2.0), ((1.0,), (0.0,))), (0.0,), (0.0,))
    assert max(path.at(i / 100)[0] for i in range(200)) == pytest.approx(1.0)


def test_the_law_of_joint_commands() -> None:
    # effort + kp e + clamp(ki integral) + kd de/dt + kp_velocity (speed error), with e = 0.5 rad for one second.
    law = Gains(ControlLaw(
        velocity=1.0, effort=2.0, kp_position=10.0, ki_position=4.0, kd_position=3.0, kp_velocity=5.0,
        i_effort_min=-1.0, i_effort_max=9.0,
    ))  # fmt: skip
    assert law.torque(0.5, 0.2, 1.0) == pytest.approx(2 + 5 + 4 * 0.5 - 3 * 0.2 + 5 * (1.0 - 0.2))
    assert law.acceleration(0.0, 0.0, 1.0) == pytest.approx((2 + 2 + 5) / INERTIA)
    assert Gains(ControlLaw()).acceleration(0.0, 1.0, 1.0) == pytest.approx(-FRICTION / INERTIA)


def test_the_integral_is_held_and_does_not_wind_up() -> None:
    law = Gains(ControlLaw(ki_position=2.0, i_effort_min=-1.0, i_effort_max=1.0))
    for _ in range(1000):
        assert law.torque(1.0, 0.0, 0.1) <= 1.0
    # Had it wound up to 200, it would stay at 1 for long.
    assert law.torque(-1.0, 0.0, 0.3) < 1.0
    assert law.torque(-1.0, 0.0, 1.0) == -1.0


def test_a_law_needs_an_effort_or_a_gain() -> None:
    assert gains_of(JointCommands(("J1",), position=(1.0,), velocity=(0.1,)), 0) is None
    made = gains_of(JointCommands(("J1", "J2"), velocity=(0.1, 0.2), kp_position=(3.0, 4.0)), 1)
    assert made == Gains(ControlLaw(velocity=0.2, kp_position=4.0))
    assert math.isclose(gains_of(JointCommands(("J1",), effort=(0.5,)), 0).law.effort, 0.5)  # type: ignore[union-attr]
