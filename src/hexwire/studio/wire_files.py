"""Files of traffic that tabs look at, in the process for the files of pages (`page_work`).

Owns which tab has which, and the bounds of a file. Must not know pages, requests or links.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hexwire.errors import UsageError
from hexwire.link.tap import Passed
from hexwire.trace.sources import read_traffic
from hexwire.trace.traffic import Traffic

from .wire_view import LARGEST_FILE, View, known_series

__all__ = ["WireFiles"]

_MOST_OF_FILE = 30_000
"""Frames of a file that are shown: a small file may hold millions, and reading them takes time and memory."""
_MOST_TRANSFERS = 200_000
_MOST_FILES = 4
_PIECE = 4096
_MOST_REMARKS = 20


class _FileView(View):
    """A file, read up to the bounds."""

    def __init__(self, name: str, items: Iterable[Passed | str], series: str) -> None:
        super().__init__("file", name, Traffic(series, most=_MOST_OF_FILE, size=2 * LARGEST_FILE))
        self.transfers, self.remarks = list[Passed](), list[str]()
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
        if len(self.transfers) == 1 and all(entry.bad for entry in self.traffic):
            raise UsageError(
                f"{name} has no frame or packet: open a recording, a capture, a log, a hex dump, or bytes of a line"
            )

    def rows(self, since: int, wanted: str = "", note: str = "", offset: float = 0.0) -> dict[str, Any]:
        kept = f"only the first {self.traffic.newest} frames are shown; 'hexwire trace decode' reads all"
        note = "; ".join([*([kept] if self.cut else []), *self.remarks])
        return super().rows(since, wanted, note, offset)


class WireFiles:
    """The files of all tabs. Not thread-safe."""

    def __init__(self) -> None:
        self._files: dict[str, _FileView] = {}

    def open(self, tab: str, data: bytes, name: str, series: str = "board") -> None:
        """Show a file to a tab: a recording, a capture of Wireshark, a log, a hex dump, a raw capture.

        Of too many, the oldest is closed.

        Raises:
            UsageError: It is too large, or cannot be read.
        """
        if len(data) > LARGEST_FILE:
            raise UsageError(
                f"{name} is larger than {LARGEST_FILE >> 20} MiB: decode it with 'hexwire trace decode'"
            )
        view = _FileView(name, read_traffic(data, name), known_series(series))
        if not view.transfers:
            raise UsageError("; ".join([f"{name} has no traffic", *view.remarks[:3]]))
        self._files.pop(tab, None)
        if len(self._files) >= _MOST_FILES:
            del self._files[next(iter(self._files))]
        self._files[tab] = view

    def view(self, tab: str) -> _FileView | None:
        """The file of a tab; None if it has none."""
        return self._files.get(tab)

    def set_series(self, tab: str, series: str) -> bool:
        """Read the file of a tab as the traffic of servos of this series; False if it has none.

        Raises:
            UsageError: There is no such series.
        """
        known, file = known_series(series), self._files.get(tab)
        if file is None:
            return False
        view = _FileView(file.name, [*file.transfers, *file.remarks], known)
        view.cut = view.cut or file.cut
        self._files[tab] = view
        return True

    def close(self, tab: str) -> None:
        """Show no file to a tab any more."""
        self._files.pop(tab, None)
