"""Which mutants count: those that change what code does."""

from __future__ import annotations

import pytest
from tests.mutation import ROOT, Mutant, changed_lines, draw, is_meaningful, load_reasons, put_in

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


@pytest.mark.parametrize(
    ("before", "after", "counts"),
    [
        ('return f"{x} a" if x > 3 else f"{x} b"', 'return f"{x} a" if x >= 3 else f"{x} b"', False),
        ('t = f" {x}" if x else ""', 't = f" {x}" if not x else ""', False),
        ('return "a" if x > 3 else "b"', 'return "a" if x >= 3 else "b"', True),
        ('return f"{x}" if f(x) else ""', 'return f"{x}" if f(None) else ""', True),
        ('return "a" if x > 3 else None', 'return "a" if x >= 3 else None', True),
        ('return "a" if f(x) else "b"', 'return "a" if f(None) else "b"', True),
        ("return 1 if x > 3 else 2", "return 1 if x >= 3 else 2", True),
        ("return 1 if x > 3 else 1.5", "return 1 if x > 3 else 2.5", True),
        ("for i in x:\n  if i:\n   break", "for i in x:\n  if i:\n   return", False),
        ("if x:\n  while x:\n   break", "if x:\n  while x:\n   return", False),
        ("for i in x:\n  break\n return 1", "for i in x:\n  return\n return 1", True),
        ("for i in x:\n  for j in i:\n   break", "for i in x:\n  for j in i:\n   return", True),
        ("for i in x:\n  break\n else:\n  g()", "for i in x:\n  return\n else:\n  g()", True),
        ("while x:\n  continue", "while x:\n  break", True),
        ("a = False\n while not a:\n  a = g()", "a = None\n while not a:\n  a = g()", False),
        ("a = False\n if x and a:\n  g()", "a = True\n if x and a:\n  g()", True),
        ("a = False\n if a:\n  g()\n return a", "a = None\n if a:\n  g()\n return a", True),
        ("a = 0\n a += x\n if a:\n  g()", "a = None\n a += x\n if a:\n  g()", True),
        ("a = False\n if a is None:\n  g()", "a = None\n if a is None:\n  g()", True),
        ('open(x, encoding="ascii")', "open(x, encoding=None)", False),
        ('open(x, encoding="ascii")', 'open(None, encoding="ascii")', True),
    ],
)
def test_texts_that_are_chosen_and_loops_that_end(before: str, after: str, counts: bool) -> None:
    assert is_meaningful(f"def f(x):\n {before}", f"def f(x):\n {after}") is counts


def test_what_a_value_shows_of_itself_does_not_count() -> None:
    assert not is_meaningful("def __repr__(self):\n    return a + b", "def __repr__(self):\n    return a - b")


def test_the_lines_that_differ_are_reported() -> None:
    assert changed_lines(BEFORE, BEFORE.replace("x > 3", "x >= 3")) == ("-if x > 3:", "+if x >= 3:")


SOURCE = """
def f(x):
    return x + 1

class A:
    @staticmethod
    def f(x):
        if x:
            return 1
        return 2

    def g(self): ...
"""


@pytest.mark.parametrize(
    ("key", "function", "old", "new"),
    [
        ("x_f__mutmut_3", "def f(x):\n    return x - 1\n", "x + 1", "x - 1"),
        ("xǁAǁf__mutmut_1", "def f(x):\n    if x:\n        return 1\n    return None\n", "return 2", "return None"),
    ],
)
def test_a_mutant_takes_the_place_of_its_function_in_the_source(
    key: str, function: str, old: str, new: str
) -> None:
    assert put_in(SOURCE, key, function) == SOURCE.replace(old, new)


def test_a_sample_is_random_and_stays_when_other_code_changes() -> None:
    found = [Mutant(f"m{i}", f"wire/a.py:f{i}", (f"-{i}", f"+{i + 1}")) for i in range(200)]
    sample = draw(found, 40, 1)
    assert len({mutant.name for mutant in sample}) == 40
    assert len(draw(found, 300, 1)) == 200
    assert {mutant.name for mutant in draw(found, 40, 2)} != {mutant.name for mutant in sample}
    # Half of the code is gone, and mutmut numbers the rest anew.
    rest = [Mutant(f"n{i}", mutant.place, mutant.change) for i, mutant in enumerate(found[100:])]
    kept = {mutant.place for mutant in sample} & {mutant.place for mutant in rest}
    assert 10 < len(kept) < 30
    assert kept <= {mutant.place for mutant in draw(rest, 40, 1)}


def test_every_reason_is_for_code_that_is_still_there() -> None:
    for (place, change), reason in load_reasons().items():
        file, _, function = place.partition(":")
        source = (ROOT / "src/hexwire" / file).read_text()
        lines = {line.strip() for line in source.splitlines()}
        assert f"def {function}(" in source, place
        assert {line[1:] for line in change if line.startswith("-")} <= lines, f"{place} has changed: {change}"
        assert reason
