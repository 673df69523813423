"""What the page Arms asks for about shared arms, and who may ask it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Collection, Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from tests.studio.asking import Asker
from tests.studio.running import PATIENCE, until

from hexwire.control.loop.power import Stopped, Torques
from hexwire.errors import LeaseError, LinkLostError, LinkNotFoundError, UsageError
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.fleet_api import fleet_routes
from hexwire.studio.fleet_watch import FleetWatch

_STALLED = 120.0
"""Seconds that bursts may take on a machine that has other things to do."""


class Holder(NamedTuple):
    """Who has control."""

    key: int
    client: str


class Puppet:
    """A fleet of one arm that notes what it is asked."""

    def __init__(self) -> None:
        self.stopped: list[object] = []

    def look(self) -> dict[str, Any]:
        return {"arms": []}

    async def stop(self, name: str | None, who: str) -> list[Stopped]:
        self.stopped.append(name)
        if name == "none":
            raise LinkNotFoundError("there is no arm none")
        limp = Torques(limp=("J1",))
        return [Stopped("lab/arm1", True, ("J1",), torques=limp), Stopped("lab/hung", False, error="it hangs")]

    def address(self, name: str) -> str:
        return f"zenoh:{name}"

    def known(self, name: str) -> str:
        return f"zenoh:{name}"

    def close(self) -> None:
        pass


class Desk:
    """A studio on such a fleet, and two who ask."""

    def __init__(self) -> None:
        self.studio: Any = Studio(Access(frozenset()))
        self.studio.fleet.close()
        self.fleet = self.studio.fleet = Puppet()
        self.opened: list[str] = []
        self.studio.source.open = lambda url, *_, **__: self.opened.append(url)
        self.sessions, self.ask = {}, {}
        for right in Right:
            session = self.studio.access.admit(right, 0.0)
            self.sessions[right] = session.key
            self.ask[right] = Asker(fleet_routes(lambda: self.studio), session)


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.studio.close()


@pytest.mark.parametrize("right", Right)
def test_everybody_sees_and_stops(desk: Desk, right: Right) -> None:
    ask = desk.ask[right]
    assert call(desk, right, "fleet.arms") == {"arms": []}
    said = [row["line"] for row in ask("/fleet/stop", "POST", name="lab/arm1")]
    assert said == ["lab/arm1: stopped, limp: J1 (0 ms)", "lab/hung: NOT CONFIRMED: it hangs; unknown"]
    # What may still move comes first.
    assert [row["name"] for row in ask("/fleet/stop", "POST", all=1)] == ["lab/hung", "lab/arm1"]
    assert desk.fleet.stopped == ["lab/arm1", None]
    assert ask("/fleet/stop", "POST", name="none") == {"refused": "there is no arm none"}


def test_a_stop_says_what_it_stops_and_is_no_link(desk: Desk) -> None:
    ask = desk.ask[Right.OPERATE]
    for query in ({}, {"name": "lab/arm1", "all": 1}, {"own": 1, "all": 1}, {"name": "lab/arm1", "own": 1}):
        assert "nothing was stopped" in ask("/fleet/stop", "POST", **query)["refused"]
    assert ask.raw("/fleet/stop", all=1)[0] == 405
    assert desk.fleet.stopped == []


class Opened:
    """An arm that the studio has open."""

    name, holder = "hex7bot at /dev/x", None

    def __init__(self, url: str = "/dev/x", error: str = "") -> None:
        self.driver = SimpleNamespace(url=url)
        self.hold_to_run = SimpleNamespace(end_all=lambda why: None)
        self.url, self.error, self.stopped = url, error, list[str]()
        self.line = threading.Event()
        self.line.set()

    def stop(self, why: str) -> Stopped:
        self.stopped.append(why)
        assert self.line.wait(_STALLED)
        if self.error:
            raise LinkLostError(self.error)
        return Stopped(self.name, True, ("J1", "J2"), torques=Torques(("J1",), ("J2",)))

    def mark(self) -> object:
        return None

    def torques(self) -> Torques:
        return Torques(unknown=("J1", "J2"))

    def facts(self) -> dict[str, object]:
        return {"url": self.url}

    def row(self) -> dict[str, object]:
        return {"name": self.name, "torque": "J1"}


def opened(desk: Desk, arm: Opened) -> Opened:
    desk.studio.source = SimpleNamespace(present=arm, arm=arm, open=desk.studio.source.open, close=lambda: None)
    return arm


def test_all_arms_are_what_is_open_here_first_and_then_the_shared_ones(desk: Desk) -> None:
    ask = desk.ask[Right.WATCH]
    own = opened(desk, Opened())
    assert [row["own"] for row in call(desk, Right.WATCH, "fleet.arms")["arms"]] == [True]
    said = [row["line"] for row in ask("/fleet/stop", "POST", all=1)]
    assert said[0] == "hex7bot at /dev/x: stopped, holding: J1; limp: J2 (0 ms)"
    assert [line.partition(":")[0] for line in said[1:]] == ["lab/hung", "lab/arm1"]
    assert len(own.stopped) == 1
    (row,) = ask("/fleet/stop", "POST", own=1)
    assert (row["line"], len(own.stopped)) == (said[0], 2)
    # An arm that is not reached is said to be in no known state, and keeps nobody else from being stopped.
    opened(desk, Opened(error="the cable is off"))
    said = [row["line"] for row in ask("/fleet/stop", "POST", all=1)]
    assert said[0] == "hex7bot at /dev/x: NOT CONFIRMED: the cable is off; unknown: J1 J2"
    assert len(said) == 3
    # A shared arm that is open here has one line, unless it has not confirmed.
    opened(desk, Opened("zenoh:lab/arm1"))
    assert [row["name"] for row in ask("/fleet/stop", "POST", all=1)] == [own.name, "lab/hung"]
    # Without Zenoh, without shared arms, and whatever fails there, the own one is stopped all the same.
    failures: tuple[tuple[Exception, list[str]], ...] = (
        (LinkNotFoundError("none"), []),
        (UsageError("no zenoh"), ["the shared arms"]),
        (RuntimeError("a bug"), ["the shared arms"]),
    )
    for error, more in failures:

        async def stop(name: str | None, who: str, error: Exception = error) -> list[Stopped]:
            raise error

        desk.fleet.stop = stop
        own = opened(desk, Opened())
        assert [row["name"] for row in ask("/fleet/stop", "POST", all=1)] == [own.name, *more]
        assert len(own.stopped) == 1


def test_an_own_arm_that_hangs_delays_no_other(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexwire.studio.app._PATIENCE", 0.05)
    go_on = threading.Event()
    own = opened(desk, Opened())
    own.stop = lambda why: go_on.wait(30.0) and Stopped("", False)  # type: ignore[assignment,method-assign,return-value]
    said = [row["line"] for row in desk.ask[Right.WATCH]("/fleet/stop", "POST", all=1)]
    assert said[0] == "hex7bot at /dev/x: NOT CONFIRMED: no answer within 0.05 s; unknown"
    assert len(said) == 3
    go_on.set()


@pytest.mark.slow
def test_a_burst_of_stops_is_two_stops_and_none_waits_for_that_of_another_arm(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = desk.studio.fleet = FleetWatch()
    monkeypatch.setattr(watch, "_begin", lambda: None)
    monkeypatch.setattr(watch, "_open", nullcontext)
    monkeypatch.setattr("hexwire.studio.fleet_watch._HUNG", 0.01)
    begun, all_are_there, go_on = list[set[str]](), threading.Event(), threading.Event()
    all_are_there.set()
    # An arm that does not answer makes the first stop of all last as long as it may.
    hang = iter([go_on])

    def stop(roster: object, client: str, *, only: Collection[str] | None) -> Iterator[Stopped]:
        names = set(only or {"lab/arm1", "lab/arm2"})
        begun.append(names)
        assert next(hang, all_are_there).wait(_STALLED)
        return iter([Stopped(name, True) for name in sorted(names)])

    monkeypatch.setattr("hexwire.fleet.overview.stop_all", stop)
    ask, answered = desk.ask[Right.WATCH], list[Any]()
    first = threading.Thread(target=lambda: answered.append(ask("/fleet/stop", "POST", all=1)))
    first.start()
    until(lambda: begun, "the stop of an arm that hangs")
    assert ask("/fleet/stop", "POST", name="lab/arm1")
    # From now on a slow machine begins no further one.
    monkeypatch.setattr("hexwire.studio.fleet_watch._HUNG", _STALLED)
    own = opened(desk, Opened())
    own.line = all_are_there

    def burst(**query: object) -> list[Any]:
        begun.clear()
        own.stopped.clear()
        all_are_there.clear()
        left = 2357
        asked = desk.studio.tabs.find

        def find(*args: Any) -> Any:
            # Each asks for it before the loop goes on to the next one.
            nonlocal left
            left -= 1
            if not left:
                asyncio.get_running_loop().call_soon(all_are_there.set)
            return asked(*args)

        monkeypatch.setattr(desk.studio.tabs, "find", find)
        return ask.together("/fleet/stop", "POST", [query] * left)

    assert [[row["name"] for row in rows] for rows in burst(name="lab/arm1")] == [["lab/arm1"]] * 2357
    assert 1 <= len(begun) <= 2
    everyone = [own.name, "lab/arm1", "lab/arm2"]
    assert [[row["name"] for row in rows] for rows in burst(all=1)] == [everyone] * 2357
    assert 1 <= len(begun) <= 2
    assert 1 <= len(own.stopped) <= 2
    assert {rows[0]["name"] for rows in burst(own=1)} == {own.name}
    assert 1 <= len(own.stopped) <= 2
    # All that time one arm has hung.
    assert not answered
    go_on.set()
    first.join(PATIENCE)
    assert [row["name"] for row in answered[0]] == ["lab/arm1", "lab/arm2"]
    watch.close()


def call(desk: Desk, right: Right, what: str, **args: object) -> Any:
    tab = desk.studio.tabs.open(desk.sessions[right], right)
    return asyncio.run(desk.studio.call(tab, what, args))


def test_only_who_may_operate_opens_an_arm_here(desk: Desk) -> None:
    with pytest.raises(LeaseError, match="watching only"):
        call(desk, Right.WATCH, "fleet.open", name="lab/arm1")
    assert desk.opened == []
    call(desk, Right.OPERATE, "fleet.open", name="lab/arm1")
    assert desk.opened == ["zenoh:lab/arm1"]


def test_what_somebody_else_controls_is_not_replaced(desk: Desk) -> None:
    class Present(Opened):
        holder = Holder(1, "tab 9")  # type: ignore[assignment]

    opened(desk, Present())
    desk.studio.source.has_control = lambda tab: False
    with pytest.raises(LeaseError, match="tab 9 has control of what is open"):
        call(desk, Right.OPERATE, "fleet.open", name="lab/arm1")
    assert desk.opened == []
