"""Link sets of the 7Bot family: the three published ones, and those in users' files.

Owns the constants, their sources, and the joint coupling limits that keep forearm and upper arm apart. Lengths are
metres, angles radians; the public tables and the files have millimetres and degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hexwire.errors import UsageError
from hexwire.inputs import Item, parse_toml
from hexwire.model.kinematics import JointRange

__all__ = ["LINK_SETS", "ElevationLimit", "LinkSet", "link_set", "parse_link_set"]

JOINT_NAMES = ("t0", "t1", "t2", "t3", "t4", "t5")
_LENGTHS = "abcdefgh"


@dataclass(frozen=True, slots=True)
class ElevationLimit:
    """Set B's upper bound for the line from shoulder to wrist.

    Attributes:
        side: First side of the source's triangle, metres.
        forearm: Second side, metres: c + d in the source.
        maximum: Largest elevation above the horizontal, radians.
    """

    side: float
    forearm: float
    maximum: float

    def elevation(self, t1: float, elbow: float) -> float:
        """Elevation of the line as the source computes it, radians."""
        line = math.sqrt(self.side**2 + self.forearm**2 - 2 * self.side * self.forearm * math.cos(elbow))
        return t1 - math.asin(max(-1.0, min(1.0, self.forearm * math.sin(elbow) / line)))


@dataclass(frozen=True, slots=True)
class LinkSet:
    """Lengths and limits of one arm.

    Attributes:
        name: Name, such as ``A``.
        a: Upper arm.
        b: Crank that drives the forearm; its length affects neither wrist nor tip.
        c: Forearm.
        d: Shoulder axis before the base axis.
        e: Shoulder axis above the table.
        f: Wrist centre to tool tip.
        g: Tip to the side point of the tool.
        h: Forearm axis above the elbow, square to the forearm.
        offset: Servo angle t2 at which the forearm is level, radians.
        ranges: Limits of t0..t5, radians.
        elbow: Smallest and largest interior angle between upper arm and forearm: the joint coupling limit, radians.
        elevation: An additional limit, or None.
        source: Source of the numbers.
    """

    name: str
    a: float
    b: float
    c: float
    d: float
    e: float
    f: float
    g: float
    h: float
    offset: float
    ranges: tuple[JointRange, ...]
    elbow: tuple[float, float]
    elevation: ElevationLimit | None = None
    source: str = ""

    @property
    def forearm(self) -> float:
        """Elbow to wrist centre, metres."""
        return math.hypot(self.h, self.c)

    @property
    def forearm_angle(self) -> float:
        """Angle of the elbow-to-wrist line above the forearm, radians."""
        return math.atan2(self.h, self.c)

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest distance of the wrist centre from the shoulder, metres."""
        return abs(self.forearm - self.a), self.forearm + self.a

    def elbow_angle(self, t1: float, t2: float) -> float:
        """Interior angle between upper arm and forearm, radians, bounded by the joint coupling limit."""
        return math.pi + self.offset - t1 - t2


def _make(
    name: str,
    lengths: tuple[float, ...],
    offset_deg: float,
    limits_deg: tuple[tuple[float, float], ...],
    elbow_deg: tuple[float, float],
    *,
    elevation: ElevationLimit | None = None,
    source: str = "",
) -> LinkSet:
    a, b, c, d, e, f, g, h = (length / 1000 for length in lengths)
    ranges = tuple(
        JointRange(joint, math.radians(low), math.radians(high))
        for joint, (low, high) in zip(JOINT_NAMES, limits_deg, strict=True)
    )
    elbow = (math.radians(elbow_deg[0]), math.radians(elbow_deg[1]))
    return LinkSet(name, a, b, c, d, e, f, g, h, math.radians(offset_deg), ranges, elbow, elevation, source)


_MOST = 1e5
"""Millimetres or degrees beyond any arm; larger numbers in a link set are errors."""
_SHORTEST = 1e-3
_BUS_LIMITS = ((10.0, 170.0), (10.0, 180.0), (10.0, 170.0), (0.0, 180.0), (0.0, 180.0), (0.0, 360.0))
_RAD = 180 / math.pi

LINK_SETS = {
    "A": _make(
        "A",
        (120.0, 40.0, 188.0, 24.28, 79.0, 21.6, 12.0, 34.8),
        90.0,
        _BUS_LIMITS,
        # t1 + t2 < 260 deg is an interior elbow angle above 10 deg. The other end is not published for this
        # set: it is set B's, which is close to that of all versions.
        (10.0, 165.0),
        source="public 7Bot bus-servo library, the version with MyArm and Steer_Num that the chapter includes",
    ),
    "B": _make(
        "B",
        (120.0, 40.0, 159.30, 16.92, 51.75, 51.50, 8.0, 28.80),
        90.0,
        # -1..3.14, -0.8..2.79 and -1..3.14 rad; the wrist as in the other version of the same library.
        (
            (-1.0 * _RAD, 3.14 * _RAD),
            (-0.8 * _RAD, 2.79 * _RAD),
            (-1.0 * _RAD, 3.14 * _RAD),
            *_BUS_LIMITS[3:],
        ),
        (0.48 * _RAD, 2.88 * _RAD),
        elevation=ElevationLimit(0.19055, 0.17622, math.radians(78.0)),
        source="public 7Bot bus-servo library, the other published set",
    ),
    "V1": _make(
        "V1",
        (120.0, 40.0, 198.50, 30.05, 77.80, 22.10, 12.0, 29.42),
        65.0,
        ((0.0, 180.0), (0.0, 180.0), (0.0, 180.0), (10.0, 170.0), (0.0, 180.0), (0.0, 180.0)),
        # 83 <= t1 + t2 <= 227 deg with t2 level at 65 deg.
        (18.0, 162.0),
        source="7Bot-Arduino-lib, the first 7Bot",
    ),
}
"""The published link sets by name."""


def link_set(name: str) -> LinkSet:
    """A published link set by name, ignoring case.

    Raises:
        UsageError: There is no link set of this name.
    """
    found = LINK_SETS.get(name.upper())
    if found is None:
        raise UsageError(f"no link set {name!r}; use {', '.join(LINK_SETS)}, or a TOML file")
    return found


def parse_link_set(text: str, *, file: str = "") -> LinkSet:
    """A link set from a TOML file's text.

    Required are the lengths ``a`` to ``h`` in millimetres and ``offset`` in degrees; ``name``, ``limits`` (six
    pairs of degrees) and ``elbow`` (a pair of degrees) are optional and default to those of set A.

    Raises:
        ConfigError: Not TOML, a key is unknown or missing, or a value is invalid; the error has its place.
    """
    row = parse_toml(text, file).table((*_LENGTHS, "offset"), ("name", "limits", "elbow"))
    lengths = tuple(row[key].number(_SHORTEST if key in "ac" else 0.0, _MOST, "mm") for key in _LENGTHS)
    offset = row["offset"].number(-_MOST, _MOST, "deg")
    limits = tuple(map(_pair, row["limits"].rows(6, 6))) if "limits" in row else _BUS_LIMITS
    elbow = _pair(row["elbow"], 0.0, 180.0) if "elbow" in row else (10.0, 165.0)
    name = row["name"].text(100, least=1) if "name" in row else "own"
    return _make(name, lengths, offset, limits, elbow, source=file)


def _pair(item: Item, least: float = -_MOST, most: float = _MOST) -> tuple[float, float]:
    low, high = item.numbers(2, least, most, "deg")
    if low >= high:
        raise item.fault(f"must be a pair of degrees, the lower first, not {low:g} and {high:g}")
    return low, high
