"""The states of a shared arm as they arrive, with a clock of the test's own."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from tests.fleet.fake_inbox import PATIENCE, FakeInbox

from hexwire.errors import LinkClosedError, LinkLostError, RemoteProtocolError
from hexwire.fleet import messages as m
from hexwire.fleet import states as module
from hexwire.fleet.clock import ClockOffset
from hexwire.fleet.states import ArrivedStates

NOTHING = (math.nan,)


def state(sequence: int, sent: float, *, server: int = 1, **changes: Any) -> bytes:
    values = (*(NOTHING,) * 4, NOTHING, NOTHING, (64,), (0.0,), math.nan, False, False, False)
    message = m.State(server, sequence, sent, sent, 1.7e9, ("J1",), *values)
    return m.encode(msgspec.structs.replace(message, **changes))


class Bench:
    def __init__(self, offset: float = 100.0) -> None:
        self.time = 10.0
        self.clock = ClockOffset()
        self.clock.add(10.0, 10.0 + offset, 10.0)
        self.states = ArrivedStates("zenoh:arm", self.clock, now=lambda: self.time)

    def arrive(self, payload: bytes, wait: float = 0.01) -> None:
        self.time += wait
        self.states.add(payload)

    def newest(self) -> tuple[int, int]:
        newest = self.states.newest
        assert newest is not None
        return newest.server, newest.sequence


def test_the_newest_state_is_returned_in_this_programs_time() -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0, position=(0.5,), stopped=True))
    got = bench.states.next(0.0, 0.0)
    assert got is not None
    assert got["J1"].position == 0.5
    assert got.stamp == pytest.approx(10.0, abs=1e-3)
    assert got.stopped


def test_no_stamp_is_later_than_the_arrival() -> None:
    bench = Bench()
    bench.arrive(state(1, 500.0))
    got = bench.states.next(0.0, 0.0)
    assert got is not None
    assert got.stamp == bench.time


def test_only_states_that_arrive_after_the_call_count() -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0))
    assert bench.states.next(bench.time, 0.0) is None
    assert bench.states.next(bench.time - 0.001, 0.0) is not None


def test_overtaken_and_doubled_states_are_ignored_and_lost_ones_counted() -> None:
    bench = Bench()
    for sequence in (1, 4, 2, 4, 3, 5):
        bench.arrive(state(sequence, 110.0 + sequence))
    assert bench.newest() == (1, 5)
    assert (bench.states.seen, bench.states.lost) == (3, 2)


def test_states_from_before_an_answered_order_are_not_returned() -> None:
    bench = Bench()
    bench.states.require(3)
    bench.arrive(state(1, 110.0, done=2))
    assert bench.states.next(0.0, 0.0) is None
    bench.arrive(state(2, 110.1, done=3))
    assert bench.states.next(0.0, 0.0) is not None
    # An earlier answer that comes later takes nothing back.
    bench.states.require(1)
    bench.arrive(state(3, 110.2, done=2))
    assert bench.states.next(0.0, 0.0) is None


def test_a_server_that_was_started_anew_counts_whatever_its_clock_says() -> None:
    bench = Bench()
    bench.states.require(40)
    bench.arrive(state(900, 5000.0, done=40))
    bench.arrive(state(1, 3.0, server=2))
    assert bench.newest() == (2, 1)
    assert bench.states.next(0.0, 0.0) is not None, "it has done nothing yet"
    assert bench.states.lost == 0


def test_a_late_state_of_the_server_before_is_ignored() -> None:
    bench = Bench()
    bench.arrive(state(900, 5000.0))
    bench.arrive(state(1, 3.0, server=2))
    bench.arrive(state(901, 5000.1))
    assert bench.newest() == (2, 1)


def test_a_server_that_was_hidden_by_another_one_counts_again_when_that_is_silent() -> None:
    bench = Bench()
    bench.arrive(state(900, 5000.0))
    bench.arrive(state(1, 3.0, server=2))
    bench.arrive(state(990, 5002.0), wait=2.0)
    bench.arrive(state(991, 5002.1))
    assert bench.newest() == (1, 991)
    bench.arrive(state(2, 4.0, server=2))
    assert bench.newest() == (1, 991)


@pytest.mark.parametrize(
    "changes",
    [{"sent": math.nan}, {"sent": math.inf}, {"stamp": math.nan}, {"stamp": -math.inf}, {"wall": math.nan}],
)
def test_a_state_without_a_time_is_damaged_and_changes_nothing(changes: dict[str, Any]) -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0))
    bench.arrive(state(2, **{"sent": 110.1, **changes}))
    bench.arrive(b"\x01\x02noise")
    assert bench.newest() == (1, 1)
    assert bench.states.damaged == 2


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"error": "the port was unplugged"}, LinkLostError, "unplugged"),
        ({"position": (1.0, 2.0)}, RemoteProtocolError, "differ in length"),
        ({"flags": ()}, RemoteProtocolError, "differ in length"),
        ({"names": ("J1", "J1")}, RemoteProtocolError, "differ in length"),
    ],
)
def test_a_state_without_values_raises_why(changes: dict[str, Any], error: type[Exception], words: str) -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0, **changes))
    with pytest.raises(error, match=words):
        bench.states.next(0.0, 0.0)


def test_a_state_without_joints_is_no_state_of_the_robot() -> None:
    bench = Bench()
    none: dict[str, Any] = dict.fromkeys(
        ("names", "position", "velocity", "load", "current", "voltage", "temperature", "flags", "age"), ()
    )
    bench.arrive(state(1, 110.0, **none))
    assert bench.states.next(0.0, 0.0) is None


def test_who_waits_gets_the_next_state_or_hears_of_the_end() -> None:
    states = ArrivedStates("zenoh:arm", ClockOffset())
    got: list[object] = []

    def wait() -> None:
        try:
            got.append(states.next(0.0, 30.0))
        except LinkLostError as error:
            got.append(error)

    for act in (lambda: states.add(state(1, 1.0)), states.close):
        thread = threading.Thread(target=wait)
        states.newest = None
        thread.start()
        act()
        thread.join(30.0)
        assert not thread.is_alive()
    assert got[0] is not None
    assert not isinstance(got[0], Exception)
    assert isinstance(got[1], LinkLostError)


# -- an inbox ---------------------------------------------------------------------------------------------


class InboxBench:
    def __init__(self) -> None:
        self.time, self.inbox = 10.0, FakeInbox()
        self.states = ArrivedStates("zenoh:arm", ClockOffset(), self.inbox, now=lambda: self.time)
        self.got = queue.Queue[object]()

    def begin(self, call: Callable[[], object]) -> threading.Thread:
        def run() -> None:
            try:
                self.got.put(call())
            except BaseException as error:  # noqa: BLE001  # handed to the test
                self.got.put(error)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        return thread

    def result(self) -> Any:
        return self.got.get(timeout=PATIENCE)


def test_what_waits_in_the_inbox_is_taken_at_once_and_the_newest_counts() -> None:
    bench = InboxBench()
    for sequence in (1, 2, 3):
        bench.inbox.rows.put(state(sequence, 10.0 + sequence, position=(float(sequence),)))
    got = bench.states.next(0.0, 0.5)
    assert got is not None
    assert got["J1"].position == 3.0
    assert (bench.states.seen, bench.states.lost) == (3, 0)
    assert not bench.inbox.receivers, "it did not wait"


def test_what_waited_before_a_refresh_is_no_state_that_arrives_later() -> None:
    bench = InboxBench()
    bench.inbox.rows.put(state(1, 10.0))
    bench.states.refresh()
    assert bench.states.newest is not None
    thread = bench.begin(lambda: bench.states.next(bench.time, 5.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    bench.time += 0.01
    bench.inbox.rows.put(state(2, 10.01, position=(0.25,)))
    assert bench.result()["J1"].position == 0.25
    assert bench.inbox.receivers == {thread.ident}, "it receives itself"


def test_a_refresh_waits_for_what_another_thread_is_taking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_TAKING", PATIENCE)
    bench, inside, go_on = InboxBench(), threading.Event(), threading.Event()
    poll = bench.inbox.poll

    def slow() -> bytes | None:
        bench.inbox.poll = poll  # type: ignore[method-assign]
        inside.set()
        assert go_on.wait(PATIENCE)
        return poll()

    bench.inbox.rows.put(state(1, 10.0))
    bench.inbox.poll = slow  # type: ignore[method-assign]
    bench.begin(bench.states.refresh)
    assert inside.wait(PATIENCE)
    seen = list[int]()
    thread = bench.begin(lambda: (bench.states.refresh(), seen.append(bench.states.seen)))
    threading.Timer(0.1, go_on.set).start()
    thread.join(PATIENCE)
    assert seen == [1]


def test_one_receives_for_all_who_wait() -> None:
    bench = InboxBench()
    for _ in range(3):
        bench.begin(lambda: bench.states.next(bench.time, 5.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    bench.time += 0.01
    bench.inbox.rows.put(state(1, 10.01, position=(0.5,)))
    assert [bench.result()["J1"].position for _ in range(3)] == [0.5] * 3
    assert len(bench.inbox.receivers) == 1


def test_who_waits_goes_on_though_what_arrives_for_another_is_of_no_use() -> None:
    bench = InboxBench()
    bench.states.add(state(5, 10.0))
    for _ in range(2):
        bench.begin(lambda: bench.states.next(bench.time, 5.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    for useless in (state(4, 10.0), b"noise", b""):
        bench.inbox.rows.put(useless)
        assert bench.inbox.waiting.acquire(timeout=PATIENCE), "one of them receives again"
    bench.time += 0.01
    bench.inbox.rows.put(state(6, 10.01))
    assert [bench.result().names for _ in range(2)] == [("J1",)] * 2


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("from a signal handler")])
def test_if_the_one_who_receives_is_interrupted_the_next_one_does(error: BaseException) -> None:
    bench = InboxBench()
    for _ in range(2):
        bench.begin(lambda: bench.states.next(bench.time, 5.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    bench.inbox.rows.put(error)
    assert bench.result() is error
    assert bench.inbox.waiting.acquire(timeout=PATIENCE), "the other one receives now"
    bench.time += 0.01
    bench.inbox.rows.put(state(1, 10.01))
    assert bench.result().names == ("J1",)
    assert len(bench.inbox.receivers) == 2


def test_a_wait_that_is_over_ends_at_the_next_refresh() -> None:
    bench = InboxBench()
    bench.begin(lambda: bench.states.next(bench.time, 1.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    bench.time += 0.9
    bench.states.refresh()
    assert bench.inbox.rows.empty(), "not yet"
    bench.time += 0.2
    bench.states.refresh()
    assert bench.result() is None


def test_a_wait_ends_when_the_session_is_closed_or_the_driver_detached() -> None:
    for act in (
        lambda bench: bench.states.close(),
        lambda bench: bench.inbox.rows.put(LinkClosedError("the session is closed")),
    ):
        bench = InboxBench()
        for _ in range(2):
            bench.begin(lambda bench=bench: bench.states.next(bench.time, 5.0))  # type: ignore[misc]
        assert bench.inbox.waiting.acquire(timeout=PATIENCE)
        act(bench)
        assert [type(bench.result()) for _ in range(2)] == [LinkLostError] * 2


def test_a_read_in_a_signal_handler_of_the_thread_that_waits_receives_too() -> None:
    bench, within = InboxBench(), list[object]()
    real = bench.inbox.wait

    def wait() -> bytes:
        bench.inbox.wait = real  # type: ignore[method-assign]
        bench.time += 0.01
        bench.inbox.rows.put(state(1, 10.01, position=(0.1,)))
        within.append(bench.states.next(bench.time - 0.001, 5.0))
        bench.time += 0.01
        bench.inbox.rows.put(state(2, 10.02, position=(0.2,)))
        return real()

    bench.inbox.wait = wait  # type: ignore[method-assign]
    assert bench.states.next(bench.time + 0.015, 5.0)["J1"].position == 0.2  # type: ignore[index]
    assert within[0]["J1"].position == 0.1  # type: ignore[index]


@pytest.mark.parametrize("waits", [False, True], ids=["it has arrived", "it waits"])
def test_a_wait_that_a_signal_handler_read_in_still_ends_in_time(waits: bool) -> None:
    bench, within = InboxBench(), list[object]()
    real = bench.inbox.wait

    def handler() -> bytes:
        if waits:
            bench.inbox.rows.put(b"")
            bench.inbox.wait = arrives  # type: ignore[method-assign]
        else:
            bench.inbox.wait = real  # type: ignore[method-assign]
            bench.inbox.rows.put(state(1, 10.01))
        bench.time += 0.01
        within.append(bench.states.next(bench.time - 0.001, 0.5))
        return real()

    def arrives() -> bytes:
        bench.inbox.wait = real  # type: ignore[method-assign]
        bench.inbox.rows.put(state(1, 10.01))
        return bench.inbox.rows.get()  # type: ignore[return-value]

    bench.inbox.wait = handler  # type: ignore[method-assign]
    bench.begin(lambda: bench.states.next(bench.time + 0.5, 1.0))
    assert bench.inbox.waiting.acquire(timeout=PATIENCE)
    assert within[0] is not None
    bench.time += 2.0
    bench.states.refresh()
    assert bench.result() is None


# --- the one that is there ------------------------------------------------------------------------


def test_the_latest_state_is_there_at_once_however_old_it_is() -> None:
    bench = Bench()
    assert bench.states.latest() is None
    bench.arrive(state(1, 110.0, position=(0.5,)))
    bench.time += 60.0
    got = bench.states.latest()
    assert got is not None
    assert (got["J1"].position, got.stamp) == (0.5, pytest.approx(10.0, abs=1e-3))


def test_the_latest_state_may_be_from_before_an_order_and_from_before_the_robot_was_busy() -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0, position=(0.5,)))
    bench.states.require(3)
    bench.arrive(state(2, 110.1, names=(), done=1))
    got = bench.states.latest()
    assert got is not None
    assert got["J1"].position == 0.5


def test_there_is_no_latest_state_of_a_server_that_was_started_anew() -> None:
    bench = Bench()
    bench.arrive(state(900, 5000.0))
    bench.arrive(state(1, 3.0, server=2, names=()))
    assert bench.states.latest() is None


def test_the_latest_state_tells_of_a_lost_robot_and_of_an_end() -> None:
    bench = Bench()
    bench.arrive(state(1, 110.0))
    bench.arrive(state(2, 110.1, error="the port was unplugged"))
    with pytest.raises(LinkLostError, match="unplugged"):
        bench.states.latest()
    bench.states.close()
    with pytest.raises(LinkLostError, match="detached"):
        bench.states.latest()
