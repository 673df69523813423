"""Many arms at once: how they are, and their stop."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

import pytest
from tests.waits import PATIENCE, eventually

from hexwire.drivers import registry
from hexwire.drivers.values import StopMode
from hexwire.errors import LinkLostError, StoppedError
from hexwire.fleet import messages as m
from hexwire.fleet import overview
from hexwire.fleet import roster as module
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.names import ClientRole, Keys
from hexwire.fleet.network import Network
from hexwire.fleet.node import Node, OpenQuestion
from hexwire.fleet.overview import Overview, Stopped, look, stop_all
from hexwire.fleet.roster import HUNG, Roster
from hexwire.model.state import JointFlag, JointTarget

from .conftest import Serve


def test_the_condition_of_an_arm_in_words() -> None:
    for row, words in (
        (Overview("a"), "ok"),
        (Overview("a", why="power is low"), "power is low"),
        (Overview("a", stopped=True), "stopped"),
        (Overview("a", stopped=True, why="Ann stopped it"), "stopped: Ann stopped it"),
        (Overview("a", stopped=True, silent=True, why="gone"), "no answer: gone"),
    ):
        assert row.condition == words


def puppet(name: str, **answers: Any) -> Node:
    """A server that gives these answers, by the last part of the key; an answer of None hangs."""
    node = Network(listen=endpoints_of([local_socket(name)])).open(wait=False)
    node.announce(Keys(name).token("1"))
    held = []

    def reply(query: Any, answer: m.Answer | None) -> None:
        if answer is None:
            held.append(query)
        else:
            query.reply(m.encode(answer))

    for key, answer in answers.items():
        node.answer(f"hexwire/{name}/{key}", lambda query, answer=answer: reply(query, answer))
    return node


def test_an_arm_says_how_it_is(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    with Roster() as roster:
        assert roster.settle(PATIENCE)
        (row,) = look(roster, PATIENCE)
        assert (row.name, row.robot, row.torque) == ("lab/arm1", "hex7bot", "off")
        assert [row.stopped, row.silent] == [False, False]
        assert row.host
        assert row.age is not None
        with registry.connect("zenoh:lab/arm1") as robot:
            robot.torque(True, ["J1", "J2"])
            eventually(lambda: f"process {os.getpid()}" in look(roster, PATIENCE)[0].holder)
            eventually(lambda: look(roster, PATIENCE)[0].torque == "J1 J2")
            robot.torque(True)
            eventually(lambda: look(roster, PATIENCE)[0].torque == "on")
            # Nothing but a stop is asked for here.
            (done,) = stop_all(roster, "Bob", timeout=PATIENCE)
            assert (done.name, done.confirmed, done.joints) == ("lab/arm1", True, robot.model.names)
            eventually(lambda: look(roster, PATIENCE)[0].stopped)
            assert "Bob stopped it" in look(roster, PATIENCE)[0].why
            with pytest.raises(StoppedError):
                robot.write(JointTarget.of({"J1": 0.1}, 1.0))


@pytest.fixture
def stops(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The stops that are under way, by the arm's name."""
    made: dict[str, Any] = {}

    class Kept(overview._ArmStop):
        def __init__(self, seen: Any, *rest: Any) -> None:
            super().__init__(seen, *rest)
            made[seen.name] = self

    monkeypatch.setattr(overview, "_ArmStop", Kept)
    return made


def while_it_hangs(
    roster: Roster, stops: dict[str, Any], hung: str, others: int, mode: StopMode = StopMode.HOLD
) -> list[Stopped]:
    """Stop all; the one that hangs is given up only when so many others are known, however late they answer."""
    assert roster.settle(PATIENCE)
    rows = []
    for row in stop_all(roster, "Bob", mode, timeout=4 * PATIENCE):
        rows.append(row)
        if len(rows) == others:
            stops[hung]._timeout = 0.2
            stops[hung]._ask(stops[hung]._key)
    return rows


