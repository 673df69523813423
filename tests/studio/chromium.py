"""Debian's Chromium, driven by Playwright: how it is started, for tests, benchmarks and pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser

__all__ = ["PROGRAM", "chromium"]

PROGRAM = "/usr/bin/chromium-headless-shell"
"""Chromium without the frame of a browser around its pages, which takes a quarter less of the processor."""
_ARGUMENTS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync "
    # Two cameras that nobody has to allow.
    "--use-fake-device-for-media-stream=device-count=2 --use-fake-ui-for-media-stream"
)
_ONE_RENDERER = "--disable-site-isolation-trials --renderer-process-limit=1"
"""A new page takes the process of the last one: a third less processor time for each page."""


@contextmanager
def chromium(*, one_renderer: bool = False) -> Iterator[Browser]:
    """A browser without a window, history or downloads of anybody's.

    Args:
        one_renderer: All pages of a context are drawn by one process; for tests, which show one after the other.
    """
    from playwright.sync_api import sync_playwright

    arguments = f"{_ARGUMENTS} {_ONE_RENDERER}" if one_renderer else _ARGUMENTS
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        made = playwright.chromium.launch(
            executable_path=PROGRAM, headless=True, args=arguments.split(), downloads_path=folder
        )
        try:
            yield made
        finally:
            made.close()
