"""Ctrl-C at every step of `hexwire.link` at which the interpreter runs a signal handler.

These are the end of a call of a C function, the start of a Python function, and jumps back. `sys.setprofile`
reports the first two, and an error that it raises there passes as one of a handler does. `sys.settrace` would also
raise where no handler can run, for example between the end of a `with` block and the release of its lock.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

_EVENTS = ("call", "c_return")


def _profiled(call: Callable[[], object], at: Callable[[str], None]) -> None:
    def profile(frame: FrameType, event: str, arg: Any) -> None:
        if event in _EVENTS and "/hexwire/link/" in frame.f_code.co_filename:
            at(f"{frame.f_code.co_qualname}:{frame.f_lineno} {event} {getattr(arg, '__name__', '')}")

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(before)


def places(call: Callable[[], object]) -> int:
    """Number of steps in a call."""
    seen: list[str] = []
    _profiled(call, seen.append)
    return len(seen)


def interrupted_at(step: int, call: Callable[[], object]) -> str:
    """Make a call and raise KeyboardInterrupt at a step of it; where that was, empty if there are fewer steps."""
    seen: list[str] = []

    def at(place: str) -> None:
        seen.append(place)
        if len(seen) == step:
            raise KeyboardInterrupt

    try:
        _profiled(call, at)
    except KeyboardInterrupt:
        return seen[step - 1]
    return ""
