"""Judging a probe and a state: what is bad is named once, and what was not read is not judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from tests.model.states import make_state

from hexwire.drivers.base import JointProbe, ProbeReport
from hexwire.drivers.checkup import judge_board, judge_probe, judge_state, together
from hexwire.link.diagnose import Finding, Level
from hexwire.model.state import JointFlag, JointState

NAN = math.nan
NAMES = ("base", "elbow", "wrist")
LIMITS: dict[str, Any] = {"supply": (4.0, 8.0), "max_temperature": 70.0}


def probes(**changes: Mapping[str, Any]) -> tuple[JointProbe, ...]:
    rows = []
    for i, name in enumerate(NAMES):
        fields = {
            "name": name,
            "servo_id": i,
            "series": "sts_sms",
            "present": True,
            **LIMITS,
            **changes.get(name, {}),
        }
        rows.append(JointProbe(**fields))
    return tuple(rows)


def report(joints: tuple[JointProbe, ...] | None = None, **changes: Any) -> ProbeReport:
    fields: dict[str, Any] = {
        "robot": "arm",
        "link": "serial:///x",
        "dialect": 2,
        "firmware": "2.0.0",
        "boot_id": 1,
        "capabilities": (),
        "stopped": False,
        "joints": probes() if joints is None else joints,
        "counters": {},
    }
    return ProbeReport(**fields | changes)


def state(
    voltage: tuple[float, ...] = (7.4,) * 3,
    temperature: tuple[float, ...] = (28.0,) * 3,
    flags: tuple[int, ...] = (0, 0, 0),
) -> JointState:
    return make_state(0.0, 0.0, 0.0, names=NAMES, voltage=voltage, temperature=temperature, flags=flags, stamp=1.0)


def bad(findings: list[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.level is Level.BAD]


def test_a_healthy_robot_has_nothing_but_good() -> None:
    findings = judge_board(report()) + judge_probe(report()) + judge_state(state(), probes())
    assert {finding.level for finding in findings} == {Level.OK}
    texts = [f"{finding.about}: {finding.text}" for finding in findings]
    assert "servos: all 3 answer" in texts
    assert "supply: 7.4 V; the servos need 4.0 to 8.0 V" in texts
    assert "temperature: 28 deg C; the limit is 70" in texts


def test_a_servos_model_name_is_not_a_fault() -> None:
    assert bad(judge_probe(report(probes(elbow={"model": "sts3215 3.10"})))) == []
    (finding,) = bad(judge_probe(report(probes(elbow={"note": "answers as scs", "model": "scs009 1.0"}))))
    assert (finding.about, finding.text) == ("elbow", "answers as scs")


def test_values_that_were_not_read_are_unknown_and_not_judged() -> None:
    findings = judge_state(state((NAN,) * 3, (NAN,) * 3), probes())
    assert bad(findings) == []
    assert [(f.about, f.text) for f in findings if f.level is Level.UNKNOWN] == [
        ("supply", "unknown: the servos do not report it"),
        ("temperature", "unknown: the servos do not report it"),
    ]
    assert not any("in order" in f.text for f in findings)
    some = judge_state(state((7.4, NAN, 7.2)), probes())
    assert [f.text for f in some if f.about == "supply"] == [
        "7.2 to 7.4 V; the servos need 4.0 to 8.0 V",
        "unknown for elbow",
    ]


@pytest.mark.parametrize(
    ("volts", "supply", "words"),
    [
        (3.5, (4.0, 8.0), "too low"),
        (12.0, (4.0, 8.0), "too high"),
        (12.0, (4.0, 14.0), ""),
        (7.4, (9.0, 12.6), "too low"),
        (12.0, None, "too high"),
        (4.9, None, "too low"),
        (6.0, None, ""),
    ],
)
def test_a_supply_is_judged_by_what_the_servo_wants(
    volts: float, supply: tuple[float, float] | None, words: str
) -> None:
    for flag in (0, JointFlag.VOLTAGE) if words else (0,):
        findings = bad(judge_state(state((volts, 7.4, 7.4), flags=(flag, 0, 0)), probes(base={"supply": supply})))
        assert [words in finding.text for finding in findings] == ([True] if words else [])


def test_one_cause_at_all_joints_is_one_finding() -> None:
    (finding,) = bad(judge_state(state((12.0,) * 3, flags=(1, 1, 1)), probes()))
    assert finding.about == "base, elbow, wrist"
    rows = [Finding(Level.BAD, "a", "x"), Finding(Level.BAD, "b", "y"), Finding(Level.BAD, "c", "x")]
    assert [(row.about, row.text) for row in together(rows)] == [("a, c", "x"), ("b", "y")]


@pytest.mark.parametrize(
    ("flag", "word", "advice"),
    [
        (JointFlag.OVERLOAD, "overload", "free the joint"),
        (JointFlag.CURRENT, "current", "free the joint"),
        (JointFlag.ENCODER, "encoder", "replace"),
        (JointFlag.TEMPERATURE, "temperature", "cool"),
        (JointFlag.VOLTAGE, "voltage", "supply"),
    ],
)
def test_each_fault_is_named_once_with_what_to_do(flag: JointFlag, word: str, advice: str) -> None:
    for known in (True, False):
        number = 7.4 if known else NAN
        rows = judge_state(state((number,) * 3, (number,) * 3, (0, int(flag), 0)), probes())
        (finding,) = bad(rows)
        assert finding.about == "elbow"
        assert word in finding.text
        assert advice in finding.advice
        assert not any("no servo reports" in row.text for row in rows)


def test_heat() -> None:
    (hot,) = bad(judge_state(state(temperature=(28, 71, 28), flags=(0, 4, 0)), probes()))
    assert hot.text == "71 deg C, its limit is 70"
    warm = judge_state(state(temperature=(28, 65, 28)), probes())
    assert [f.level for f in warm if f.about == "elbow"] == [Level.HINT]
    assert not [f for f in judge_state(state(temperature=(28, 60, 28)), probes()) if f.about == "elbow"]
    unlimited = judge_state(state(temperature=(28, 65, 28)), probes(elbow={"max_temperature": None}))
    assert [f.level for f in unlimited if f.about == "elbow"] == [Level.HINT]


def test_a_silent_joint_is_missing_and_nothing_else_is_said_of_it() -> None:
    joints = probes(elbow={"present": False})
    (missing,) = bad(judge_probe(report(joints)))
    assert missing.text == "elbow (servo 1) does not answer"
    assert "the cable after the last servo that answers" in missing.advice
    assert judge_probe(report(joints), missing=False) == []
    stale = state((7.4, NAN, 7.4), (28, 99, 28), (0, JointFlag.SILENT | JointFlag.OVERLOAD, 0))
    assert not any("elbow" in f.about + f.text for f in judge_state(stale, joints))


def test_a_board_of_the_chapter_is_told_how_it_gets_more() -> None:
    (finding,) = judge_board(report(dialect=1, firmware=""))
    assert (finding.level, finding.text) == (Level.HINT, "arm, dialect 1")
    assert "hexwire firmware flash" in finding.advice


def test_a_boards_own_counts() -> None:
    def of(failed: int, joints: tuple[JointProbe, ...] | None = None) -> list[Level]:
        counters = {"board_bus_transactions": 1000, "board_bus_timeouts": failed, "board_uptime_ms": 99_000}
        return [f.level for f in judge_board(report(joints, counters=counters)) if f.about == "servo bus"]

    assert (of(0), of(5), of(100)) == ([Level.OK], [Level.HINT], [Level.BAD])
    # A missing servo explains them.
    assert of(100, probes(base={"present": False})) == []
    fresh = judge_board(report(counters={"board_uptime_ms": 500}))
    assert any(f.level is Level.HINT and "resets it" in f.text for f in fresh)
    assert judge_board(report(dialect=1))[0].level is Level.HINT
    assert any("is stopped" in f.text for f in judge_probe(report(stopped=True)))