@pytest.mark.slow
def test_an_arm_that_hangs_is_shown_as_silent_and_one_that_starts_too(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hung, starts = puppet("lab/hung", ask=None), puppet("lab/starts")
    question = Node.question

    def soon_given_up(node: Node, key: str, payload: bytes, timeout: float) -> OpenQuestion:
        # Only the one that hangs: that nobody answers for the other may be known late.
        return question(node, key, payload, 0.2 if "lab/hung" in key else timeout)

    monkeypatch.setattr(Node, "question", soon_given_up)
    with Roster() as roster:
        assert roster.settle(PATIENCE)
        one, two = look(roster, PATIENCE)
    assert (one.name, one.silent, one.why) == ("lab/hung", True, HUNG)
    assert (two.name, two.silent) == ("lab/starts", True)
    assert "its server is starting or ending" in two.why
    hung.close()
    starts.close()


def test_a_stop_reaches_all_others_while_one_hangs(runtime: Path, stops: dict[str, Any]) -> None:
    """Those that answer are confirmed before the one that does not is given up."""
    confirmed = m.Answer("", value=["J1", "J2"])
    partly = m.Answer("", "", {"missing": ["J2"]}, ["J1"])
    refused = m.Answer("LinkLostError", "the port is gone")
    nodes = [
        puppet("lab/a", stop=confirmed),
        puppet("lab/b", stop=None),
        puppet("lab/c", stop=partly),
        puppet("lab/d", stop=refused),
        puppet("lab/e"),
        puppet("lab/f", stop=m.Answer("", value=[])),
    ]
    with Roster("lab/*") as roster:
        rows = while_it_hangs(roster, stops, "lab/b", len(nodes) - 1)
    assert rows[-1].name == "lab/b"
    by_name = {row.name: row for row in rows}
    assert sorted(by_name) == [f"lab/{letter}" for letter in "abcdef"]
    assert [name for name, row in by_name.items() if row.confirmed] == ["lab/a"]
    assert by_name["lab/b"].error == HUNG
    assert by_name["lab/c"].error == "not confirmed by J2"
    assert by_name["lab/d"].error == "the port is gone"
    assert "its program is halted or has just ended, or this program may not stop it" in by_name["lab/e"].error
    assert by_name["lab/f"].error == "no joint confirmed it"
    for node in nodes:
        node.close()


def test_a_denied_torque_off_still_stops_the_arm(
    runtime: Path, stops: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    confirmed = m.Answer("", value=["J1"])
    nodes = [
        puppet("lab/a", **{"stop": confirmed, "as/maintainer/off": confirmed}),
        puppet("lab/b", stop=confirmed),
        puppet("lab/c", **{"stop": confirmed, "as/maintainer/off": None}),
    ]
    with Roster("lab/*") as roster:
        rows = {row.name: row for row in while_it_hangs(roster, stops, "lab/c", 2, StopMode.TORQUE_OFF)}
        assert [rows[name].confirmed for name in sorted(rows)] == [True, True, False]
        assert [bool(rows[name].kept) for name in sorted(rows)] == [False, True, False]
        assert "'hexwire fleet config'" in rows["lab/b"].kept
        monkeypatch.setattr(overview, "role_of", lambda cert: ClientRole.OBSERVER)
        rows = {row.name: row for row in stop_all(roster, "Bob", StopMode.TORQUE_OFF, timeout=PATIENCE)}
        assert all(row.confirmed for row in rows.values())
        assert all(row.kept.startswith("an observer may stop it") for row in rows.values())
    for node in nodes:
        node.close()


@pytest.mark.slow
def test_a_stop_does_not_wait_for_the_way_to_others(runtime: Path) -> None:
    """A server that hangs already when the stop is called is reported last, and as not confirmed."""

    node = puppet("lab/a", stop=m.Answer("", value=["J1"]))
    with socket.socket(socket.AF_UNIX) as hung:
        hung.bind(str(local_socket("lab/hung")))
        hung.listen()
        with Roster() as roster:
            rows = stop_all(roster, "Bob")
            assert next(rows).confirmed
            assert not roster.settled
            assert [(row.name, row.confirmed, row.error) for row in rows] == [("lab/hung", False, HUNG)]
    node.close()


def test_a_server_that_is_not_known_in_time_is_reported_as_not_stopped(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It takes connections but does not name its arm, as a program that is halted at that moment."""
    monkeypatch.setattr(overview, "SLOW", 0.3)
    monkeypatch.setattr(module, "SLOW", 0.3)
    node = puppet("lab/a", stop=m.Answer("", value=["J1"]))
    slow = Network(listen=endpoints_of([local_socket("lab/slow")])).open(wait=False)
    with Roster("lab/*") as roster:
        eventually(roster.seen)
        rows = {row.name: row for row in stop_all(roster, "Bob")}
        assert not roster.settled
        assert (rows["lab/a"].confirmed, rows["lab/slow"].confirmed) == (True, False)
        assert rows["lab/slow"].error == HUNG
        assert [(row.name, row.why) for row in look(roster, PATIENCE) if row.silent][-1:] == [("lab/slow", HUNG)]
    node.close()
    slow.close()


def test_a_stop_of_nobody_yields_nothing(runtime: Path) -> None:
    with Roster("lab/*") as roster:
        assert list(stop_all(roster, "Bob")) == []


def test_a_connection_that_ends_in_between_is_an_error_of_that_arm(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = puppet("lab/a", stop=m.Answer("", value=["J1"]))

    def lost(*_: object, **__: object) -> None:
        raise LinkLostError("gone")

    with Roster() as roster:
        assert roster.settle(PATIENCE)
        monkeypatch.setattr(Node, "question", lost)
        (row,) = stop_all(roster, "Bob")
        assert (row.confirmed, row.error) == (False, "gone")
        assert [row.silent for row in look(roster, PATIENCE)] == [True]
    node.close()


@pytest.mark.parametrize("local", [True, False])
def test_an_arm_that_does_not_say_how_it_is_is_known_by_its_name(local: bool) -> None:
    seen: Any = module.Seen("lab/a", None, local)  # type: ignore[arg-type]  # nobody is asked
    row = overview._overview(seen, [], "its program is halted")
    assert (row.name, row.why, row.silent, row.local) == ("lab/a", "its program is halted", True, local)


def test_faults_of_servos_are_named_by_joint() -> None:
    def state(*flags: JointFlag, error: str = "") -> m.State:
        names = tuple(f"J{i + 1}" for i in range(len(flags)))
        row = (0.0,) * len(flags)
        values = (*(row,) * 6, tuple(int(each) for each in flags), row)
        return m.State(1, 1, 0.0, 0.0, 0.0, names, *values, 0.0, False, False, False, error=error)

    hot = JointFlag.TEMPERATURE | JointFlag.OVERLOAD | JointFlag.TORQUE_ON
    assert overview._faults(state(JointFlag.TORQUE_ON, hot)) == "J2: temperature, overload"
    assert overview._faults(state(JointFlag.TORQUE_ON)) == ""
    assert overview._faults(state(hot, error="the port is lost")) == ""


def test_only_the_arms_that_are_named_are_stopped(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    serve("lab/arm2", robot="sim")
    with Roster() as roster:
        assert roster.settle(PATIENCE)
        (done,) = stop_all(roster, "Bob", timeout=PATIENCE, only=["lab/arm2"])
        assert (done.name, done.confirmed) == ("lab/arm2", True)
        eventually(lambda: [row.stopped for row in look(roster, PATIENCE)] == [False, True])
        assert list(stop_all(roster, "Bob", only=["lab/arm3"])) == []
