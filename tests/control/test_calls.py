from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from tests.waits import PATIENCE, eventually

from hexwire.control.loop import owner as module
from hexwire.control.loop.owner import QueuedCalls
from hexwire.errors import (
    DeviceError,
    LinkLostError,
    LinkTimeoutError,
    PreemptedError,
    ReplyTimeoutError,
    UsageError,
)


class Caller:
    """A thread that calls, and what came of it."""

    def __init__(self, jobs: QueuedCalls, job: Callable[[], Any]) -> None:
        self.result: Any = None
        self.error: BaseException | None = None
        self._calls, self._job = jobs, job
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        try:
            self.result = self._calls.call(self._job)
        except BaseException as error:  # noqa: BLE001  # judged by the test
            self.error = error

    def join(self) -> Caller:
        self.thread.join(30.0)
        assert not self.thread.is_alive()
        return self


def waiting(jobs: QueuedCalls, count: int = 1) -> None:
    """Until so many calls wait."""
    eventually(lambda: len(jobs._waiting) >= count)


def raising(error: BaseException) -> Callable[[], Any]:
    def job() -> None:
        raise error

    return job


def test_the_caller_gets_what_the_owner_did() -> None:
    jobs = QueuedCalls()
    caller = Caller(jobs, lambda: threading.current_thread())
    waiting(jobs)
    jobs.run()
    assert caller.join().result is threading.current_thread()
    jobs.run()


def test_jobs_are_done_in_their_order() -> None:
    jobs = QueuedCalls()
    done: list[int] = []
    callers = []
    for i in range(5):
        callers.append(Caller(jobs, lambda i=i: done.append(i)))  # type: ignore[misc]  # mypy: default in a lambda
        waiting(jobs, i + 1)
    jobs.run()
    for caller in callers:
        caller.join()
    assert done == [0, 1, 2, 3, 4]


def test_a_fault_of_a_job_is_its_callers_alone() -> None:
    jobs = QueuedCalls()
    for error in (UsageError("no"), ZeroDivisionError(), ReplyTimeoutError("silent"), DeviceError("x")):
        caller, after = Caller(jobs, raising(error)), None
        waiting(jobs)
        after = Caller(jobs, lambda: 7)
        waiting(jobs, 2)
        jobs.run()
        assert caller.join().error is error, "also if it is a kind of time-out"
        assert after.join().result == 7


@pytest.mark.parametrize(
    "error", [LinkLostError("gone"), LinkTimeoutError("stuck"), PreemptedError("stop"), KeyboardInterrupt()]
)
def test_a_lost_line_is_the_owners_business_too(error: BaseException) -> None:
    jobs = QueuedCalls()
    first = Caller(jobs, raising(error))
    waiting(jobs)
    second = Caller(jobs, lambda: 7)
    waiting(jobs, 2)
    with pytest.raises(type(error)):
        jobs.run()
    assert first.join().error is error
    jobs.run()
    assert second.join().result == 7, "what waits behind is not lost by it"


def test_no_caller_waits_forever_and_a_dropped_call_never_runs() -> None:
    jobs = QueuedCalls(timeout=0.05)
    done: list[int] = []
    caller = Caller(jobs, lambda: done.append(1)).join()
    assert isinstance(caller.error, DeviceError)
    assert str(caller.error) == "the robot was busy for 0.05 s; nothing was done"
    jobs.run()
    assert done == []
    assert not jobs._waiting


def test_a_caller_waits_ten_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr(module, "wait", lambda futures, timeout: waited.append(timeout))
    with pytest.raises(DeviceError, match=r"^the robot was busy for 10 s; nothing was done$"):
        QueuedCalls().call(lambda: 1)
    assert waited == [10.0]


def test_a_job_that_is_being_done_is_waited_for_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs, waited = QueuedCalls(), list[float]()
    begun, go_on = threading.Event(), threading.Event()

    def until_begun(futures: object, timeout: float) -> None:
        """Its time is over when the job has begun."""
        waited.append(timeout)
        assert begun.wait(PATIENCE)

    monkeypatch.setattr(module, "wait", until_begun)

    def job() -> int:
        begun.set()
        go_on.wait(30.0)
        return 7

    caller = Caller(jobs, job)
    waiting(jobs)
    owner = threading.Thread(target=jobs.run, daemon=True)
    owner.start()
    assert begun.wait(30.0)
    caller.join()
    assert isinstance(caller.error, DeviceError), "not a TimeoutError of the library's, which nobody catches"
    assert str(caller.error) == "the robot has not finished within 10 s"
    assert waited == [10.0, 10.0]
    go_on.set()
    owner.join(30.0)
    assert not owner.is_alive()


def test_all_who_wait_are_told_when_there_is_no_robot() -> None:
    jobs = QueuedCalls()
    callers = []
    for i in range(3):
        callers.append(Caller(jobs, lambda: 7))
        waiting(jobs, i + 1)
    jobs.fail(LinkLostError("gone"))
    for caller in callers:
        assert isinstance(caller.join().error, LinkLostError)
    jobs.run()
