from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import LinkClosedError, LinkTimeoutError, UsageError
from hexwire.link import impair as impair_module
from hexwire.link.base import Link, LinkKind
from hexwire.link.impair import NOTHING, ImpairedLink, Impairment, Lane
from hexwire.link.memory import memory_pair
from hexwire.testing.link import LinkConformance, in_a_moment, soon

STREAM, DATAGRAM = LinkKind.STREAM, LinkKind.DATAGRAM


class TestUnimpairedStream(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        near, far = memory_pair()
        return ImpairedLink(near), far


class TestUnimpairedDatagram(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        near, far = memory_pair(DATAGRAM, max_message=2000)
        return ImpairedLink(near), far


class TestSplitStream(LinkConformance):
    """Pieces are all that a stream may become without breaking what a stream promises."""

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        near, far = memory_pair()
        return ImpairedLink(near, sending=Impairment(split=1.0), receiving=Impairment(split=1.0)), far

    def take(self, link: Link, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += link.read(soon())
        return data

    # The shared test counts on one read for one write.
    def test_flush_input_drops_what_waits_and_counts_it(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.write(b"stale", soon())
        assert near.read(soon()) in (b"s", b"st", b"sta", b"stal")
        assert 1 <= near.flush_input() <= 4
        assert near.read(in_a_moment()) == b""


class FakeClock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class FakeLine(Link):
    """A link in simulated time: what is written is recorded, what arrives is scripted."""

    def __init__(self, kind: LinkKind = STREAM, arrivals: dict[float, bytes] | None = None) -> None:
        self.url = "fake://"
        self.kind = kind
        self.clock = FakeClock()
        self.arrivals = sorted((arrivals or {}).items())
        self.written: list[tuple[float, bytes]] = []
        self.full = False
        self.woken = False
        self.is_up = True

    @property
    def is_open(self) -> bool:
        return self.is_up

    def open(self) -> None:
        self.is_up = True

    def close(self) -> None:
        self.is_up = False

    def wake(self) -> None:
        self.woken = True

    def flush_input(self) -> int:
        return 0

    def write(self, data: bytes, deadline: float | None = None) -> None:
        if self.full:
            raise LinkTimeoutError("full")
        self.written.append((round(self.clock.now, 6), data))

    def read(self, deadline: float | None) -> bytes:
        if self.woken:
            self.woken = False
            return b""
        if self.arrivals and (deadline is None or self.arrivals[0][0] <= deadline):
            time, data = self.arrivals.pop(0)
            self.clock.now = max(self.clock.now, time)
            return data
        assert deadline is not None, "would wait for ever"
        self.clock.now = max(self.clock.now, deadline)
        return b""


# --- one lane -------------------------------------------------------------------------------------------


def everything(lane: Lane, until: float = 1e9) -> list[bytes]:
    """All that comes out from now on."""
    out = []
    while (time := lane.next_time()) is not None and time <= until:
        piece = lane.take(time)
        if piece:
            out.append(piece)
    return out


def test_nothing_happens_to_units_of_a_good_line() -> None:
    lane = Lane(NOTHING, STREAM, "x")
    for number in range(10):
        lane.put(bytes([number]) * 5, float(number))
        assert lane.next_time() == number
        assert lane.take(number) == bytes([number]) * 5
        assert lane.take(number) == b""
    assert lane.next_time() is None
    assert lane.counters.units == 10


def test_split_keeps_every_byte_in_order() -> None:
    lane = Lane(Impairment(split=1.0), STREAM, "x")
    lane.put(bytes(range(100)), 0.0)
    pieces = everything(lane)
    assert 2 <= len(pieces) <= 4
    assert b"".join(pieces) == bytes(range(100))
    lane.put(b"1", 0.0)
    assert everything(lane) == [b"1"]
    assert lane.counters.split == 1
    whole = Lane(Impairment(split=1.0), DATAGRAM, "x")
    whole.put(bytes(100), 0.0)
    assert everything(whole) == [bytes(100)], "a datagram is never split"


def test_drop() -> None:
    lane = Lane(Impairment(drop=1.0), DATAGRAM, "x")
    lane.put(b"gone", 0.0)
    assert everything(lane) == []
    lane = Lane(Impairment(drop=1.0), STREAM, "x")
    data = bytes(range(100))
    lane.put(data, 0.0)
    (left,) = everything(lane)
    assert 84 <= len(left) < 100
    gap = next(at for at in range(100) if left[at : at + 1] != data[at : at + 1])
    assert data[:gap] + data[gap + 100 - len(left) :] == left, "one run is missing"
    lane.put(b"1", 0.0)
    assert everything(lane) == []
    assert lane.counters.dropped == 2


def test_flip_changes_one_bit() -> None:
    for kind in LinkKind:
        lane = Lane(Impairment(flip=1.0), kind, "x")
        lane.put(bytes(50), 0.0)
        (data,) = everything(lane)
        assert len(data) == 50
        assert sum(byte.bit_count() for byte in data) == 1


def test_duplicate() -> None:
    lane = Lane(Impairment(duplicate=1.0), DATAGRAM, "x")
    lane.put(b"twice", 0.0)
    assert everything(lane) == [b"twice", b"twice"]
    lane = Lane(Impairment(duplicate=1.0), STREAM, "x")
    lane.put(bytes(range(50)), 0.0)
    (data,) = everything(lane)
    assert 50 < len(data) <= 66
    doubled = [byte for byte, count in Counter(data).items() if count == 2]
    assert doubled == list(range(doubled[0], doubled[-1] + 1)), "one run comes twice"


def test_reorder_puts_a_unit_behind_the_next_one() -> None:
    lane = Lane(Impairment(reorder=1.0, delay_time=0.5), DATAGRAM, "x")
    lane.put(b"1", 0.0)
    assert lane.take(0.1) == b""
    lane.put(b"2", 0.2)
    assert [lane.take(0.2), lane.take(0.2)] == [b"2", b"1"]
    lane.put(b"3", 1.0)
    assert lane.next_time() == 1.5
    assert lane.take(1.49) == b""
    assert lane.take(1.5) == b"3", "nothing followed"
    assert lane.counters.reordered == 2


def test_delay_keeps_a_stream_in_order_and_lets_datagrams_overtake() -> None:
    stream = Lane(Impairment(delay=0.5, delay_time=1.0), STREAM, "seed")
    datagrams = Lane(Impairment(delay=0.5, delay_time=1.0), DATAGRAM, "seed")
    for number in range(50):
        for lane in (stream, datagrams):
            lane.put(bytes([number]), number * 0.01)
    order = b"".join(everything(stream))
    assert order == bytes(range(50))
    overtaken = b"".join(everything(datagrams))
    assert sorted(overtaken) == list(range(50))
    assert overtaken != order
    assert 10 < stream.counters.delayed < 40


def test_freeze_holds_everything_back_for_a_while() -> None:
    lane = Lane(Impairment(freeze=1.0, freeze_time=2.0), STREAM, "x")
    lane.put(b"1", 10.0)
    assert lane.take(11.9) == b""
    assert lane.next_time() == 12.0
    assert lane.take(12.0) == b"1"
    assert lane.counters.frozen == 1


def test_what_waits_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(impair_module, "_MOST_WAITING", 3)
    lane = Lane(NOTHING, STREAM, "x")
    for _ in range(5):
        lane.put(b"12", 0.0)
    assert lane.counters.overflowed == 2
    assert lane.clear() == 6
    assert lane.next_time() is None


UNITS = st.lists(st.tuples(st.binary(min_size=1, max_size=80), st.floats(0.0, 0.1)), max_size=40)
RATES = st.builds(Impairment, *[st.floats(0.0, 1.0)] * 7)


@given(UNITS, RATES, st.sampled_from(LinkKind), st.text(max_size=5))
def test_the_same_seed_does_the_same_and_nothing_stays_inside(
    units: list[tuple[bytes, float]], bad: Impairment, kind: LinkKind, seed: str
) -> None:
    outcomes = []
    for _ in range(2):
        lane, now, out = Lane(bad, kind, seed), 0.0, []
        for data, pause in units:
            now += pause
            lane.put(data, now)
            out += everything(lane, now)
        out += everything(lane)
        assert lane.clear() == 0
        outcomes.append((out, lane.counters))
    assert outcomes[0] == outcomes[1]
    counters = outcomes[0][1]
    assert counters.units == len(units)
    if kind is DATAGRAM:
        assert len(outcomes[0][0]) == len(units) - counters.dropped + counters.duplicated


@pytest.mark.parametrize("wrong", [{"drop": 1.1}, {"flip": -0.1}, {"delay_time": -1.0}, {"split": float("nan")}])
def test_senseless_rates_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(wrong))):
        Impairment(**wrong)


def test_all_of() -> None:
    bad = Impairment.all_of(0.01)
    assert (bad.split, bad.freeze, bad.delay_time) == (0.01, 0.01, 0.02)


# --- the link -------------------------------------------------------------------------------------------


def test_time_comes_from_the_inner_links_clock_if_it_has_one() -> None:
    line = FakeLine(arrivals={100.2: b"answer"})
    link = ImpairedLink(line, receiving=Impairment(freeze=1.0, freeze_time=5.0))
    assert link.clock is line.clock
    assert link.read(103.0) == b""
    assert line.clock.now == 103.0
    assert link.read(200.0) == b"answer"
    assert line.clock.now == 105.2
    assert ImpairedLink(line, clock=lambda: 7.0).clock() == 7.0


def test_what_a_link_refuses_or_ignores_is_no_unit_of_the_line() -> None:
    near, far = memory_pair(DATAGRAM, max_message=4)
    link = ImpairedLink(near, sending=Impairment(drop=1.0))
    with pytest.raises(LinkClosedError):
        link.write(b"x")
    with link, far:
        link.write(b"")
        with pytest.raises(UsageError, match="at most 4 bytes"):
            link.write(b"12345")
        assert link.sent.counters.units == 0
        link.write(b"1234")
        assert (link.sent.counters.units, link.sent.counters.dropped) == (1, 1)


def test_what_is_no_unit_of_the_line_keeps_its_deadline() -> None:
    """Even an empty write waits for its turn behind another thread's."""
    near, _ = memory_pair(DATAGRAM)
    link, seen = ImpairedLink(near), []
    near.write = lambda data, deadline=None: seen.append((data, deadline))  # type: ignore[method-assign]
    link.write(b"x", 4.0)
    link.open()
    link.write(b"", 5.0)
    link.write(bytes(9000), 6.0)
    link.write(b"x", 7.0)
    link.close()
    assert seen == [(b"x", 4.0), (b"", 5.0), (bytes(9000), 6.0), (b"x", 7.0)]


def test_what_is_late_goes_out_while_somebody_reads() -> None:
    line = FakeLine()
    link = ImpairedLink(line, sending=Impairment(freeze=1.0, freeze_time=1.0))
    link.write(b"request")
    assert line.written == []
    assert link.read(100.5) == b""
    assert line.written == []
    assert link.read(102.0) == b""
    assert line.written == [(101.0, b"request")]
    assert line.clock.now == 102.0


def test_a_line_that_takes_nothing_loses_what_is_late() -> None:
    line = FakeLine()
    link = ImpairedLink(line, sending=Impairment(freeze=1.0, freeze_time=1.0))
    link.write(b"request")
    line.full = True
    assert link.read(102.0) == b""
    assert link.sent.counters.overflowed == 1
    good = ImpairedLink(line)
    with pytest.raises(LinkTimeoutError):
        good.write(b"request")


def test_a_wake_and_a_past_deadline() -> None:
    line = FakeLine(arrivals={100.0: b"there"})
    link = ImpairedLink(line, receiving=Impairment(delay=1.0))
    link.wake()
    assert link.read(None) == b""
    assert link.read(0.0) == b"", "it is late"
    assert link.read(101.0) == b"there"
    assert link.read(0.0) == b""


def test_closing_forgets_what_waits() -> None:
    line = FakeLine(arrivals={100.0: b"there"})
    link = ImpairedLink(line, sending=Impairment(freeze=1.0), receiving=Impairment(freeze=1.0))
    link.write(b"late")
    assert link.read(100.1) == b""
    assert link.flush_input() == 5
    link.close()
    assert not link.is_open
    link.open()
    assert link.read(110.0) == b""
    assert line.written == []


def test_seeds_differ_between_directions_and_runs() -> None:
    def losses(seed: int) -> tuple[int, ...]:
        line = FakeLine(DATAGRAM, {100.0 + number: b"x" for number in range(200)})
        link = ImpairedLink(line, sending=Impairment(drop=0.5), receiving=Impairment(drop=0.5), seed=seed)
        heard = []
        for number in range(200):
            link.write(bytes([number]))
            heard.append(len(link.read(100.0 + number)))
        return (*heard, *(data[0] for _, data in line.written))

    assert losses(1) == losses(1)
    assert losses(1) != losses(2)


def test_the_rates_are_kept() -> None:
    line = FakeLine(DATAGRAM)
    link = ImpairedLink(line, sending=Impairment.all_of(0.01), seed=3)
    for _ in range(20_000):
        link.write(bytes(60))
    counts = link.sent.counters
    assert counts.units == 20_000
    for value in (
        counts.dropped,
        counts.flipped,
        counts.duplicated,
        counts.reordered,
        counts.delayed,
        counts.frozen,
    ):
        assert 120 < value < 280
    assert counts.split == 0


# --- what a fault does, over many seeds -----------------------------------------------------------------------


def fates(impairment: Impairment, kind: LinkKind, data: bytes, seeds: int = 400) -> list[list[bytes]]:
    """What comes of one unit, for many seeds."""
    found = []
    for seed in range(seeds):
        lane = Lane(impairment, kind, str(seed))
        lane.put(data, 0.0)
        found.append(everything(lane))
    return found


def test_a_run_is_one_to_sixteen_bytes_anywhere() -> None:
    data = bytes(range(40))
    lost = {
        tuple(sorted(set(data) - set(b"".join(out)))) for out in fates(Impairment(drop=1.0), STREAM, data, 2000)
    }
    assert all(run == tuple(range(run[0], run[-1] + 1)) for run in lost)
    assert {len(run) for run in lost} == set(range(1, 17))
    assert {run[0] for run in lost} >= {0, 24, 39}
    assert {run[-1] for run in lost} >= {0, 15, 39}
    # A short unit may be lost whole, and never more than that.
    assert {len(b"".join(out)) for out in fates(Impairment(drop=1.0), STREAM, b"abc")} == {0, 1, 2}


def test_a_repeat_is_one_to_sixteen_bytes_anywhere() -> None:
    data = bytes(range(40))
    outs = {b"".join(out) for out in fates(Impairment(duplicate=1.0), STREAM, data, 2000)}
    runs = {(start, length) for start in range(40) for length in range(1, 17) if start + length <= 40}
    twice = {data[: start + length] + data[start:] for start, length in runs}
    assert outs <= twice
    assert {len(out) - 40 for out in outs} == set(range(1, 17))


def test_a_flip_may_be_any_bit_of_any_byte() -> None:
    flipped = {b"".join(out) for out in fates(Impairment(flip=1.0), STREAM, bytes(3))}
    assert flipped == {(1 << bit).to_bytes(3, "big") for bit in range(24)}


def test_a_split_gives_two_to_four_pieces_none_of_them_empty() -> None:
    outs = fates(Impairment(split=1.0), STREAM, bytes(range(10)))
    assert {len(out) for out in outs} == {2, 3, 4}
    assert all(piece for out in outs for piece in out)
    assert {len(out[0]) for out in outs} >= {1, 9}
    assert {len(out) for out in fates(Impairment(split=1.0), STREAM, b"ab")} == {2}
    assert {len(out) for out in fates(Impairment(split=1.0), STREAM, b"abc")} == {2, 3}


@pytest.mark.parametrize("name", ["split", "drop", "flip", "duplicate", "reorder", "delay", "freeze"])
def test_how_often_a_fault_happens(name: str) -> None:
    counter = {
        "drop": "dropped", "flip": "flipped", "duplicate": "duplicated", "reorder": "reordered", "delay": "delayed",
        "freeze": "frozen",
    }.get(name, name)  # fmt: skip
    for probability, low, high in ((0.0, 0, 0), (0.25, 200, 300), (1.0, 1000, 1000)):
        count = 0
        for seed in range(1000):
            lane = Lane(Impairment(**{name: probability}), STREAM, str(seed))
            lane.put(b"a unit", 0.0)
            count += getattr(lane.counters, counter)
            assert lane.counters.units == 1
        assert low <= count <= high


def test_a_delay_is_anything_up_to_the_longest() -> None:
    times = []
    for seed in range(300):
        lane = Lane(Impairment(delay=1.0, delay_time=0.5), STREAM, str(seed))
        lane.put(b"x", 10.0)
        times.append(lane.next_time() or 0.0)
    assert 10.0 <= min(times) < 10.05
    assert 10.45 < max(times) <= 10.5


def test_a_fault_of_one_kind_leaves_the_others_where_they_were() -> None:
    """As many random numbers are drawn for a unit, whatever becomes of it."""
    plain, also = Lane(Impairment(flip=0.5), STREAM, "x"), Lane(Impairment(flip=0.5, delay=0.7), STREAM, "x")
    for i in range(50):
        for lane in (plain, also):
            lane.put(b"unit", float(i))
        assert plain.counters.flipped == also.counters.flipped
    assert also.counters.delayed > 20


def test_a_freeze_holds_everything_and_is_not_shortened() -> None:
    lane = Lane(Impairment(freeze=1.0, freeze_time=2.0), STREAM, "x")
    lane.put(b"a", 1.0)
    assert lane.next_time() == 3.0
    assert lane.take(2.999) == b""
    lane.put(b"b", 2.5)
    assert lane.next_time() == 4.5
    assert lane.take(4.499) == b""
    assert [lane.take(4.5), lane.take(4.5), lane.take(4.5)] == [b"a", b"b", b""]


def test_what_is_cleared_is_counted_in_bytes_and_forgotten() -> None:
    lane = Lane(Impairment(reorder=0.0, delay=1.0, delay_time=5.0), STREAM, "x")
    lane.put(b"abc", 0.0)
    lane.put(b"de", 0.0)
    assert lane.clear() == 5
    assert lane.next_time() is None
    assert lane.clear() == 0
    held = Lane(Impairment(reorder=1.0, freeze=1.0, freeze_time=9.0), STREAM, "x")
    held.put(b"abcd", 0.0)
    assert held.clear() == 4
    assert held.next_time() is None
    held._impairment = NOTHING
    held.put(b"x", 1.0)
    assert held.take(1.0) == b"x", "it is frozen no more"


def test_a_lane_holds_back_ten_thousand_pieces() -> None:
    lane = Lane(NOTHING, DATAGRAM, "x")
    for _ in range(10_001):
        lane.put(b"x", 0.0)
    assert lane.counters.overflowed == 1
    assert len(everything(lane)) == 10_000


@pytest.mark.parametrize("name", ["split", "drop", "flip", "duplicate", "reorder", "delay", "freeze"])
def test_probabilities_and_times_at_their_bounds(name: str) -> None:
    for value in (0.0, 1.0):
        assert getattr(Impairment(**{name: value}), name) == value
    for value in (-0.001, 1.001, float("nan")):
        with pytest.raises(UsageError, match=name):
            Impairment(**{name: value})
    assert getattr(Impairment.all_of(0.25), name) == 0.25
    assert (Impairment.all_of(0.25).delay_time, Impairment.all_of(0.25).freeze_time) == (0.02, 0.5)
    for time in ("delay_time", "freeze_time"):
        assert getattr(Impairment(**{time: 3600.0}), time) == 3600.0
        with pytest.raises(UsageError, match=time):
            Impairment(**{time: 3600.1})
