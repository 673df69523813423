"""How an emulated servo's shaft moves: one millisecond at a time, from a command and the forces on it.

Owns position, velocity and motor torque. Knows no registers and no series: `servo` translates. Torques are
fractions of the stall torque, positions encoder counts of the shaft, positive toward higher counts.

The model is a first guess at a geared hobby servo, not a measured one: a trapezoidal speed profile, an inertia,
dry friction, gravity as a function of the angle, and a motor that cannot give more than its ceiling. Where that is
not enough, the joint lags, stalls or sags.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

__all__ = ["TICK", "Mechanics", "Motion", "MotorDrive", "speed_for_duration"]

TICK = 0.001
"""Seconds per step of the model. Time is counted in whole ticks from 0, so results do not depend on the caller."""

_CLOSE = 0.01  # counts: a slow shaft that is nearer than this has arrived
_COASTING = 15.0  # drag of motor and gears without power, 1/s
_DAMPING = 60.0  # the same with the winding shorted
_STIFFNESS = 1 / 64  # torque per count of error against an obstacle, about what a position gain of 32 gives
_WIND_UP = 1.5 / _STIFFNESS  # counts by which a profile may lead a shaft that is held back


class MotorDrive(Enum):
    """Kind of control of the motor."""

    FREE = "free"
    DAMPED = "damped"
    POSITION = "position"
    SPEED = "speed"
    TORQUE = "torque"


# Kept here because each tick asks for them: looking up a member of an enum is slow.
_POSITION, _SPEED, _TORQUE, _DAMPED = MotorDrive.POSITION, MotorDrive.SPEED, MotorDrive.TORQUE, MotorDrive.DAMPED


@dataclass(frozen=True, slots=True)
class Mechanics:
    """Limits and constants of a servo's motor and gears.

    Attributes:
        max_speed: No-load speed at nominal voltage, counts/s.
        max_acceleration: Steepest ramp the servo's own profile uses, counts/s^2.
        full_acceleration: Acceleration of the joint at full stall torque, counts/s^2.
        friction: Dry friction while powered or moving.
        holding_friction: Dry friction of the gears at rest without power; smaller torques do not move them.
        stall_current: Amperes at full torque.
        nominal_voltage: Volts at which max_speed is reached.
        stops: Mechanical end stops of the servo itself, in counts; None for a shaft that turns without end.
    """

    max_speed: float
    max_acceleration: float = 40_000.0
    full_acceleration: float = 60_000.0
    friction: float = 0.02
    holding_friction: float = 0.15
    stall_current: float = 1.3
    nominal_voltage: float = 6.0
    stops: tuple[float, float] | None = None


def speed_for_duration(distance: float, seconds: float, acceleration: float) -> float:
    """Top speed of a trapezoidal profile that covers a distance in a given time; inf if it cannot be that fast."""
    root = acceleration * acceleration * seconds * seconds / 4 - acceleration * abs(distance)
    if root < 0:
        return math.inf
    return acceleration * seconds / 2 - math.sqrt(root)


class Motion:
    """Shaft, gears and motor.

    Set `drive`, `target`, `speed`, `acceleration` and `ceiling` through `command`; the hooks `gravity`,
    `external_torque`, `hand` and `obstacle` may be set at any time.

    Attributes:
        stops: Positions that the shaft cannot pass: those of the servo, or the narrower ones of the arm it is in.
    """

    def __init__(self, mechanics: Mechanics, position: float) -> None:
        self.mechanics = mechanics
        self.position = float(position)
        self.velocity = 0.0
        self.torque = 0.0
        self.blocked = False
        self.settled = False
        self.stops = mechanics.stops
        self._drive = MotorDrive.FREE
        self._target = self.position
        self._speed = 0.0
        self._acceleration = mechanics.max_acceleration
        self._ceiling = 0.0
        self._gravity: Callable[[float], float] | None = None
        self._external = 0.0
        self._obstacle: tuple[float | None, float | None] = (None, None)
        self._hand: Callable[[float, float], float | None] | None = None
        # The profile that a shaft follows which gives way: counts and counts/s.
        self._ahead, self._pace = self.position, 0.0

    def command(
        self, drive: MotorDrive, *, target: float, speed: float, acceleration: float, ceiling: float
    ) -> None:
        """Command the motor.

        Args:
            drive: Kind of control.
            target: Shaft counts to go to (POSITION), or signed fraction of the stall torque (TORQUE).
            speed: Speed limit (POSITION) or signed speed (SPEED), counts/s.
            acceleration: Ramp limit, counts/s^2; 0 for the servo's own maximum.
            ceiling: Highest torque the motor may give, 0..1.
        """
        self._drive = drive
        self._target = target
        self._speed = speed
        most = self.mechanics.max_acceleration
        self._acceleration = min(acceleration, most) if acceleration > 0 else most
        self._ceiling = ceiling
        self.settled = False

    @property
    def target(self) -> float:
        """Target of the shaft, counts."""
        return self._target

    @property
    def gravity(self) -> Callable[[float], float] | None:
        """Torque of gravity at a shaft position, positive toward higher counts."""
        return self._gravity

    @gravity.setter
    def gravity(self, function: Callable[[float], float] | None) -> None:
        self._gravity = function
        self.settled = False

    @property
    def external_torque(self) -> float:
        """Torque from outside, positive toward higher counts."""
        return self._external

    @external_torque.setter
    def external_torque(self, torque: float) -> None:
        self._external = float(torque)
        self.settled = False

    @property
    def obstacle(self) -> tuple[float | None, float | None]:
        """Shaft positions that cannot be passed downward and upward; None for no obstacle."""
        return self._obstacle

    @obstacle.setter
    def obstacle(self, bounds: tuple[float | None, float | None]) -> None:
        self._obstacle = bounds
        self.settled = False

    @property
    def hand(self) -> Callable[[float, float], float | None] | None:
        """A hand at the shaft: called each tick with position and velocity, it returns its torque.

        It has let go once it returns None. A motor that holds a position gives way to it like a spring.
        """
        return self._hand

    @hand.setter
    def hand(self, push: Callable[[float, float], float | None] | None) -> None:
        self._hand = push
        self._ahead, self._pace = self.position, self.velocity
        self.settled = False

    def rename(self, counts: float) -> None:
        """Count the shaft's position from elsewhere, by whole turns; nothing moves."""
        self.position += counts
        self._ahead += counts
        if self.stops is not None:
            self.stops = (self.stops[0] + counts, self.stops[1] + counts)
        # It pulls toward a place that has another name now.
        self._hand = None
        self.settled = False

    def tick(self) -> None:
        """Advance by one `TICK`."""
        position, velocity, torque = self.position, self.velocity, self.torque
        outside = self._external + (self._gravity(position) if self._gravity is not None else 0.0)
        if self._hand is not None:
            outside += self._pull()
        if self._drive is _POSITION and self._hand is not None:
            self._give_way(outside)
        elif self._drive is _POSITION or self._drive is _SPEED:
            self._controlled(outside)
        elif self._drive is _TORQUE:
            self.torque = max(-self._ceiling, min(self._ceiling, self._target))
            self.velocity = self._pushed(self.torque + outside, self.mechanics.friction, 0.0)
        else:
            self.torque = 0.0
            drag = _DAMPING if self._drive is _DAMPED else _COASTING
            self.velocity = self._pushed(outside, self.mechanics.holding_friction, drag)
        self._move()
        at_rest = self.velocity == velocity == 0.0 and self.position == position and self.torque == torque
        self.settled = at_rest and self._hand is None

    def _pull(self) -> float:
        """Torque of the hand in this tick; 0 from the tick on in which it lets go."""
        pull = self._hand(self.position, self.velocity) if self._hand is not None else None
        if pull is None:
            self._hand = None
            return 0.0
        return pull

    def _give_way(self, outside: float) -> None:
        """Hold a position, or move to it, with the proportional gain of a real servo."""
        self._follow_profile()
        damping = 2.0 * math.sqrt(_STIFFNESS / self.mechanics.full_acceleration)
        wanted = _STIFFNESS * (self._ahead - self.position) + damping * (self._pace - self.velocity)
        self.torque = max(-self._ceiling, min(self._ceiling, wanted))
        holding = self.mechanics.friction if self._ceiling > 0 else self.mechanics.holding_friction
        self.velocity = self._pushed(self.torque + outside, holding, 0.0)

    def _follow_profile(self) -> None:
        step = self._acceleration * TICK
        error = self._target - self._ahead
        slowing = (math.sqrt(step * step + 8 * self._acceleration * abs(error)) - step) / 2
        wanted = math.copysign(min(self._speed, slowing, abs(error) / TICK), error)
        self._pace += max(-step, min(step, wanted - self._pace))
        # A shaft that is held back holds the profile back too; otherwise it would leap when released.
        low, high = self.position - _WIND_UP, self.position + _WIND_UP
        self._ahead = max(low, min(high, self._ahead + self._pace * TICK))

    def _controlled(self, outside: float) -> None:
        step = self._acceleration * TICK
        velocity = self.velocity
        if self._drive is _POSITION:
            error = self._target - self.position
            distance = abs(error)
            near = distance < _CLOSE and abs(velocity) <= 4 * step
            if near and self._speed > 0 and abs(outside) <= self._ceiling:
                self.position, velocity, self.velocity, wanted = self._target, 0.0, 0.0, 0.0
            else:
                # The highest speed from which the ramp still stops at the target, in whole ticks.
                slowing = (math.sqrt(step * step + 8 * self._acceleration * distance) - step) / 2
                wanted = math.copysign(min(self._speed, slowing, distance / TICK), error)
        else:
            wanted = self._speed
        change = wanted - velocity
        if change > step:
            change = step
        elif change < -step:
            change = -step
        heading = velocity or change
        friction = math.copysign(self.mechanics.friction, heading) if heading else 0.0
        need = change / TICK / self.mechanics.full_acceleration + friction - outside
        if abs(need) <= self._ceiling:
            self.torque = need
            self.velocity = velocity + change
        else:
            self.torque = math.copysign(self._ceiling, need)
            powered = self._ceiling > 0
            holding = self.mechanics.friction if powered else self.mechanics.holding_friction
            self.velocity = self._pushed(self.torque + outside, holding, 0.0 if powered else _COASTING)

    def _pushed(self, push: float, friction: float, drag: float) -> float:
        """Velocity after a tick of a net push against dry friction and a drag in 1/s."""
        velocity = self.velocity
        if velocity == 0.0 and abs(push) <= friction:
            return 0.0
        against = math.copysign(friction, velocity or push)
        full = self.mechanics.full_acceleration
        after = velocity + ((push - against) * full - drag * velocity) * TICK
        if velocity and after * velocity <= 0 and abs(push) <= friction:
            return 0.0
        most = self.mechanics.max_speed
        return max(-most, min(most, after))

    def _move(self) -> None:
        after = self.position + self.velocity * TICK
        low, high = self._obstacle
        stops = self.stops
        if stops is not None:
            low = stops[0] if low is None else max(low, stops[0])
            high = stops[1] if high is None else min(high, stops[1])
        self.blocked = False
        if (low is None or after > low) and (high is None or after < high):
            self.position = after
            return
        for bound, sign in ((low, -1.0), (high, 1.0)):
            # A shaft that presses against the bound counts as blocked too.
            if bound is not None and (after - bound) * sign >= 0 and self.velocity * sign > 0:
                after = bound
                self.blocked = True
                self.velocity = 0.0
                self._press()
        self.position = after

    def _press(self) -> None:
        if self._drive is _POSITION:
            push = (self._target - self.position) * _STIFFNESS
            self.torque = max(-self._ceiling, min(self._ceiling, push))
        elif self._drive is _SPEED:
            self.torque = math.copysign(self._ceiling, self._speed)
