"""The scripts of `release/`, which are no package, as modules; and uv as the Makefile installs it."""

from __future__ import annotations

import importlib.util
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


@cache
def script(name: str) -> Any:
    """Import release/NAME.py once."""
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location(f"release_{name}", ROOT / f"release/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # A test may not see the folders that the script has put on the path.
    sys.path[:] = before
    return module


def uv() -> str:
    """Path of uv."""
    version = re.search(r"^UV_VERSION := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert version is not None
    return str(ROOT / f".tools/uv-{version[1]}/bin/uv")
