"""Records the motion of an arm guided by hand, and simplifies it to a trajectory small enough to send.

Owns the recording, its simplification and its file. Pure except for writing that file; time comes with the states.
Must not know messages, drivers or clocks.
"""

from __future__ import annotations

import json
import math
import os
import threading
from collections.abc import Sequence
from datetime import datetime
from itertools import count
from pathlib import Path

from hexwire.errors import HexwireError, UsageError
from hexwire.folders import make_folder
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.teach import Taught
from hexwire.new_file import OutputFile

from .goals import Point
from .known_state import SampleClock

__all__ = ["TOLERANCE", "Teacher", "save", "to_points", "tolerance_of"]

TOLERANCE = math.radians(0.2)
"""Radians by which a simplified trajectory may miss a sample: two counts of a servo with 4096 per turn."""

_RATE = 50
"""Samples per second: the motion of a hand has no components above 10 Hz."""
_DIGITS = 6
"""Decimals of seconds and radians that are sent and written: finer than a hundredth of a servo's count."""


class Teacher:
    """Records the states of an arm that is guided by hand, at most 50 per second.

    One thread may pass states while others start and finish the recording.

    Args:
        limit: Longest recording, seconds.

    Attributes:
        limit: As above.
        active: It is recording.
        full: The limit has been reached; what was recorded until then is kept.
    """

    def __init__(self, limit: float = 600.0) -> None:
        self.limit = limit
        self.active = False
        self.full = False
        self._names: tuple[str, ...] = ()
        self._start = 0.0
        self._clock = SampleClock()
        self._slot = -math.inf
        self._samples: list[tuple[float, tuple[float, ...]]] = []
        self._lock = threading.Lock()

    def start(self, names: Sequence[str], now: float) -> None:
        """Start a recording; the previous one is dropped.

        Args:
            names: Joints to record.
            now: The clock of the states' `stamp`; samples from before do not count.

        Raises:
            UsageError: No joint is named, or one twice.
        """
        if not names or len(set(names)) != len(names):
            raise UsageError(f"joints to teach must be named once each, not {', '.join(names) or 'none at all'}")
        with self._lock:
            self.active, self.full = True, False
            self._names = tuple(names)
            self._start = now
            self._clock, self._slot, self._samples = SampleClock(), -math.inf, []

    def take(self, state: JointState) -> None:
        """Take a state; harmless when not recording. A state that lacks one of the joints is skipped.

        Its time is that of its newest sample. Of several states within a fiftieth of a second the first is kept.
        """
        # Another thread may start or finish the recording meanwhile.
        with self._lock:
            if self.active and not self.full:
                self._take(state)

    def _take(self, state: JointState) -> None:
        when = self._clock.time(state)
        if state.stamp - self._start > self.limit:
            self.full = True
            return
        try:
            places = [state.names.index(name) for name in self._names]
        except ValueError:
            return
        row = tuple([state.position[i] for i in places])
        ages = [state.age[i] for i in places]
        if any(state.flags[i] & JointFlag.SILENT for i in places) or not all(map(math.isfinite, (*row, *ages))):
            return
        age = min(ages)
        if state.stamp - age < self._start:
            return
        slot = math.floor((when - age) * _RATE)
        if slot > self._slot:
            self._slot = slot
            self._samples.append((when - age, row))

    def finish(self) -> Taught:
        """End the recording.

        Returns:
            The unchanged recording: smooth it, play it, or simplify it with `to_points`.

        Raises:
            UsageError: Fewer than two samples.
        """
        with self._lock:
            samples, self._samples = self._samples, []
            self.active = False
        if len(samples) < 2:
            raise UsageError(
                "nothing was recorded: start teaching, move the arm, stop teaching; every joint's servo must answer"
            )
        return Taught.of(self._names, samples)


def tolerance_of(model: ArmModel) -> float:
    """Tolerance for an arm, radians: more for servos with coarse counts, whose noise would otherwise be kept."""
    return max(TOLERANCE, 1.2 * max((joint.scale for joint in model.joints), default=0.0))


