"""Hands that move the joints of an emulated arm, as a person does who guides it.

Owns the path and the force of a hand, and which joint a word names. A hand pulls the joint along a smooth path, as
hard as its force allows, and then lets go; what comes of it follows from the motor, the gears and the stops.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.model.arm import ArmModel, JointModel

from .servo import EmulatedServo
from .servo_motion import TICK, Motion

__all__ = ["FORCE", "Grip", "Hand", "HandOrder", "HandResult", "Hands", "usual_seconds"]

FORCE = 0.6
"""Force of a hand unless an order says otherwise, as a share of the servo's stall torque."""
_GRIP = 1 / 4
"""Share of the stall torque per count between hand and joint: a joint without torque follows within a count."""
_SETTLING = 0.1
"""Seconds for which a hand stays at the end of its path, so that the joint is there too."""
_PACE = 60.0
"""Degrees per second of a hand in no hurry."""
_SHORTEST = 0.3


def usual_seconds(degrees: float) -> float:
    """Seconds that a hand takes for a motion, unless an order says otherwise."""
    return max(_SHORTEST, abs(degrees) / _PACE)


@dataclass(frozen=True, slots=True)
class HandOrder:
    """What a hand is to do.

    Attributes:
        joint: Name of the joint, or id of its servo.
        degrees: Distance, positive as the joint's angle.
        seconds: Duration of the motion.
        hold: Seconds for which it holds the joint at the end of the motion.
        force: Its greatest torque, as a share of the servo's stall torque.
    """

    joint: str
    degrees: float
    seconds: float
    hold: float = 0.0
    force: float = FORCE


@dataclass(frozen=True, slots=True)
class HandResult:
    """What came of an order.

    Attributes:
        joint: Name of the joint, or ``servo 3`` where servos have no names.
        moved: Degrees from the start when the hand let go.
        torque: The joint had torque then, so it goes back.
        blocked: It was at a mechanical stop or an obstacle.
    """

    joint: str
    moved: float
    torque: bool
    blocked: bool


class Hand:
    """A hand at one shaft, from now on until it lets go.

    Args:
        motion: The shaft.
        counts: Distance to pull it, counts.
        seconds: Duration of that.
        hold: Seconds for which it then holds the shaft.
        force: Greatest torque, as a share of the stall torque.

    Attributes:
        start: Position of the shaft when the hand took it.
        position: Position up to which the hand has had it.
        blocked: It was at a stop or an obstacle there.
    """

    def __init__(self, motion: Motion, counts: float, seconds: float, hold: float, force: float) -> None:
        self.start = self.position = motion.position
        self.blocked = False
        self._motion, self._counts, self._force = motion, counts, force
        self._ticks = 0
        self._moving = max(1, round(seconds / TICK))
        self._last = self._moving + round((hold + _SETTLING) / TICK)
        # Critical damping of a joint at its lightest.
        self._damping = 2.0 * math.sqrt(_GRIP / motion.mechanics.full_acceleration)
        motion.hand = self._push

    @property
    def has_let_go(self) -> bool:
        """Whether the shaft is free again; also if another hand has taken it, or it was switched off meanwhile."""
        return self._motion.hand != self._push

    def let_go(self) -> None:
        """Let go before the end."""
        if not self.has_let_go:
            self._motion.hand = None

    def _push(self, position: float, velocity: float) -> float | None:
        self.position, self.blocked = position, self._motion.blocked
        if self._ticks >= self._last:
            return None
        self._ticks += 1
        part = min(1.0, self._ticks / self._moving)
        # From rest to rest, without a jerk at either end.
        way = part**3 * (10.0 - 15.0 * part + 6.0 * part * part)
        pace = 30.0 * (part * (1.0 - part)) ** 2 / (self._moving * TICK)
        pull = _GRIP * (self.start + self._counts * way - position) + self._damping * (
            self._counts * pace - velocity
        )
        return max(-self._force, min(self._force, pull))


class Hands:
    """The joints of an emulated arm or bus that hands can move.

    Args:
        servos: Its servos.
        arm: Names and directions of its joints; None if it has only servos, which count upward.
    """

    def __init__(self, servos: Sequence[EmulatedServo], arm: ArmModel | None = None) -> None:
        self._servos, self._arm = servos, arm

    def take(self, order: HandOrder, now: float) -> Grip:
        """Take the joint that an order names; the hand moves while time passes for the servo.

        Raises:
            UsageError: There is no such joint, or another hand has it.
        """
        servo = self._servo(order.joint)
        servo.step(now)
        joint = None if self._arm is None else self._arm.by_servo(servo.servo_id)
        if servo.motion.hand is not None:
            raise UsageError(f"another hand holds {_name(servo, joint)}; wait until it lets go")
        return Grip(servo, joint, order)

    def _servo(self, word: str) -> EmulatedServo:
        wanted = int(word) if word.isascii() and word.isdecimal() else None
        if self._arm is not None and wanted is None:
            wanted = self._arm.joint(word).servo_id
        for servo in self._servos:
            if servo.servo_id == wanted:
                return servo
        ids = ", ".join(str(servo.servo_id) for servo in self._servos)
        raise UsageError(f"there is no servo {word!r}; there are {ids}")


class Grip:
    """A hand at a joint, and what comes of it."""

    def __init__(self, servo: EmulatedServo, joint: JointModel | None, order: HandOrder) -> None:
        self._servo, self._name = servo, _name(servo, joint)
        turn = math.radians(servo.series.range_deg) / servo.series.counts_per_rev
        self._scale = math.degrees(turn if joint is None else joint.sign * joint.scale)
        counts = order.degrees / self._scale
        self._hand = Hand(servo.motion, counts, order.seconds, order.hold, order.force)

    def step(self, now: float) -> HandResult | None:
        """Let time pass; returns the result once the hand has let go."""
        hand = self._hand
        self._servo.step(now)
        if not hand.has_let_go:
            return None
        moved = (hand.position - hand.start) * self._scale
        return HandResult(self._name, moved, self._servo.torque_on, hand.blocked)

    def let_go(self) -> None:
        """Let go before the end."""
        self._hand.let_go()


def _name(servo: EmulatedServo, joint: JointModel | None) -> str:
    return f"servo {servo.servo_id}" if joint is None else joint.name
