"""A picture of an arm as SVG, drawn from its shapes: what a notebook shows of where an arm is.

Owns the view, the facets and their order. Must not know a particular arm.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product

from .palette import joint_colour
from .pose import Vector, apply, dot
from .shapes import COLOURS, ArmShapes, Shape, moved

__all__ = ["Picture", "draw_arm"]

_TURN, _ELEVATION = math.radians(-60.0), math.radians(22.0)
"""From where the arm is seen: beside its heading, and above the table."""
_LIGHT: Vector = (0.36, -0.48, 0.8)
_DARKEST = 0.62
"""Share of its colour that a facet has which faces away from the light."""
_SIDES = 20
"""Facets of a round body."""
_TILE = 0.1
"""Metres between the lines on the table, so that sizes can be told."""
_PIXELS = 640
_MARGIN = 10.0
"""Millimetres around what is drawn."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture; a notebook shows it where it is the value of a cell.

    Attributes:
        svg: The picture as an SVG document.
    """

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg


def draw_arm(shapes: ArmShapes, positions: Mapping[str, float], title: str) -> Picture:
    """Draw an arm from the side and a little from above; the lines on the table are 100 mm apart.

    Args:
        shapes: The arm.
        positions: Joint positions of the driver, radians; 0 for a joint that is not in it or is unknown.
        title: What it shows, for people who do not see it.
    """
    turn = shapes.heading + _TURN
    right: Vector = (-math.sin(turn), math.cos(turn), 0.0)
    level = (math.cos(turn), math.sin(turn))
    eye: Vector = (math.cos(_ELEVATION) * level[0], math.cos(_ELEVATION) * level[1], math.sin(_ELEVATION))
    up: Vector = (-math.sin(_ELEVATION) * level[0], -math.sin(_ELEVATION) * level[1], math.cos(_ELEVATION))
    known = {name: angle for name, angle in positions.items() if math.isfinite(angle)}
    order = {name: i for i, name in enumerate(positions)}

    def seen(point: Vector) -> tuple[float, float]:
        return 1000.0 * dot(point, right), -1000.0 * dot(point, up)

    facets = []
    for _, shape, pose in shapes.placed(known):
        colour = joint_colour(order.get(shape.joint, 0)) if shape.colour == "joint" else COLOURS[shape.colour][0]
        for corners, normal in _facets(shape):
            facing = apply(pose.rotation, normal)
            if dot(facing, eye) > 0.0:
                placed = [moved(pose, corner) for corner in corners]
                depth = sum(dot(corner, eye) for corner in placed) / len(placed)
                facets.append((depth, placed, _lit(colour, facing)))
    facets.sort(key=lambda facet: facet[0])
    reach = _TILE * math.ceil(0.5 * shapes.reach / _TILE)
    lines = ["M{:.1f} {:.1f} L{:.1f} {:.1f}".format(*seen(start), *seen(end)) for start, end in _table_lines(reach)]
    drawn = [([seen(corner) for corner in corners], colour) for _, corners, colour in facets]
    points = [point for corners, _ in drawn for point in corners]
    # The same view of each pose: the table, and the arm stretched upwards.
    points += [seen((x, y, 0.0)) for x, y in product((-reach, reach), repeat=2)] + [seen((0.0, 0.0, reach))]
    left, top = (min(point[i] for point in points) - _MARGIN for i in range(2))
    wide, high = (max(point[i] for point in points) + _MARGIN - low for i, low in enumerate((left, top)))
    polygons = "\n".join(
        f'<polygon fill="{colour}" stroke="{colour}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'
        for points, colour in drawn
    )
    return Picture(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_PIXELS}" role="img" '
        f'viewBox="{left:.1f} {top:.1f} {wide:.1f} {high:.1f}">\n<title>{title}</title>\n'
        f'<path stroke="#c3c9d1" stroke-width="1" fill="none" d="{" ".join(lines)}"/>\n'
        f'<g stroke-width="0.6" stroke-linejoin="round">\n{polygons}\n</g>\n</svg>\n'
    )


def _table_lines(reach: float) -> Iterator[tuple[Vector, Vector]]:
    for i in range(-round(reach / _TILE), round(reach / _TILE) + 1):
        yield (i * _TILE, -reach, 0.0), (i * _TILE, reach, 0.0)
        yield (-reach, i * _TILE, 0.0), (reach, i * _TILE, 0.0)


def _facets(shape: Shape) -> Iterator[tuple[list[Vector], Vector]]:
    """Corners and outward normal of each facet, in the frame of the shape."""
    if shape.kind == "box":
        x, y, z = (0.5 * length for length in shape.size)
        for axis, sign in product(range(3), (-1.0, 1.0)):
            normal = tuple(sign if i == axis else 0.0 for i in range(3))
            corners = [
                tuple(sign if i == axis else (a if i == (axis + 1) % 3 else b) for i in range(3))
                for a, b in ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
            ]
            yield [(x * i, y * j, z * k) for i, j, k in corners], normal  # type: ignore[misc]
        return
    radius = shape.size[0]
    # A ball is drawn as rings, a cylinder as one ring with two ends: height and radius of each circle.
    if shape.kind == "cylinder":
        circles = [(-0.5 * shape.size[1], radius), (0.5 * shape.size[1], radius)]
    else:
        tilts = [math.pi * i / 8 for i in range(9)]
        circles = [(-radius * math.cos(tilt), radius * math.sin(tilt)) for tilt in tilts]
    for (low, inner), (high, outer) in pairwise(circles):
        for start, end in pairwise(2.0 * math.pi * i / _SIDES for i in range(_SIDES + 1)):
            middle = 0.5 * (start + end)
            normal = (math.cos(middle) * (high - low), math.sin(middle) * (high - low), inner - outer)
            yield (
                [_on(low, inner, start), _on(low, inner, end), _on(high, outer, end), _on(high, outer, start)],
                normal,
            )
    for height, rim in (circles[0], circles[-1]):
        turns = [2.0 * math.pi * i / _SIDES for i in range(_SIDES)]
        yield [_on(height, rim, turn) for turn in turns], (0.0, 0.0, math.copysign(1.0, height))


def _on(height: float, radius: float, turn: float) -> Vector:
    return (radius * math.cos(turn), radius * math.sin(turn), height)


def _lit(colour: str, normal: Vector) -> str:
    length = math.sqrt(dot(normal, normal)) or 1.0
    share = _DARKEST + (1.0 - _DARKEST) * max(0.0, dot(normal, _LIGHT) / length)
    return "#" + "".join(f"{round(share * int(colour[i : i + 2], 16)):02x}" for i in (1, 3, 5))
