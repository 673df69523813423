"""What builds the site, for its tests: the modules of ``docs/site``, which is no package."""

from __future__ import annotations

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

__all__ = ["ROOT", "blocks", "commands", "error_pages", "error_texts", "make", "pages"]
