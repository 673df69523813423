"""Prepared requests to servos, a fast check of their answers, and the store of those that a bus has made.

Owns the fast path of a servo bus: the bytes of a request are built once, and the answers of a healthy bus are
verified by comparing and adding whole blocks. Anything unusual, such as a fault bit, an echo or noise, gives None,
and the caller takes the careful path (`servo_answers`). No I/O, no clock.

Every byte of every answer is still verified: headers, ids and lengths by one masked comparison, the checksum of
each packet by adding its bytes in 16-bit lanes of one big integer. For seven two-byte answers that takes 1 us
instead of 3 us packet by packet.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import ClassVar, Literal

from hexwire.errors import UsageError
from hexwire.wire.registers import Register, Series
from hexwire.wire.servo_packet import make_read, make_sync_read, make_write, sync_write_packer

from .servos import KnownServos
from .timing import LineTiming

__all__ = ["LEGACY_READ", "PlanCache", "ReadPlan", "SyncReadPlan", "SyncWritePlan", "WritePlan", "writable"]

_LANES_OF_A_PACKET = 0x0001_0001_0001_0001
"""Factor that makes each 16-bit lane the sum of itself and the three lanes below it."""
LEGACY_READ = 2
"""Bytes in a legacy servo's answer to any read."""
_MOST_PLANS = 512


def _sound_sum(header: bytes) -> int:
    """Return the low byte of the sum of a valid packet: the header, and FF for the rest."""
    return (sum(header) + 0xFF) & 0xFF


class ReadPlan:
    """One READ to one servo.

    Args:
        servo_id: The servo.
        series: Its series.
        address: First register address.
        count: Bytes to read.
        register: The register at that address, whose value is wanted.

    Attributes:
        ids: The servo's id, alone.
        request: Bytes to send.
        length: Bytes of the answer.
        total: Bytes of both.
        base: Seconds that the answer takes without the adapter's allowance; set by the user of the plan.
        latest: Newest raw value, None without one; set by the user of the plan.
        stamp: Time of that value.
        allowance: Seconds allowed for the adapter; set by the user of the plan.
        rest: None: an answer in several pieces takes the careful path.
    """

    __slots__ = (
        "_end",
        "_head",
        "_order",
        "_positive",
        "_sum",
        "address",
        "allowance",
        "base",
        "count",
        "ids",
        "latest",
        "length",
        "register",
        "request",
        "series",
        "servo_id",
        "stamp",
        "total",
    )

    rest: ClassVar[None] = None

    def __init__(self, servo_id: int, series: Series, address: int, count: int, register: Register) -> None:
        self.servo_id = servo_id
        self.ids = (servo_id,)
        self.series = series
        self.address = address
        self.count = count
        self.register = register
        self._end = 5 + register.size
        self._order: Literal["big", "little"] = "big" if series.byte_order == "big" else "little"
        self._positive = 0xFFFF if register.sign_bit is None else (1 << register.sign_bit) - 1
        self.request = make_read(servo_id, address, count)
        self.length = 6 + count
        self.total = len(self.request) + self.length
        # The comparison includes the error byte: a servo with a fault takes the careful path.
        self._head = series.reply_header + bytes((servo_id, count + 2, 0))
        self._sum = _sound_sum(series.reply_header)
        self.base = self.allowance = 0.0
        self.latest: int | None = None
        self.stamp = 0.0

    def value(self, data: bytes) -> int | None:
        """Return the register's raw value if `data` is exactly one valid answer without an error, else None."""
        if (
            len(data) == self.length
            and data[:5] == self._head
            and sum(data) & 0xFF == self._sum
            and data != self.request
        ):
            raw = int.from_bytes(data[5 : self._end], self._order)
            if raw <= self._positive:
                return raw
            return self.register.decode(data[5 : self._end])
        return None


