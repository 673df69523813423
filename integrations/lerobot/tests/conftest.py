"""What the tests share: emulated arms, LeRobot's programs, and a folder that is removed at the end."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module

import pytest
from draccus.wrappers import docstring

# Before LeRobot: it sets the folders that LeRobot reads when it is imported.
from emulated import HOME, bus, calibrated
from lerobot.utils.import_utils import register_third_party_plugins


def pytest_sessionstart() -> None:
    # As the programs of LeRobot do: it finds the plug-in by its name.
    register_third_party_plugins()
    # For the help of its options LeRobot reads the source of each configuration again in each program: 5 s.
    docstring.get_attribute_docstring = cache(docstring.get_attribute_docstring)


def pytest_sessionfinish() -> None:
    shutil.rmtree(HOME, ignore_errors=True)


@pytest.fixture
def follower() -> Iterator[str]:
    """Port of a calibrated follower; its id is black."""
    with bus("--baud", "0") as port:
        calibrated(port, "black")
        yield port


@pytest.fixture
def leader() -> Iterator[str]:
    """Port of a calibrated leader; its id is blue."""
    with bus("--leader", "--baud", "0") as port:
        calibrated(port, "blue", leader=True)
        yield port


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Runs a program of LeRobot in this process, as its console script does."""

    def run(name: str, *words: str) -> None:
        monkeypatch.setattr(sys, "argv", [name.replace("_", "-"), *words])
        import_module(f"lerobot.scripts.{name}").main()

    return run
