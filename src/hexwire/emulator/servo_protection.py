"""How an emulated servo protects itself: overload, overcurrent, heat, supply voltage.

Owns the status bits and the timers behind them, and the winding temperature. Time comes in whole ticks of the
motion model. Sums over ticks use whole numbers, so that a thousand ticks at rest taken at once give the same
result.
"""

from __future__ import annotations

from dataclasses import dataclass

from hexwire.wire.tables import STATUS_BITS

__all__ = ["Protection", "ProtectionLimits"]

VOLTAGE = STATUS_BITS["voltage"]
TEMPERATURE = STATUS_BITS["temperature"]
CURRENT = STATUS_BITS["current"]
OVERLOAD = STATUS_BITS["overload"]

THERMAL_TICKS = 1000  # the temperature is updated once a second
_THERMAL_SECONDS = 300.0  # time constant of the case
_STALL_RISE = 120.0  # degrees above ambient that a stalled servo would reach
_NEVER = 1 << 62


@dataclass(frozen=True, slots=True)
class ProtectionLimits:
    """Limits from the registers. Torques are fractions of the stall torque, times are in ticks.

    Attributes:
        switch: Mask of the faults that take torque away; the others are only reported.
    """

    overload_torque: float
    overload_ticks: int
    current: float
    current_ticks: int
    held_torque: float
    temperature: float
    voltage: tuple[float, float]
    switch: int


class Protection:
    """Status bits of one servo.

    Attributes:
        status: The error byte.
        temperature: Winding temperature, deg C.
        ambient: Air temperature, deg C; may be set.
    """

    def __init__(self, limits: ProtectionLimits, temperature: float) -> None:
        self.limits = limits
        self.status = 0
        self.forced = 0
        self.temperature = temperature
        self.ambient = temperature
        self._overload = 0
        self._current = 0
        self._heat = 0

    @property
    def ceiling(self) -> float:
        """Highest torque the motor may give, 0..1."""
        acting = self.status & self.limits.switch
        if acting & (VOLTAGE | TEMPERATURE):
            return 0.0
        if acting & (OVERLOAD | CURRENT):
            return self.limits.held_torque
        return 1.0

    def clear(self) -> None:
        """End an overload or overcurrent: its torque was switched off, or a goal presses no further."""
        self.status &= ~(OVERLOAD | CURRENT)
        self._overload = self._current = 0

    def horizon(self, tick: int, torque: float, current: float) -> int:
        """Ticks that may be advanced at once, at constant torque and current, before the status can change."""
        limits = self.limits
        until = THERMAL_TICKS - tick % THERMAL_TICKS
        if torque >= limits.overload_torque and not self.status & OVERLOAD:
            until = min(until, limits.overload_ticks - self._overload)
        if current > limits.current and not self.status & CURRENT:
            until = min(until, limits.current_ticks - self._current)
        return max(until, 1)

    def advance(self, tick: int, count: int, torque: float, current: float, volts: float) -> bool:
        """Let `count` ticks pass at a constant load.

        Args:
            tick: Ticks since 0 before these.
            count: Number of ticks, at most `horizon`.
            torque: Magnitude of the motor's torque, 0..1.
            current: Magnitude of its current, A.
            volts: Supply voltage.

        Returns:
            Whether the status changed.
        """
        limits = self.limits
        before = self.status
        if torque >= limits.overload_torque:
            self._overload += count
            if self._overload >= limits.overload_ticks:
                self.status |= OVERLOAD
        else:
            self._overload = 0
        if current > limits.current:
            self._current += count
            if self._current >= limits.current_ticks:
                self.status |= CURRENT
        else:
            self._current = 0
        self._heat += count * int(torque * 1000) ** 2
        if (tick + count) % THERMAL_TICKS == 0:
            self._warm()
        low, high = limits.voltage
        # A moving servo comes here each tick, and most of them have nothing to report.
        if self.status or self.forced or not low <= volts <= high or self.temperature > limits.temperature:
            self.sense(volts)
        return self.status != before

    def sense(self, volts: float) -> None:
        """Update the status bits of temperature and supply."""
        low, high = self.limits.voltage
        status = self.status & ~(VOLTAGE | TEMPERATURE)
        if not low <= volts <= high:
            status |= VOLTAGE
        if self.temperature > self.limits.temperature:
            status |= TEMPERATURE
        self.status = status | self.forced

    def _warm(self) -> None:
        square = self._heat / (1_000_000 * THERMAL_TICKS)
        self._heat = 0
        goal = self.ambient + _STALL_RISE * square
        self.temperature += (goal - self.temperature) * (THERMAL_TICKS / 1000 / _THERMAL_SECONDS)


NO_LIMITS = ProtectionLimits(
    overload_torque=2.0,
    overload_ticks=_NEVER,
    current=1e9,
    current_ticks=_NEVER,
    held_torque=1.0,
    temperature=1e9,
    voltage=(-1.0, 1e9),
    switch=0,
)
"""For servos that protect themselves without reporting it, or not at all."""
