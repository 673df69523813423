"""Vectors, rotation matrices and poses.

Owns this algebra in plain tuples, so that kinematics need no numpy. Must not know arms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import UsageError

__all__ = [
    "IDENTITY",
    "Matrix",
    "Pose",
    "Vector",
    "apply",
    "column",
    "cross",
    "multiply",
    "quaternion",
    "rotation_about",
    "rotation_between",
    "rotation_from_numbers",
    "rotation_from_rpy",
    "rotation_x",
    "rotation_y",
    "rotation_z",
    "shifted",
    "slerp",
    "transpose",
]

Vector = tuple[float, float, float]
"""x, y, z."""
Matrix = tuple[Vector, Vector, Vector]
"""A rotation matrix, row by row."""

IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Pose:
    """A position and an orientation in the frame of the arm's base.

    Attributes:
        position: x, y, z in metres.
        rotation: Rotation matrix, row by row; its columns are the axes of the body.
    """

    position: Vector
    rotation: Matrix = IDENTITY


def rotation_x(angle: float) -> Matrix:
    """Rotation about x by an angle in radians."""
    c, s = math.cos(angle), math.sin(angle)
    return ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))


def rotation_y(angle: float) -> Matrix:
    """Rotation about y by an angle in radians."""
    c, s = math.cos(angle), math.sin(angle)
    return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))


def rotation_z(angle: float) -> Matrix:
    """Rotation about z by an angle in radians."""
    c, s = math.cos(angle), math.sin(angle)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def multiply(first: Matrix, *others: Matrix) -> Matrix:
    """Product of rotations, left to right."""
    for m in others:
        a, b, c = m
        first = (
            _row(first[0], a, b, c),
            _row(first[1], a, b, c),
            _row(first[2], a, b, c),
        )
    return first


def _row(r: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    x, y, z = r
    return (x * a[0] + y * b[0] + z * c[0], x * a[1] + y * b[1] + z * c[1], x * a[2] + y * b[2] + z * c[2])


def transpose(m: Matrix) -> Matrix:
    """Transpose; of a rotation, its inverse."""
    (a, b, c), (d, e, f), (g, h, i) = m
    return ((a, d, g), (b, e, h), (c, f, i))


def apply(m: Matrix, v: Sequence[float]) -> Vector:
    """A rotation applied to a vector."""
    x, y, z = v
    return (
        m[0][0] * x + m[0][1] * y + m[0][2] * z,
        m[1][0] * x + m[1][1] * y + m[1][2] * z,
        m[2][0] * x + m[2][1] * y + m[2][2] * z,
    )


def column(m: Matrix, i: int) -> Vector:
    """Column of a matrix, from 0; of a rotation, an axis of the body."""
    return (m[0][i], m[1][i], m[2][i])


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    """Scalar product of two vectors of one length."""
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    """Cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def shifted(place: Sequence[float], direction: Sequence[float], length: float) -> Vector:
    """The place so many times a vector further."""
    return (
        place[0] + length * direction[0],
        place[1] + length * direction[1],
        place[2] + length * direction[2],
    )


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> Matrix:
    """Rotation of roll about x, then pitch about y, then yaw about z, all fixed axes, as URDF has it; radians."""
    return multiply(rotation_z(yaw), rotation_y(pitch), rotation_x(roll))


def rotation_from_numbers(numbers: Sequence[float]) -> Matrix:
    """A rotation from nine numbers, row by row, made exactly orthogonal.

    Raises:
        UsageError: Not nine numbers, or off a rotation by more than a hundredth, for example after a typing error.
    """
    if len(numbers) != 9 or not all(math.isfinite(n) for n in numbers):
        raise UsageError(f"a rotation has nine numbers, row by row; got {len(numbers)}")
    x: Vector = (numbers[0], numbers[3], numbers[6])
    y: Vector = (numbers[1], numbers[4], numbers[7])
    z: Vector = (numbers[2], numbers[5], numbers[8])
    lengths = [math.hypot(*v) for v in (x, y, z)]
    skew = max(abs(dot(x, y)), abs(dot(y, z)), abs(dot(z, x)), *(abs(n - 1) for n in lengths))
    if skew > 0.01 or dot(cross(x, y), z) < 0:
        raise UsageError(
            "these nine numbers are not a rotation: the columns must be perpendicular, right-handed and of length 1"
        )
    # The error is shared by the three axes; a few steps take printed digits to machine precision.
    m: Matrix = ((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2]))
    for _ in range(4):
        m = _closer_to_orthogonal(m)
    return m


def _closer_to_orthogonal(m: Matrix) -> Matrix:
    # Newton's step for the polar decomposition: the mean of the matrix and its inverse transposed. For a
    # right-handed matrix the rows of the latter are the cross products over the determinant.
    a, b, c = m
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    det = dot(a, bc)
    return (_mean(a, bc, det), _mean(b, ca, det), _mean(c, ab, det))


def _mean(u: Vector, v: Vector, det: float) -> Vector:
    return (0.5 * (u[0] + v[0] / det), 0.5 * (u[1] + v[1] / det), 0.5 * (u[2] + v[2] / det))


def quaternion(m: Matrix) -> tuple[float, float, float, float]:
    """Unit quaternion x, y, z, w of a rotation, w not negative."""
    (a, b, c), (d, e, f), (g, h, i) = m
    # The largest of the four is computed first (Shepperd), so that no small number is divided by.
    w2, x2, y2, z2 = 1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i
    big = max(w2, x2, y2, z2)
    if big == w2:
        q = (h - f, c - g, d - b, w2)
    elif big == x2:
        q = (x2, b + d, c + g, h - f)
    elif big == y2:
        q = (b + d, y2, f + h, c - g)
    else:
        q = (c + g, f + h, z2, d - b)
    n = math.copysign(math.hypot(*q), q[3])
    return (q[0] / n, q[1] / n, q[2] / n, q[3] / n)


def rotation_between(a: Matrix, b: Matrix) -> tuple[Vector, float]:
    """Axis in the base's frame and angle 0..pi in radians that turn `a` into `b`."""
    x, y, z, w = quaternion(multiply(b, transpose(a)))
    n = math.hypot(x, y, z)
    if n < 1e-15:
        return (1.0, 0.0, 0.0), 0.0
    return (x / n, y / n, z / n), 2.0 * math.atan2(n, w)


def rotation_about(axis: Vector, angle: float) -> Matrix:
    """Rotation about an axis, a unit vector, by an angle in radians."""
    x, y, z = axis
    c, s = math.cos(angle), math.sin(angle)
    k = 1 - c
    return (
        (c + x * x * k, x * y * k - z * s, x * z * k + y * s),
        (y * x * k + z * s, c + y * y * k, y * z * k - x * s),
        (z * x * k - y * s, z * y * k + x * s, c + z * z * k),
    )


def slerp(a: Matrix, b: Matrix, part: float) -> Matrix:
    """The rotation that is `part` of the way from `a` (0) to `b` (1), at an even rate about one axis."""
    axis, angle = rotation_between(a, b)
    return multiply(rotation_about(axis, angle * part), a)
