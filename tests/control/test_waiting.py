from __future__ import annotations

import threading

import pytest

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.loop.waiting import TryLock, Waiter, join_or_abort
from hexwire.errors import UsageError

DONE = Ended(Outcome.SUCCEEDED, Reason.REACHED)
STOPPED = Ended(Outcome.ABORTED, Reason.STOPPED, "stopped: it burns")
REPLACED = Ended(Outcome.PREEMPTED, Reason.REPLACED)


def test_all_must_succeed() -> None:
    waiter = Waiter(2)
    waiter.ended(DONE)
    assert waiter.end is None
    waiter.ended(DONE)
    assert waiter.wait(0.0) is DONE


def test_what_the_goals_say_that_succeeded() -> None:
    waiter = Waiter(3)
    for text in ("J2 0.6 deg off", "", "J7 1.0 deg off"):
        waiter.ended(Ended(Outcome.SUCCEEDED, Reason.REACHED, text))
    assert waiter.off == ("J2 0.6 deg off", "J7 1.0 deg off")


def test_the_first_that_fails_ends_the_wait() -> None:
    waiter = Waiter(3)
    waiter.ended(STOPPED)
    with pytest.raises(UsageError, match=r"^stopped: it burns$"):
        waiter.wait(0.0)
    waiter.ended(REPLACED)
    waiter.ended(DONE)
    assert waiter.end is STOPPED


def test_an_end_without_words() -> None:
    waiter = Waiter()
    waiter.ended(REPLACED)
    with pytest.raises(UsageError, match=r"^preempted$"):
        waiter.wait(0.0)


def test_a_goal_that_is_never_reached_times_out() -> None:
    with pytest.raises(UsageError, match=r"^not arrived after 0 s; the arm holds$"):
        Waiter().wait(0.0)


def test_another_thread_ends_the_wait() -> None:
    waiter = Waiter()
    timer = threading.Timer(0.01, waiter.ended, (DONE,))
    timer.start()
    assert waiter.wait(60.0) is DONE
    timer.join()


def test_one_at_a_time() -> None:
    lock = threading.Lock()
    with TryLock(lock), pytest.raises(UsageError, match="busy with another request"), TryLock(lock):
        raise AssertionError("two at once")
    assert not lock.locked()


def test_a_failure_gives_the_arm_free() -> None:
    lock = threading.Lock()
    with pytest.raises(ZeroDivisionError), TryLock(lock):
        raise ZeroDivisionError
    with TryLock(lock):
        assert lock.locked()


@pytest.mark.parametrize("calls", [1, 3])
def test_a_thread_that_waits_again_is_hung_up_on_again(calls: int) -> None:
    bell = threading.Semaphore(0)
    thread = threading.Thread(target=lambda: [bell.acquire() for _ in range(calls)], daemon=True)
    thread.start()
    assert join_or_abort(thread, 0.0, bell.release, 10.0)
    assert not thread.is_alive()


def test_a_thread_that_never_ends_is_given_up() -> None:
    free = threading.Event()
    thread = threading.Thread(target=free.wait, args=(60,), daemon=True)
    thread.start()
    hung_up: list[bool] = []
    assert not join_or_abort(thread, 0.0, lambda: hung_up.append(True), 0.0)
    assert len(hung_up) > 1
    free.set()
    assert join_or_abort(thread, 30.0, lambda: None, 0.0)
