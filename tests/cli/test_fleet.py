"""`hexwire fleet`: the group."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from hexwire.cli.fleet import fleet
from hexwire.cli.main import cli


def test_the_group_lists_its_commands() -> None:
    result = CliRunner().invoke(cli, ["fleet", "--help"])
    assert result.exit_code == 0
    for name, command in fleet.commands.items():
        assert name in result.stdout
        assert command.short_help
        assert command.short_help in result.stdout


@pytest.mark.parametrize("name", sorted(fleet.commands))
def test_each_command_has_help(name: str) -> None:
    result = CliRunner().invoke(cli, ["fleet", name, "--help"])
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"Usage: cli fleet {name} ")


def test_a_command_that_is_not_there() -> None:
    result = CliRunner().invoke(cli, ["fleet", "dance"])
    assert result.exit_code == 2
