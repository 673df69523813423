"""The arms that this program may see: those of this user on this machine, and those behind a router.

Owns finding them, and telling when one appears or vanishes (by liveliness: at once when its program
ends, after `network.SILENT` seconds when its machine is cut off). Must not know what is asked of them.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from hexwire.errors import HexwireError, UsageError

from .address import rights_of
from .endpoints import endpoints_of, is_served, local_name, local_sockets
from .names import Keys, check_pattern, matches, name_of
from .network import Network
from .node import NoAnswerError, Node
from .questions import unknown_certificate

__all__ = ["HUNG", "Roster", "Seen"]

HUNG = "its program does not answer: is it halted, or the network slow or cut?"

_LOOK = 0.2
"""Seconds between two looks for sockets that appeared and connections that ended."""
_AGAIN = 1.0
"""Seconds until a connection that failed is tried again."""
_TOKENS = 1.0
"""Seconds in which those who are there must answer."""
_MOMENT = 0.01
_PATIENCE = 5.0
"""Seconds in which a thread ends: it may be connecting."""


@dataclass(frozen=True, slots=True)
class Seen:
    """An arm that is there.

    Attributes:
        name: Its name.
        node: The session through which it is reached; closed when the arm vanishes.
        local: It is served by this user on this machine.
    """

    name: str
    node: Node
    local: bool


class Roster:
    """Follows which arms are there, for a `with` block.

    Args:
        pattern: Names of interest.
        router: The way to arms of other machines; None for this machine only.
        on_change: Called when an arm appears (True) or vanishes (False), in a thread that must not wait.

    Raises:
        UsageError: It is not a pattern. A certificate that cannot be read is only an error of its way.
    """

    def __init__(
        self,
        pattern: str = "**",
        router: Network | None = None,
        *,
        on_change: Callable[[str, bool], object] = lambda name, there: None,
    ) -> None:
        self.pattern = check_pattern(pattern)
        self._router, self._on_change = router, on_change
        self._rights = None
        if router is not None and router.cert:
            with contextlib.suppress(UsageError):
                self._rights = rights_of(router.cert)
        self._ways: dict[str, _Way] = {}
        # Arm -> connection -> instances of its server. An arm may be reached on two ways.
        self._arms: dict[str, dict[_Way, set[str]]] = {}
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._scanner = threading.Thread(target=self._scan, name="roster", daemon=True)

    def __enter__(self) -> Self:
        if self._router is not None:
            self._begin(_Way(self, self._router, ", ".join(self._router.connect), None))
        self._look()
        self._scanner.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._scanner.join(_PATIENCE)
        for way in list(self._ways.values()):
            way.thread.join(_PATIENCE)

    @property
    def settled(self) -> bool:
        """Whether every way was tried, so that an arm that is not seen is not there."""
        return all(way.tried.is_set() for way in list(self._ways.values()))

    def settle(self, timeout: float) -> bool:
        """Wait until every way was tried; returns `settled`."""
        return all(way.tried.wait(timeout) for way in list(self._ways.values()))

    def seen(self) -> dict[str, Seen]:
        """The arms that are there now, by name."""
        with self._lock:
            found = {}
            for name, ways in sorted(self._arms.items()):
                way = min(ways, key=lambda way: way.socket is None)
                if way.node is not None:
                    found[name] = Seen(name, way.node, way.socket is not None)
            return found

    def silent(self) -> dict[str, str]:
        """Ways on which nobody answers, and why: names of arms of this machine, or the router."""
        ways = list(self._ways.values())
        return {way.name: way.error for way in ways if way.error and way.tried.is_set()}

    # -- in threads of their own ------------------------------------------------------------------------

    def _scan(self) -> None:
        while not self._ending.wait(_LOOK):
            self._look()

    def _look(self) -> None:
        for path in local_sockets():
            name = local_name(path)
            if str(path) not in self._ways and (not name or matches(self.pattern, name)):
                self._begin(_Way(self, Network(connect=endpoints_of([path])), name or path.name, path))

    def _begin(self, way: _Way) -> None:
        self._ways[str(way.socket or "")] = way
        way.thread.start()

    def _token(self, way: _Way, key: str, there: bool) -> None:
        if not self._is_wanted(key):
            return
        with contextlib.suppress(UsageError):
            name, instance = name_of(key)
            with self._lock:
                before = name in self._arms
                instances = self._arms.setdefault(name, {}).setdefault(way, set())
                if there:
                    way.error = ""
                    instances.add(instance)
                else:
                    instances.discard(instance)
                self._tidy(name, way)
                after = name in self._arms
            if before != after:
                self._on_change(name, after)

    def _lost(self, way: _Way) -> None:
        """A connection has ended, and with it all that was seen through it."""
        with self._lock:
            gone = []
            for name in [name for name, ways in self._arms.items() if way in ways]:
                self._arms[name][way].clear()
                self._tidy(name, way)
                if name not in self._arms:
                    gone.append(name)
        for name in gone:
            self._on_change(name, False)

    def _tidy(self, name: str, way: _Way) -> None:
        ways = self._arms[name]
        if not ways[way]:
            del ways[way]
        if not ways:
            del self._arms[name]

    def _run(self, way: _Way) -> None:
        keys = [Keys(pattern).alive for pattern in self._patterns(way)]
        while not self._ending.is_set():
            try:
                way.node = node = way.network.open()
            except HexwireError as error:
                there = way.socket is not None and is_served(way.socket)
                way.error = HUNG if there else str(error)
                way.tried.set()
                if (way.socket is not None and not there) or self._ending.wait(_AGAIN):
                    break
                continue
            way.error = ""
            try:
                # In this order: Zenoh answers a question from what a subscriber has heard so far.
                found = self._tokens(node, way, keys)
                for key in keys:
                    node.watch_visible(key, lambda key, there: self._token(way, key, there))
                deadline = time.monotonic() + _TOKENS
                while not self._knows(way, found) and time.monotonic() < deadline:
                    self._ending.wait(_MOMENT)
                if not found and way.socket is None:
                    way.error = self._denied(node)
                way.tried.set()
                while node.connections and not self._ending.wait(_LOOK):
                    pass
            finally:
                way.node = None
                self._lost(way)
                node.close()
            if way.socket is not None and not is_served(way.socket):
                break
            way.error = "the connection is lost; it is tried again"
        if way.socket is not None:
            self._ways.pop(str(way.socket), None)

    def _patterns(self, way: _Way) -> list[str]:
        """What to ask for on a way: who asks for more than its certificate is for hears nothing."""
        if way.socket is not None:
            # Its only server has a token, so that an empty answer comes too early.
            return ["**"]
        arms = self._rights.arms if self._rights is not None else ()
        # One part of a pattern stands for itself here; for '**' only '**' does.
        covered = any(matches(arm, self.pattern) for arm in arms) and "**" not in self.pattern
        return [self.pattern] if not arms or covered or "**" in arms else list(arms)

    def _tokens(self, node: Node, way: _Way, keys: list[str]) -> list[str]:
        """The tokens that are there; a server's own ones come a moment after the connection stands."""
        deadline = time.monotonic() + _TOKENS
        while not (found := [token for key in keys for token in node.visible(key, _TOKENS)]):
            if way.socket is None or time.monotonic() > deadline or self._ending.wait(_MOMENT):
                break
        return [key for key in found if self._is_wanted(key)]

    def _denied(self, node: Node) -> str:
        """Why a router says of no arm that it is there; empty if none is."""
        try:
            try:
                node.ask_neighbours(_TOKENS)
            except NoAnswerError as none:
                return unknown_certificate(node.cert) if none.absent and node.cert else HUNG
        except HexwireError as error:
            return str(error)
        return ""

    def _knows(self, way: _Way, keys: list[str]) -> bool:
        with self._lock:
            return all(way in self._arms.get(name_of(key)[0], ()) for key in keys)

    def _is_wanted(self, key: str) -> bool:
        with contextlib.suppress(UsageError):
            return matches(self.pattern, name_of(key)[0])
        return False


class _Way:
    """A connection to a server or a router, with the thread that keeps it."""

    def __init__(self, roster: Roster, network: Network, name: str, socket: Path | None) -> None:
        self.network, self.name, self.socket = network, name, socket
        self.node: Node | None = None
        self.error = ""
        self.tried = threading.Event()
        self.thread = threading.Thread(target=roster._run, args=(self,), name=f"way to {name}", daemon=True)
