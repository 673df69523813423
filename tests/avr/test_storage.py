"""How often the firmware writes to its EEPROM, which bears 100,000 writes (PROTOCOL.md section 6.3, LIMITS)."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import CoreBoard

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status

# The first one builds.

ROW = b"\0\0\xff\x0f"
STORES = tables.SETTINGS_STORES
MINUTE = tables.SETTINGS_STORE_EVERY


class Host:
    """Stores limits, counted by their speed."""

    def __init__(self) -> None:
        self.board = CoreBoard()
        self.board.settle()
        self.client = Client(self.board)

    def limits(self, speed: int) -> int:
        rows = (ROW + speed.to_bytes(2, "little")) * 7
        return self.client.ask(Command.LIMITS, b"\7" + rows, within=1.0).status

    def offsets(self, neutral: int) -> int:
        rows = (neutral.to_bytes(2, "little") + b"\1") * 7
        return self.client.ask(Command.OFFSETS, b"\7" + rows, within=1.0).status

    @property
    def writes(self) -> int:
        return sum(self.board.storage_writes)


@pytest.fixture
def host() -> Iterator[Host]:
    made = Host()
    yield made
    made.board.close()


def test_only_bytes_that_differ_are_written(host: Host) -> None:
    assert host.limits(1000) == Status.OK
    before = list(host.board.storage_writes)
    assert host.limits(1000) == Status.OK
    assert host.board.storage_writes == before
    assert host.limits(1001) == Status.OK
    written = [b - a for a, b in zip(before, host.board.storage_writes, strict=True)]
    # One byte of each row, and the check.
    assert set(written) == {0, 1}
    assert 7 < sum(written) <= 9


def test_a_host_that_stores_all_the_time_is_stopped(host: Host) -> None:
    for n in range(STORES):
        assert (host.limits(100 + n) if n % 2 else host.offsets(1000 + n)) == Status.OK
    before = host.writes
    for _ in range(3):
        assert host.limits(4000) == Status.BUSY
        assert host.offsets(4000) == Status.BUSY
    assert host.writes == before
    # All other reasons come first, and what is stored already may be stored again.
    assert host.limits(0) == Status.BAD_RANGE
    assert host.client.ask(Command.LIMITS, b"\7").status == Status.BAD_LENGTH
    assert host.limits(100 + STORES - 1) == Status.OK
    assert host.client.ask(Command.LIMITS).status == Status.OK
    assert host.writes == before


def test_one_more_store_each_minute(host: Host) -> None:
    for n in range(STORES):
        assert host.limits(100 + n) == Status.OK
    assert host.limits(4000) == Status.BUSY
    host.board.leap(MINUTE - 5)
    assert host.limits(4000) == Status.BUSY
    host.board.leap(5)
    assert host.limits(4000) == Status.OK
    assert host.limits(4001) == Status.BUSY
    host.board.leap(3 * MINUTE)
    assert [host.limits(4002 + n) for n in range(4)] == [Status.OK] * 3 + [Status.BUSY]
    host.board.leap(1000 * MINUTE)
    assert [host.limits(3000 + n) for n in range(STORES + 1)] == [Status.OK] * STORES + [Status.BUSY]


def test_no_cell_wears_out_within_two_months(host: Host) -> None:
    """The fastest host, for an hour: what a cell bears lasts for 69 days."""
    stores = 0
    for minute in range(60):
        while host.limits(100 + stores) == Status.OK:
            stores += 1
        if minute < 59:
            host.board.leap(MINUTE)
    assert STORES + 58 <= stores <= STORES + 60
    worst = max(host.board.storage_writes)
    assert worst <= stores
    bears = 100_000
    assert (bears - STORES) * MINUTE / 86400 > 69


def test_a_refused_store_changes_nothing(host: Host) -> None:
    for n in range(STORES):
        assert host.limits(100 + n) == Status.OK
    assert host.limits(4000) == Status.BUSY
    speed = int.from_bytes(host.client.ask(Command.LIMITS).body[6:8], "little")
    assert speed == 100 + STORES - 1
    host.board.reset()
    host.board.settle()
    assert host.limits(4000) == Status.OK
