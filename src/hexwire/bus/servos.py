"""Known facts of the servos on a bus: series, return delay, acknowledgement of writes.

Owns these facts and nothing else. No I/O, no time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hexwire.errors import UsageError
from hexwire.wire.registers import Series

from .timing import RETURN_DELAY

__all__ = ["KnownServos", "as_series"]

_ENDS = {series: max(r.address + r.size for r in series.registers.values()) for series in Series}


def as_series(series: Series | str) -> Series:
    """Return the series with a name.

    Raises:
        UsageError: There is no such series; the text lists them.
    """
    try:
        return Series(series)
    except ValueError:
        known = ", ".join(kind.value for kind in Series)
        raise UsageError(f"no servo series {series!r}; there are {known} (sts and sms are sts_sms)") from None


class KnownServos:
    """The servos on one bus.

    Args:
        default: Series of a servo that `series` does not name.
        series: Series of single servos by id.

    Attributes:
        default: See above.
        confirmed_writes: Ids of servos that have acknowledged a write.
    """

    def __init__(self, default: Series | str, series: Mapping[int, Series | str] | None = None) -> None:
        self.default = as_series(default)
        self.confirmed_writes: set[int] = set()
        self._series = {servo_id: as_series(kind) for servo_id, kind in (series or {}).items()}
        self._silent_writes: set[int] = set()
        self._return_delays: dict[int, float] = {}

    def series_of(self, servo_id: int) -> Series:
        """Series of a servo."""
        return self._series.get(servo_id, self.default)

    def set_series(self, servo_id: int, series: Series | str) -> None:
        """Set the series of a servo.

        Raises:
            UsageError: There is no such series.
        """
        self._series[servo_id] = as_series(series)

    def set_return_delay(self, servo_id: int, seconds: float) -> None:
        """Set how long a servo waits before it answers, seconds."""
        self._return_delays[servo_id] = seconds

    def return_delays(self, servo_ids: Iterable[int]) -> float:
        """Sum of the return delays of some servos, seconds."""
        return sum(self._return_delays.get(servo_id, RETURN_DELAY) for servo_id in servo_ids)

    def set_acknowledges(self, servo_id: int, acknowledges: bool) -> None:
        """Set whether a servo acknowledges writes (status_return_level 1)."""
        (self._silent_writes.discard if acknowledges else self._silent_writes.add)(servo_id)

    def acknowledges(self, servo_id: int) -> bool:
        """Whether a servo acknowledges writes, as far as known."""
        return servo_id not in self._silent_writes and self.series_of(servo_id) is not Series.SEVEN_BOT

    def end_of(self, servo_id: int) -> int:
        """Address after the last register of a servo."""
        return _ENDS[self.series_of(servo_id)]
