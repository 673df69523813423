"""Set-points that a client publishes: when it does, and that it learns of each refusal."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from tests.waits import eventually

from hexwire.drivers import registry
from hexwire.errors import LeaseError, LimitError, PreemptedError, ReplyTimeoutError, StoppedError
from hexwire.fleet import messages as m
from hexwire.fleet.remote import RemoteRobot
from hexwire.fleet.set_points import SetPointReports, SharedSetPoints
from hexwire.model.state import JointTarget, SentTarget

from .conftest import Serve
from .fake_inbox import FakeInbox
from .fake_server import attached

SENT = SentTarget((("J1", 0.1),), 0.02, ("J1",), ("J2",))
STATE = m.State(1, 1, 0.0, 0.0, 0.0, (), *((),) * 8, 0.0, False, False, False)  # type: ignore[arg-type]
KEY = 77


class Bench:
    """A client and what a server tells it, without a network, in simulated time."""

    def __init__(self) -> None:
        self.time, self.sequence, self.stopping = 100.0, 0, False
        self.reports = SetPointReports()
        self.stream = SharedSetPoints("zenoh:lab/arm1")
        self.stream.begin(self.reports.number(KEY))

    def look(self, **changes: Any) -> None:
        told = self.reports.report(KEY, self.reports.dealt)
        self.stream.look(msgspec.structs.replace(STATE, **{"stream": told} | changes), self.time)

    def answer(self, wait: float = 0.01, *, set_point: bool = True) -> None:
        self.time += wait
        self.sequence += 1
        self.stream.answered(self.sequence, self.time, set_point=set_point)

    def publish(self) -> None:
        self.time += 0.01
        self.sequence += 1
        self.stream.published(self.sequence, self.time)

    def runs(self) -> bool:
        return self.stream.runs(self.time + 0.01)

    def begin(self) -> None:
        for _ in range(5):
            self.answer()
        self.look()
        assert self.runs()


def test_a_stream_begins_after_answered_set_points_that_follow_each_other_closely() -> None:
    bench = Bench()
    for count in range(5):
        bench.look()
        assert not bench.runs(), count
        bench.answer()
    assert bench.runs()
    for ends in (
        lambda bench: bench.answer(set_point=False),
        lambda bench: bench.answer(0.2),
        lambda bench: bench.stream.begin(0),
        lambda bench: setattr(bench, "time", bench.time + 0.2),
    ):
        other = Bench()
        other.begin()
        ends(other)
        assert not other.runs()


def test_a_server_that_tells_nothing_gets_no_published_set_points() -> None:
    for changes in ({"stream": None}, {"stream": m.Stream(5)}):
        bench = Bench()
        for _ in range(9):
            bench.answer()
            bench.look(**changes)
        assert not bench.runs()
        assert bench.stream.take_error() is None


def test_states_that_fail_to_arrive_end_it() -> None:
    bench = Bench()
    bench.begin()
    for _ in range(60):
        bench.publish()
    assert not bench.runs()


def test_of_many_that_no_state_tells_of_the_next_one_is_asked() -> None:
    bench = Bench()
    bench.begin()
    for _ in range(50):
        assert bench.runs()
        bench.publish()
        bench.look()
    assert not bench.runs()
    bench.answer()
    assert bench.runs(), "and that was all"


def test_what_was_done_renews_the_lease_and_says_which_joints_were_limited() -> None:
    bench = Bench()
    bench.begin()
    bench.publish()
    assert bench.stream.renewed < bench.time
    bench.reports.done(KEY, bench.sequence, SENT)
    bench.look()
    assert bench.stream.renewed == bench.time
    assert (bench.stream.clamped, bench.stream.silent) == (("J1",), ("J2",))
    assert bench.runs()


def test_a_refusal_is_an_error_once_and_ends_the_stream() -> None:
    bench = Bench()
    bench.begin()
    for number in range(3):
        bench.publish()
        if number:
            bench.reports.refuse(KEY, bench.sequence, LeaseError("too late", lost=False))
    bench.look()
    error = bench.stream.take_error()
    assert isinstance(error, LeaseError)
    assert not error.lost
    assert bench.stream.refused == 2
    bench.look()
    assert bench.stream.take_error() is None
    assert not bench.runs()
    bench.begin()


def test_a_stopped_arm_is_told_by_the_state_and_the_next_order() -> None:
    bench = Bench()
    bench.begin()
    bench.publish()
    bench.reports.refuse(KEY, bench.sequence, StoppedError("a move", 5, "the arm is stopped"))
    bench.look()
    assert bench.stream.take_error_of_read(bench.time + 9.0, stopped=True) is None
    assert isinstance(bench.stream.take_error(), StoppedError)


def test_who_goes_on_writing_hears_of_a_refusal_there_and_who_only_reads_soon() -> None:
    bench = Bench()
    bench.begin()
    bench.publish()
    bench.reports.refuse(KEY, bench.sequence, LeaseError("too late", lost=False))
    bench.look()
    assert bench.stream.take_error_of_read(bench.time + 0.2, stopped=False) is None
    assert isinstance(bench.stream.take_error_of_read(bench.time + 0.3, stopped=False), LeaseError)
    assert bench.stream.take_error() is None


def test_a_signal_handler_that_stops_the_arm_anywhere_here_neither_waits_nor_breaks_it() -> None:
    bench = Bench()
    bench.begin()
    for _ in range(3):
        bench.publish()
    bench.reports.done(KEY, bench.sequence - 1, SENT)
    told = bench.reports.report(KEY, bench.reports.dealt)
    lines = 0

    def trace(frame: Any, event: str, argument: object) -> Any:
        nonlocal lines
        if frame.f_code.co_filename.endswith("set_points.py") and event == "line" and not bench.stopping:
            lines += 1
            bench.stopping = True
            bench.stream.answered(bench.sequence, bench.time, set_point=False)
            bench.stopping = False
        return trace

    sys.settrace(trace)
    try:
        bench.stream.look(msgspec.structs.replace(STATE, stream=told), bench.time)
        bench.stream.published(bench.sequence + 1, bench.time)
        bench.stream.take_error()
    finally:
        sys.settrace(None)
    assert lines > 10
    bench.look()
    assert bench.stream.take_error() is None


def test_a_refusal_of_before_an_answered_order_is_over() -> None:
    bench = Bench()
    bench.begin()
    bench.publish()
    bench.reports.refuse(KEY, bench.sequence, StoppedError("a move", 5, "the arm is stopped"))
    bench.answer(set_point=False)
    bench.look()
    assert bench.stream.take_error() is None


def test_one_of_which_no_state_tells_is_lost_after_the_time_of_an_answer() -> None:
    bench = Bench()
    bench.begin()
    bench.publish()
    bench.time += 1.9
    bench.look()
    assert bench.stream.take_error() is None
    bench.time += 0.2
    bench.look()
    assert isinstance(bench.stream.take_error(), ReplyTimeoutError)
    assert not bench.runs()


def test_a_lease_of_another_ends_it_with_the_reason() -> None:
    for changes, words in (
        ({"stream": m.Stream(5), "holder": "Eve"}, "Eve holds the lease"),
        ({"stream": None, "held": "Ann lost the lease after 0.5 s of silence"}, "Ann lost the lease"),
    ):
        bench = Bench()
        bench.begin()
        bench.publish()
        bench.look(**changes)
        error = bench.stream.take_error()
        assert isinstance(error, LeaseError)
        assert error.lost
        assert words in str(error)


@pytest.mark.parametrize("key", [1, KEY])
def test_another_lease_has_another_number_and_no_memory(key: int) -> None:
    reports = SetPointReports()
    first = reports.number(key)
    assert first != 0, "that of nobody"
    reports.refuse(key, 3, LeaseError("too late"))
    assert reports.number(key + 1) not in (first, key + 1)
    # One that ended late is nobody's any more.
    reports.done(key, 4, SENT)
    assert reports.report(key + 1, reports.dealt) == m.Stream(reports.number(key + 1))
    assert reports.report(0, (0, 0)) is None
    # A state that is made while the lease changes hands gives no number to one that has none, nor takes one away.
    second = reports.number(key + 1)
    assert [reports.report(other, (0, 0)) for other in (key, key + 2)] == [None, None]
    assert reports.number(key + 1) == second


def detaching(robot: RemoteRobot) -> tuple[FakeInbox, threading.Thread]:
    """Detach, in a thread, a robot that has sent a set-point of which no state tells yet."""
    robot.take()
    robot._set_points.begin(5)
    robot._set_points.published(1, time.monotonic())
    inbox = robot._states._inbox
    assert isinstance(inbox, FakeInbox)
    thread = threading.Thread(target=robot.detach, daemon=True)
    thread.start()
    return inbox, thread


@pytest.mark.parametrize("refused", [0, 1])
def test_the_lease_is_given_back_after_the_set_points_and_what_was_refused_is_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, refused: int
) -> None:
    robot, server = attached(monkeypatch)
    inbox, thread = detaching(robot)
    assert inbox.waiting.acquire(timeout=30.0)
    assert not any(isinstance(message, m.Leave) for _, message in server.asked)
    told = m.Stream(5, 1, refused, 1, "LimitError" if refused else "", "too far")
    inbox.rows.put(m.encode(msgspec.structs.replace(STATE, stream=told)))
    thread.join(30.0)
    # The thread that keeps the lease may still renew it meanwhile.
    assert [message for _, message in server.asked if isinstance(message, m.Leave)] == [m.Leave(17, finish=True)]
    assert ("the last set-points were not done: too far" in caplog.text) is bool(refused)


def test_the_lease_is_given_back_although_no_state_tells_of_the_set_points(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hexwire.fleet.remote._TIMEOUT", 0.1)
    robot, server = attached(monkeypatch)
    inbox, thread = detaching(robot)

    def ended() -> bool:
        inbox.wake()
        return not thread.is_alive()

    eventually(ended)
    assert [message for _, message in server.asked if isinstance(message, m.Leave)] == [m.Leave(17, finish=True)]


READS: list[Callable[[RemoteRobot], object]] = [
    RemoteRobot.read,
    RemoteRobot.newest,
    lambda robot: next(robot.stream(0.01, timeout=30.0)),
]


@pytest.mark.parametrize("read", READS)
def test_who_only_reads_after_set_points_hears_that_one_was_refused(
    monkeypatch: pytest.MonkeyPatch, read: Callable[[RemoteRobot], object]
) -> None:
    robot, _ = attached(monkeypatch)
    robot.take()
    robot._set_points.begin(5)
    robot._set_points.published(1, time.monotonic() - 1.0)
    inbox, one = robot._states._inbox, (0.0,)
    assert isinstance(inbox, FakeInbox)
    told = m.Stream(5, 1, 1, 1, "LimitError", "too far")
    ended, number = threading.Event(), itertools.count(1)

    def tell() -> None:
        while not ended.wait(0.01):
            values = m.State(1, next(number), 0.0, 0.0, 0.0, ("J1",), *(one,) * 6, (0,), one, 0.0, *(False,) * 3)
            inbox.rows.put(m.encode(msgspec.structs.replace(values, stream=told)))

    thread = threading.Thread(target=tell)
    thread.start()
    try:
        with pytest.raises(LimitError, match="too far"):
            read(robot)
    finally:
        ended.set()
        thread.join(30.0)
        robot.abort()


# -- with a server ------------------------------------------------------------------------------------------


def stream(robot: RemoteRobot, done: Callable[[], object]) -> None:
    """Send set-points until something is true."""
    start = robot.read()["J1"].position
    ended = threading.Event()
    timer = threading.Timer(30.0, ended.set)
    timer.start()
    try:
        for number in itertools.count():
            robot.write(JointTarget.of({"J1": start + 1e-4 * (number % 2)}, 0.02))
            if done():
                return
            assert not ended.is_set(), "it did not happen"
            robot.read()
    finally:
        timer.cancel()


def published(robot: RemoteRobot) -> Callable[[], bool]:
    """Whether a set-point was published since, and a state has told of it."""
    before = robot._set_points.renewed
    return lambda: robot._set_points.renewed > before


def test_a_stream_is_published_and_ends_with_a_stop_and_with_the_lease(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    with registry.connect("zenoh:lab/arm1") as robot, registry.connect("zenoh:lab/arm1?take=1") as other:
        assert isinstance(robot, RemoteRobot)
        assert isinstance(other, RemoteRobot)
        robot.torque(True)
        stream(robot, published(robot))
        other.stop()
        with pytest.raises((StoppedError, PreemptedError)):
            stream(robot, lambda: False)
        robot.resume()
        robot.torque(True)
        stream(robot, published(robot))
        other.take()
        with pytest.raises(LeaseError, match=r"took the lease|holds the lease"):
            stream(robot, lambda: False)
