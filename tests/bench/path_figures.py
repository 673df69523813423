"""What the targets on a servo line say about a motion: pure arithmetic.

Owns the time error of targets, and how far they lead from the ideal path. Must not know boards or processes.

The time error of a packet is its begin plus the board's lead, minus the time at which the ideal path has its
positions. The path's velocity v turns the distance q - p(t) of its targets from the path into time: the least
squares over the packet's joints are sum(v (q - p)) / sum(v v). Only packets in the even parts of the path count.
Targets are whole counts; `unexplained` is what is left of the error when that is taken away.
"""

from __future__ import annotations

import math
import statistics
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.path_points import path_points
from hexwire.motion.trajectory import Sample, Trajectory
from hexwire.wire.board_trajectory import POINT_TIME, PathPoint

MARGIN = 0.12
"""Seconds of even speed that must lie around a packet's time, so that the velocity there is right."""
_STEP = 0.05
"""Most seconds that a joint needs for one target."""


class Set(NamedTuple):
    """A packet of targets: when it began, and radians by joint."""

    time: float
    targets: dict[str, float]


class Spread(NamedTuple):
    """Median, 99th percentile and greatest of absolute values, and how many there are."""

    p50: float
    p99: float
    worst: float
    count: int


def spread(values: Iterable[float]) -> Spread:
    """Of absolute values."""
    row = sorted(map(abs, values))
    return Spread(row[len(row) // 2], row[math.ceil(0.99 * len(row)) - 1], row[-1], len(row))


def read_sets(packets: Iterable[tuple[float, bytes]], since: float) -> list[Set]:
    """The targets in packets of the servo line that began at a time or later."""
    found = []
    for begin, packet in packets:
        if begin < since:
            continue
        legacy, targets = packet[5] == 0x2A, {}
        for at in range(7, len(packet) - 1, packet[6] + 1):
            joint = HEX7BOT.joints[packet[at]]
            raw = packet[at + 1 : at + 3] if legacy else packet[at + 2 : at + 4]
            targets[joint.name] = joint.counts_to_angle(int.from_bytes(raw, "big" if legacy else "little"))
        found.append(Set(begin, targets))
    return found


def rounded(path: Trajectory, sets: Sequence[Set], start: float) -> list[Set]:
    """The same packets, had they been made without any error but rounding to counts."""
    found = []
    for begin, targets in sets:
        ideal = dict(zip(path.names, path.sample(begin - start).position, strict=True))
        counts = {name: HEX7BOT.joint(name) for name in targets}
        found.append(Set(begin, {n: j.counts_to_angle(j.angle_to_counts(ideal[n])) for n, j in counts.items()}))
    return found


class SentPath(Trajectory):
    """The path that a board is sent for an ideal one: its points are rounded to counts and counts per second."""

    def __init__(self, path: Trajectory) -> None:
        self.names, self.duration = path.names, path.duration
        joints = [HEX7BOT.joint(name) for name in path.names]
        self._times: list[float] = []
        self._points: list[tuple[list[float], list[float]]] = []
        for t, (position, velocity, _) in path_points(path, [joint.scale / 2.0 for joint in joints]):
            self._times.append(round(t, 4))
            self._points.append(
                (
                    [j.counts_to_angle(j.angle_to_counts(p)) for j, p in zip(joints, position, strict=True)],
                    [round(v / j.scale) * j.scale for j, v in zip(joints, velocity, strict=True)],
                )
            )

    @property
    def count(self) -> int:
        """Points."""
        return len(self._times)

    def points(self) -> list[PathPoint]:
        """As they are sent."""
        joints = [HEX7BOT.joint(name) for name in self.names]
        rows, last = [], 0
        for time, (position, velocity) in zip(self._times, self._points, strict=True):
            ticks = round(time / POINT_TIME)
            counts = [j.angle_to_counts(p) for j, p in zip(joints, position, strict=True)]
            speeds = [round(v / j.scale) for j, v in zip(joints, velocity, strict=True)]
            rows.append(PathPoint(ticks - last, tuple(counts), tuple(speeds)))
            last = ticks
        return rows

    def at(self, t: float) -> Sample:
        i = min(max(bisect_right(self._times, t) - 1, 0), len(self._times) - 2)
        step = self._times[i + 1] - self._times[i]
        u = (t - self._times[i]) / step
        position, velocity = [], []
        (starts, before), (ends, after) = self._points[i], self._points[i + 1]
        for a, v, b, w in zip(starts, before, ends, after, strict=True):
            c2, c3 = 3.0 * (b - a) - (2.0 * v + w) * step, (v + w) * step - 2.0 * (b - a)
            position.append(a + u * (v * step + u * (c2 + u * c3)))
            velocity.append(v + u * (2.0 * c2 + 3.0 * u * c3) / step)
        return Sample(tuple(position), tuple(velocity), (0.0,) * len(position))


def _even(path: Trajectory, t: float) -> bool:
    """Whether the velocity around a time is one and the same."""
    if not MARGIN < t < path.duration - MARGIN:
        return False
    here, before, after = (path.sample(t + way).velocity for way in (0.0, -MARGIN, MARGIN))
    return all(abs(a - v) < 1e-6 and abs(b - v) < 1e-6 for v, a, b in zip(here, before, after, strict=True))


def time_errors(path: Trajectory, sets: Sequence[Set], start: float) -> list[float]:
    """The time error of every packet in an even part of the path, seconds; positive is late.

    Args:
        path: The ideal path.
        sets: Packets.
        start: Time at which a packet should have the path's first position: its start, less the lead.
    """
    errors = []
    for begin, targets in sets:
        t = begin - start
        if _even(path, t):
            here = path.sample(t)
            rows = zip(path.names, here.position, here.velocity, strict=True)
            parts = [(v * (targets[n] - p), v * v) for n, p, v in rows if n in targets]
            errors.append(-sum(a for a, _ in parts) / sum(b for _, b in parts))
    return errors


def unexplained(path: Trajectory, sent: Trajectory, sets: Sequence[Set], start: float) -> list[float]:
    """What rounding targets to counts does not explain of the time error of every packet in an even part.

    A target stands for all positions within half a count, and so for a span of time. The error is the distance of
    the packet from the time that the spans of all its joints share.

    Args:
        path: The ideal path.
        sent: The path that the targets were computed from.
        sets: Packets.
        start: As in `time_errors`.
    """
    errors = []
    for begin, targets in sets:
        t = begin - start
        if not _even(path, t):
            continue
        here = sent.sample(t)
        spans = []
        for name, p, v in zip(path.names, here.position, here.velocity, strict=True):
            if name in targets:
                middle, half = (p - targets[name]) / v, abs(HEX7BOT.joint(name).scale / 2.0 / v)
                spans.append((middle - half, middle + half))
        low, high = max(a for a, _ in spans), min(b for _, b in spans)
        # Where they share none, their rounding is not all: its middle is the estimate.
        errors.append((low + high) / 2.0 if low > high else max(low, min(high, 0.0)))
    return errors


def best_start(path: Trajectory, sets: Sequence[Set], near: float) -> float:
    """The start for which the median of the time errors is 0.

    Args:
        path: The ideal path.
        sets: Packets.
        near: The start, to within half a second.
    """

    def distance(start: float) -> float:
        return statistics.fmean(
            min(abs(path.sample(s.time - start).position[path.names.index(n)] - q), 0.2)
            for s in sets[::5]
            for n, q in s.targets.items()
            if n in path.names
        )

    start = min((near + 0.01 * i for i in range(-60, 61)), key=distance)
    for _ in range(3):
        if errors := time_errors(path, sets, start):
            start += statistics.median(errors)
    return start


def told(sets: Sequence[Set], names: Sequence[str]) -> Callable[[float], list[float]]:
    """What the joints are told for a time, on the time axis of the packets: even between two targets of a joint."""
    rows = {n: [(s.time, s.targets[n]) for s in sets if n in s.targets] for n in names}
    times = {n: [time for time, _ in row] for n, row in rows.items()}

    def at(t: float) -> list[float]:
        found = []
        for name in names:
            row, i = rows[name], bisect_right(times[name], t)
            if i in (0, len(row)):
                found.append(row[min(i, len(row) - 1)][1])
                continue
            (a, p), (b, q) = row[i - 1], row[i]
            # After a pause the joint has long been where it was told, and holds.
            a = max(a, b - _STEP)
            found.append(p + (q - p) * max(0.0, t - a) / (b - a))
        return found

    return at


def path_error(path: Trajectory, sets: Sequence[Set], start: float) -> float:
    """Greatest distance of a joint from where the ideal path is at that time, radians; every 2 ms."""
    at = told(sets, path.names)
    worst = 0.0
    for i in range(int(path.duration / 0.002)):
        ideal = path.sample(0.002 * i).position
        worst = max(worst, *(abs(a - b) for a, b in zip(at(start + 0.002 * i), ideal, strict=True)))
    return worst


def longest_pause(sets: Sequence[Set], start: float, end: float) -> float:
    """Most seconds between two packets of the legacy servos, in a part of the time."""
    times = [s.time for s in sets if "J1" in s.targets and start <= s.time <= end]
    return max((b - a for a, b in pairwise(times)), default=math.inf)


def distance_from_line(
    tip: Callable[[dict[str, float]], Sequence[float]],
    sets: Sequence[Set],
    names: Sequence[str],
    ends: tuple[Sequence[float], Sequence[float]],
) -> float:
    """Greatest distance of the tip from a straight line, metres, of what the joints are told; every 2 ms."""
    at = told(sets, names)
    a, b = ends
    way = [q - p for p, q in zip(a, b, strict=True)]
    length = math.hypot(*way)
    worst, t = 0.0, sets[0].time
    while t <= sets[-1].time:
        off = [q - p for p, q in zip(a, tip(dict(zip(names, at(t), strict=True))), strict=True)]
        along = sum(x * y for x, y in zip(off, way, strict=True)) / length
        worst = max(worst, math.hypot(*(x - along * y / length for x, y in zip(off, way, strict=True))))
        t += 0.002
    return worst
