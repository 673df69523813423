"""`ServoBus`: bus servos on any byte link, without a board in between.

Owns registers by name in SI units or raw counts, the series of each servo, and the fast path of reads and writes.
What is slow or strange is `bus_line`'s; setting servos up is `servo_setup`'s. Must not know arms or joints.

A missing or troubled servo is data, not an exception: results carry status, age and error, and their `check()`
raises for those who want that. Only the link raises by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Self

from hexwire.errors import UsageError
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Register, Series

from .line import ADAPTER_TIME, MEASURED_EVERY
from .orders import BusOrders, as_series, why
from .plan import ReadPlan, SyncReadPlan, SyncWritePlan, WritePlan
from .values import SILENT, Answer, Reading, Readings, ServoBlock

if TYPE_CHECKING:
    from types import TracebackType

    from hexwire.link.base import Link

__all__ = ["ServoBus"]

_new = tuple.__new__
_LEGACY_READ = 2
_MOST_PLANS = 512


class ServoBus(BusOrders):
    """Servos on one half-duplex wire behind a link. Constructing one does no I/O; `open` or ``with`` does.

    One bus object owns its link; several threads may use the object, one transaction at a time.

    Args:
        link: The line to the adapter.
        series: What a servo is unless `servos` says otherwise.
        servos: Series of single servos by id, on a wire with mixed series.
        baud: Bits a second on the wire; None takes the link's own rate, 0 if it has none.
        retries: How often a servo that did not answer is asked again within one call.
    """

    def __init__(
        self,
        link: Link,
        *,
        series: Series | str = Series.STS_SMS,
        servos: Mapping[int, Series | str] | None = None,
        baud: int | None = None,
        retries: int = 2,
    ) -> None:
        super().__init__(link, series=series, servos=servos, baud=baud, retries=retries)
        self._reads: dict[tuple[int, str], tuple[ReadPlan, Register]] = {}
        self._syncs: dict[tuple[str, tuple[int, ...]], SyncReadPlan | None] = {}
        self._blocks: dict[tuple[int, int, tuple[int, ...]], SyncReadPlan] = {}
        self._sync_writes: dict[tuple[str, tuple[int, ...]], SyncWritePlan] = {}
        self._recent: dict[tuple[str, int], tuple[int, float]] = {}
        self._newest: dict[str, Readings] = {}

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """A bus on the link that `url` names, not opened; options as in the constructor.

        A serial port without a rate in its URL gets that of the series' factory setting.

        Raises:
            UsageError: The URL or an option makes no sense.
        """
        from hexwire.link.open import make_link
        from hexwire.link.url import parse_url

        parts = parse_url(url)
        if parts.scheme == "serial" and "baud" not in parts.query:
            series = as_series(options.get("series", Series.STS_SMS))
            url = f"{url}{'&' if parts.query else '?'}baud={series.baud}"
        return cls(make_link(url), **options)

    # --- opening -----------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the link and drop what had arrived before, or is in the adapter: another program's answers, say."""
        self.link.open()
        self._own_baud_again()
        self.link.flush_input()
        self._drain(ADAPTER_TIME)

    def close(self) -> None:
        """Close the link. Harmless if it is closed."""
        self.link.close()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<ServoBus {self.link.url} {self.series.value}>"

    def _forget_plans(self) -> None:
        for cache in (self._reads, self._syncs, self._blocks, self._sync_writes):
            cache.clear()

    # --- reading -----------------------------------------------------------------------------------------------

    def read(self, servo_id: int, name: str) -> Reading:
        """Read a register.

        Args:
            servo_id: Bus id.
            name: Register name, as in ``present_position``.

        Returns:
            Raw value, SI value, status, age and error of it.

        Raises:
            UsageError: The servo's series has no such register.
            LinkError: The line is at fault.
        """
        entry = self._reads.get((servo_id, name))
        if entry is None:
            entry = self._plan_read(servo_id, name)
        plan, register = entry
        with self._lock:
            if self._doubtful and self._doubted(servo_id, plan.count):
                return self._read_carefully(plan, register, None)
            turn = self._turns = self._turns + 1
            try:
                if self._learning or self._busy_until or not turn % MEASURED_EVERY:
                    data = self._exchange_measured(plan)
                else:
                    data = self._exchange(plan.request, plan.base + self.timing.allowance, plan.nap.seconds)
            except BaseException:
                self._doubt(servo_id, plan.count, plan.request, self._clock())
                raise
            raw = plan.value(data)
            if raw is None:
                return self._read_carefully(plan, register, data)
            plan.latest = raw
            plan.stamp = self._clock()
            return _new(Reading, (servo_id, register, raw, 0, 0.0, "", raw))

    def read_block(self, servo_id: int, address: int, count: int) -> ServoBlock:
        """Read neighbouring registers. A legacy servo is asked for them two bytes at a time."""
        if self.series_of(servo_id) is Series.SEVEN_BOT:
            return self._read_by_pairs(servo_id, address, count)
        packets.make_read(servo_id, address, count)
        with self._lock:
            status, _ = self._ask_block(servo_id, address, count)
        if status is None:
            return ServoBlock(servo_id, address, b"", 0, SILENT)
        return ServoBlock(servo_id, address, status.params, status.error)

    def sync_read(self, name: str, servo_ids: Iterable[int]) -> Readings:
        """Read the same register of several servos: one request where they can, single reads where not.

        Args:
            name: Register name; on a wire with mixed series each servo's own.
            servo_ids: Whom to ask, in this order. A tuple is quickest.

        Returns:
            One reading each. Servos that did not answer, and only those, were asked again.

        Raises:
            UsageError: A servo's series has no such register, or no servo is named.
            LinkError: The line is at fault.
        """
        ids = servo_ids if type(servo_ids) is tuple else tuple(servo_ids)
        plan = self._syncs.get((name, ids))
        if plan is None:
            plan = self._plan_sync(name, ids)
            if plan is None:
                return self._read_mixed(name, ids)
        register = plan.register
        assert register is not None
        with self._lock:
            if self._mute or (self._doubtful and self._suspect(ids, plan.count)):
                return self._sync_carefully(plan, register, None)
            turn = self._turns = self._turns + 1
            try:
                if self._learning or self._busy_until or not turn % MEASURED_EVERY:
                    data = self._exchange_measured(plan)
                else:
                    data = self._exchange(plan.request, plan.base + self.timing.allowance, plan.nap.seconds)
                if len(data) < plan.length:
                    data = self._rest(plan, data)
            except BaseException:
                self._give_up(plan)
                raise
            raw = plan.glance(data)
            if raw is None:
                return self._sync_carefully(plan, register, data)
            self._extra_answers += len(ids) - 1
            readings = Readings(register, ids, raw, self._clock())
            self._newest[name] = readings
            return readings

    def sync_read_blocks(self, address: int, count: int, servo_ids: Iterable[int]) -> list[ServoBlock]:
        """Read neighbouring registers of several servos at once; single reads where they cannot sync read."""
        ids = tuple(servo_ids)
        able = tuple(i for i in ids if self.series_of(i).sync_read)
        found: dict[int, ServoBlock] = {}
        if able:
            plan = self._block_plan(address, count, able)
            with self._lock:
                data = None
                if not (self._mute or (self._doubtful and self._suspect(able, count))):
                    self._turns += 1
                    try:
                        data = self._exchange_measured(plan)
                    except BaseException:
                        self._give_up(plan)
                        raise
                    rows = plan.blocks(data)
                    if rows is not None:
                        self._extra_answers += len(able) - 1
                        found = {i: ServoBlock(i, address, row) for i, row in zip(able, rows, strict=True)}
                if not found:
                    for i, status in self._ask_many(plan, data).items():
                        found[i] = ServoBlock(i, address, status.params, status.error)
        for servo_id in ids:
            if servo_id not in found:
                if servo_id in able:
                    found[servo_id] = ServoBlock(servo_id, address, b"", 0, SILENT)
                else:
                    found[servo_id] = self.read_block(servo_id, address, count)
        return [found[servo_id] for servo_id in ids]

    # --- writing -----------------------------------------------------------------------------------------------

    def write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit. A goal position switches the torque on and moves the servo.

        Raises:
            UsageError: No such register, a read-only one, or a value that it cannot hold; nothing was sent.
        """
        register = self._writable(servo_id, name)
        return self._write(servo_id, register, register.from_si(value))

    def write_raw(self, servo_id: int, name: str, raw: int) -> Answer:
        """Write a register as the servo counts it. See `write`."""
        return self._write(servo_id, self._writable(servo_id, name), raw)

    def write_bytes(self, servo_id: int, address: int, data: bytes) -> Answer:
        """Write neighbouring registers. Nothing is checked but that it fits a packet."""
        return self._acknowledged(
            WritePlan(servo_id, self.series_of(servo_id), address, data), f"a write at {address}"
        )

    def reg_write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit, to take effect at `action`."""
        register = self._writable(servo_id, name)
        raw = self._in_range(servo_id, register, register.from_si(value))
        request = packets.make_reg_write(servo_id, register.address, register.encode(raw))
        return self._acknowledged(self._order(servo_id, request), f"a delayed write of {name}")

    def sync_write(self, name: str, values: Mapping[int, float]) -> None:
        """Write a register of several servos in its SI unit: one packet a series, which nobody answers."""
        self.sync_write_raw(name, {i: self._writable(i, name).from_si(value) for i, value in values.items()})

    def sync_write_raw(self, name: str, values: Mapping[int, int]) -> None:
        """Write a register of several servos as they count it: one packet a series, which nobody answers.

        Raises:
            UsageError: A value outside a register's range; nothing was sent.
        """
        key = (name, tuple(values))
        plan = self._sync_writes.get(key)
        if plan is None:
            plan = self._plan_sync_write(name, key[1])
            if plan is None:
                return self._sync_write_mixed(name, values)
        packet = plan.serialize(tuple(values.values()))
        with self.epochs.calling(name), self._lock:
            self._post(packet)
        return None

    def sync_write_bytes(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write neighbouring registers of several servos in one packet. Nothing is checked but that it fits."""
        self._send(packets.make_sync_write(address, data))

    # --- inside ------------------------------------------------------------------------------------------------

    def _new_read(self, servo_id: int, address: int, count: int, register: Register | None = None) -> ReadPlan:
        plan = ReadPlan(servo_id, self.series_of(servo_id), address, count, register)
        plan.base = self._base(plan.total, (servo_id,))
        if plan.series is Series.SEVEN_BOT:
            # Its echo, one byte of the header wrong, is a sound answer, and the fast path keeps no record.
            self._sent.prepare(plan.request)
        return plan

    def _plan_read(self, servo_id: int, name: str) -> tuple[ReadPlan, Register]:
        series = self.series_of(servo_id)
        register = series.register(name)
        count = _LEGACY_READ if series is Series.SEVEN_BOT else register.size
        entry = (self._new_read(servo_id, register.address, count, register), register)
        self._reads[servo_id, name] = entry
        return entry

    def _read_carefully(self, plan: ReadPlan, register: Register, data: bytes | None) -> Reading:
        servo_id = plan.servo_id
        status, collector = self._ask_block(servo_id, plan.address, plan.count, base=plan.base, data=data)
        now = self._clock()
        if status is None:
            last = self._last(register.name, servo_id)
            age = float("inf") if last is None else now - last[1]
            error = why(collector.in_words())
            return Reading(servo_id, register, None, 0, age, error, None if last is None else last[0])
        raw = register.decode(status.params[: register.size])
        self._recent[register.name, servo_id] = (raw, now)
        return Reading(servo_id, register, raw, status.error, 0.0, "", raw)

    def _last(self, name: str, servo_id: int) -> tuple[int, float] | None:
        """Newest value of a register that was read, and when."""
        last = self._recent.get((name, servo_id))
        entry = self._reads.get((servo_id, name))
        if entry is not None and entry[0].latest is not None and (last is None or entry[0].stamp > last[1]):
            last = entry[0].latest, entry[0].stamp
        newest = self._newest.get(name)
        if newest is not None and servo_id in newest.ids:
            raw = newest.raw[newest.ids.index(servo_id)]
            if raw is not None and (last is None or newest.stamp > last[1]):
                return raw, newest.stamp
        return last

    def _read_by_pairs(self, servo_id: int, address: int, count: int) -> ServoBlock:
        data, error = b"", 0
        for at in range(address, address + count, _LEGACY_READ):
            with self._lock:
                status, _ = self._ask_block(servo_id, at, _LEGACY_READ)
            if status is None:
                return ServoBlock(servo_id, address, b"", 0, SILENT)
            data += status.params
            error |= status.error
        return ServoBlock(servo_id, address, data[:count], error)

    def _exchange_measured(self, plan: ReadPlan | SyncReadPlan) -> bytes:
        """The exchange of a prepared read, and how long it took; behind unanswered packets it may take longer."""
        start = self._asked_at = self._clock()
        window = plan.base + self.timing.allowance + self._backlog()
        data = self._exchange(plan.request, window, plan.nap.seconds)
        if len(data) < plan.length and isinstance(plan, SyncReadPlan):
            data = self._rest(plan, data)
        if plan.sound(data):
            self._measure(plan, self._clock() - start)
            self._asked_at = None
        return data

    def _give_up(self, plan: SyncReadPlan) -> None:
        """The wait ended with an error or Ctrl-C; the answers may come all the same."""
        now = self._clock()
        for servo_id in plan.ids:
            self._doubt(servo_id, plan.count, plan.request, now)

    def _rest(self, plan: SyncReadPlan, data: bytes) -> bytes:
        """Wait for the rest of the answers to a sync read, as long as it looks as if they were coming."""
        share = plan.base / plan.length
        while data and len(data) < plan.length and not plan.ended(data):
            left = (plan.length - len(data)) * share + self.timing.allowance
            more = self.link.read(self._clock() + left)
            if not more:
                break
            data += more
        return data

    def _plan_sync(self, name: str, ids: tuple[int, ...]) -> SyncReadPlan | None:
        """Plan of a sync read that all of them understand alike; None if there is none."""
        if not ids:
            raise UsageError("a sync read needs at least one servo id")
        key = (name, ids)
        if key in self._syncs:
            return self._syncs[key]
        kinds = {self.series_of(servo_id) for servo_id in ids}
        registers = [self.series_of(servo_id).register(name) for servo_id in ids]
        alike = len(kinds) == 1 and all(kind.sync_read for kind in kinds)
        plan = None
        if alike:
            plan = SyncReadPlan(kinds.pop(), ids, registers[0].address, registers[0].size, registers[0])
            plan.base = self._base(plan.total, ids)
        self._syncs[key] = plan
        return plan

    def _sync_plan(self, plan: SyncReadPlan, servo_ids: tuple[int, ...], address: int, count: int) -> SyncReadPlan:
        if plan.register is not None and (address, count) == (plan.address, plan.count):
            again = self._plan_sync(plan.register.name, servo_ids)
            if again is not None:
                return again
        return self._block_plan(address, count, servo_ids)

    def _block_plan(self, address: int, count: int, ids: tuple[int, ...]) -> SyncReadPlan:
        key = (address, count, ids)
        plan = self._blocks.get(key)
        if plan is None:
            plan = SyncReadPlan(self.series_of(ids[0]), ids, address, count)
            plan.base = self._base(plan.total, ids)
            if len(self._blocks) >= _MOST_PLANS:
                self._blocks.clear()
            self._blocks[key] = plan
        return plan

    def _sync_carefully(self, plan: SyncReadPlan, register: Register, data: bytes | None) -> Readings:
        rows = None if data is None else plan.blocks(data)
        name, ids = register.name, plan.ids
        if rows is not None:
            self._extra_answers += len(ids) - 1
            raws: tuple[int | None, ...] = tuple(register.decode(row) for row in rows)
            readings = Readings(register, ids, raws, self._clock())
        else:
            found = self._ask_many(plan, data)
            now = self._clock()
            raws = tuple(register.decode(found[i].params) if i in found else None for i in ids)
            statuses = {i: status.error for i, status in found.items() if status.error}
            last = {i: value for i in ids if i not in found and (value := self._last(name, i)) is not None}
            readings = Readings(register, ids, raws, now, statuses, last)
            # A silent servo's newest value must outlive the readings that lack it.
            self._recent.update({(name, i): value for i, value in last.items()})
        self._newest[name] = readings
        return readings

    def _read_mixed(self, name: str, ids: tuple[int, ...]) -> Readings:
        """Sync reads for those that can, by series; single reads for the others."""
        groups: dict[Series, list[int]] = {}
        for servo_id in ids:
            groups.setdefault(self.series_of(servo_id), []).append(servo_id)
        found: dict[int, Reading] = {}
        for series, members in groups.items():
            if series.sync_read and len(members) > 1:
                found.update((reading.servo_id, reading) for reading in self.sync_read(name, tuple(members)))
            else:
                found.update((servo_id, self.read(servo_id, name)) for servo_id in members)
        now = self._clock()
        rows = [found[servo_id] for servo_id in ids]
        return Readings(
            [row.register for row in rows],
            ids,
            tuple(row.raw for row in rows),
            now,
            {row.servo_id: row.status for row in rows if row.status},
            {row.servo_id: (row.last, now - row.age) for row in rows if row.raw is None and row.last is not None},
            {row.servo_id: row.error for row in rows if row.error},
        )

    # --- inside: writing ---------------------------------------------------------------------------------------

    def _writable(self, servo_id: int, name: str) -> Register:
        register = self.series_of(servo_id).register(name)
        if register.access != "rw":
            raise UsageError(f"register {name} of servo {servo_id} can only be read")
        return register

    def _in_range(self, servo_id: int, register: Register, raw: int) -> int:
        low, high = register.minimum, register.maximum
        if (low is not None and raw < low) or (high is not None and raw > high):
            raise UsageError(
                f"{register.name} of servo {servo_id} takes {low}..{high}, not {raw}; nothing was sent"
            )
        return raw

    def _write(self, servo_id: int, register: Register, raw: int) -> Answer:
        data = register.encode(self._in_range(servo_id, register, raw))
        plan = WritePlan(servo_id, self.series_of(servo_id), register.address, data)
        return self._acknowledged(plan, f"a write of {register.name}")

    def _plan_sync_write(self, name: str, ids: tuple[int, ...]) -> SyncWritePlan | None:
        if not ids:
            raise UsageError("a sync write needs at least one servo id")
        registers = [self._writable(servo_id, name) for servo_id in ids]
        if registers[0].size != 2 or any(register != registers[0] for register in registers):
            return None
        plan = SyncWritePlan(registers[0], ids)
        self._sync_writes[name, ids] = plan
        return plan

    def _sync_write_mixed(self, name: str, values: Mapping[int, int]) -> None:
        # By place and width: the byte order within is each servo's own.
        rows: dict[tuple[int, int], dict[int, bytes]] = {}
        for servo_id, value in values.items():
            register = self._writable(servo_id, name)
            data = register.encode(self._in_range(servo_id, register, value))
            rows.setdefault((register.address, register.size), {})[servo_id] = data
        with self.epochs.calling(name):
            for (address, _), data_of in rows.items():
                self._send(packets.make_sync_write(address, data_of))