class WritePlan:
    """One acknowledged write to one servo.

    Args:
        servo_id: The servo.
        series: Its series.
        address: First register address.
        data: Register bytes.
        request: The packet, if it is not a plain WRITE.
    """

    __slots__ = (
        "acknowledgement",
        "address",
        "base",
        "data",
        "length",
        "request",
        "series",
        "servo_id",
        "total",
    )

    def __init__(
        self, servo_id: int, series: Series, address: int, data: bytes, request: bytes | None = None
    ) -> None:
        self.servo_id = servo_id
        self.series = series
        self.address = address
        # Bytes that can be read back; none for other packets than a plain write.
        self.data = data if request is None else b""
        self.request = make_write(servo_id, address, data) if request is None else request
        self.acknowledgement = series.reply_header + bytes((servo_id, 2, 0, ~(servo_id + 2) & 0xFF))
        self.length = 6
        self.total = len(self.request) + 6
        self.base = 0.0


class SyncReadPlan:
    """One SYNC_READ of the same registers of several servos.

    Args:
        series: Series of all the servos.
        ids: Ids of the servos, in this order.
        address: First register address.
        count: Bytes from each servo.
        register: The register, if it is a single one whose values `glance` can decode.

    Attributes:
        request: Bytes to send.
        length: Bytes of all answers.
        extra: Number of answers beyond one.
        total: Bytes of both.
        base: Seconds that the answers take without the adapter's allowance; set by the user of the plan.
        allowance: Seconds allowed for the adapter; set by the user of the plan.
    """

    __slots__ = (
        "_heads",
        "_last",
        "_masks",
        "_values",
        "address",
        "allowance",
        "base",
        "count",
        "extra",
        "ids",
        "length",
        "register",
        "request",
        "series",
        "size",
        "total",
    )

    def __init__(
        self, series: Series, ids: Sequence[int], address: int, count: int, register: Register | None = None
    ) -> None:
        self.series = series
        self.ids = tuple(ids)
        self.address = address
        self.count = count
        self.register = register
        self.request = make_sync_read(address, count, ids)
        self.size = size = 6 + count
        n = len(self.ids)
        self.length = n * size
        self.extra = n - 1
        self.total = len(self.request) + self.length
        self.base = self.allowance = 0.0
        header = series.reply_header
        self._heads = tuple(header + bytes((servo_id, count + 2, 0)) for servo_id in self.ids)
        self._last = self._heads[-1][:4]
        self._masks: tuple[int, int, int, int, int] | None = None
        self._values: Struct | None = None
        if register is not None and register.size == count == 2:
            # One big little-endian integer that holds the packets one after the other.
            def lanes(packet: bytes) -> int:
                return int.from_bytes(packet * n, "little")

            sign = 0 if register.sign_bit is None else 1 << register.sign_bit
            # No bit above the sign bit may be set: those bits have no meaning.
            above = 0 if register.sign_bit is None else 0xFFFF & ~(sign - 1)
            odd = above.to_bytes(2, "little" if register.byte_order == "little" else "big")
            self._masks = (
                lanes(b"\xff\xff\xff\xff\xff" + odd + b"\0"),
                int.from_bytes(b"".join(head + b"\0\0\0" for head in self._heads), "little"),
                lanes(b"\xff\0\xff\0\xff\0\xff\0"),
                lanes(b"\0\0\0\0\0\0\xff\0"),
                lanes(bytes((0, 0, 0, 0, 0, 0, _sound_sum(header), 0))),
            )
            self._values = Struct((">" if register.byte_order == "big" else "<") + "5xHx" * n)

    def glance(self, data: bytes) -> tuple[int, ...] | None:
        """Return raw values in the order of `ids` if `data` is exactly their valid answers, else None.

        Also returns None if a servo reports an error, or a value has its sign bit set.
        """
        masks = self._masks
        if masks is None or len(data) != self.length:
            return None
        mask, heads, bytes_mask, sum_mask, whole = masks
        number = int.from_bytes(data, "little")
        if number & mask != heads:
            return None
        # Pairs of bytes, then the sum of each lane and the three below it: the top lane of each packet ends with
        # the sum of all eight bytes, at most 2040, so no lane overflows into the next.
        lanes = (number & bytes_mask) + (number >> 8 & bytes_mask)
        if lanes * _LANES_OF_A_PACKET & sum_mask != whole:
            return None
        return self._values.unpack(data)  # type: ignore[union-attr]  # made together with the masks

    def blocks(self, data: bytes) -> list[bytes] | None:
        """Return the register bytes of each servo, in the order of `ids`; None under the conditions of `glance`."""
        if len(data) != self.length:
            return None
        size, rows, at = self.size, [], 0
        for head in self._heads:
            packet = data[at : at + size]
            if packet[:5] != head or sum(packet[2:]) & 0xFF != 0xFF:
                return None
            rows.append(packet[5:-1])
            at += size
        return rows

    def rest(self, data: bytes) -> float:
        """Return the seconds to wait for the answers missing after `data`; 0.0 if no more can arrive."""
        missing = self.length - len(data)
        if missing <= 0:
            return 0.0
        at = len(data) - self.size
        if at >= 0 and data.startswith(self._last, at) and sum(data[at + 2 :]) & 0xFF == 0xFF:
            return 0.0  # servos answer in order, and this is the last
        return missing * self.base / self.length + self.allowance


