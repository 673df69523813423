from __future__ import annotations

from tests.model.poses import pose_error, random_angles
from tests.model.solids import loose, positions_within

from hexwire.model.arms.puma260.kinematics import PUMA260, Puma260Model
from hexwire.model.arms.puma260.shapes import make_puma260_shapes


def test_the_flange_is_that_of_the_kinematics() -> None:
    shapes, model = make_puma260_shapes(), Puma260Model()
    for angles in random_angles(41, 40):
        pose = shapes.poses(dict(zip(PUMA260.names, angles, strict=True)))[shapes.tip]
        assert pose_error(pose, model.forward(angles)) < 1e-5


def test_no_part_floats() -> None:
    shapes = make_puma260_shapes()
    for positions in positions_within(shapes, 42, 6):
        assert loose(shapes, positions) == set()
