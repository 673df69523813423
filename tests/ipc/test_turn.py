"""One at a time, the owner again, and the urgent first."""

from __future__ import annotations

import threading

import pytest

from hexwire.ipc.turn import Turn

PATIENCE = 10.0


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

    assert turn.begin_listening(woken.set)
    thread = threading.Thread(target=waiter)
    thread.start()
    assert woken.wait(PATIENCE)
    turn.end()
    assert turn.begin_listening(woken.set)
    order.append("listener")
    turn.end()
    thread.join(PATIENCE)
    assert order == ["waiter", "listener"]
    assert (turn.waiting, turn.listening) == (0, None)


def test_a_listener_stays_awake_to_others_after_a_request_of_its_own() -> None:
    turn = Turn()

    def wake() -> None: ...

    assert turn.begin_listening(wake)
    with turn.taken():
        pass
    assert turn.listening is wake
    turn.end()
    assert turn.listening is None


def test_the_owner_that_listens_keeps_the_lock() -> None:
    turn = Turn()
    with turn.taken():
        assert not turn.begin_listening(lambda: None)
        assert turn.listening is None
        turn.end()
        assert turn.owner == threading.get_ident()
