"""`hexwire studio`: what it prints, what it refuses, and that other machines need more than its address."""

from __future__ import annotations

import contextlib
import http.client
import importlib.util
import re
import signal
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.link.certs import issue_certificate, make_authority

if TYPE_CHECKING:
    pass


@contextlib.contextmanager
def _studio(*options: str) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """The program, and the two addresses that it printed."""
    command = [sys.executable, "-m", "hexwire.cli", "studio", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, [process.stdout.readline() for _ in range(2)]
        finally:
            process.kill()


@pytest.mark.system
def test_demo_prints_both_addresses_and_ends_at_ctrl_c() -> None:
    with _studio("--demo") as (process, lines):
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert re.fullmatch(r"operate: http://127\.0\.0\.1:\d+/move\?token=[\w-]{43}\n", lines[0])
    assert re.fullmatch(r"watch:   http://127\.0\.0\.1:\d+/move\?token=[\w-]{43}\n", lines[1])
    assert lines[0].split()[1] != lines[1].split()[1]
    assert process.returncode == 0
    assert errors == "the studio has ended\n"


@pytest.mark.slow
def test_the_arm_is_opened_when_the_server_has_started_and_not_after_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Imports keep other threads waiting longer than a watchdog does.
    at_start: list[str] = []
    frozen: list[bool] = []
    opened = threading.Event()
    alive: list[bool] = []

    class FakeServer:
        host, port = "127.0.0.1", 1

        def __init__(self, make: object, access: object, *_: object) -> None:
            self.access = access

        def bind(self) -> int:
            return self.port

        def run(self, started: Callable[[], None]) -> None:
            at_start.extend(thread.name for thread in threading.enumerate())
            started()

        def end(self) -> None:
            pass

    def slow_open(*_: object, **__: object) -> None:
        # The collector does not look through the program any more, which would hold up the owner of the arm.
        assert frozen
        time.sleep(0.2)
        opened.set()

    monkeypatch.setattr("hexwire.control.loop.shutdown.Shutdown.listen", lambda _: None)
    monkeypatch.setattr("hexwire.studio.memory.pass_by_hand", lambda: frozen.append(True))
    monkeypatch.setattr("hexwire.studio.server.Server", FakeServer)
    monkeypatch.setattr("hexwire.studio.source.Source.open", slow_open)
    monkeypatch.setattr("hexwire.studio.app.Studio.close", lambda _: alive.append(opened.is_set()))
    result = CliRunner().invoke(cli, ["studio", "--port", "sim://so101", "--no-browser"])
    assert result.exit_code == 0, result.output
    assert "signals" in at_start
    assert "opening" not in at_start
    assert alive == [True]


@pytest.mark.parametrize(
    "options",
    [
        ["--demo", "--port", "/dev/null"],
        ["--listen", "0.0.0.0:0"],
        ["--listen", "0.0.0.0:0", "--cert", "a.pem", "--key", "a.key"],
        ["--listen", "nowhere"],
        ["--cert", "a.pem"],
        ["--password-file", "/not/there"],
        ["--take"],
        ["--physics"],
        ["--robot", "nobody"],
        ["--port", "/dev/null", "--robot", "nobody"],
        ["--port", "nowhere://here"],
    ],
)
def test_what_contradicts_itself_or_is_unprotected_is_refused_in_one_line(options: list[str]) -> None:
    result = CliRunner().invoke(cli, ["studio", *options])
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1


def test_who_keeps_the_time_is_an_option(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[object] = []
    monkeypatch.setattr(
        "hexwire.cli.studio._run", lambda kind, port, robot, settings, *rest, **more: given.append(settings)
    )
    for words in ([], ["--host-timed"]):
        assert CliRunner().invoke(cli, ["studio", "--demo", *words]).exit_code == 0
    assert [row["host_timed"] for row in given if isinstance(row, dict)] == [False, True]


def test_without_the_extra_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr("hexwire.cli.studio.find_spec", lambda name: None if name == "uvicorn" else found(name))
    result = CliRunner().invoke(cli, ["studio", "--demo"])
    assert result.exit_code == 2
    assert result.stderr == "error: the studio is not installed: pip install 'hexwire[studio]'\n"


@pytest.mark.slow
@pytest.mark.system
def test_with_tls_a_password_or_a_client_certificate_is_needed(tmp_path: Path) -> None:
    make_authority(tmp_path)
    server = issue_certificate(tmp_path, "arm", "server")
    client = issue_certificate(tmp_path, "ann", "client", uris=("hexwire:observer:lab/*",))
    password = tmp_path / "password"
    password.write_text("correct horse battery")
    password.chmod(0o600)
    trust = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    files = ("--cert", str(server.cert), "--key", str(server.key), "--listen", "127.0.0.1:0")

    def ask(port: int, path: str = "/", form: str = "") -> tuple[int, str]:
        line = http.client.HTTPSConnection("127.0.0.1", port, timeout=60, context=trust)
        origin = {"Origin": f"https://127.0.0.1:{port}"}
        try:
            line.request("POST" if form else "GET", path, form or None, origin if form else {})
            answer = line.getresponse()
            answer.read()
            return answer.status, answer.getheader("set-cookie") or ""
        finally:
            line.close()

    with _studio(*files, "--password-file", str(password)) as (_, lines):
        port = int(lines[0].split(":")[3].partition("/")[0])
        assert lines[0].startswith("operate: https://127.0.0.1:")
        assert ask(port) == (401, "")
        assert ask(port, "/login", "password=wrong")[0] == 403
        status, cookie = ask(port, "/login", "password=correct+horse+battery")
        assert status == 200
        assert cookie.endswith("; Secure")
    with _studio(*files, "--ca", str(tmp_path / "ca.pem")) as (_, lines):
        port = int(lines[0].split(":")[3].partition("/")[0])
        with pytest.raises((ssl.SSLError, ConnectionError)):
            ask(port)
        trust.load_cert_chain(client.cert, client.key)
        status, cookie = ask(port)
        assert (status, cookie.startswith("hexwire_session_")) == (200, True)