class SyncWritePlan:
    """SYNC_WRITE of one two-byte register of several servos, with new values each time.

    Args:
        register: The register, two bytes wide.
        ids: Ids of the servos.

    Attributes:
        least: Lowest raw value accepted.
        most: Highest raw value accepted.
    """

    __slots__ = ("_making", "ids", "least", "most", "register")

    def __init__(self, register: Register, ids: Sequence[int]) -> None:
        if register.size != 2:
            raise UsageError(f"{register.name} has 1 byte; a sync write plan is for 2")
        self.register = register
        self.ids = tuple(ids)
        self.least = register.fits[0] if register.minimum is None else register.minimum
        self.most = register.fits[-1] if register.maximum is None else register.maximum
        order = ">" if register.byte_order == "big" else "<"
        fields = [one for servo_id in self.ids for one in (servo_id, 0)]
        pack = sync_write_packer(register.address, f"{order}BH", len(self.ids))
        # One lookup instead of five: the line is idle while a packet is made.
        self._making = max(0, self.least), self.most, fields, pack

    def serialize(self, values: Sequence[int]) -> bytes:
        """Make the packet for one raw value per servo, in the order of `ids`.

        Raises:
            UsageError: A value is outside the register's range.
        """
        low, high, fields, pack = self._making
        for value in values:
            if not low <= value <= high:
                values = self._signed(values)
                break
        fields = fields.copy()
        fields[1::2] = values
        return pack(*fields)

    def _signed(self, values: Sequence[int]) -> Sequence[int]:
        """Return the values with their sign as a bit; refuse a value outside the range."""
        low, high = self.least, self.most
        for servo_id, value in zip(self.ids, values, strict=True):
            if not low <= value <= high:
                raise UsageError(
                    f"{self.register.name} of servo {servo_id} takes {low}..{high}, not {value}; nothing was sent"
                )
        sign = 0 if self.register.sign_bit is None else 1 << self.register.sign_bit
        return [value if value >= 0 else -value | sign for value in values]


def writable(series: Series, servo_id: int, name: str) -> Register:
    """Return a register that may be written.

    Raises:
        UsageError: The series has no such register, or it is read-only.
    """
    register = series.register(name)
    if register.access != "rw":
        raise UsageError(f"register {name} of servo {servo_id} is read-only")
    return register


