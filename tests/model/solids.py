"""What the tests of shapes share: which solids touch, and poses within the limits."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping

import coal
import numpy as np

from hexwire.model.pose import Pose
from hexwire.model.shapes import ArmShapes, Shape

TOUCH = 0.0003
"""Solids closer than this touch, metres."""


def body(shape: Shape) -> coal.ShapeBase:
    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    return coal.Sphere(*shape.size)


def placed(shapes: ArmShapes, positions: Mapping[str, float]) -> list[tuple[str, Shape, coal.CollisionObject]]:
    """Link, shape and solid of every shape of an arm."""
    return [(link.name, shape, _solid(shape, pose)) for link, shape, pose in shapes.placed(positions)]


def _solid(shape: Shape, pose: Pose) -> coal.CollisionObject:
    return coal.CollisionObject(body(shape), np.array(pose.rotation), np.array(pose.position))


def distance(a: coal.CollisionObject, b: coal.CollisionObject) -> float:
    """Metres between two solids; 0 or less if they touch."""
    return float(coal.distance(a, b, coal.DistanceRequest(), coal.DistanceResult()))


def loose(shapes: ArmShapes, positions: Mapping[str, float]) -> set[str]:
    """Names of the solids, as link/shape, that nothing connects with the first one."""
    solids = placed(shapes, positions)
    left = set(range(1, len(solids)))
    found = [0]
    while found:
        here = solids[found.pop()][2]
        touched = {i for i in left if distance(here, solids[i][2]) < TOUCH}
        left -= touched
        found += touched
    return {f"{solids[i][0]}/{solids[i][1].name}" for i in left}


def positions_within(shapes: ArmShapes, seed: int, count: int) -> Iterator[dict[str, float]]:
    """All joints at 0, then anywhere within their limits."""
    rng = random.Random(seed)
    limits = {joint.name: joint.limits for joint in shapes.joints if joint.name in shapes.driven}
    yield dict.fromkeys(limits, 0.0)
    for _ in range(count):
        yield {name: rng.uniform(low, high) for name, (low, high, _) in limits.items()}
