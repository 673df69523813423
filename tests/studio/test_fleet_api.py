"""What the fleet page asks for, and who may ask it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from tests.studio.asking import Asker

from hexwire.errors import LinkNotFoundError
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.fleet_api import fleet_routes


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

    def stop(self, name: str | None, who: str) -> list[dict[str, Any]]:
        self.stopped.append(name)
        if name == "none":
            raise LinkNotFoundError("there is no arm none")
        return [{"name": "lab/arm1", "confirmed": True}]

    def known(self, name: str) -> str:
        return f"zenoh:{name}"

    def close(self) -> None:
        pass


class Desk:
    """A studio on such a fleet, and two who ask."""

    def __init__(self) -> None:
        self.studio: Any = Studio(Access(frozenset()))
        self.fleet = self.studio.fleet = Puppet()
        self.opened: list[str] = []
        self.studio.source.open = lambda url, *_, **__: self.opened.append(url)
        self.tabs, self.ask = {}, {}
        for right in Right:
            session = self.studio.access.admit(right, 0.0)
            self.tabs[right] = self.studio.tabs.open(session.key, right).key
            self.ask[right] = Asker(fleet_routes(lambda: self.studio), session)


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.studio.close()


@pytest.mark.parametrize("right", Right)
def test_everybody_sees_and_stops(desk: Desk, right: Right) -> None:
    ask = desk.ask[right]
    assert ask("/fleet/arms") == {"arms": []}
    assert ask("/fleet/stop", "POST", name="lab/arm1") == [{"name": "lab/arm1", "confirmed": True}]
    ask("/fleet/stop", "POST", all=1)
    assert desk.fleet.stopped == ["lab/arm1", None]
    assert ask("/fleet/stop", "POST", name="none") == {"refused": "there is no arm none"}


def test_a_stop_says_what_it_stops_and_is_no_link(desk: Desk) -> None:
    ask = desk.ask[Right.OPERATE]
    for query in ({}, {"name": "lab/arm1", "all": 1}):
        assert "nothing was stopped" in ask("/fleet/stop", "POST", **query)["refused"]
    assert ask.raw("/fleet/stop", all=1)[0] == 405
    assert desk.fleet.stopped == []


def test_only_who_may_operate_opens_an_arm_here(desk: Desk) -> None:
    watch, operate = (Right.WATCH, Right.OPERATE)
    refused = desk.ask[watch]("/fleet/open", "POST", tab=desk.tabs[watch], name="lab/arm1")
    assert "watching only" in refused["refused"]
    # The tab of another session is no help.
    refused = desk.ask[watch]("/fleet/open", "POST", tab=desk.tabs[operate], name="lab/arm1")
    assert "no longer known" in refused["refused"]
    assert desk.opened == []
    desk.ask[operate]("/fleet/open", "POST", tab=desk.tabs[operate], name="lab/arm1")
    assert desk.opened == ["zenoh:lab/arm1"]


def test_what_somebody_else_controls_is_not_replaced(desk: Desk) -> None:
    class Present:
        holder = Holder(1, "tab 9")

    class Holding:
        present = Present()
        has_control = staticmethod(lambda tab: False)
        open = desk.studio.source.open
        close = staticmethod(lambda: None)

    desk.studio.source = Holding()
    refused = desk.ask[Right.OPERATE]("/fleet/open", "POST", tab=desk.tabs[Right.OPERATE], name="lab/arm1")
    assert "tab 9 has control of what is open" in refused["refused"]
    assert desk.opened == []
