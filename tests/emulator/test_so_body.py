"""The body of SO arms for MuJoCo."""

from __future__ import annotations

import mujoco
import pytest

from hexwire.emulator.so_arms import make_so_arm
from hexwire.emulator.so_body import TIP, make_so_body


def test_it_has_the_joints_of_the_arm_and_its_weight() -> None:
    model = mujoco.MjModel.from_xml_string(make_so_body())
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
    assert tuple(names) == make_so_arm("so101").model.names
    assert sum(model.body_mass) == pytest.approx(0.485)


def test_with_all_joints_at_0_the_upper_arm_is_upright_and_the_rest_points_forward() -> None:
    model = mujoco.MjModel.from_xml_string(make_so_body())
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    places = {name: data.body(name).xpos for name in ("shoulder_lift", "elbow_flex", TIP)}
    # Over the foot of the arm; the lengths of the public URDF.
    assert list(places["shoulder_lift"]) == pytest.approx([0.0304, 0.0, 0.1162])
    assert list(places["elbow_flex"]) == pytest.approx([0.0584, 0.0, 0.2288])
    assert list(places[TIP]) == pytest.approx([0.2544, 0.0, 0.234])


@pytest.mark.parametrize("joint", ["shoulder_lift", "elbow_flex", "wrist_flex"])
def test_positive_angles_lean_forward_and_down(joint: str) -> None:
    model = mujoco.MjModel.from_xml_string(make_so_body())
    data = mujoco.MjData(model)
    heights = []
    for angle in (0.0, 0.5):
        data.joint(joint).qpos[0] = angle
        mujoco.mj_forward(model, data)
        heights.append(data.body("gripper").xpos[2])
    assert heights[1] < heights[0] - 0.03
