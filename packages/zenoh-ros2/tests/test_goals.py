"""The goals of an action server, against the rules of rcl_action written down once more."""

from __future__ import annotations

import itertools
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_ros2.errors import UsageError
from zenoh_ros2.goals import MOST_GOALS, CancelCode, Goal, Goals, GoalStatus

TIMEOUT = 10.0
END = (GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED)


def uuid(number: int) -> bytes:
    return number.to_bytes(16, "big")


class Server:
    """Goals with a clock."""

    def __init__(self, timeout: float = TIMEOUT) -> None:
        self.goals: Goals[str] = Goals(timeout)
        self.now = 100.0

    def receive(self, number: int, stamp: int = 0) -> Goal[str]:
        return self.goals.receive(uuid(number), stamp, self.now)

    def accept(self, number: int, stamp: int = 0) -> Goal[str]:
        goal = self.receive(number, stamp)
        self.goals.accept(goal)
        return goal

    def end(self, goal: Goal[str], status: GoalStatus = GoalStatus.SUCCEEDED, result: object = None) -> list[str]:
        return self.goals.end(goal, status, result, self.now)

    def cancel(self, number: int = 0, stamp: int = 0) -> tuple[CancelCode, list[int]]:
        code, goals = self.goals.cancel(uuid(number), stamp, self.now)
        assert all(goal.status is GoalStatus.CANCELING for goal in goals)
        return code, [int.from_bytes(goal.id, "big") for goal in goals]

    def ask(self, number: int, who: str = "anyone") -> Any:
        return self.goals.ask(uuid(number), who, self.now)

    @property
    def known(self) -> list[tuple[int, GoalStatus]]:
        return [(int.from_bytes(goal.id, "big"), goal.status) for goal in self.goals.known(self.now)]


@pytest.fixture
def server() -> Server:
    return Server()


# -- the states -------------------------------------------------------------------------------------------------

# The table of rcl_action/goal_state_machine.c.
ALLOWED = {
    (GoalStatus.EXECUTING, GoalStatus.SUCCEEDED),
    (GoalStatus.EXECUTING, GoalStatus.ABORTED),
    (GoalStatus.CANCELING, GoalStatus.SUCCEEDED),
    (GoalStatus.CANCELING, GoalStatus.ABORTED),
    (GoalStatus.CANCELING, GoalStatus.CANCELED),
}


def test_only_the_ends_of_rcl_action_are_allowed(server: Server) -> None:
    for number, (before, after) in enumerate(itertools.product(GoalStatus, GoalStatus)):
        goal = server.accept(number)
        goal.status = before
        if (before, after) in ALLOWED:
            server.end(goal, after)
            assert goal.status is after, f"{after.name} after {before.name}"
            continue
        with pytest.raises(ValueError, match=rf"^{after.name} cannot follow {before.name}$"):
            server.end(goal, after)
        assert (goal.status, goal.ended, goal.result) == (before, None, None), f"{after.name} after {before.name}"


def test_a_goal_is_unseen_while_it_is_checked_and_executes_once_it_is_accepted(server: Server) -> None:
    goal = server.receive(1, stamp=7)
    assert (goal.status, goal.stamp, goal.id) == (GoalStatus.ACCEPTED, 7, uuid(1))
    assert server.known == []
    server.goals.accept(goal)
    assert server.known == [(1, GoalStatus.EXECUTING)]


def test_a_refused_goal_is_unknown_and_its_id_is_free(server: Server) -> None:
    goal = server.receive(1)
    assert server.ask(1, "early") is None
    assert server.goals.refuse(goal) == ["early"]
    assert server.known == []
    assert server.ask(1) == (GoalStatus.UNKNOWN, None)
    assert server.cancel(1) == (CancelCode.UNKNOWN_GOAL_ID, [])
    second = server.accept(1)
    server.goals.refuse(goal)
    assert server.known == [(1, second.status)], "the first goal of this id refused twice"


@pytest.mark.parametrize("state", ["checked", "executing", "canceling", "ended"])
def test_an_id_that_is_in_use_is_refused(server: Server, state: str) -> None:
    goal = server.receive(1)
    if state != "checked":
        server.goals.accept(goal)
    if state == "canceling":
        server.cancel(1)
    if state == "ended":
        server.end(goal)
    before = goal.status
    with pytest.raises(UsageError, match=rf"goal id {uuid(1).hex()} is in use"):
        server.receive(1)
    assert goal.status is before


# -- results ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", END)
def test_everyone_who_waits_gets_the_result_and_so_does_who_asks_later(server: Server, status: GoalStatus) -> None:
    goal = server.accept(1)
    assert [server.ask(1, "first"), server.ask(1, "second")] == [None, None]
    server.cancel(1)
    assert server.end(goal, status, "result") == ["first", "second"]
    assert server.ask(1, "late") == (status, "result")
    assert goal.waiting == []


def test_nobody_gets_the_result_of_another_goal(server: Server) -> None:
    first, second = server.accept(1), server.accept(2)
    assert [server.ask(2, "b"), server.ask(1, "a")] == [None, None]
    assert server.end(second, result="two") == ["b"]
    assert server.end(first, result="one") == ["a"]
    assert [server.ask(1), server.ask(2)] == [(GoalStatus.SUCCEEDED, "one"), (GoalStatus.SUCCEEDED, "two")]


