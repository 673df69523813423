"""Which mutants count: those that change what code does; which tests judge them, and what came of them."""

from __future__ import annotations

import ast
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests import mutation
from tests.mutation import (
    ROOMS,
    ROOT,
    SOURCE,
    Mutant,
    Room,
    Timed,
    changed_lines,
    choose,
    count_calls,
    draw,
    files_of,
    function_of,
    is_meaningful,
    judges_of,
    key_of,
    load_reasons,
    module_of,
    put_in,
)
from tests.mutation_run import Judge

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


def test_coroutines_have_mutants_that_count() -> None:
    before = BEFORE.replace("def", "async def")
    assert is_meaningful(before, before.replace("x > 3", "x >= 3"))
    assert not is_meaningful(before, before.replace('"too much"', "None"))


def test_what_a_value_shows_of_itself_does_not_count() -> None:
    assert not is_meaningful("def __repr__(self):\n    return a + b", "def __repr__(self):\n    return a - b")


def test_the_lines_that_differ_are_reported() -> None:
    assert changed_lines(BEFORE, BEFORE.replace("x > 3", "x >= 3")) == ("-if x > 3:", "+if x >= 3:")


MODULE = """
def f(x):
    return x + 1

class A:
    @staticmethod
    def f(x):
        if x:
            return 1
        return 2

    def g(self): ...

    async def h(self):
        return 3
"""


@pytest.mark.parametrize(
    ("key", "function", "old", "new"),
    [
        ("x_f__mutmut_3", "def f(x):\n    return x - 1\n", "x + 1", "x - 1"),
        ("xǁAǁf__mutmut_1", "def f(x):\n    if x:\n        return 1\n    return None\n", "return 2", "return None"),
        ("xǁAǁh__mutmut_1", "async def h(self):\n    return 4\n", "return 3", "return 4"),
    ],
)
def test_a_mutant_takes_the_place_of_its_function_in_the_source(
    key: str, function: str, old: str, new: str
) -> None:
    assert put_in(MODULE, key, function) == MODULE.replace(old, new)


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
        source = mutation.source_of(Path(file)).read_text()
        lines = {line.strip() for line in source.splitlines()}
        assert f"def {function}(" in source, place
        assert {line[1:] for line in change if line.startswith("-")} <= lines, f"{place} has changed: {change}"
        assert reason


def test_every_module_is_in_a_room_and_every_room_has_tests() -> None:
    files = [path for room in ROOMS for path in files_of(room)]
    generated = {SOURCE / name for name in mutation.GENERATED}
    every = {path for source in (SOURCE, *mutation.PACKAGES.values()) for path in source.rglob("*.py")}
    assert sorted(files) == sorted(every - generated)
    assert [start for room in ROOMS for start in judges_of(room) if not (ROOT / start).exists()] == []


def test_a_mutant_says_its_module_and_function() -> None:
    assert module_of(Path("studio/pages/arm.py")) == "hexwire.studio.pages.arm"
    assert module_of(Path("wire/__init__.py")) == "hexwire.wire"
    assert module_of(Path("zenoh_ros2/cdr.py")) == "zenoh_ros2.cdr"
    assert function_of("hexwire.bus.machine.xǁMachineǁ_ask__mutmut_3") == "Machine._ask"
    assert function_of("hexwire.units.x_to_degrees__mutmut_1") == "to_degrees"


def test_a_counted_module_says_which_functions_are_called() -> None:
    text = count_calls('"""Text."""\nfrom __future__ import annotations\n' + MODULE, "hexwire.two")
    called: list[str] = []
    space: dict[str, object] = {}
    text = text.replace("from hexwire.mutation_calls import note as _note_call", "")
    exec(compile(text, "two", "exec"), {"_note_call": called.append}, space)
    space["f"](1)  # type: ignore[operator]
    space["A"].f(0)  # type: ignore[attr-defined]
    assert called == ["hexwire.two:f", "hexwire.two:A.f"]
    assert ast.get_docstring(ast.parse(text)) == "Text."


