"""What the wire page shows of the open line.

Owns reading its traffic only while somebody looks. Its calls may take tens of milliseconds and may come from any
thread. Must not know pages, requests or sockets, nor files (`wire_files`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from hexwire.link.base import Link, LinkKind
from hexwire.link.tap import Direction, Passed, TapLink
from hexwire.trace.traffic import Traffic, TrafficRing
from hexwire.wire.tables import INTERBYTE_TIMEOUT as _WAITED

from .wire_view import SERIES, View, known_series

__all__ = ["WireFeed"]

_KEPT = 10_000
"""Frames that are shown of the line; about 1 kB each."""
_SPARE = 500
"""More that are kept, so that the oldest one that a page shows can still be opened."""
_BACKLOG = 2000
"""Transfers from before somebody looked that are read then."""
_STEP = 400
"""Transfers that are read at a time, so that nobody waits long for the rest of the program."""
_NOTHING = "Nothing is open. Choose a port on the page Arms, or open a recording or a log here."
_SHARED = (
    "This arm is shared by another program, which owns its line: only that program sees the bytes. Open a "
    "recording made there with --record, or open the port itself."
)


class _Tap(TapLink):
    """A tap of a studio's own. It also passes on, as a transfer without bytes, what ends a frame for its decoder.

    That is the end of a message, and a read that has waited in vain for as long as `FrameDecoder` waits. The times
    of bytes do not say it: those that wait for their reader come together, however long the pause between them was.
    """

    _heard: float | None = None

    def read(self, deadline: float | None) -> bytes:
        data = super().read(deadline)
        now = self.clock()
        if data:
            self._heard = now
        ends = self.kind is LinkKind.DATAGRAM if data else self._heard is not None and now - self._heard >= _WAITED
        if ends:
            self._heard = None
            self._observer(Passed(Direction.RECEIVED, b"", now, self.url))
        return data


class _LineView(View):
    """The open line; ``read`` is the number of the last transfer that was read."""

    def __init__(self, url: str, series: str) -> None:
        super().__init__("live", url, Traffic(series, most=_KEPT + _SPARE), _KEPT)
        self.read = self.skipped = 0


class WireFeed:
    """The traffic of one studio.

    Args:
        clock: Clock of the links, seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._ring = TrafficRing()
        self._live = _LineView("", "board")
        self._tapped = False

    # -- the line -------------------------------------------------------------------------------------------

    def begin(self, url: str) -> Callable[[Link], Link]:
        """Something else is being opened; what is known of the last line is forgotten.

        Args:
            url: What is opened; empty for nothing.

        Returns:
            Wraps its link so that its traffic is kept; for `wrap_new_links`.
        """
        with self._lock:
            self._ring = ring = TrafficRing()
            self._tapped = False
            self._live = _LineView(url, "board")

        def tap(link: Link) -> Link:
            self._tapped = True
            # A link that goes on for something else is not observed twice.
            return _Tap(link.link if isinstance(link, _Tap) else link, ring.feed)

        return tap

    def expect(self, series: Iterable[str]) -> None:
        """Say which series the servos of the open line have, in any order; several are those of the Hex7Bot."""
        found = set(series)
        known = found.pop() if len(found) == 1 and found <= set(SERIES) else "board"
        with self._lock:
            self._live = _LineView(self._live.name, known)

    # -- looking ----------------------------------------------------------------------------------------------

    def set_series(self, series: str) -> None:
        """Read the line as the traffic of servos of this series.

        Raises:
            UsageError: There is no such series.
        """
        known = known_series(series)
        with self._lock:
            self._live = _LineView(self._live.name, known)

    def rows(self, since: int, wanted: str = "") -> dict[str, Any]:
        """Rows of the line with what came meanwhile, as `View.rows`; raises as it.

        And ``skipped``, the number of transfers that were left out while nobody looked.
        """
        with self._lock:
            self._update()
            page = self._live.rows(since, wanted, self._note(), time.time() - self._clock())
            return {**page, "skipped": self._live.skipped}

    def frame(self, number: int) -> dict[str, Any]:
        """One frame of the line, as `View.frame`; raises as it."""
        with self._lock:
            return self._live.frame(number)

    def kept(self) -> tuple[list[Passed], float]:
        """What the studio still has of the line, and seconds to add to its times for seconds since 1970."""
        return [passed for _, passed in self._ring.since(0) if passed.data], time.time() - self._clock()

    def _update(self) -> None:
        """Read what came over the line meanwhile."""
        view = self._live
        # After a time in which nobody looked, only the end is read: the rest would keep the arm waiting.
        fresh = self._ring.since(max(view.read, self._ring.newest - _BACKLOG))
        if fresh and fresh[0][0] > view.read + 1:
            view.skipped += fresh[0][0] - view.read - 1 if view.read else 0
            view.traffic.skip()
        for number, passed in fresh[:_STEP]:
            view.traffic.feed(passed)
            view.read = number

    def _note(self) -> str:
        view = self._live
        if not view.name:
            return _NOTHING
        if not self._tapped:
            return _SHARED if view.name.startswith("zenoh:") else "No bytes are seen of this line."
        return ""
