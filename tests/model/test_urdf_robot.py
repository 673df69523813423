"""What is read of a URDF: links with their solids and meshes, joints, and what no URDF is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError
from hexwire.model.shapes import Drive
from hexwire.model.urdf_robot import UrdfJoint, UrdfLink, UrdfRobot, UrdfVisual, parse_urdf

GREY = "#b0b7c0"
ARM = """<robot name="arm">
  <material name="paint"><color rgba="0 0.5 1 1"/></material>
  <material name="blank"/>
  <link name="finger"/>
  <link name="base">
    <visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>
    <visual>
      <origin xyz="0.01 0.02 0.03" rpy="0.1 0.2 0.3"/>
      <geometry><cylinder radius="0.02" length="0.3"/></geometry>
      <material name="paint"/>
    </visual>
  </link>
  <link name="arm">
    <visual>
      <origin rpy="0 0 1"/><geometry><sphere radius="0.05"/></geometry>
      <material name="paint"><color rgba="1 0 -1 0"/></material>
    </visual>
    <visual><geometry><mesh filename="a.stl"/></geometry><material name="blank"/></visual>
    <visual><geometry><mesh filename="b.glb" scale="1 -1 0.001"/></geometry></visual>
  </link>
  <joint name="lift" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.06" rpy="0 1.5 0"/><axis xyz="0 3 4"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="arm"/><child link="finger"/><mimic joint="lift" multiplier="-0.5" offset="0.25"/>
  </joint>
