from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.base import StopMode
from hexwire.drivers.board import Board
from hexwire.drivers.hex7bot import StandingOrders
from hexwire.errors import CommandRefusedError, NotSupportedError

STATE = Arm(2).driver.read()
STOPPED = replace(STATE, stopped=True)
TRIPPED = replace(STOPPED, watchdog_tripped=True)


class Fake:
    """A board that notes what it is told."""

    dialect = 2
    has_watchdog = reports_states = keeps_trip = True

    def __init__(self, **options: Any) -> None:
        self.said: list[str] = []
        self.state, self.busy = STATE, False
        vars(self).update(options)

    def read(self, fields: int) -> Any:
        self.said.append("read")
        return self.state

    def watchdog(self, timeout: float, mode: StopMode) -> None:
        if self.busy:
            raise CommandRefusedError("WATCHDOG", 4, "busy")
        self.said.append(f"watchdog {timeout:g} {mode.name}")

    def report(self, period: float, fields: int) -> None:
        self.said.append(f"report {period:g} {fields}")


def board_of(fake: Fake) -> Board:
    return cast(Board, fake)


def test_a_watchdog_is_an_order_until_it_is_switched_off() -> None:
    fake, orders = Fake(), StandingOrders()
    orders.arm(board_of(fake), 0.5, StopMode.TORQUE_OFF)
    assert orders.watchdog == (0.5, StopMode.TORQUE_OFF)
    orders.arm(board_of(fake), 0.0, StopMode.HOLD)
    assert orders.watchdog is None
    assert fake.said == ["watchdog 0.5 TORQUE_OFF", "watchdog 0 HOLD"]


def test_a_watchdog_that_was_refused_is_no_order() -> None:
    orders = StandingOrders()
    with pytest.raises(CommandRefusedError):
        orders.arm(board_of(Fake(busy=True)), 0.5, StopMode.HOLD)
    assert orders.watchdog is None


def test_a_board_that_forgot_gets_its_orders_back() -> None:
    fake, orders = Fake(), StandingOrders()
    orders.watchdog, orders.report, orders.due = (0.5, StopMode.HOLD), (0.02, 7), True
    orders.give_back(board_of(fake))
    assert fake.said == ["watchdog 0.5 HOLD", "report 0.02 7"]
    assert (orders.due, orders.given_back) == (False, 1)


def test_orders_stay_due_until_the_board_takes_them() -> None:
    fake, orders = Fake(busy=True), StandingOrders()
    orders.watchdog, orders.due = (0.5, StopMode.HOLD), True
    with pytest.raises(CommandRefusedError):
        orders.give_back(board_of(fake))
    assert (orders.due, orders.given_back) == (True, 0)
    fake.busy = False
    orders.give_back(board_of(fake))
    assert not orders.due


@pytest.mark.parametrize("lacks", ["has_watchdog", "reports_states"])
def test_an_unsupported_order_is_reported_once(lacks: str) -> None:
    fake, orders = Fake(dialect=1, **{lacks: False}), StandingOrders()
    orders.watchdog, orders.report, orders.due = (0.5, StopMode.HOLD), (0.02, 7), True
    with pytest.raises(NotSupportedError, match="speaks dialect 1, which has no watchdog and no reports"):
        orders.give_back(board_of(fake))
    assert (orders.watchdog, orders.report, orders.due, fake.said) == (None, None, False, [])


def test_the_cause_of_a_stop_is_kept_until_resume() -> None:
    orders = StandingOrders()
    assert orders.explain(STATE) is STATE
    assert orders.explain(TRIPPED) is TRIPPED
    assert orders.explain(STOPPED).watchdog_tripped
    orders.resumed()
    assert not orders.explain(STOPPED).watchdog_tripped
    orders.explain(TRIPPED)
    assert not orders.explain(STATE).watchdog_tripped
    assert not orders.explain(STOPPED).watchdog_tripped


def test_a_board_that_would_forget_its_trip_is_asked_first() -> None:
    fake, orders = Fake(keeps_trip=False, state=TRIPPED), StandingOrders()
    orders.arm(board_of(fake), 0.5, StopMode.HOLD)
    assert fake.said == ["read", "watchdog 0.5 HOLD"]
    # Switching it off would make the board forget why it has stopped.
    orders.arm(board_of(fake), 0.0, StopMode.HOLD)
    assert fake.said == ["read", "watchdog 0.5 HOLD", "read"]
    assert orders.explain(STOPPED).watchdog_tripped
