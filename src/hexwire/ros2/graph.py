"""The ROS graph as this node sees it: which nodes, publishers, subscriptions, services and clients there are.

Owns the table of liveliness tokens, within bounds. Must not know sessions, nor what follows from a change.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

from hexwire.errors import RemoteProtocolError

from .keys import Endpoint, Role, parse_token

__all__ = ["Graph"]

_MOST = 20_000
"""Most tokens in the table."""


class Graph:
    """Nodes and endpoints of a domain. Any thread may call it.

    Attributes:
        malformed: Tokens that could not be read.
        left_out: Tokens for which there was no room.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[str, Endpoint] = {}
        self.malformed = 0
        self.left_out = 0

    def add(self, token: str) -> Endpoint | None:
        """Add a token.

        Returns:
            What it shows; None if it is known already, malformed, or there is no room.
        """
        try:
            endpoint = parse_token(token)
        except RemoteProtocolError:
            self.malformed += 1
            return None
        with self._lock:
            if token in self._known:
                return None
            if len(self._known) >= _MOST:
                self.left_out += 1
                return None
            self._known[token] = endpoint
        return endpoint

    def remove(self, token: str) -> Endpoint | None:
        """Remove a token; returns what it showed, None if it was not known."""
        with self._lock:
            return self._known.pop(token, None)

    def find(self, role: Role, name: str | None = None) -> list[Endpoint]:
        """Nodes or endpoints.

        Args:
            role: What.
            name: Full name of topic or service; None for all.
        """
        return [each for each in self if each.role is role and name in (None, each.name)]

    def __iter__(self) -> Iterator[Endpoint]:
        with self._lock:
            known = list(self._known.values())
        return iter(known)
