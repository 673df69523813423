"""One servo of a bus moved by a person: jogged or dragged while it is held, or by an exact step.

Owns the servo as an arm of one joint within its own limits, and what ends its motion: the person, a fault, a stop.
How it moves is `hexwire.control.motion.jog`, as for the joints of an arm. Must not know terminals or pages.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.jog import JogController, JogRequest
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.arm_file import BusArmFile
from hexwire.drivers.bus_arm import BusArm
from hexwire.errors import ServoError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.motion.safety import STOP_COMMAND

from .servo_wave import WAVE_RATE, own_limits, standing

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.model.state import SentTarget

__all__ = ["SlideServo", "sliding_servo"]

_FASTEST = math.radians(180.0)
"""Radians per second at full speed: a servo on a bench has no other limit."""
_SETTLES = 0.2
"""Seconds after the last goal of a step in which the servo comes there."""
_NEAR = math.radians(3.0)
"""A step begins at the goal of the one before if the servo is no farther from it, so that steps add up exactly."""


def sliding_servo(bus: ServoBus, servo_id: int) -> BusArm:
    """Make an arm of one servo on an open bus, within the servo's own limits; its angle is 0 at count 0.

    Args:
        bus: The bus, which knows the servo's series; it stays open when the arm is detached.
        servo_id: The servo.

    Raises:
        UsageError: The servo does not control its position.
        ServoError: The servo does not answer, or has a fault.
    """
    series = bus.series_of(servo_id)
    reading = bus.read(servo_id, "present_position").check()
    scale = reading.register.si_factor
    least, most = own_limits(bus, servo_id) or (0, series.counts_per_rev - 1)
    name = f"servo {servo_id}"
    joint = JointModel(name, servo_id, series.value, 0, 1, 0.0, scale, least * scale, most * scale, _FASTEST)
    return BusArm(bus.link, arm=BusArmFile(ArmModel("one servo", (joint,)), bus.timing.baud), bus=bus)


class SlideServo:
    """One motion of a servo.

    Args:
        arm: From `sliding_servo`, attached. The servo has torque.
        request: What is held: a direction or a goal of the only joint.
        age: Returns the seconds since the last sign of life of whoever holds it; infinite when it is to end.
        silence: Seconds without one after which the servo brakes.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.

    Attributes:
        wanted: What is held; another one may be put here while it moves, by any thread.
        sent: The last goal that was sent, radians; NaN before the first.
    """

    def __init__(
        self,
        arm: BusArm,
        request: JogRequest,
        age: Callable[[], float],
        silence: float,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], object],
    ) -> None:
        self.wanted, self.sent = request, math.nan
        self._arm, self._age, self._clock, self._sleep = arm, age, clock, sleep
        self._check = PathCheck.limits_only(arm.model)
        self._jog = JogController(arm.model, None, self._check, silence=silence)

    def by(self, angle: float, last: float, speed: float) -> None:
        """Make it a step.

        Args:
            angle: How far, radians.
            last: The goal of the step before; NaN if there was none.
            speed: Share of the greatest speed.

        Raises:
            LimitError: It leads beyond the limits of the servo.
            ServoError: The servo does not report its position.
        """
        joint = self._arm.model.joints[0]
        here = standing(self._arm).position
        goal = (last if abs(last - here) <= _NEAR else here) + angle
        joint.check(goal)
        self.wanted = JogRequest(goals={joint.name: goal}, speed=speed)

    def run(self, go_on: Callable[[], bool], *, once: bool = False) -> None:
        """Move until it ends; the servo then holds.

        Args:
            go_on: Asked before each goal; once it returns False, the servo brakes.
            once: It ends where its goal is, as a step does.

        Raises:
            GoalError: The servo has no torque.
            ServoError: It has a fault, falls silent or was stopped.
        """
        jog, name = self._jog, self._arm.model.names[0]
        servo_id = self._arm.model.joints[0].servo_id
        owner = RobotOwner(
            self._arm,
            check=self._check,
            borrowed=True,
            command_rate=WAVE_RATE,
            stop_on_failure=False,
            clock=self._clock,
            sleep=self._sleep,
            on_sent=self._keep,
        )
        there = math.inf
        with owner:
            owner.group.members = (jog,)
            taken = self.wanted
            jog.begin(taken, lambda: self._age() if go_on() else math.inf, self._arm.read())
            while jog.busy:
                owner.turn()
                state = owner.state
                if state is not None and (faults := state[name].flags.faults):
                    fault = f"stopped: {faults}"
                    jog.release(fault)
                    raise ServoError(f"servo {servo_id} {fault}", servo_id=servo_id)
                if taken is not self.wanted:
                    taken = self.wanted
                    with owner.locked():
                        jog.update(taken)
                if once and abs(self.sent - taken.goals[name]) < self._arm.model.joints[0].scale:
                    there = min(there, self._clock() + _SETTLES)
                    if self._clock() >= there:
                        # Without another goal, which would be where the servo is and not where it was sent.
                        jog.release("arrived")
                        self.sent = taken.goals[name]
            stopped = STOP_COMMAND if self._arm.epochs.stopped else ""
        if stopped:
            raise ServoError(f"stopped: {stopped}; clear it with 'hexwire resume'", servo_id=servo_id)

    def _keep(self, sent: SentTarget) -> None:
        self.sent = sent.positions[0][1]
