from __future__ import annotations

import sys
import threading
from collections.abc import Callable

import pytest
from interrupts import interrupted_at, places

from hexwire.link.poll_link import CallTurn
from hexwire.testing.link import PATIENCE, Background


def _is_free(turn: CallTurn) -> bool:
    """Whether another thread gets the turn at once."""
    return Background(lambda: turn.later(0.0, lambda: True)).outcome() is True


def test_a_call_waits_for_the_turn_and_gives_it_back() -> None:
    turn = CallTurn()
    assert turn.later(0.0, lambda: turn.taken) == 1
    assert not turn.taken
    inside, go_on = threading.Event(), threading.Event()

    def first() -> bool:
        inside.set()
        return go_on.wait(PATIENCE)

    holder = Background(lambda: turn.later(-1.0, first))
    assert inside.wait(PATIENCE)
    assert turn.taken == 1
    assert turn.later(0.0, lambda: True) is None
    assert turn.taken == 1
    second = Background(lambda: turn.later(PATIENCE, lambda: True))
    second.let_it_block()
    assert turn.taken == 2, "who comes now waits behind it"
    go_on.set()
    assert holder.outcome() is True
    assert second.outcome() is True
    assert not turn.taken


def test_a_call_inside_a_call_leaves_the_turn_to_the_outer_one() -> None:
    turn = CallTurn()
    assert not turn.is_mine()

    def inner() -> bool:
        assert Background(turn.is_mine).outcome() is False
        return turn.is_mine()

    def outer() -> bool:
        assert turn.later(0.0, inner)
        assert turn.is_mine()
        return turn.taken == 1 and not _is_free(turn)

    assert turn.later(0.0, outer)
    assert not turn.is_mine()
    assert _is_free(turn)


def test_an_error_gives_the_turn_back() -> None:
    turn = CallTurn()
    with pytest.raises(ZeroDivisionError):
        turn.later(0.0, lambda: 1 // 0)
    assert not turn.taken
    assert _is_free(turn)


@pytest.mark.parametrize("inside", [False, True], ids=["alone", "inside another call"])
def test_ctrl_c_at_any_step_leaves_the_turn_free(inside: bool) -> None:
    def use(turn: CallTurn) -> Callable[[], object]:
        call = lambda: turn.later(0.0, lambda: True)  # noqa: E731  (the steps of both functions are wanted)
        return (lambda: turn.later(0.0, call)) if inside else call

    for step in range(1, places(use(CallTurn())) + 1):
        turn = CallTurn()
        where = interrupted_at(step, use(turn))
        assert where, "the step is reached"
        assert not turn.taken, where
        assert _is_free(turn), where
    assert sys.getprofile() is None
