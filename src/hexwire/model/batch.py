"""Kinematics of many poses at once: the same formulas over arrays.

Owns the vectorised implementation, which needs numpy, and the plain one, which does not. Each call chooses between
them; both give the same numbers except for rounding. Knows only the formulas of the arms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from .arms.puma260 import links as puma260_links
from .kinematics import KinematicModel, numpy_or_none
from .pose import Pose

if TYPE_CHECKING:
    from .arms.hex7bot.links import LinkSet

__all__ = ["hex7bot_forward_many", "hex7bot_inverse_many", "puma260_forward_many", "puma260_inverse_many"]

_BRANCHES = 8


def _forward_one_by_one(model: KinematicModel, angles: Iterable[Sequence[float]]) -> tuple[Any, Any]:
    poses = [model.forward(row) for row in angles]
    return [list(p.position) for p in poses], [[list(row) for row in p.rotation] for p in poses]


def _inverse_one_by_one(model: KinematicModel, positions: Any, rotations: Any) -> list[list[list[float]]]:
    table = []
    for position, rotation in zip(positions, rotations, strict=True):
        solutions = model.inverse(Pose(tuple(position), tuple(tuple(row) for row in rotation)))  # type: ignore[arg-type]  # three each
        rows = [[math.remainder(a, math.tau) for a in s.angles] for s in solutions]
        table.append(rows + [[math.nan] * 6] * (_BRANCHES - len(rows)))
    return table


def _rotation_zy(np: Any, about_z: Any, about_y: Any) -> Any:
    """Rz Ry as an array (N, 3, 3)."""
    cz, sz, cy, sy = np.cos(about_z), np.sin(about_z), np.cos(about_y), np.sin(about_y)
    zero = np.zeros_like(cz)
    return np.stack(
        [
            np.stack([cz * cy, -sz, cz * sy], -1),
            np.stack([sz * cy, cz, sz * sy], -1),
            np.stack([-sy, zero, cy], -1),
        ],
        -2,
    )


def _turn(np: Any, axis: int, angle: Any) -> Any:
    """Rotations about one axis as an array (N, 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    m = np.zeros((*c.shape, 3, 3))
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    m[..., axis, axis] = 1.0
    m[..., i, i] = m[..., j, j] = c
    m[..., i, j], m[..., j, i] = -s, s
    return m


def hex7bot_forward_many(model: KinematicModel, k: LinkSet, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
    """Positions and rotations of the tip at servo angles (N, 6)."""
    np = numpy_or_none()
    if np is None:
        return _forward_one_by_one(model, angles)
    t0, t1, t2, t3, t4, t5 = np.moveaxis(np.asarray(angles, float).reshape(-1, 6), 1, 0)
    p = t2 - k.offset
    rho = k.d + k.a * np.cos(t1) + k.h * np.sin(p) + k.c * np.cos(p)
    wrist = np.stack(
        [rho * np.cos(t0), rho * np.sin(t0), k.e + k.a * np.sin(t1) + k.h * np.cos(p) - k.c * np.sin(p)], -1
    )
    rotation = _rotation_zy(np, t0, p) @ _turn(np, 0, math.pi / 2 - t3) @ _turn(np, 1, t4) @ _turn(np, 2, -t5)
    return wrist + k.f * rotation[..., 2], rotation


def hex7bot_inverse_many(model: KinematicModel, k: LinkSet, positions: Any, rotations: Any) -> Any:
    """Servo angles (N, 8, 6) of tip poses."""
    np = numpy_or_none()
    if np is None:
        return _inverse_one_by_one(model, positions, rotations)
    rotation = np.asarray(rotations, float).reshape(-1, 3, 3)
    x, y, z = np.moveaxis(np.asarray(positions, float).reshape(-1, 3) - k.f * rotation[..., 2], 1, 0)
    from_axis, long = np.hypot(x, y), k.forearm
    heading = np.where(from_axis < 1e-12, math.pi / 2, np.arctan2(y, x))
    table = np.full((len(x), _BRANCHES, 6), math.nan)
    branch = 0
    with np.errstate(invalid="ignore", divide="ignore"):
        for facing, sign in ((0.0, 1.0), (math.pi, -1.0)):
            r, s, t0 = sign * from_axis - k.d, z - k.e, heading + facing
            square = r * r + s * s
            elbow = _arc_cosine(np, (k.a**2 + long**2 - square) / (2 * k.a * long))
            shoulder = _arc_cosine(np, (k.a**2 + square - long**2) / (2 * k.a * np.sqrt(square)))
            for side in (1.0, -1.0):
                t1 = np.arctan2(s, r) + side * shoulder
                p = k.forearm_angle - t1 + side * (math.pi - elbow)
                m = np.swapaxes(_rotation_zy(np, t0, p), -1, -2) @ rotation
                off = np.hypot(m[..., 1, 2], m[..., 2, 2])
                singular = off < 1e-12
                for wrist in (1.0, -1.0):
                    t4 = np.arctan2(m[..., 0, 2], wrist * off)
                    roll = np.where(singular, 0.0, np.arctan2(-wrist * m[..., 1, 2], wrist * m[..., 2, 2]))
                    turn = np.where(
                        singular,
                        np.arctan2(m[..., 1, 0], m[..., 1, 1]),
                        np.arctan2(-wrist * m[..., 0, 1], wrist * m[..., 0, 0]),
                    )
                    table[:, branch] = np.stack([t0, t1, p + k.offset, math.pi / 2 - roll, t4, -turn], -1)
                    # A singular wrist has one solution, not two; and a row is complete or all NaN.
                    table[np.isnan(table[:, branch]).any(-1) | (singular & (wrist < 0)), branch] = math.nan
                    branch += 1
    return np.arctan2(np.sin(table), np.cos(table))


def puma260_forward_many(model: KinematicModel, angles: Sequence[Sequence[float]]) -> tuple[Any, Any]:
    """Positions and rotations of the flange at joint angles (N, 6)."""
    np = numpy_or_none()
    if np is None:
        return _forward_one_by_one(model, angles)
    k = puma260_links
    q1, q2, q3, q4, q5, q6 = np.moveaxis(np.asarray(angles, float).reshape(-1, 6), 1, 0)
    ahead = k.UPPER * np.cos(q2) + k.DROP * np.sin(q2) - k.FOREARM * np.sin(q2 + q3)
    up = k.SHOULDER - k.UPPER * np.sin(q2) + k.DROP * np.cos(q2) - k.FOREARM * np.cos(q2 + q3)
    c, s = np.cos(q1), np.sin(q1)
    wrist = np.stack([c * ahead - s * k.SIDE, s * ahead + c * k.SIDE, up], -1)
    rotation = _rotation_zy(np, q1, q2 + q3) @ _turn(np, 2, q4) @ _turn(np, 1, q5) @ _turn(np, 0, q6)
    return wrist + k.FLANGE * rotation[..., 0], rotation


def puma260_inverse_many(model: KinematicModel, positions: Any, rotations: Any) -> Any:
    """Joint angles (N, 8, 6) of flange poses."""
    np = numpy_or_none()
    if np is None:
        return _inverse_one_by_one(model, positions, rotations)
    k = puma260_links
    rotation = np.asarray(rotations, float).reshape(-1, 3, 3)
    x, y, z = np.moveaxis(np.asarray(positions, float).reshape(-1, 3) - k.FLANGE * rotation[..., 0], 1, 0)
    upper, lean = math.hypot(k.UPPER, k.DROP), math.atan2(k.DROP, k.UPPER)
    up = z - k.SHOULDER
    table = np.full((len(x), _BRANCHES, 6), math.nan)
    branch = 0
    with np.errstate(invalid="ignore", divide="ignore"):
        square = x * x + y * y - k.SIDE**2
        # As for one pose: rounding may put the wrist inside the distance that the shoulder is set aside.
        away = np.sqrt(np.where(square < -1e-15, math.nan, np.maximum(square, 0.0)))
        for ahead in (away, -away):
            q1 = np.arctan2(y, x) - np.arctan2(k.SIDE, ahead)
            elbow = _arc_cosine(np, (upper**2 + k.FOREARM**2 - ahead**2 - up**2) / (2 * upper * k.FOREARM))
            inner = np.arctan2(k.FOREARM * np.sin(elbow), upper - k.FOREARM * np.cos(elbow))
            for bent in (1.0, -1.0):
                raised = np.arctan2(up, ahead) + bent * inner
                q2 = lean - raised
                pitch = -math.pi / 2 - raised + bent * (math.pi - elbow)
                m = np.swapaxes(_rotation_zy(np, q1, pitch), -1, -2) @ rotation
                level = np.hypot(m[..., 0, 0], m[..., 1, 0])
                singular = level < 1e-12
                for wrist in (1.0, -1.0):
                    q5 = np.arctan2(-m[..., 2, 0], wrist * level)
                    q4 = np.where(singular, 0.0, np.arctan2(wrist * m[..., 1, 0], wrist * m[..., 0, 0]))
                    q6 = np.where(
                        singular,
                        np.arctan2(-m[..., 1, 2], m[..., 1, 1]),
                        np.arctan2(wrist * m[..., 2, 1], wrist * m[..., 2, 2]),
                    )
                    table[:, branch] = np.stack([q1, q2, pitch - q2, q4, q5, q6], -1)
                    table[np.isnan(table[:, branch]).any(-1) | (singular & (wrist < 0)), branch] = math.nan
                    branch += 1
    return np.arctan2(np.sin(table), np.cos(table))


def _arc_cosine(np: Any, cosine: Any) -> Any:
    """Arc cosine that tolerates rounding just outside -1..1, and is NaN further out."""
    return np.arccos(np.where(np.abs(cosine) <= 1.0 + 1e-12, np.clip(cosine, -1.0, 1.0), math.nan))
