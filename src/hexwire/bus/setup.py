"""Setup of servos: identification, ids, rates, stored settings, centring, and recovery after an overload.

Owns the safe order of such steps: each is verified, and undone if it fails. Moves nothing. Works on a `ServoBus`
and asks for no confirmation; that is the caller's task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from hexwire.errors import NotSupportedError, ServoError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_ping, make_read, make_write

from .servo_bus import ServoBus
from .values import Answer, fault_words

__all__ = [
    "Found",
    "ServoInfo",
    "center",
    "identify",
    "recover",
    "scan",
    "set_baud",
    "set_id",
    "shares_id",
    "torque_off",
    "unlocked",
    "write_setting",
]

_EEPROM_TIME = 0.02
"""Seconds until a stored setting takes effect, with a margin; a servo receives nothing while it writes."""
_LATE = 0.1
"""Seconds after which a late answer has arrived, even on a computer that stalls."""
_LOOKS = 4
"""Number of times that a servo is looked for after a change; a second in all."""
_COLLISION_READS = 6
_CALIBRATE_MID = 128
_LIVE_FIRST, _LIVE_COUNT = 56, 15
_LIMITS_FIRST, _LIMITS_COUNT = 9, 24
"""Limits and offset, which differ in two calibrated servos."""
_CALIBRATE_FIRMWARE = (3, 10)
_SCAN_ALLOWANCE = 0.008
_MODEL_NAMES = {777: "sts3215", 2825: "sts3250", 2570: "hls3606", 1284: "scs009", 11272: "sm8512bl"}
"""Registers 3 and 4 as a little-endian word (vendor tool and public tables)."""


class ServoInfo(NamedTuple):
    """Identity and settings of a servo.

    Attributes:
        servo_id: Its id.
        series: Its series; None if its firmware has no table here.
        firmware: As in ``3.10``; empty for a legacy servo, which does not report it.
        model: Registers 3 and 4 as a little-endian word; None if not reported.
        baud: Its line rate; 0 if not reported.
        acknowledges: Whether it acknowledges writes.
        return_delay: Seconds it waits before an answer.
        status: Its error byte.
    """

    servo_id: int
    series: Series | None
    firmware: str
    model: int | None
    baud: int
    acknowledges: bool
    return_delay: float
    status: int

    @property
    def model_name(self) -> str:
        """As in ``sts3215``; the number if it has no name here."""
        return "" if self.model is None else _MODEL_NAMES.get(self.model, str(self.model))


class Found(NamedTuple):
    """A servo that a scan found.

    Attributes:
        info: Its identity; None if it answers pings but no reads.
        servo_id: Its id.
        baud: Rate at which it answered.
        shared: Several servos seem to have this id.
    """

    info: ServoInfo | None
    servo_id: int
    baud: int
    shared: bool


def identify(bus: ServoBus, servo_id: int) -> ServoInfo | None:
    """Identify a servo, and apply its series, return delay and acknowledgement of writes to the bus.

    Returns:
        The identity; None if the servo does not answer.
    """
    head = None
    for _ in range(1 + bus.retries):
        head, _instead = bus.ask(make_read(servo_id, 0, 9), servo_id, 9)
        if head is not None:
            break
    if head is None:
        return _identify_legacy(bus, servo_id)
    data = head.params
    series = Series.from_firmware(data[0], data[1], "big" if data[2] else "little")
    codes = (series or Series.STS_SMS).baud_codes
    # Register return_delay has no effect on STS, and on HLS it is the second id.
    delay = data[7] * 2e-6 if series is Series.SCS else 500e-6
    if series is not None:
        bus.set_series(servo_id, series)
        bus.set_return_delay(servo_id, delay)
        bus.set_acknowledges(servo_id, bool(data[8]))
    model = data[3] | data[4] << 8
    firmware = f"{data[0]}.{data[1]}"
    return ServoInfo(servo_id, series, firmware, model, codes.get(data[6], 0), bool(data[8]), delay, head.error)


def _identify_legacy(bus: ServoBus, servo_id: int) -> ServoInfo | None:
    request = make_read(servo_id, Series.SEVEN_BOT.register("present_position").address, 2)
    status = None
    for _ in range(1 + bus.retries):
        status, _instead = bus.ask(request, servo_id, 2)
        if status is not None:
            break
    if status is None:
        return None
    series = Series.SEVEN_BOT if status.legacy else None
    if series is not None:
        bus.set_series(servo_id, series)
    return ServoInfo(servo_id, series, "", None, bus.timing.baud if series else 0, False, 500e-6, status.error)


def scan(
    bus: ServoBus,
    *,
    bauds: Iterable[int] = (),
    ids: Iterable[int] = range(254),
    progress: Callable[[int, int, int], None] | None = None,
    allowance: float = _SCAN_ALLOWANCE,
) -> list[Found]:
    """Ping every id at every rate. The bus returns to its previous rate.

    Args:
        bus: The bus.
        bauds: Rates to try; only the present one if empty.
        ids: Ids to try.
        progress: Called before each ping with the rate, the id and the number of servos found.
        allowance: Seconds for the adapter; the measured value replaces it after the first answer.

    Returns:
        One row per servo, in the order found. Several servos with one id give one row, marked as shared.
    """
    found: list[Found] = []
    wanted, first_baud, retries = list(ids), bus.timing.baud, bus.retries
    rates = list(bauds) or [first_baud]
    try:
        for baud in rates:
            if baud != bus.timing.baud:
                bus.set_baud(baud)
            bus.timing.allowance = max(allowance, min(bus.timing.allowance, 0.02) if bus.timing.holds_back else 0.0)
            for servo_id in wanted:
                if progress is not None:
                    progress(baud, servo_id, len(found))
                bus.retries = 0
                answered = _hears(bus, servo_id)
                bus.retries = max(1, retries)
                if answered:
                    info = identify(bus, servo_id)
                    found.append(Found(info, servo_id, baud, shares_id(bus, servo_id)))
    finally:
        bus.retries = retries
        if bus.timing.baud != first_baud:
            bus.set_baud(first_baud)
    return found


def _hears(bus: ServoBus, servo_id: int) -> bool:
    """Whether any bytes answer a ping, valid or not: two servos with one id corrupt each other's answers."""
    answer = bus.ping(servo_id)
    if answer.ok or not answer.error:
        return True
    if "only the echo" in answer.error or "but" not in answer.error:
        return False
    # The bytes may be a late answer to an earlier request: only an answer to this id that is repeatable counts.
    bus.pause(_LATE)
    status, again = bus.ask(make_ping(servo_id), servo_id, 0)
    return status is not None or (bool(again) and "answer of servo" not in again and "echo" not in again)


