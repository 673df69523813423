"""`hexwire fleet config` and `hexwire fleet router`: rights from certificates, and the way between machines."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.link.far_ends import free_port
from tests.system.programs import hexwire_program

from hexwire.cli.main import cli
from hexwire.fleet.network import Network, read_access
from hexwire.link.certs import make_authority


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)))


def ok(*words: str | Path) -> str:
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    folder = tmp_path / "lab"
    ok("cert", "issue", folder, "router", "--role", "router", "--host", "localhost")
    ok("cert", "issue", folder, "arm1", "--role", "arm", "--for", "lab/arm1")
    ok("cert", "issue", folder, "anna", "--role", "operator", "--for", "lab/*")
    return folder


def files(folder: Path, name: str) -> list[str]:
    return ["--ca", f"{folder}/ca.pem", "--cert", f"{folder}/{name}.pem", "--key", f"{folder}/{name}.key"]


# -- rights -----------------------------------------------------------------------------------------------


def test_the_rights_of_a_folder(lab: Path) -> None:
    ok("cert", "new", lab, "--client", "old")
    out = ok("fleet", "config", lab)
    assert "anna.pem: operator for lab/*, until 20" in out
    assert "old.pem: no role, no rights" in out
    assert "access.json: rights of 3 certificates" in out
    access = read_access(str(lab / "access.json"))
    named = [name for row in access["subjects"] for name in row.get("cert_common_names", ())]
    assert sorted(name.split()[0] for name in named) == ["anna", "arm1", "router"]


def test_a_certificate_that_was_removed_or_issued_anew_has_its_old_rights_no_more(lab: Path) -> None:
    def names() -> set[str]:
        ok("fleet", "config", lab, "--force")
        rows = json.loads((lab / "access.json").read_text())["subjects"]
        return {name for row in rows for name in row.get("cert_common_names", ()) if name.startswith("anna")}

    before = names()
    (lab / "anna.pem").unlink()
    (lab / "anna.key").unlink()
    assert names() == set()
    ok("cert", "issue", lab, "anna", "--role", "observer", "--for", "lab/*")
    assert len(names()) == 1
    assert not names() & before


def test_files_that_are_ignored_are_named(lab: Path, tmp_path: Path) -> None:
    make_authority(tmp_path / "other")
    ok("cert", "issue", tmp_path / "other", "eve", "--role", "maintainer", "--for", "**")
    (lab / "eve.pem").write_bytes((tmp_path / "other" / "eve.pem").read_bytes())
    result = run("fleet", "config", lab)
    assert result.exit_code == 0
    assert result.stderr.count("\n") == 1
    assert "eve.pem was not signed by the authority" in result.stderr
    assert "eve" not in (lab / "access.json").read_text()
    assert "not signed" in run("fleet", "config", lab, lab / "eve.pem", "--force").stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("config", "{lab}"), "--force"),
        (("config", "{lab}/none"), "has no certificate with a role"),
        (("router", "--listen", "tls/localhost:7447"), "needs certificates"),
        (("router", "--listen", "tcp/0.0.0.0:7447"), "anybody there could move the arm"),
        (("router", "--listen", "udp/127.0.0.1:7447"), "is not an endpoint"),
        (("router", "--access", "{lab}/ca.pem"), "ca.pem"),
        (("router", "--listen", "tls/localhost:{port}", *files(Path("{lab}"), "router")), "--access"),
    ],
)
def test_mistakes_are_reported_in_one_line(lab: Path, words: tuple[str, ...], text: str) -> None:
    ok("fleet", "config", lab)
    result = run("fleet", *(word.format(lab=lab, port=free_port()) for word in words))
    assert result.exit_code == 2, result.output
    assert text in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_router_needs_the_certificate_of_a_router(lab: Path) -> None:
    ok("fleet", "config", lab)
    listen = ["--listen", f"tls/localhost:{free_port()}", "--access", str(lab / "access.json")]
    for name, text in (("arm1", "is for the role arm for lab/arm1; a router needs"),):
        result = run("fleet", "router", *listen, *files(lab, name))
        assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
        assert text in result.stderr
    wrong = [*files(lab, "router")[:-1], str(lab / "arm1.key")]
    result = run("fleet", "router", *listen, *wrong)
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "are not a certificate and its key" in result.stderr


def test_a_port_that_is_taken(lab: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        result = run("fleet", "router", "--listen", f"tcp/localhost:{taken.getsockname()[1]}")
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "another program listens there" in result.stderr


# -- a router ---------------------------------------------------------------------------------------------


@pytest.mark.system
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_passes_on_until_a_signal(lab: Path, number: signal.Signals) -> None:
    ok("fleet", "config", lab)
    endpoint = f"tls/localhost:{free_port()}"
    words = ["fleet", "router", "--listen", endpoint, "--access", str(lab / "access.json"), *files(lab, "router")]
    router = subprocess.Popen(
        [sys.executable, "-m", "hexwire.cli", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert router.stdout is not None
        assert router.stdout.readline() == f"passing on at {endpoint}\n"
        ca, cert, key = (str(lab / file) for file in ("ca.pem", "anna.pem", "anna.key"))
        node = Network(connect=(endpoint,), ca=ca, cert=cert, key=key).open()
        node.ask_neighbours(10.0)
        node.close()
        router.send_signal(number)
        _, errors = router.communicate(timeout=30)
        assert (router.returncode, errors) == (0, "the router has ended\n")
    finally:
        router.kill()
        router.communicate()


@pytest.mark.system
def test_it_may_have_zenohs_own_settings(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    path = tmp_path / "router.json5"
    path.write_text(
        f"{{mode: 'router', listen: {{endpoints: ['{endpoint}']}}, scouting: {{multicast: {{enabled: false}}}}}}"
    )
    with hexwire_program("fleet", "router", "--zenoh-config", path) as router:
        assert router.stdout is not None
        assert router.stdout.readline() == f"passing on at {endpoint}\n"
        node = Network(connect=(endpoint,)).open()
        assert node.routers == 1
        node.close()
        router.terminate()
        assert router.wait(30) == 0


def test_without_options_the_file_of_rmw_zenohs_variable_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "router.json5"
    path.write_text("{mode: 'peer'}")
    monkeypatch.setenv("ZENOH_ROUTER_CONFIG_URI", f"file://{path}")
    result = run("fleet", "router")
    assert result.exit_code == 2
    assert f"settings from {path}, which ZENOH_ROUTER_CONFIG_URI names" in result.stderr
    assert f"{path}: has no mode 'router'" in result.stderr
    # What is typed counts more.
    result = run("fleet", "router", "--listen", "tcp/0.0.0.0:1")
    assert "ZENOH_ROUTER_CONFIG_URI" not in result.stderr
    assert result.exit_code == 2


@pytest.mark.parametrize(
    ("text", "words", "why"),
    [
        ("{mode: 'peer'}", [], "has no mode 'router'"),
        ("{}", [], "has no mode 'router'"),
        ("{mode: 'router', frobnicate: 5}", [], "Invalid configuration file"),
        ("{", [], "Invalid configuration file"),
        ("{mode: 'router'}", ["--listen", "tcp/127.0.0.1:7447"], "leave out the other options"),
        ("{mode: 'router', listen: {endpoints: ['tcp/192.0.2.1:1']}}", [], "cannot open a router"),
    ],
)
def test_settings_that_are_no_routers_are_refused(tmp_path: Path, text: str, words: list[str], why: str) -> None:
    path = tmp_path / "router.json5"
    path.write_text(text)
    result = run("fleet", "router", "--zenoh-config", path, *words)
    assert result.exit_code in (1, 2)
    assert why in result.stderr
    assert result.stderr.count("\n") == 1
