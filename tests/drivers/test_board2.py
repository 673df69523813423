from __future__ import annotations

import math

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.board2 import Board2
from hexwire.errors import ServoError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.hex7bot import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.session.events import Reply
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import AGE_NEVER, ALL_FIELDS, Identity, JointReport


def board_of(arm: Arm) -> Board2:
    board = arm.driver._board
    assert isinstance(board, Board2)
    return board


def joint_state(board: Board2) -> tuple[bytes, Frame]:
    reply = board._session.request(Command.JOINT_STATE, bytes((ALL_FIELDS,)), repeatable=True)
    assert reply.frame is not None
    return reply.body, reply.frame


def test_only_the_fields_that_were_asked_for_the_rest_nan() -> None:
    board = board_of(Arm(2))
    bare = board.read(0)
    for column in (bare.velocity, bare.load, bare.current, bare.voltage, bare.temperature):
        assert all(map(math.isnan, column))
    assert board.read(ALL_FIELDS).position == bare.position


def test_a_model_with_another_order_sign_and_offset() -> None:
    arm = Arm(2)
    joints = (
        JointModel("elbow", 4, "hls", 2000, -1, 0.5, 0.001, -3, 3, 5),
        JointModel("base", 0, "seven_bot", 2047, 1, 0.0, 0.002, -3, 3, 5),
    )
    board = Board2(arm.driver.session, ArmModel("odd", joints), board_of(arm).identity)
    state = board.read()
    assert state.names == ("elbow", "base")
    assert state.position == pytest.approx((0.5 - 0.083, 0.012))
    assert board.torque(True, None) == ("base", "elbow")
    assert arm.torques() == [True, False, False, False, True, False, False]
    sent = board.move(JointTarget.of({"elbow": 0.3}, 0.5), {})
    assert sent.positions == (("elbow", pytest.approx(0.3)),)
    arm.wait(1)
    assert arm.shaft(4) == pytest.approx(2200, abs=2)


def test_a_board_without_one_of_the_models_servos() -> None:
    arm = Arm(2)
    model = ArmModel("big", (*HEX7BOT.joints, JointModel("J8", 30, "hls", 0, 1, 0, 1, -1, 1, 1)))
    with pytest.raises(ServoError, match=r"no servo for J8; it has the ids 0, 1, 2, 3, 4, 5, 6"):
        Board2(arm.driver.session, model, board_of(arm).identity)


def test_a_board_that_changed_its_joints_is_noticed() -> None:
    arm = Arm(2)
    identity = board_of(arm).identity
    assert isinstance(identity, Identity)
    board = board_of(arm)
    report = arm.board.state.report(0, arm.clock.time)
    fewer = report._replace(position=report.position[:5], status=report.status[:5])
    reply = arm.driver.session.request(Command.JOINT_STATE, b"\0")
    assert isinstance(reply, Reply)
    assert reply.frame is not None
    with pytest.raises(ServoError, match="attach again"):
        board.decode_state(fewer.serialize(), reply.frame, 0.0)


def test_the_clock_of_the_last_answer() -> None:
    arm = Arm(2)
    board = board_of(arm)
    assert math.isnan(board.clock)
    arm.wait(7.5)
    board.stats()
    assert board.clock == pytest.approx(7.5, abs=0.001)


def test_an_age_never_is_infinite() -> None:
    state = board_of(Arm(2, 0, ("silent:6",))).read()
    assert state["J7"].age == math.inf
    assert state.silent == ("J7",)


@pytest.mark.parametrize("resent_after_ms", [0, 200])
def test_ages_are_told_at_the_stamp_not_at_sending(resent_after_ms: int) -> None:
    board = board_of(Arm(2))
    body, sent_frame = joint_state(board)
    # Made 12.6 ms after the newest sample; the others are 12 to 62 ms old then, and one was never taken.
    report = JointReport.parse(body)._replace(time_us=5_000_000, age=(22, 12, 32, 42, 52, 62, AGE_NEVER))
    sent = 12_600_000 + resent_after_ms * 1_000_000
    frame = sent_frame._replace(time_sec=5, time_nsec=sent)
    state = board.decode_state(report.serialize(), frame, 100.0)
    assert state.stamp == pytest.approx(100.0 - sent * 1e-9)
    assert state.board_time == pytest.approx(5.0)
    assert state.age == pytest.approx((0.01, 0.0, 0.02, 0.03, 0.04, 0.05, math.inf))


def test_ages_of_an_arm_that_was_never_heard_stay_infinite() -> None:
    board = board_of(Arm(2))
    body, sent_frame = joint_state(board)
    report = JointReport.parse(body)._replace(age=(AGE_NEVER,) * 7)
    state = board.decode_state(report.serialize(), sent_frame, 100.0)
    assert state.age == (math.inf,) * 7


def test_a_servo_never_sampled_has_no_position() -> None:
    arm = Arm(2, 0, ("silent:6",))
    joint = board_of(arm).read()["J7"]
    values = (joint.position, joint.velocity, joint.load, joint.current, joint.voltage, joint.temperature)
    assert all(map(math.isnan, values))
    sent = arm.driver.write(JointTarget.of({"J7": 0.1}, duration=1.0))
    assert sent.silent == ("J7",)
