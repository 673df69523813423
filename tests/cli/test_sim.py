from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.emulator import board as emulator_board
from hexwire.emulator import serve_pty


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the emulator was asked for; serving ends at once."""
    asked: dict[str, Any] = {}

    real = emulator_board.make_hex7bot_board

    def make(**options: Any) -> object:
        asked.update(options, device=real())
        return asked["device"]

    class Server:
        def __init__(self, device: object, **options: Any) -> None:
            assert device is asked["device"]
            asked.update(serve=options)

        def serve(self, stop: Callable[[], bool], announce: Callable[[str], None], **_: Any) -> None:
            asked["serve"]["stop"] = stop
            announce("/dev/pts/77")

    monkeypatch.setattr(emulator_board, "make_hex7bot_board", make)
    monkeypatch.setattr(serve_pty, "PtyServer", Server)
    return asked


def test_the_path_is_all_that_is_printed(made: dict[str, Any]) -> None:
    result = CliRunner().invoke(cli, ["sim", "board"])
    assert (result.exit_code, result.stdout, result.stderr) == (0, "/dev/pts/77\n", "")
    assert (made["dialect"], made["faults"], made["seed"]) == (2, (), 0)
    assert made["serve"]["baud"] == 115200
    assert made["serve"]["reset_on_open"] is False
    assert made["serve"]["stop"]() is False


def test_options_reach_the_emulator(made: dict[str, Any]) -> None:
    words = ["--dialect", "1", "--fault", "silent:4", "--fault", "echo", "--seed", "7", "--reset-on-open"]
    result = CliRunner().invoke(cli, ["sim", "board", *words, "--baud", "9600", "--link", "/tmp/arm"])
    assert result.exit_code == 0
    assert (made["dialect"], made["faults"], made["seed"]) == (1, ("silent:4", "echo"), 7)
    served = made["serve"]
    assert (served["baud"], served["link"], served["reset_on_open"]) == (9600, "/tmp/arm", True)


@pytest.mark.parametrize(("baud", "bus"), [("0", 0), ("115200", 115200), ("1000000", 115200)])
def test_an_unpaced_line_has_an_unpaced_bus(made: dict[str, Any], baud: str, bus: int) -> None:
    CliRunner().invoke(cli, ["sim", "board", "--baud", baud])
    assert made["baud"] == bus


def test_it_ends_with_its_input_if_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []

    def serve(server: object, stop: Callable[[], bool], *_: object, **__: object) -> None:
        while not stop():
            pass
        ended.append(True)

    monkeypatch.setattr(serve_pty.PtyServer, "serve", serve)
    monkeypatch.setattr(os, "read", lambda fd, size: b"")
    assert CliRunner().invoke(cli, ["sim", "board", "--until-eof"]).exit_code == 0
    assert ended == [True]
