"""The arms that this program may see: those of this user on this machine, and those behind a router.

Owns finding them, and noticing when one appears or vanishes (by liveliness: at once when its program ends, after
`network.SILENT` seconds when its machine is cut off).
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

__all__ = ["HUNG", "SLOW", "Roster", "Seen"]

HUNG = "its program does not answer: is it halted, or the network slow or down?"

_LOOK = 0.2
"""Seconds between two checks for new sockets and closed connections."""
_AGAIN = 1.0
"""Seconds until a connection that failed is tried again."""
_TOKENS, _OWN_TOKEN = 1.0, 3.0
"""Time-outs for the answers of the servers, and for one on this machine that certainly has an answer, seconds."""
SLOW = 3.5
"""Seconds after which a route that is still being tried counts as one without an answer: connecting to a program
that hangs takes up to 3 s."""
_MOMENT = 0.01
_PATIENCE = 5.0
"""Time-out for the end of a thread, which may be connecting, seconds."""


@dataclass(frozen=True, slots=True)
class Seen:
    """An arm that is present.

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
        router: Router to the arms of other machines; None for this machine only.
        on_change: Called when an arm appears (True) or vanishes (False), in a thread that must not wait.

    Raises:
        UsageError: It is not a pattern. A certificate that cannot be read is only an error of its route.
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
        self._routes: dict[str, _Route] = {}
        # Arm -> connection -> instances of its server. An arm may be reached by two routes.
        self._arms: dict[str, dict[_Route, set[str]]] = {}
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._scanner = threading.Thread(target=self._scan, name="roster", daemon=True)

    def __enter__(self) -> Self:
        if self._router is not None:
            self._begin(_Route(self, self._router, ", ".join(self._router.connect), None))
        self._look()
        self._scanner.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._scanner.join(_PATIENCE)
        for route in list(self._routes.values()):
            route.thread.join(_PATIENCE)

    @property
    def settled(self) -> bool:
        """Whether every route has been tried, so that an arm that was not found does not exist."""
        return all(route.tried.is_set() for route in list(self._routes.values()))

    def settle(self, timeout: float) -> bool:
        """Wait until every route has been tried; returns `settled`."""
        return all(route.tried.wait(timeout) for route in list(self._routes.values()))

    def seen(self) -> dict[str, Seen]:
        """The arms that are present, by name."""
        with self._lock:
            found = {}
            for name, routes in sorted(self._arms.items()):
                route = min(routes, key=lambda route: route.socket is None)
                if route.node is not None:
                    found[name] = Seen(name, route.node, route.socket is not None)
            return found

    def silent(self) -> dict[str, str]:
        """Routes without an answer and the reason: names of arms of this machine, or the router."""
        found, now = {}, time.monotonic()
        for route in list(self._routes.values()):
            if route.tried.is_set():
                if route.error:
                    found[route.name] = route.error
            elif now - route.began >= SLOW:
                # Who does not wait any longer must not take its arm for one that does not exist.
                found[route.name] = route.error or HUNG
        return found

    # -- in threads of their own ------------------------------------------------------------------------

    def _scan(self) -> None:
        while not self._ending.wait(_LOOK):
            self._look()

    def _look(self) -> None:
        for path in local_sockets():
            name = local_name(path)
            if str(path) not in self._routes and (not name or matches(self.pattern, name)):
                self._begin(_Route(self, Network(connect=endpoints_of([path])), name or path.name, path))

    def _begin(self, route: _Route) -> None:
        self._routes[str(route.socket or "")] = route
        route.thread.start()

    def _token(self, route: _Route, key: str, there: bool) -> None:
        if not self._is_wanted(key):
            return
        with contextlib.suppress(UsageError):
            name, instance = name_of(key)
            with self._lock:
                before = name in self._arms
                instances = self._arms.setdefault(name, {}).setdefault(route, set())
                if there:
                    route.error = ""
                    instances.add(instance)
                else:
                    instances.discard(instance)
                self._tidy(name, route)
                after = name in self._arms
            if before != after:
                self._on_change(name, after)

    def _lost(self, route: _Route) -> None:
        """Forget what was seen through a connection that has ended."""
        with self._lock:
            gone = []
            for name in [name for name, routes in self._arms.items() if route in routes]:
                self._arms[name][route].clear()
                self._tidy(name, route)
                if name not in self._arms:
                    gone.append(name)
        for name in gone:
            self._on_change(name, False)

    def _tidy(self, name: str, route: _Route) -> None:
        routes = self._arms[name]
        if not routes[route]:
            del routes[route]
        if not routes:
            del self._arms[name]

    def _run(self, route: _Route) -> None:
        keys = [Keys(pattern).alive for pattern in self._patterns(route)]
        while not self._ending.is_set():
            try:
                route.node = node = route.network.open()
            except HexwireError as error:
                there = route.socket is not None and is_served(route.socket)
                route.error = HUNG if there else str(error)
                route.tried.set()
                if (route.socket is not None and not there) or self._ending.wait(_AGAIN):
                    break
                continue
            route.error = ""
            try:
                # In this order: Zenoh answers a question from what a subscriber has heard so far.
                found = self._tokens(node, route, keys)
                for key in keys:
                    node.watch_visible(key, lambda key, there: self._token(route, key, there))
                deadline = time.monotonic() + _TOKENS
                while not self._knows(route, found) and time.monotonic() < deadline:
                    self._ending.wait(_MOMENT)
                if not found:
                    route.error = self._denied(node) if route.socket is None else self._unheard(route)
                route.tried.set()
                while node.connections and not self._ending.wait(_LOOK):
                    pass
            finally:
                route.node = None
                self._lost(route)
                node.close()
            if route.socket is not None and not is_served(route.socket):
                break
            route.error = "the connection is lost; trying again"
        if route.socket is not None:
            self._routes.pop(str(route.socket), None)

    def _patterns(self, route: _Route) -> list[str]:
        """Patterns to ask for on a route; asking for more than the certificate allows gets no answer."""
        if route.socket is not None:
            # Its only server has a token, so that an empty answer comes too early.
            return ["**"]
        arms = self._rights.arms if self._rights is not None else ()
        # A pattern is compared here like a name: '*' counts as a part, and only '**' matches '**'.
        covered = any(matches(arm, self.pattern) for arm in arms) and "**" not in self.pattern
        return [self.pattern] if not arms or covered or "**" in arms else list(arms)

    def _tokens(self, node: Node, route: _Route, keys: list[str]) -> list[str]:
        """The tokens that exist; those of the server itself appear shortly after the connection opens."""
        deadline = time.monotonic() + (_TOKENS if route.socket is None else _OWN_TOKEN)
        while not (found := [token for key in keys for token in node.visible(key, _TOKENS)]):
            if route.socket is None or time.monotonic() > deadline or self._ending.wait(_MOMENT):
                break
        return [key for key in found if self._is_wanted(key)]

    def _denied(self, node: Node) -> str:
        """Why a router reports no arm; empty if there is none."""
        try:
            try:
                node.ask_neighbours(_TOKENS)
            except NoAnswerError as none:
                return unknown_certificate(node.cert) if none.absent and node.cert else HUNG
        except HexwireError as error:
            return str(error)
        return ""

    def _unheard(self, route: _Route) -> str:
        """Why a server of this machine has not named its arm; empty if that is not wanted anyway."""
        return HUNG if matches(self.pattern, route.name) else ""

    def _knows(self, route: _Route, keys: list[str]) -> bool:
        with self._lock:
            return all(route in self._arms.get(name_of(key)[0], ()) for key in keys)

    def _is_wanted(self, key: str) -> bool:
        with contextlib.suppress(UsageError):
            return matches(self.pattern, name_of(key)[0])
        return False


class _Route:
    """A connection to a server or a router, with the thread that keeps it open."""

    def __init__(self, roster: Roster, network: Network, name: str, socket: Path | None) -> None:
        self.network, self.name, self.socket = network, name, socket
        self.node: Node | None = None
        self.error = ""
        self.tried, self.began = threading.Event(), time.monotonic()
        self.thread = threading.Thread(target=roster._run, args=(self,), name=f"route to {name}", daemon=True)
