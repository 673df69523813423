"""Which servo of a new arm comes next, from what answers on the bus."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hexwire.bus.setup import ServoInfo
from hexwire.bus.survey import Remark
from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel
from hexwire.setup.arm_setup import ArmSetup, SeenServo, StepKind, label, picture
from hexwire.wire.registers import Series

SO101 = load_profile("so101").model
MILLION = 1_000_000


def info(servo_id: int, model: int = 777, firmware: str = "3.10") -> ServoInfo:
    return ServoInfo(servo_id, Series.STS_SMS, firmware, model, MILLION, True, 0.0005, 0)


def seen(servo_id: int, baud: int = MILLION, *, shared: bool = False, kind: str = "7.4 V") -> SeenServo:
    return SeenServo(servo_id, baud, shared, info(servo_id), (), 7.4, kind)


def made(**options: object) -> ArmSetup:
    return ArmSetup(SO101, MILLION, **options)  # type: ignore[arg-type]


def test_one_servo_after_the_other_from_the_gripper_to_the_base() -> None:
    plan, order = made(), []
    chain: list[SeenServo] = []
    while plan.step.kind is not StepKind.DONE:
        plan.receive(chain)
        step = plan.step
        if step.kind is StepKind.CONNECT:
            assert step.joint is not None
            order.append(step.joint.servo_id)
            plan.receive([*chain, seen(1)])
            if step.joint.servo_id != 1:
                assert plan.step.kind is StepKind.ASSIGN
                assert plan.step.joint is step.joint
                plan.assigned(step.joint, info(step.joint.servo_id))
            chain.append(seen(step.joint.servo_id))
    assert order == [6, 5, 4, 3, 2, 1]
    assert plan.step.text == "all servos are set up"


def test_servos_that_were_connected_alone_are_checked_together_at_the_end() -> None:
    plan = made()
    for servo_id in (6, 5, 4, 3, 2, 1):
        plan.receive([seen(servo_id)])
        assert plan.step.kind is (StepKind.CONNECT if servo_id != 1 else StepKind.CHECK)
    assert plan.step.text.startswith("connect all servos in a chain; not there: shoulder_lift (2)")
    plan.receive([seen(i) for i in (1, 2, 3, 4, 6)])
    assert plan.step.text == "connect all servos in a chain; not there: wrist_roll (5)"
    plan.receive([seen(i) for i in (1, 2, 3, 4, 5, 6, 9)])
    assert plan.step.text == "unplug what does not belong to the arm: servo 9"
    plan.receive([seen(i) for i in (1, 2, 3, 4, 5, 6)])
    assert plan.step.kind is StepKind.DONE


def test_it_is_resumed_by_what_answers() -> None:
    plan = made()
    plan.receive([seen(6), seen(5), seen(1)])
    assert set(plan.done) == {"gripper", "wrist_roll"}
    step = plan.step
    assert (step.kind, step.text) == (StepKind.ASSIGN, "wrist_flex becomes servo 4 at 1000000 baud")
    whole = made()
    whole.receive([seen(i) for i in range(1, 7)])
    assert whole.step.kind is StepKind.DONE


def test_a_servo_of_which_only_the_rate_is_missing_keeps_its_joint() -> None:
    plan = made()
    plan.receive([seen(3, 115_200)])
    step = plan.step
    assert (step.kind, step.joint) == (StepKind.ASSIGN, SO101.joint("elbow_flex"))
    # If that joint is set up already, it is another servo.
    plan.receive([seen(3), seen(3, 115_200)])
    assert plan.step.joint is SO101.joint("gripper")


def test_two_servos_by_mistake() -> None:
    plan = made()
    plan.receive([seen(1, shared=True)])
    assert plan.step.kind is StepKind.SEPARATE
    assert plan.step.text == "several servos have id 1: unplug all but one of them"
    plan.receive([seen(1), seen(1, 500_000)])
    assert plan.step.kind is StepKind.SEPARATE
    assert "1 at 1000000 baud and 1 at 500000 baud" in plan.step.text
    plan.receive([seen(6), seen(6, shared=True)])
    assert plan.step.kind is StepKind.SEPARATE


def test_what_must_not_be_changed_and_what_to_think_about() -> None:
    plan = made(leader=True)
    high = Remark(True, "supply 12.1 V is above its limit of 8.0 V")
    plan.receive([seen(1)._replace(remarks=(high,), blocked=high.text)])
    assert (plan.step.blocked, plan.step.warning) == (high.text, "")
    plan.receive([SeenServo(1, MILLION, False, None, blocked="it tells nothing of itself")])
    assert plan.step.blocked == "it tells nothing of itself"
    plan.receive([seen(1, kind="12 V")._replace(info=info(1, 2570), remarks=(Remark(True, "old firmware"),))])
    assert plan.step.blocked == ""
    assert plan.step.warning == (
        "a leader arm has servos for 7.4 V, and this one is made for 12 V; this arm has sts3215 servos, and this "
        "is a hls3606; old firmware"
    )


def test_only_one_joint_after_a_repair() -> None:
    plan = made(only="elbow_flex")
    plan.receive([])
    assert plan.step.kind is StepKind.CONNECT
    assert plan.step.text.endswith(": alone")
    plan.receive([seen(5), seen(6)])
    assert plan.step.kind is StepKind.SEPARATE
    plan.receive([seen(5)])
    assert (plan.step.kind, plan.step.joint) == (StepKind.ASSIGN, SO101.joint("elbow_flex"))
    plan.assigned(SO101.joint("elbow_flex"), info(3))
    assert plan.step.kind is StepKind.DONE
    with pytest.raises(UsageError, match="no joint 'tail'"):
        made(only="tail")


def test_remarks_name_their_joints_once() -> None:
    plan = made()
    old = Remark(True, "firmware is old")
    plan.receive([seen(1)._replace(remarks=(old,)), seen(2)._replace(remarks=(old,)), seen(3, kind="12 V")])
    assert plan.remarks == (
        "shoulder_pan, shoulder_lift: firmware is old",
        "servos for 12 V and for 7.4 V are mixed: no supply fits both",
    )


def test_a_servo_in_words() -> None:
    assert str(seen(1)) == ("servo 1 at 1000000 baud: sts3215, firmware 3.10, made for 7.4 V, supply 7.4 V")
    assert str(SeenServo(1, 500_000, False, None)) == "servo 1 at 500000 baud"
    assert "supply" not in str(seen(1)._replace(supply=math.nan))


def test_the_picture_shows_what_to_connect_and_what_is_done() -> None:
    plan = made()
    plan.receive([seen(6), seen(5)])
    lines = "\n".join(picture(plan))
    assert "(4)-[5]-[6]" in lines
    assert " 3 " in lines
    assert "(4) wrist_flex" in lines
    follower = made(leader=False)
    assert max(len(line) for view in (plan, follower) for line in picture(view)) < 80
    assert picture(ArmSetup(ArmModel("chain", SO101.joints), MILLION)) == ()


def test_the_gears_on_the_label() -> None:
    assert label(SO101, "gripper", leader=True) == "1:147 (C046)"
    assert label(SO101, "gripper", leader=False).startswith("1:345 (C001")
    assert label(SO101, "gripper", leader=None) == ""
    # The makers of the SO-100 take the gears of its leader out.
    assert label(load_profile("so100").model, "gripper", leader=True) == ""
    plan = made(leader=True)
    plan.receive([])
    assert any("gears 1:147 (C046)" in line for line in picture(plan))


def test_other_arms_have_their_own_ids() -> None:
    joints = tuple(replace(joint, servo_id=joint.servo_id + 10) for joint in SO101.joints[:2])
    plan = ArmSetup(ArmModel("mine", joints), MILLION)
    plan.receive([seen(1)])
    assert plan.step.text == "shoulder_lift becomes servo 12 at 1000000 baud"
    plan.receive([seen(11), seen(12)])
    assert plan.step.kind is StepKind.DONE
