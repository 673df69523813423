from __future__ import annotations

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.calibration import Calibration, JointCalibration, RangeSweep

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


def test_lerobot_files_are_taken_over() -> None:
    calibration = Calibration.from_lerobot(json.dumps(LEROBOT), arm="two", taken="2026-01-01")
    first, second = calibration.joints
    assert (first.middle, first.low, first.high, first.sign, first.servo_offset) == (2025, 758, 3292, 1, -1470)
    assert second.sign == -1
    # LeRobot's degrees: (raw - middle) * 360 / 4095 with drive_mode turning the sign.
    angle = calibration.apply(MODEL).joints[1].counts_to_angle(2500)
    assert math.degrees(angle) == pytest.approx(-(2500 - 2020.5) * 360 / 4095, abs=0.2)


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


@given(st.integers(1, 4095), st.lists(st.integers(-300, 300), max_size=60))
def test_a_sweep_follows_the_joint_over_the_end_of_a_turn(middle: int, steps: list[int]) -> None:
    sweep, true, low, high = RangeSweep({"a": middle}), middle, middle, middle
    for step in steps:
        true += step
        low, high = min(low, true), max(high, true)
        sweep.receive({"a": true % 4096})
        sweep.receive({"a": None, "z": 3})
    assert sweep.ranges == {"a": (low, high)}
    assert bool(sweep.wrapped) is (low < 0 or high > 4095)


def test_a_sweep_names_what_is_left_to_do() -> None:
    sweep = RangeSweep({"a": 2000, "b": 100})
    for step in range(0, 200, 20):
        sweep.receive({"a": 2000 + step})
    assert sweep.unmoved == ("b",)
    with pytest.raises(UsageError, match="b was not moved"):
        sweep.finish(MODEL, "")
    for step in range(0, 200, 20):
        sweep.receive({"b": (100 - step) % 4096})
    with pytest.raises(UsageError, match="b passed the end"):
        sweep.finish(MODEL, "")
    good = RangeSweep({"a": 2000})
    good.receive({"a": 1900})
    good.receive({"a": 2100})
    calibration = good.finish(MODEL, "now", {"a": (5, "sts3215", "3.10")})
    assert calibration.joints == (JointCalibration("a", 1, 2000, 1900, 2100, 1, 5, "sts3215", "3.10"),)
