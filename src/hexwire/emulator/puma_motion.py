"""How the emulated PUMA 260 moves: paths through waypoints, and the control law of JointCommands.

Owns curves and one joint's physics, as far as an emulator needs them. Knows no commands, no frames, no clock.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.model.control_law import ControlLaw
from hexwire.wire.robot_bodies import LAW_ARRAYS, JointCommands, TrajectoryPoints

__all__ = ["Gains", "Path", "gains_of"]

INERTIA = 0.05
"""kg m^2 of every joint: the order of magnitude of a small arm, not measured."""
FRICTION = 0.05
"""N m s/rad of every joint, not measured either."""
_ACTING = ("effort", "kp_position", "ki_position", "kd_position", "kp_velocity")


class Path:
    """A cubic curve through waypoints, from the joints' present position and velocity.

    The speed at a waypoint is the one given, else the mean of its two sides; at the end the joints are at rest.

    Args:
        trajectory: The waypoints.
        origin: Present positions, radians; the path starts there unless the first waypoint is at time 0.
        velocity: Present velocities, rad/s.
    """

    def __init__(self, trajectory: TrajectoryPoints, origin: Sequence[float], velocity: Sequence[float]) -> None:
        self._times = list(trajectory.times)
        self._points = list(trajectory.positions)
        self._given = list(trajectory.velocities)
        self._start = tuple(velocity)
        if self._times[0] > 0.0:
            self._times.insert(0, 0.0)
            self._points.insert(0, tuple(origin))
            if self._given:
                self._given.insert(0, self._start)
        self.duration = self._times[-1]

    def at(self, t: float) -> tuple[float, ...]:
        """Positions `t` seconds after the start, radians."""
        times, points = self._times, self._points
        if t >= self.duration:
            return points[-1]
        if t <= times[0]:
            return points[0]
        k = bisect_right(times, t) - 1
        span = times[k + 1] - times[k]
        u = (t - times[k]) / span
        start, end = self._slopes(k), self._slopes(k + 1)
        # Hermite's polynomials.
        a, b = 2 * u**3 - 3 * u**2 + 1, 3 * u**2 - 2 * u**3
        c, d = span * (u**3 - 2 * u**2 + u), span * (u**3 - u**2)
        rows = zip(points[k], points[k + 1], start, end, strict=True)
        return tuple(a * p + b * q + c * v + d * w for p, q, v, w in rows)

    def _slopes(self, k: int) -> tuple[float, ...]:
        if self._given:
            return self._given[k]
        if k == 0:
            return self._start
        if k == len(self._times) - 1:
            return (0.0,) * len(self._start)
        span = self._times[k + 1] - self._times[k - 1]
        slopes = []
        for before, here, after in zip(self._points[k - 1], self._points[k], self._points[k + 1], strict=True):
            # A turning point is passed at rest, so that no joint overshoots its waypoint.
            slopes.append(0.0 if (here - before) * (after - here) <= 0 else (after - before) / span)
        return tuple(slopes)


@dataclass(slots=True)
class Gains:
    """One joint under a control law, in place of the controller's own loop."""

    law: ControlLaw
    integral: float = 0.0

    def torque(self, error: float, velocity: float, tick: float) -> float:
        """Torque of the drive, newton metres; `error` in radians, speeds in rad/s."""
        law = self.law
        self.integral += error * tick
        by_integral = law.ki_position * self.integral
        held = max(law.i_effort_min, min(law.i_effort_max, by_integral))
        if held != by_integral and law.ki_position:
            # Anti-windup: the integral does not grow beyond its limit.
            self.integral = held / law.ki_position
        return (
            law.effort
            + law.kp_position * error
            + held
            - law.kd_position * velocity
            + law.kp_velocity * (law.velocity - velocity)
        )

    def acceleration(self, error: float, velocity: float, tick: float) -> float:
        """The resulting acceleration, rad/s^2."""
        return (self.torque(error, velocity, tick) - FRICTION * velocity) / INERTIA


def gains_of(commands: JointCommands, i: int) -> Gains | None:
    """The control law for the i-th joint of `commands`; None if they give neither an effort nor a gain."""
    if not any(getattr(commands, array) for array in _ACTING):
        return None
    return Gains(ControlLaw(**{array: values[i] for array in LAW_ARRAYS if (values := getattr(commands, array))}))
