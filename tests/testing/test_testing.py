"""What is public of `hexwire.testing`, and what it says where pytest is missing."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import hexwire.testing


def test_the_suites_are_public() -> None:
    assert hexwire.testing.__all__ == ["LinkConformance", "RobotConformance"]
    assert all(hasattr(hexwire.testing, name) for name in hexwire.testing.__all__)


def test_without_pytest_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pytest", None)
    monkeypatch.delitem(sys.modules, "hexwire.testing")
    with pytest.raises(ImportError, match=r"pip install 'hexwire\[testing\]'"):
        importlib.import_module("hexwire.testing")


def test_nothing_else_of_hexwire_loads_pytest() -> None:
    command = "import sys, hexwire, hexwire.cli.main, hexwire.drivers.registry; print('pytest' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "False\n"
