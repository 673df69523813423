"""The open tabs: who they are, what they may do, and which of them has control.

Owns the list, and the order numbers of each tab. Must not know sockets or pages.
"""

from __future__ import annotations

import itertools
import secrets
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from .access import Right

__all__ = ["MOST_TABS", "Tab", "Tabs"]

MOST_TABS = 128
"""Pages that are remembered; more than may have sockets, since a page is built before it opens its own."""
_STOPS = 32
"""Stops that are remembered of a tab; one is sent again within a second."""


@dataclass(eq=False, slots=True)
class Tab:
    """One open tab of a browser.

    Attributes:
        name: For display, such as ``tab 2``.
        key: Secret that its page knows, with which its own socket is opened.
        session: Key of the session to which it belongs.
        right: What that session may do.
        grant: Key of the lease that it holds; 0 if it has none.
        live: It has its socket.
        file: It looks at a file of traffic.
        stops: Numbers of the last stops that came over it.
        begun: What its calls have begun and go on with, such as a set-up, with the bus that it is about.
    """

    name: str
    key: str
    session: str
    right: Right
    grant: int = 0
    live: bool = False
    file: bool = False
    stops: deque[int] = field(default_factory=lambda: deque(maxlen=_STOPS), repr=False)
    begun: dict[str, tuple[object, Any]] = field(default_factory=dict, repr=False)
    _numbers: itertools.count[int] = field(default_factory=lambda: itertools.count(1), repr=False)

    def next_number(self) -> int:
        """Number of its next order."""
        return next(self._numbers)


class Tabs:
    """All open tabs. The loop of the server adds and removes them; any thread may look."""

    def __init__(self) -> None:
        self._tabs: dict[str, Tab] = {}
        self._count = itertools.count(1)

    def __len__(self) -> int:
        return len(self._tabs)

    def open(self, session: str, right: Right) -> Tab:
        """A page is built for a session. If there are too many, the oldest without a socket is forgotten."""
        idle = (each for each in self._tabs.values() if not each.live)
        if len(self._tabs) >= MOST_TABS and (oldest := next(idle, None)) is not None:
            self.close(oldest)
        tab = Tab(f"page {next(self._count)}", secrets.token_urlsafe(16), session, right)
        self._tabs[tab.key] = tab
        return tab

    def find(self, key: str, session: str) -> Tab | None:
        """The tab with that key, if it belongs to that session."""
        tab = self._tabs.get(key)
        return tab if tab is not None and tab.session == session else None

    def close(self, tab: Tab) -> None:
        """A page is gone."""
        self._tabs.pop(tab.key, None)

    def holder(self, grant: int) -> Tab | None:
        """The tab that holds a lease."""
        return next((tab for tab in list(self._tabs.values()) if grant and tab.grant == grant), None)
