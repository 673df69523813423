from __future__ import annotations

import contextlib
import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.calibration import Calibration, JointCalibration

SCALE = 2 * math.pi / 4096
MODEL = ArmModel(
    "two",
    tuple(JointModel(name, i, "sts_sms", 2048, 1, 0.0, SCALE, -1.0, 1.0, 1.0) for i, name in ((1, "a"), (2, "b"))),
)
LEROBOT = {
    "a": {"id": 1, "drive_mode": 0, "homing_offset": -1470, "range_min": 758, "range_max": 3292},
    "b": {"id": 2, "drive_mode": 1, "homing_offset": 157, "range_min": 801, "range_max": 3240},
}


def test_text_there_and_back() -> None:
    rows = (
        JointCalibration("a", 1, 2000, 1000, 3000, -1, -5, "sts3215", "3.10"),
        JointCalibration("b", 2, 2048, 2048, 4000),
    )
    calibration = Calibration("two", "2026-01-02T03:04:05+00:00", rows)
    assert Calibration.parse(calibration.serialize()) == calibration


def test_apply() -> None:
    calibration = Calibration("two", "", (JointCalibration("b", 2, 2000, 1500, 2600, -1),))
    applied = calibration.apply(MODEL)
    assert applied.joints[0] == MODEL.joints[0]
    joint = applied.joints[1]
    assert joint.counts_to_angle(2000) == 0.0
    assert joint.minimum == pytest.approx(-600 * SCALE)
    assert joint.maximum == pytest.approx(500 * SCALE)
    with pytest.raises(UsageError, match="calibrated on servo 7"):
        Calibration("two", "", (JointCalibration("b", 7, 2, 1, 3),)).apply(MODEL)
    with pytest.raises(UsageError, match="no joint 'c'"):
        Calibration("two", "", (JointCalibration("c", 7, 2, 1, 3),)).apply(MODEL)


# LeRobot 0.4.4, `MotorsBus._normalize` with MotorNormMode.DEGREES, of the file above:
# (raw - (range_min + range_max) / 2) * 360 / 4095; drive_mode has no effect on degrees.
LEROBOT_DEGREES = {
    "a": {758: -111.38461538461539, 2025: 0.0, 2048: 2.021978021978022, 3292: 111.38461538461539},
    "b": {801: -107.20879120879121, 2020: -0.04395604395604396, 2500: 42.15384615384615},
}


# Read by the real `SO101Follower.get_observation` of LeRobot 0.4.4, use_degrees, from an emulated arm with this
# calibration, which LeRobot took for its own (`is_calibrated`): range_min, range_max, position, degrees.
LEROBOT_READ = (
    ("shoulder_pan", 746, 3349, 2047, -0.04395604395604396),
    ("shoulder_lift", 858, 3236, 1000, -92.04395604395604),
    ("elbow_flex", 895, 3199, 3048, 88.0),
    ("wrist_flex", 916, 3179, 2502, 39.956043956043956),
    ("wrist_roll", 0, 4095, 2047, -0.04395604395604396),
)


@pytest.mark.parametrize(("name", "low", "high", "counts", "degrees"), LEROBOT_READ)
def test_degrees_that_lerobot_read(name: str, low: int, high: int, counts: int, degrees: float) -> None:
    row = {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": low, "range_max": high}
    calibration = Calibration.from_lerobot(json.dumps({name: row}), arm="so101")
    joint = JointModel(name, 1, "sts_sms", 2048, 1, 0.0, SCALE, -1.0, 1.0, 1.0)
    applied = calibration.apply(ArmModel("so101", (joint,))).joints[0]
    assert math.degrees(applied.counts_to_angle(counts)) == pytest.approx(degrees, abs=1e-12)


def test_a_lerobot_file_gives_the_degrees_of_lerobot() -> None:
    calibration = Calibration.from_lerobot(json.dumps(LEROBOT), arm="two", taken="2026-01-01")
    first, second = calibration.joints
    assert (first.middle, first.low, first.high, first.sign, first.servo_offset) == (2025, 758, 3292, 1, -1470)
    assert (second.middle, second.sign, second.drive_mode) == (2020.5, 1, 1)
    applied = calibration.apply(MODEL)
    for name, vectors in LEROBOT_DEGREES.items():
        for raw, degrees in vectors.items():
            joint = applied.joint(name)
            assert math.degrees(joint.counts_to_angle(raw)) == pytest.approx(degrees, abs=1e-9)
            assert joint.angle_to_counts(math.radians(degrees)) == raw
    assert Calibration.parse(calibration.serialize()) == calibration


def test_a_lerobot_file_there_and_back() -> None:
    calibration = Calibration.from_lerobot(json.dumps(LEROBOT), arm="two")
    assert json.loads(calibration.to_lerobot()) == LEROBOT


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"servo_offset": None}, "the offset stored in its servo is unknown"),
        ({"servo_offset": 2114}, "its offset 2114 is more than 2047"),
        ({"low": -5}, "passes the end of the turn"),
        ({"high": 4096}, "passes the end of the turn"),
        ({"middle": 2100}, "its middle 2100 is not the middle of its range"),
        ({"sign": -1}, "it is reversed"),
    ],
)
def test_what_lerobot_cannot_express_is_refused(changed: dict[str, int | None], why: str) -> None:
    row = JointCalibration("a", 1, 2047.5, 1000, 3095, servo_offset=5)
    assert json.loads(Calibration("x", "", (row,)).to_lerobot())["a"]["range_max"] == 3095
    with pytest.raises(UsageError, match=f"a cannot be written as a LeRobot calibration: .*{why}"):
        Calibration("x", "", (dataclasses.replace(row, **changed),)).to_lerobot()


