"""Another default for a parameter, wherever the function or class has been imported to.

A test that replaced the name in a module would reach only those who look it up there, which depends on what was
imported before.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from types import FunctionType
from typing import Any

import pytest

from hexwire.session.policy import RetryPolicy


def default(patch: pytest.MonkeyPatch, function: Callable[..., Any], **values: object) -> None:
    """Give parameters of a function, or of a class, other defaults until the patch is undone."""
    inner = inspect.unwrap(function.__init__ if isinstance(function, type) else function)
    assert isinstance(inner, FunctionType)
    keywords = dict(inner.__kwdefaults__ or {})
    plain = list(inner.__defaults__ or ())
    names = inner.__code__.co_varnames[: inner.__code__.co_argcount]
    optional = names[len(names) - len(plain) :]
    for name, value in values.items():
        if name in keywords:
            keywords[name] = value
        else:
            plain[optional.index(name)] = value
    patch.setattr(inner, "__kwdefaults__", keywords)
    patch.setattr(inner, "__defaults__", tuple(plain))


def patient_line(patch: pytest.MonkeyPatch, window: float = 1.0) -> None:
    """Longer times for answers, seconds: the board's thread may get no processor for a while.

    While a command finds out with whom it speaks, it may wait so long for an answer of dialect 1, which does not
    come: so that it asks for dialect 2 again, this is at most a second.
    """
    default(patch, RetryPolicy, window=window, dialect1_window=min(window, 1.0))
