from __future__ import annotations

from hexwire.control.pose_file import check_pose_name
from hexwire.studio.pages.arm_poses import gripper_html, poses_html


def test_the_gripper_belongs_to_a_pose_only_where_there_is_one() -> None:
    assert 'name="gripper"' in poses_html(gripper=True)
    assert 'name="gripper"' not in poses_html(gripper=False)


def test_the_longest_name_is_that_of_the_file() -> None:
    assert 'maxlength="40"' in poses_html(gripper=True)
    assert check_pose_name(40 * "x") == 40 * "x"


def test_the_gripper_opens_closes_and_goes_to_an_opening() -> None:
    html = gripper_html()
    assert 'data-share="0">Close' in html
    assert 'data-share="1">Open' in html
    assert 'name="share" min="0" max="100"' in html
