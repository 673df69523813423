"""What `import hexwire` loads, and what its lazy names lead to."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

import hexwire

HEAVY = {"rich", "click", "numpy", "serial", "cryptography"}


def _loaded_by(statement: str) -> set[str]:
    """Names of the modules that a fresh interpreter holds after `statement`."""
    program = f"import json, sys; {statement}; print(json.dumps(sorted(sys.modules)))"
    result = subprocess.run(
        [sys.executable, "-I", "-c", program], check=True, capture_output=True, text=True, timeout=60
    )
    return set(json.loads(result.stdout))


def test_import_hexwire_loads_nothing_heavy() -> None:
    loaded = _loaded_by("import hexwire")
    assert not HEAVY & loaded


def test_import_hexwire_loads_no_layer() -> None:
    loaded = {name for name in _loaded_by("import hexwire") if name.split(".")[0] == "hexwire"}
    assert loaded == {"hexwire", "hexwire.errors"}


def test_a_heavy_import_would_be_seen() -> None:
    assert HEAVY & _loaded_by("import hexwire, click") == {"click"}


@pytest.mark.parametrize("name", hexwire.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(hexwire, name) is not None
    assert name in dir(hexwire)


def test_lazy_names_are_those_the_type_checker_sees() -> None:
    tree = ast.parse(Path(hexwire.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.asname or alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == hexwire._LAZY
    assert set(seen) <= set(hexwire.__all__)


def test_a_lazy_name_is_the_object_of_its_module() -> None:
    for name, module in hexwire._LAZY.items():
        assert getattr(hexwire, name) is getattr(importlib.import_module(module), name), name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        hexwire.nonsense  # noqa: B018
