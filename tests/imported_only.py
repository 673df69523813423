"""A plug-in for pytest: import every test module, which compiles it, and look for no tests in it."""

from __future__ import annotations


def pytest_pycollect_makeitem() -> list[object]:
    """Nothing in a module is a test."""
    return []


def pytest_collection_finish() -> None:
    """Let Hypothesis read the constants of all modules: it keeps them in files, where the workers find them."""
    from hypothesis.internal.conjecture.providers import _get_local_constants

    _get_local_constants()
