"""Pictures of arms: every arm with shapes has one, and what is nearer covers what is behind it."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from xml.etree import ElementTree

import pytest

from hexwire import Arm
from hexwire.drivers.registry import load_driver
from hexwire.errors import UsageError
from hexwire.model.geometry import make_kinematics, make_shapes
from hexwire.model.palette import joint_colour
from hexwire.model.picture import draw_arm
from hexwire.model.shapes import ArmShapes, ShapeLink, box, cylinder
from hexwire.model.state import JointState

SVG = "{http://www.w3.org/2000/svg}"


def polygons(svg: str) -> list[tuple[str, list[tuple[float, float]]]]:
    found = []
    for polygon in ElementTree.fromstring(svg).iter(f"{SVG}polygon"):
        numbers = [float(number) for number in re.split("[ ,]", polygon.attrib["points"])]
        found.append((polygon.attrib["fill"], list(zip(numbers[::2], numbers[1::2], strict=True))))
    return found


def still(*shapes: object) -> ArmShapes:
    return ArmShapes("still", (ShapeLink("base", shapes),), (), "base", "", "")  # type: ignore[arg-type]


@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so100", "so101"])
def test_every_arm_has_a_picture_that_follows_its_joints(robot: str) -> None:
    shapes = make_shapes(make_kinematics(robot))
    zero = dict.fromkeys(shapes.driven, 0.0)
    picture = draw_arm(shapes, zero, robot)
    root = ElementTree.fromstring(picture._repr_svg_())
    assert (root.tag, root.findtext(f"{SVG}title")) == (f"{SVG}svg", robot)
    left, top, wide, high = map(float, root.attrib["viewBox"].split())
    for _, corners in polygons(picture.svg):
        assert all(left < x < left + wide and top < y < top + high for x, y in corners)
    for name in shapes.driven:
        assert draw_arm(shapes, zero | {name: 0.3}, robot) != picture, name
    assert draw_arm(shapes, zero | {shapes.driven[0]: math.nan}, robot) == picture


@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so100", "so101"])
def test_the_view_is_that_of_the_table_with_half_the_reach_of_the_arm_above_it(robot: str) -> None:
    shapes = make_shapes(make_kinematics(robot))
    folded, turned = (draw_arm(shapes, dict.fromkeys(shapes.driven, angle), robot) for angle in (0.0, 0.4))
    root = ElementTree.fromstring(folded.svg)
    assert ElementTree.fromstring(turned.svg).attrib["viewBox"] == root.attrib["viewBox"]
    left, top, wide, high = map(float, root.attrib["viewBox"].split())
    table = root.find(f"{SVG}path")
    assert table is not None
    ends = [float(number) for number in re.split("[ LM]+", table.attrib["d"])[1:]]
    # Whole tiles of 100 mm to each side: two lines for each, and two in the middle, of two ends with two numbers.
    tiles = (len(ends) / 8 - 1) / 2
    assert tiles == math.ceil(0.5 * shapes.reach / 0.1)
    margin = 10.0
    assert (left, left + wide) == pytest.approx((min(ends[::2]) - margin, max(ends[::2]) + margin), abs=0.15)
    above = 100.0 * tiles * math.cos(math.radians(22))
    assert (top, top + high) == pytest.approx((-above - margin, max(ends[1::2]) + margin), abs=0.15)


def test_a_box_shows_its_three_sides_that_face_the_viewer_to_scale() -> None:
    faces = polygons(draw_arm(still(box("b", "paint", (0.1, 0.1, 0.1), (0.0, 0.0, 0.05))), {}, "").svg)
    assert [len(corners) for _, corners in faces] == [4, 4, 4]
    assert len({colour for colour, _ in faces}) == 3, "each side has its own light"
    # Of 100 mm, and seen from 22 degrees above.
    upright = max(abs(a[1] - b[1]) for _, corners in faces for a, b in pairwise(corners) if a[0] == b[0])
    assert upright == pytest.approx(100 * math.cos(math.radians(22)), abs=0.2)


def test_what_is_nearer_is_drawn_later() -> None:
    floor, above = (
        box("floor", "base", (0.2, 0.2, 0.01), (0, 0, 0.005)),
        box("top", "pad", (0.05,) * 3, (0, 0, 0.1)),
    )
    faces = [corners for _, corners in polygons(draw_arm(still(above, floor), {}, "").svg)]
    size = [max(x for x, _ in corners) - min(x for x, _ in corners) for corners in faces]
    highest = min(range(len(faces)), key=lambda i: min(y for _, y in faces[i]))
    assert size.index(max(size)) < highest, "the box above lies over the floor"


def test_a_cylinder_is_closed_and_has_the_colour_of_its_joint() -> None:
    can = cylinder("c", "joint", 0.03, 0.1, (0.0, 0.0, 0.05), joint="pan")
    faces = polygons(draw_arm(still(can), {"lift": 0.0, "pan": 0.0}, "").svg)
    sides = [len(corners) for _, corners in faces]
    assert (sides.count(20), sides.count(4), len(sides)) == (1, 10, 11), "one end and half of the mantle are seen"
    brightest = max(faces, key=lambda face: int(face[0][1:], 16))[0]
    wanted = joint_colour(1)
    shares = [
        int(brightest[i : i + 2], 16) / int(wanted[i : i + 2], 16) for i in (1, 3) if wanted[i : i + 2] != "00"
    ]
    assert all(0.62 <= share <= 1.0 for share in shares)
    assert max(shares) - min(shares) < 0.05


def test_an_arm_draws_itself() -> None:
    driver = load_driver("so101").from_url("tcp://127.0.0.1:1")
    zero = JointState.of(dict.fromkeys(driver.model.names, 0.0), stamp=0.0)
    assert Arm(driver).picture(zero).svg.count("<polygon") > 100


def test_an_arm_without_a_known_geometry_has_no_picture() -> None:
    driver = load_driver("chain").from_url("tcp://127.0.0.1:1")
    with pytest.raises(UsageError, match="no geometry is known"):
        Arm(driver).picture(JointState.of(dict.fromkeys(driver.model.names, 0.0), stamp=0.0))
