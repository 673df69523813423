from __future__ import annotations

import pytest

from hexwire.model.arms.puma260 import links
from hexwire.model.arms.puma260.kinematics import Puma260Model


def test_the_zero_pose_is_the_links_in_a_row() -> None:
    pose = Puma260Model().forward((0.0,) * 6)
    along = (links.UPPER + links.FLANGE, links.SIDE, links.SHOULDER + links.DROP - links.FOREARM)
    assert pose.position == pytest.approx(along, abs=1e-15)
    assert [round(v / 0.0254, 12) for v in along] == [10.0, -4.9, 4.25]
