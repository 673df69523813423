"""Trajectories for a server to follow: the start goes out in the owner's clock, and a number comes back."""

from __future__ import annotations

import time
from typing import Any

import msgspec
import pytest

from hexwire.errors import RemoteProtocolError
from hexwire.fleet import messages as m
from hexwire.fleet.clock import ClockOffset
from hexwire.fleet.remote import RemoteRobot
from hexwire.motion.trajectory import Spline, Waypoint

AHEAD = 1000.0
PATH = Spline(("J1",), (Waypoint(0.0, (0.0,)), Waypoint(1.0, (0.1,))))


class Client(RemoteRobot):
    """Sends nothing, and answers what the test says."""

    def __init__(self, value: Any) -> None:
        super(RemoteRobot, self).__init__()
        self._clock = ClockOffset()
        now = time.monotonic()
        self._clock.add(now, now + AHEAD, now)
        self.value = value
        self.orders: list[Any] = []

    def _order(self, what: str, order: m.Order, *, freeing: bool = False, slow: bool = False) -> Any:
        self.orders.append(order)
        return self.value

    def _asked(self, question: m.Ask) -> m.Answer:
        self.orders.append(question)
        return m.Answer("", value=self.value)


def test_the_start_is_sent_in_the_owners_clock() -> None:
    client = Client(7)
    assert client.follow(PATH, 50.0) == 7
    (order,) = client.orders
    assert (order.names, order.times, order.positions) == (("J1",), (0.0, 1.0), (0.0, 0.1))
    assert order.start == pytest.approx(50.0 + AHEAD, abs=1e-3)
    assert not order.check


def test_a_trajectory_from_anywhere_leaves_out_its_first_point() -> None:
    client = Client(7)
    client.follow(PATH, 50.0, anywhere=True)
    assert (client.orders[0].times, client.orders[0].positions) == ((1.0,), (0.1,))


def test_a_start_that_is_to_be_confirmed() -> None:
    client = Client(7)
    client.follow(PATH, 50.0)
    client.follow(PATH, 50.0, confirm=True)
    client.confirm(7)
    assert [order.confirm for order in client.orders[:2]] == [False, True]
    assert client.orders[2] == m.Confirm(7)


def test_a_check_says_that_it_is_only_one() -> None:
    client = Client(None)
    client.check_path(PATH)
    assert client.orders[0].check


def test_its_report_and_its_end_are_asked_for_by_its_number() -> None:
    client = Client(msgspec.to_builtins(m.Goal(7, 3.0, "succeeded", moved=3.1)))
    goal = client.goal(7)
    assert (goal.number, goal.start, goal.outcome, goal.moved) == (7, 3.0, "succeeded", 3.1)
    client.cancel(7)
    assert client.orders == [m.Ask("goal", 7), m.Cancel(7)]


@pytest.mark.parametrize("value", [None, "7", [7], 7.0])
def test_an_answer_that_is_no_number_is_an_error_of_the_server(value: Any) -> None:
    with pytest.raises(RemoteProtocolError, match="number of a trajectory"):
        Client(value).follow(PATH, 50.0)


def test_a_report_that_is_none_is_an_error_of_the_server() -> None:
    with pytest.raises(RemoteProtocolError):
        Client(["seven"]).goal(7)
