"""Measures the backlash of one servo by a small wave about the place where it stands.

Owns the order: limits, torque, wave, way back, torque as before. The servo moves. Must not know terminals or pages.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, ServoError
from hexwire.model.state import JointFlag
from hexwire.motion.backlash import BACKLASH_AMPLITUDE, BACKLASH_SECONDS, backlash, backlash_angle

from .servo_wave import WaveEnd, bring_back, one_servo, run_wave, standing

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus

__all__ = ["measure_backlash"]


def measure_backlash(
    bus: ServoBus,
    servo_id: int,
    *,
    clock: Callable[[], float],
    sleep: Callable[[float], object],
    go_on: Callable[[], bool] = lambda: True,
    shield: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> float:
    """Move a servo by 3 degrees to either side, three times, and back.

    Args:
        bus: The open bus, which knows the servo's series.
        servo_id: The servo.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        go_on: Asked before each goal; the wave ends as soon as it returns False.
        shield: Protects the way back from signals.

    Returns:
        The backlash, radians; NaN if it was ended early.

    Raises:
        UsageError: The servo is too near to one of its limits, or not in position mode.
        ServoError: It is silent, has a fault, or was stopped.
        StoppedError: The arm is stopped.
    """
    with one_servo(bus, servo_id, BACKLASH_AMPLITUDE) as arm:
        start = standing(arm)
        had_torque = bool(start.flags & JointFlag.TORQUE_ON)
        if not arm.torque(True):
            raise ServoError(f"servo {servo_id} does not confirm its torque", servo_id=servo_id)
        end = WaveEnd()

        def back() -> None:
            # Refused after a stop: the servo holds where it is.
            with shield():
                if not bring_back(arm, start, keep_torque=had_torque, sleep=sleep):
                    raise ServoError(f"servo {servo_id} does not confirm its torque off", servo_id=servo_id)

        try:
            run_wave(arm, start, backlash_angle, BACKLASH_SECONDS, end, go_on=go_on, clock=clock, sleep=sleep)
        except BaseException:
            # What ended it must be reported first.
            with suppress(HexwireError):
                back()
            raise
        back()
    return backlash((row.t, row.position) for row in end.samples)
