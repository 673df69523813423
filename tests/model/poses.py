"""What the tests of kinematics share: published poses, random poses, distances."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path
from typing import Any

from hexwire.model.arms.hex7bot.links import LinkSet
from hexwire.model.arms.puma260.links import DROP, FOREARM, UPPER
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose

VECTORS: dict[str, Any] = json.loads(
    (Path(__file__).resolve().parents[2] / "vectors" / "arm.json").read_text(encoding="utf-8")
)


def rad(degrees: list[float]) -> tuple[float, ...]:
    return tuple(math.radians(d) for d in degrees)


def random_angles(seed: int, n: int) -> list[tuple[float, ...]]:
    """Every joint anywhere in its turn: the whole workspace, every branch."""
    rng = random.Random(seed)
    return [tuple(rng.uniform(-math.pi, math.pi) for _ in range(6)) for _ in range(n)]


def hex7bot_edges(k: LinkSet, n: int) -> list[tuple[float, ...]]:
    """At the edge of what the links reach, where rounding may put the wrist outside: stretched, and folded."""
    straight = k.offset + k.forearm_angle
    return [
        (t0, t1, straight - t1 + turn, *others)
        for t0, t1, _, *others in random_angles(6, n)
        for turn in (0.0, math.pi)
    ]


def puma260_edges(n: int) -> list[tuple[float, ...]]:
    """As `hex7bot_edges`; and with the wrist as near to the base axis as the shoulder is set aside."""
    straight = math.pi / 2 - math.atan2(DROP, UPPER)
    return [
        (q1, q2, q3, *others)
        for q1, q2, _, *others in random_angles(6, n)
        for q3 in (
            straight,
            straight - math.pi,
            math.asin((UPPER * math.cos(q2) + DROP * math.sin(q2)) / FOREARM) - q2,
        )
    ]


def turn_error(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return max(abs(math.remainder(x - y, math.tau)) for x, y in zip(a, b, strict=True))


def pose_error(a: Pose, b: Pose) -> float:
    """Largest difference of any number of two poses."""
    place = max(abs(x - y) for x, y in zip(a.position, b.position, strict=True))
    turn = max(abs(x - y) for r, s in zip(a.rotation, b.rotation, strict=True) for x, y in zip(r, s, strict=True))
    return max(place, turn)


def check_jacobian(model: KinematicModel, angles: tuple[float, ...]) -> None:
    """Compare the Jacobian with differences of `forward`."""
    rows = model.jacobian(angles)
    here, step = model.forward(angles).rotation, 1e-6
    for j in range(len(angles)):
        up = model.forward([a + step * (i == j) for i, a in enumerate(angles)])
        down = model.forward([a - step * (i == j) for i, a in enumerate(angles)])
        for i in range(3):
            assert abs(rows[i][j] - (up.position[i] - down.position[i]) / (2 * step)) < 1e-8
        change = [[(up.rotation[r][c] - down.rotation[r][c]) / (2 * step) for c in range(3)] for r in range(3)]
        spin = [[sum(change[r][k] * here[c][k] for k in range(3)) for c in range(3)] for r in range(3)]
        for i, value in enumerate((spin[2][1], spin[0][2], spin[1][0])):
            assert abs(rows[3 + i][j] - value) < 1e-8


def determinant(rows: tuple[tuple[float, ...], ...]) -> float:
    """By elimination."""
    m, det = [list(row) for row in rows], 1.0
    for i in range(len(m)):
        pivot = max(range(i, len(m)), key=lambda r: abs(m[r][i]))
        if m[pivot][i] == 0:
            return 0.0
        if pivot != i:
            m[i], m[pivot], det = m[pivot], m[i], -det
        det *= m[i][i]
        for r in range(i + 1, len(m)):
            k = m[r][i] / m[i][i]
            m[r] = [x - k * y for x, y in zip(m[r], m[i], strict=True)]
    return det
