"""Results of a servo bus: values with status, age and error.

Owns the result types. A silent or faulty servo is data, not an exception; `check` raises instead. No I/O.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Self

from hexwire.errors import ServoError, UsageError
from hexwire.wire.registers import Register
from hexwire.wire.tables import STATUS_BITS

__all__ = ["Answer", "Reading", "Readings", "ServoBlock", "fault_text", "fault_words", "instead_in", "why"]

SILENT = "no answer"


def why(instead: str) -> str:
    """Say why there is no answer, for an error text.

    Args:
        instead: In words what arrived instead; empty if nothing arrived.
    """
    return f"{SILENT}, but {instead}" if instead else SILENT


def instead_in(error: str) -> str:
    """What arrived instead, of an error of which `why` is the text; empty if nothing arrived."""
    return error.removeprefix(why("")).removeprefix(", but ") if error.startswith(SILENT) else ""


def fault_words(status: int) -> tuple[str, ...]:
    """Names of the bits in a status byte: voltage, encoder, temperature, current, overload."""
    words = [name for name, bit in STATUS_BITS.items() if status & bit]
    rest = status & ~sum(STATUS_BITS.values())
    return (*words, f"bits {rest:#04x}") if rest else tuple(words)


_ADVICE = {
    "voltage": "supply outside its limits: check the supply and the servo's voltage",
    "encoder": "position sensor: power it off and on, then replace it",
    "temperature": "too hot: let it cool down",
    "current": "too much current: free the joint",
    "overload": "free the joint, then `hexwire bus recover`",
}


def fault_text(servo_id: int, status: int, what: str) -> str:
    """Make one line for display: servo, operation, fault, advice."""
    words = fault_words(status)
    advice = next((_ADVICE[word] for word in reversed(words) if word in _ADVICE), "read its register status")
    return f"servo {servo_id} reports {', '.join(words)} at {what} ({advice})"


def _silent_text(servo_id: int, what: str, error: str) -> str:
    return f"servo {servo_id}: {error} to {what} (check cable, power, id and line rate)"


class Answer(NamedTuple):
    """Outcome of a request to a servo.

    Attributes:
        servo_id: Id of the servo.
        what: The request, for display.
        status: Its error byte; 0 without faults.
        error: Why there is no answer; empty if there is one, or none is expected.
        confirmed: The servo acknowledged. A legacy servo, or one with status_return_level 0, never does.
    """

    servo_id: int
    what: str
    status: int = 0
    error: str = ""
    confirmed: bool = True

    @property
    def ok(self) -> bool:
        """Whether there is neither a fault nor an error."""
        return not self.status and not self.error

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the servo's faults."""
        return fault_words(self.status)

    def check(self) -> Answer:
        """Return this answer if it is ok.

        Raises:
            ServoError: The servo is silent or reports a fault.
        """
        _check(self.servo_id, self.status, self.error, self.what)
        return self


class Reading(NamedTuple):
    """One register of one servo.

    Attributes:
        servo_id: Id of the servo.
        register: The register.
        raw: Signed raw value; None if the servo did not answer.
        status: Its error byte; 0 without faults.
        age: Seconds since `last` was sampled; 0.0 for a new value, infinite if there never was one.
        error: Why there is no value; empty if there is one.
        last: The newest raw value read, or None.
    """

    servo_id: int
    register: Register
    raw: int | None
    status: int = 0
    age: float = 0.0
    error: str = ""
    last: int | None = None

    @property
    def value(self) -> float:
        """Value in the register's SI unit; NaN if the servo did not answer."""
        return math.nan if self.raw is None else self.register.to_si(self.raw)

    @property
    def ok(self) -> bool:
        """Whether there is a value, and the servo reports no fault."""
        return not self.status and not self.error

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the servo's faults."""
        return fault_words(self.status)

    def check(self) -> Reading:
        """Return this reading if it is ok.

        Raises:
            ServoError: The servo is silent or reports a fault.
        """
        _check(self.servo_id, self.status, self.error, self.register.name)
        return self


def _check(servo_id: int, status: int, error: str, what: str) -> None:
    if error:
        raise ServoError(_silent_text(servo_id, what, error), servo_id=servo_id, status=status)
    if status:
        raise ServoError(fault_text(servo_id, status, what), servo_id=servo_id, status=status)


