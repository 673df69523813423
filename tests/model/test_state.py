"""States, targets and what was sent: frozen values with names."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import UsageError
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget

NAN = (math.nan,) * 2
STATE = JointState(
    names=("J1", "J2"),
    position=(0.1, -0.2),
    velocity=(1.0, 2.0),
    load=(0.5, -0.5),
    current=(0.25, 0.5),
    voltage=(12.0, 12.1),
    temperature=(30.0, 31.0),
    flags=(int(JointFlag.TORQUE_ON), int(JointFlag.SILENT | JointFlag.OVERLOAD)),
    age=(0.01, 0.5),
    stamp=5.0,
)


def test_one_joint_by_name_and_all_in_order() -> None:
    j2 = STATE["J2"]
    assert (j2.name, j2.position, j2.velocity, j2.load, j2.current) == ("J2", -0.2, 2.0, -0.5, 0.5)
    assert (j2.voltage, j2.temperature, j2.age) == (12.1, 31.0, 0.5)
    assert j2.flags == JointFlag.SILENT | JointFlag.OVERLOAD
    assert [reading.name for reading in STATE] == ["J1", "J2"]
    assert len(STATE) == 2
    assert list(STATE)[1] == j2
    with pytest.raises(UsageError, match="no joint 'J9'; there are J1, J2"):
        STATE["J9"]


def test_who_is_silent_and_who_has_torque() -> None:
    assert STATE.silent == ("J2",)
    assert STATE.torque_on == ("J1",)
    assert STATE.positions == {"J1": 0.1, "J2": -0.2}


def test_what_a_board_does_not_say_is_not_claimed() -> None:
    assert math.isnan(STATE.board_time)
    assert (STATE.stopped, STATE.watchdog_tripped) == (False, False)


@pytest.mark.parametrize("value", [STATE, STATE["J1"], JointTarget.of({"J1": 0.0}), SentTarget((), 1.0)])
def test_values_are_frozen(value: Any) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, dataclasses.fields(value)[0].name, None)


def test_flags_are_the_wires_and_have_words() -> None:
    schema = tomllib.loads((Path(__file__).parents[2] / "schema/commands.toml").read_text())
    assert {flag.name.lower(): flag.value for flag in JointFlag if flag.name} == schema["servo_flags"]
    assert str(JointFlag(0)) == "ok"
    assert str(JointFlag.TORQUE_ON | JointFlag.OVERLOAD) == "overload, torque on"
    assert JointFlag(0xFF).faults == JointFlag(0xFF) & ~(JointFlag.TORQUE_ON | JointFlag.CLAMPED)


@given(st.integers(0, 255))
def test_any_flag_byte_has_words(value: int) -> None:
    words = str(JointFlag(value))
    assert (words == "ok") == (value == 0)
    assert len(words.split(", ")) == max(1, value.bit_count())


@pytest.mark.parametrize(
    ("positions", "duration", "reason"),
    [
        ((), 1.0, "names no joint"),
        ((("J1", 0.0), ("J1", 1.0)), 1.0, "names a joint twice: J1, J1"),
        ((("J1", math.nan),), 1.0, "target of J1 is nan"),
        ((("J1", -math.inf),), 1.0, "target of J1 is -inf"),
        ((("J1", 0.0),), -0.1, "duration -0.1 s"),
        ((("J1", 0.0),), math.nan, "duration nan s"),
        ((("J1", 0.0),), math.inf, "duration inf s"),
    ],
)
def test_targets_that_make_no_sense(positions: tuple[tuple[str, float], ...], duration: float, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        JointTarget(positions, duration)


def test_a_target_of_a_mapping() -> None:
    assert JointTarget.of({"J3": 0.5, "J1": 0.0}, 2.0) == JointTarget((("J3", 0.5), ("J1", 0.0)), 2.0)
    assert JointTarget.of({"J1": 0.0}, 0.0).duration == 0.0
