"""Tests that are asked in many ways: all of them in `make test-all`, a few in `make test`."""

from __future__ import annotations

from collections.abc import Iterable
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
