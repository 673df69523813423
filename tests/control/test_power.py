from __future__ import annotations

import math

import pytest
from tests.control.arm_bench import make_bench
from tests.control.owner_bench import BoardBench
from tests.drivers.arms import Arm
from tests.model.states import make_state

from hexwire.control.loop.known_state import KNOWN_FOR
from hexwire.control.loop.power import Torques, end_stop, give_torque, switch_torque
from hexwire.drivers.values import StopMode
from hexwire.errors import ServoError, StoppedError
from hexwire.model.state import JointFlag, JointState


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
    said = rf"^J5 \(servo 4\) did not confirm that torque is {'on' if on else 'off'}$"
    with pytest.raises(ServoError, match=said):
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


ON, OFF, UNREAD = int(JointFlag.TORQUE_ON), 0, int(JointFlag.TORQUE_UNKNOWN)
SILENT = ON | int(JointFlag.SILENT)
NAMES = ("J1", "J2", "J3", "J4")


def seen(*ages: float, stamp: float = 10.0) -> JointState:
    return make_state(0.0, 0.0, 0.0, 0.0, stamp=stamp, flags=(ON, OFF, SILENT, UNREAD), age=ages or (0.0,) * 4)


def test_what_the_joints_do_is_said_only_as_long_as_it_is_known() -> None:
    for now in (10.0, 10.0 + 0.99 * KNOWN_FOR):
        assert Torques.of(NAMES, seen(), now) == Torques(("J1",), ("J2",), ("J3", "J4"))
    # Each joint for itself, and after the time all of them.
    assert Torques.of(NAMES, seen(0.0, 0.99, 0.0, 0.0), 10.0) == Torques(("J1",), (), ("J2", "J3", "J4"))
    assert Torques.of(NAMES, seen(math.inf, 0.0, 0.0, 0.0), 10.0) == Torques((), ("J2",), ("J1", "J3", "J4"))
    for state, now in ((seen(), 10.01 + KNOWN_FOR), (None, 10.0)):
        assert Torques.of(NAMES, state, now) == Torques(unknown=NAMES)
    assert KNOWN_FOR < 0.75, "with a quarter of a second between two messages to a page it is a second"


def test_after_a_stop_nobody_is_said_to_hold_who_does_not() -> None:
    before = Torques(("J1",), ("J2",), ("J3", "J4"))
    assert before.after_stop(NAMES, StopMode.HOLD) == before
    assert str(before) == "holding: J1; limp: J2; unknown: J3 J4"
    assert before.after_stop(("J2", "J4"), StopMode.HOLD) == Torques((), ("J2",), ("J1", "J3", "J4"))
    off = before.after_stop(("J1", "J4"), StopMode.TORQUE_OFF)
    assert (off.holding, off.limp, set(off.unknown)) == ((), ("J1", "J4"), {"J2", "J3"})
    assert [
        Torques(*rows).short for rows in (((), NAMES), (NAMES,), (("J1",), ("J2",)), (("J1",), (), ("J2",)))
    ] == [
        "off",
        "on",
        "J1",
        "",
    ]


def test_every_front_says_of_a_limp_arm_that_it_is_limp() -> None:
    """The command line and the shared arm are tried in their own rooms; the nodes and the studio ask the arm."""
    bench = make_bench(on=False)
    bench.ask(lambda: bench.owner.torque(True, ("J2",)))
    bench.turn(0.3)
    assert bench.arm.stop("test").startswith("stopped, holding: J2; limp: J1 J3 J4 J5 J6 J7; ")
    bench.link.lost = True
    bench.turn(1.0)
    assert bench.arm.torques() == Torques(unknown=bench.arm.settings.model.names)
