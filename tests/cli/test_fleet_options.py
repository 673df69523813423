"""The options that name a router: the same on every command for many arms."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result
from tests.fleet.conftest import Serve, runtime, serve  # noqa: F401  # fixtures
from tests.fleet.lab import LONG_AGO, Lab
from tests.link.far_ends import free_port
from tests.waits import eventually

from hexwire.cli.main import cli
from hexwire.fleet import endpoints
from hexwire.fleet.network import Network
from hexwire.fleet.rights import Kind
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms

# ruff: noqa: F811  # fixtures that are imported

WAY = {"--router", "--ca", "--cert", "--key", "--reachable-without-certificates"}


def options_of(command: click.Command | None) -> set[str]:
    assert command is not None
    return {option for param in command.params for option in param.opts}


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, ["fleet", *map(str, words)])


def test_each_command_for_many_arms_has_all_of_them() -> None:
    group = cli.get_command(click.Context(cli), "fleet")
    assert isinstance(group, click.Group)
    for name in ("list", "watch", "stop", "record", "play", "router"):
        assert options_of(group.get_command(click.Context(group), name)) >= WAY, name
    assert options_of(cli.get_command(click.Context(cli), "serve")) >= WAY


@pytest.fixture
def lab(tmp_path: Path, runtime: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    """A router, and an arm behind it on another computer: its socket is elsewhere."""
    lab = Lab(tmp_path)
    lab.issue("arm", Kind.ARM, "lab/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    lab.issue("old", Kind.OPERATOR, "lab/*", now=LONG_AGO, days=1)
    away, here = runtime / "away", runtime / "here"
    for folder in (away, here):
        folder.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(away))
    arms = read_arms({"lab/arm1": {"watchdog": 5.0, "robot": "sim"}})
    with lab.routing(), Service(arms, lab.network("arm")):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(here))
        yield lab


def typed(lab: Lab, name: str, **instead: str) -> list[str]:
    values = {"router": lab.endpoint, **lab.files(name), **instead}
    return [word for key, value in values.items() for word in (f"--{key}", value)]


def test_certificates_that_are_typed_lead_every_command_to_the_arm(lab: Lab, tmp_path: Path) -> None:
    way = typed(lab, "anna")
    eventually(lambda: "lab/arm1" in run("list", *way).stdout)
    done = run("record", tmp_path / "a.mcap", "--duration", 1, *way)
    assert done.exit_code == 0, done.output
    done = run("play", tmp_path / "a.mcap", "--on", "lab/*", "--dry-run", *way)
    assert (done.exit_code, "is allowed; nothing moved" in done.stdout) == (0, True), done.output
    done = run("stop", "--all", *way)
    assert (done.exit_code, done.stdout.startswith("lab/arm1: stopped")) == (0, True), done.output


def test_a_mistake_in_them_is_one_line_and_a_usage_error(lab: Lab, tmp_path: Path) -> None:
    for words, said in (
        (typed(lab, "old"), "expired on 2020-01-02"),
        (typed(lab, "anna", key=str(tmp_path / "none.key")), "none.key"),
        (typed(lab, "anna", router="tls/localhost"), "is not an endpoint"),
        (typed(lab, "anna")[:-2], "TLS needs all of ca, cert and key"),
        (typed(lab, "anna")[2:], "--router tls/HOST:7447"),
        (["--router", "tcp/lab-pc:7447"], "reaches beyond this machine without certificates"),
        (["--reachable-without-certificates"], "--router tls/HOST:7447"),
    ):
        for name in (("list",), ("watch",), ("record", tmp_path / "b.mcap"), ("play", "b.json", "--on", "lab/*")):
            done = run(*name, *words)
            assert (done.exit_code, done.stdout) == (2, ""), (name, words, done.output)
            assert said in done.stderr
            assert done.stderr.count("\n") == 1
    assert not (tmp_path / "b.mcap").exists()


def test_certificates_that_cannot_be_used_keep_no_stop_from_the_arms_of_this_machine(
    lab: Lab, serve: Serve
) -> None:
    serve("near", robot="sim")
    none = str(lab.folder / "none.pem")
    for way, said in ((typed(lab, "old"), "expired on 2020-01-02"), (typed(lab, "anna", cert=none), none)):
        done = run("stop", "--all", *way)
        assert done.exit_code == 1
        near, far = done.stdout.splitlines()
        assert near.startswith("near: stopped")
        assert far.startswith(f"{lab.endpoint}: NOT CONFIRMED")
        assert said in far


def test_a_stop_that_does_not_begin_says_that_nothing_was_stopped(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = runtime / "anna.toml"
    file.write_text('rouetr = "tls/lab-pc:7447"\n')
    monkeypatch.setenv("HEXWIRE_FLEET", str(file))
    done = run("stop", "--all")
    assert (done.exit_code, done.stdout) == (2, "")
    assert f"nothing was stopped: {file}:1:" in done.stderr


def test_a_router_without_certificates_is_reached_where_a_flag_says_so(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The address of this computer stands for another one's."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = Network(listen=(endpoint,), router=True).open()
    monkeypatch.setattr(endpoints, "_loopback", lambda host: None)
    try:
        done = run("list", "--router", endpoint)
        assert (done.exit_code, "anybody there could move the arm" in done.stderr) == (2, True)
        done = run("list", "--router", endpoint, "--reachable-without-certificates")
        assert (done.exit_code, f"behind {endpoint}" in done.stdout) == (0, True), done.output
    finally:
        router.close()
