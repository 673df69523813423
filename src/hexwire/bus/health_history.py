"""The health of servos over the last ten minutes: voltage, temperature, current, load, and lost answers.

Owns the samples, in bounded memory, and what is worst of them. Pure: values come in with their time. Must not know
who reads the servos or shows them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from .live_values import LiveValues

__all__ = ["HealthHistory", "HealthRow", "HealthSummary"]


class HealthRow(NamedTuple):
    """One second of one servo. NaN where it did not answer.

    Attributes:
        t: Its last sample, seconds.
        voltage: Lowest supply, volts: a short drop must be seen.
        temperature: Highest, degrees Celsius.
        current: Largest magnitude, amperes.
        load: Largest magnitude, fraction of full load.
        status: All fault bits that were set.
        lost: Answers that are missing.
    """

    t: float
    voltage: float
    temperature: float
    current: float
    load: float
    status: int
    lost: int


class HealthSummary(NamedTuple):
    """What is worst of all samples that are kept; NaN without any.

    Attributes:
        lowest_voltage: Volts.
        highest_voltage: Volts; of the lowest in each second.
        hottest: Degrees Celsius.
        most_current: Amperes.
        most_load: Fraction of full load.
        status: All fault bits that were set.
        lost: Answers that are missing.
        asked: Answers that were asked for, since the servo is watched.
    """

    lowest_voltage: float
    highest_voltage: float
    hottest: float
    most_current: float
    most_load: float
    status: int
    lost: int
    asked: int


class HealthHistory:
    """Samples of any number of servos.

    Args:
        seconds: How long they are kept.
        period: Seconds that become one row, however often the servos are read.
        most: Number of servos that are kept; further ones are ignored.
    """

    def __init__(self, *, seconds: float = 600.0, period: float = 1.0, most: int = 64) -> None:
        self._period, self._most = period, most
        self._kept = math.ceil(seconds / period)
        self._rows: dict[int, deque[HealthRow]] = {}
        self._now: dict[int, HealthRow] = {}
        self._second: dict[int, int] = {}
        self._asked: dict[int, int] = {}

    @property
    def servo_ids(self) -> tuple[int, ...]:
        """The servos of which there are samples."""
        return tuple(self._rows)

    def add(self, now: float, values: Sequence[LiveValues]) -> None:
        """Add what servos measured at a time, seconds."""
        for row in values:
            servo_id = row.servo_id
            if servo_id not in self._rows:
                if len(self._rows) >= self._most:
                    continue
                self._rows[servo_id] = deque(maxlen=self._kept)
                self._asked[servo_id] = 0
            self._asked[servo_id] += 1
            fresh, second = _row(now, row), math.floor(now / self._period)
            former = self._now.get(servo_id)
            if former is not None and self._second[servo_id] == second:
                self._now[servo_id] = _merged(former, fresh)
                continue
            if former is not None:
                self._rows[servo_id].append(former)
            self._now[servo_id], self._second[servo_id] = fresh, second

    def rows(self, servo_id: int, since: float = -math.inf) -> list[HealthRow]:
        """The rows of a servo after a time, oldest first, without that of the present second."""
        return [row for row in self._rows.get(servo_id, ()) if row.t > since]

    def summary(self, servo_id: int) -> HealthSummary:
        """What is worst of the rows of a servo, the present second included."""
        rows = [*self._rows.get(servo_id, ())]
        if servo_id in self._now:
            rows.append(self._now[servo_id])
        status = 0
        for row in rows:
            status |= row.status
        return HealthSummary(
            _least([row.voltage for row in rows]),
            _most([row.voltage for row in rows]),
            _most([row.temperature for row in rows]),
            _most([row.current for row in rows]),
            _most([row.load for row in rows]),
            status,
            sum(row.lost for row in rows),
            self._asked.get(servo_id, 0),
        )

    def forget(self, servo_id: int) -> None:
        """Forget a servo, such as one with a new id."""
        for kept in (self._rows, self._now, self._second, self._asked):
            kept.pop(servo_id, None)


def _row(now: float, row: LiveValues) -> HealthRow:
    current, load = abs(row.current), abs(row.load)
    return HealthRow(now, row.voltage, row.temperature, current, load, row.status, int(bool(row.error)))


def _merged(one: HealthRow, other: HealthRow) -> HealthRow:
    return HealthRow(
        other.t,
        _least([one.voltage, other.voltage]),
        _most([one.temperature, other.temperature]),
        _most([one.current, other.current]),
        _most([one.load, other.load]),
        one.status | other.status,
        one.lost + other.lost,
    )


def _least(values: Sequence[float]) -> float:
    return min((value for value in values if not math.isnan(value)), default=math.nan)


def _most(values: Sequence[float]) -> float:
    return max((value for value in values if not math.isnan(value)), default=math.nan)
