"""An order to a shared arm: what proves that it may be done."""

from __future__ import annotations

import threading

import pytest

from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order, OrderCheck
from hexwire.epochs import Epochs
from hexwire.errors import LeaseError


class Desk:
    """A holder, the clock, and who judges its orders."""

    def __init__(self) -> None:
        self.time = 100.0
        self.lease = Lease(timeout=10.0)
        self.judge = OrderCheck(self.lease, threading.RLock(), lambda: self.time, lambda: self.time)
        self.key = self.lease.take("Ann", 1, self.time).key
        self.epochs = Epochs()

    def order(self, number: int, made: float | None = None, doubt: float = 0.0) -> Order:
        return Order(self.key, number, self.epochs.mark(), made, doubt)


def test_an_order_carries_what_its_checks_need_and_nothing_else() -> None:
    token = Epochs().mark()
    order = Order(17, 3, token, 12.5, 0.001)
    assert (order.key, order.sequence, order.arrived, order.made, order.doubt) == (17, 3, token, 12.5, 0.001)
    # One that may wait has no time.
    assert Order(17, 4, token).made is None
    with pytest.raises(AttributeError):
        order.note = "x"  # type: ignore[attr-defined]  # that is what the test is about


def test_a_set_point_is_checked_again_right_before_its_bytes_leave_and_counted_once() -> None:
    desk = Desk()
    order = desk.order(1, made=desk.time, doubt=0.01)
    desk.judge.admit(order)
    token = desk.judge.token(order)
    desk.time += 0.25
    desk.epochs.check_leaving(token, "a move")
    # Half of a target would be worse than a late one.
    desk.time += 1.0
    desk.epochs.check_leaving(token, "a move")
    order = desk.order(2, made=desk.time)
    desk.judge.admit(order)
    token = desk.judge.token(order)
    desk.time += 0.3
    # Not while it waits, nor while its answer is awaited.
    assert desk.epochs.holds(token)
    with pytest.raises(LeaseError, match="300 ms old") as raised:
        desk.epochs.check_leaving(token, "a move")
    assert not raised.value.lost
    assert desk.lease.counters.too_old == 1


def test_an_order_that_may_wait_has_no_age() -> None:
    desk = Desk()
    order = desk.order(1)
    desk.judge.admit(order)
    desk.time += 5.0
    desk.epochs.check_leaving(desk.judge.token(order), "torque")


def test_what_is_refused_without_a_lease_is_counted_and_says_who_holds_it() -> None:
    desk = Desk()
    error = desk.judge.refusal(desk.key ^ 1)
    assert (error.holder, error.lost) == ("Ann", True)
    # It has become the holder since.
    assert not desk.judge.refusal(desk.key).lost
    assert desk.lease.counters.without_lease == 2
    assert desk.judge.of_targets() is None
    desk.time += 11.0
    assert desk.judge.of_targets() is not None
    assert "lost after" in str(desk.judge.refusal(desk.key))
