"""Reports become states, in the usual order of joints and in any other."""

from __future__ import annotations

import math

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.board2 import StateDecoder
from hexwire.errors import ServoError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointState
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import AGE_NEVER, ALL_FIELDS, JointReport


@pytest.fixture(scope="module")
def sent() -> tuple[bytes, Frame]:
    """What a board answers."""
    arm = Arm(2)
    arm.wait(0.5)
    reply = arm.driver.session.request(Command.JOINT_STATE, bytes((ALL_FIELDS,)), repeatable=True)
    assert reply.frame is not None
    return reply.body, reply.frame


def decoder() -> StateDecoder:
    """A fresh one: it remembers how the board's clock ran."""
    return StateDecoder(HEX7BOT, HEX7BOT.joints)


def columns(state: JointState, name: str) -> list[float]:
    reading = state[name]
    values = [reading.position, reading.velocity, reading.load, reading.voltage, reading.temperature]
    return [value if math.isfinite(value) else -1.0 for value in (*values, reading.current, reading.age)]


def test_any_order_of_joints_gives_the_same_values(sent: tuple[bytes, Frame]) -> None:
    usual = decoder().decode(*sent, 100.0)
    turned = ArmModel("turned", HEX7BOT.joints[::-1])
    other = StateDecoder(turned, HEX7BOT.joints).decode(*sent, 100.0)
    assert other.names == HEX7BOT.names[::-1]
    assert other.stamp == usual.stamp
    for name in HEX7BOT.names:
        assert columns(other, name) == pytest.approx(columns(usual, name), abs=1e-12)
        assert other[name].flags == usual[name].flags


def test_a_legacy_servo_tells_no_more_than_its_position(sent: tuple[bytes, Frame]) -> None:
    state = decoder().decode(*sent, 100.0)
    for joint, reading in zip(HEX7BOT.joints, state, strict=True):
        assert math.isnan(reading.voltage) == (joint.series == "seven_bot")
        assert math.isfinite(reading.position)


@pytest.mark.parametrize("order", [HEX7BOT.joints, HEX7BOT.joints[::-1]])
def test_a_report_of_other_joints_is_an_error(sent: tuple[bytes, Frame], order: tuple[JointModel, ...]) -> None:
    body, frame = sent
    report = JointReport.parse(body)
    fewer = JointReport(*report[:2], *(column[:5] if column else None for column in report[2:]))
    with pytest.raises(ServoError, match="the board reports 5 joints instead of 7"):
        StateDecoder(HEX7BOT, order).decode(fewer.serialize(), frame, 0.0)


@pytest.mark.parametrize("resent_after_ms", [0, 200])
def test_ages_are_told_at_the_stamp_not_at_sending(sent: tuple[bytes, Frame], resent_after_ms: int) -> None:
    body, sent_frame = sent
    # Made 12.6 ms after the newest sample; the others are 12 to 62 ms old then, and one was never taken.
    report = JointReport.parse(body)._replace(time_us=5_000_000, age=(22, 12, 32, 42, 52, 62, AGE_NEVER))
    at = 12_600_000 + resent_after_ms * 1_000_000
    frame = sent_frame._replace(time_sec=5, time_nsec=at)
    state = decoder().decode(report.serialize(), frame, 100.0)
    assert state.stamp == pytest.approx(100.0 - at * 1e-9)
    assert state.board_time == pytest.approx(5.0)
    assert state.age == pytest.approx((0.01, 0.0, 0.02, 0.03, 0.04, 0.05, math.inf))


def test_ages_of_joints_that_were_never_sampled_stay_infinite(sent: tuple[bytes, Frame]) -> None:
    body, sent_frame = sent
    report = JointReport.parse(body)._replace(age=(AGE_NEVER,) * 7)
    state = decoder().decode(report.serialize(), sent_frame, 100.0)
    assert state.age == (math.inf,) * 7
