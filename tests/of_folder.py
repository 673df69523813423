"""What the tests of a folder share, such as a node: made for the first that asks, ended after the folder's last.

A fixture of the whole session would go on beside all other tests, and a node takes a tenth of a processor from
them.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import pytest

_T = TypeVar("_T")
_THERE: dict[tuple[str, str], Any] = {}


def of_folder(request: pytest.FixtureRequest, name: str, make: Callable[[], AbstractContextManager[_T]]) -> _T:
    """Make something, or get it again.

    Args:
        request: Of a fixture whose scope is a module.
        name: What it is, in this folder.
        make: Makes it; left after the folder's last test.
    """
    folder = next(node for node in request.node.iter_parents() if isinstance(node, pytest.Dir))
    key = folder.nodeid, name
    if key not in _THERE:
        manager = make()
        _THERE[key] = manager.__enter__()

        def end() -> None:
            del _THERE[key]
            manager.__exit__(None, None, None)

        folder.addfinalizer(end)
    there: _T = _THERE[key]
    return there
