"""Who plays what: motions in a file, given to the arms of a fleet.

Owns the assignment, and the common time of motions that were recorded together. Must not know Zenoh or terminals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.inputs import LARGEST_DATA, read_bytes
from hexwire.motion.teach import Taught
from hexwire.motion.trajectory import Spline, Waypoint
from hexwire.motion.waypoint_file import parse_waypoints
from hexwire.trace.recording import arm_of, read_joint_states

__all__ = ["assign", "read_motions"]

_MOST_ANGLES = 8_000_000
_SPACING = 0.05
"""Seconds between two points of a recorded motion; closer ones would make the noise of a servo look fast."""
_COARSEST = 0.1
"""Greatest spacing to which a long motion is thinned out."""
_Samples = dict[str, list[tuple[float, float]]]
"""Times and positions of each joint."""
_MOST_POINTS = 9_000
"""Most points of a motion; an arm's server accepts 10,000."""


def read_motions(file: str, speed: float = 1.0) -> dict[str, Spline]:
    """The motions in a file, by the name of the arm; the empty name stands for any arm.

    Motions that were recorded together keep their times to each other.

    Args:
        file: A recording (.mcap) or waypoints (.json).
        speed: Factor of the speed.

    Raises:
        UsageError: It has no motion, or one that is too long.
        ConfigError: It cannot be read, or is wrong.
    """
    if file.lower().endswith(".json"):
        return {"": _scaled(parse_waypoints(read_bytes(file, largest=LARGEST_DATA), file), speed)}
    arms: dict[str, _Samples] = {}
    angles = 0
    for state in read_joint_states(file, whole=True, several=True):
        angles += len(state.position)
        if angles > _MOST_ANGLES:
            raise UsageError(f"{file} has more than {_MOST_ANGLES} angles: too many for one motion")
        joints = arms.setdefault(arm_of(state.topic), {})
        for name, angle, values in zip(state.names, state.position, state.values, strict=True):
            # Its own time: a board asks its joints one after the other.
            when, column = state.time - values.get("age", 0.0), joints.setdefault(name, [])
            if not column or when > column[-1][0]:
                column.append((when, angle))
    arms = {arm: joints for arm, joints in arms.items() if joints}
    if not arms:
        raise UsageError(f"{file} has no joint states")
    begin = min(column[0][0] for joints in arms.values() for column in joints.values())
    try:
        return {arm: _motion(joints, begin, speed) for arm, joints in arms.items()}
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from None


def assign(
    motions: Mapping[str, Spline], file: str, arms: Sequence[str], pairs: Mapping[str, str] | None = None
) -> dict[str, Spline]:
    """Assign motions to arms.

    Args:
        motions: From `read_motions`.
        file: Their file, for error texts.
        arms: Names of the arms to move.
        pairs: Arm -> name in the file, where they differ.

    Raises:
        UsageError: There is no motion for an arm; the text says for which.
    """
    pairs = pairs or {}
    given: dict[str, Spline] = {}
    missing = []
    for arm in arms:
        wanted = pairs.get(arm, arm)
        if wanted in motions:
            given[arm] = motions[wanted]
        elif "" in motions and arm not in pairs:
            given[arm] = motions[""]
        else:
            missing.append(arm if wanted == arm else f"{arm} (as {wanted})")
    if missing:
        known = ", ".join(sorted(motions))
        raise UsageError(
            f"{Path(file).name} has no motion for {', '.join(missing)}, but for {known}; give it one with "
            f"--map {sorted(motions)[0]}={missing[0].partition(' ')[0]}"
        )
    return given


def _motion(joints: _Samples, begin: float, speed: float) -> Spline:
    """The motion of one arm; an arm that was recorded later waits at its first position."""
    duration = max(column[-1][0] for column in joints.values()) - begin
    spacing = max(_SPACING * speed, duration / _MOST_POINTS)
    if spacing > _COARSEST * max(speed, 1.0):
        raise UsageError(
            f"the recording lasts {duration:.0f} s, and {_MOST_POINTS * _COARSEST:.0f} s of one can be played"
        )
    count = max(1, math.ceil(duration / spacing))
    times = [duration * i / count for i in range(count + 1)]
    columns = [_at(column, begin, times) for column in joints.values()]
    taught = Taught(tuple(joints), tuple(times), tuple(zip(*columns, strict=True)))
    return taught.faster(speed).trajectory()


def _at(column: Sequence[tuple[float, float]], begin: float, times: Sequence[float]) -> list[float]:
    """A joint's positions at some times, interpolated; before the first sample it rests, and after the last."""
    found, i = [], 0
    for t in times:
        while i < len(column) - 1 and column[i + 1][0] <= begin + t:
            i += 1
        when, angle = column[i]
        if i < len(column) - 1 and begin + t > when:
            after, there = column[i + 1]
            angle += (there - angle) * (begin + t - when) / (after - when)
        found.append(angle)
    return found


def _scaled(path: Spline, speed: float) -> Spline:
    points = []
    for p in path.waypoints:
        velocity = None if p.velocity is None else tuple(speed * v for v in p.velocity)
        acceleration = None if p.acceleration is None else tuple(speed * speed * a for a in p.acceleration)
        points.append(Waypoint(p.time / speed, p.position, velocity, acceleration))
    return Spline(path.names, points)
