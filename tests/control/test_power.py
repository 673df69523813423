from __future__ import annotations

import pytest
from tests.control.owner_bench import BoardBench
from tests.drivers.arms import Arm

from hexwire.control.power import end_stop, give_torque, switch_torque
from hexwire.errors import ServoError, StoppedError


def test_torque_is_given_to_those_that_have_none() -> None:
    arm = Arm(2)
    arm.driver.torque(True, ["J1"])
    assert give_torque(arm.driver, ["J1", "J2"], arm.driver.read()) == ("J2",)
    assert arm.torques()[:3] == [True, True, False]
    written = len(arm.link.written)
    assert give_torque(arm.driver, ["J1", "J2"], arm.driver.read()) == ()
    assert len(arm.link.written) == written + 1, "nothing but the read"


def test_a_joint_that_does_not_confirm_its_torque_is_named_with_its_servo() -> None:
    arm = Arm(2, faults=("silent:4", "silent:5"))
    with pytest.raises(ServoError, match=r"^servos 4 \(J5\), 5 \(J6\) do not answer: check cable, power and id$"):
        give_torque(arm.driver, ["J4", "J5", "J6"], arm.driver.read())


@pytest.mark.parametrize("on", [True, False])
def test_switching_is_confirmed_by_every_joint(on: bool) -> None:
    bench = BoardBench(faults=("silent:4",))
    bench.owner.connect()
    bench.turn(0.2)
    with pytest.raises(ServoError, match=f"^J5 did not confirm that torque is {'on' if on else 'off'}$"):
        bench.ask(lambda: switch_torque(bench.owner, on, bench.robot.model.names))


def test_end_stop_switches_off_only_a_watchdog_that_has_tripped() -> None:
    arm = Arm(2)
    arm.driver.torque(True)
    arm.driver.watchdog(0.5)
    arm.driver.stop()
    assert not end_stop(arm.driver)
    assert arm.board.state.watchdog_timeout == 0.5
    arm.clock.advance(1.0)
    assert arm.driver.read().watchdog_tripped
    with pytest.raises(StoppedError):
        arm.driver.torque(True)
    assert end_stop(arm.driver)
    assert arm.board.state.watchdog_timeout == 0.0
    arm.driver.torque(True)
