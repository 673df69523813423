"""What builds the site, for its tests: the modules of ``docs/site``, which is no package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "site"))

import commands  # noqa: E402  # found by the line above
import error_pages  # noqa: E402
import error_texts  # noqa: E402
import make  # noqa: E402
import pages  # noqa: E402
from pages import blocks  # noqa: E402

__all__ = ["ROOT", "blocks", "commands", "error_pages", "error_texts", "make", "pages", "repository_pages"]

HIDDEN = ("build", "node_modules")


def repository_pages() -> list[Path]:
    """Every page of the repository, from its root; what others have installed below it is not looked through."""
    found = []
    for folder, below, files in os.walk(ROOT):
        below[:] = [name for name in below if name not in HIDDEN and not name.startswith(".")]
        found += [(Path(folder) / name).relative_to(ROOT) for name in files if name.endswith(".md")]
    return sorted(found)
