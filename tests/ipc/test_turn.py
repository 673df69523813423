"""One at a time, the owner again, and the urgent first."""

from __future__ import annotations

import threading

import pytest

from hexwire.ipc.turn import Turn

PATIENCE = 30.0


def never() -> bool:
    return False


def test_the_owner_may_take_it_again() -> None:
    turn = Turn()
    with turn.taken():
        assert turn.owner == threading.get_ident()
        with turn.taken():
            pass
        assert turn.owner == threading.get_ident()
    assert turn.owner == 0


def test_the_urgent_overtake_those_who_wait() -> None:
    turn = Turn()
    order: list[str] = []
    nudged = threading.Event()

    def ordinary() -> None:
        with turn.taken():
            order.append("ordinary")

    def urgent() -> None:
        turn.begin(nudged.set)
        order.append("urgent")
        turn.end()

    turn.begin()
    first = threading.Thread(target=ordinary)
    first.start()
    second = threading.Thread(target=urgent)
    second.start()
    assert nudged.wait(PATIENCE)
    assert turn.urgent_waiting == 1
    turn.end()
    first.join(PATIENCE)
    second.join(PATIENCE)
    assert order == ["urgent", "ordinary"]
    assert (turn.urgent_waiting, turn.owner) == (0, 0)


def test_the_owner_does_not_wait_for_the_urgent_one_behind_it() -> None:
    turn = Turn()
    nudged = threading.Event()

    def urgent() -> None:
        turn.begin(nudged.set)
        turn.end()

    with turn.taken():
        thread = threading.Thread(target=urgent)
        thread.start()
        assert nudged.wait(PATIENCE)
        with turn.taken():
            assert turn.urgent_waiting == 1
    thread.join(PATIENCE)
    assert not thread.is_alive()


def test_a_nudge_that_fails_leaves_nothing_counted() -> None:
    turn = Turn()

    def fail() -> None:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        turn.begin(fail)
    assert turn.urgent_waiting == 0
    with turn.taken():
        pass


def test_a_listener_is_woken_by_those_who_wait_and_lets_them_in_first() -> None:
    turn = Turn()
    woken = threading.Event()
    order: list[str] = []

    def waiter() -> None:
        with turn.taken():
            order.append("waiter")

    assert turn.begin_listening(woken.set, never)
    thread = threading.Thread(target=waiter)
    thread.start()
    assert woken.wait(PATIENCE)
    turn.end()
    assert turn.begin_listening(woken.set, never)
    order.append("listener")
    turn.end()
    thread.join(PATIENCE)
    assert order == ["waiter", "listener"]
    assert (turn.waiting, turn.listening) == (0, None)


def test_a_listener_stays_awake_to_others_after_a_request_of_its_own() -> None:
    turn = Turn()

    def wake() -> None: ...

    assert turn.begin_listening(wake, never)
    with turn.taken():
        pass
    assert turn.listening is wake
    turn.end()
    assert turn.listening is None


def test_the_owner_that_listens_keeps_the_lock() -> None:
    turn = Turn()
    with turn.taken():
        assert not turn.begin_listening(lambda: None, never)
        assert turn.listening is None
        turn.end()
        assert turn.owner == threading.get_ident()


def test_a_job_is_run_by_an_owner_that_waits_or_by_its_own_thread_and_its_error_is_told() -> None:
    turn, woken = Turn(), threading.Event()
    ran: list[int] = []

    def fails() -> None:
        raise ValueError("a job")

    turn.run(lambda: ran.append(threading.get_ident()), woken.set)
    assert ran == [threading.get_ident()]
    assert not woken.is_set()
    errors: list[ValueError] = []

    def another() -> None:
        turn.run(lambda: ran.append(threading.get_ident()), woken.set)
        try:
            turn.run(fails, woken.set)
        except ValueError as error:
            errors.append(error)

    turn.begin()
    thread = threading.Thread(target=another)
    thread.start()
    while thread.is_alive():
        # It waits for its own answer, and never releases the lock.
        assert woken.wait(PATIENCE)
        turn.run_jobs()
        thread.join(0.001)
    assert ran == [threading.get_ident()] * 2
    assert [str(error) for error in errors] == ["a job"]
    turn.end()


def test_a_listener_takes_what_an_owner_has_received_for_it() -> None:
    turn, taken = Turn(), list[bool | None]()
    arrived = threading.Event()
    with turn.taken():
        thread = threading.Thread(target=lambda: taken.append(turn.begin_listening(lambda: None, arrived.is_set)))
        thread.start()
        assert not taken
        arrived.set()
        thread.join(PATIENCE)
    assert taken == [None]