</robot>"""


def test_an_arm_has_its_links_solids_meshes_and_joints() -> None:
    place, turn = (0.01, 0.02, 0.03), (0.1, 0.2, 0.3)
    assert parse_urdf(ARM) == UrdfRobot(
        "arm",
        (
            UrdfLink(
                "base",
                (
                    UrdfVisual("box", (0.1, 0.2, 0.3), colour=GREY),
                    UrdfVisual("cylinder", (0.02, 0.3), place, turn, "#0080ff"),
                ),
            ),
            UrdfLink(
                "arm",
                (
                    UrdfVisual("sphere", (0.05,), rpy=(0.0, 0.0, 1.0), colour="#ff0000"),
                    UrdfVisual("mesh", (1.0, 1.0, 1.0), file="a.stl"),
                    UrdfVisual("mesh", (1.0, -1.0, 0.001), file="b.glb"),
                ),
            ),
            UrdfLink("finger"),
        ),
        (
            UrdfJoint(
                "lift",
                "base",
                "arm",
                (0.0, 0.0, 0.06),
                (0.0, 1.5, 0.0),
                (0.0, 0.6, 0.8),
                slides=False,
                drive=Drive("lift"),
            ),
            UrdfJoint(
                "grip",
                "arm",
                "finger",
                (0.0, 0.0, 0.0),
                (0.0, 0.0, 0.0),
                (1.0, 0.0, 0.0),
                slides=True,
                drive=Drive("lift", -0.5, 0.25),
            ),
        ),
    )


def joint(name: str, parent: str, child: str, kind: str = "fixed", inside: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def robot(*visuals: str, joints: str = "", links: Sequence[str] = ()) -> str:
    """A robot whose link `a` has these visuals, with more links and joints."""
    seen = "".join(f"<visual>{inside}</visual>" for inside in visuals)
    more = "".join(f'<link name="{name}"/>' for name in links)
    return f'<robot name="r"><link name="a">{seen}</link>{more}{joints}</robot>'


def solid(shape: str) -> str:
    return f"<geometry>{shape}</geometry>"


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic", "fixed", "floating", ""])
def test_a_joint_that_moves_has_an_axis_of_length_one(kind: str) -> None:
    moves = kind in ("revolute", "continuous", "prismatic")
    for xyz, axis in (("0 0 -2", (0.0, 0.0, -1.0)), ("2e-6 0 0", (1.0, 0.0, 0.0))):
        (found,) = parse_urdf(robot(links="b", joints=joint("j", "a", "b", kind, f'<axis xyz="{xyz}"/>'))).joints
        assert found.axis == (axis if moves else None)
        assert found.slides is (kind == "prismatic")
        assert found.drive == Drive("j")
    none = robot(links="b", joints=joint("j", "a", "b", kind, '<axis xyz="0 0 0"/>'))
    if moves:
        with pytest.raises(ConfigError, match="joint j: its axis has no length"):
            parse_urdf(none)
    else:
        assert parse_urdf(none).joints[0].axis is None


def test_a_joint_that_mimics_another_one_has_its_angle() -> None:
    mimic = '<mimic joint="i"/>'
    text = robot(links="bc", joints=joint("i", "a", "b") + joint("j", "b", "c", "revolute", mimic))
    assert parse_urdf(text).joints[1].drive == Drive("i", 1.0, 0.0)


@given(st.data())
def test_each_link_comes_after_the_one_that_carries_it(data: st.DataObject) -> None:
    names = [f"l{i}" for i in range(data.draw(st.integers(1, 12)))]
    carries = {name: names[data.draw(st.integers(0, i))] for i, name in enumerate(names[1:])}
    rows = [f'<link name="{name}"/>' for name in names]
    rows += [joint(f"to {child}", parent, child) for child, parent in carries.items()]
    found = parse_urdf(f"<robot>{''.join(data.draw(st.permutations(rows)))}</robot>")
    order = [link.name for link in found.links]
    assert sorted(order) == sorted(names)
    assert all(order.index(parent) < order.index(child) for child, parent in carries.items())
    assert {each.child: each.parent for each in found.joints} == carries


WRONG: dict[str, str] = {
    "a URDF has no DOCTYPE": '<!DOCTYPE r [<!ENTITY a "aaaa">]><robot name="&a;"><link name="x"/></robot>',
    "r.urdf:2:9: is no XML": "<robot>\n<link/> <",
    "has no <robot>": "<sdf/>",
    "has 0 links and 0 joints": "<robot/>",
    "has 2 links and 256 joints": robot(links="b", joints=joint("j", "a", "b") * 256),
    "have one name": robot(links="a"),
    "or two joints, have one name": robot(links="bc", joints=joint("j", "a", "b") + joint("j", "a", "c")),
    "has 2 links that nothing carries": robot(links="b"),
    "joint j: a link is unknown": robot(joints=joint("j", "a", "b")),
    "joint k: a link is unknown, or carried by two": robot(
        links="b", joints=joint("j", "a", "b") + joint("k", "a", "b")
    ),
    "its joints go round in a circle": robot(links="bc", joints=joint("j", "b", "c") + joint("k", "c", "b")),
    "a visual has no geometry": robot("<geometry/>"),
    "'1 1' is not 3 numbers": robot(solid('<box size="1 1"/>')),
    "'1 1 1 1' is not 3 numbers": robot(solid('<box size="1 1 1 1"/>')),
    "'1 x 1' is not 3 numbers": robot(solid('<box size="1 x 1"/>')),
    "'1 1 1e9' is not 3 numbers of at most 100": robot(solid('<box size="1 1 1e9"/>')),
    "'nan' is not 1 numbers": robot(solid('<sphere radius="nan"/>')),
    "'2 inf' is not 2 numbers": robot(solid('<cylinder radius="2" length="inf"/>')),
    "a sphere has a length that is not above 0": robot(solid('<sphere radius="0"/>')),
    "a box has a length that is not above 0": robot(solid('<box size="1 1 -1"/>')),
    "a visual is a 'torus', not a box": robot(solid("<torus/>")),
    "something has no length": robot(solid('<cylinder radius="1"/>')),
    "something has no filename": robot(solid("<mesh/>")),
    "a mesh has the scale 0": robot(solid('<mesh filename="a" scale="1 0 1"/>')),
    "'1 1' is not 3 numbers of": robot(f'<origin xyz="1 1"/>{solid("<sphere/>")}'),
    "'1 1 1' is not 4 numbers of at most 1": robot(
        f'<material><color rgba="1 1 1"/></material>{solid("<sphere/>")}'
    ),
    "something has no name": "<robot><link/></robot>",
    "something has no name, or one of more": '<robot><link name=""/></robot>',
    "something has no link": robot(joints='<joint name="j"><parent link="a"/></joint>'),
    "something has no joint": robot(links="b", joints=joint("j", "a", "b", "revolute", "<mimic/>")),
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_no_urdf_is_refused_in_one_line(words: str) -> None:
    with pytest.raises(ConfigError, match=r"\A[^\n]+\Z") as error:
        parse_urdf(WRONG[words], "r.urdf")
    assert words in str(error.value)
    assert str(error.value).startswith("r.urdf:")


def chain(links: int) -> str:
    names = [f"l{i}" for i in range(1, links)]
    joints = "".join(joint(f"j{b}", a, b) for a, b in zip(["a", *names], names, strict=False))
    return robot(links=names, joints=joints)


BALL = solid('<sphere radius="1"/>')
BOUNDS: dict[str, Any] = {
    "links": (256, chain),
    "visuals": (1024, lambda count: robot(*[BALL] * count)),
    "letters of a name": (400, lambda count: robot(links=["b" * count], joints=joint("j", "a", "b" * count))),
    "letters of an address": (400, lambda count: robot(solid(f'<mesh filename="{"f" * count}"/>'))),
    "metres of a solid": (100, lambda count: robot(solid(f'<box size="1 1 {count}"/>'))),
    "metres to a visual": (100, lambda count: robot(f'<origin xyz="0 {-count} 0"/>{BALL}')),
    "full colour": (1, lambda count: robot(f'<material><color rgba="0 {count} 0 1"/></material>{BALL}')),
}


@pytest.mark.parametrize("what", BOUNDS)
def test_a_urdf_has_bounds(what: str) -> None:
    most, make = BOUNDS[what]
    parse_urdf(make(most))
    with pytest.raises(ConfigError, match=f"than {most}|at most {most}"):
        parse_urdf(make(most + 1))
    assert len(parse_urdf(f'<robot name="{"r" * 401}"><link name="a"/></robot>').name) == 400


@given(st.data())
def test_a_text_that_is_cut_or_changed_is_a_robot_or_a_fault(data: st.DataObject) -> None:
    text = ARM
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(start + 40, len(text))))
        text = text[:start] + data.draw(st.text(st.sampled_from("<>/\"'=& \n0-.eabx\0"), max_size=8)) + text[end:]
    with suppress(ConfigError):
        found = parse_urdf(text)
        for link in found.links:
            for visual in link.visuals:
                assert all(map(math.isfinite, (*visual.size, *visual.place, *visual.rpy)))
        for each in found.joints:
            assert each.axis is None or math.hypot(*each.axis) == pytest.approx(1.0)
