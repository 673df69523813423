"""No wrong value from a servo bus: asks for millions of values on a line with every combination of faults.

``python -m tests.property.servo_values 1000000`` prints a row for each combination and ends with status 1 if a
value was wrong. `test_servo_values` runs a small part of it.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from multiprocessing import Pool

from tests.property.dialect1_values import Noise, all_noise, ask_board
from tests.property.servo_line import Faults, FaultyLine, MemoryServo, all_faults

from hexwire.bus.servo_bus import ServoBus
from hexwire.wire.registers import Register, Series

__all__ = ["ask", "main", "table"]

_NAMES = (
    "present_position",
    "present_speed",
    "present_voltage",
    "present_temperature",
    "goal_position",
    "torque_enable",
)
_TOTAL = "all together"
_CALLS = 60
"""Calls on one bus before the next is set up."""
_KINDS = (
    [Series.STS_SMS],
    [Series.STS_SMS],
    [Series.SCS],
    [Series.SEVEN_BOT],
    [Series.STS_SMS, Series.HLS, Series.SCS, Series.SEVEN_BOT],
)


def ask(faults: Faults, values: int, seed: int, calls: int = _CALLS) -> Counter[str]:
    """Ask for so many values and count them: right, missing, wrong, and forged by damage beyond a checksum."""
    count: Counter[str] = Counter()
    dice = random.Random(f"{seed}/{faults}")
    while count["asked"] < values:
        _one_bus(faults, dice, count, calls)
    return count


def _one_bus(faults: Faults, dice: random.Random, count: Counter[str], calls: int) -> None:
    kinds = dice.choice(_KINDS)
    ids = dice.sample(range(254), dice.choice((1, 2, 4)))
    servos = [MemoryServo(i, kinds[k % len(kinds)], dice) for k, i in enumerate(ids)]
    line = FaultyLine(servos, faults, dice)
    bus = ServoBus(line, servos={s.servo_id: s.series for s in servos}, retries=dice.choice((0, 1, 2, 2)))
    bus.open()
    for _ in range(calls):
        for servo in servos:
            servo.live()
        if dice.random() < 0.1:
            line.clock.time += dice.choice((0.001, 0.01, 0.1))
        line.listen()
        _call(bus, line, servos, dice, count)


def _call(
    bus: ServoBus, line: FaultyLine, servos: list[MemoryServo], dice: random.Random, count: Counter[str]
) -> None:
    kind = dice.choice(("read", "read", "sync", "sync", "block", "blocks", "ping", "write"))
    servo = dice.choice(servos)
    able = [s for s in servos if "goal_position" in s.series.registers]
    if kind == "read":
        name = dice.choice([n for n in _NAMES if n in servo.series.registers])
        reading = bus.read(servo.servo_id, name)
        _judge(line, servo, reading.register.address, reading.register, reading.raw, reading.status, count)
    elif kind == "sync" and able:
        name = dice.choice(_NAMES)
        for reading, one in zip(bus.sync_read(name, tuple(s.servo_id for s in able)), able, strict=True):
            _judge(line, one, reading.register.address, reading.register, reading.raw, reading.status, count)
    elif kind == "block":
        block = bus.read_block(servo.servo_id, 56, dice.choice((2, 4, 8)))
        _judge_bytes(line, servo, block.address, block.data, block.status, count)
    elif kind == "blocks":
        for block, one in zip(
            bus.sync_read_blocks(56, dice.choice((2, 6)), [s.servo_id for s in servos]), servos, strict=True
        ):
            _judge_bytes(line, one, block.address, block.data, block.status, count)
    elif kind == "ping":
        answer = bus.ping(servo.servo_id)
        count["asked"] += 1
        _count(line, servo, not answer.error, answer.status == servo.error, b"", count)
    elif kind == "write" and not servo.legacy:
        servo.written.clear()
        value = dice.randrange(200)
        answer = bus.write_raw(servo.servo_id, "torque_enable", value & 1)
        count["asked"] += 1
        there = answer.confirmed and not answer.error
        done = bool(servo.written) or servo.memory[servo.series.register("torque_enable").address] == value & 1
        _count(line, servo, there, done and answer.status == servo.error, b"", count)


def _judge(
    line: FaultyLine,
    servo: MemoryServo,
    at: int,
    register: Register,
    raw: int | None,
    status: int,
    count: Counter[str],
) -> None:
    data = bytes(servo.memory[at : at + register.size])
    count["asked"] += 1
    right = raw == register.decode(data) and status == servo.error
    _count(
        line,
        servo,
        raw is not None,
        right,
        b"" if raw is None or raw not in register.fits else register.encode(raw),
        count,
    )


def _judge_bytes(
    line: FaultyLine, servo: MemoryServo, at: int, data: bytes, status: int, count: Counter[str]
) -> None:
    count["asked"] += 1
    right = data == servo.memory[at : at + len(data)] and status == servo.error
    _count(line, servo, bool(data), right, data, count)


def _count(
    line: FaultyLine, servo: MemoryServo, there: bool, right: bool, data: bytes, count: Counter[str]
) -> None:
    if not there:
        count["missing"] += 1
    elif right:
        count["right"] += 1
    elif line.forged(servo.servo_id, data):
        count["forged"] += 1
    else:
        count["wrong"] += 1


def table(rows: Iterable[tuple[object, Counter[str]]]) -> Iterator[str]:
    """Lines for people, and their sum."""
    total: Counter[str] = Counter()
    yield f"{'faults':56} {'asked':>9} {'right':>9} {'missing':>8} {'forged':>6} {'wrong':>5}"
    for faults, count in rows:
        total += count
        yield _row(str(faults), count)
    yield _row(_TOTAL, total)


def _row(name: str, c: Counter[str]) -> str:
    return f"{name:56} {c['asked']:9} {c['right']:9} {c['missing']:8} {c['forged']:6} {c['wrong']:5}"


def _work(task: tuple[Faults | Noise, int, int]) -> tuple[object, Counter[str]]:
    faults, values, seed = task
    return faults, ask(faults, values, seed) if isinstance(faults, Faults) else ask_board(faults, values, seed)


def main() -> int:
    """Ask as many values as the command line says, spread over all combinations."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument(
        "values", type=int, nargs="?", default=100_000, help="how many in all (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="for everything random (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    options = parser.parse_args()
    combinations = [*all_faults(), *all_noise()]
    each = max(1, options.values // len(combinations))
    start = time.monotonic()
    last = ""
    with Pool(options.jobs) as pool:
        for last in table(pool.imap(_work, [(faults, each, options.seed) for faults in combinations])):
            print(last, flush=True)
    print(f"{time.monotonic() - start:.0f} s; forged: damage made a sound answer, which no receiver can tell")
    return 1 if int(last.split()[-1]) else 0


if __name__ == "__main__":
    sys.exit(main())
