"""Traffic that somebody looks at: pages of rows that pass a filter, one frame with its tree.

Owns what of it becomes JSON. Its calls may take tens of milliseconds.
"""

from __future__ import annotations

import math
import secrets
import sys
from typing import Any

from hexwire.errors import UsageError
from hexwire.trace.explain import Explainer
from hexwire.trace.filtering import is_unanswered, parse_filter
from hexwire.trace.traffic import Entry, Traffic

__all__ = ["LARGEST_FILE", "SERIES", "View", "known_series"]

LARGEST_FILE = 16 * 1024 * 1024
"""Bytes of a file that a page may open."""

SERIES = ("board", "seven_bot", "scs", "sts_sms", "hls")
"""Series of the servos on a line; board: those of the Hex7Bot, by id."""
_PAGE = 1000
_PROBLEM = 6
"""Its place in a row."""
_OVERDUE = 1.0
"""Seconds after which no answer is expected any more: those that take longest come after half a second."""


def known_series(series: str) -> str:
    """A series, checked.

    Raises:
        UsageError: There is no such series.
    """
    if series not in SERIES:
        raise UsageError(f"there is no servo series {series[:20]!r}; choose {', '.join(SERIES)}")
    return series


class View:
    """Traffic to look at.

    Args:
        kind: ``live`` or ``file``.
        name: Of the line or the file.
        traffic: The frames.
        most: As many of them are said to be kept.

    Attributes:
        id: Another one for each.
    """

    def __init__(self, kind: str, name: str, traffic: Traffic, most: int = sys.maxsize) -> None:
        self.id = secrets.token_hex(8)
        self.kind, self.name, self.traffic, self._most = kind, name, traffic, most
        self._explainer = Explainer(traffic.series)

    def rows(self, since: int, wanted: str = "", note: str = "", offset: float = 0.0) -> dict[str, Any]:
        """The rows after a number that pass a filter, oldest first, for JSON.

        Args:
            since: The last number that was looked at; 0 for all.
            wanted: The filter.
            note: What a person should know of it.
            offset: Seconds to add to times for seconds since 1970.

        Returns:
            ``rows`` as `Entry.as_row`; ``answers`` that do not pass, to requests that do, each as the numbers of
            both; ``next``, the number to continue from; ``more``, whether there is more already; ``first``, the
            oldest number that is kept, and ``span``, the seconds from it to the newest; ``id``, another one for
            each source; its ``view``, ``name`` and ``series``; ``note`` and ``offset``; ``newest``, the number of
            its newest frame.

        Raises:
            UsageError: The filter is wrong.
        """
        passes, traffic = parse_filter(wanted), self.traffic
        first = traffic.newest - min(len(traffic), self._most) + 1
        oldest, newest = traffic.get(first), traffic.get(traffic.newest)
        overdue = (
            newest.reading.time - _OVERDUE if newest and passes.of_answers and self.kind == "live" else math.inf
        )
        more = True
        found, answers, reached, looked = list[Entry](), list[tuple[int, int]](), max(since, 0), 0
        for entry in traffic.since(since):
            looked += 1
            if looked > 5 * _PAGE or len(found) == _PAGE:
                break
            if entry.reading.time > overdue and is_unanswered(entry):
                # Whether it passes is known later.
                more = False
                break
            reached = entry.number
            if passes(entry):
                found.append(entry)
            elif entry.answers is not None:
                request = traffic.get(entry.answers)
                if request is not None and passes(request):
                    answers.append((request.number, entry.number))
        rows = [entry.as_row() for entry in found]
        for row, entry in zip(rows, found, strict=True):
            if passes.of_answers and is_unanswered(entry):
                row[_PROBLEM] = row[_PROBLEM] or "no answer came"
        return {
            "rows": rows,
            "answers": answers,
            "next": reached if found or looked else min(since, traffic.newest),
            "more": more and reached < traffic.newest,
            "first": first,
            "newest": traffic.newest,
            "span": newest.reading.time - oldest.reading.time if oldest and newest else 0.0,
            "id": self.id,
            "view": self.kind,
            "name": self.name,
            "series": traffic.series,
            "note": note,
            "offset": offset,
        }

    def frame(self, number: int) -> dict[str, Any]:
        """One frame with its bytes and its tree, for JSON.

        Raises:
            UsageError: It is no longer kept.
        """
        entry = self.traffic.get(number)
        if entry is None:
            raise UsageError(f"frame {number} is no longer kept")
        return {
            "number": number,
            "row": entry.as_row(),
            "hex": entry.reading.data.hex(),
            "tree": self._explainer.dissect(entry.reading).as_fields(),
            "answered": entry.answered,
            "took": None if entry.took is None else round(1000 * entry.took, 3),
        }
