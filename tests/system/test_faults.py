"""Whole stories in simulated time: driver, session, line, board, bus and servos, with something going wrong."""

from __future__ import annotations

import math

import pytest
from tests.drivers.arms import Arm, check_old_board_survives
from tests.few import few

from hexwire.drivers.base import StopMode
from hexwire.errors import DeviceError, HexwireError, LinkError, StoppedError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.session.policy import RetryPolicy

STORIES = [
    ("echo",),
    ("host.echo",),
    ("silent:2",),
    ("silent:5:0.3",),
    ("late:1:0.004",),
    ("late:4:0.05:0.3",),
    ("babble:3:0.3",),
    ("overload:4",),
    ("hot:5",),
    ("flip:0.02",),
    ("drop:0.02",),
    ("dup:0.02",),
    ("junk:0.05",),
    ("cut:0.02",),
    ("bus.flip:0.03", "bus.drop:0.03"),
    ("bus.dup:0.03", "bus.junk:0.03", "bus.cut:0.03"),
    ("boot:1", "reset:6"),
    ("brownout:6:0.5", "boot:0.5"),
]


def angle(i: int) -> float:
    joint = HEX7BOT.joints[i]
    return joint.offset + 0.25


@pytest.mark.parametrize("baud", [0, pytest.param(115200, marks=pytest.mark.slow)])
@few("faults", [(story,) for story in STORIES], *((story,) for story in STORIES[::3]))
def test_a_day_in_the_life(faults: tuple[str, ...], baud: int) -> None:
    """Every state is true or says that it is not known; every error is one of ours; nothing hangs."""
    for dialect in (1, 2):
        live_a_day(faults, dialect, baud)


def live_a_day(faults: tuple[str, ...], dialect: int, baud: int) -> None:
    if dialect == 1 and any(f[:4] in ("flip", "drop", "dup:", "cut:", "junk") for f in faults):
        # The chapter's frames carry no check toward the board: what a spoilt write does is anybody's guess.
        faults = tuple(f"bus.{f}" for f in faults)
    arm = Arm(dialect, baud, faults, seed=2, policy=RetryPolicy(attempts=8))
    errors: list[HexwireError] = []

    def attempt(*steps: object) -> None:
        for step in steps:
            try:
                step()  # type: ignore[operator]  # functions
            except (DeviceError, LinkError) as error:
                errors.append(error)

    target = JointTarget.of({n: angle(i) for i, n in enumerate(HEX7BOT.names)}, 2.0)
    attempt(lambda: arm.driver.torque(True), lambda: arm.driver.write(target))
    for _ in range(40):
        begun = arm.clock.time
        state = arm.driver.read()
        for reading, joint in zip(state, HEX7BOT.joints, strict=True):
            if math.isnan(reading.position):
                assert reading.name in state.silent
                continue
            # 0.5 rad/s at most here; what it was since the read began.
            old = arm.clock.time - min(begun, state.stamp) + reading.age
            true = joint.counts_to_angle(arm.shaft(joint.servo_id))
            assert abs(reading.position - true) < 0.02 + 0.75 * (old + 0.02), (dialect, reading, true)
        arm.wait(0.2)
    attempt(lambda: arm.driver.stop(StopMode.TORQUE_OFF))
    with pytest.raises(StoppedError):
        arm.driver.write(target)
    assert not [error for error in errors if "\n" in str(error)]
    if faults in ([], ("echo",), ("host.echo",), ("overload:4",), ("hot:5",)):
        assert errors == []
        assert not any(arm.torques())
    if dialect == 1:
        check_old_board_survives(arm.link.written)


def test_a_reset_in_the_middle_of_a_move_stops_the_arm_and_the_watchdog_comes_back() -> None:
    arm = Arm(2, 115200, ("reset:3",))
    arm.driver.torque(True)
    arm.driver.watchdog(0.5)
    arm.driver.write(JointTarget.of({"J1": 1.0, "J5": 1.0}, 6.0))
    while arm.clock.time < 1003.2:
        arm.driver.read()
        arm.wait(0.1)
    held = arm.shafts()
    for _ in range(20):
        arm.driver.read()
        arm.wait(0.1)
    assert arm.shafts() == pytest.approx(held, abs=5)
    assert arm.driver.read().torque_on == HEX7BOT.names
    arm.wait(1.0)
    assert arm.driver.read().watchdog_tripped


def test_a_host_that_dies_in_the_middle_of_a_move_is_stopped_for() -> None:
    arm = Arm(2, 115200)
    arm.driver.torque(True)
    arm.driver.watchdog(0.3)
    arm.driver.write(JointTarget.of({"J1": 1.0, "J5": 1.0}, 6.0))
    arm.wait(1.0)
    held = arm.shafts()
    arm.wait(8.0)
    assert arm.shafts() == pytest.approx(held, abs=5)
    state = arm.driver.read()
    assert (state.stopped, state.watchdog_tripped) == (True, True)
    arm.driver.resume()
    arm.driver.write(JointTarget.of({"J1": 0.5}, 0.2))