class Readings:
    """The same register of several servos, read at once. Iteration gives one `Reading` per servo.

    A `Reading` is made only on access: a control loop uses `raw` or `values`.

    Attributes:
        ids: Servo ids, in the order of the request.
        raw: Raw value of each servo; None if it did not answer.
        stamp: Time (monotonic, seconds) at which the answers were complete.
    """

    __slots__ = ("_errors", "_last", "_registers", "_statuses", "ids", "raw", "stamp")

    def __init__(
        self,
        registers: Register | Sequence[Register],
        ids: tuple[int, ...],
        raw: tuple[int | None, ...],
        stamp: float,
        statuses: Mapping[int, int] | None = None,
        last: Mapping[int, tuple[int, float]] | None = None,
        errors: Mapping[int, str] | None = None,
    ) -> None:
        self._registers = registers
        self.ids = ids
        self.raw = raw
        self.stamp = stamp
        self._statuses = statuses
        self._last = last
        self._errors = errors

    @classmethod
    def joined(cls, rows: Sequence[Reading], now: float) -> Self:
        """Join single readings to one result.

        Args:
            rows: One reading per servo.
            now: Time (monotonic, seconds) of the last of them.
        """
        return cls(
            [row.register for row in rows],
            tuple(row.servo_id for row in rows),
            tuple(row.raw for row in rows),
            now,
            {row.servo_id: row.status for row in rows if row.status},
            {row.servo_id: (row.last, now - row.age) for row in rows if row.last is not None},
            {row.servo_id: row.error for row in rows if row.error},
        )

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Reading]:
        return (self._reading(i) for i in range(len(self.ids)))

    def __getitem__(self, servo_id: int) -> Reading:
        """Return the reading of one servo.

        Raises:
            UsageError: The request did not include that servo.
        """
        if servo_id not in self.ids:
            raise UsageError(
                f"no reading of servo {servo_id}; there are readings of {', '.join(map(str, self.ids))}"
            )
        return self._reading(self.ids.index(servo_id))

    def __repr__(self) -> str:
        return f"<Readings {dict(zip(self.ids, self.raw, strict=True))}>"

    @property
    def values(self) -> tuple[float, ...]:
        """SI value of each servo; NaN if it did not answer."""
        return tuple(reading.value for reading in self)

    @property
    def missing(self) -> tuple[int, ...]:
        """Ids of the servos that did not answer."""
        return tuple(i for i, raw in zip(self.ids, self.raw, strict=True) if raw is None)

    @property
    def ok(self) -> bool:
        """Whether all servos answered, and none reports a fault."""
        return not self._statuses and None not in self.raw

    def check(self) -> Readings:
        """Return these readings if they are ok.

        Raises:
            ServoError: A servo is silent or reports a fault; the text names the first.
        """
        for reading in self:
            reading.check()
        return self

    def _reading(self, i: int) -> Reading:
        servo_id, raw = self.ids[i], self.raw[i]
        register = self._registers if isinstance(self._registers, Register) else self._registers[i]
        status = self._statuses.get(servo_id, 0) if self._statuses else 0
        if raw is not None:
            return Reading(servo_id, register, raw, status, 0.0, "", raw)
        last = self._last.get(servo_id) if self._last else None
        error = self._errors.get(servo_id, SILENT) if self._errors else SILENT
        if last is None:
            return Reading(servo_id, register, None, status, math.inf, error)
        return Reading(servo_id, register, None, status, self.stamp - last[1], error, last[0])


class ServoBlock(NamedTuple):
    """Neighbouring registers of one servo, read at once.

    Attributes:
        servo_id: Id of the servo.
        address: Address of the first byte.
        data: The bytes; empty if the servo did not answer.
        status: Its error byte.
        error: Why there is no data; empty if there is some.
    """

    servo_id: int
    address: int
    data: bytes
    status: int = 0
    error: str = ""

    def raw(self, register: Register) -> int | None:
        """Return the raw value of a register; None without an answer, or if the block does not contain it."""
        at = register.address - self.address
        data = self.data[at : at + register.size] if at >= 0 else b""
        return register.decode(data) if len(data) == register.size else None

    def value(self, register: Register) -> float:
        """Return the SI value of a register; NaN without one."""
        raw = self.raw(register)
        return math.nan if raw is None else register.to_si(raw)

    def check(self) -> ServoBlock:
        """Return this block if it is ok.

        Raises:
            ServoError: The servo is silent or reports a fault.
        """
        _check(self.servo_id, self.status, self.error, f"a read of registers from {self.address}")
        return self
