"""The steps of a first run, without a page: on emulated servos in simulated time, and with states of a board."""

from __future__ import annotations

import math

import pytest
from tests.control.so_bench import NAMES, SoBench

from hexwire.drivers.stored_calibration import stored_calibration
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.calibration import Calibration
from hexwire.setup.calibrating import store
from hexwire.setup.first_run import SPEED, STEP, FirstRun, FoundJoint, Stage


def found(run: FirstRun, *silent: str) -> list[FoundJoint]:
    return [
        FoundJoint(joint.name, joint.servo_id, "sts3215", "does not answer" if joint.name in silent else "")
        for joint in run.model.joints
    ]


def by_hand(parts: SoBench) -> Calibration:
    """Calibrate the arm, attached, as a person does."""
    with parts.attached() as bench:
        bench.release()
        hand = bench.by_hand()
        ends = [servo.motion.stops or (servo.motion.position,) * 2 for servo in parts.arm.servos]
        for share in [part / 40 for part in range(41)]:
            for servo, (low, high) in zip(parts.arm.servos, ends, strict=True):
                servo.motion.position = low + share * (high - low)
            hand.receive(bench.positions(), share)
        hand.mark_middle()
        return hand.finish("now")


def test_an_arm_is_taken_from_uncalibrated_to_its_first_jog_and_back() -> None:
    parts = SoBench(3)
    run = FirstRun(parts.described.model, bare=True)
    with pytest.raises(UsageError, match="look what answers"):
        run.forward()
    run.identified(found(run, "elbow_flex"), "An arm.")
    assert run.told.joint == "elbow_flex"
    with pytest.raises(UsageError, match="elbow_flex: not ready"):
        run.forward()
    run.identified(found(run), "An arm.")
    run.forward()
    with parts.driver:
        former = stored_calibration(parts.driver.bus, run.model)
    run.examined(former)
    assert not run.calibrated
    assert "Not calibrated" in run.told.text
    # The wrist has no stops, so nothing tells whether it is.
    assert [name for name, _, level in run.told.rows if level == "error"] == [n for n in NAMES if n != "wrist_roll"]
    run.forward()
    with pytest.raises(UsageError, match="measure the ranges first"):
        run.forward()
    run.may_measure()
    run.measured = by_hand(parts)
    with pytest.raises(UsageError, match="store the ranges first"):
        run.forward()
    # What would be written is said before.
    row = run.measured.joints[0]
    assert run.told.rows[0][1] == f"offset 0 → {row.servo_offset}, range 0 to 4095 → {row.low} to {row.high}"
    with parts.driver:
        store(parts.driver.bus, run.measured)
        run.was_stored(former)
        run.examined(stored_calibration(parts.driver.bus, run.model))
        assert run.calibrated
        # And back: the factory's values are there again.
        store(parts.driver.bus, former)
        run.was_undone()
        run.examined(stored_calibration(parts.driver.bus, run.model))
    assert not run.calibrated
    assert run.former is None
    with pytest.raises(UsageError):
        run.forward()


def jogging(run: FirstRun) -> None:
    """Go on to the first jog."""
    run.identified(found(run), "An arm.")
    while run.stage is not Stage.JOG:
        run.forward()


def test_the_first_jog_is_one_small_step_of_a_joint_with_torque() -> None:
    run = FirstRun(HEX7BOT, bare=False)
    with pytest.raises(UsageError, match="after the other steps"):
        run.jog("J1", 1, torque=True)
    jogging(run)
    assert run.jog("J1", -1, torque=True) == {"what": "step", "joint": "J1", "by": -STEP, "speed": SPEED}
    assert math.degrees(STEP) <= 5.0
    for joint, way, torque in (("J1", 1, False), ("J1", 0, True), ("J1", 2, True), ("J9", 1, True)):
        with pytest.raises(UsageError):
            run.jog(joint, way, torque=torque)
    for moved in (0.0, math.nan, math.radians(0.5)):
        run.jogged("J1", moved)
        with pytest.raises(UsageError, match="move one joint first"):
            run.forward()
    run.jogged("J1", -STEP)
    assert run.told.rows[0] == ("J1", "moved −5.0 deg", "ok")
    run.forward()
    assert run.stage is Stage.DONE
    with pytest.raises(UsageError, match="over"):
        run.forward()


def test_behind_a_board_nothing_is_calibrated_and_a_hand_only_shows() -> None:
    run = FirstRun(HEX7BOT, bare=False)
    run.identified(found(run), "A board.")
    run.forward()
    assert run.calibrated
    run.forward()
    with pytest.raises(UsageError, match="not calibrated at this step"):
        run.may_measure()
    for angle in (0.1, math.nan, 0.3):
        run.seen({"J2": angle})
    rows = {row.name: row for row in run.progress}
    assert (rows["J2"].low, rows["J2"].high, rows["J2"].missing) == (0.1, 0.3, "")
    assert rows["J1"].missing
    run.back()
    run.back()
    with pytest.raises(UsageError, match="first step"):
        run.back()
