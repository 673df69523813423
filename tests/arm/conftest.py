"""What this folder shares: an arm of each kind, and that no error of one names an option of a command."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.arm.arms import KINDS, TIMED, connected, marked

from hexwire import Arm, HexwireError

_COMMAND = re.compile(r"[`'][^`']*hexwire [^`']*[`']")
_OPTION = re.compile(r"(?<!-)--[a-z]")


@pytest.fixture(scope="module", params=marked(KINDS | TIMED))
def arm(request: pytest.FixtureRequest) -> Iterator[Arm]:
    """An arm of every kind, at home."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder, connected(request.param, Path(folder)) as arm:
        arm.home()
        yield arm


@pytest.fixture(autouse=True)
def no_error_names_an_option(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A whole command, between quotes, may have options: it is typed elsewhere."""
    said: list[str] = []
    leave = pytest.RaisesExc.__exit__

    def seen(self: pytest.RaisesExc[BaseException], kind: object, error: object, trace: object) -> bool:
        if isinstance(error, HexwireError):
            said.append(str(error))
        return leave(self, kind, error, trace)  # type: ignore[arg-type]  # as they came

    monkeypatch.setattr(pytest.RaisesExc, "__exit__", seen)
    yield
    assert [text for text in said if _OPTION.search(_COMMAND.sub("", text))] == []
