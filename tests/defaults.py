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
