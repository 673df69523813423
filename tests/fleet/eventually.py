"""Waiting for what another thread or process does, and processes that end with a test."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")

PATIENCE = 20.0


def eventually(what: Callable[[], T]) -> T:
    """The first true answer; fails if there is none for long."""
    deadline = time.monotonic() + PATIENCE
    while not (found := what()):
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.02)
    return found


@contextmanager
def hexwire_program(*words: object) -> Iterator[subprocess.Popen[str]]:
    """`hexwire` with these words in a process of its own, which a failing test does not leave behind."""
    with subprocess.Popen(
        [sys.executable, "-m", "hexwire.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as program:
        try:
            yield program
        except BaseException:
            program.kill()
            raise
