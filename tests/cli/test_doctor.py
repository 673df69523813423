"""The doctor on a made-up machine with an emulated board."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from hexwire.cli import doctor as module
from hexwire.cli.doctor import doctor
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.ports import PortInfo
from hexwire.ipc.session import Session


def plug_in(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *faults: str, dialect: int = 2) -> None:
    device = tmp_path / "ttyUSB0"
    device.touch(mode=0o660)
    port = PortInfo(str(device), 0xFFFE, 0xFFFE, guess="a board", likely_board=True)
    monkeypatch.setattr("hexwire.ipc.ports.list_ports", lambda: [port])
    clock = FakeClock()
    board = make_hex7bot_board(dialect=dialect, faults=faults, start=clock.time)
    clock.advance(10.0)

    from contextlib import contextmanager

    @contextmanager
    def opened(_: object) -> Iterator[Hex7BotDriver]:
        with Hex7BotDriver(Session(IpcHandle.from_link(BoardLink(board, clock)))) as driver:
            yield driver

    monkeypatch.setattr(module, "open_robot", opened)


def levels(args: list[str]) -> tuple[dict[str, str], int]:
    result = CliRunner().invoke(doctor, [*args, "--json"])
    text = result.output[: result.output.rindex("]") + 1]
    return {f"{row['about']}: {row['text']}": row["level"] for row in json.loads(text)}, result.exit_code


def test_a_healthy_arm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plug_in(monkeypatch, tmp_path)
    found, status = levels([])
    assert status == 0
    assert found["servos: all 7 answer"] == "ok"
    assert any("dialect 2" in text and level == "ok" for text, level in found.items())
    assert any("no udev rule" in text and level == "hint" for text, level in found.items())


@pytest.mark.parametrize(("device", "text"), [("ttyS0", "no likely board"), ("", "no serial port")])
def test_without_a_board_it_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: str, text: str
) -> None:
    (tmp_path / "ttyS0").touch()
    ports = [PortInfo(str(tmp_path / device), guess="built-in serial port")] if device else []
    monkeypatch.setattr("hexwire.ipc.ports.list_ports", lambda: ports)
    monkeypatch.delenv("HEXWIRE_PORT", raising=False)
    found, status = levels([])
    assert status == 0
    assert [level for about, level in found.items() if text in about] == ["hint"]


def test_a_silent_and_a_hot_servo(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plug_in(monkeypatch, tmp_path, "silent:4", "hot:6")
    found, status = levels([])
    assert status == 1
    assert found["servos: J5 not answering"] == "bad"
    assert any(text.startswith("J7: reports") and level == "bad" for text, level in found.items())


def test_an_old_board_is_a_hint(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plug_in(monkeypatch, tmp_path, dialect=1)
    found, status = levels([])
    assert status == 0
    assert any("dialect 1" in text and level == "hint" for text, level in found.items())


def test_words_name_the_advice_and_fix_writes_the_rule(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plug_in(monkeypatch, tmp_path)
    written: list[list[str]] = []
    monkeypatch.setattr(
        "hexwire.ipc.diagnose.write_udev_rule", lambda ids: written.append(list(ids)) or tmp_path / "rule"
    )
    shown = CliRunner().invoke(doctor, []).output
    assert 'ATTRS{idVendor}=="fffe"' in shown
    assert "-> " in shown
    assert not written
    assert "wrote" in CliRunner().invoke(doctor, ["--fix"]).output
    assert written == [["fffe:fffe"]]
