"""`ServoBus`: bus servos on any byte link, without a board in between.

Owns registers by name in SI units or raw counts, the instructions that name no register, the fast path of reads and
writes, and the reliability of acknowledgements: when one may belong to an earlier write, when the register is read
back instead, and whether a servo acknowledges at all. It has a `BusLine`, which sends plans and runs conversations;
`questions` handles slow and unusual reads, `setup` sets servos up. Must not know arms or joints.

A missing or faulty servo is data, not an exception: results carry status, age and error, and their `check()`
raises. Only faults of the link raise directly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Self

from hexwire.errors import NotSupportedError, RemoteProtocolError, UsageError
from hexwire.link.base import Link, Openable
from hexwire.session.servo_answers import AnswerCollector, expected_answer
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Register, Series
from hexwire.wire.servo_packet import BROADCAST_ID, StatusPacket, make_sync_write
from hexwire.wire.tables import LEGACY_HEADER, MAX_SERVO_ID

from . import questions
from .line import BusLine
from .plan import ReadPlan, SyncReadPlan, WritePlan, writable
from .servos import KnownServos, as_series
from .values import SILENT, Answer, Reading, Readings, ServoBlock, why

if TYPE_CHECKING:
    from hexwire.epochs import Epochs

    from .machine import BusCounters, BusMachine, Conversation
    from .timing import LineTiming

__all__ = ["ServoBus", "acknowledged", "in_range", "order", "sync_write_each", "write_register"]

_LEVEL = "status_return_level"
_new = tuple.__new__


def order(line: BusLine, servo_id: int, request: bytes, what: str, *, repeat: bool = True) -> Answer:
    """Send a packet that one servo acknowledges like a write; see `acknowledged`."""
    plan = WritePlan(servo_id, line.machine.servos.series_of(servo_id), 0, b"", request)
    return acknowledged(line, plan, what, repeat=repeat)


def acknowledged(line: BusLine, plan: WritePlan, what: str, *, repeat: bool = True) -> Answer:
    """Send a write and receive its acknowledgement, if the servo gives any.

    Args:
        line: The bus.
        plan: The write.
        what: Name of the write, for display.
        repeat: Whether it may be executed more than once.

    Raises:
        LinkError: The line has a fault.
        StoppedError: The arm was stopped after the call; nothing more was sent.
        PreemptedError: The arm was stopped while the write was sent.
    """
    servo_id = plan.servo_id
    if servo_id == BROADCAST_ID:
        line.send(plan.request)
        return Answer(servo_id, what, confirmed=False)
    machine, servos = line.machine, line.machine.servos
    with line.epochs.calling(what), line.lock:
        plan.base = machine.base(plan.total, (servo_id,))
        if not servos.acknowledges(servo_id):
            line.post(plan.request, line.epochs.of_this_call)
            # An unexpected acknowledgement must not count as the answer to the next ping or write.
            now = line.clock()
            machine.gave_up((servo_id,), 0, plan.request, now, now)
            return Answer(servo_id, what, confirmed=False)
        if line.doubted((servo_id,), 0):
            block = line.run(_write_and_look(machine, plan)) if repeat else None
            if block is not None:
                return Answer(servo_id, what, block.error)
            if not line.run(questions.settle(machine, servo_id, 0)):
                return Answer(servo_id, what, 0, SILENT, False)
        line.check_call()
        start = line.clock()
        try:
            data = _exchange(line, plan, start)
            if data is None:
                servos.confirmed_writes.add(servo_id)
                return _new(Answer, (servo_id, what, 0, "", True))
            status, instead = line.run(_finish(machine, plan, data, machine.retries if repeat else 0))
        except BaseException:
            # An error or Ctrl-C: the acknowledgement may still arrive.
            machine.gave_up((servo_id,), 0, plan.request, start, line.clock())
            raise
        if status is not None:
            servos.confirmed_writes.add(servo_id)
            return Answer(servo_id, what, status.error)
        if servo_id not in servos.confirmed_writes:
            level = line.run(_level(machine, servo_id))
            if level is not None and level.params == b"\0":
                servos.set_acknowledges(servo_id, False)
                return Answer(servo_id, what, level.error, confirmed=False)
        return Answer(servo_id, what, 0, why(instead), False)


def _exchange(line: BusLine, plan: WritePlan, start: float) -> bytes | None:
    """Send a write at `start`; returns None if the bytes received are its acknowledgement, else those bytes."""
    machine = line.machine
    machine.sent.add(plan.request, start)
    data = line.exchange(plan.request, plan.base + machine.timing.allowance)
    machine.turns += 1
    if data != plan.acknowledgement:
        return data
    machine.asked_at = start
    machine.learn_time(plan, line.clock())
    return None


def _finish(
    machine: BusMachine, plan: WritePlan, data: bytes, retries: int
) -> Conversation[tuple[StatusPacket | None, str]]:
    """Receive the acknowledgement of a sent write, or None; and in words what arrived instead."""
    servo_id, header = plan.servo_id, plan.series.reply_header
    status, collector = yield from questions.ask_one(
        machine,
        servo_id,
        plan.request,
        0,
        base=plan.base,
        data=data,
        header=header,
        retries=retries,
    )
    if status is None and plan.data and servo_id in collector.copies:
        # Its answer looks like the echo of a recent packet: read the register back.
        status = yield from _look(machine, plan)
    return status, collector.in_words()


def _write_and_look(machine: BusMachine, plan: WritePlan) -> Conversation[StatusPacket | None]:
    """Write while an acknowledgement could be an earlier one, and read back; None if that does not confirm it."""
    header = plan.series.reply_header
    for _ in range(1 + machine.retries if plan.data else 0):
        yield from machine.collect(plan.request, (plan.servo_id,), 0, plan.base, header=header)
        found = yield from _look(machine, plan)
        if found is not None:
            machine.count.settled += 1
            return found
    return None


def _look(machine: BusMachine, plan: WritePlan) -> Conversation[StatusPacket | None]:
    """Read a write back; None if the value differs, or the servo does not answer."""
    block, _ = yield from questions.ask_block(machine, plan.servo_id, plan.address, len(plan.data))
    return block if block is not None and block.params == plan.data else None


def _level(machine: BusMachine, servo_id: int) -> Conversation[StatusPacket | None]:
    """Read whether a servo acknowledges writes; None if it has no such register, or does not answer."""
    register = machine.servos.series_of(servo_id).registers.get(_LEVEL)
    if register is None:
        return None
    level, _ = yield from questions.ask_block(machine, servo_id, register.address, register.size)
    return level


# --- registers ----------------------------------------------------------------------------------------------------


def write_register(line: BusLine, servo_id: int, register: Register, raw: int) -> Answer:
    """Write the raw value of a register.

    Raises:
        UsageError: The register cannot hold it; nothing was sent.
        LinkError: As `acknowledged`, and so are StoppedError and PreemptedError.
    """
    data = register.encode(in_range(servo_id, register, raw))
    plan = WritePlan(servo_id, line.machine.servos.series_of(servo_id), register.address, data)
    return acknowledged(line, plan, f"a write of {register.name}")


def sync_write_each(line: BusLine, name: str, values: Mapping[int, int]) -> None:
    """Write a register that differs between the servos: one packet for each address and width.

    Raises:
        UsageError: A servo has no such register or it cannot hold its value; nothing was sent.
        StoppedError: The arm was stopped after the call; nothing more was sent.
        PreemptedError: The arm was stopped while a packet was sent.
    """
    # By address and width: the byte order of the data is that of each servo.
    rows: dict[tuple[int, int], dict[int, bytes]] = {}
    for servo_id, value in values.items():
        register = writable(line.machine.servos.series_of(servo_id), servo_id, name)
        data = register.encode(in_range(servo_id, register, value))
        rows.setdefault((register.address, register.size), {})[servo_id] = data
    with line.epochs.calling(name):
        for (address, _), data_of in rows.items():
            line.send(make_sync_write(address, data_of))


def in_range(servo_id: int, register: Register, raw: int) -> int:
    """Check a raw value against the register's range, and return it.

    Raises:
        UsageError: It is outside the range.
    """
    low, high = register.minimum, register.maximum
    if (low is not None and raw < low) or (high is not None and raw > high):
        raise UsageError(f"{register.name} of servo {servo_id} takes {low}..{high}, not {raw}; nothing was sent")
    return raw


_PING_BYTES = 6


class RecentValues:
    """Newest values of registers. Values of the fast path stay in its plans and results, which are searched here.

    Attributes:
        syncs: Newest result of a sync read, by register name; set by the user of this object.
    """

    def __init__(self) -> None:
        self.syncs: dict[str, Readings] = {}
        self._single: dict[tuple[str, int], tuple[int, float]] = {}

    def keep(self, name: str, servo_id: int, raw: int, stamp: float) -> None:
        """Store a value and its time."""
        self._single[name, servo_id] = (raw, stamp)

    def last(self, name: str, servo_id: int, plan: ReadPlan | None) -> tuple[int, float] | None:
        """Return the newest value of a register of a servo and its time; None if it was never read.

        Args:
            name: Register name.
            servo_id: The servo.
            plan: The plan of a single read of it, if there is one; it holds the last value.
        """
        last = self._single.get((name, servo_id))
        if plan is not None and plan.latest is not None and (last is None or plan.stamp > last[1]):
            last = plan.latest, plan.stamp
        newest = self.syncs.get(name)
        if newest is not None and servo_id in newest.ids:
            raw = newest.raw[newest.ids.index(servo_id)]
            if raw is not None and (last is None or newest.stamp > last[1]):
                return raw, newest.stamp
        return last


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

    def open(self, *, settle: bool = True) -> None:
        """Open the link and discard old bytes in it and in the adapter, such as answers to another program.

        Args:
            settle: Wait 20 ms for those in the adapter; not needed where pings come first, see `BusLine.open`.

        Raises:
            LinkError: The link cannot be opened; see `Link.open`.
        """
        self._line.open(settle=settle)

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
        with self._lock:
            data, error = self._line.run(questions.ask_registers(self._machine, servo_id, address, count))
        return ServoBlock(servo_id, address, data, error, "" if data else SILENT)

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
        ids = tuple(servo_ids)
        able = tuple(i for i in ids if self.series_of(i).sync_read)
        found = self._read_together(address, count, able) if able else {}
        for servo_id in ids:
            if servo_id not in found:
                found[servo_id] = self.read_block(servo_id, address, count)
        return [found[servo_id] for servo_id in ids]

    def _read_together(self, address: int, count: int, ids: tuple[int, ...]) -> dict[int, ServoBlock]:
        """Read one block per servo, by id. All of the servos support sync read."""
        line, machine = self._line, self._machine
        plan = machine.plans.block(address, count, ids)
        with self._lock:
            if machine.silent or line.doubted(ids, count):
                return self._blocks_carefully(plan, None)
            try:
                data = line.transact(plan, timed=True)
                rows = plan.blocks(data)
                if rows is None:
                    return self._blocks_carefully(plan, data)
            except BaseException:
                line.gave_up(plan)
                raise
            machine.learn_time(plan, line.clock())
            machine.extra_answers += len(ids) - 1
            return {i: ServoBlock(i, address, row) for i, row in zip(ids, rows, strict=True)}

    # --- writing -----------------------------------------------------------------------------------------------

    def write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit. A goal position switches the torque on and moves the servo.

        Raises:
            UsageError: There is no such register, it is read-only, or cannot hold the value; nothing was sent.
            LinkError: The line has a fault.
        """
        register = writable(self.series_of(servo_id), servo_id, name)
        return write_register(self._line, servo_id, register, register.from_si(value))

    def write_raw(self, servo_id: int, name: str, raw: int) -> Answer:
        """Write the raw value of a register. See `write`."""
        return write_register(self._line, servo_id, writable(self.series_of(servo_id), servo_id, name), raw)

    def write_bytes(self, servo_id: int, address: int, data: bytes) -> Answer:
        """Write neighbouring registers. Only the size of the packet is checked."""
        plan = WritePlan(servo_id, self.series_of(servo_id), address, data)
        return acknowledged(self._line, plan, f"a write at {address}")

    def reg_write(self, servo_id: int, name: str, value: float) -> Answer:
        """Write a register in its SI unit; the value takes effect at `action`. Raises as `write`."""
        register = writable(self.series_of(servo_id), servo_id, name)
        raw = in_range(servo_id, register, register.from_si(value))
        request = packets.make_reg_write(servo_id, register.address, register.encode(raw))
        return order(self._line, servo_id, request, f"a delayed write of {name}")

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
                return sync_write_each(self._line, name, values)
            self._newest_write[name] = plan
        packet = plan.serialize(tuple(values.values()))
        line = self._line
        token = line.epochs.token(name)
        with self._lock:
            line.post(packet, token)
        return None

    def sync_write_bytes(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write neighbouring registers of several servos in one packet. Only the size of the packet is checked."""
        self.post(packets.make_sync_write(address, data))

    def post(self, packet: bytes) -> None:
        """Send a packet that nobody answers and that moves servos, such as a sync write."""
        line = self._line
        # It always acts, so that it need not be asked whether it does.
        token = line.epochs.token("a servo packet")
        with self._lock:
            line.post(packet, token)

    # --- other instructions ------------------------------------------------------------------------------------

    def ping(self, servo_id: int) -> Answer:
        """Ping a servo."""
        with self._lock:
            status, collector = self._line.run(_ping(self._machine, servo_id))
        if status is None:
            return Answer(servo_id, "ping", 0, why(collector.in_words()), False)
        return Answer(servo_id, "ping", status.error)

    def broadcast_ping(self, most: int = 254) -> tuple[tuple[int, ...], int]:
        """Ping all servos at once. Only the answer of a single servo is reliable: several answer at the same time.

        Args:
            most: Number of answers to wait for.

        Returns:
            Ids received, and the number of invalid bytes (such as from a collision).
        """
        line, machine = self._line, self._machine
        with self._lock:
            request = packets.make_ping(BROADCAST_ID)
            base = machine.base(_PING_BYTES * (1 + most), range(min(most, 8)))
            line.link.flush_input()
            data = line.exchange(request, base + machine.timing.allowance)
            now = line.clock()
            while more := line.link.read(now + base):
                data += more
            heard = AnswerCollector(request, range(MAX_SERVO_ID + 1), 0, sent=machine.sent.packets(now))
            heard.receive(data)
            found = set(heard.answers) | set(heard.murky)
            # An answer that may be the echo of an earlier ping: ping the servo alone.
            found |= {servo_id for servo_id in heard.copies - found if not self.ping(servo_id).error}
        data = packets.strip_echo(data, request)
        return tuple(sorted(found)), max(0, len(data) - _PING_BYTES * len(found))

    def restore(self, servo_id: int) -> Answer:
        """Restore factory settings; Feetech servos keep their id.

        Raises:
            NotSupportedError: A legacy servo would lose its id; see `setup.factory_reset`.
        """
        self._must_know(servo_id, "RESTORE")
        if self.series_of(servo_id) is Series.SEVEN_BOT:
            raise NotSupportedError(f"servo {servo_id} is a legacy servo: a factory reset would change its id to 1")
        return order(self._line, servo_id, packets.make_restore(servo_id), "factory reset", repeat=False)

    def reboot(self, servo_id: int) -> None:
        """Restart a servo, without an acknowledgement. It is silent for 0.8 s, and its torque is off.

        Raises:
            NotSupportedError: Its series has no such instruction.
        """
        self._must_know(servo_id, "REBOOT")
        self._line.send(packets.make_reboot(servo_id))

    def backup(self, servo_id: int) -> Answer:
        """Make a servo store its present settings as those of `restore`. Raises as `reboot`."""
        self._must_know(servo_id, "BACKUP")
        return order(self._line, servo_id, packets.make_backup(servo_id), "backup")

    def reset_turns(self, servo_id: int) -> Answer:
        """Clear a servo's turn counter. Raises as `reboot`."""
        self._must_know(servo_id, "RESET_STATE")
        return order(self._line, servo_id, packets.make_reset_state(servo_id), "reset of turns")

    def calibrate(self, servo_id: int, position: int | None = None) -> Answer:
        """Make the present position 2048, or the given count if the firmware accepts one. Nothing moves.

        Raises:
            NotSupportedError: The series has no such instruction.
        """
        self._must_know(servo_id, "CALIBRATE")
        register = self.series_of(servo_id).register("goal_position")
        data = None if position is None else register.encode(position)
        return order(self._line, servo_id, packets.make_calibrate(servo_id, data), "calibration", repeat=False)

    def action(self, servo_id: int = BROADCAST_ID) -> Answer | None:
        """Apply values of `reg_write`, in one servo or, without an acknowledgement, in all."""
        if servo_id == BROADCAST_ID:
            self._line.send(packets.make_action())
            return None
        return order(self._line, servo_id, packets.make_action(servo_id), "action", repeat=False)

    def _must_know(self, servo_id: int, instruction: str) -> None:
        series = self.series_of(servo_id)
        if instruction not in series.instructions:
            raise NotSupportedError(
                f"servo {servo_id} is a {series.value} servo, which has no {instruction.lower()}"
            )

    def ask(self, request: bytes, servo_id: int, params: int) -> tuple[packets.StatusPacket | None, str]:
        """Send any packet once and receive the answer of one servo.

        Args:
            request: The packet.
            servo_id: Id of the answering servo.
            params: Parameter bytes of the answer.

        Returns:
            The status packet or None, and in words what arrived instead; empty if nothing arrived.
        """
        line, machine = self._line, self._machine
        with line.calling(request), self._lock:
            if line.run(_in_doubt(machine, request, servo_id, params)):
                return None, ""
            base = machine.base(len(request) + 6 + params, (servo_id,))
            collector = line.run(machine.collect(request, (servo_id,), params, base, header=None))
        return collector.answers.get(servo_id), collector.in_words()

    def raw(self, request: bytes, servo_ids: Sequence[int] = (), params: int = 0) -> dict[int, bytes]:
        """Send any packet and return the parameters of the answers by servo id.

        Args:
            request: The packet.
            servo_ids: Ids of the answering servos, in order; if empty, the call does not wait.
            params: Parameter bytes of each answer.
        """
        line, machine = self._line, self._machine
        with line.calling(request), self._lock:
            if not servo_ids:
                line.post(request, line.epochs.of_this_call)
                now = line.clock()
                for servo_id, length in _answers_of(request):
                    machine.gave_up((servo_id,), length, request, now, now)
                return {}
            sure = [i for i in servo_ids if not line.run(_in_doubt(machine, request, i, params))]
            base = machine.base(len(request) + len(servo_ids) * (6 + params), servo_ids)
            collector = line.run(machine.collect(request, servo_ids, params, base, header=None))
        return {servo_id: status.params for servo_id, status in collector.answers.items() if servo_id in sure}

    def pause(self, seconds: float) -> None:
        """Wait, and discard bytes that arrive meanwhile."""
        line = self._line
        with self._lock:
            end = line.clock() + seconds
            while line.clock() < end:
                line.link.read(end)

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

    def _blocks_carefully(self, plan: SyncReadPlan, data: bytes | None) -> dict[int, ServoBlock]:
        found = {i: ServoBlock(i, plan.address, b"", 0, SILENT) for i in plan.ids}
        for i, status in self._line.run(questions.ask_many(self._machine, plan, data)).items():
            found[i] = ServoBlock(i, plan.address, status.params, status.error)
        return found

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


def _ping(machine: BusMachine, servo_id: int) -> Conversation[tuple[packets.StatusPacket | None, AnswerCollector]]:
    legacy = machine.servos.series_of(servo_id) is Series.SEVEN_BOT
    if not legacy and (yield from machine.doubted(servo_id, 0)):
        return (yield from questions.is_there(machine, servo_id))
    status, collector = yield from questions.ask_one(
        machine,
        servo_id,
        packets.make_ping(servo_id),
        0,
        base=machine.base(2 * _PING_BYTES, (servo_id,)),
        # An unknown servo may be of either kind.
        header=LEGACY_HEADER if legacy else None,
        retries=machine.retries,
    )
    if status is None and not legacy and servo_id in collector.copies:
        # The answer of a servo with low supply voltage equals its ping.
        return (yield from questions.is_there(machine, servo_id))
    return status, collector


def _in_doubt(machine: BusMachine, request: bytes, servo_id: int, params: int) -> Conversation[bool]:
    """Whether the answer to a request could be a late one, and no further request can exclude that."""
    if not (yield from machine.doubted(servo_id, params, request)):
        return False
    return not (yield from questions.settle(machine, servo_id, params))


def _answers_of(request: bytes) -> list[tuple[int, int]]:
    """Return the servos that answer a packet, and their numbers of parameter bytes; empty for an invalid packet."""
    try:
        expected = expected_answer(packets.parse_packet(request))
    except RemoteProtocolError:
        return []
    return [(servo_id, expected.params) for servo_id in expected.servo_ids]
