"""Goals of clients that are made up, and an emulated arm in simulated time."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from tests.control.arm_bench import SPLIT, Bench
from tests.motion.arms import HOME, NAMES
from tests.waits import PATIENCE, eventually

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.goals import Component, ComponentTolerance, Point, TrajectoryGoal
from hexwire.control.requests.client_goals import ClientGoal, ClientGoals, ClientRequest
from hexwire.errors import LinkLostError
from hexwire.wire.command_frame import Command, parse_frame


class Client:
    """What was said to it, in its order."""

    def __init__(self, on_refused: Callable[[], object] = lambda: None) -> None:
        self.said: list[str | tuple[str, str]] = []
        self.when: list[float] = []
        self._on_refused = on_refused

    def accepted(self) -> None:
        self._note("accepted")

    def refused(self, reason: Reason, text: str) -> None:
        self._on_refused()
        self._note((reason.value, text))

    def ended(self, ended: Ended) -> None:
        assert (ended.outcome is Outcome.SUCCEEDED) == (ended.reason is Reason.REACHED)
        assert (ended.outcome is Outcome.PREEMPTED) == (ended.reason in {Reason.REPLACED, Reason.CANCELLED})
        self._note((ended.reason.value, ended.text))

    def _note(self, what: str | tuple[str, str]) -> None:
        self.when.append(time.monotonic())
        self.said.append(what)

    @property
    def over(self) -> bool:
        return bool(self.said) and self.said[-1] != "accepted"


class Goals:
    """Goals of an emulated arm that has torque."""

    def __init__(
        self, *, answer_after: float = 0.0, end_after: float = 0.0, in_log: Any = None, **settings: Any
    ) -> None:
        self.bench = Bench(**({"check_table": False} | (settings or {"allow_partial_joints_goal": True})))
        self.bench.ask(lambda: self.bench.arm.enable(True))
        words = {} if in_log is None else {"in_log": in_log}
        self.goals: ClientGoals[Client] = ClientGoals(
            self.bench.arm, answer_after=answer_after, end_after=end_after, **words
        )

    def send(
        self,
        where: dict[str, float],
        seconds: float = 1.0,
        *,
        key: str = "one",
        controller: str = "",
        client: Client | None = None,
    ) -> Client:
        client = client or Client()
        order = TrajectoryGoal(tuple(where), (Point(seconds, tuple(where.values())),))
        self.goals.send(controller, key, client, lambda: ClientRequest(order))
        return client


@pytest.fixture
def goals() -> Iterator[Goals]:
    made = Goals()
    yield made
    made.goals.close()


def test_a_goal_is_accepted_and_reached(goals: Goals) -> None:
    goals.goals.start()
    client = goals.send({"J1": HOME["J1"] + 0.2})
    eventually(lambda: client.said == ["accepted"])
    assert goals.goals._worker.daemon, "a program that does not close it ends all the same"
    goal = goals.bench.controller.listener
    assert isinstance(goal, ClientGoal)
    eventually(lambda: goal.accepted)
    assert goal.client is client
    assert goals.goals.open
    goals.bench.until(lambda: client.over)
    assert client.said == ["accepted", ("reached", "")]
    assert not goals.goals.open


@pytest.mark.parametrize(
    ("host_timed", "command"),
    [(True, Command.JOINT_MOVE), (False, Command.TRAJECTORY_BEGIN)],
    ids=["target", "path"],
)
def test_the_first_byte_of_a_goal_leaves_within_2_ms_of_its_acceptance(host_timed: bool, command: int) -> None:
    goals = Goals(check_table=False, allow_partial_joints_goal=True, host_timed=host_timed)
    bench, controller = goals.bench, goals.bench.controller
    accept, write, accepted, left = controller.accept, bench.link.write, list[float](), list[tuple[float, int]]()

    def noted(data: bytes, deadline: float | None = None) -> None:
        left.append((bench.clock.time, parse_frame(data).cmd))
        write(data, deadline)

    def accept_noted(*args: Any, **named: Any) -> None:
        accept(*args, **named)
        accepted.append(bench.clock.time)

    bench.link.write = noted  # type: ignore[method-assign]
    controller.accept = accept_noted  # type: ignore[method-assign]
    goals.goals.start()
    client = goals.send({"J1": HOME["J1"] + 0.2})
    # Nobody turns the owner: no state comes, and no period passes.
    eventually(lambda: client.said == ["accepted"])
    first = next(when for when, cmd in left if cmd == command)
    assert 0.0 <= first - accepted[0] <= 0.002
    bench.until(lambda: client.over)
    assert client.said == ["accepted", ("reached", "")]
    goals.goals.close()


def test_a_first_target_that_fails_is_a_failure_of_the_robot(goals: Goals) -> None:
    goals.goals.start()
    lost = LinkLostError("unplugged", url="serial:///emulated")

    def fails(*_: Any, **__: Any) -> Any:
        raise lost

    goals.bench.emulated.driver.path = fails  # type: ignore[method-assign]
    client = goals.send({"J1": HOME["J1"] + 0.2})
    eventually(lambda: client.said == ["accepted"])
    goals.bench.until(lambda: not goals.bench.owner.connected)
    eventually(lambda: client.over)
    assert client.said[1] == ("stopped", "stopped: the robot was lost: unplugged")


def test_a_goal_that_is_cancelled_during_its_path_check_is_held(goals: Goals) -> None:
    goals.goals.start()
    client = goals.send({"J1": HOME["J1"] + 0.5}, 5.0)
    eventually(lambda: client.said)
    goals.bench.turn(1.0)
    goals.goals.cancel("", "one")
    eventually(lambda: client.over)
    assert client.said == ["accepted", ("cancelled", "cancelled")]


@pytest.mark.parametrize("when", ["before", "while it is checked"])
def test_a_goal_that_is_cancelled_before_it_begins_never_does(
    goals: Goals, when: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = goals.bench.controller
    check = controller.check_path

    def check_path(*args: Any, **named: Any) -> None:
        check(*args, **named)
        goals.goals.cancel("", "one")

    if when != "before":
        monkeypatch.setattr(controller, "check_path", check_path)
    client = goals.send({"J1": HOME["J1"] + 0.5})
    if when == "before":
        goals.goals.cancel("", "one")
    goals.goals.start()
    eventually(lambda: client.over)
    assert client.said == [("cancelled", "cancelled")]
    assert not controller.busy
    assert not goals.goals.open


def test_a_goal_that_hangs_does_not_keep_the_program_from_ending(
    goals: Goals, monkeypatch: pytest.MonkeyPatch
) -> None:
    goals.goals.start()
    waited: list[float] = []
    with monkeypatch.context() as patch:
        patch.setattr(goals.goals._worker, "join", waited.append)
        goals.goals.close()
    assert waited == [1.0]


def test_a_cancel_for_nobody_is_nothing(goals: Goals) -> None:
    goals.goals.cancel("", "nobody")
    assert not goals.goals.open


@pytest.mark.slow
def test_two_controllers_may_have_goals_of_one_key() -> None:
    goals = Goals(controllers=SPLIT)
    goals.goals.start()
    whole = {name: HOME[name] + 0.2 * (name == "J1") for name in NAMES[:6]}
    first = goals.send(whole, 3.0, controller="arm")
    second = goals.send({"J7": HOME["J7"] + 0.1}, 3.0, controller="hand")
    eventually(lambda: first.said and second.said)
    goals.goals.cancel("arm", "one")
    eventually(lambda: first.over)
    assert first.said[-1] == ("cancelled", "cancelled")
    assert goals.goals.open
    goals.bench.until(lambda: second.over)
    assert second.said[-1] == ("reached", "")
    goals.goals.close()


def test_the_end_of_a_goal_is_not_that_of_another_one_with_its_key(goals: Goals) -> None:
    first = goals.send({"elbow": 0.0})
    second = goals.send({"J1": HOME["J1"] + 0.5}, 5.0)
    goals.goals.start()
    eventually(lambda: first.over and second.said)
    ((reason, text),) = first.said
    assert (reason, text.partition(";")[0]) == ("wrong joints", "joint_names: 'elbow' unknown")
    assert goals.goals.open
    goals.goals.cancel("", "one")
    eventually(lambda: second.over)
    assert second.said[-1] == ("cancelled", "cancelled")


def test_a_programming_error_refuses_its_goal_and_no_other(
    goals: Goals, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    goals.goals.start()
    with monkeypatch.context() as patch, caplog.at_level(logging.CRITICAL, logger="hexwire"):
        patch.setattr(goals.bench.controller, "check_path", lambda *_, **__: 1 / 0)
        broken = goals.send({"J1": HOME["J1"]})
        eventually(lambda: broken.over)
        unreadable = Client()
        goals.goals.send("", "two", unreadable, lambda: 1 / 0)  # type: ignore[arg-type,return-value]  # it fails
        eventually(lambda: unreadable.over)
    for client in (broken, unreadable):
        ((reason, text),) = client.said
        assert reason == "failed"
        assert text.startswith("the program failed: ZeroDivisionError")
    last = goals.send({"J1": HOME["J1"] + 0.1}, key="three")
    eventually(lambda: last.said == ["accepted"])


def test_a_client_that_cannot_be_answered_is_logged_and_hinders_nobody(
    goals: Goals, caplog: pytest.LogCaptureFixture
) -> None:
    goals.goals.start()
    deaf = Client(on_refused=lambda: 1 / 0)
    with caplog.at_level(logging.CRITICAL, logger="hexwire"):
        goals.send({"elbow": 0.0}, client=deaf)
        other = goals.send({"elbow": 0.0}, key="two")
        eventually(lambda: other.over)
    assert deaf.said == []
    assert not goals.goals.open


def test_a_stop_aborts_and_the_end_is_told_before_all_is_closed(goals: Goals) -> None:
    goals.goals.start()
    client = goals.send({"J1": HOME["J1"] + 0.5}, 5.0)
    eventually(lambda: client.said)
    goals.bench.arm.stop("test")
    goals.goals.close()
    assert client.said == ["accepted", ("stopped", "stopped: test")]


def test_a_goal_that_another_one_replaces_is_not_one_that_its_client_cancels(goals: Goals) -> None:
    goals.goals.start()
    first = goals.send({"J1": HOME["J1"] + 0.5}, 5.0)
    second = goals.send({"J1": HOME["J1"] - 0.1}, key="two")
    eventually(lambda: first.over and second.said)
    assert first.said == ["accepted", ("replaced", "replaced by a new goal")]
    assert second.said == ["accepted"]


def test_the_log_says_why_in_the_words_of_the_front(caplog: pytest.LogCaptureFixture) -> None:
    goals = Goals(in_log=lambda reason, text: f"<{reason.name}> {text}")
    goals.goals.start()
    refused, stopped = goals.send({"elbow": 0.0}), goals.send({"J1": HOME["J1"] + 0.5}, 5.0, key="two")
    eventually(lambda: refused.over and stopped.said)
    goals.bench.arm.stop("test")
    goals.goals.close()
    assert stopped.over
    lines = [
        record.getMessage() for record in caplog.records if record.name == "hexwire.control.requests.client_goals"
    ]
    assert lines[0].startswith("goal refused: <WRONG_JOINTS> joint_names: 'elbow' unknown")
    assert lines[1:] == ["goal aborted: <STOPPED> stopped: test"]


def test_no_client_is_answered_before_its_time() -> None:
    goals = Goals(answer_after=0.05)
    goals.goals.start()
    sent = time.monotonic()
    client = goals.send({"J1": HOME["J1"] + 0.2})
    eventually(lambda: client.said)
    assert client.when[0] - sent >= 0.03
    goals.goals.close()


@pytest.mark.parametrize("wanted", [HOME["J1"] + 0.2, math.nan], ids=["accepted", "refused"])
def test_no_client_hears_the_end_before_its_time(wanted: float) -> None:
    goals = Goals(end_after=0.05)
    goals.goals.start()
    sent = time.monotonic()
    client = goals.send({"J1": wanted})
    if math.isfinite(wanted):
        eventually(lambda: client.said)
        goals.bench.arm.stop("by the test")
    eventually(lambda: client.over)
    assert client.when[-1] - sent >= 0.03
    goals.goals.close()


def test_answers_keep_their_order_and_are_given_before_the_end(goals: Goals) -> None:
    goals.goals.start()
    told: list[int] = []
    for i in range(20):
        goals.send({"J1": math.nan}, key=str(i), client=Client(lambda i=i: told.append(i)))  # type: ignore[misc]
    goals.goals.close(PATIENCE)
    assert told == list(range(20))
    assert not goals.goals.open


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "reason"),
    [
        ({"path": [("J1", 0.02, 0.0, 0.0)]}, "path tolerance"),
        ({"path_components": [ComponentTolerance("J1", Component.ROTATION, 0.02)]}, "path tolerance"),
        (
            {"goal_components": [ComponentTolerance("J1", Component.ROTATION, 0.02)], "goal_time": 0.5},
            "goal tolerance",
        ),
        ({"goal": [("J1", 0.02, 0.0, 0.0)], "goal_time": 0.5}, "goal tolerance"),
        ({}, "reached"),
    ],
)
def test_the_tolerances_of_a_goal_decide_how_it_ends(goals: Goals, own: dict[str, Any], reason: str) -> None:
    goals.goals.start()
    goals.bench.jam("J1")
    client, order = Client(), TrajectoryGoal(("J1",), (Point(1.0, (HOME["J1"] + 0.1,)),))
    goals.goals.send("", "one", client, lambda: ClientRequest(order, **own))
    eventually(lambda: client.said)
    goals.bench.until(lambda: goals.bench.controller.listener is None)
    eventually(lambda: client.over)
    assert client.said[0] == "accepted"
    assert client.said[1][0] == reason


def test_a_machine_that_stood_still_answers_no_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = 0

    def jumping() -> float:
        nonlocal looks
        looks += 1
        return 3600.0 * looks  # an hour from one look at the clock to the next

    goals = Goals(end_after=0.02)
    monkeypatch.setattr("hexwire.control.requests.client_goals.time", SimpleNamespace(monotonic=jumping))
    goals.goals.start()
    for key in ("one", "two"):
        looks_before = looks
        answered_after: list[int] = []
        client = Client(lambda after=answered_after: after.append(looks))  # type: ignore[misc]
        goals.send({"elbow": 0.0}, key=key, client=client)
        eventually(lambda after=answered_after: after)
        # The client had its turns of the processor, as often as a clock that runs on would have given it.
        assert answered_after[0] - looks_before >= 10
    goals.goals.close()


def test_a_goal_that_waited_during_a_stop_is_refused_after_the_reset(goals: Goals) -> None:
    client = goals.send({"J1": HOME["J1"] + 0.3})
    arm, bench = goals.bench.arm, goals.bench
    bench.ask(lambda: arm.stop("by the test"))
    bench.ask(arm.reset)
    goals.goals.start()
    eventually(lambda: client.over)
    assert client.said == [("stopped", "the arm was stopped since it was asked for; ask again")]
    assert not bench.controller.busy
