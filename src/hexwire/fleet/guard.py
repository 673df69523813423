"""Watches through a router for other servers of a name.

Owns a second session with the router, as a client of it. A router tells its clients of every server, but not the
servers of each other: these are peers for Zenoh, which are expected to find each other, and hexwire lets nobody
find anybody. Must not know what a server does about another one.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

from hexwire.errors import HexwireError

from .network import Network
from .node import Node

__all__ = ["NameGuard"]

_RETRY = 1.0
"""Seconds between two attempts to reach the router."""
_ANSWER = 1.0
"""Seconds for an answer of the router."""


class NameGuard:
    """Watches for servers of a name.

    Args:
        network: Connects to the router; it does not listen.
        key: Key or pattern of the liveliness tokens.
    """

    def __init__(self, network: Network, key: str) -> None:
        self._network, self._key = network, key
        self._node: Node | None = None
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Try once to reach the router."""
        # It is retried by `watch`, and the server's own session tells of a router that cannot be reached.
        with contextlib.suppress(HexwireError):
            self._node = self._network.open()

    def visible(self) -> list[str]:
        """Tokens of those who offer the name now; none without a connection."""
        return self._node.visible(self._key, _ANSWER) if self._node is not None else []

    def watch(self, on_token: Callable[[str, bool], object]) -> None:
        """Report in another thread which servers appear and vanish while the router can be reached."""
        self._thread = threading.Thread(target=self._watch, args=(on_token,), name="guard", daemon=True)
        self._thread.start()

    def _watch(self, on_token: Callable[[str, bool], object]) -> None:
        while self._node is None and not self._ending.is_set():
            self.open()
            if self._node is None:
                self._ending.wait(_RETRY)
        if self._node is not None:
            # From here on Zenoh connects again by itself.
            self._node.watch_visible(self._key, on_token)

    def close(self) -> None:
        """End it."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()
        if self._node is not None:
            self._node.close()