LEROBOT_ROW = '"drive_mode": 0, "homing_offset": 0, "range_min": 1, "range_max": 9'


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ":1:1: not JSON"),
        ("[]", ": must be a table, not the list"),
        ("{}", ": is not a LeRobot calibration: it has no joint"),
        ('{"a": 3}', ": a must be a table, not 3"),
        ('{"a": {"id": 1}}', r": a\.drive_mode is missing"),
        (f'{{"a": {{"id": "x", {LEROBOT_ROW}}}}}', r": a\.id must be a whole number, not the text 'x'"),
        (f'{{"a": {{"id": 254, {LEROBOT_ROW}}}}}', r": a\.id is 254, but must be 0 to 253"),
        (f'{{"a": {{"id": 1e3, {LEROBOT_ROW}}}}}', r": a\.id must be a whole number, not 1000"),
        (f'{{"a": {{"id": {"9" * 5000}, {LEROBOT_ROW}}}}}', r": a\.id must be a whole number, not inf"),
        (f'{{"a": {{"id": 1, {LEROBOT_ROW}}}, "a": {{}}}}', ": the key 'a' occurs twice in one table"),
        (f'{{"a\\n": {{"id": 1, {LEROBOT_ROW}}}}}', ": a joint's name has characters that cannot be printed"),
        ("[" * 100_000, ": brackets are nested too deeply"),
    ],
)
def test_no_lerobot_file(text: str, named: str) -> None:
    with pytest.raises(ConfigError, match=rf"c\.json{named}"):
        Calibration.from_lerobot(text, arm="x", file="c.json")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("arm = 3", "taken is missing"),
        ('arm = 3\ntaken = ""\njoints = []', "arm must be text, not 3"),
        ('arm = "x"', "taken is missing"),
        ('arm = "x"\ntaken = ""\njoints = [3]', r"joints\[0\] must be a table, not 3"),
        ('arm = "x"\ntaken = ""\ncolor = 1\njoints = []', "color is an unknown key"),
        ('arm = "x"\ntaken = ""\n[[joints]]\nname = "a"', "servo_id is missing"),
        (
            'arm = "x"\ntaken = ""\n[[joints]]\nname="a"\nservo_id=1\nmiddle=5\nlow=6\nhigh=7',
            "middle 5 is not between",
        ),
        (
            'arm = "x"\ntaken = ""\n[[joints]]\nname="a"\n[[joints]]\nname=1\nservo_id=1\nmiddle=5\nlow=4\nhigh=7',
            r"c\.toml: 3:1: joints\[0\]\.servo_id is missing; 6:6: joints\[1\]\.name must be text, not 1$",
        ),
        ("arm = ", "not TOML"),
    ],
)
def test_what_is_wrong_is_named(text: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        Calibration.parse(text, file="c.toml")


@given(st.text())
def test_any_text_is_a_calibration_or_a_named_error(text: str) -> None:
    for parse in (Calibration.parse, lambda t: Calibration.from_lerobot(t, arm="x")):
        with contextlib.suppress(ConfigError):
            parse(text)
