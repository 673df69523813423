"""What a test or a block of a document changes for its program is as before after it, and fixtures for blocks.

In a fence ``python fixture:emulated_arm`` an arm is plugged in. Names of modules that a block or a test registers
are forgotten after it: a later test may use the id.
"""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Generator, Iterator

import pytest
from pytest_markdown_docs.plugin import MarkdownDocstringCodeModule, MarkdownInlinePythonItem
from tests.cli.shared_arm import patient
from tests.defaults import patient_line
from tests.emulator.terminals import serving

from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.wire import modules

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Leave out docstrings, which `--markdown-docs` searches in all tests, and in the programs of docs."""
    found = yield
    return [collector for collector in found if not isinstance(collector, MarkdownDocstringCodeModule)]


@pytest.fixture(autouse=True)
def _as_before() -> Iterator[None]:
    """Forget names of modules, and take back what a command has set for the rest of its program.

    That is handlers of signals, and the interpreter's times. One fixture: each costs every one of the many tests as
    much as a small test takes.
    """
    named = set(modules._named)
    handlers = [(number, signal.getsignal(number)) for number in _SIGNALS]
    switch, threshold = sys.getswitchinterval(), gc.get_threshold()
    yield
    sys.setswitchinterval(switch)
    gc.set_threshold(*threshold)
    for number, handler in handlers:
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)
    for number in modules._named.keys() - named:
        module = modules._named.pop(number)
        module._name_ = str(int(module))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """A busy machine may let the emulated arm of a block wait."""
    if not isinstance(item, MarkdownInlinePythonItem):
        return (yield)
    with pytest.MonkeyPatch.context() as patched:
        patient(patched)
        patient_line(patched)
        return (yield)


@pytest.fixture
def emulated_arm(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """An emulated Hex7Bot on a serial port that HEXWIRE_PORT names."""
    with serving(PtyServer(make_hex7bot_board(start=time.monotonic()))) as path:
        monkeypatch.setenv("HEXWIRE_PORT", path)
        yield path
