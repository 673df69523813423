"""Fixtures for code blocks in documents: in a fence ``python fixture:emulated_arm`` an arm is plugged in.

The names of modules that a block or a test registers are forgotten after it: a later test may use the id.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator

import pytest
from pytest_markdown_docs.plugin import MarkdownDocstringCodeModule, MarkdownInlinePythonItem
from tests.cli.shared_arm import patient, patient_line
from tests.emulator.terminals import serving

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.wire import modules


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Leave out docstrings, which `--markdown-docs` searches in all tests, and in the programs of docs."""
    found = yield
    return [collector for collector in found if not isinstance(collector, MarkdownDocstringCodeModule)]


@pytest.fixture(autouse=True)
def _no_module_left() -> Iterator[None]:
    before = set(modules._named)
    yield
    for name in modules._named.keys() - before:
        module = modules._named.pop(name)
        module._name_ = str(int(module))


@pytest.fixture(autouse=True)
def _patient_blocks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may let the emulated arm of a block wait."""
    if isinstance(request.node, MarkdownInlinePythonItem):
        patient(monkeypatch)
        patient_line(monkeypatch)


@pytest.fixture
def emulated_arm(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An emulated Hex7Bot on a serial port that HEXWIRE_PORT names."""
    with serving(PtyServer(make_hex7bot_board(start=time.monotonic()))) as path:
        monkeypatch.setenv("HEXWIRE_PORT", path)
        yield path
