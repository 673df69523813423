"""Which pairs of links MoveIt need not check against each other, and why.

Owns the table of sampled pairs, `collisions.toml`, and what is chosen from it. It was written by
`tests/ros2/package/sample_collisions.py`, since only the tests have a library that knows whether two solids touch.
Must not know the format of an SRDF.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import combinations

from hexwire.model.shapes import ArmShapes

from .arms import PackageArm

__all__ = ["SAMPLED", "IdlePair", "adjacent_pairs", "idle_pairs", "table_key"]

SAMPLED = ("Always", "Default", "Never")
"""Reasons that sampling finds, by MoveIt's names: the two touch in every posture, in the arm's home, in none."""
_FILE = "collisions.toml"


@dataclass(frozen=True, slots=True)
class IdlePair:
    """Two links that are not checked against each other.

    Attributes:
        first: Name of a link.
        second: Name of another, behind it in the alphabet.
        reason: ``Adjacent`` or one of `SAMPLED`.
    """

    first: str
    second: str
    reason: str


def idle_pairs(arm: PackageArm) -> tuple[IdlePair, ...]:
    """The pairs of an arm, sorted.

    Of a link set that is nobody's but the user's, no pair counts as one that never touches: it was not sampled. Of
    an arm of which no link set was sampled, only neighbours count.
    """
    table = _table()
    near = adjacent_pairs(arm.shapes)
    reasons = dict.fromkeys(near, "Adjacent")
    found = table.get(table_key(arm.name, arm.links))
    if found is None:
        others = [rows for key, rows in table.items() if key.split(".")[0] == arm.name]
        found = {
            reason: frozenset.intersection(*(rows[reason] for rows in others))
            for reason in ("Always", "Default")
            if others
        }
    for reason in SAMPLED:
        for pair in found.get(reason, ()):
            reasons.setdefault(pair, reason)
    return tuple(IdlePair(*pair, reason) for pair, reason in sorted(reasons.items()))


def table_key(robot: str, links: str) -> str:
    """Name of an arm's table in the file: `robot`, or `robot`.`links` if it has link sets."""
    return f"{robot}.{links}" if links else robot


def adjacent_pairs(shapes: ArmShapes) -> frozenset[tuple[str, str]]:
    """Links that a joint connects, and those with only frames between them: these have nothing that could touch."""
    solid = {link.name for link in shapes.links if any(shape.solid for shape in link.shapes)}
    near: dict[str, set[str]] = {link.name: set() for link in shapes.links}
    for joint in shapes.joints:
        near[joint.parent].add(joint.child)
        near[joint.child].add(joint.parent)
    for frame in near.keys() - solid:
        for one, other in combinations(near[frame], 2):
            near[one].add(other)
            near[other].add(one)
    return frozenset((min(one, other), max(one, other)) for one in solid for other in near[one] if other in solid)


@cache
def _table() -> Mapping[str, Mapping[str, frozenset[tuple[str, str]]]]:
    rows = tomllib.loads((resources.files(__package__) / _FILE).read_text(encoding="utf-8"))
    return {
        name: {reason: frozenset((one, other) for one, other in pairs) for reason, pairs in reasons.items()}
        for name, reasons in rows.items()
    }
