"""What the wire page shows: the traffic of the open line, or of a file, for each tab.

Owns which of the two a tab looks at, reading the traffic only while somebody looks, and the bounds of a file. Its
calls may take tens of milliseconds and may come from any thread. Must not know pages, requests or sockets.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from hexwire.errors import UsageError
from hexwire.link.base import Link, LinkKind
from hexwire.link.tap import Direction, Passed, TapLink
from hexwire.trace.dissect import Dissector
from hexwire.trace.filtering import parse_filter
from hexwire.trace.ring import TrafficRing
from hexwire.trace.saving import saved_traffic
from hexwire.trace.sources import read_traffic
from hexwire.trace.traffic import Entry, Traffic
from hexwire.wire.tables import INTERBYTE_TIMEOUT as _WAITED

from .access import Right

__all__ = ["LARGEST_FILE", "SERIES", "WireFeed"]

LARGEST_FILE = 16 * 1024 * 1024
"""Bytes of a file that a page may open."""
SERIES = ("board", "seven_bot", "scs", "sts_sms", "hls")
"""Series of the servos on a line; board: those of the Hex7Bot, by id."""

_MOST_OF_FILE = 30_000
"""Frames of a file that are shown: a small file may hold millions, and reading them takes time and memory."""
_MOST_TRANSFERS = 200_000
_MOST_FILES = 4
_PIECE = 4096
_PAGE = 1000
_BACKLOG = 2000
"""Transfers from before somebody looked that are read then."""
_STEP = 400
"""Transfers that are read at a time, so that nobody waits long for the rest of the program."""
_MOST_REMARKS = 20
_NOTHING = "Nothing is open. Choose a port on the page Connect, or open a recording or a log here."
_SHARED = (
    "This arm is shared by another program, which owns its line: only that program sees the bytes. Open a "
    "recording made there with --record, or open the port itself."
)


_views = itertools.count(1)


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


class _View:
    """The traffic that a tab looks at."""

    def __init__(self, kind: str, name: str, series: str) -> None:
        self.id = next(_views)
        self.kind, self.name = kind, name
        self.traffic = Traffic(series)
        self.dissector = Dissector(series)
        self.read = 0
        self.skipped = 0


class _FileView(_View):
    """A file, read up to the bounds."""

    right = Right.OPERATE
    """Of the session whose tab it is."""

    def __init__(self, name: str, items: Iterable[Passed | str], series: str) -> None:
        super().__init__("file", name, series)
        self.transfers, self.remarks = list[Passed](), list[str]()
        self.traffic = Traffic(series, most=_MOST_OF_FILE, size=2 * LARGEST_FILE)
        self.cut = False
        for item in items:
            if isinstance(item, str):
                if len(self.remarks) < _MOST_REMARKS:
                    self.remarks.append(item)
                continue
            if self.traffic.newest >= _MOST_OF_FILE or len(self.transfers) >= _MOST_TRANSFERS:
                self.cut = True
                break
            self.transfers.append(item)
            # A raw capture is one transfer: it is read in pieces, up to the bound.
            for at in range(0, len(item.data), _PIECE):
                if self.traffic.newest >= _MOST_OF_FILE:
                    self.cut = True
                    break
                self.traffic.feed(item._replace(data=item.data[at : at + _PIECE]))
        if not self.cut:
            self.traffic.finish()

    def empty(self) -> None:
        """Free what was read, one by one, when nobody sees it any more: at once that would keep the arm waiting."""
        self.traffic.clear()
        while self.transfers:
            self.transfers.pop()


class WireFeed:
    """The traffic of one studio.

    Args:
        clock: Clock of the links, seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._ring = TrafficRing()
        self._url = ""
        self._tapped = False
        self._live = _View("live", "", "board")
        self._files: dict[str, _FileView] = {}

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
            self._url, self._tapped = url, False
            self._live = _View("live", url, "board")

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
            self._live = _View("live", self._url, known)

    # -- what a tab looks at ----------------------------------------------------------------------------------

    def open_file(
        self, tab: str, data: bytes, name: str, series: str = "board", *, right: Right = Right.OPERATE
    ) -> None:
        """Show a file to a tab: a recording, a capture of Wireshark, a log, a hex dump, a raw capture.

        Raises:
            UsageError: It is too large, or cannot be read.
        """
        if len(data) > LARGEST_FILE:
            raise UsageError(
                f"{name} is larger than {LARGEST_FILE >> 20} MiB: decode it with 'hexwire trace decode'"
            )
        view = _FileView(name, read_traffic(data, name), _known(series))
        if not view.transfers:
            raise UsageError("; ".join([f"{name} has no traffic", *view.remarks[:3]]))
        with self._lock:
            gone = [self._files.pop(tab, None)]
            # Those who only watch close no file of an operator's.
            others = [key for key, each in self._files.items() if each.right is right]
            if len(others) >= _MOST_FILES:
                gone.append(self._files.pop(others[0]))
            view.right = right
            self._files[tab] = view
        for old in filter(None, gone):
            old.empty()

    def close_file(self, tab: str) -> None:
        """Show the line to a tab again."""
        with self._lock:
            view = self._files.pop(tab, None)
        if view is not None:
            view.empty()

    def set_series(self, tab: str, series: str) -> None:
        """Read what a tab looks at as the traffic of servos of this series; for the line, in all tabs.

        Raises:
            UsageError: There is no such series.
        """
        known = _known(series)
        with self._lock:
            file = self._files.get(tab)
            if file is None:
                self._live = _View("live", self._url, known)
                return
            items: list[Passed | str] = [*file.transfers, *file.remarks]
        view = _FileView(file.name, items, known)
        view.cut, view.right = view.cut or file.cut, file.right
        with self._lock:
            old = view
            if tab in self._files:
                old, self._files[tab] = self._files[tab], view
        old.empty()

    # -- looking ----------------------------------------------------------------------------------------------

    def rows(self, tab: str, since: int, wanted: str = "") -> dict[str, Any]:
        """The rows after a number that pass a filter, oldest first, for JSON.

        Args:
            tab: Who looks.
            since: The last number that it has looked at; 0 for all.
            wanted: The filter.

        Returns:
            ``rows`` as `Entry.as_row`; ``next``, the number to continue from; ``more``, whether there is more
            already; ``first``, the oldest number that is kept; ``offset``, seconds to add to times for seconds
            since 1970; ``id``, another number for each source; its ``view``, ``name``, ``series`` and ``note``;
            ``newest``, the number of its newest frame.

        Raises:
            UsageError: The filter is wrong.
        """
        passes = parse_filter(wanted)
        with self._lock:
            view = self._updated(tab)
            found, reached, looked = list[Entry](), max(since, 0), 0
            for entry in view.traffic.since(since):
                looked += 1
                if looked > 5 * _PAGE or len(found) == _PAGE:
                    break
                reached = entry.number
                if passes(entry):
                    found.append(entry)
            return {
                "rows": [entry.as_row() for entry in found],
                "next": reached if found or looked else min(since, view.traffic.newest),
                "more": reached < view.traffic.newest,
                "first": view.traffic.newest - len(view.traffic) + 1,
                "newest": view.traffic.newest,
                "id": view.id,
                "view": view.kind,
                "name": view.name,
                "series": view.traffic.series,
                "note": self._note(view),
                "offset": time.time() - self._clock() if view.kind == "live" else 0.0,
            }

    def frame(self, tab: str, number: int) -> dict[str, Any]:
        """One frame with its bytes and its tree, for JSON.

        Raises:
            UsageError: It is no longer kept.
        """
        with self._lock:
            view = self._view(tab)
            entry = view.traffic.get(number)
            if entry is None:
                raise UsageError(f"frame {number} is no longer kept")
            return {
                "number": number,
                "row": entry.as_row(),
                "hex": entry.reading.data.hex(),
                "tree": view.dissector.dissect(entry.reading).as_fields(),
                "answered": entry.answered,
                "took": None if entry.took is None else round(1000 * entry.took, 3),
            }

    def saved(self, tab: str, form: str) -> bytes:
        """The traffic that a tab looks at as a file; of the line, what the studio still has.

        Raises:
            UsageError: See `saved_traffic`.
        """
        with self._lock:
            file, ring = self._files.get(tab), self._ring
            transfers = [] if file is None else [*file.transfers]
        if file is not None:
            return saved_traffic(transfers, form)
        kept = (passed for _, passed in ring.since(0) if passed.data)
        return saved_traffic(kept, form, offset=time.time() - self._clock())

    def _view(self, tab: str) -> _View:
        return self._files.get(tab, self._live)

    def _updated(self, tab: str) -> _View:
        """The view of a tab, with what came over the line meanwhile."""
        view = self._view(tab)
        if view.kind == "file":
            return view
        # After a time in which nobody looked, only the end is read: the rest would keep the arm waiting.
        fresh = self._ring.since(max(view.read, self._ring.newest - _BACKLOG))
        if fresh and fresh[0][0] > view.read + 1:
            view.skipped += fresh[0][0] - view.read - 1 if view.read else 0
            view.traffic.skip()
        for number, passed in fresh[:_STEP]:
            view.traffic.feed(passed)
            view.read = number
        return view

    def _note(self, view: _View) -> str:
        if isinstance(view, _FileView):
            kept = f"only the first {view.traffic.newest} frames are shown; 'hexwire trace decode' reads all"
            return "; ".join([*([kept] if view.cut else []), *view.remarks])
        if not self._url:
            return _NOTHING
        if not self._tapped:
            return _SHARED if self._url.startswith("zenoh:") else "No bytes are seen of this line."
        return f"{view.skipped} transfers were left out while nobody looked." if view.skipped else ""


def _known(series: str) -> str:
    if series not in SERIES:
        raise UsageError(f"there is no servo series {series[:20]!r}; choose {', '.join(SERIES)}")
    return series
