"""At which speed a recorded motion is offered that is too fast for an arm."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.motion.arms import ARMS, HOME

from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.checks import SLOWEST, check_trajectory, speed_that_fits
from hexwire.motion.teach import Edits, Taught


@st.composite
def recordings(draw: st.DrawFn) -> tuple[Taught, ArmModel]:
    """An arm, perhaps a slower one, and a motion within the limits of its positions."""
    arm = draw(st.sampled_from(ARMS))
    slower = draw(st.floats(0.05, 1.0))
    arm = replace(arm, joints=tuple(replace(joint, max_speed=slower * joint.max_speed) for joint in arm.joints))
    joints = arm.joints[: draw(st.integers(1, 3))]
    shares = st.tuples(*[st.floats(0.0, 1.0) for _ in joints])
    rows = draw(st.lists(shares, min_size=1, max_size=6))
    gaps = draw(st.lists(st.floats(0.002, 0.5), min_size=len(rows), max_size=len(rows)))
    samples = [
        (
            sum(gaps[:i]),
            [joint.minimum + s * (joint.maximum - joint.minimum) for joint, s in zip(joints, row, strict=True)],
        )
        for i, row in enumerate(rows)
    ]
    return Taught.of([joint.name for joint in joints], samples), arm


@given(recordings(), st.sampled_from([0.5, 1.0, 2.0]))
def test_it_is_allowed_at_the_factor_and_refused_a_thousandth_above(
    case: tuple[Taught, ArmModel], most: float
) -> None:
    taught, arm = case
    make = taught.played(arm, Edits())

    def too_fast(factor: float) -> list[str]:
        found = check_trajectory(make(factor), arm, table=None).findings
        return [fault.text for fault in found if "would turn at" in fault.text]

    factor = speed_that_fits(make, arm, most)
    if factor is None:
        assert too_fast(SLOWEST)
        return
    assert SLOWEST <= factor <= most
    assert not too_fast(factor)
    if factor < most:
        assert float(f"{factor:g}") == factor
        assert too_fast(min(most, round(factor + 0.001, 3)))


def test_a_slow_motion_is_offered_as_it_is_and_a_jump_not_at_all() -> None:
    def moved(far: float) -> Taught:
        return Taught(("J1",), (0.0, 0.5, 1.0), ((HOME["J1"],), (HOME["J1"] + far,), (HOME["J1"],)))

    assert speed_that_fits(moved(0.1).played(HEX7BOT, Edits()), HEX7BOT, 1.5) == 1.5
    found = speed_that_fits(moved(1.8).played(HEX7BOT, Edits()), HEX7BOT)
    # A cubic from rest to rest is 1.5 times as fast in its middle as on average.
    assert found == pytest.approx(HEX7BOT.joint("J1").max_speed / (1.5 * 1.8 / 0.5), rel=0.01)
    # Slower, it would take longer than a motion may.
    long = Taught(("J1",), (0.0, 0.5, 3500.0), ((HOME["J1"],), (HOME["J1"] + 1.0,), (HOME["J1"],)))
    assert speed_that_fits(long.played(HEX7BOT, Edits()), HEX7BOT) is None
    for far in (1e4, 1e300):
        jump = Taught(("J1",), (0.0, 0.01, 0.02), ((0.0,), (far,), (0.0,)))
        assert speed_that_fits(lambda factor, jump=jump: jump.faster(factor).trajectory(), HEX7BOT) is None, far
