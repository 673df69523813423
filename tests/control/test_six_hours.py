"""Six hours of an arm in simulated time, with stops and an unplugged port: nothing grows, and no state is missing.

The board's clock of microseconds wraps every 72 minutes. `make soak` takes the six hours, otherwise it is minutes.
"""

from __future__ import annotations

import gc
import logging
import sys
import threading
from itertools import pairwise

import pytest
from tests.control.arm_bench import STOPPED, SUCCEEDED
from tests.control.owner_bench import BoardBench
from tests.soak import SOAK, rounds

MINUTES = rounds(4, 360)
WARM = 30
"""Minutes after which every list that is bounded is full."""
WINDOW = 10
FLAT = 1.02
PERIOD = 0.01


def blocks() -> int:
    """Pieces of memory that Python has given out and that are in use."""
    gc.collect()
    return sys.getallocatedblocks()


class LongBench(BoardBench):
    """A bench that does a minute's work, and forgets its own notes after it."""

    def go_and_arrive(self, number: int) -> None:
        told = self.go("J1", 0.4 if number % 2 else -0.4, 5.0)
        self.until(lambda: told.ends)
        assert told.outcome == SUCCEEDED, told.words

    def be_stopped(self, by: float) -> None:
        told = self.go("J1", by, 5.0)
        self.turn(1.0)
        self.owner.stop("a person")
        self.until(lambda: told.ends)
        assert told.outcome == STOPPED, told.words
        self.ask(self.owner.reset)

    def be_unplugged(self) -> None:
        before = self.owner.reconnects
        self.link.lost = True
        self.until(lambda: not self.owner.connected)
        self.arm.wait(3.0)
        self.link.lost = False
        self.until(lambda: self.owner.connected)
        self.turn(1.0)
        assert self.owner.reconnects == before + 1
        self.ask(self.owner.reset)
        self.enable()

    def minute(self, number: int) -> None:
        begun = self.clock.time
        if number % 4 == 2:
            # To and fro: where it is stopped, the next motion begins.
            self.be_stopped(0.1 if number % 8 == 2 else -0.1)
        if number % 4 == 3:
            self.be_unplugged()
        self.published.clear()
        self.go_and_arrive(number)
        self.turn(begun + 60.0 - self.clock.time)
        times = [time for time, _ in self.published]
        # Every period has its state: none is missing, and none comes twice.
        assert all(0.5 * PERIOD < after - before < 1.5 * PERIOD for before, after in pairwise(times))
        self.published.clear()
        self.writes.clear()
        self.link.written.clear()


@pytest.mark.soak
@pytest.mark.slow
@pytest.mark.timeout(rounds(300, 7200))
def test_six_hours_lose_nothing_and_keep_nothing(caplog: pytest.LogCaptureFixture) -> None:
    # pytest keeps what is logged, and with an error the frames that it passed.
    caplog.set_level(logging.CRITICAL, "hexwire")
    bench, threads = LongBench(), set(threading.enumerate())
    bench.owner.connect()
    bench.turn(0.2)
    bench.enable()
    begun, kept = bench.clock.time, list[int]()
    for number in range(MINUTES):
        bench.minute(number)
        kept.append(blocks())
    print(f"{bench.clock.time - begun:.0f} s of simulated time; blocks of memory each half an hour: {kept[::30]}")
    assert threads.issuperset(threading.enumerate())
    counters = bench.robot.host_counters()
    assert counters["bad_frames"] == counters["stale_frames"] == 0
    if SOAK:
        assert max(kept[-WINDOW:]) <= FLAT * min(kept[WARM : WARM + WINDOW]), kept
