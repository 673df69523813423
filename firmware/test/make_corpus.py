"""Writes the seeds of the fuzz target into corpus/: known attacks, in the format that fuzz_board.cpp reads.

python firmware/test/make_corpus.py
"""

from __future__ import annotations

from pathlib import Path

CORPUS = Path(__file__).with_name("corpus")

# First byte of an input: flags of the set-up. Second byte: the servos they apply to.
DIALECT_1, TORQUE_AT_START, OTHER_MODE, SETTLE, END_LIMP = 1, 2, 4, 8, 16
# Time that passes after an action: 200 us times n^3 + 1.
AT_ONCE, SHORT, WHILE, LONG = 0, 3, 7, 15
# Commands that carry a packet, with their flags.
TRANSACT, READ, SYNC_WRITE, CHAPTER, ANSWERED = 0, 1, 2, 4, 8
PING, READ_IT, WRITE, REG_WRITE, ACTION, RESTORE, SYNC_READ, SYNC = 0, 1, 2, 3, 4, 5, 10, 11
ALL = 0x7F


def do(what: int, *arguments: int | bytes, then: int = WHILE) -> bytes:
    """One action: its number, the time to wait afterwards, its arguments."""
    data = b"".join(bytes((a,)) if isinstance(a, int) else a for a in arguments)
    return bytes((what | then << 4,)) + data


def u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


def packet(way: int, servo_id: int, instruction: int, parameters: bytes = b"", then: int = WHILE) -> bytes:
    return do(1, way, servo_id, instruction, len(parameters), parameters, then=then)


def write(way: int, servo_id: int, address: int, data: bytes, then: int = WHILE) -> bytes:
    return do(2, way, servo_id, address, len(data), data, then=then)


def sync_write(way: int, address: int, rows: dict[int, bytes], then: int = WHILE) -> bytes:
    each = len(next(iter(rows.values())))
    data = b"".join(bytes((i,)) + row for i, row in rows.items())
    return do(3, way, address, each, len(rows), data, then=then)


def move(position: int, duration: int = 300, then: int = WHILE) -> bytes:
    return do(4, u16(duration), ALL, u16(position) * 7, then=then)


def torque(mask: int = ALL, then: int = WHILE) -> bytes:
    return do(5, mask, then=then)


def stop(mode: int = 0, then: int = LONG) -> bytes:
    return do(6, mode, then=then)


def resume(then: int = WHILE) -> bytes:
    return do(7, then=then)


def again(ago: int, then: int = WHILE) -> bytes:
    """Send the frame of so many frames ago again."""
    return do(13, ago, then=then)


def watchdog(ms: int, then: int = WHILE) -> bytes:
    return do(8, ms, then=then)


def maintenance(on: int, then: int = WHILE) -> bytes:
    return do(9, on, then=then)


