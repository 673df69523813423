"""The bytes of goals, by series, from what the vendors' memory tables say."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.bus.bus_bench import make_bus

from hexwire.drivers.bus_arm import SPEED_UNIT, BusGoals
from hexwire.errors import LimitError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointTarget
from hexwire.motion.limits import check_target
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import parse_packet, parse_sync_write

ANGLES = st.floats(-6.0, 6.0)
"""Of these some are counts below zero."""


def joint(series: str, servo_id: int = 1) -> JointModel:
    return JointModel("a", servo_id, series, 0, 1, 0.0, 0.001, -9.0, 9.0, 9.0)


def test_an_sts_goal_is_acceleration_position_nothing_and_speed() -> None:
    goals = BusGoals(make_bus((1,))[0], {})
    # From 0 to 1000 counts in a second is 1000 counts/s: 20 units.
    assert goals.make(joint("sts_sms"), 1000, 1.0, 0.0) == (41, bytes.fromhex("00 E8 03 00 00 14 00"))


def test_speed_counts_single_steps_where_the_servo_says_so() -> None:
    bus, _ = make_bus((1,))
    goals, arm = BusGoals(bus, {}), joint("sts_sms")
    assert goals.speed_unit(arm) == SPEED_UNIT
    goals.learn([arm])
    before = goals.speed_unit(arm)
    phase = bus.read(1, "phase").raw
    assert phase is not None
    bus.write_raw(1, "lock", 0)
    bus.write_raw(1, "phase", phase ^ 0x04)
    goals.learn([arm])
    assert {before, goals.speed_unit(arm)} == {1.0, SPEED_UNIT}


def test_an_hls_goal_has_the_servos_own_current_ceiling() -> None:
    bus, _ = make_bus((4,), (Series.HLS,))
    goals, arm = BusGoals(bus, {}), joint("hls", 4)
    goals.learn([arm])
    ceiling = bus.read(4, "protection_current").raw
    assert ceiling
    address, data = goals.make(arm, 100, 0.5, 0.0)
    assert (address, data[3:5]) == (41, ceiling.to_bytes(2, "little"))


def test_a_legacy_goal_is_position_and_time() -> None:
    goals = BusGoals(make_bus((1,), (Series.SEVEN_BOT,))[0], {})
    assert goals.make(joint("seven_bot"), 0x123, 0.5, None) == (0x2A, bytes.fromhex("01 23 01 F4"))
    # Below 9 ms such a servo does not move.
    assert goals.make(joint("seven_bot"), -4, 0.0, None)[1] == bytes.fromhex("00 00 00 09")


def test_from_where_nobody_knows_a_goal_is_as_slow_as_can_be() -> None:
    goals = BusGoals(make_bus((1,))[0], {})
    _, data = goals.make(joint("sts_sms"), 4000, 0.1, None)
    assert int.from_bytes(data[5:], "little") == 1


@pytest.mark.parametrize("duration", [1e-6, 1e9])
def test_no_time_is_too_short_or_too_long(duration: float) -> None:
    goals = BusGoals(make_bus((1,))[0], {})
    for series in ("sts_sms", "scs", "hls", "seven_bot"):
        _, data = goals.make(joint(series), 4000, duration, -math.pi)
        assert data[-2:] != b"\0\0" or series == "scs"


@given(
    st.lists(
        st.tuples(st.sampled_from(["sts_sms", "hls", "seven_bot", "scs"]), ANGLES, ANGLES | st.none()), max_size=5
    )
)
def test_goals_of_several_joints_are_those_of_each_one(moves: list[tuple[str, float, float | None]]) -> None:
    arms = [
        JointModel(f"J{i}", i, series, 2048, (-1) ** i, 0.1 * i, 0.0015, -9.0, 9.0, 9.0)
        for i, (series, _, _) in enumerate(moves, 1)
    ]
    goals = BusGoals(make_bus((1,))[0], {arm.name: arm for arm in arms})
    starts = {arm.name: start for arm, (_, _, start) in zip(arms, moves, strict=True) if start is not None}
    wanted = {
        (arm.servo_id, *goals.make(arm, arm.angle_to_counts(angle), 0.05, start))
        for arm, (_, angle, start) in zip(arms, moves, strict=True)
    }
    angles = [angle for _, angle, _ in moves]
    packets, sent = goals.make_packets(zip([arm.name for arm in arms], angles, strict=True), 0.05, starts)
    rows = [parse_sync_write(parse_packet(packet)) for packet in packets]
    assert {(i, address, data) for address, found in rows for i, data in found} == wanted
    assert len({(address, len(found[0][1])) for address, found in rows}) == len(rows)
    rounded = [
        (arm.name, arm.counts_to_angle(arm.angle_to_counts(angle))) for arm, angle in zip(arms, angles, strict=True)
    ]
    assert sent == tuple(rounded)


@given(
    st.lists(st.tuples(st.sampled_from(["sts_sms", "hls"]), ANGLES, ANGLES), min_size=1, max_size=5),
    st.floats(0.0, 2.0),
    st.booleans(),
)
def test_one_pass_gives_what_check_and_packets_give(
    moves: list[tuple[str, float, float]], duration: float, guided: bool
) -> None:
    arms = [
        JointModel(f"J{i}", i, series, 2048, (-1) ** i, 0.1 * i, 0.0015, -2.0, 2.0, 3.0, free_speed=5.0)
        for i, (series, _, _) in enumerate(moves, 1)
    ]
    model = ArmModel("arm", tuple(arms))
    goals = BusGoals(make_bus((1,))[0], model.by_name)
    starts = {arm.name: start for arm, (_, _, start) in zip(arms, moves, strict=True)}
    target = JointTarget.of(
        {arm.name: angle for arm, (_, angle, _) in zip(arms, moves, strict=True)}, duration, guided=guided
    )
    made = goals.checked_packet(target.positions, target.duration, starts, guided)
    try:
        checked = check_target(model, target, starts)
    except LimitError:
        assert made is None
        return
    seconds = max(checked.duration, 0.02)
    (packet,), sent = goals.make_packets(checked.positions, seconds, starts)
    if made is not None:
        assert made == (packet, sent, seconds)
    else:
        # An angle that is at its limit but for rounding is allowed, too.
        assert any(
            arm.angle_to_counts(angle) < 0 or abs(angle) > 2.0
            for arm, (_, angle, _) in zip(arms, moves, strict=True)
        )
    assert goals.checked_packet(target.positions, duration, dict(list(starts.items())[1:]), guided) is None


def test_what_was_learned_counts_from_then_on() -> None:
    """The prepared goals of a joint are made anew."""
    bus, _ = make_bus((1,))
    arm = joint("sts_sms")
    goals = BusGoals(bus, {"a": arm})
    target, starts = (("a", 1.0),), {"a": 0.0}
    before = goals.checked_packet(target, 1.0, starts, True)
    bus.write_raw(1, "lock", 0)
    bus.write_raw(1, "phase", (bus.read(1, "phase").raw or 0) ^ 0x04)
    goals.learn([arm])
    assert goals.checked_packet(target, 1.0, starts, True) not in (before, None)