def test_tests_that_are_not_slow_and_quick_ones_judge_first() -> None:
    def test(seconds: float, slow: bool = False, passed: bool = True, calls: str = "f") -> Timed:
        return Timed(seconds, slow, passed, frozenset({calls}))

    tests = {
        "b::1": test(0.01),
        "a::1": test(0.02),
        "a::2": test(0.01),
        "a::3": test(9.0),
        "a::4": test(0.001, slow=True),
        "a::5": test(0.1),
        "a::6": test(0.1, passed=False),
        "a::7": test(0.1, calls="g"),
    }
    assert len(choose(tests | {"": test(0.0)}, "")) == 7
    assert choose(tests, "f") == ["a::2", "a::1", "b::1", "a::5", "a::3", "a::4"]


FIVE = """
def one(x):
    return 1

def two(x):
    return 2

def wait(x):
    return x

def early(x):
    return x

ONE = early(1)

class Pair(tuple):
    def __new__(cls, *values):
        return super().__new__(cls, values)

    @classmethod
    def make(cls, value=1):
        return cls(value, value)
"""

TESTS_OF_FIVE = """
import subprocess, sys, time
import five
from five import one, Pair

def test_one():
    assert one(0) == 1

def test_two():
    done = subprocess.run([sys.executable, "-c", "import five; print(five.two(0))"], capture_output=True, text=True)
    assert done.stdout == "2\\n"

def test_wait():
    while five.wait(1) != 1:
        time.sleep(0.01)

def test_early():
    assert five.ONE == 1

def test_pair():
    assert len(Pair.make()) == 2
"""


@pytest.mark.slow
@pytest.mark.system
def test_a_mutant_is_judged_by_its_tests_until_one_notices(tmp_path: Path) -> None:
    source, out = tmp_path / "five.py", tmp_path / "out"
    source.write_text(FIVE)
    (tmp_path / "test_five.py").write_text(TESTS_OF_FIVE)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow: takes long\n")

    def mutant(key: str, function: str, change: tuple[str, str], new: str, *tests: str) -> dict[str, object]:
        limit = 1.0 if key == "for ever" else 30.0
        names = [(f"test_five.py::test_{test}", 0.01) for test in tests]
        more = names if key == "import" else []
        code = {"function": function, "source": new, "limit": limit, "text": FIVE.replace(*change), "all": more}
        return {"key": key, "module": "five", "file": str(source), "tests": names, **code}

    mutants = [
        mutant("here", "one", ("return 1", "return 3"), "def one(x):\n    return 3\n", "two", "one", "pair"),
        mutant("in a program", "two", ("return 2", "return 3"), "def two(x):\n    return 3\n", "one", "two"),
        mutant("unseen", "two", ("return 2", "return 3"), "def two(x):\n    return 3\n", "one"),
        mutant("nowhere", "two", ("return 2", "return 3"), "def two(x):\n    return 3\n"),
        mutant("for ever", "wait", ("return x", "return None"), "def wait(x):\n    return None\n", "wait"),
        mutant("import", "early", ("return x\n\nONE", "return 2\n\nONE"), "def early(x):\n    return 2\n", "early"),
        mutant("default", "Pair.make", ("=1", "=2"), "def make(cls, value=2):\n    return cls(value)\n", "pair"),
    ]
    orders = tmp_path / "orders.json"
    orders.write_text(json.dumps({"tests": ["test_five.py"], "mutants": mutants, "out": str(out)}))
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    more = {"PYTHONPATH": paths, "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "tests.mutation_run", str(orders)]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ | more, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert [(row["key"], row["verdict"], row["by"].removeprefix("test_five.py::test_")) for row in rows] == [
        ("here", "failed", "one"),
        ("in a program", "failed", "two"),
        ("unseen", "lives", "one"),
        ("nowhere", "untested", ""),
        ("for ever", "late", "wait"),
        ("import", "failed", "early"),
        ("default", "failed", "pair"),
    ]
    assert source.read_text() == FIVE


