from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from hexwire.errors import UsageError
from hexwire.ros1.parameters import PARAMETERS, Faults, Parameter

RATE = Parameter("rate", 5.0, "", "Hz", low=0.0, high=100.0, above=True)
PAUSE = Parameter("pause", 1.0, "", "s", low=0.05, high=60.0, zero=True)
FREE = Parameter("free", 0.0, "")
SHARE = Parameter("share", 0.0, "", low=0.0)


def test_rows_are_whole() -> None:
    names = [row.name for row in PARAMETERS]
    assert len(set(names)) == len(names) == 25
    for row in PARAMETERS:
        assert row.help, row.name
        assert "\n" not in row.help
        if isinstance(row.default, float):
            assert row.allows(row.default), row.name
            assert math.isfinite(row.high), f"{row.name}: a number without an end is a typing error away from harm"
        else:
            assert isinstance(row.default, str | bool | tuple | Mapping), row.name


def test_defaults_as_a_parameter_file_has_them() -> None:
    texts = {row.name: row.default_text for row in PARAMETERS}
    assert texts["port"] == '""'
    assert texts["robot"] == "hex7bot"
    assert texts["publish_rate"] == "100.0"
    assert texts["check_table"] == "true"
    assert texts["joints"] == "[]"
    assert texts["poses"] == "{}"


@pytest.mark.parametrize(
    ("row", "words", "good", "bad"),
    [
        (RATE, "above 0 and at most 100", [0.1, 100], [0.0, -1.0, 100.1]),
        (PAUSE, "0, or 0.05 to 60", [0, 0.05, 60.0], [0.01, -0.05, 61]),
        (SHARE, "0 or more", [0, 1e9], [-1e-9]),
        (FREE, "", [-1e9, 0, 1e9], []),
    ],
)
def test_bounds(row: Parameter, words: str, good: list[float], bad: list[float]) -> None:
    assert row.bounds == words
    assert [value for value in good if not row.allows(value)] == []
    assert [value for value in bad if row.allows(value)] == []


def test_a_good_value_of_every_kind() -> None:
    faults = Faults()
    assert faults.number("rate", 7, RATE) == 7.0
    assert isinstance(faults.number("rate", 7, RATE), float)
    assert faults.text("port", "/dev/ttyUSB0") == "/dev/ttyUSB0"
    assert faults.switch("check", True) is True
    assert faults.names("joints", ["J2", "J1"]) == ("J2", "J1")
    assert faults.table("poses", {"home": {}}) == {"home": {}}
    faults.check()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0 must be above 0 and at most 100 Hz"),
        (1e3, "1000 must be above 0 and at most 100 Hz"),
        (math.nan, "nan is not a number that makes sense here"),
        (-math.inf, "-inf is not a number that makes sense here"),
        (10**400, "inf is not a number that makes sense here"),
        (True, "must be a number, not true"),
        ("0.5", "must be a number, not the text '0.5'"),
        ([1.0], "must be a number, not the list [1.0]"),
        ({"a": 1}, "must be a number, not a table"),
        (None, "must be a number, not None"),
        ("x" * 100, f"must be a number, not the text '{'x' * 56}..."),
    ],
)
def test_what_is_no_number(value: object, text: str) -> None:
    faults = Faults()
    assert faults.number("rate", value, RATE) == 5.0
    assert faults.texts == [f"~rate: {text}"]


def test_other_kinds_and_their_defaults() -> None:
    faults = Faults()
    assert faults.text("id", 1234, "x") == "x"
    assert faults.text("id", False, "x") == "x"
    assert faults.switch("check", 1, default=True) is True
    assert faults.names("joints", "J1") == ()
    assert faults.names("joints", ["J1", 2]) == ()
    assert faults.names("joints", ["J1", "J2", "J1", "J1"]) == ("J1", "J2")
    assert faults.table("poses", [1]) == {}
    assert faults.texts == [
        '~id: 1234 must be text: in quotes, or with type="str" in a launch file',
        "~id: must be text, not false",
        "~check: must be true or false, not 1",
        "~joints: must be a list of names, not the text 'J1'",
        "~joints: must be a list of names, not the list ['J1', 2]",
        "~joints: J1 is there twice",
        "~poses: must be a table of names and values, not the list [1]",
    ]


def test_an_unknown_name_suggests_the_nearest() -> None:
    faults = Faults()
    faults.unknown("wacthdog", ["watchdog", "port"])
    faults.unknown("arm/goul", ["trajectory", "goal"])
    faults.unknown("arm/xyz", ["trajectory", "goal"])
    faults.unknown("qqq", ["watchdog", "port"])
    assert faults.texts == [
        "~wacthdog: unknown, did you mean ~watchdog?",
        "~arm/goul: unknown, did you mean ~arm/goal?",
        "~arm/xyz: unknown, there are trajectory, goal",
        "~qqq: unknown, 'hexwire-ros1 --help' lists them",
    ]


def test_all_faults_on_one_line() -> None:
    faults = Faults()
    faults.check()
    faults.add("port", "is\n  wrong")
    with pytest.raises(UsageError) as one:
        faults.check()
    assert str(one.value) == "1 parameter is wrong: ~port: is wrong"
    faults.add("robot", ValueError("no robot"))
    with pytest.raises(UsageError) as two:
        faults.check()
    assert str(two.value) == "2 parameters are wrong: ~port: is wrong; ~robot: no robot"
