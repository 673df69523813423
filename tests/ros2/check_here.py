"""docs/ros2_check.py in this process: instead of a `ros2` that it starts, a function answers."""

from __future__ import annotations

import importlib.util
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHECK = Path(__file__).resolve().parents[2] / "docs" / "ros2_check.py"
WAIT = "<wait>"
"""At the end of an answer: the program runs until it is interrupted."""


class Started:
    """A program that runs until it is ended, or has ended by itself."""

    def __init__(self, runs: bool) -> None:
        self._runs = runs

    def wait(self, timeout: float) -> int:
        if self._runs:
            raise subprocess.TimeoutExpired("ros2", timeout)
        return 1

    def end(self) -> None:
        self._runs = False


def load_check(monkeypatch: pytest.MonkeyPatch, answer: Callable[[tuple[str, ...]], str]) -> Any:
    """Its module.

    Args:
        monkeypatch: Replaces what starts programs.
        answer: Gets the words after `ros2`; returns what that prints.
    """
    spec = importlib.util.spec_from_file_location("ros2_check", CHECK)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def run(_: object, *words: str, seconds: float | None = None, patience: float = 0.0) -> str:
        said = answer(words)
        if said.endswith(WAIT) and seconds is None:
            raise module.Failed(f"ros2 {' '.join(words)} did not end in {patience:g} s")
        return said.removesuffix(WAIT) + "\n"

    monkeypatch.setattr(module.Programs, "run", run)

    def start(program: str, *words: str) -> Started:
        return Started(answer(words if program == "ros2" else (program, *words)).endswith(WAIT))

    monkeypatch.setattr(module, "start", start)
    monkeypatch.setattr(module, "end_all", Started.end)
    return module
