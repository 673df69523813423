"""Writes the seeds of the fuzz target into corpus/: known attacks, in the format that fuzz_attack.cpp reads.

python firmware/test/make_corpus.py

It is one table: every attack that has ever succeeded.
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


FINE = 0x80  # in the mask


def path(
    how: int,
    steps: list[int] | None = None,
    ticks: int = 500,
    first: bool = True,
    then: int = SHORT,
    mask: int = ALL,
) -> bytes:
    """Parts of a trajectory of all joints; each step is a way of four counts a unit."""
    data = bytes((how, mask))
    if how & BEGIN:
        data += b"\xb4"
    if how & POINTS:
        data += points(steps or [], ticks, first, bool(how & HERMITE))
    return do(15, 200, data, then=then)


def points(steps: list[int], ticks: int = 500, first: bool = True, hermite: bool = False) -> bytes:
    """Points for a trajectory or a message: their number, then each."""
    data = bytes((len(steps) + first,))
    if first:
        data += b"\0" * 7 if hermite else b""
    for step in steps:
        data += u16(ticks) + (bytes((step & 0xFF, 0)) if hermite else bytes((step & 0xFF,))) * 7
    return data


# Messages in fragments: what one is about, how many of the next chunks are sent, and whether chunks are asked for.
PATH_POINTS, STILL_POINTS, TABLE, ANY_MESSAGE, ASK = 0, 1, 2, 3, 0x80


def message(kind: int, size: int, content: bytes, chunks: int = 7, then: int = WHILE) -> bytes:
    """Begin a message in chunks of that size, and send the first ones."""
    return do(15, 220, 1 | kind << 1 | chunks << 3, size - 1, 3, content, then=then)


def chunks(count: int = 7, then: int = WHILE) -> bytes:
    """The next chunks of the message."""
    return do(15, 220, count << 3, then=then)


def chunk(index: int, then: int = SHORT) -> bytes:
    """One chunk of it."""
    return do(15, 220, 0x40, index, then=then)


def missing(number: int, *indices: int, then: int = WHILE) -> bytes:
    """Ask for chunks of the reply to the last request."""
    return do(15, 220, ASK, len(indices) | number << 2, bytes(indices), then=then)


def table_of(servo: int, first: int, data: bytes) -> bytes:
    """Registers of a servo, for a message or a request."""
    return bytes((servo, first, len(data))) + data


def write_table(servo: int, first: int, data: bytes, then: int = WHILE) -> bytes:
    return do(15, 232, 1, table_of(servo, first, data), then=then)


def read_table(servo: int, first: int, then: int = WHILE) -> bytes:
    """All registers from the first on."""
    return do(15, 232, 0, servo, first, 0, then=then)


def aim(whom: int) -> bytes:
    """Whom the next frames are for."""
    return do(15, 240, whom, then=AT_ONCE)


THIS, EVERYBODY, SEVERAL, OTHERS = 0, 1, 2, 3


def rate(which: int, then: int = LONG) -> bytes:
    """HOST_BAUD: 115200, 250000, 500000, 1000000, or what no board knows."""
    return do(15, 248, which, then=then)


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
    "busy-comes-again": bytes((SETTLE, 0))
    + torque()
    + watchdog(61, AT_ONCE)
    + SLOW * 26
    + resume(AT_ONCE)
    + do(15, 199, then=LONG)
    + again(0),
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
    # Found by chance: the way is long, and a request comes between the two packets of a pair.
    "limits-between-two-packets": bytes.fromhex(
        "f500757fffc83e7fb40a590a0a5959595959595959595959590a5959"
        "0a59590a590a595959595959595959595959595959595959595959590a"
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
    "trajectory-in-eighths": bytes((SETTLE, 0))
    + limits(1400, 900)
    + torque()
    + path(BEGIN | POINTS | START | LAST, [5, 10, 10, 5], then=LONG, mask=ALL | FINE)
    + path(BEGIN | HERMITE | POINTS | LAST, [-100, -100, -100], 9000, mask=ALL | FINE)
    + path(HERMITE | START | STATUS, then=LONG),
    "frames-for-others": bytes((SETTLE, 0))
    + aim(OTHERS)
    + torque()
    + move(2500)
    + aim(4)
    + torque()
    + aim(THIS)
    + stop()
    + aim(OTHERS)
    + resume()
    + torque()
    + move(1500)
    + aim(6 | 64),
    "commands-for-all": bytes((SETTLE, 0))
    + aim(EVERYBODY)
    + torque()
    + move(2000, 900)
    + maintenance(1)
    + torque(0x80 | ALL)
    + maintenance(1)
    + write(TRANSACT, 4, 33, b"\1")
    + write_table(4, 33, b"\1")
    + aim(SEVERAL)
    + stop(1)
    + resume()
    + limits(1400, 900)
    + again(3),
    "trajectory-in-fragments": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN)
    + message(PATH_POINTS, 60, points([5, 10, 10, 5, 0, -5, -10, -10, -5] * 2))
    + path(START | STATUS, then=LONG)
    + path(BEGIN)
    + message(PATH_POINTS, 17, points([5, 10, 10, 5]), 2)
    + path(POINTS, [1, 2, 3], first=False)
    + path(BEGIN)
    + chunks(),
    "more-points-than-fit": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN | HERMITE)
    + message(STILL_POINTS, 200, bytes((60,)), 7)
    + chunks(3)
    + message(STILL_POINTS, 13, bytes((5,)))
    + chunks(6)
    + message(STILL_POINTS, 200, bytes((255,)), 7)
    + chunks(7) * 5
    + path(HERMITE | START, then=LONG)
    + message(STILL_POINTS, 200, bytes((65,)), 7)
    + chunks(3),
    "message-over-a-stop": bytes((SETTLE, 0))
    + torque()
    + path(BEGIN)
    + message(PATH_POINTS, 30, points([10, 10, 10, 10, 10]), 2)
    + stop()
    + resume()
    + path(BEGIN)
    + chunks()
    + b"".join(chunk(n) for n in range(7))
    + path(START, then=LONG),
    "commands-in-fragments": bytes((SETTLE, 0))
    + b"".join(
        message(ANY_MESSAGE, 200, bytes((cmd, len(data))) + data)
        for cmd, data in ((0x16, b""), (0x14, b"\1\x7f\0"), (0x1F, b"\1"), (0x15, b"\1"), (0x1C, b"\0" * 9))
    )
    + stop()
    + message(ANY_MESSAGE, 1, b"\x16\1\0")
    + message(ANY_MESSAGE, 3, b"\x14\3\1\x7f\0"),
    "table-outside-maintenance": bytes((SETTLE, 0))
    + torque()
    + write_table(4, 33, b"\1")
    + write_table(4, 42, u16(2500))
    + write_table(0, 40, b"\1\0\7\xd0")
    + message(TABLE, 5, table_of(5, 5, bytes(range(40))))
    + maintenance(1)
    + write_table(5, 7, b"\4"),
    "table-in-maintenance": bytes((SETTLE, 0))
    + maintenance(1)
    + write_table(4, 9, u16(200) + u16(3000))
    + write_table(4, 40, b"\1")
    + write_table(4, 41, b"\0" + u16(2500) + u16(100) + u16(100))
    + message(TABLE, 20, table_of(5, 9, bytes(31)))
    + message(TABLE, 20, table_of(1, 9, bytes(60)), then=SHORT)
    + stop()
    + resume()
    + maintenance(1)
    + write_table(5, 5, b"\6\0")
    + torque(),
    "table-of-a-silent-servo": bytes((SETTLE, 0))
    + read_table(4, 0, SHORT)
    + do(14, 4)
    + read_table(4, 0, LONG)
    + maintenance(1)
    + write_table(4, 0, bytes(200))
    + do(14, 4)
    + message(TABLE, 200, table_of(4, 0, bytes(255))),
    "chunks-asked-for": bytes((SETTLE, 0))
    + read_table(4, 0)
    + missing(1, 0, 1, 2)
    + missing(1, 3, 3, 3)
    + read_table(0, 0, SHORT)
    + missing(2, 1, then=SHORT)
    + do(0, 0, 0, then=SHORT)
    + missing(2, 0)
    + missing(2)
    + read_table(6, 100)
    + stop()
    + missing(3, 0, 1),
    "rates": bytes((SETTLE, 0))
    + rate(2)
    + torque()
    + move(2000, 900, SHORT)
    + rate(3, SHORT)
    + rate(0)
    + rate(3, AT_ONCE)
    + message(PATH_POINTS, 20, points([1, 2, 3]))
    + stop()
    + rate(4)
    + resume(),
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
