"""The layout for Foxglove: every panel has its settings, every path and topic is one of the node's."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from tests.ros2.front_bench import running

from hexwire.model.arms import arms_with_geometry
from hexwire.ros2.package import make_package
from hexwire.ros2.package.arms import make_arm

PATH = re.compile(r"(/[a-z_/]+)\.([a-z]+)\[(\d+)\]")


def layout(robot: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(make_package(robot)["foxglove/arm.json"])
    return found


def leaves(node: Any) -> Iterator[str]:
    """The panels of a tree of splits."""
    if isinstance(node, str):
        yield node
        return
    assert set(node) == {"direction", "splitPercentage", "first", "second"}
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_every_panel_is_shown_once_and_has_its_settings(robot: str) -> None:
    found = layout(robot)
    panels = list(leaves(found["layout"]))
    assert sorted(panels) == sorted(found["configById"])
    assert [panel.partition("!")[0] for panel in panels] == ["3D", "Plot", "DiagnosticSummary", "RosOut"]


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_each_joint_has_its_line(robot: str) -> None:
    rows = layout(robot)["configById"]["Plot!positions"]["paths"]
    assert [row["label"] for row in rows] == [joint.name for joint in make_arm(robot).joints]
    for i, row in enumerate(rows):
        found = PATH.fullmatch(row["value"])
        assert found is not None
        assert (found[1], found[2], int(found[3])) == ("/joint_states", "position", i)


def test_the_node_publishes_what_is_shown() -> None:
    found = layout("hex7bot")["configById"]
    shown = {found["3D!arm"]["layers"]["urdf"]["topic"], found["DiagnosticSummary!arm"]["topicToRender"]}
    shown |= {PATH.fullmatch(row["value"])[1] for row in found["Plot!positions"]["paths"]}  # type: ignore[index]
    with running() as front:
        assert shown <= set(front.node.publishers)
        # Their order is that of the paths.
        assert tuple(front.newest("/joint_states").name) == tuple(j.name for j in make_arm("hex7bot").joints)
