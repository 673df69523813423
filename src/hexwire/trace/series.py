"""Joint states as columns of numbers, one for each quantity of each joint: for plots and tables.

Owns the columns, filling them from a recording within bounds, and writing rows as CSV or MCAP.
"""

from __future__ import annotations

import csv
import io
import math
import time
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING

from hexwire.errors import ConfigError, UsageError
from hexwire.model.state import JointState

from .recording import RecordedJoints, RecordingWriter, joint_states_in

if TYPE_CHECKING:
    from .mcap_file import Readable

__all__ = ["QUANTITIES", "PlotSeries", "TimedFile", "column_name", "read_series", "write_csv", "write_mcap"]

QUANTITIES = ("position", "goal", "velocity", "load", "current", "voltage", "temperature")
"""Numbers of a joint that a recording may have, in SI units."""
_MOST_NUMBERS = 20_000_000
"""Numbers in all columns: 80 MB."""
_MOST_JOINTS = 64
"""Joints of a recording to plot."""

Row = tuple[float, Sequence[float]]
"""Seconds, and a value for each column."""


class TimedFile:
    """A file that can be read for a limited time only: a hostile file must not keep a thread busy for hours.

    Args:
        file: Open for reading bytes.
        name: Its name in errors.
        seconds: From now on.
        clock: Monotonic seconds.
    """

    def __init__(
        self, file: Readable, name: str, seconds: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._file, self._name, self._clock, self._seconds = file, name, clock, seconds
        self._end = clock() + seconds

    def read(self, size: int = -1, /) -> bytes:
        """Read at most `size` bytes.

        Raises:
            ConfigError: The time is over.
        """
        if self._clock() > self._end:
            raise ConfigError(f"takes more than {self._seconds:g} s to read", file=self._name)
        return self._file.read(size)


@dataclass(slots=True)
class PlotSeries:
    """Columns of a recording.

    Attributes:
        names: Joint names.
        begin: Time of the first row, seconds since 1970.
        times: Seconds from there, rising.
        columns: Values by joint and quantity, as many as times; NaN where unknown. SI units.
        problem: Why the file could not be read to its end; empty if it could.
    """

    names: tuple[str, ...]
    begin: float = 0.0
    times: array[float] = field(default_factory=lambda: array("d"))
    columns: dict[tuple[str, str], array[float]] = field(default_factory=dict)
    problem: str = ""

    @property
    def duration(self) -> float:
        """Seconds from the first to the last row."""
        return self.times[-1] if self.times else 0.0

    def positions(self, names: Sequence[str] | None = None) -> list[tuple[float, tuple[float, ...]]]:
        """Pairs of time and positions of some joints, all by default."""
        wanted = [self.columns[name, "position"] for name in names or self.names]
        return list(zip(self.times, zip(*wanted, strict=True), strict=True))

    def _add(self, state: RecordedJoints) -> None:
        if not self.times:
            self.begin = state.time
        at = state.time - self.begin
        # A clock that was set back: such rows have no place on an axis.
        if self.times and at <= self.times[-1]:
            return
        self.times.append(at)
        places = {name: i for i, name in enumerate(state.names)}
        for name in self.names:
            i = places.get(name)
            values = state.values[i] if i is not None else {}
            for quantity in QUANTITIES:
                value = values.get(quantity)
                column = self.columns.get((name, quantity))
                if column is None:
                    if value is None:
                        continue
                    # The quantity appears late.
                    column = self.columns[name, quantity] = array("f", [math.nan]) * (len(self.times) - 1)
                column.append(math.nan if value is None else _float(value))


def _float(value: float) -> float:
    """A number that 32 bits can hold."""
    return value if abs(value) < 1e30 else math.nan


def read_series(file: Readable, name: str, *, topic: str | None = None, most: int = _MOST_NUMBERS) -> PlotSeries:
    """Read the joint states of a recording; of a damaged one, those before the damage.

    Args:
        file: Open for reading bytes.
        name: Its name in errors.
        topic: Only those of this channel.
        most: Most numbers that are kept.

    Raises:
        UsageError: It is not a recording, has no joint states or those of several arms, or has too many; or the
            package ``mcap`` is not installed.
        ConfigError: A joint state is wrong, or the file cannot be read.
    """
    series: PlotSeries | None = None
    problem = ""
    for state in joint_states_in(file, name, topic=topic):
        if isinstance(state, str):
            problem = state
            continue
        if not state.names:
            continue
        if series is None:
            if len(state.names) > _MOST_JOINTS:
                raise UsageError(f"{name} has {len(state.names)} joints: too many for a plot")
            series = PlotSeries(state.names)
            for joint in state.names:
                series.columns[joint, "position"] = array("f")
        series._add(state)
        if len(series.times) * (1 + len(series.columns)) > most:
            raise UsageError(f"{name} has more than {most} numbers: too many for a plot")
    if series is None:
        raise UsageError(f"{name} has no joint states" + (f" ({problem})" if problem else ""))
    series.problem = problem
    return series


def column_name(joint: str, quantity: str) -> str:
    """Name of a column: ``joint.quantity``, or the quantity of the whole arm if there is no joint."""
    return f"{joint}.{quantity}" if joint else quantity


def write_csv(out: IO[bytes], columns: Sequence[tuple[str, str]], rows: Iterable[Row], offset: float = 0.0) -> int:
    """Write rows as CSV, as `hexwire record export` does: ``time``, then ``joint.quantity``.

    Unknown values are empty.

    Args:
        out: Open for writing bytes.
        columns: Pairs of joint (empty for the whole arm) and quantity.
        rows: The rows.
        offset: Seconds to add to their times.

    Returns:
        The number of rows.
    """
    text = io.TextIOWrapper(out, encoding="utf-8", newline="")
    writer, count = csv.writer(text), 0
    writer.writerow(["time", *(column_name(*column) for column in columns)])
    for at, values in rows:
        writer.writerow([f"{at + offset:.6f}", *(f"{v:.7g}" if math.isfinite(v) else "" for v in values)])
        count += 1
    text.flush()
    text.detach()
    return count


def write_mcap(
    path: str | Path, columns: Sequence[tuple[str, str]], rows: Iterable[Row], offset: float, *, robot: str = ""
) -> int:
    """Write rows as a recording, which `hexwire play` and other programs read.

    Args:
        path: The file; it must not exist.
        columns: Pairs of joint and quantity; those of the whole arm are left out.
        rows: The rows.
        offset: Seconds to add to their times for seconds since 1970.
        robot: Its name, noted in every message.

    Returns:
        The number of states.

    Raises:
        UsageError: The file cannot be created, or the package ``mcap`` is not installed.
    """
    names = tuple(dict.fromkeys(joint for joint, _ in columns if joint))
    places = {column: i for i, column in enumerate(columns)}

    def row_of(values: Sequence[float], quantity: str) -> tuple[float, ...] | None:
        found = [places.get((name, quantity)) for name in names]
        return None if None in found else tuple(values[i] for i in found if i is not None)

    with RecordingWriter(path) as recording:
        for at, values in rows:
            positions, goals = (row_of(values, key) or (math.nan,) * len(names) for key in ("position", "goal"))
            state = JointState.of(
                dict(zip(names, positions, strict=True)),
                stamp=at,
                torque=False,
                velocity=row_of(values, "velocity"),
                load=row_of(values, "load"),
                current=row_of(values, "current"),
                voltage=row_of(values, "voltage"),
                temperature=row_of(values, "temperature"),
            )
            wanted = dict(zip(names, goals, strict=True))
            recording.joint_state(state, at + offset, goals=wanted, extra={"robot": robot} if robot else None)
        return recording.count
