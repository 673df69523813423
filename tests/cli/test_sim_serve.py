from __future__ import annotations

import sys

import pytest
from click.testing import CliRunner, Result

from hexwire.cli.main import cli
from hexwire.cli.sim import parse_address
from hexwire.errors import UsageError

DEVICES = (["sim", "board"], ["sim", "bus"])


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, words)


@pytest.mark.parametrize("device", DEVICES)
def test_a_port_without_a_terminal(device: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[tuple[str, int]] = []

    class Server:
        def __init__(self, device: object, host: str, port: int, **_: object) -> None:
            served.append((host, port))

        def serve(self, *_: object, **__: object) -> None:
            pass

    monkeypatch.setattr("hexwire.emulator.serve_tcp.TcpServer", Server)
    assert run(*device, "--tcp", "127.0.0.1:0").exit_code == 0
    result = run(*device, "--tcp", "0.0.0.0:7000")
    assert "anyone who reaches TCP on 0.0.0.0" in result.stderr
    assert served == [("127.0.0.1", 0), ("0.0.0.0", 7000)]


@pytest.mark.parametrize("device", DEVICES)
def test_a_terminals_name_needs_a_terminal(device: list[str]) -> None:
    result = run(*device, "--tcp", "127.0.0.1:0", "--link", "/tmp/arm")
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "--tcp makes none" in result.stderr


@pytest.mark.parametrize("device", DEVICES)
def test_a_system_without_terminals_says_what_to_do(device: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("serve_pty", "serve_bus"):
        monkeypatch.setitem(sys.modules, f"hexwire.emulator.{name}", None)
    result = run(*device)
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "add --tcp 127.0.0.1:0" in result.stderr


def test_addresses() -> None:
    assert parse_address(":15030") == ("127.0.0.1", 15030)
    assert parse_address("[::1]:0") == ("::1", 0)
    with pytest.raises(UsageError):
        parse_address("host")
