"""Messages under the names of Foxglove's schemas: times, joints that are unknown, and where links are drawn."""

from __future__ import annotations

import math

import pytest
from tests.motion.arms import state

from hexwire.errors import UsageError
from hexwire.model.arms import arms_with_geometry
from hexwire.ros2.package.arms import make_arm
from hexwire.trace.foxglove import frame_transforms, joint_states, positions, scene_update, time_of


def test_a_time_is_whole_seconds_and_nanoseconds() -> None:
    assert time_of(12.25) == {"sec": 12, "nsec": 250_000_000}
    for wrong in (-1.0, math.nan, 1e10):
        with pytest.raises(UsageError, match="cannot store the time"):
            time_of(wrong)


def test_what_is_unknown_is_left_out() -> None:
    assert positions({"J1": math.nan, "J2": 0.5}, 1.0)["joints"] == [{"name": "J2", "position": 0.5}]
    joints = joint_states(state({"J1": 0.5}), 1.0, {"J1": math.nan})["joints"]
    assert joints[0]["position"] == 0.5
    assert "goal" not in joints[0]
    assert all(math.isfinite(value) for joint in joints for value in joint.values() if isinstance(value, float))


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_what_is_drawn_is_where_the_links_are(robot: str) -> None:
    arm = make_arm(robot)
    shapes, names = arm.shapes, [joint.name for joint in arm.joints]
    found = {name: 0.1 * i for i, name in enumerate(names)}
    rows = frame_transforms(shapes, found, 2.0, "lab/a/")["transforms"]
    poses = shapes.poses(found)
    assert {row["child_frame_id"] for row in rows} == {f"lab/a/{name}" for name in [*poses][1:]}
    for row in rows:
        place = poses[row["child_frame_id"].removeprefix("lab/a/")].position
        assert tuple(row["translation"].values()) == pytest.approx(place)
        assert math.hypot(*row["rotation"].values()) == pytest.approx(1.0)
    entities = scene_update(shapes, names, 2.0, "lab/a/")["entities"]
    drawn = sum(len(entity[kind]) for entity in entities for kind in ("cubes", "spheres", "cylinders"))
    assert drawn == sum(len(link.shapes) for link in shapes.links)
    round_ones = [row for entity in entities for row in entity["cylinders"]]
    assert all(row["bottom_scale"] == row["top_scale"] == 1.0 for row in round_ones), "no cones"
    assert {entity["frame_id"] for entity in entities} <= {f"lab/a/{name}" for name in poses}
