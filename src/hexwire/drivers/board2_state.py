"""A dialect-2 board's JOINT_STATE in SI units: counts by the joints' models, ages, stamps of the host's clock.

Owns this decoding, with a fast path for the usual report, and the relation of the two clocks. Pure. Must not know
sessions.

A frame arrives some time after it was sent: a millisecond later, or seconds if this program was stopped meanwhile
and the frame waited in the port. The frame with the shortest transit time gives the best relation, so the smallest
difference counts, as far as the clocks may have drifted apart since.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import inf
from operator import add, mul, sub

from hexwire.errors import ServoError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointState
from hexwire.wire.command_frame import Frame
from hexwire.wire.commands import AGE_NEVER, JointReport
from hexwire.wire.scaled_report import ReportScaler
from hexwire.wire.tables import BOARD_FLAGS_MAINTENANCE, BOARD_FLAGS_STOPPED, BOARD_FLAGS_WATCHDOG_TRIPPED

__all__ = ["BoardClock", "StateDecoder"]

_DRIFT = 0.01
"""Difference in rate that the clocks may have. Boards with a ceramic resonator are specified to 0.5 %."""
_WAITED = 10.0
"""Longest time that a report waits, seconds, while a later answer is taken before it."""
_AT_ONCE = 1.0
"""Seconds in which all that waited are taken; a board that was reset needs longer to be back."""


class BoardClock:
    """Relates the clock of one board to the host's."""

    def __init__(self) -> None:
        self._clock = self._arrived = math.inf
        self._difference = 0.0

    def sent(self, clock: float, arrived: float) -> float:
        """When a frame was sent, in seconds of the host's clock; at the latest when it arrived.

        Args:
            clock: The board's clock at sending, seconds.
            arrived: The host's clock at arrival, seconds.
        """
        difference = arrived - clock
        if clock > self._clock:
            drift = _DRIFT * max(0.0, arrived - self._arrived)
            self._set(clock, arrived, min(difference, self._difference + drift))
        elif self._waited(clock, arrived):
            # A frame with a shorter transit time than those before also gives a better relation.
            self._difference = min(difference, self._difference)
        else:
            # The board was reset; or it has no clock.
            self._set(clock, arrived, difference)
        return clock + self._difference

    def _waited(self, clock: float, arrived: float) -> bool:
        """Whether a frame that is not newer than the newest one is a report that waited."""
        return (
            self._clock - _WAITED < clock <= self._clock < math.inf
            and clock != 0.0
            and arrived - self._arrived < _AT_ONCE
        )

    def _set(self, clock: float, arrived: float, difference: float) -> None:
        self._clock, self._arrived, self._difference = clock, arrived, difference


_HALF_WRAP = (1 << 31) * 1e-6
_AGE_UNIT = 0.001
_NEVER = _AGE_UNIT * AGE_NEVER


