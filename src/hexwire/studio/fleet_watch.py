"""The arms of the fleet, for the fleet page: looked at while somebody looks, and stopped.

Owns when the fleet is watched, that stops are made together, and what the page says where there is nothing to
watch. Any thread may call it. Must not know pages or requests, nor how arms are found, asked and stopped; which of
them this program may see and stop, its certificate decides.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hexwire.control.loop.known_state import KNOWN_FOR
from hexwire.control.loop.workers import MOST_GATHERED, MergedCalls
from hexwire.errors import HexwireError, LinkNotFoundError, UsageError
from hexwire.extras import extras_named

if TYPE_CHECKING:
    from hexwire.control.loop.power import Stopped
    from hexwire.fleet.network import Network
    from hexwire.fleet.overview import Overview
    from hexwire.fleet.roster import Roster

__all__ = ["FleetWatch"]

_PERIOD = 0.5
_ANSWERS = 0.4
"""Time-out for the condition of an arm, seconds."""
_UNWATCHED = 10.0
"""Seconds after the last look at which the fleet is left alone."""
_SETTLE = 4.0
"""Seconds until all routes have been tried; a server that hangs takes 3 s."""
_GONE = 60.0
"""Seconds for which an arm that vanished is shown."""
_HUNG = 0.2
"""Seconds after which a stop that still waits, for an arm that hangs, does not keep the next one waiting."""
_MOST_STOPS = 40
"""Stops that wait for such arms at a time: more than can begin until one of them has timed out."""
_LONGEST = 200
"""Letters of the names of those who stopped arms."""
_LAST_STOP = 5.0
"""Seconds in which the last stop must end."""
_HERE = (
    "These are the arms that this user shares on this machine. To see those behind a router, name it in a file, "
    "set HEXWIRE_FLEET to its path, and start the studio again."
)
_NOBODY = "No arm is shared on this machine by this user: start 'hexwire serve --name lab/arm1' in a terminal."


class FleetWatch:
    """Watches the fleet while somebody looks at it.

    Args:
        clock: Seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._resting = threading.Lock()
        self._changed = threading.Event()
        self._thread: threading.Thread | None = None
        self._asked = 0.0
        self._roster: Roster | None = None
        self._rows: list[Overview] | None = None
        self._looked = 0.0
        self._gone: dict[str, float] = {}
        self._error = ""
        self._router = ""
        self._stops: MergedCalls[tuple[str | None, str], Future[list[Stopped]]] | None = None
        self._stopping = ThreadPoolExecutor(_MOST_STOPS, "fleet stops")

    def look(self) -> dict[str, Any]:
        """The arms as they were half a second ago at most, for JSON; the first looks find nothing yet.

        Returns:
            ``arms``, a table each, with ``known``: it says how the arm is now; ``gone``, names of those that
            vanished; ``looking``, whether arms are still being searched for; ``router``; ``note``, what to do;
            ``error``.
        """
        with self._lock:
            self._begin()
            rows, since = self._rows, self._clock() - self._looked
            note = _NOBODY if rows == [] and not self._router else "" if self._router else _HERE
            return {
                "arms": [self._row(row, since) for row in rows or ()],
                "gone": sorted(self._gone),
                "looking": rows is None and not self._error,
                "router": self._router,
                "note": "" if self._error else note,
                "error": self._error,
            }

    def _row(self, row: Overview, since: float) -> dict[str, Any]:
        """A row for JSON, so many seconds after it was looked at."""
        age = None if row.age is None else row.age + since
        known = not row.silent and age is not None and age <= KNOWN_FOR
        return {**asdict(row), "age": age, "known": known, "url": self.address(row.name), "own": False}

    async def stop(self, name: str | None, who: str) -> list[Stopped]:
        """Stop an arm, or all; it needs no lease. One stop answers all who ask for it before it begins.

        Args:
            name: Its name; None for all.
            who: Who stops them, for display.

        Raises:
            HexwireError: The fleet cannot be reached, or there is no such arm.
        """
        with self._lock:
            # The next one finds the arms at once.
            self._begin()
            if self._stops is None:
                self._stops = MergedCalls("fleet stops", self._stop)
            asked = self._stops.ask((name, who))
        begun = await asyncio.wrap_future(asked)
        # Who loses interest does not cancel it for the others.
        found = await asyncio.shield(asyncio.wrap_future(begun))
        done = [row for row in found if name in (None, row.name)]
        if not done:
            raise LinkNotFoundError(f"nothing was stopped: there is no arm {name}" if name else _NOBODY)
        return done

    def _stop(self, asked: list[tuple[str | None, str]]) -> Future[list[Stopped]]:
        """Begin one stop for all who have asked; returns when it is done, or waits only for arms that hang."""
        names = {name for name, _ in asked if name is not None}
        # Of so many, some are not known by name: no burst of names keeps a stop away.
        every = any(name is None for name, _ in asked) or len(asked) >= MOST_GATHERED
        who = ", ".join(dict.fromkeys(who for _, who in asked))[:_LONGEST]
        begun = self._stopping.submit(self._stop_now, None if every else names, who)
        wait((begun,), _HUNG)
        return begun

    def _stop_now(self, names: Collection[str] | None, who: str) -> list[Stopped]:
        with contextlib.ExitStack() as stack:
            roster = self._roster or stack.enter_context(self._open())
            # Only now: what is not installed, it says better.
            from hexwire.fleet.overview import stop_all
            from hexwire.fleet.remote import whoami

            return list(stop_all(roster, f"{who} of {whoami()}", only=names))

    def address(self, name: str) -> str:
        """The address of an arm, for `Source.open`; certificates come from the file of the fleet."""
        return f"zenoh:{name}"

    def known(self, name: str) -> str:
        """The address of an arm that was seen.

        Raises:
            UsageError: None of that name was.
        """
        with self._lock:
            if name not in {row.name for row in self._rows or ()}:
                raise UsageError(f"there is no arm {name[:80]!r}")
        return self.address(name)

    def rest(self) -> None:
        """End watching until somebody looks again."""
        with self._resting:
            self._end()
            self._ending.clear()

    def close(self) -> None:
        """End watching and stopping."""
        self._end()
        if self._stops is not None:
            self._stops.close(_LAST_STOP)
        self._stopping.shutdown()

    def _end(self) -> None:
        self._ending.set()
        self._changed.set()
        # With the lock it has started: one that has not cannot be waited for.
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.join()

    def _begin(self) -> None:
        """Watch for a while from now on; the caller has the lock."""
        self._asked = self._clock()
        if self._thread is None and not self._ending.is_set():
            self._thread = threading.Thread(target=self._watch, name="fleet watch", daemon=True)
            self._thread.start()

    def _open(self) -> Roster:
        from hexwire.fleet.address import router_network
        from hexwire.fleet.node import load_zenoh

        load_zenoh()
        # Zenoh may be there for ROS 2, without what the fleet needs besides.
        with extras_named():
            from hexwire.fleet.roster import Roster
        network: Network | None = router_network()
        self._router = ", ".join(network.connect) if network is not None else ""
        return Roster("**", network, on_change=lambda name, there: self._changed.set())

    def _watch(self) -> None:
        try:
            with self._open() as roster:
                self._error, self._roster = "", roster
                roster.settle(_SETTLE)
                while not self._is_over():
                    begun = time.monotonic()
                    self._look(roster)
                    # An arm that does not answer must not make the others old.
                    self._changed.wait(max(0.0, begun + _PERIOD - time.monotonic()))
                    self._changed.clear()
        except HexwireError as error:
            self._error = str(error)
            self._ending.wait(_PERIOD)
        finally:
            with self._lock:
                self._roster, self._thread = None, None
                self._rows = None

    def _look(self, roster: Roster) -> None:
        from hexwire.fleet.overview import look

        now = self._clock()
        rows = look(roster, _ANSWERS)
        there = {row.name for row in rows}
        with self._lock:
            for row in self._rows or ():
                if row.name not in there:
                    self._gone.setdefault(row.name, now)
            self._gone = {n: when for n, when in self._gone.items() if n not in there and now - when < _GONE}
            self._rows, self._looked = rows, now

    def _is_over(self) -> bool:
        with self._lock:
            return self._ending.is_set() or self._clock() - self._asked > _UNWATCHED
