"""Tabs: found only by their own session, and numbered orders."""

from __future__ import annotations

from hexwire.studio.access import Right
from hexwire.studio.tabs import MOST_TABS, Tabs


def test_a_tab_is_found_by_its_own_session_only() -> None:
    tabs = Tabs()
    tab = tabs.open("session 1", Right.OPERATE)
    assert tabs.find(tab.key, "session 1") is tab
    assert tabs.find(tab.key, "session 2") is None
    assert tabs.find("", "session 1") is None
    tabs.close(tab)
    assert tabs.find(tab.key, "session 1") is None


def test_orders_are_numbered_upward() -> None:
    tab = Tabs().open("session", Right.OPERATE)
    assert [tab.next_number() for _ in range(3)] == [1, 2, 3]


def test_the_holder_is_the_tab_with_that_grant() -> None:
    tabs = Tabs()
    first, second = tabs.open("s", Right.OPERATE), tabs.open("s", Right.OPERATE)
    second.grant = 7
    assert tabs.holder(7) is second
    assert tabs.holder(0) is None
    assert (first.name, second.name) == ("page 1", "page 2")


def test_pages_that_never_opened_a_socket_are_forgotten_first() -> None:
    tabs = Tabs()
    live = tabs.open("s", Right.OPERATE)
    live.live = True
    idle = [tabs.open("s", Right.WATCH) for _ in range(MOST_TABS)]
    assert len(tabs) == MOST_TABS
    assert tabs.find(live.key, "s") is live
    assert tabs.find(idle[0].key, "s") is None
    assert tabs.find(idle[-1].key, "s") is idle[-1]


def test_only_the_last_stops_of_a_tab_are_remembered() -> None:
    tab = Tabs().open("s", Right.WATCH)
    tab.stops.extend(range(10_000))
    assert tab.stops[-1] == 9999
    assert len(tab.stops) < 100
