"""Notes the calls of functions: `mutation.py` puts it into the package whose functions call `note`.

Owns what was called since the last look, in the process that looks and in all that it starts. These add lines to a
file; one that runs on from test to test says a name again, but not each time.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

__all__ = ["note", "take"]

_FILE = Path(__file__).with_name("calls")
_AGAIN = 0.05
_called: set[str] = set()
_said: dict[str, float] = {}
_looker = 0
_read = 0
# Tests replace some of these.
_getpid, _monotonic, _open, _write, _close = os.getpid, time.monotonic, os.open, os.write, os.close


def note(name: str) -> None:
    """A function is called."""
    if _getpid() == _looker:
        _called.add(name)
        return
    now = _monotonic()
    if now - _said.get(name, -1.0) < _AGAIN:
        return
    _said[name] = now
    file = _open(_FILE, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o666)
    _write(file, f"{name}\n".encode())
    _close(file)


def take() -> set[str]:
    """What was called since this was asked last; makes this process the one that looks."""
    global _looker, _read
    _looker = os.getpid()
    called = set(_called)
    _called.clear()
    if _FILE.is_file():
        with _FILE.open("rb") as file:
            file.seek(_read)
            data = file.read()
        _read += len(data)
        called |= set(data.decode().split("\n")) - {""}
    return called