def limits(low: int, speed: int) -> bytes:
    return do(10, low // 8, (speed - 100) // 16, then=LONG)


# Parts of a trajectory.
HERMITE, OUTLIVES, BEGIN, POINTS, START, LAST, ABORT, STATUS = 1, 2, 4, 8, 16, 32, 64, 128


def path(
    how: int, steps: list[int] | None = None, ticks: int = 500, first: bool = True, then: int = SHORT
) -> bytes:
    """Parts of a trajectory of all joints; each step is a way of four counts a unit."""
    data = bytes((how, ALL))
    if how & BEGIN:
        data += b"\xb4"
    if how & POINTS:
        rows = steps or []
        data += bytes((len(rows) + first,))
        if first:
            data += b"\0" * 7 if how & HERMITE else b""
        for step in rows:
            data += u16(ticks) + (bytes((step & 0xFF, 0)) if how & HERMITE else bytes((step & 0xFF,))) * 7
    return do(15, 200, data, then=then)


STATS = do(0, 8, 0, then=SHORT)
SLOW = packet(TRANSACT | ANSWERED, 9, PING, then=AT_ONCE)
"""A ping that no servo answers."""

SEEDS = {
    "queued-before-a-stop": bytes((SETTLE, 0))
    + torque()
    + SLOW * 3
    + resume(AT_ONCE)
    + move(2500, then=AT_ONCE)
    + do(0, 10, 2, b"\7\7", then=AT_ONCE)
    + stop(),
    "queued-before-a-trip": bytes((SETTLE, 0))
    + torque()
    + watchdog(60, AT_ONCE)
    + SLOW * 8
    + resume(AT_ONCE)
    + move(2500),
    "voided-comes-again": bytes((SETTLE, 0))
    + torque()
    + SLOW
    + move(2500, then=AT_ONCE)
    + stop()
    + resume()
    + again(2),
    "done-comes-again": bytes((SETTLE, 0)) + stop() + resume() + stop() + STATS * 5 + again(6),
    "voided-torque-comes-again": bytes((SETTLE, 0)) + SLOW + torque(then=AT_ONCE) + stop() + resume() + again(2),
    "torque-in-maintenance": bytes((SETTLE | DIALECT_1, 0))
    + maintenance(1)
    + write(READ | CHAPTER, 4, 40, b"\1")
    + write(READ | CHAPTER, 0, 40, b"\1"),
    "waiting-beyond-limits": bytes((SETTLE | DIALECT_1, 0))
    + limits(1400, 900)
    + torque()
    + packet(TRANSACT, 4, REG_WRITE, b"\x2a" + u16(3900))
    + packet(TRANSACT, 4, ACTION)
    + packet(READ | CHAPTER, 5, REG_WRITE, b"\x2a" + u16(3900))
    + packet(READ | CHAPTER, 0xFE, ACTION),
    "waiting-over-a-stop": bytes((SETTLE, 0))
    + torque()
    + packet(TRANSACT, 4, REG_WRITE, b"\x2a" + u16(2000))
    + stop(1)
    + resume()
    + packet(TRANSACT, 0xFE, ACTION),
    "rows-of-255-from-0": bytes((SETTLE | DIALECT_1, 0))
    + b"".join(
        packet(way, 0xFE, SYNC, b"\0\xff" + bytes(range(n)))
        for way in (TRANSACT, READ, SYNC_WRITE, READ | CHAPTER, SYNC_WRITE | CHAPTER)
        for n in (1, 4, 80)
    ),
    "flood-of-stops": bytes((SETTLE, 0)) + torque() + move(3000, 50) + stop(0, SHORT) * 12 + stop(1, AT_ONCE) * 8,
    "turning-at-start": bytes((TORQUE_AT_START | OTHER_MODE, 0x71)),
    "current-at-start": bytes((TORQUE_AT_START | OTHER_MODE, 0x72)) + stop() + resume() + torque(),
    "mode-of-a-servo": bytes((SETTLE, 0))
    + torque()
    + write(TRANSACT, 4, 33, b"\1")
    + sync_write(READ, 33, {5: b"\2"})
    + stop(),
    "mode-in-maintenance": bytes((SETTLE | DIALECT_1, 0))
    + maintenance(1)
    + write(TRANSACT, 4, 33, b"\1")
    + write(TRANSACT, 5, 7, b"\4")
    + maintenance(0)
    + torque()
    + write(READ | CHAPTER, 4, 42, u16(2300))
    + write(READ | CHAPTER, 4, 40, b"\1")
    + stop(),
    "maintenance-and-motion": bytes((SETTLE, 0))
    + maintenance(1)
    + torque()
    + move(2000)
    + write(TRANSACT, 8, 42, u16(2000))
    + stop()
    + maintenance(1),
    "targets-without-torque": bytes((SETTLE, 0))
    + sync_write(SYNC_WRITE, 42, {i: u16(2000) + u16(0) for i in range(7)})
    + write(TRANSACT, 4, 41, b"\0" + u16(2000) + u16(100) + u16(500))
    + write(READ, 0, 42, b"\7\xd0\0\0")
    + write(TRANSACT, 4, 40, b"\1"),
    "targets-in-dialect-1": bytes((SETTLE | DIALECT_1, 0))
    + limits(1200, 300)
    + sync_write(SYNC_WRITE | CHAPTER, 42, {i: u16(2400) + u16(0) for i in range(7)}, then=LONG)
    + write(READ | CHAPTER, 4, 42, u16(2600))
    + write(READ | CHAPTER, 0, 42, b"\7\xd0")
    + write(READ | CHAPTER, 0, 40, b"\1")
    + stop(1)
    + write(READ | CHAPTER, 4, 42, u16(1600)),
    "targets-too-fast": bytes((SETTLE, 0))
    + limits(1200, 500)
    + torque()
    + move(2600, 0, LONG)
    + write(TRANSACT, 0, 42, b"\6\x40\0\1")
    + write(TRANSACT, 4, 41, b"\0" + u16(1400) + u16(100) + u16(0x7FFF))
    + sync_write(TRANSACT, 42, {4: u16(1300), 5: u16(2690)})
    + sync_write(TRANSACT, 42, {0: b"\4\xb0", 1: b"\7\xd0"})
    + write(TRANSACT, 4, 46, u16(900)),
    "targets-beyond-limits": bytes((SETTLE, 0))
    + limits(1400, 900)
    + torque()
    + move(0)
    + move(8000)
    + write(TRANSACT, 4, 42, u16(3900))
    + write(READ, 8, 42, u16(1500))
    + sync_write(TRANSACT, 43, {4: b"\4"}),
    "waiting-in-a-servo": bytes((SETTLE, 0))
    + torque()
    + packet(TRANSACT, 4, REG_WRITE, b"\x2a" + u16(2500))
    + stop()
    + packet(TRANSACT, 0xFE, ACTION),
    "rows-of-255": bytes((SETTLE | DIALECT_1, 0))
    + b"".join(
        packet(way, 0xFE, SYNC, b"\x2a\xff" + bytes(range(n)))
        for way in (TRANSACT, READ, SYNC_WRITE, READ | CHAPTER, SYNC_WRITE | CHAPTER)
        for n in (0, 4, 80)
    ),
    "hostile-fields": bytes((SETTLE | DIALECT_1, 0))
    + b"".join(
        packet(way, i, instruction, data, AT_ONCE)
        for way in (TRANSACT, READ | CHAPTER)
        for i in (4, 0xFE, 0xFD)
        for instruction, data in (
            (WRITE, b""),
            (WRITE, b"\xff\1\2"),
            (SYNC, b"\x2a\0\1"),
            (READ_IT, b"\x38\xff"),
            (SYNC_READ, b"\x38\xff\4\5"),
            (RESTORE, b""),
            (15, b"\1"),
        )
    ),
    "limits-under-way": bytes((SETTLE, 0))
    + torque()
    + limits(1000, 900)
    + move(2300, 0, AT_ONCE)
    + do(0, 6, 43, b"\7" + (u16(1900) + u16(2000) + u16(200)) * 7, then=SHORT)
    + stop()
    + resume()
    + limits(800, 2000)
    + move(1500, 0),
    "reports-and-noise": bytes((SETTLE, 0))
    + do(0, 2, 3, b"\5\0\x3f")
    + torque()
    + do(11, 5, b"\x5a\xfa\xfa\x5a\1")
    + move(2000)
    + do(12, 8, b"\xff\xf5\0\4\0\1\2\xf8")
    + stop(1),
    "silent-servo": bytes((SETTLE, 0))
    + torque()
    + do(14, 2)
    + move(2300, 800)
    + stop()
    + do(14, 2)
    + resume()
    + stop(1),
    "trajectory": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN | POINTS | START | LAST, [5, 10, 10, 5], then=LONG)
    + path(BEGIN | HERMITE | POINTS | LAST, [5, 10, 10, 5])
    + path(HERMITE | START | STATUS, then=LONG),
    "trajectory-over-a-stop": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN | POINTS | START, [10, 10, 10, 10, 10], 4000)
    + stop(0, SHORT)
    + resume(AT_ONCE)
    + path(POINTS | START, [10], first=False)
    + again(1)
    + again(4),
    "trajectory-runs-dry": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN | POINTS | START, [10, 10, 10, 10, 10], 4000, then=LONG)
    + path(POINTS, [10, 10], first=False, then=LONG),
    "trajectory-and-others": bytes((SETTLE | DIALECT_1, 0))
    + torque()
    + path(BEGIN | POINTS | START, [10, 10, 10, 10, 10], 4000)
    + move(2500)
    + write(READ | CHAPTER, 4, 42, u16(2600))
    + write(READ | CHAPTER, 0, 40, b"\1")
    + write(TRANSACT, 2, 40, b"\0")
    + torque(0x80 | 16)
    + path(ABORT | STATUS),
    "trajectory-without-a-host": bytes((SETTLE, 0))
    + torque()
    + watchdog(61, AT_ONCE)
    + path(BEGIN | OUTLIVES | POINTS | START | LAST, [10, 10, 10, 10, 10], 4000, then=LONG)
    + resume()
    + path(BEGIN | OUTLIVES | POINTS | START, [10, 10, 10, 10, 10], 4000, then=LONG),
    "torque-at-start": bytes((TORQUE_AT_START, 0x5F))
    + move(2000, 900, SHORT)
    + torque(0x80 | 4)
    + move(1700, 0, SHORT)
    + stop(1)
    + resume()
    + move(1800),
}


def main() -> None:
    """Write every seed, and remove every other file."""
    CORPUS.mkdir(exist_ok=True)
    for file in CORPUS.iterdir():
        if file.name not in SEEDS:
            file.unlink()
    for name, data in SEEDS.items():
        (CORPUS / name).write_bytes(data)


if __name__ == "__main__":
    main()