class PlanCache:
    """Plans of one bus, for the present line rate and return delays.

    Args:
        servos: Known facts of the servos.
        timing: Transmission times; replaced by `clear` when the rate changes.

    Attributes:
        reads: Plan and register of a single read, by servo and register name.
        syncs: Plan of a sync read, by register name and ids; None if single reads are needed.
        sync_writes: Plan of a sync write, by register name and ids.
        newest_sync: Newest plan of a sync read, by register name: a control loop repeats one.
        newest_write: The same of a sync write.
    """

    def __init__(self, servos: KnownServos, timing: LineTiming) -> None:
        self.reads: dict[tuple[int, str], tuple[ReadPlan, Register]] = {}
        self.syncs: dict[tuple[str, tuple[int, ...]], SyncReadPlan | None] = {}
        self.sync_writes: dict[tuple[str, tuple[int, ...]], SyncWritePlan] = {}
        self.newest_sync: dict[str, SyncReadPlan] = {}
        self.newest_write: dict[str, SyncWritePlan] = {}
        self._blocks: dict[tuple[int, int, tuple[int, ...]], SyncReadPlan] = {}
        self._servos = servos
        self._timing = timing

    def clear(self, timing: LineTiming) -> None:
        """Drop all plans: the rate, a series or a return delay has changed."""
        self._timing = timing
        self.reads.clear()
        self.syncs.clear()
        self.sync_writes.clear()
        self.newest_sync.clear()
        self.newest_write.clear()
        self._blocks.clear()

    def read(self, servo_id: int, name: str) -> tuple[ReadPlan, Register]:
        """Make the plan of a single read.

        Raises:
            UsageError: The servo's series has no such register.
        """
        series = self._servos.series_of(servo_id)
        register = series.register(name)
        count = LEGACY_READ if series is Series.SEVEN_BOT else register.size
        plan = ReadPlan(servo_id, series, register.address, count, register)
        plan.base = self._base(plan.total, (servo_id,))
        entry = self.reads[servo_id, name] = (plan, register)
        return entry

    def sync(self, name: str, ids: tuple[int, ...]) -> SyncReadPlan | None:
        """Return the plan of a sync read of servos of one series; None if they need single reads.

        Raises:
            UsageError: No servo is named, or a series has no such register.
        """
        if not ids:
            raise UsageError("a sync read needs at least one servo id")
        key = (name, ids)
        if key in self.syncs:
            return self.syncs[key]
        kinds = {self._servos.series_of(servo_id) for servo_id in ids}
        registers = [self._servos.series_of(servo_id).register(name) for servo_id in ids]
        plan = None
        if len(kinds) == 1 and all(kind.sync_read for kind in kinds):
            plan = SyncReadPlan(kinds.pop(), ids, registers[0].address, registers[0].size, registers[0])
            plan.base = self._base(plan.total, ids)
        self.syncs[key] = plan
        return plan

    def block(self, address: int, count: int, ids: tuple[int, ...]) -> SyncReadPlan:
        """Return the plan of a sync read of neighbouring registers. All of the servos support sync read."""
        key = (address, count, ids)
        plan = self._blocks.get(key)
        if plan is None:
            plan = SyncReadPlan(self._servos.series_of(ids[0]), ids, address, count)
            plan.base = self._base(plan.total, ids)
            if len(self._blocks) >= _MOST_PLANS:
                self._blocks.clear()
            self._blocks[key] = plan
        return plan

    def part(self, plan: SyncReadPlan, ids: tuple[int, ...], address: int, count: int) -> SyncReadPlan:
        """Return a plan that repeats the read for some of a plan's servos, in a block around the registers."""
        if plan.register is not None and (address, count) == (plan.address, plan.count):
            again = self.sync(plan.register.name, ids)
            if again is not None:
                return again
        return self.block(address, count, ids)

    def sync_write(self, name: str, ids: tuple[int, ...]) -> SyncWritePlan | None:
        """Make the plan of a sync write of a two-byte register that is the same for all; None if it is not.

        Raises:
            UsageError: No servo is named, or a servo has no such writable register.
        """
        if not ids:
            raise UsageError("a sync write needs at least one servo id")
        registers = [writable(self._servos.series_of(servo_id), servo_id, name) for servo_id in ids]
        if registers[0].size != 2 or any(register != registers[0] for register in registers):
            return None
        plan = self.sync_writes[name, ids] = SyncWritePlan(registers[0], ids)
        return plan

    def _base(self, total: int, ids: tuple[int, ...]) -> float:
        return self._timing.line_time(total) + self._servos.return_delays(ids)
