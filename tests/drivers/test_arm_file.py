from __future__ import annotations

import math
from pathlib import Path

import pytest

from hexwire.drivers.arm_file import load_arm_file, load_profile, profile_names
from hexwire.errors import ConfigError, UsageError
from hexwire.model.arm import MAX_ACCELERATION, MAX_JERK
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.calibration import Calibration, JointCalibration

JOINT = """
[[joints]]
name = "J1"
servo_id = 1
series = "sts_sms"
minimum_deg = -90.0
maximum_deg = 90.0
"""


def _write(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "arm.toml"
    file.write_text(text)
    return file


def test_the_profiles() -> None:
    assert profile_names() == ("chain", "sevenbot", "so100", "so101")
    for name in profile_names():
        arm = load_profile(name)
        assert arm.model.name == name
        for joint in arm.model.joints:
            assert joint.minimum < 0 < joint.maximum or name == "sevenbot"
            low, high = joint.count_limits
            assert 0 <= low < high <= 4095
    assert [joint.servo_id for joint in load_profile("so101").model.joints] == [1, 2, 3, 4, 5, 6]
    with pytest.raises(UsageError, match="there are chain, sevenbot"):
        load_profile("so102")


def test_the_sevenbot_profile_is_the_arm_of_the_chapter() -> None:
    for mine, theirs in zip(load_profile("sevenbot").model.joints, HEX7BOT.joints, strict=True):
        assert (mine.name, mine.servo_id, mine.series, mine.neutral) == (
            theirs.name,
            theirs.servo_id,
            theirs.series,
            theirs.neutral,
        )
        for field in ("offset", "scale", "minimum", "maximum", "max_speed"):
            assert getattr(mine, field) == pytest.approx(getattr(theirs, field), abs=1e-5)


def test_limits_of_planned_motion(tmp_path: Path) -> None:
    usual = load_arm_file(_write(tmp_path, 'name = "x"\n' + JOINT)).model.joints[0]
    assert (usual.max_acceleration, usual.max_jerk) == (MAX_ACCELERATION, MAX_JERK)
    extra = "max_acceleration_deg_per_s2 = 90\nmax_jerk_deg_per_s3 = 1800\n"
    soft = load_arm_file(_write(tmp_path, 'name = "x"\n' + JOINT + extra)).model.joints[0]
    assert soft.max_acceleration == pytest.approx(math.pi / 2)
    assert soft.max_jerk == pytest.approx(10 * math.pi)
    with pytest.raises(ConfigError, match=r"joints\[0\]\.max_jerk_deg_per_s3 is 0"):
        load_arm_file(_write(tmp_path, 'name = "x"\n' + JOINT + "max_jerk_deg_per_s3 = 0\n"))


def test_gearing_signs_and_defaults(tmp_path: Path) -> None:
    extra = "sign = -1\ngearing = 3.0\noffset_deg = 10.0\n"
    joint = load_arm_file(_write(tmp_path, 'name = "x"\n' + JOINT + extra)).model.joints[0]
    assert joint.neutral == 2048
    assert joint.scale == pytest.approx(2 * math.pi / 4096 / 3)
    assert joint.counts_to_angle(2048 - 3 * 1024) == pytest.approx(math.radians(100))
    assert load_arm_file(_write(tmp_path, 'name = "x"\n' + JOINT)).baud == 1_000_000


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("name = 3\n" + JOINT, "name"),
        ('name = "x"\n', "joints"),
        ('name = "x"\nspeed = 3\n' + JOINT, "speed"),
        ('name = "x"\n' + JOINT + "color = 1\n", r"arm\.toml:9:9: joints\[0\]\.color is an unknown key"),
        (
            'name = "x"\n' + JOINT.replace("servo_id = 1", "servo_id = 300"),
            r"arm\.toml:5:12: joints\[0\]\.servo_id is 300, but must be 0 to 253",
        ),
        ('name = "x"\n' + JOINT.replace("sts_sms", "stx"), "of J1: no servo series 'stx'"),
        (
            'name = "x"\n' + JOINT.replace("-90.0", "95.0"),
            r"joints\[0\]\.minimum_deg is 95, but must be below maximum_deg 90",
        ),
        ('name = "x"\n' + JOINT + "sign = 2\n", r"arm\.toml:9:8: joints\[0\]\.sign must be 1 or -1"),
        (
            'name = "x"\n' + JOINT + JOINT.replace("servo_id = 1", "servo_id = 2"),
            r"arm\.toml:11:8: joints\[1\]\.name is 'J1', as in joints\[0\]; every joint needs its own",
        ),
        (
            'name = "x"\n' + JOINT + JOINT.replace("J1", "J2") + JOINT.replace("J1", "J3"),
            r"12:12: joints\[1\]\.servo_id is 1, as in joints\[0\].*; .*19:12: joints\[2\]\.servo_id is 1",
        ),
        ('name = "x"\nbase = "so101"\n' + JOINT, "one of them"),
        ('name = "x"\nbase = "so999"\n', "no arm profile"),
        ("name = ", "not TOML"),
        ('name = "x"\n' + JOINT + "gearing = nan\n", "gearing"),
        ('name = "x"\n' + JOINT + "gearing = true\n", r"gearing must be a number, not true"),
        ('name = "x"\njoints = 5\n', "joints must be a list, not 5"),
        (
            'name = "x"\n' + JOINT + "gearing = 0\n" + JOINT.replace("servo_id", "servo"),
            r"arm\.toml: 9:11: joints\[0\]\.gearing is 0, .*; 13:9: joints\[1\]\.servo is an unknown key, did",
        ),
    ],
)
def test_what_is_wrong_is_named(text: str, named: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=named) as caught:
        load_arm_file(_write(tmp_path, text))
    assert "arm.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_calibrated_arm(tmp_path: Path) -> None:
    row = JointCalibration("gripper", 6, 2000, 1900, 2600)
    (tmp_path / "cal.toml").write_text(Calibration("so101", "2026-01-02", (row,)).serialize())
    arm = load_arm_file(_write(tmp_path, 'name = "left"\nbase = "so101"\ncalibration = "cal.toml"\n'))
    assert arm.model.names == load_profile("so101").model.names
    assert arm.calibration is not None
    assert arm.calibration.joints == (row,)
    wrong = JointCalibration("gripper", 9, 2000, 1900, 2600)
    (tmp_path / "cal.toml").write_text(Calibration("so101", "", (wrong,)).serialize())
    with pytest.raises(ConfigError, match=r"arm\.toml: gripper was calibrated on servo 9"):
        load_arm_file(tmp_path / "arm.toml")
    (tmp_path / "cal.toml").unlink()
    with pytest.raises(ConfigError, match=r"cal\.toml: cannot be read"):
        load_arm_file(tmp_path / "arm.toml")


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_arm_file(tmp_path / "none.toml")