def to_points(taught: Taught, tolerance: float = TOLERANCE) -> tuple[Point, ...]:
    """Points of a trajectory that is linear between them and misses no sample by more than `tolerance`.

    Ten minutes of samples are 30,000 points: more than a viewer or a controller's goal should have to carry, and
    most of them lie on the line between their neighbours. The points to keep are found in one pass: from the last
    point kept, each sample leaves a cone of slopes that pass it closely enough, and a sample outside a joint's cone
    means that the one before it must be kept. This takes the same time for every sample, whereas the algorithm of
    Ramer, Douglas and Peucker takes the square of their number for some motions; it keeps the same tolerance with
    slightly more points.

    The points have no velocities: through points so far apart, a cubic would swing beyond the tolerance.

    Args:
        taught: What was recorded.
        tolerance: Radians, for each joint by itself.

    Returns:
        Points with times from 0, the first and last sample among them; one for a recording of one sample.
    """
    times, rows = taught.times, taught.rows
    kept = [0]
    low, high = _open_cone(taught)
    for i in range(1, len(times)):
        # A sample right after the kept one is inside the cone, which is still open.
        anchor, start = times[kept[-1]], rows[kept[-1]]
        long = times[i] - anchor
        slopes = [(b - a) / long for a, b in zip(start, rows[i], strict=True)]
        if not all(a <= slope <= b for a, slope, b in zip(low, slopes, high, strict=True)):
            kept.append(i - 1)
            low, high = _open_cone(taught)
            long = times[i] - times[i - 1]
            slopes = [(b - a) / long for a, b in zip(rows[i - 1], rows[i], strict=True)]
        width = tolerance / long
        low = [max(a, slope - width) for a, slope in zip(low, slopes, strict=True)]
        high = [min(b, slope + width) for b, slope in zip(high, slopes, strict=True)]
    if len(times) > 1:
        kept.append(len(times) - 1)
    return tuple(
        Point(round(times[i], _DIGITS), tuple([round(value, _DIGITS) + 0.0 for value in rows[i]])) for i in kept
    )


def _open_cone(taught: Taught) -> tuple[list[float], list[float]]:
    return [-math.inf] * len(taught.names), [math.inf] * len(taught.names)


def save(taught: Taught, folder: Path, when: datetime, *, tolerance: float = TOLERANCE) -> Path:
    """Write a file that `hexwire play` takes: the points of `to_points` in the form of a joint trajectory.

    A write that fails leaves nothing behind, and no other file is overwritten.

    Args:
        taught: What was recorded.
        folder: Where to write it; created if missing.
        when: Gives the file its name, ``taught-20240131-235959.json``.
        tolerance: Of `to_points`.

    Returns:
        The file's path.

    Raises:
        HexwireError: It cannot be written.
    """
    points = [{"time_from_start": p.time, "positions": p.positions} for p in to_points(taught, tolerance)]
    text = json.dumps({"joint_names": taught.names, "points": points}, separators=(",", ":"), allow_nan=False)
    # One line per point, for readers and diff.
    text = text.replace('{"time_from_start"', '\n{"time_from_start"') + "\n"
    try:
        make_folder(folder)
        with _reserve(folder, f"taught-{when:%Y%m%d-%H%M%S}") as out:
            out.file.write(text.encode())
    except (OSError, UsageError) as error:
        raise HexwireError(
            f"what was taught cannot be saved in {folder} ({getattr(error, 'strerror', None) or error}); "
            "name a folder that this user may write to, on a disk with room"
        ) from error
    return out.path


def _reserve(folder: Path, stem: str) -> OutputFile:
    """Create a file with an unused name."""
    for i in count(1):
        path = folder / (f"{stem}.json" if i == 1 else f"{stem}-{i}.json")
        if os.path.lexists(path):
            continue
        try:
            return OutputFile(path)
        except UsageError:
            # Another program may have created it first.
            if not os.path.lexists(path):
                raise
    raise AssertionError("unreachable")
