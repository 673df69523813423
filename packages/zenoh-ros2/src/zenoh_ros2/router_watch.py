"""Whether the node has a router: says so once when it is missing, lost and back.

Owns the texts and when they are due. Must not know Zenoh.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence

__all__ = ["RouterWatch"]

_LOOK = 0.05
_PERIOD = 1.0
"""Seconds between two looks, and of one attempt."""

_SAID = 10
"""Seconds after which it is said again that there is no router."""


class RouterWatch:
    """Looks for a router, in a thread of its own.

    Args:
        routers: Number of routers that the session is connected to.
        endpoints: Where they are expected.
        remedy: What to do without one, beginning with a verb.
        log: Where to say it.
    """

    def __init__(
        self, routers: Callable[[], int], endpoints: Sequence[str], remedy: str, log: logging.Logger
    ) -> None:
        self._routers, self._remedy, self._log = routers, remedy, log
        self._where = " or ".join(endpoints) or "any endpoint"
        self._stop = threading.Event()
        self._had = False
        self._thread = threading.Thread(target=self._run, name="watch the router", daemon=True)

    def wait(self, attempts: int) -> bool:
        """Wait for a router; returns whether there is one.

        Args:
            attempts: Seconds to wait at most; 0 for no limit. Now and then it is said that there is none.
        """
        number = 0
        while not self._connected():
            number += 1
            if number % _SAID == 1:
                self.say_missing()
            if number == attempts or self._stop.is_set():
                return False
        self._had = True
        return True

    def start(self) -> None:
        """Go on looking in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """End that thread."""
        self._stop.set()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def look(self) -> None:
        """Look once, and say what has changed."""
        has = self._routers() > 0
        if has and not self._had:
            self._log.info("Connected to a Zenoh router")
        elif self._had and not has:
            self._log.warning(
                "The connection to the Zenoh router is lost; until %s is back, other nodes do not see this one",
                self._where,
            )
        self._had = has

    def _connected(self) -> bool:
        for _ in range(round(_PERIOD / _LOOK)):
            if self._routers() > 0:
                return True
            if self._stop.wait(_LOOK):
                return False
        return False

    def say_missing(self) -> None:
        """Say that there is no router, and what to do."""
        self._log.warning(
            "Unable to connect to a Zenoh router at %s. %s; until then other nodes do not see this one",
            self._where,
            self._remedy[0].upper() + self._remedy[1:],
        )

    def _run(self) -> None:
        while not self._stop.wait(_PERIOD):
            self.look()
