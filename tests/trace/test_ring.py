from __future__ import annotations

import threading
import tracemalloc

from hypothesis import given
from hypothesis import strategies as st

from hexwire.link.tap import Direction, Passed
from hexwire.trace.traffic import TrafficRing


def passed(time: float, size: int = 10) -> Passed:
    return Passed(Direction.SENT, bytes(size), time, "")


def test_old_transfers_are_dropped_by_time_and_by_bytes() -> None:
    ring = TrafficRing(seconds=5.0)
    for i in range(10):
        ring.feed(passed(float(i)))
    assert [number for number, _ in ring.since(0)] == [5, 6, 7, 8, 9, 10]
    ring = TrafficRing(size=4000)
    for i in range(100):
        ring.feed(passed(float(i) / 1000, size=1000))
    assert [number for number, _ in ring.since(0)] == [98, 99, 100]
    # The newest stays, however large it is.
    ring.feed(passed(1.0, size=10_000))
    assert [number for number, _ in ring.since(0)] == [101]


def test_what_is_kept_is_what_came() -> None:
    ring, ways = TrafficRing(), (Direction.SENT, Direction.RECEIVED)
    came = [Passed(ways[i % 3 == 0], bytes([i % 251] * (i % 7)), i / 1000, f"link {i % 2}") for i in range(2000)]
    for passed in came:
        ring.feed(passed)
    for number in (0, 1, 255, 256, 257, 1000, 1791, 1792, 1793, 1999):
        assert ring.since(number) == list(enumerate(came, 1))[number:]


def test_two_minutes_of_many_short_transfers_take_little_memory() -> None:
    tracemalloc.start()
    try:
        ring = TrafficRing()
        for i in range(40_000):
            ring.feed(Passed(Direction.SENT, bytes(30), i / 1000 + 0.5, str(i)[:0]))
        assert tracemalloc.get_traced_memory()[0] < 2.5e6
    finally:
        tracemalloc.stop()
    assert len(ring.since(0)) == 40_000


def test_a_reader_gets_only_what_is_new_to_it() -> None:
    ring = TrafficRing()
    assert ring.since(0) == []
    for i in range(4):
        ring.feed(passed(float(i)))
    assert [number for number, _ in ring.since(2)] == [3, 4]
    assert ring.since(4) == []
    assert ring.since(ring.newest + 5) == []


@given(st.lists(st.tuples(st.floats(0, 100), st.integers(0, 5000)), max_size=60))
def test_the_bounds_hold_for_any_traffic(transfers: list[tuple[float, int]]) -> None:
    ring = TrafficRing(seconds=10.0, size=20_000)
    for time, size in sorted(transfers):
        ring.feed(passed(time, size))
        kept = [each for _, each in ring.since(0)]
        assert len(kept) == 1 or sum(len(each.data) + 16 for each in kept) <= 20_000
        assert kept[-1].time - kept[0].time <= 10.0


def test_a_reader_in_another_thread_misses_nothing_and_disturbs_nobody() -> None:
    ring = TrafficRing()
    count = 20_000
    seen: list[int] = []

    def read() -> None:
        while not seen or seen[-1] < count:
            seen.extend(number for number, _ in ring.since(seen[-1] if seen else 0))

    reader = threading.Thread(target=read)
    reader.start()
    for i in range(count):
        ring.feed(passed(i / 1000))
    reader.join(30)
    assert seen == list(range(1, count + 1))
