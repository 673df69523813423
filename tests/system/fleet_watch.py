"""The three promises of a shared arm, checked on what its servos did: see `violations`.

Owns the reading of the logs of `watched_board` and `fleet_client`, and the judgement. Everything is in the clock
that the programs of a machine share. Nothing here believes what hexwire reports of itself: motions come from the
servos, the lease from what its holders have sent and been answered.
"""

from __future__ import annotations

import bisect
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.system.watched_board import ROW

TIMEOUT = 1.0
"""Seconds of silence after which a lease is lost. Longer than what `hexwire serve` has by default: a machine that
stalls is silent, too."""
SETTLING = 0.5
"""Seconds from a confirmed stop to rest. A servo of 4200 counts/s that brakes with 40,000 counts/s^2 needs 0.11 s
and goes back as long, since a stop holds where it was asked for; the rest is for a machine that stalls."""
HOLD = 1.5
"""Seconds from the end of a lease to rest: a look at the clock, a state, an order to the board, `SETTLING`, and a
second for a machine that stalls."""
STILL = 1.5
"""Counts by which a servo at rest may differ: its position is rounded, a held joint is not stiff."""
ROUNDING = 1.0
"""Counts by which a position that was read may differ: the servo rounds."""
SAME = 1.0
"""Seconds by which the start of a board may differ, as its log and a state tell it."""
LATE = 0.05
"""Seconds by which the stamp of a state may be wrong, besides its own uncertainty: the way from the board, and its
clock."""

Span = tuple[float, float]


@dataclass(slots=True)
class Servo:
    """What one servo did: rows of time, driven, target and position."""

    times: list[float] = field(default_factory=list)
    driven: list[int] = field(default_factory=list)
    targets: list[float] = field(default_factory=list)
    positions: list[float] = field(default_factory=list)

    def add(self, time: float, driven: int, target: float, position: float) -> None:
        self.times.append(time)
        self.driven.append(driven)
        self.targets.append(target)
        self.positions.append(position)

    def between(self, begin: float, end: float) -> range:
        """Rows in a time, and the one that held when it began."""
        first = max(bisect.bisect_right(self.times, begin) - 1, 0)
        return range(first, max(bisect.bisect_right(self.times, end), first + 1))

    def position(self, time: float) -> float:
        """Position at a time, on a straight line between two rows."""
        after = bisect.bisect_right(self.times, time)
        if after in (0, len(self.times)):
            return self.positions[max(after - 1, 0)]
        begin, end = self.times[after - 1], self.times[after]
        part = (time - begin) / (end - begin) if end > begin else 1.0
        return self.positions[after - 1] + part * (self.positions[after] - self.positions[after - 1])

    def had(self, begin: float, end: float) -> tuple[float, float]:
        """Least and greatest position in a time."""
        inside = [self.positions[i] for i in self.between(begin, end) if begin <= self.times[i] <= end]
        values = [self.position(begin), self.position(end), *inside]
        return min(values), max(values)

    def may_have_had(self, begin: float, end: float) -> tuple[float, float]:
        """Least and greatest position in a time, from the row before it to the row after it.

        A board that stalls writes nothing down meanwhile, and a servo that brakes is not on the straight line
        between its rows.
        """
        rows = self.positions[
            max(bisect.bisect_right(self.times, begin) - 1, 0) : bisect.bisect_left(self.times, end) + 1
        ]
        return min(rows), max(rows)


class BoardLog:
    """The log of a board that may go on; `servos` is what it says so far, by id."""

    def __init__(self, path: Path) -> None:
        self.servos: dict[int, Servo] = {}
        self._path, self._read = path, 0

    def read(self) -> dict[int, Servo]:
        """Read what was added; returns `servos`."""
        with self._path.open("rb") as file:
            file.seek(self._read)
            data = file.read()
        whole = len(data) // ROW.size * ROW.size
        self._read += whole
        for time, number, *row in ROW.iter_unpack(data[:whole]):
            self.servos.setdefault(number, Servo()).add(time, *row)
        return self.servos


class ClientLog:
    """The log of a client that may go on; the last line of one that was killed may be cut.

    Args:
        path: The file.
        client: Number of the client, which its rows get.
    """

    def __init__(self, path: Path, client: int) -> None:
        self.rows: list[dict[str, Any]] = []
        self._path, self._client, self._read = path, client, 0

    def read(self) -> list[dict[str, Any]]:
        """Read what was added; returns all rows."""
        with self._path.open("rb") as file:
            file.seek(self._read)
            data = file.read()
        whole = data.rfind(b"\n") + 1
        self._read += whole
        self.rows += [json.loads(line) | {"client": self._client} for line in data[:whole].splitlines()]
        return self.rows


