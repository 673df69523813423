"""States, targets and what was sent: frozen values with names."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.model.states import make_state

from hexwire.errors import UsageError
from hexwire.model.state import LONGEST, JointFlag, JointState, JointTarget, SentTarget

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
    of_the_wire = {flag.name.lower(): flag.value for flag in JointFlag if flag.name and flag < 0x100}
    assert of_the_wire == schema["servo_flags"]
    assert [flag.name for flag in JointFlag if flag >= 0x100] == ["TORQUE_UNKNOWN"], "of this side only"
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
        ((("J1", 0.0),), -0.1, "duration of -0.1 s"),
        ((("J1", 0.0),), math.nan, "duration is nan"),
        ((("J1", 0.0),), math.inf, "duration is inf"),
        ((("J1", 0.0),), 1e308, "duration of 1e\\+308 s"),
        ((("J1", 0.0),), 10**400, "duration is too large"),
        ((("J1", 0.0),), None, "duration must be a number, not None"),
        ((("J1", None),), 1.0, "target of J1 must be a number, not None"),
        ((("J1", "1"),), 1.0, "target of J1 must be a number, not '1'"),
        ((("J1", True),), 1.0, "target of J1 must be a number, not True"),
        ((("J1", 10**400),), 1.0, "target of J1 is too large"),
        ((("J1", [1.0]),), 1.0, "target of J1 must be a number, not a list"),
        ((("J1", 1e300),), 1.0, "no joint reaches"),
        (((1, 0.0),), 1.0, "names joints by text"),
    ],
)
def test_invalid_targets_are_refused(positions: Any, duration: Any, reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        JointTarget(positions, duration)


def test_a_target_of_a_mapping() -> None:
    assert JointTarget.of({"J3": 0.5, "J1": 0.0}, 2.0) == JointTarget((("J3", 0.5), ("J1", 0.0)), 2.0)
    assert JointTarget.of({"J1": 0.0}, 0.0).duration == 0.0
    # Also where the values have to be converted.
    assert [JointTarget.of({"J1": 0}, duration).duration for duration in (0, 0.5, LONGEST)] == [0.0, 0.5, LONGEST]


def test_a_target_is_made_of_a_mapping_and_its_numbers_become_floats() -> None:
    target = JointTarget.of({"J1": 1, "J2": Fraction(1, 2)}, 2)  # type: ignore[dict-item]  # as numpy's numbers
    assert target == JointTarget((("J1", 1.0), ("J2", 0.5)), 2.0)
    assert {type(value) for _, value in target.positions} == {type(target.duration)} == {float}
    for wrong in (None, 5, "J1", [("J1", 0.0)]):
        with pytest.raises(UsageError, match="maps joint names to radians"):
            JointTarget.of(wrong)  # type: ignore[arg-type]  # what a caller may get wrong


@given(
    st.lists(st.tuples(st.text() | st.none(), st.from_type(object) | st.floats()), max_size=3), st.from_type(object)
)
def test_any_target_is_finite_or_refused_by_one_error(positions: Any, duration: Any) -> None:
    try:
        target = JointTarget(tuple(positions), duration)
    except UsageError:
        return
    assert all(math.isfinite(value) for _, value in target.positions)
    assert 0 <= target.duration <= LONGEST


def test_a_state_is_built_by_keyword_only() -> None:
    with pytest.raises(TypeError, match="positional"):
        JointState(("J1",))  # type: ignore[call-arg]  # what is refused here
    assert JointState.__match_args__ == ()


def test_a_joint_nobody_knows_of_is_infinitely_far_away() -> None:
    nan = math.nan
    state = make_state(1.0, nan, names=("a", "b"))
    assert state.distances({"a": 1.5, "b": 0.0}) == {"a": 0.5, "b": math.inf}
    with pytest.raises(UsageError, match="no joint 'c'"):
        state.distances({"c": 0.0})


def test_a_state_of_positions_alone_knows_nothing_else() -> None:
    state = JointState.of({"J2": 0.5, "J1": -0.5}, stamp=3.0)
    assert (state.names, state.position, state.stamp) == (("J2", "J1"), (0.5, -0.5), 3.0)
    for row in (state.velocity, state.load, state.current, state.voltage, state.temperature):
        assert all(map(math.isnan, row))
        assert len(row) == 2
    assert (state.age, state.stopped) == ((0.0, 0.0), False)
    assert state.flags == (int(JointFlag.TORQUE_UNKNOWN),) * 2
    for torque, words in ((True, "on"), (False, "off"), (None, "unknown")):
        assert JointState.of({"J1": 0.0}, stamp=0.0, torque=torque)["J1"].torque == words
    assert JointState.of({"J1": 0.0}, stamp=0.0, torque=True).torque_on == ("J1",)
    assert JointState.of({"J1": 0.0}, stamp=0.0, torque=False).flags == (0,)
    assert JointState.of({"J1": 0.0}, stamp=0.0, torque=True, flags=(0x20,), load=(0.1,)).flags == (0x20,)
