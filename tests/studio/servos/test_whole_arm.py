from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.servos.conftest import servo_of

from hexwire.errors import HexwireError, StoppedError, UsageError
from hexwire.setup.arm_setup import StepKind
from hexwire.studio.servos.whole_arm import assign_one, look_for, plan_of

if TYPE_CHECKING:
    from tests.studio.servos.conftest import Bench


def connect(view: Any, *servos: Any) -> None:
    """Only these servos are plugged in."""
    view.bus.bus.link.device.wire.servos = list(servos)


def test_an_arm_is_set_up_servo_by_servo(view: Any) -> None:
    all_servos = [servo_of(view, servo_id) for servo_id in range(1, 7)]
    view.bus.bench.servo_ids, view.bus.servos = (), []
    for servo in all_servos[3:]:
        servo.registers.put_stored("id", 1)
    for servo_id, servo in zip((4, 5, 6), all_servos, strict=False):
        servo.registers.put_stored("id", servo_id)
    setup = plan_of("so101", "follower")
    # Three were set up before.
    connected: list[Any] = all_servos[:3]
    for servo, servo_id in zip(all_servos[3:], (3, 2, 1), strict=True):
        connected.append(servo)
        connect(view, *connected)
        look_for(view, setup, everywhere=False)
        step = setup.step
        if servo_id > 1:
            assert (step.kind, step.joint.servo_id if step.joint else 0) == (StepKind.ASSIGN, servo_id)
            assign_one(view, setup, step)
        assert servo.registers.stored("id") == servo_id
    look_for(view, setup, everywhere=False)
    assert setup.step.kind is StepKind.DONE
    assert view.bus.bench.servo_ids == (1, 2, 3, 4, 5, 6)


def test_choices_are_checked_and_a_stop_refuses_a_change(view: Any) -> None:
    for arm, role in (("puma", ""), ("so101", "king")):
        with pytest.raises(UsageError):
            plan_of(arm, role)
    servo = servo_of(view, 6)
    servo.registers.put_stored("id", 15)
    connect(view, servo)
    setup = plan_of("so101", "")
    look_for(view, setup, everywhere=False)
    step = setup.step
    assert step.kind is StepKind.ASSIGN
    view.bus.bench.servo_ids = ()
    view.bus.stop("enough")
    with pytest.raises(StoppedError):
        assign_one(view, setup, step)
    assert servo.registers.stored("id") == 15


def test_a_search_can_be_cancelled(view: Any) -> None:
    job_of = view.bus.bench

    class Bus:
        def __getattr__(self, name: str) -> Any:
            return getattr(plain, name)

        def ping(self, servo_id: int) -> Any:
            job_of.cancel()
            return plain.ping(servo_id)

    plain, view.bus.bus = view.bus.bus, Bus()
    try:
        with pytest.raises(HexwireError, match="cancelled"):
            look_for(view, plan_of("so101", ""), everywhere=False)
    finally:
        view.bus.bus = plain


@pytest.mark.slow
def test_what_was_found_goes_with_the_choice_of_another_arm(bench: Bench) -> None:
    page = bench.page
    bench.part("Set up an arm")
    bench.button("Look what is connected").click()
    page.get_by_text("shoulder_pan", exact=True).wait_for()
    page.get_by_label("Arm", exact=True).select_option("SO-100")
    page.get_by_text("shoulder_pan", exact=True).wait_for(state="detached")
