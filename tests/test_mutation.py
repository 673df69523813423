"""Which mutants count: those that change what code does."""

from __future__ import annotations

import pytest
from tests.mutation import changed_lines, is_meaningful

BEFORE = """
def f(x):
    if x > 3:
        raise ValueError("too much")
    _log.debug("seen")
    return cast("int", x + 1)
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("x > 3", "x >= 3"),
        ("x + 1", "x - 1"),
        ("x + 1", "None"),
        ("if x > 3", "if not (x > 3)"),
        ("ValueError", "KeyError"),
    ],
)
def test_a_change_of_what_is_done_counts(old: str, new: str) -> None:
    assert is_meaningful(BEFORE, BEFORE.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"too much"', "None"),
        ('"seen"', '"XXseenXX"'),
        ('"int"', "None"),
        ('_log.debug("seen")', "_log.debug(None)"),
    ],
)
def test_a_change_of_what_is_said_does_not(old: str, new: str) -> None:
    assert not is_meaningful(BEFORE, BEFORE.replace(old, new))


def test_what_a_value_shows_of_itself_does_not_count() -> None:
    assert not is_meaningful("def __repr__(self):\n    return a + b", "def __repr__(self):\n    return a - b")


def test_the_lines_that_differ_are_told() -> None:
    assert changed_lines(BEFORE, BEFORE.replace("x > 3", "x >= 3")) == ("-if x > 3:", "+if x >= 3:")
