from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hexwire.drivers.arm_file import load_arm_file, load_profile
from hexwire.errors import ConfigError, UsageError
from hexwire.model.arms import arms_with_geometry
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.geometry import kinematics_for, kinematics_or_none, make_kinematics

OWN = "name='bench'\na=120\nb=40\nc=190.5\nd=24.28\ne=79\nf=30\ng=12\nh=34.8\noffset=90\n"


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_every_robot_that_is_named_has_one(robot: str) -> None:
    assert make_kinematics(robot).name == robot
    model = kinematics_or_none(robot)
    assert model is not None
    assert model.name == robot


def test_a_robot_without_geometry() -> None:
    assert kinematics_or_none("chain") is None
    assert kinematics_for(load_profile("chain").model) is None
    with pytest.raises(UsageError, match="for robot 'chain'; choose one of hex7bot, puma260, so100, so101"):
        make_kinematics("chain")


def test_an_arm_has_the_geometry_of_its_base_and_its_own_limits(tmp_path: Path) -> None:
    (tmp_path / "left.toml").write_text('name = "left"\nbase = "so100"\n', encoding="utf-8")
    arm = load_arm_file(tmp_path / "left.toml").model
    narrow = replace(arm, joints=tuple(replace(joint, maximum=0.2) for joint in arm.joints))
    model = kinematics_for(narrow)
    assert model is not None
    assert model.name == "so100"
    assert [r.maximum for r in model.ranges] == [0.2] * 5
    # The limits of the others are those of their published models, as in `make_kinematics`.
    other = kinematics_for(HEX7BOT, "V1")
    assert other is not None
    assert other.ranges == make_kinematics("hex7bot", "V1", for_motion=True).ranges


def test_published_link_sets_and_a_file(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(OWN, encoding="utf-8")
    for links, name in (("v1", "V1"), ("B", "B"), (str(file), "bench")):
        model = make_kinematics("hex7bot", links)
        assert isinstance(model, Hex7BotModel)
        assert model.links.name == name
    with pytest.raises(UsageError, match="no link set 'C'"):
        make_kinematics("hex7bot", "C")


def test_a_file_that_cannot_be_used(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    with pytest.raises(ConfigError, match=r"bench\.toml: cannot be read: No such file"):
        make_kinematics("hex7bot", str(file))
    file.write_bytes(b"name = '\xff'\n")
    with pytest.raises(ConfigError, match=r"bench\.toml:1:9: not UTF-8 text"):
        make_kinematics("hex7bot", str(file))
    file.write_text("a=120\nz=1\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"bench\.toml:2:3: z is an unknown key; known: a, "):
        make_kinematics("hex7bot", str(file))


def test_for_motion_the_limits_of_the_joints_count_as_well() -> None:
    wide, narrow = make_kinematics("hex7bot"), make_kinematics("hex7bot", for_motion=True)
    assert math.degrees(wide.ranges[5].maximum) == pytest.approx(360.0)
    # J6 ends where a turn of its encoder ends, 179 degrees above neutral.
    assert math.degrees(narrow.ranges[5].maximum) == pytest.approx(269.0)
    assert make_kinematics("puma260", for_motion=True).ranges == make_kinematics("puma260").ranges


def test_asking_which_robots_there_are_loads_no_model() -> None:
    code = (
        "import sys\n"
        "import hexwire.model.geometry\n"
        "loaded = {name for name in sys.modules if name.startswith('hexwire.model.')}\n"
        "assert loaded == {'hexwire.model.geometry', 'hexwire.model.arms'}, loaded\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)
