"""A group of commands that are imported when they are used."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hexwire.cli.main import LazyGroup

LOCATIONS = {"second": "commands_of_a_test:second", "first": "commands_of_a_test:first"}


@pytest.fixture
def group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LazyGroup:
    (tmp_path / "commands_of_a_test.py").write_text(
        "import click\n@click.command()\ndef first():\n    'Does the first thing.'\n    click.echo('done')\n"
        "@click.command()\ndef second():\n    'Does the second thing.'\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "commands_of_a_test", raising=False)
    return LazyGroup("group", locations=LOCATIONS, commands={"own": click.Command("own", help="Is here.")})


def test_its_help_names_all_commands_in_order(group: LazyGroup) -> None:
    said = CliRunner().invoke(group, ["--help"]).output
    assert said.index("Does the first thing.") < said.index("Is here.") < said.index("Does the second thing.")


def test_a_command_of_its_own_imports_no_other(group: LazyGroup) -> None:
    assert CliRunner().invoke(group, ["own"]).exit_code == 0
    assert "commands_of_a_test" not in sys.modules


def test_a_command_is_imported_when_it_is_used(group: LazyGroup) -> None:
    assert CliRunner().invoke(group, ["first"]).output == "done\n"
    assert "commands_of_a_test" in sys.modules


def test_an_unknown_command_is_none(group: LazyGroup) -> None:
    assert group.get_command(click.Context(group), "third") is None
    assert CliRunner().invoke(group, ["third"]).exit_code == 2
