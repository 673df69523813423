"""`ServoBus`: bus servos on any byte link, without a board in between.

Owns registers by name in SI units or raw counts, and the fast path of reads and writes. It has a `BusLine`, which
sends plans and runs conversations; `questions` and `writes` handle slow and unusual cases, `setup` sets servos up.
Must not know arms or joints.

A missing or faulty servo is data, not an exception: results carry status, age and error, and their `check()`
raises. Only faults of the link raise directly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

from hexwire.link.base import Openable
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Register, Series
from hexwire.wire.servo_packet import BROADCAST_ID

from . import block_reads, orders, questions, writes
from .line import BusLine
from .plan import ReadPlan, SyncReadPlan, WritePlan
from .plan_cache import writable
from .recent import RecentValues
from .servos import KnownServos, as_series
from .values import Answer, Reading, Readings, ServoBlock, why

if TYPE_CHECKING:
    from hexwire.epochs import Epochs
    from hexwire.link.base import Link

    from .counters import BusCounters
    from .timing import LineTiming

__all__ = ["ServoBus"]

_new = tuple.__new__


class ServoBus(Openable):
    """Servos on one half-duplex wire behind a link. The constructor does no I/O; `open` or ``with`` does.

    One bus object owns its link; several threads may use the object, one transaction at a time.

    Args:
        link: The link to the adapter.
        series: Series of servos that `servos` does not name.
        servos: Series of single servos by id, on a wire with mixed series.
        baud: Bits per second on the wire; None takes the link's rate, 0 if it has none.
        retries: Number of repeats within one call to a servo that did not answer.

    Raises:
        UsageError: There is no such series, or fewer than 0 retries.
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
        self._servos = KnownServos(series, servos)
        self._line = BusLine(link, self._servos, baud=baud, retries=retries)
        self._machine = self._line.machine
        self._lock = self._line.lock
        self._plans = self._machine.plans
        self._recent = RecentValues()
        self._newest = self._recent.syncs
        self._newest_sync = self._plans.newest_sync
        self._newest_write = self._plans.newest_write

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """Make a bus on the link that `url` names, without opening it; options as in the constructor.

        A serial port without a rate in its URL gets the factory setting of the series.

        Raises:
            UsageError: The URL or an option is invalid.
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
        """Open the link and discard old bytes in it and in the adapter, such as answers to another program.

        Raises:
            LinkError: The link cannot be opened; see `Link.open`.
        """
        self._line.open()

    def close(self) -> None:
        """Close the link. Harmless if it is closed."""
        self._line.link.close()

    def __repr__(self) -> str:
        return f"<ServoBus {self.link.url} {self.series.value}>"

    # --- properties and settings -------------------------------------------------------------------------------

    @property
    def link(self) -> Link:
        """The link to the adapter."""
        return self._line.link

    @property
    def epochs(self) -> Epochs:
        """The stops of the arm, and the calls that they cancel. A driver sets its own."""
        return self._line.epochs

    @epochs.setter
    def epochs(self, epochs: Epochs) -> None:
        self._line.epochs = epochs

    @property
    def retries(self) -> int:
        """Number of repeats within one call to a servo that did not answer; may be set at any time."""
        return self._machine.retries

    @retries.setter
    def retries(self, retries: int) -> None:
        self._machine.retries = retries

    @property
    def timing(self) -> LineTiming:
        """Rate, windows and the adapter's measured overhead; another object after `set_baud`."""
        return self._machine.timing

    @property
    def counters(self) -> BusCounters:
        """The counters so far."""
        return self._machine.counters

    @property
    def echo(self) -> bool | None:
        """Whether the adapter echoes what is sent; None until it is known. Detected automatically."""
        return self._machine.echo

    @property
    def series(self) -> Series:
        """Series of servos without a known one."""
        return self._servos.default

    def now(self) -> float:
        """Return the time of the link's clock, monotonic seconds."""
        return self._line.clock()

    def backlog(self) -> float:
        """Return the seconds until the line has transmitted the packets sent so far."""
        with self._lock:
            return self._machine.backlog(self._line.clock())

    def series_of(self, servo_id: int) -> Series:
        """Series of a servo."""
        return self._servos.series_of(servo_id)

    def set_series(self, servo_id: int, series: Series | str) -> None:
        """Set the series of a servo.

        Raises:
            UsageError: There is no such series.
        """
        with self._lock:
            self._servos.set_series(servo_id, series)
            self._machine.forget_plans()

    def set_return_delay(self, servo_id: int, seconds: float) -> None:
        """Set the seconds until a servo begins its answer; `setup.identify` reads them."""
        with self._lock:
            self._servos.set_return_delay(servo_id, seconds)
            self._machine.forget_plans()

    def set_acknowledges(self, servo_id: int, acknowledges: bool) -> None:
        """Set whether a servo acknowledges writes (status_return_level 1); silence is detected automatically."""
        with self._lock:
            self._servos.set_acknowledges(servo_id, acknowledges)

    def acknowledges(self, servo_id: int) -> bool:
        """Whether a servo acknowledges writes, as far as known."""
        return self._servos.acknowledges(servo_id)

    def set_baud(self, baud: int) -> None:
        """Change the rate of the link, bits per second. The servos' own rate does not change.

        Raises:
            NotSupportedError: This link has no rate.
        """
        with self._lock:
            self._line.set_baud(baud)

    # --- reading -----------------------------------------------------------------------------------------------

    def read(self, servo_id: int, name: str) -> Reading:
        """Read a register.

        Args:
            servo_id: Bus id.
            name: Register name, as in ``present_position``.

        Returns:
            Raw value, SI value, status, age and error of the register.

        Raises:
            UsageError: The servo's series has no such register.
            LinkError: The line has a fault.
        """
        entry = self._plans.reads.get((servo_id, name))
        if entry is None:
            entry = self._machine.plan_read(servo_id, name)
        plan, register = entry
        line, machine = self._line, self._machine
        with self._lock:
            if machine.doubtful and line.doubted(plan.ids, plan.count):
                return self._read_carefully(plan, register, None)
            try:
                data = line.transact(plan)
                raw = plan.value(data)
                if raw is None:
                    return self._read_carefully(plan, register, data)
            except BaseException:
                line.gave_up(plan)
                raise
            plan.latest = raw
            plan.stamp = now = line.clock()
            if machine.asked_at is not None:
                machine.learn_time(plan, now)
            return _new(Reading, (servo_id, register, raw, 0, 0.0, "", raw))

    def read_block(self, servo_id: int, address: int, count: int) -> ServoBlock:
        """Read neighbouring registers; of a legacy servo, two bytes at a time.

        Raises:
            UsageError: The block is invalid.
            LinkError: The line has a fault.
        """
        return block_reads.read_block(self._line, servo_id, address, count)

    def sync_read(self, name: str, servo_ids: Iterable[int]) -> Readings:
        """Read the same register of several servos: by one request where they support it, else by single reads.

        Args:
            name: Register name; on a wire with mixed series that of each servo.
            servo_ids: Ids of the servos, in this order. A tuple is fastest.

        Returns:
            One reading per servo. Repeats went only to servos that did not answer.

        Raises:
            UsageError: A servo's series has no such register, or no servo is named.
            LinkError: The line has a fault.
        """
        plan = self._newest_sync.get(name)
        if plan is None or plan.ids is not servo_ids:
            ids = tuple(servo_ids)
            plan = self._plans.syncs.get((name, ids)) or self._plans.sync(name, ids)
            if plan is None:
                return self._read_mixed(name, ids)
            self._newest_sync[name] = plan
        register, ids = plan.register, plan.ids
        assert register is not None
        line, machine = self._line, self._machine
        with self._lock:
            if machine.silent or (machine.doubtful and line.doubted(ids, plan.count)):
                return self._sync_carefully(plan, register, None)
            try:
                data = line.transact(plan)
                raw = plan.glance(data)
                if raw is None:
                    return self._sync_carefully(plan, register, data)
            except BaseException:
                line.gave_up(plan)
                raise
            now = line.clock()
            if machine.asked_at is not None:
                machine.learn_time(plan, now)
            machine.extra_answers += plan.extra
            readings = self._newest[name] = Readings(register, ids, raw, now)
            return readings

    def sync_read_blocks(self, address: int, count: int, servo_ids: Iterable[int]) -> list[ServoBlock]:
        """Read neighbouring registers of several servos at once; single reads where they have no sync read.

        Raises:
            UsageError: The block is invalid.
            LinkError: The line has a fault.
        """
        return block_reads.sync_read_blocks(self._line, address, count, tuple(servo_ids))

    # --- writing -----------------------------------------------------------------------------------------------

    def write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit. A goal position switches the torque on and moves the servo.

        Raises:
            UsageError: There is no such register, it is read-only, or cannot hold the value; nothing was sent.
            LinkError: The line has a fault.
        """
        register = writable(self.series_of(servo_id), servo_id, name)
        return writes.write_register(self._line, servo_id, register, register.from_si(value))

    def write_raw(self, servo_id: int, name: str, raw: int) -> Answer:
        """Write the raw value of a register. See `write`."""
        return writes.write_register(self._line, servo_id, writable(self.series_of(servo_id), servo_id, name), raw)

    def write_bytes(self, servo_id: int, address: int, data: bytes) -> Answer:
        """Write neighbouring registers. Only the size of the packet is checked."""
        plan = WritePlan(servo_id, self.series_of(servo_id), address, data)
        return writes.acknowledged(self._line, plan, f"a write at {address}")

    def reg_write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit; the value takes effect at `action`. Raises as `write`."""
        register = writable(self.series_of(servo_id), servo_id, name)
        raw = writes.in_range(servo_id, register, register.from_si(value))
        request = packets.make_reg_write(servo_id, register.address, register.encode(raw))
        return writes.order(self._line, servo_id, request, f"a delayed write of {name}")

    def sync_write(self, name: str, values: Mapping[int, float]) -> None:
        """Write a register of several servos in its SI unit, by one unacknowledged packet per series.

        Raises:
            UsageError: A value is outside a register's range; nothing was sent.
            LinkError: The line has a fault.
        """
        raws = {i: writable(self.series_of(i), i, name).from_si(value) for i, value in values.items()}
        self.sync_write_raw(name, raws)

    def sync_write_raw(self, name: str, values: Mapping[int, int]) -> None:
        """Write raw values of a register of several servos. See `sync_write`."""
        ids = tuple(values)
        plan = self._newest_write.get(name)
        if plan is None or plan.ids != ids:
            plan = self._plans.sync_writes.get((name, ids)) or self._plans.sync_write(name, ids)
            if plan is None:
                return writes.sync_write_each(self._line, name, values)
            self._newest_write[name] = plan
        packet = plan.serialize(tuple(values.values()))
        line = self._line
        token = line.epochs.token(name)
        with self._lock:
            line.post(packet, token)
        return None

    def sync_write_bytes(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write neighbouring registers of several servos in one packet. Only the size of the packet is checked."""
        packet = packets.make_sync_write(address, data)
        line = self._line
        # It always acts, so that it need not be asked whether it does.
        token = line.epochs.token("a servo packet")
        with self._lock:
            line.post(packet, token)

    # --- other instructions ------------------------------------------------------------------------------------

    def ping(self, servo_id: int) -> Answer:
        """Ping a servo."""
        return orders.ping(self._line, servo_id)

    def broadcast_ping(self, most: int = 254) -> tuple[tuple[int, ...], int]:
        """Ping all servos at once. Only the answer of a single servo is reliable: several answer at the same time.

        Args:
            most: Number of answers to wait for.

        Returns:
            Ids received, and the number of invalid bytes (such as from a collision).
        """
        return orders.broadcast_ping(self._line, most)

    def restore(self, servo_id: int) -> Answer:
        """Restore factory settings; Feetech servos keep their id.

        Raises:
            NotSupportedError: A legacy servo would lose its id; see `setup.factory_reset`.
        """
        return orders.restore(self._line, servo_id)

    def reboot(self, servo_id: int) -> None:
        """Restart a servo, without an acknowledgement. It is silent for 0.8 s, and its torque is off.

        Raises:
            NotSupportedError: Its series has no such instruction.
        """
        orders.reboot(self._line, servo_id)

    def backup(self, servo_id: int) -> Answer:
        """Make a servo store its present settings as those of `restore`. Raises as `reboot`."""
        return orders.backup(self._line, servo_id)

    def reset_turns(self, servo_id: int) -> Answer:
        """Clear a servo's turn counter. Raises as `reboot`."""
        return orders.reset_turns(self._line, servo_id)

    def calibrate(self, servo_id: int, position: int | None = None) -> Answer:
        """Make the present position 2048, or the given count if the firmware accepts one. Nothing moves.

        Raises:
            NotSupportedError: The series has no such instruction.
        """
        return orders.calibrate(self._line, servo_id, position)

    def action(self, servo_id: int = BROADCAST_ID) -> Answer | None:
        """Apply values of `reg_write`, in one servo or, without an acknowledgement, in all."""
        return orders.action(self._line, servo_id)

    def ask(self, request: bytes, servo_id: int, params: int) -> tuple[packets.StatusPacket | None, str]:
        """Send any packet once and receive the answer of one servo.

        Args:
            request: The packet.
            servo_id: Id of the answering servo.
            params: Parameter bytes of the answer.

        Returns:
            The status packet or None, and in words what arrived instead; empty if nothing arrived.
        """
        return orders.ask(self._line, request, servo_id, params)

    def raw(self, request: bytes, servo_ids: Sequence[int] = (), params: int = 0) -> dict[int, bytes]:
        """Send any packet and return the parameters of the answers by servo id.

        Args:
            request: The packet.
            servo_ids: Ids of the answering servos, in order; if empty, the call does not wait.
            params: Parameter bytes of each answer.
        """
        return orders.raw(self._line, request, servo_ids, params)

    def pause(self, seconds: float) -> None:
        """Wait, and discard bytes that arrive meanwhile."""
        orders.pause(self._line, seconds)

    # --- careful path ------------------------------------------------------------------------------------------

    def _read_carefully(self, plan: ReadPlan, register: Register, data: bytes | None) -> Reading:
        servo_id, name, machine = plan.servo_id, register.name, self._machine
        status, collector = self._line.run(
            questions.ask_block(machine, servo_id, plan.address, plan.count, base=plan.base, data=data)
        )
        now = machine.now
        if status is None:
            last = self._last(name, servo_id)
            age = float("inf") if last is None else now - last[1]
            error = why(collector.in_words())
            return Reading(servo_id, register, None, 0, age, error, None if last is None else last[0])
        raw = register.decode(status.params[: register.size])
        self._recent.keep(name, servo_id, raw, now)
        return Reading(servo_id, register, raw, status.error, 0.0, "", raw)

    def _last(self, name: str, servo_id: int) -> tuple[int, float] | None:
        """Return the newest value read from a register, and its time."""
        entry = self._plans.reads.get((servo_id, name))
        return self._recent.last(name, servo_id, None if entry is None else entry[0])

    def _sync_carefully(self, plan: SyncReadPlan, register: Register, data: bytes | None) -> Readings:
        rows = None if data is None else plan.blocks(data)
        name, ids, machine = register.name, plan.ids, self._machine
        if rows is not None:
            now = self.now()
            machine.learn_time(plan, now)
            machine.extra_answers += len(ids) - 1
            raws: tuple[int | None, ...] = tuple(register.decode(row) for row in rows)
            readings = Readings(register, ids, raws, now)
        else:
            found = self._line.run(questions.ask_many(machine, plan, data))
            now = machine.now
            raws = tuple(register.decode(found[i].params) if i in found else None for i in ids)
            statuses = {i: status.error for i, status in found.items() if status.error}
            last = {i: value for i in ids if i not in found and (value := self._last(name, i)) is not None}
            readings = Readings(register, ids, raws, now, statuses, last)
            # Keep a silent servo's newest value longer than the readings without it.
            for servo_id, (raw, stamp) in last.items():
                self._recent.keep(name, servo_id, raw, stamp)
        self._newest[name] = readings
        return readings

    def _read_mixed(self, name: str, ids: tuple[int, ...]) -> Readings:
        """Use one sync read per series that supports it, and single reads for the other servos."""
        groups: dict[Series, list[int]] = {}
        for servo_id in ids:
            groups.setdefault(self.series_of(servo_id), []).append(servo_id)
        found: dict[int, Reading] = {}
        for series, members in groups.items():
            if series.sync_read and len(members) > 1:
                found.update((reading.servo_id, reading) for reading in self.sync_read(name, tuple(members)))
            else:
                found.update((servo_id, self.read(servo_id, name)) for servo_id in members)
        return Readings.joined([found[servo_id] for servo_id in ids], self.now())
