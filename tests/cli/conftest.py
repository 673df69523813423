"""A command line whose port is an emulated board in this process, in simulated time."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.bus.bus_bench import make_bus
from tests.defaults import default

from hexwire.cli import exits
from hexwire.cli.main import cli
from hexwire.control.loop.loop import RateLoop
from hexwire.control.motion.motion_options import MotionOptions
from hexwire.control.requests.teach_mode import record_by_hand
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.link import open as ipc_open

START = 1000.0


_CALL = re.compile(r"\b[a-z_]+\((?!s\))")
"""A call of a method, as in ``resume()``; not a plural, as in ``servo(s)``."""


@pytest.fixture(autouse=True)
def no_error_names_a_method(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Whoever types commands is told of commands and options."""
    said: list[str] = []
    say = exits._say
    monkeypatch.setattr(exits, "_say", lambda kind, text: (said.append(text), say(kind, text)))
    yield
    assert [text for text in said if _CALL.search(text)] == []


class Bench:
    """Runs `hexwire` commands against one board."""

    def __init__(self, board: EmulatedBoard, link: BoardLink, clock: FakeClock) -> None:
        self.board = board
        self.link = link
        self.clock = clock
        self.urls: list[str] = []

    def run(self, *words: str, port: str | None = "/dev/ttyTEST") -> Result:
        args = [*words, *(["--port", port] if port else [])]
        return CliRunner().invoke(cli, args)

    def ok(self, *words: str) -> str:
        """Run what must succeed without a word on standard error; returns the output."""
        result = self.run(*words)
        assert (result.exit_code, result.stderr) == (0, ""), result.output
        return result.stdout

    def json(self, *words: str) -> Any:
        return json.loads(self.ok(*words, "--json"))

    def positions(self) -> dict[str, float]:
        return {joint["name"]: joint["position_deg"] for joint in self.json("state")["joints"]}

    def torque(self) -> list[str]:
        return [joint["name"] for joint in self.json("state")["joints"] if joint["torque_on"]]


MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeBench]:
    def make(*faults: str, dialect: int = 2) -> Bench:
        clock = FakeClock(START)
        board = make_hex7bot_board(dialect=dialect, baud=115200, faults=faults, start=START)
        link = BoardLink(board, clock, baud=115200)
        bench = Bench(board, link, clock)

        def make_link(url: str) -> BoardLink:
            bench.urls.append(url)
            return link

        def sleep(seconds: float) -> None:
            # The board lives on while the program sleeps.
            clock.advance(seconds)

        monkeypatch.setattr(ipc_open, "make_link", make_link)
        default(monkeypatch, RateLoop, clock=clock, sleep=sleep)
        for function in (record_by_hand, MotionOptions):
            default(monkeypatch, function, sleep=sleep)
        return bench

    return make


@pytest.fixture
def so_bench(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run a command for an SO-100 or SO-101, six emulated servos on an adapter."""
    bus, _ = make_bus(range(1, 7), baud=1_000_000)
    bus.close()
    monkeypatch.setattr(ipc_open, "make_link", lambda url: bus.link)
    sleep = bus.link.clock.advance  # type: ignore[attr-defined]  # simulated time
    default(monkeypatch, RateLoop, clock=bus.link.clock, sleep=sleep)  # type: ignore[attr-defined]
    default(monkeypatch, MotionOptions, sleep=sleep)
    return lambda *words: CliRunner().invoke(cli, [*words, "--port", "/dev/ttyTEST"])


@pytest.fixture
def bench(make_bench: MakeBench) -> Bench:
    return make_bench()
