"""The documentation site, built once for all workers of a run."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.site.pages import make
from tests.studio.chromium import chromium

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built site."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with (shared / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        out = shared / "site-build"
        if not (out / "done").exists():
            make.build(out)
            (out / "done").touch()
    return out / "site"


@pytest.fixture(scope="module")
def window() -> Iterator[Browser]:
    """A browser for one module's tests."""
    with chromium(one_renderer=True) as made:
        yield made