def shares_id(bus: ServoBus, servo_id: int) -> bool:
    """Whether several servos seem to have this id: their answers collide if their values differ.

    Two servos with equal values in all registers read (position, voltage, offset, limits, ...) look like one.
    """
    if bus.series_of(servo_id) is Series.SEVEN_BOT:
        return _collide(bus, servo_id, _LIVE_FIRST, 2)
    return _collide(bus, servo_id, _LIVE_FIRST, _LIVE_COUNT) or _collide(
        bus, servo_id, _LIMITS_FIRST, _LIMITS_COUNT
    )


def _collide(bus: ServoBus, servo_id: int, first: int, count: int) -> bool:
    """Whether most answers to a read are spoiled."""
    spoiled = 0
    for _ in range(_COLLISION_READS):
        status, instead = bus.ask(make_read(servo_id, first, count), servo_id, count)
        if status is None and instead and "echo" not in instead:
            spoiled += 1
    return spoiled > _COLLISION_READS // 2


@contextmanager
def unlocked(bus: ServoBus, servo_id: int) -> Iterator[None]:
    """Unlock stored settings for a `with` block, and lock them again in any case. Legacy servos have no lock."""
    if "lock" not in bus.series_of(servo_id).registers:
        yield
        return
    _faultless(bus.write_raw(servo_id, "lock", 0))
    try:
        yield
    finally:
        bus.write_raw(servo_id, "lock", 1)


def read_raw(bus: ServoBus, servo_id: int, name: str) -> int:
    """The raw value of a register; a servo that reports a fault has it, too.

    Raises:
        ServoError: It does not answer.
    """
    raw = bus.read(servo_id, name).raw
    if raw is None:
        raise ServoError(f"servo {servo_id} does not answer", servo_id=servo_id)
    return raw


def write_setting(bus: ServoBus, servo_id: int, name: str, raw: int) -> None:
    """Store a setting permanently and verify it.

    Raises:
        ServoError: The servo does not answer, or has another value afterwards.
        UsageError: There is no such register, or it refuses the value; ids and rates have separate calls.
    """
    if name in ("id", "baud_code"):
        raise UsageError(f"{name} is not written like this: use set-{'id' if name == 'id' else 'baud'}")
    with unlocked(bus, servo_id):
        _faultless(bus.write_raw(servo_id, name, raw))
        bus.pause(_EEPROM_TIME)
    now = bus.read(servo_id, name)
    if now.raw != raw:
        what = "is silent" if now.raw is None else f"has {now.raw}"
        raise ServoError(f"servo {servo_id} {what} after {name} was set to {raw}: read it again", servo_id=servo_id)


