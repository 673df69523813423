"""Options that mean the same on every command that has them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click
import pytest
from click.testing import CliRunner
from tests.cli.bus_cli import BusCli

from hexwire.cli.main import cli

Words = tuple[str, ...]


def commands() -> Iterator[tuple[str, click.Command]]:
    """Every command with its words."""

    def walk(
        group: click.Group, context: click.Context, words: tuple[str, ...]
    ) -> Iterator[tuple[str, click.Command]]:
        for name in group.list_commands(context):
            command = group.get_command(context, name)
            assert command is not None
            inner = click.Context(command, parent=context, info_name=name)
            if isinstance(command, click.Group):
                yield from walk(command, inner, (*words, name))
            else:
                yield " ".join((*words, name)), command

    yield from walk(cli, click.Context(cli, info_name="hexwire"), ())


ALL = dict(commands())


def options_of(command: click.Command) -> dict[str, click.Option]:
    return {name: p for p in command.params if isinstance(p, click.Option) for name in p.opts}


def test_a_port_comes_from_the_environment_wherever_there_is_one() -> None:
    with_port = {
        name: options_of(command)["--port"] for name, command in ALL.items() if "--port" in options_of(command)
    }
    assert len(with_port) > 30
    without = [name for name, option in with_port.items() if option.envvar != "HEXWIRE_PORT"]
    # The demo moves an emulated arm unless the real one is asked for.
    assert without == ["demo"]


def test_flags_take_no_value() -> None:
    for name, command in ALL.items():
        for flag in ("--json", "--yes", "--wait", "--force"):
            option = options_of(command).get(flag)
            assert option is None or option.is_flag, f"{name} {flag}"


def test_every_option_says_what_it_does() -> None:
    silent = [
        f"{name} {word}" for name, command in ALL.items() for word, p in options_of(command).items() if not p.help
    ]
    assert silent == []


def test_questions_can_be_answered_in_advance() -> None:
    asking = {"set-id", "set-baud", "center", "restore", "wave", "write"}
    for name in (*(f"bus {name}" for name in asking), "teach", "demo"):
        assert "--yes" in options_of(ALL[name]), name


@pytest.mark.parametrize("words", [("state",), ("move", "J1=5", "--json"), ("goto", "0", "220", "200")])
@pytest.mark.parametrize("where", ["before", "behind", "environment"])
def test_a_port_before_or_behind_a_command_on_an_arm(
    bench: Any, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], where: str
) -> None:
    check_port(lambda args: bench.run(*args, port=None), bench.urls, monkeypatch, words, where)


@pytest.mark.parametrize("where", ["before", "between", "behind", "environment"])
def test_a_port_before_or_behind_a_command_on_a_bus(monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    bus = BusCli(monkeypatch)
    check_port(lambda args: CliRunner().invoke(cli, args), bus.urls, monkeypatch, ("bus", "ping", "1"), where)


def check_port(
    run: Any, urls: list[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], where: str
) -> None:
    port = ["--port", "/dev/ttyHERE"]
    if where == "environment":
        monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyHERE")
    else:
        # What is typed comes before the environment.
        monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyELSEWHERE")
    args = {
        "before": [*port, *words],
        "between": [words[0], *port, *words[1:]],
        "behind": [*words, *port],
        "environment": [*words],
    }[where]
    result = run(args)
    assert result.exit_code == 0, result.output
    assert [url.partition("?")[0] for url in urls] == ["/dev/ttyHERE"]


def test_the_nearest_port_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    words = ["--port", "/dev/tty1", "bus", "--port", "/dev/tty2", "ping", "1"]
    CliRunner().invoke(cli, [*words, "--port", "/dev/tty3"])
    CliRunner().invoke(cli, words)
    assert [url.partition("?")[0] for url in bus.urls] == ["/dev/tty3", "/dev/tty2"]


def test_a_demo_moves_the_real_arm_only_if_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    result = CliRunner().invoke(cli, ["--port", "/dev/ttyREAL", "demo"])
    assert (result.exit_code, "--yes-move-the-arm" in result.stderr) == (2, True)
    monkeypatch.delenv("HEXWIRE_PORT", raising=False)
    result = CliRunner().invoke(cli, ["demo", "--yes"])
    assert (result.exit_code, "needs the port of the arm" in result.stderr) == (2, True)
    monkeypatch.setenv("HEXWIRE_PORT", "/nowhere/at/all")
    result = CliRunner().invoke(cli, ["demo", "--yes"])
    assert (result.exit_code, "/nowhere/at/all" in result.stderr) == (1, True)


def test_the_arm_of_a_model_may_stand_before_the_command() -> None:
    zero = ["0"] * 6
    for words in (
        ["--robot", "puma260", "model", "fk", *zero, "--json"],
        ["model", "fk", *zero, "--json", "--robot", "puma260"],
    ):
        assert '"robot": "puma260"' in CliRunner().invoke(cli, words).stdout
    result = CliRunner().invoke(cli, ["--robot", "chain", "model", "fk", *zero])
    assert (result.exit_code, "no geometry is known for robot 'chain'" in result.stderr) == (2, True)


@pytest.mark.parametrize("series", ["sts", "sms", "STS", "sts_sms"])
def test_series_by_the_names_that_users_know(monkeypatch: pytest.MonkeyPatch, series: str) -> None:
    bus = BusCli(monkeypatch)
    assert "present_position" in bus.ok("read", "1", "present_position", "--series", series)


def test_usage_says_what_is_typed() -> None:
    for name, place in (
        ("goto", "{X Y Z | POSE}..."),
        ("line", "{X Y Z | POSE}..."),
        ("bus set-id", "OLD NEW"),
        ("bus set-baud", "ID RATE"),
    ):
        result = CliRunner().invoke(cli, [*name.split(), "--help"])
        assert result.stdout.splitlines()[0].endswith(f"{name} [OPTIONS] {place}")
    for words, says in (
        (("goto", "1", "2"), "X Y Z"),
        (("goto",), "X Y Z"),
        (("line", "1", "2", "3", "4"), "4"),
        (("model", "fk", "1", "2"), "T0 T1 T2 T3 T4 T5"),
        (("model", "ik", "1", "2", "--rpy", "0", "0", "0"), "X Y Z"),
        (("bus", "set-id", "1"), "NEW"),
        (("bus", "set-baud", "x", "1"), "ID"),
    ):
        result = CliRunner().invoke(cli, words)
        assert result.exit_code == 2
        assert says in result.stderr
        assert "place" not in result.stderr.lower().replace("a place has", "")
        assert result.stderr.count("\n") == 1


def test_an_unknown_option_is_refused_by_every_command_with_a_suggestion() -> None:
    for name, command in ALL.items():
        known = [option for option in options_of(command) if option.startswith("--") and len(option) > 5]
        wrong = f"{known[0]}x" if known else "--nothing-like-it"
        result = CliRunner().invoke(cli, [*name.split(), wrong])
        assert (result.exit_code, type(result.exception)) == (2, SystemExit), (name, result.output)
        said = result.stderr
        assert f"No such option '{wrong}'" in said, (name, said)
        assert not known or f"'{known[0]}'" in said, (name, said)
        assert said.count("\n") == 1, (name, said)


def test_no_command_suggests_an_option_that_nobody_can_have_meant() -> None:
    for name, command in ALL.items():
        for wrong in ("--quux", "--wait", "--timeouts-of-everything"):
            if wrong in options_of(command):
                continue
            said = CliRunner().invoke(cli, [*name.split(), wrong]).stderr
            assert "Did you mean" not in said, (name, said)
            assert (wrong == "--wait") == ("The command waits without it" in said), (name, said)


@pytest.mark.parametrize("words", ["goto -10 220 -5", "line -10 -20.5 -1e2", "model fk 1 -2 3 -4 5 -6", "grip -5"])
def test_a_negative_number_is_no_option(words: str) -> None:
    port = () if words.startswith("model") else ("--port", "udp://127.0.0.1:9", "--timeout", "0.1")
    for extra in ((), ("--robot", "hex7bot")):
        result = CliRunner().invoke(cli, [*words.split(), *extra, *port])
        assert "No such option" not in result.stderr
    result = CliRunner().invoke(cli, [*words.split(), "--wiat", *port])
    assert (result.exit_code, "No such option '--wiat'" in result.stderr) == (2, True)


def test_what_an_option_takes_is_no_option_of_its_own() -> None:
    result = CliRunner().invoke(
        cli, ["model", "ik", "10", "-20", "200", "--rpy", "-1", "-2", "-3", "--links", "-x"]
    )
    assert "no link set '-x'" in result.stderr.lower()
    assert "No such option" in CliRunner().invoke(cli, ["model", "ik", "1", "2", "3", "-x"]).stderr
    assert "No such option" not in CliRunner().invoke(cli, ["goto", "--", "--wait"]).stderr
