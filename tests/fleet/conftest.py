"""Shared arms in this process: a folder of sockets of the test's own, and servers of emulated arms."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from tests.defaults import default
from tests.waits import PATIENCE

from hexwire.control.sharing.lease import Lease
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms

Serve = Callable[..., Service]


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that stands for XDG_RUNTIME_DIR; short, since the path of a socket must be."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        monkeypatch.setenv("XDG_STATE_HOME", folder)
        monkeypatch.delenv("HEXWIRE_PORT", raising=False)
        yield Path(folder)


@pytest.fixture
def serve(runtime: Path) -> Iterator[Serve]:
    """Shares an arm until the end of the test: `serve("lab/arm1", robot="sim")`."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.001)
    with ExitStack() as stack:
        # Longer times than usual, so that a busy machine is not taken for a host or a client that died, or
        # a set-point for an old one.
        default(stack.enter_context(pytest.MonkeyPatch.context()), Lease, max_age=PATIENCE)

        def start(name: str = "lab/arm1", *, lease: float = 3.0, **settings: object) -> Service:
            arms = read_arms({name: {"watchdog": 5.0} | (settings or {"robot": "sim"})}, lease=lease)
            return stack.enter_context(Service(arms))

        yield start
    sys.setswitchinterval(interval)
