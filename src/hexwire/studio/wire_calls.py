"""What the page Wire asks of the server, of the open line or of a file: rows, one frame, and how they are read.

Owns these calls. Files come and go over HTTP (`wire_api`). Must not know sockets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from .calls import Arguments, Asked, CallLane, call
from .live import Count

if TYPE_CHECKING:
    from .tabs import Tab

__all__: list[str] = []


class _Rows(Arguments, frozen=True):
    since: Count = 0
    filter: str = ""


class _Frame(Arguments, frozen=True):
    number: Count


class _Series(Arguments, frozen=True):
    series: str


def _lane(tab: Tab) -> CallLane:
    return CallLane.FILES if tab.file else CallLane.COMPUTES


def _of_file(asked: Asked, what: str, *args: object) -> Any:
    """What is asked of a tab's file; None if it has none (any more)."""
    tab = asked.tab
    if not tab.file:
        return None
    found = asked.files.ask(what, tab.key, *args)
    # The files of others have taken its place, or the process with all files has ended.
    tab.file = bool(found)
    return found


@call("wire.rows", _Rows, lane=_lane)
def _rows(asked: Asked, args: _Rows) -> object:
    found = _of_file(asked, "wire_rows", args.since, args.filter)
    return asked.studio.wire.rows(args.since, args.filter) if found is None else msgspec.Raw(found)


@call("wire.frame", _Frame, lane=_lane)
def _frame(asked: Asked, args: _Frame) -> object:
    found = _of_file(asked, "wire_frame", args.number)
    return asked.studio.wire.frame(args.number) if found is None else msgspec.Raw(found)


@call("wire.series", _Series, lane=_lane)
def _series(asked: Asked, args: _Series) -> None:
    """Read what is shown as the traffic of servos of this series."""
    if not _of_file(asked, "wire_series", args.series):
        asked.studio.wire.set_series(args.series)


@call("wire.line", Arguments, lane=_lane)
def _line(asked: Asked, args: Arguments) -> None:
    """Show the open line again, in place of a file."""
    _of_file(asked, "wire_close")
