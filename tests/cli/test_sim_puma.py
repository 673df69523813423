"""`hexwire sim puma260` as a process, and the other commands against it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.cli.shared_arm import patient
from tests.defaults import patient_line

from hexwire.cli.main import cli
from hexwire.link.certs import issue_certificate, make_authority


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer times: the robot is a process of its own, which may get no processor for a while."""
    patient(monkeypatch)
    patient_line(monkeypatch, window=5.0)


@pytest.fixture(scope="module")
def urls() -> Iterator[list[str]]:
    command = [sys.executable, "-m", "hexwire.cli", "sim", "puma260", "--tcp", ":0", "--udp", "127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        yield [process.stdout.readline().strip(), process.stdout.readline().strip()]
    finally:
        process.terminate()
        assert process.wait(30) == 130
        assert process.stderr.read() == ""
        process.stdout.close()
        process.stderr.close()


@pytest.mark.system
def test_it_prints_urls_to_call(urls: list[str]) -> None:
    assert re.fullmatch(r"tcp://127\.0\.0\.1:\d+", urls[0])
    assert re.fullmatch(r"udp://127\.0\.0\.1:\d+", urls[1])


@pytest.mark.system
@pytest.mark.parametrize("which", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_state_move_and_stop_as_for_the_other_arm(urls: list[str], which: int) -> None:
    port = urls[which]
    early = ("--robot", "puma260")
    result = run(*early, "move", "J1=4", "j5=10", "--wait", "--port", port)
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith("arrived\n")
    state = json.loads(run("state", *early, "--port", port, "--json").stdout)
    angles = {joint["name"]: joint["position_deg"] for joint in state["joints"]}
    assert angles["J1"] == pytest.approx(4, abs=1)
    assert angles["J5"] == pytest.approx(10, abs=1)
    assert run(*early, "--port", port, "stop").stdout == "stopped, holding: J1 J2 J3 J4 J5 J6\n"
    refused = run(*early, "--port", port, "move", "J1=0")
    assert (refused.exit_code, "the arm is stopped" in refused.stderr) == (1, True)
    assert run(*early, "--port", port, "resume").stdout == "resumed; torque on: J1 J2 J3 J4 J5 J6\n"
    assert run(*early, "--port", port, "torque", "off").stdout == "torque off: J1 J2 J3 J4 J5 J6\n"
    assert "puma260" in run(*early, "--port", port, "probe").stdout


@pytest.mark.system
def test_the_option_behind_the_command_wins(urls: list[str]) -> None:
    result = run(
        "--robot", "hex7bot", "--port", "tcp://127.0.0.1:1", "state", "--robot", "puma260", "--port", urls[0]
    )
    assert result.exit_code == 0, result.output


def first_lines(*words: str) -> tuple[str, str]:
    """What the process says first: its first URL, and all of standard error."""
    command = [sys.executable, "-m", "hexwire.cli", "sim", "puma260", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        url = process.stdout.readline().strip()
        process.terminate()
        return url, process.stderr.read()


@pytest.mark.system
def test_an_address_that_others_reach_is_warned_of() -> None:
    url, told = first_lines("--tcp", "0.0.0.0:0", "--udp", "0.0.0.0:0", "--peer", "192.0.2.7")
    assert url.startswith("tcp://0.0.0.0:")
    assert told == (
        "warning: anyone who reaches TCP on 0.0.0.0 can command this robot; --ca, --cert and --key prevent that\n"
        "warning: over UDP anyone can pretend to be 192.0.2.7; TCP with --ca, --cert and --key prevents that\n"
    )


@pytest.mark.system
def test_with_tls_only_clients_of_the_authority_command_it(tmp_path: Path) -> None:
    make_authority(tmp_path)
    server, client = (issue_certificate(tmp_path, kind, kind) for kind in ("server", "client"))
    ca = str(tmp_path / "ca.pem")
    words = ("--tcp", "0.0.0.0:0", "--ca", ca, "--cert", str(server.cert), "--key", str(server.key))
    command = [sys.executable, "-m", "hexwire.cli", "sim", "puma260", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        url = process.stdout.readline().strip().replace("0.0.0.0", "127.0.0.1")
        assert url.startswith("tcps://127.0.0.1:")
        options = f"?ca={ca}&cert={client.cert}&key={client.key}"
        early = ("--robot", "puma260")
        result = run(*early, "torque", "on", "--port", url + options)
        assert result.exit_code == 0, result.output
        refused = run(*early, "state", "--timeout", "0.5", "--port", url.replace("tcps", "tcp"))
        assert refused.exit_code == 1
        assert refused.stderr.count("\n") == 1
        process.terminate()
        assert process.stderr.read() == "", "with TLS there is nothing to warn of"


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("--robot", "puma", "state", "--port", "udp://127.0.0.1:9"), 2, "no robot 'puma'; installed are"),
        (("--robot", "puma260", "state", "--dialect", "1", "--port", "udp://127.0.0.1:9"), 2, "no option dialect"),
        (("--robot", "puma260", "state", "--timeout", "0.1", "--port", "udp://127.0.0.1:9"), 1, "no answer to"),
        (("sim", "puma260", "--tcp", "nowhere"), 2, "the port is missing"),
        (("sim", "puma260", "--tcp", ":0", "--udp", "0.0.0.0:0"), 2, "name the host to accept"),
        (("sim", "puma260", "--ca", "ca.pem", "--tcp", ":0"), 2, "TLS needs --ca, --cert and --key together"),
        (("sim", "puma260", "--peer", "127.0.0.1"), 2, "--peer needs --udp"),
    ],
)
def test_mistakes(words: tuple[str, ...], status: int, text: str) -> None:
    result = run(*words)
    assert result.exit_code == status
    assert text in result.stderr
    assert result.stderr.count("\n") == 1