def write_stored(bus: ServoBus, servo_id: int, address: int, data: bytes) -> None:
    """Store neighbouring settings permanently, in one packet, and verify them.

    Raises:
        ServoError: The servo does not answer, or has other values afterwards.
    """
    with unlocked(bus, servo_id):
        _faultless(bus.write_bytes(servo_id, address, data))
        bus.pause(_EEPROM_TIME)
    now = bus.read_block(servo_id, address, len(data)).data
    if now != data:
        what = "has other values" if now else "is silent"
        raise ServoError(f"servo {servo_id} {what} after a write at {address}: read it again", servo_id=servo_id)


def _faultless(answer: Answer) -> None:
    """Check a write, but accept a reported fault: a servo with an overload still stores the value."""
    if answer.error:
        answer.check()


def _must_be_there(bus: ServoBus, servo_id: int) -> ServoInfo:
    info = identify(bus, servo_id)
    if info is None:
        raise ServoError(f"servo {servo_id} does not answer: check cable, power, id and rate", servo_id=servo_id)
    if shares_id(bus, servo_id):
        raise ServoError(f"several servos seem to have id {servo_id}: connect one of them alone", servo_id=servo_id)
    return info


def set_id(bus: ServoBus, old: int, new: int) -> ServoInfo:
    """Give a servo another id.

    Nothing is written unless the servo answers, is the only one with its id, and the new id is free. Afterwards it
    must answer to the new id and not to the old one.

    Raises:
        UsageError: An id is invalid, or both are equal.
        ServoError: One of the conditions does not hold; the text says whether anything changed.
    """
    series = bus.series_of(old)
    high = 250 if series is Series.SEVEN_BOT else 253
    if not 0 <= new <= high:
        raise UsageError(f"id {new} is outside 0..{high}")
    if old == new:
        raise UsageError(f"servo {old} has that id already")
    info = _must_be_there(bus, old)
    # A servo with a fault, or several whose answers collide, take an id as well as one that answers in order.
    if _hears(bus, new):
        raise ServoError(f"id {new} is taken: nothing was changed", servo_id=new)
    register = bus.series_of(old).register("id")
    has_lock = "lock" in bus.series_of(old).registers
    if has_lock:
        _unlock(bus, old)
    # The id of the acknowledgement differs between firmwares, so this write is verified by its effect.
    bus.raw(make_write(old, register.address, bytes((new,))))
    bus.pause(_EEPROM_TIME)
    bus.set_series(new, info.series or series)
    bus.set_acknowledges(new, info.acknowledges)
    for turn in range(_LOOKS):
        if not bus.ping(new).error:
            if has_lock:
                _faultless(bus.write_raw(new, "lock", 1))
            if not bus.ping(old).error:
                raise ServoError(f"servo {new} answers, but so does {old}: two servos had id {old}", servo_id=old)
            return info._replace(servo_id=new)
        if not bus.ping(old).error:
            if has_lock:
                bus.write_raw(old, "lock", 1)
            raise ServoError(f"servo {old} did not accept id {new}; it still has {old}", servo_id=old)
        # It may be silent for a moment; a write under either id could reach another servo meanwhile.
        bus.pause(_LATE * (1 + turn))
    raise ServoError(
        f"servo {old} answers neither to {old} nor to {new}: switch its supply off and on, then scan for it",
        servo_id=old,
    )


def set_baud(bus: ServoBus, servo_id: int, baud: int) -> None:
    """Set a servo and the bus to another line rate.

    The servo must answer at the new rate; otherwise servo and bus return to the old rate.

    Raises:
        UsageError: The series has no such rate.
        NotSupportedError: The link or the series has no adjustable rate.
        ServoError: The change failed; the text says the servo's present rate.
    """
    info = _must_be_there(bus, servo_id)
    series = bus.series_of(servo_id)
    codes = {rate: code for code, rate in series.baud_codes.items()}
    if not codes:
        raise NotSupportedError(f"servo {servo_id} is a {series.value} servo, whose rate is fixed")
    if baud not in codes:
        rates = ", ".join(map(str, sorted(codes)))
        raise UsageError(f"{series.value} servos support {rates} baud, not {baud}")
    before = bus.timing.baud
    if getattr(bus.link, "set_baud", None) is None:
        raise NotSupportedError(f"{bus.link.url} has no line rate that could be changed with the servo's")
    register = series.register("baud_code")
    _unlock(bus, servo_id)
    # The acknowledgement may arrive at either rate, so verify the rate at which the servo answers afterwards.
    bus.raw(make_write(servo_id, register.address, bytes((codes[baud],))))
    bus.pause(_EEPROM_TIME)
    bus.set_baud(baud)
    if _uses(bus, servo_id, codes[baud]):
        bus.write_raw(servo_id, "lock", 1)
        return
    # It may have changed its rate without a readable answer: restore the rate without an answer, then check it.
    old_code = codes.get(info.baud, register.default or 0)
    bus.raw(make_write(servo_id, register.address, bytes((old_code,))))
    bus.pause(_EEPROM_TIME)
    for turn in range(_LOOKS):
        bus.set_baud(before)
        if not bus.ping(servo_id).error:
            bus.write_raw(servo_id, "baud_code", old_code)
            bus.write_raw(servo_id, "lock", 1)
            raise ServoError(
                f"servo {servo_id} does not answer at {baud} baud; it still uses {before}", servo_id=servo_id
            )
        # It may have been silent for a moment only, and have heard the change but not the way back.
        bus.set_baud(baud)
        if _uses(bus, servo_id, codes[baud]):
            bus.write_raw(servo_id, "lock", 1)
            return
        bus.pause(_LATE * (1 + turn))
    bus.set_baud(before)
    raise ServoError(
        f"servo {servo_id} answers neither at {before} nor at {baud} baud: switch its supply off and on, then scan "
        "for it",
        servo_id=servo_id,
    )


