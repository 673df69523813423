"""Tests that are asked in many ways: all of them in `make test-all`, a few in `make test`; and which those are."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest


def few(names: str, cases: Iterable[Any], *quick: Any) -> pytest.MarkDecorator:
    """Parametrise a test whose cases differ in numbers or combinations, so that a few of them prove the decision.

    Args:
        names: Of the arguments, as `parametrize` takes them.
        cases: All of them: values, or tuples of values.
        quick: Those that are not slow.
    """
    rows = [case if isinstance(case, tuple) else (case,) for case in cases]
    chosen = [case if isinstance(case, tuple) else (case,) for case in quick]
    assert chosen, "a test without a quick case is marked slow as a whole"
    strange = [row for row in chosen if row not in rows]
    assert not strange, f"not among the cases: {strange}"
    slow = pytest.mark.slow
    return pytest.mark.parametrize(names, [pytest.param(*row, marks=() if row in chosen else slow) for row in rows])


@functools.cache
def _module(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


@functools.cache
def _tests(file: Path) -> list[ast.FunctionDef]:
    body = _module(file).body
    methods = [node for each in body if isinstance(each, ast.ClassDef) for node in each.body]
    return [
        node for node in (*body, *methods) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]


def all_tests(file: Path) -> frozenset[str]:
    """Names of the tests of a file."""
    return frozenset(test.name for test in _tests(file))


@functools.cache
def slow_tests(file: Path) -> frozenset[str]:
    """Those of them that only `make test-all` runs."""
    assigned = [node for node in _module(file).body if isinstance(node, ast.Assign)]
    marks = [ast.unparse(node.value) for node in assigned if "pytestmark" in ast.unparse(node.targets[0])]
    if any("mark.slow" in mark for mark in marks):
        return all_tests(file)
    return frozenset(
        test.name
        for test in _tests(file)
        if any(ast.unparse(mark) == "pytest.mark.slow" for mark in test.decorator_list)
    )