def leases(rows: Sequence[dict[str, Any]], cuts: Sequence[Span] = ()) -> list[Span]:
    """Times in which somebody had a lease, as far as the holders themselves can say.

    A message that was answered was heard in between, and the lease lasts `TIMEOUT` from there. One without an
    answer may have been heard, but not if it was sent in a cut.

    Args:
        rows: The logs of all clients.
        cuts: Times in which nothing that was sent could be heard, so that what arrives afterwards is too late.
    """
    answers = {(row["client"], row["n"]): row for row in rows if row["e"] == "answered"}
    spans: list[Span] = []
    until: dict[int, float] = {}
    for row in rows:
        if row["e"] != "sent" or row["what"] == "StopRequest":
            continue
        answer = answers.get((row["client"], row["n"]))
        if answer is not None and answer["refused"]:
            continue
        if answer is None and any(begin <= row["t"] <= end for begin, end in cuts):
            continue
        heard = answer["t"] if answer is not None else row["t"] + row["wait"]
        end = heard + TIMEOUT
        until[row["client"]] = max(until.get(row["client"], -math.inf), heard + row["duration"])
        if row["what"] == "Leave":
            end = until[row["client"]] if row["finish"] else heard
        spans.append((row["t"], max(end, heard)))
    return spans


def stops(rows: Sequence[dict[str, Any]]) -> list[Span]:
    """Times from a confirmed stop to the next resume that was sent."""
    answers = {(row["client"], row["n"]): row for row in rows if row["e"] == "answered"}
    resumes = sorted(row["t"] for row in rows if row["e"] == "sent" and row["what"] == "Resume")
    spans = []
    for row in rows:
        if row["e"] == "sent" and row["what"] == "StopRequest":
            answer = answers.get((row["client"], row["n"]))
            if answer is not None and not answer["refused"]:
                # One that was sent before the confirmation may have come after the stop.
                spans.append((answer["t"], next((time for time in resumes if time > row["t"]), math.inf)))
    return spans


def gaps(spans: Iterable[Span], begin: float, end: float) -> list[Span]:
    """Times between `begin` and `end` that no span covers."""
    found, at = [], begin
    for first, last in sorted(spans):
        if first > at:
            found.append((at, min(first, end)))
        at = max(at, last)
        if at >= end:
            return found
    return [*found, (at, end)]


def moved(servos: dict[int, Servo], begin: float, end: float) -> str:
    """What moved in a time, in words; empty if nothing did."""
    if end <= begin:
        return ""
    for number, servo in servos.items():
        rows = servo.between(begin, end)
        targets = {servo.targets[i] for i in rows if servo.driven[i]}
        low, high = servo.had(begin, end)
        if len(targets) > 1 or high - low > STILL:
            return f"servo {number} had targets {sorted(targets)} and positions {low:.1f} to {high:.1f}"
    return ""


def violations(
    servos: dict[int, Servo],
    rows: Sequence[dict[str, Any]],
    end: float,
    cuts: Sequence[Span] = (),
    others: Sequence[Span] = (),
    since: float = -math.inf,
) -> list[str]:
    """What contradicts a promise: nothing moves without a lease, nothing moves after a stop before a resume, and
    nobody reads a position that the servo has not had since the time that its age gives.

    Args:
        servos: The log of the board.
        rows: The logs of all its clients.
        end: When the last look was taken.
        cuts: As for `leases`.
        others: Times in which clients may read another board, which was started under the same name.
        since: States that arrived before were checked already.
    """
    found = []
    begin = min((servo.times[0] for servo in servos.values()), default=end)
    without = gaps(((first, last + HOLD) for first, last in leases(rows, cuts)), begin, end)
    for name, spans in (
        ("without a lease", without),
        ("after a stop", [(first + SETTLING, min(last, end)) for first, last in stops(rows)]),
    ):
        for first, last in spans:
            if what := moved(servos, first, last):
                found.append(f"{name}, from {first - begin:.2f} to {last - begin:.2f} s: {what}")
    for row in rows:
        if row["t"] <= since:
            continue
        if row["e"] == "state" and row["stamp"] > begin and abs(row["booted"] - begin) > SAME:
            if not any(first <= row["t"] <= last for first, last in others):
                found.append(f"at {row['t'] - begin:.2f} s client {row['client']} read another board")
        elif row["e"] == "state":
            for number, counts, age in zip(row["ids"], row["counts"], row["age"], strict=True):
                earliest = row["stamp"] - age - LATE - row.get("doubt", 0.0)
                low, high = servos[number].may_have_had(earliest, row["t"])
                if math.isfinite(counts) and not low - ROUNDING <= counts <= high + ROUNDING:
                    since = row["t"] - row["stamp"] + age
                    found.append(
                        f"at {row['t'] - begin:.2f} s client {row['client']} read {counts:.1f} of servo {number}, "
                        f"which had {low:.1f} to {high:.1f} since {since:.3f} s before"
                    )
    return found
