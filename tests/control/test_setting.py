from __future__ import annotations

import math

import pytest

from hexwire.control.requests.setting import Faults, Setting, rate_setting
from hexwire.errors import UsageError

RATE = rate_setting("rate", 5.0, "", high=100.0)
PAUSE = Setting("pause", 1.0, "", "s", low=0.05, high=60.0, zero=True)
FREE = Setting("free", 0.0, "")
SHARE = Setting("share", 0.0, "", low=0.0)
TEXT = Setting("id", "x", "")
SWITCH = Setting("check", True, "")
NAMES = Setting("joints", (), "")
TABLE = Setting("poses", {}, "")


@pytest.mark.parametrize(
    ("row", "words", "good", "bad"),
    [
        (RATE, "above 0 and at most 100", [0.1, 100], [0.0, -1.0, 100.1]),
        (PAUSE, "0, or 0.05 to 60", [0, 0.05, 60.0], [0.01, -0.05, 61]),
        (SHARE, "0 or more", [0, 1e9], [-1e-9]),
        (FREE, "", [-1e9, 0, 1e9], []),
    ],
)
def test_bounds(row: Setting, words: str, good: list[float], bad: list[float]) -> None:
    assert row.bounds == words
    assert [value for value in good if not row.allows(value)] == []
    assert [value for value in bad if row.allows(value)] == []


def test_a_rate_is_above_zero_hertz_and_at_most_a_thousand_unless_told() -> None:
    row = rate_setting("rate", 5.0, "how often")
    assert row == Setting("rate", 5.0, "how often", "Hz", low=0.0, high=1000.0, above=True)
    assert rate_setting("rate", 5.0, "how often", high=100.0).high == 100.0
    assert [value for value in (-1.0, 0.0, 1e-9, 1000.0, 1000.1) if row.allows(value)] == [1e-9, 1000.0]


def test_a_good_value_of_every_kind() -> None:
    faults = Faults()
    assert faults.read(RATE, 7) == 7.0
    assert isinstance(faults.read(RATE, 7), float)
    assert faults.read(TEXT, "/dev/ttyUSB0") == "/dev/ttyUSB0"
    assert faults.read(SWITCH, True) is True
    assert faults.read(NAMES, ["J2", "J1"]) == ("J2", "J1")
    assert faults.read(TABLE, {"home": {}}) == {"home": {}}
    faults.check()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0 must be above 0 and at most 100 Hz"),
        (1e3, "1000 must be above 0 and at most 100 Hz"),
        (math.nan, "must be a finite number"),
        (-math.inf, "must be a finite number"),
        (10**400, "must be a finite number"),
        (True, "must be a number, not true"),
        ("0.5", "must be a number, not the text '0.5'"),
        ([1.0], "must be a number, not the list [1.0]"),
        ({"a": 1}, "must be a number, not a table"),
        (None, "must be a number, not nothing"),
        ("x" * 100, f"must be a number, not the text '{'x' * 40}'"),
    ],
)
def test_values_that_are_not_numbers_are_refused(value: object, text: str) -> None:
    faults = Faults()
    assert faults.read(RATE, value) == 5.0
    assert faults.texts == [f"rate: {text}"]


def test_other_kinds_and_their_defaults() -> None:
    faults = Faults()
    assert faults.read(TEXT, 1234) == "x"
    assert faults.read(TEXT, False) == "x"
    assert faults.read(SWITCH, 1) is True
    assert faults.read(Setting("other", False, ""), 0) is False
    assert faults.read(NAMES, "J1") == ()
    assert faults.read(NAMES, ["J1", 2]) == ()
    assert faults.read(NAMES, ["J1", "J2", "J1", "J1"]) == ("J1", "J2")
    assert faults.read(TABLE, [1]) == {}
    assert faults.texts == [
        "id: 1234 must be text: in quotes",
        "id: must be text, not false",
        "check: must be true or false, not 1",
        "other: must be true or false, not 0",
        "joints: must be a list of names, not the text 'J1'",
        "joints: must be a list of names, not the list ['J1', 2]",
        "joints: J1 is given twice",
        "poses: must be a table of names and values, not the list [1]",
    ]


def test_an_unknown_name_suggests_the_nearest() -> None:
    faults = Faults()
    faults.unknown("wacthdog", ["watchdog", "port"])
    faults.unknown("arm/goul", ["trajectory", "goal"])
    faults.unknown("arm/xyz", ["trajectory", "goal"])
    faults.unknown("qqq", ["watchdog", "port"])
    assert faults.texts == [
        "wacthdog: unknown, did you mean watchdog?",
        "arm/goul: unknown, did you mean arm/goal?",
        "arm/xyz: unknown, there are trajectory, goal",
        "qqq: unknown, there are watchdog, port",
    ]


def test_all_faults_on_one_line() -> None:
    faults = Faults()
    faults.check()
    faults.add("port", "is\n  wrong")
    with pytest.raises(UsageError) as one:
        faults.check()
    assert str(one.value) == "1 setting is wrong: port: is wrong"
    faults.add("robot", ValueError("no robot"))
    with pytest.raises(UsageError) as two:
        faults.check()
    assert str(two.value) == "2 settings are wrong: port: is wrong; robot: no robot"


class _Ours(Faults):
    noun = "option"
    mark = "--"
    quoting = "as id=text"
    listing = "see --help"


def test_a_front_has_its_own_words() -> None:
    faults = _Ours()
    faults.unknown("wacthdog", ["watchdog"])
    faults.unknown("qqq", ["watchdog"])
    faults.read(TEXT, 7)
    assert faults.texts == [
        "--wacthdog: unknown, did you mean --watchdog?",
        "--qqq: unknown, see --help",
        "--id: 7 must be text: as id=text",
    ]
    with pytest.raises(UsageError, match=r"^3 options are wrong: "):
        faults.check()


def test_a_value_is_read_as_what_its_default_is() -> None:
    faults = Faults()
    rows = [("", "x"), (1.0, 2), (False, True), ((), ["J1"]), ({}, {"a": 1})]
    read = [faults.read(Setting("s", default, ""), value) for default, value in rows]
    assert read == ["x", 2.0, True, ("J1",), {"a": 1}]
    for default, _ in rows:
        faults.read(Setting("s", default, ""), None)
    assert len(faults.texts) == len(rows)


def test_of_thousands_of_faults_the_first_ten_are_told() -> None:
    faults = Faults()
    for i in range(5000):
        faults.unknown(f"k{i}", ["rate"])
    faults.read(NAMES, ["J1"] * 5000)
    with pytest.raises(UsageError, match=r"^5001 settings are wrong: k0: .*; k9: [^;]*; and 4991 more$"):
        faults.check()


def test_the_time_for_a_list_of_names_grows_with_its_length() -> None:
    class Counted(str):
        __slots__ = ()
        compared = 0

        def __eq__(self, other: object) -> bool:
            Counted.compared += 1
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    names = [Counted(f"J{i}") for i in range(2000)]
    faults = Faults()
    assert faults.read(NAMES, [*names, names[0], names[0]]) == tuple(names)
    assert faults.texts == ["joints: J0 is given twice"]
    assert Counted.compared < 10 * len(names)
