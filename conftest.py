"""Fixtures for code blocks in documents: in a fence ``python fixture:emulated_arm`` an arm is plugged in."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from tests.emulator.terminals import serving

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer


@pytest.fixture
def emulated_arm(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An emulated Hex7Bot on a serial port that HEXWIRE_PORT names; gives its path."""
    with serving(PtyServer(make_hex7bot_board(start=time.monotonic()))) as path:
        monkeypatch.setenv("HEXWIRE_PORT", path)
        yield path
