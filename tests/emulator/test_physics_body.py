"""The body of an arm for MuJoCo."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import mujoco.egl
import numpy as np
import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.physics import CAMERA, make_body, puppet_poses, puppets
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for, make_kinematics, make_shapes
from hexwire.model.shapes import ArmShapes

ROBOTS = ("hex7bot", "so100", "so101")


def shapes_of(robot: str) -> ArmShapes:
    return make_shapes(make_kinematics(robot))


def posed(shapes: ArmShapes, positions: dict[str, float], **options: Any) -> tuple[Any, Any]:
    """Model and data with the joints at these positions, those that are simulated and follow included."""
    model = make_body(mujoco, shapes, **options).compile()
    data = mujoco.MjData(model)
    for joint in shapes.joints:
        if joint.drive is not None and joint.child not in puppets(shapes):
            data.joint(joint.name).qpos[0] = (
                joint.drive.multiplier * positions[joint.drive.joint] + joint.drive.offset
            )
    for name, (place, turn) in puppet_poses(shapes, positions).items():
        mocap = model.body(name).mocapid[0]
        data.mocap_pos[mocap], data.mocap_quat[mocap] = place, turn
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_part_is_where_the_other_pictures_have_it(robot: str) -> None:
    shapes = shapes_of(robot)
    for step in range(3):
        positions = {name: 0.3 * step * math.sin(i + 1) for i, name in enumerate(shapes.driven)}
        _, data = posed(shapes, positions)
        for link, shape, pose in shapes.placed(positions):
            geom = data.geom(f"{link.name}/{shape.name}")
            assert list(geom.xpos) == pytest.approx(pose.position, abs=1e-9)
            assert geom.xmat.tolist() == pytest.approx([n for row in pose.rotation for n in row], abs=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_has_the_joints_of_the_arm_and_its_weight(robot: str) -> None:
    shapes = shapes_of(robot)
    model = make_body(mujoco, shapes).compile()
    names = {model.joint(i).name for i in range(model.njnt)}
    assert names >= set(shapes.driven)
    assert names - set(shapes.driven) == ({"J2_level"} if robot == "hex7bot" else set())
    # Of what moves: 0.485 kg is published for the SO-101, the masses of the Hex7Bot are estimates.
    assert sum(model.body_mass) == pytest.approx({"hex7bot": 0.77}.get(robot, 0.485))


def test_an_so_arm_that_was_made_has_this_body() -> None:
    model = kinematics_for(make_bus_arm("so101").model)
    assert model is not None
    _, data = posed(make_shapes(model), dict.fromkeys(load_profile("so101").model.names, 0.0))
    # The lengths of the public URDF, over the foot of the arm.
    assert list(data.body("upper_arm").xpos) == pytest.approx([0.0692346, 0.0, 0.1166], abs=1e-6)
    assert list(data.body("lower_arm").xpos) == pytest.approx([0.0972346, 0.0, 0.22917], abs=1e-6)


def test_centres_of_mass_are_inside_the_links() -> None:
    for robot in ROBOTS:
        shapes = shapes_of(robot)
        model = make_body(mujoco, shapes).compile()
        for link in shapes.links:
            if link.inertia is None or link.name == "base":
                continue
            centre = tuple(model.body(link.name).ipos)
            assert any(math.dist(centre, shape.place) < 0.06 for shape in link.shapes), (robot, link.name)


def test_only_solid_parts_touch_and_only_the_table() -> None:
    shapes = shapes_of("hex7bot")
    model = make_body(mujoco, shapes).compile()
    for link in shapes.links:
        for shape in link.shapes:
            geom = model.geom(f"{link.name}/{shape.name}")
            assert geom.conaffinity[0] == 0
            assert geom.contype[0] == (1 if shape.solid and link.name not in puppets(shapes) else 0)
    assert model.geom("table").conaffinity[0] == 1
    assert make_body(mujoco, shapes, table=False).compile().geom("table").conaffinity[0] == 0


def test_puppets_are_the_second_jaw_and_the_rods() -> None:
    assert set(puppets(shapes_of("hex7bot"))) == {"jaw_left", "jaw_right", "crank", "crank_end", "rod"}
    assert puppets(shapes_of("so101")) == ()


@pytest.mark.parametrize("joint", ["shoulder_lift", "elbow_flex", "wrist_flex"])
def test_positive_angles_lean_forward_and_down(joint: str) -> None:
    shapes = shapes_of("so101")
    heights = []
    for angle in (0.0, 0.5):
        _, data = posed(shapes, {**dict.fromkeys(shapes.driven, 0.0), joint: angle})
        heights.append(data.body("jaw").xpos[2])
    assert heights[1] < heights[0] - 0.03


def picture(model: Any, data: Any, width: int = 160, height: int = 120) -> np.ndarray:
    """What the camera sees, (height, width, 3), drawn without a display."""
    context = mujoco.egl.GLContext(width, height)
    context.make_current()
    try:
        drawer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawer)
        camera = mujoco.MjvCamera()
        camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(CAMERA).id
        scene = mujoco.MjvScene(model, 200)
        mujoco.mjv_updateScene(
            model, data, mujoco.MjvOption(), None, camera, int(mujoco.mjtCatBit.mjCAT_ALL), scene
        )
        pixels = np.zeros((height, width, 3), np.uint8)
        area = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(area, scene, drawer)
        mujoco.mjr_readPixels(pixels, None, area, drawer)
        drawer.free()
        return pixels[::-1]
    finally:
        context.free()


@pytest.mark.parametrize("robot", ["hex7bot", pytest.param("so101", marks=pytest.mark.slow)])
def test_the_camera_sees_the_whole_arm_in_colours(robot: str) -> None:
    shapes = shapes_of(robot)
    arm = HEX7BOT if robot == "hex7bot" else load_profile(robot).model
    positions = dict.fromkeys(arm.names, 0.0) | ({"J2": 0.9} if robot == "hex7bot" else {})
    model, data = posed(shapes, positions)
    seen = picture(model, data).astype(int)
    spread = seen.max(axis=2) - seen.min(axis=2)
    # Joints, and the printed parts of an SO arm, are coloured; floor, sky and shadow are nearly grey.
    coloured = np.argwhere(spread > 60)
    assert len(coloured) > 150
    rows, columns = coloured[:, 0], coloured[:, 1]
    # The arm stands in the picture and fills it, and light falls on it.
    assert rows.min() > 5
    assert rows.max() < 115
    assert columns.min() > 5
    assert columns.max() < 155
    assert rows.max() - rows.min() > 45
    assert seen.max() > 150
    assert seen[:20, :20].mean() > 150, "the sky"
    model.light_active[:] = 0
    assert picture(model, data).mean() < seen.mean() - 10, "the lamp"