def _uses(bus: ServoBus, servo_id: int, code: int) -> bool:
    """Whether a servo answers at the bus's rate, and has stored it."""
    return not bus.ping(servo_id).error and bus.read(servo_id, "baud_code").raw == code


def _unlock(bus: ServoBus, servo_id: int) -> None:
    """Unlock stored settings; if the servo does not confirm it, lock them again.

    Raises:
        ServoError: It does not confirm it, or has a fault.
    """
    answer = bus.write_raw(servo_id, "lock", 0)
    if not answer.ok:
        bus.write_raw(servo_id, "lock", 1)
        answer.check()


def center(bus: ServoBus, servo_id: int) -> int:
    """Make the present position of a servo the middle of its range. Nothing moves; the torque must be off.

    With the torque on, the servo would immediately drive to its old goal, which is another position now.

    Returns:
        The position that it reports afterwards, encoder counts.

    Raises:
        ServoError: It has torque, does not answer, or reports another position than the middle.
        NotSupportedError: This series has no such function.
    """
    info = _must_be_there(bus, servo_id)
    series = bus.series_of(servo_id)
    if series not in (Series.STS_SMS, Series.HLS):
        raise NotSupportedError(f"a {series.value} servo cannot set its middle; use the offset in the arm's file")
    if bus.read(servo_id, "torque_enable").raw != 0:
        raise ServoError(f"servo {servo_id} has torque: switch it off first, it would jump", servo_id=servo_id)
    version = tuple(int(part) for part in info.firmware.split("."))
    if series is Series.HLS or version >= _CALIBRATE_FIRMWARE:
        _faultless(bus.calibrate(servo_id))
    else:
        _faultless(bus.write_raw(servo_id, "torque_enable", _CALIBRATE_MID))
    bus.pause(_EEPROM_TIME)
    now = bus.read(servo_id, "present_position").raw
    if now is None or abs(now - series.neutral) > 8:
        raise ServoError(f"servo {servo_id} reports position {now} after it was centred", servo_id=servo_id)
    if bus.read(servo_id, "torque_enable").raw != 0:
        bus.write_raw(servo_id, "torque_enable", 0)
    return now


def torque_off(bus: ServoBus, servo_ids: Sequence[int]) -> tuple[int, ...]:
    """Switch the torque of several servos off, each independently of the others.

    Returns:
        Ids of servos that do not confirm it.
    """
    bus.sync_write_raw("torque_enable", dict.fromkeys(servo_ids, 0))
    unsure = []
    for reading in bus.sync_read("torque_enable", servo_ids) if servo_ids else ():
        if reading.raw != 0:
            bus.write_raw(reading.servo_id, "torque_enable", 0)
            if bus.read(reading.servo_id, "torque_enable").raw != 0:
                unsure.append(reading.servo_id)
    return tuple(unsure)


def recover(bus: ServoBus, servo_id: int, *, patience: float = 3.0) -> tuple[str, ...]:
    """End a servo's overload protection: switch its torque off, then wait until the fault clears.

    The joint loses its torque: hold its load. The torque stays off; switching it on holds the present position.

    Args:
        bus: The bus.
        servo_id: The servo.
        patience: Seconds to wait for the fault to clear.

    Returns:
        Names of the remaining faults, such as a low supply or a hot motor; empty if there are none.

    Raises:
        ServoError: It does not answer, or keeps its torque.
    """
    if torque_off(bus, (servo_id,)):
        raise ServoError(f"servo {servo_id} does not confirm that its torque is off", servo_id=servo_id)
    status = 0
    for _ in range(max(1, round(patience / 0.1))):
        answer = bus.ping(servo_id)
        if answer.error:
            answer.check()
        status = answer.status
        if not status:
            return ()
        bus.pause(0.1)
    return fault_words(status)
