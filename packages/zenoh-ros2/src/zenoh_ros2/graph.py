"""The ROS graph as this node sees it: which nodes, publishers, subscriptions, services and clients there are.

Owns the table of liveliness tokens, within bounds. Must not know sessions, nor what follows from a change.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator

from .errors import RemoteProtocolError
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
        # Asked for with every message, in a graph of any size.
        self._by_name: dict[tuple[Role, str], dict[str, Endpoint]] = {}
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
            self._by_name.setdefault((endpoint.role, endpoint.name), {})[token] = endpoint
        return endpoint

    def remove(self, token: str) -> Endpoint | None:
        """Remove a token; returns what it showed, None if it was not known."""
        with self._lock:
            endpoint = self._known.pop(token, None)
            if endpoint is not None:
                at = endpoint.role, endpoint.name
                del self._by_name[at][token]
                if not self._by_name[at]:
                    del self._by_name[at]
            return endpoint

    def find(self, role: Role, name: str | None = None) -> list[Endpoint]:
        """Nodes or endpoints.

        Args:
            role: What.
            name: Full name of topic or service; None for all.
        """
        with self._lock:
            if name is not None:
                return list(self._by_name.get((role, name), {}).values())
            return [each for each in self._known.values() if each.role is role]

    def __iter__(self) -> Iterator[Endpoint]:
        with self._lock:
            known = list(self._known.values())
        return iter(known)