@pytest.mark.parametrize(
    ("tries", "verdict"),
    [
        (["hung", "hung", "lives"], "hung"),
        (["hung", "hung", "hung"], "unsure"),
        (["hung", "lives"], "lives"),
        (["hung", "failed", "lives"], "failed"),
        (["failed", "failed", "lives"], "failed"),
        (["failed", "failed", "failed"], "unsure"),
        (["failed", "lives"], "lives"),
    ],
)
def test_what_a_busy_machine_does_is_not_taken_for_what_a_mutant_does(
    tries: list[str], verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.py"
    file.write_text("whole")
    mutant = {"key": "m", "file": str(file), "text": "mutated", "limit": 30.0}
    mutant |= {"tests": [("a", 0.1), ("b", 0.1)], "all": []}
    out = io.StringIO()
    judge = Judge([mutant], {}, out)
    seen = []

    def tell(mutant: object, tests: dict[str, float], *, install: bool = True) -> tuple[str, str]:
        seen.append((list(tests), install, file.read_text()))
        return tries[len(seen) - 1], "b"

    monkeypatch.setattr(judge, "_try", tell)
    items = [SimpleNamespace(nodeid="a"), SimpleNamespace(nodeid="b")]
    assert judge.pytest_runtestloop(SimpleNamespace(items=items))  # type: ignore[arg-type]
    line = json.loads(out.getvalue())
    assert (line["verdict"], line["by"]) == (verdict, "b")
    attempts = [(["a", "b"], True, "mutated"), (["b"], True, "mutated"), (["b"], False, "whole")]
    assert seen == attempts[: len(tries)], "the last one is without the mutant"


def test_a_verdict_holds_as_long_as_the_source_and_the_tests_that_told_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, tests = tmp_path / "src/hexwire", tmp_path / "tests"
    monkeypatch.setattr(mutation, "ROOT", tmp_path)
    monkeypatch.setattr(mutation, "SOURCE", code)
    monkeypatch.setattr(mutation, "WORK", tmp_path / "work")
    (code / "bus").mkdir(parents=True)
    (tests / "bus").mkdir(parents=True)
    (code / "bus/a.py").write_text("1")
    for name in ("test_a.py", "test_b.py"):
        (tests / "bus" / name).write_text("1")
    killed, slowly, living = (Mutant(f"m{i}", f"bus/a.py:f{i}", ()) for i in range(3))
    room = Room("bus", quick=False)
    rows = [
        {"key": key_of(killed), "verdict": "failed", "by": "tests/bus/test_a.py::t", "slow": False},
        {"key": key_of(slowly), "verdict": "failed", "by": "tests/bus/test_a.py::u", "slow": True},
        {"key": key_of(living), "verdict": "lives", "by": "tests/bus/test_b.py::t", "slow": False},
    ]
    file = room._file_digest("tests/bus/test_a.py::t")
    more = {
        "source": room.source,
        "tests": room.tests,
        "file": file,
        "typed": False,
        "seconds": 1.0,
        "quick": False,
    }
    (room.folder / "verdicts.jsonl").write_text("".join(json.dumps(row | more) + "\n" for row in rows) + '{"key"')

    def left(quick: bool = False) -> list[Mutant]:
        return Room("bus", quick).recall([killed, slowly, living])

    assert left() == []
    assert [mutant.killed for mutant in (killed, slowly, living)] == [True, True, False]
    assert [mutant.killed_quickly for mutant in (killed, slowly, living)] == [True, False, False]
    assert left(quick=True) == []
    (tests / "bus/test_b.py").write_text("2")
    assert left() == [living]
    assert left(quick=True) == [slowly, living]
    (tests / "bus/test_a.py").write_text("2")
    assert left() == [killed, slowly, living]
    (tests / "bus/test_a.py").write_text("1")
    (code / "bus/a.py").write_text("2")
    assert left() == [killed, slowly, living]
