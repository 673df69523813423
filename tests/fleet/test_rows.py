"""Values of a robot as rows in messages."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.values import JointProbe, ProbeReport
from hexwire.errors import RemoteProtocolError
from hexwire.fleet import messages as m
from hexwire.fleet.rows import (
    arm_model,
    as_probe_report,
    as_probe_rows,
    joint_names,
    joints_of,
    sent_target,
)
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import SentTarget


def facts(joints: tuple[m.Joint, ...]) -> m.Facts:
    return m.Facts("hex7bot", joints, 100.0, 20.0, 0.25, 0.5, "", "", "", "", 0.0)


def test_the_model_of_an_arm_is_the_same_after_its_way() -> None:
    there = m.decode(m.encode(facts(joints_of(HEX7BOT))), m.Facts)
    assert arm_model(there).joints == HEX7BOT.joints
    assert arm_model(there).geometry == ""
    there.geometry = "so101"
    assert arm_model(there).geometry == "so101"


@pytest.mark.parametrize(
    "change",
    [
        {"minimum": math.nan},
        {"maximum": math.inf},
        {"minimum": 2.0, "maximum": 1.0},
        {"scale": 0.0},
        {"scale": math.nan},
        {"max_speed": math.nan},
        {"max_speed": -1.0},
        {"max_acceleration": 0.0},
        {"max_jerk": math.inf},
        {"free_speed": -1.0},
        {"free_speed": math.nan},
        {"offset": math.nan},
        {"sign": 0},
        {"name": "J2"},
        {"name": ""},
        {"servo_id": HEX7BOT.joints[1].servo_id},
    ],
)
def test_a_model_that_cannot_be_is_refused(change: dict[str, Any]) -> None:
    joints = list(joints_of(HEX7BOT))
    for name, value in change.items():
        setattr(joints[0], name, value)
    with pytest.raises(RemoteProtocolError, match="not the model"):
        arm_model(facts(tuple(joints)))


@pytest.mark.parametrize("name", ["rate", "command_rate", "max_age", "timeout"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_an_arm_with_impossible_times_is_refused(name: str, value: float) -> None:
    wrong = facts(joints_of(HEX7BOT))
    setattr(wrong, name, value)
    with pytest.raises(RemoteProtocolError, match="rates and times"):
        arm_model(wrong)


def test_an_arm_without_joints_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="not the model"):
        arm_model(facts(()))


PROBE = ProbeReport(
    robot="hex7bot",
    link="serial:///dev/ttyUSB0",
    dialect=2,
    firmware="2.0.1",
    boot_id=17,
    capabilities=("move", "stop"),
    stopped=False,
    joints=(
        JointProbe("J1", 1, "scs", True, supply=(6.0, 8.4)),
        JointProbe("J2", 2, "sts_sms", False, note="silent"),
    ),
    counters={"frames": 5},
)


def test_a_probe_report_is_the_same_after_its_way_but_for_the_address() -> None:
    answer = m.decode(m.encode(m.Answer("", value=as_probe_rows(PROBE))), m.Answer)
    assert as_probe_report(answer.value, "zenoh:arm") == replace(PROBE, link="zenoh:arm")


def test_a_probe_report_has_64_joints_at_most() -> None:
    joint = as_probe_rows(PROBE)["joints"][0]
    assert len(as_probe_report(as_probe_rows(PROBE) | {"joints": [joint] * 64}, "zenoh:arm").joints) == 64
    with pytest.raises(RemoteProtocolError, match="more than 64 joints"):
        as_probe_report(as_probe_rows(PROBE) | {"joints": [joint] * 65}, "zenoh:arm")


_VALUES: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.binary(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["joints", "capabilities", "counters", "supply", "name", "servo_id", "link"]), inner
        )
    ),
    max_leaves=8,
)


@given(
    rows=_VALUES
    | st.fixed_dictionaries(
        {"joints": _VALUES, "capabilities": _VALUES, "counters": _VALUES},
        optional={
            "robot": st.text(),
            "dialect": _VALUES,
            "firmware": st.text(),
            "boot_id": _VALUES,
            "stopped": st.booleans(),
        },
    )
)
def test_whatever_arrives_is_a_probe_report_or_one_error(rows: object) -> None:
    try:
        report = as_probe_report(rows, "zenoh:arm")
    except RemoteProtocolError:
        return
    assert isinstance(report, ProbeReport)
    assert report.link == "zenoh:arm"


def test_a_target_as_it_was_sent_comes_back() -> None:
    row = [["J1", "J2"], [0.1, 2], 1.5, ["J2"], []]
    assert sent_target(row) == SentTarget((("J1", 0.1), ("J2", 2.0)), 1.5, ("J2",), ())
    assert joint_names(["J1", "J2"]) == ("J1", "J2")


@pytest.mark.parametrize(
    "value", [None, 5, [], [["J1"], [0.1, 0.2], 1.0, [], []], [["J1"], ["x"], 1.0, [], []], [[], [], None, [], []]]
)
def test_what_is_no_target_as_sent_is_refused(value: Any) -> None:
    with pytest.raises(RemoteProtocolError, match="not a target as sent"):
        sent_target(value)
    with pytest.raises(RemoteProtocolError, match="not names of joints"):
        joint_names("J1")