class StateDecoder:
    """Decoder for the states of one board.

    Args:
        model: The arm.
        order: The board's joints in its own order, including every joint of the model; None for a joint that the
            model does not have.
    """

    def __init__(self, model: ArmModel, order: Sequence[JointModel | None]) -> None:
        self._count = len(order)
        self._places = tuple(order.index(joint) for joint in model.joints)
        self._in_order = in_order = self._places == tuple(range(len(order)))
        self._names = model.names
        self._neutral = tuple(j.neutral for j in model.joints)
        self._offset = tuple(j.offset for j in model.joints)
        self._factor = tuple(j.sign * j.scale for j in model.joints)
        # A legacy servo always reports 0 for load, current, voltage and temperature: give NaN, not a false 0.
        told = [math.nan if j.series == "seven_bot" else 1.0 for j in model.joints]
        self._milli = tuple(j.sign * 0.001 * k for j, k in zip(model.joints, told, strict=True))
        self._deci = tuple(0.1 * k for k in told)
        self._told = tuple(told)
        # The fast path for the usual case: the board's joints are the model's, in the same order.
        self._scaler = (
            ReportScaler(
                speed=self._factor,
                load=self._milli,
                voltage=self._deci,
                temperature=self._told,
                current=self._milli,
                age=_AGE_UNIT,
            )
            if in_order and len(order) == len(model.joints)
            else None
        )
        self._nan = (math.nan,) * len(model.joints)
        self._zero_age = (0.0,) * len(model.joints)
        self._age_units = (_AGE_UNIT,) * len(model.joints)
        self._clock = BoardClock()

    def decode(self, body: bytes, frame: Frame, now: float, slow: JointState | None = None) -> JointState:
        """Turn a JOINT_STATE body into SI units.

        Args:
            body: Of a reply or a report.
            frame: Its frame, whose time is the board's clock at sending.
            now: Host clock at arrival.
            slow: Whose voltage, temperature and current it gets.

        Raises:
            ServoError: It has no positions, or not these joints.
        """
        scaled = self._scaler.parse(body) if self._scaler is not None else None
        time_us, flags, columns = scaled or self._scale(JointReport.parse(body))
        position, status, velocity, load, voltage, temperature, current, age = columns
        if _NEVER in age:
            # The row of a servo that was never sampled holds no measurement: give NaN, not a false 0.
            known = [math.nan if a == _NEVER else 1.0 for a in age]
            position, velocity, load, voltage, temperature, current = (
                tuple(map(mul, column, known))
                for column in (position, velocity, load, voltage, temperature, current)
            )
            age = tuple([a if a != _NEVER else inf for a in age])
        since_sample = ((frame.time_sec * 1_000_000 + frame.time_nsec // 1000 - time_us) & 0xFFFFFFFF) * 1e-6
        if since_sample > _HALF_WRAP:
            since_sample = 0.0  # the board rounds the two stamps differently
        newest = min(age)
        if 0.0 < newest < inf:
            # The board counts ages from the time it made this body; the stamp here is that of the newest sample.
            # The frame's time does not serve: a repeated reply is older than its frame.
            age = tuple([a - newest for a in age])
        if slow is not None:
            voltage, temperature, current = slow.voltage, slow.temperature, slow.current
        clock = frame.time_sec + frame.time_nsec * 1e-9
        return JointState(
            names=self._names,
            position=tuple(map(add, map(mul, self._factor, map(sub, position, self._neutral)), self._offset)),
            velocity=velocity,
            load=load,
            current=current,
            voltage=voltage,
            temperature=temperature,
            flags=status,  # type: ignore[arg-type]  # whole numbers: the scaler leaves this column as it is
            age=age,
            # Not by its arrival: it may have waited in the port while this program could not run.
            stamp=self._clock.sent(clock, now) - since_sample,
            board_time=clock - since_sample,
            stopped=flags & BOARD_FLAGS_STOPPED != 0,
            watchdog_tripped=flags & BOARD_FLAGS_WATCHDOG_TRIPPED != 0,
            maintenance=flags & BOARD_FLAGS_MAINTENANCE != 0,
        )

    def _scale(self, report: JointReport) -> tuple[int, int, tuple[tuple[float, ...], ...]]:
        """Scale a report with fewer fields or with joints in another order, as the scaler does."""
        factors = (self._factor, self._milli, self._deci, self._told, self._milli)
        if len(column := report.position) != self._count:
            raise ServoError(
                f"the board reports {len(column)} joints instead of {self._count}: was it changed? attach again"
            )
        position, status, *columns, age = report[2:] if self._in_order else map(self._ordered, report[2:])
        if position is None or status is None:
            raise ServoError("the board reports no positions")
        scaled = [
            self._nan if column is None else tuple(map(mul, column, factor))
            for column, factor in zip(columns, factors, strict=True)
        ]
        ages = self._zero_age if age is None else tuple(map(mul, age, self._age_units))
        return report.time_us, report.board_flags, (position, status, *scaled, ages)

    def _ordered(self, column: tuple[int, ...] | None) -> tuple[int, ...] | None:
        return None if column is None else tuple(column[i] for i in self._places)