def test_a_result_is_kept_from_the_end_on_however_long_the_goal_took(server: Server) -> None:
    goal = server.accept(1)
    server.now += 100 * TIMEOUT
    assert server.ask(1, "patient") is None
    server.end(goal)
    server.now += TIMEOUT
    assert server.ask(1)[0] is GoalStatus.SUCCEEDED
    assert server.known == [(1, GoalStatus.SUCCEEDED)]
    server.now += 0.001
    assert server.known == []
    assert server.ask(1) == (GoalStatus.UNKNOWN, None)
    assert server.cancel(1) == (CancelCode.UNKNOWN_GOAL_ID, [])
    assert len(server.goals) == 0
    server.receive(1)


def test_a_negative_timeout_keeps_results() -> None:
    server = Server(-1.0)
    server.end(server.accept(1))
    server.now += 1e9
    assert server.ask(1)[0] is GoalStatus.SUCCEEDED


def test_an_unknown_goal_has_an_unknown_state(server: Server) -> None:
    assert server.ask(9) == (GoalStatus.UNKNOWN, None)


# -- cancelling -------------------------------------------------------------------------------------------------


def test_one_goal_is_cancelled_by_its_id(server: Server) -> None:
    server.accept(1), server.accept(2)
    assert server.cancel(2) == (CancelCode.NONE, [2])
    assert server.known == [(1, GoalStatus.EXECUTING), (2, GoalStatus.CANCELING)]


@pytest.mark.parametrize("status", END)
def test_an_ended_goal_cannot_be_cancelled_nor_one_twice(server: Server, status: GoalStatus) -> None:
    goal = server.accept(1)
    server.cancel(1)
    assert server.cancel(1) == (CancelCode.GOAL_TERMINATED, [])
    server.end(goal, status)
    assert server.cancel(1) == (CancelCode.GOAL_TERMINATED, [])
    assert goal.status is status


def test_no_id_and_no_time_cancel_all(server: Server) -> None:
    server.end(server.accept(1, stamp=2**62))
    server.accept(2, stamp=2**62), server.accept(3)
    assert server.cancel() == (CancelCode.NONE, [2, 3])
    assert server.cancel() == (CancelCode.NONE, [])


def test_a_time_cancels_what_was_received_until_then(server: Server) -> None:
    for number, stamp in ((1, 10), (2, 11), (3, 12)):
        server.accept(number, stamp)
    assert server.cancel(stamp=11) == (CancelCode.NONE, [1, 2])
    assert server.cancel(stamp=5) == (CancelCode.NONE, [])


def test_an_id_with_a_time_cancels_both_and_unknown_ids_do_not_matter_then(server: Server) -> None:
    for number, stamp in ((1, 10), (2, 20), (3, 30)):
        server.accept(number, stamp)
    assert server.cancel(3, stamp=10) == (CancelCode.NONE, [1, 3])
    assert server.cancel(9, stamp=10) == (CancelCode.NONE, [])


def test_a_goal_that_is_cancelled_while_it_is_checked_stays_cancelled(server: Server) -> None:
    goal = server.receive(1)
    assert server.cancel() == (CancelCode.NONE, [1])
    assert server.known == []
    server.goals.accept(goal)
    assert server.known == [(1, GoalStatus.CANCELING)]


# -- bounds -----------------------------------------------------------------------------------------------------


def test_old_results_make_room_for_new_goals(server: Server) -> None:
    first = server.accept(0)
    for number in range(1, MOST_GOALS):
        server.end(server.accept(number))
        server.now += 0.001
    server.accept(MOST_GOALS)
    assert len(server.goals) == MOST_GOALS
    assert server.ask(1) == (GoalStatus.UNKNOWN, None)
    assert server.ask(2)[0] is GoalStatus.SUCCEEDED
    assert first.active
    assert server.known[0] == (0, GoalStatus.EXECUTING), "what is active is kept"


def test_too_many_active_goals_are_refused(server: Server) -> None:
    goals = [server.receive(number) for number in range(100)]
    with pytest.raises(UsageError, match="100 goals are active or checked"):
        server.receive(1000)
    server.goals.accept(goals[0])
    server.end(goals[0])
    server.receive(1000)


def test_too_many_who_wait_for_one_goal_are_told_nothing(server: Server) -> None:
    goal = server.accept(1)
    answers = [server.ask(1, str(number)) for number in range(101)]
    assert answers == [None] * 100 + [(GoalStatus.UNKNOWN, None)]
    assert server.end(goal) == [str(number) for number in range(100)]


@given(st.randoms(use_true_random=False))
def test_whatever_comes_in_whatever_order_each_goal_ends_once_for_those_who_asked(rng: random.Random) -> None:
    server = Server()
    asked: dict[int, list[str]] = {}
    told: dict[int, list[str]] = {}
    held: dict[int, Goal[str]] = {}
    for step in range(60):
        number = rng.randrange(6)
        goal = held.get(number)
        action = rng.choice(["receive", "accept", "ask", "cancel", "end", "wait"])
        if action == "receive" and goal is None and server.ask(number)[0] is GoalStatus.UNKNOWN:
            held[number] = server.receive(number)
            asked[number], told[number] = [], []
        elif action == "accept" and goal is not None:
            server.goals.accept(goal)
        elif action == "ask" and goal is not None:
            assert server.ask(number, str(step)) is None
            asked[number].append(str(step))
        elif action == "cancel":
            server.cancel(number)
        elif action == "end" and goal is not None and goal.status is not GoalStatus.ACCEPTED:
            status = GoalStatus.CANCELED if goal.status is GoalStatus.CANCELING else GoalStatus.SUCCEEDED
            told[number] += server.end(goal, status, number)
            assert told[number] == asked[number]
            assert server.ask(number) == (status, number)
            del held[number]
        elif action == "wait":
            server.now += rng.choice([0.1, TIMEOUT + 1.0])
    assert all(goal.active and goal.waiting == asked[number] for number, goal in held.items())
