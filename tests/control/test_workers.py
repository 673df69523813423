"""Threads of a server that answer."""

from __future__ import annotations

import logging
import threading

import pytest
from tests.waits import eventually

from hexwire.control.loop import workers as module
from hexwire.control.loop.workers import Gathering, MergedCalls, Worker
from hexwire.errors import UsageError


def test_jobs_are_done_in_order_and_too_many_are_refused() -> None:
    begun, go, done = threading.Event(), threading.Event(), []
    worker = Worker("test", most=2)

    def slow() -> None:
        begun.set()
        go.wait(30)

    assert worker.put(slow)
    assert begun.wait(30)
    assert [worker.put(lambda i=i: done.append(i)) for i in range(3)] == [True, True, False]  # type: ignore[misc]
    go.set()
    worker.close(30)
    assert done == [0, 1]


def test_a_thread_begins_with_a_job_and_ends_when_it_is_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    for lasting in (False, True):
        done = threading.Event()
        with monkeypatch.context() as patch:
            patch.setattr(module, "_IDLE", 0.01)
            worker = Worker("test", lasting=lasting)
        assert (worker._thread is not None) == lasting
        for _ in range(3):
            done.clear()
            assert worker.put(done.set)
            assert done.wait(30)
            if not lasting:
                eventually(lambda worker=worker: worker._thread is None)  # type: ignore[misc]
        assert (worker._thread is not None) == lasting
        worker.close(30)
        assert not worker.put(done.set)


def test_a_job_that_fails_is_logged_and_the_next_one_done(caplog: pytest.LogCaptureFixture) -> None:
    done = threading.Event()
    worker = Worker("test")
    with caplog.at_level(logging.ERROR, "hexwire"):
        worker.put(lambda: 1 // 0)
        worker.put(done.set)
        worker.close(30)
    assert done.is_set()
    assert "ZeroDivisionError" in caplog.text


def test_what_arrives_meanwhile_is_passed_on_together() -> None:
    begun, go = threading.Event(), threading.Event()
    got: list[list[int]] = []

    def act(items: list[int]) -> None:
        got.append(items)
        begun.set()
        go.wait(30)

    stops = Gathering("test", act)
    stops.put(0)
    assert begun.wait(30)
    assert all(stops.put(i) for i in range(1, 1001))
    assert not stops.put(1001)
    go.set()
    stops.close(30)
    assert got == [[0], list(range(1, 1001))]


def test_what_fails_does_not_keep_the_next_from_being_passed_on(caplog: pytest.LogCaptureFixture) -> None:
    got: list[int] = []
    failed = threading.Event()

    def act(items: list[int]) -> None:
        got.extend(items)
        if not failed.is_set():
            failed.set()
            raise RuntimeError("a mistake")

    with caplog.at_level(logging.ERROR, "hexwire"):
        stops = Gathering("test", act)
        stops.put(1)
        assert failed.wait(30)
        stops.put(2)
        stops.close(30)
    assert got == [1, 2]
    assert "a mistake" in caplog.text


def test_one_call_answers_all_who_ask_before_it_begins() -> None:
    begun, go = threading.Event(), threading.Event()
    calls: list[list[int]] = []

    def call(said: list[int]) -> int:
        calls.append(said)
        begun.set()
        go.wait(30)
        return len(calls)

    stops = MergedCalls("test", call)
    first = stops.ask(0)
    assert begun.wait(30)
    others = {stops.ask(number % 3) for number in range(2356)}
    # Nobody who has gone cancels it for the others.
    assert not any(future.cancel() for future in others)
    go.set()
    assert first.result(30) == 1
    # What began before they asked is no answer to them.
    assert [future.result(30) for future in others] == [2]
    stops.close(30)
    assert calls == [[0], [0, 1, 2]]
    with pytest.raises(UsageError, match="the program ends"):
        stops.ask(0).result(30)


def test_a_call_that_fails_fails_for_all_who_asked() -> None:
    stops: MergedCalls[int, float] = MergedCalls("test", lambda said: 1 / said[0])
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            stops.ask(0).result(30)
    assert stops.ask(2).result(30) == 0.5
    stops.close(30)
