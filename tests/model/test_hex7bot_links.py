from __future__ import annotations

import math

import pytest

from hexwire.errors import ConfigError, UsageError
from hexwire.model.arms.hex7bot.links import LINK_SETS, link_set, parse_link_set

TEXT = """\
name = "bench"
a = 120
b = 40
c = 190.5
d = 24.28
e = 79
f = 30
g = 12
h = 34.8
offset = 90
elbow = [12, 160]
"""


def test_published_sets_by_name() -> None:
    assert link_set("v1") is LINK_SETS["V1"]
    with pytest.raises(UsageError, match="no link set 'C'; use A, B, V1, or a TOML file"):
        link_set("C")


def test_own_set() -> None:
    own = parse_link_set(TEXT, file="bench.toml")
    assert (own.name, own.source) == ("bench", "bench.toml")
    assert own.c == pytest.approx(0.1905)
    assert own.elbow == pytest.approx((math.radians(12), math.radians(160)))
    assert own.ranges == LINK_SETS["A"].ranges


def test_own_limits() -> None:
    own = parse_link_set(TEXT + "limits = [[0, 90], [1, 2], [3, 4], [5, 6], [7, 8], [9, 10.5]]\n")
    assert [round(math.degrees(r.maximum), 6) for r in own.ranges] == [90, 2, 4, 6, 8, 10.5]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("c = 190.5", "cc = 190.5", "bench.toml:4:6: cc is an unknown key, did you mean c?"),
        ("c = 190.5", "colour = 190.5", "bench.toml:4:10: colour is an unknown key; known: a, b, c, d, e, f, g, h"),
        ("c = 190.5", "", "bench.toml: c is missing"),
        ("c = 190.5", "c = 'long'", "bench.toml:4:5: c must be a number, not the text 'long'"),
        ("c = 190.5", "c = -1", "bench.toml:4:5: c is -1, but must be 0.001 to 100000 mm"),
        ("c = 190.5", "c = 0", "bench.toml:4:5: c is 0, but must be 0.001 to 100000 mm"),
        ("c = 190.5", "c = nan", "bench.toml:4:5: c must be a finite number"),
        ("c = 190.5", "c = true", "bench.toml:4:5: c must be a number, not true"),
        ("offset = 90", "", "bench.toml: offset is missing"),
        ("offset = 90", "offset = []", "bench.toml:10:10: offset must be a number, not the list []"),
        ("[12, 160]", "[160, 12]", "bench.toml:11:9: elbow must be a pair of degrees, the lower first"),
        ("[12, 160]", "[12, 181]", "bench.toml:11:9: elbow[1] is 181, but must be 0 to 180 deg"),
        ("[12, 160]", "3", "bench.toml:11:9: elbow must be a list, not 3"),
        ("[12, 160]", "[10, 165]\nlimits = [[1, 2]]", "bench.toml:12:10: limits has 1 values, but must have 6"),
        ('"bench"', "7", "bench.toml:1:8: name must be text, not 7"),
        ("a = 120", "a = = 1", "bench.toml:2:5: not TOML"),
    ],
)
def test_mistakes_are_named_with_their_line(old: str, new: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_link_set(TEXT.replace(old, new), file="bench.toml")
    assert str(caught.value).startswith(message)
