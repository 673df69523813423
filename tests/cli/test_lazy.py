"""A group of commands that are imported when they are used."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hexwire.cli.lazy import LazyGroup

TABLE = {
    "second": ("commands_of_a_test:second", "Does the second thing."),
    "first": ("commands_of_a_test:first", "Does the first thing."),
}


@pytest.fixture
def group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LazyGroup:
    (tmp_path / "commands_of_a_test.py").write_text(
        "import click\n@click.command()\ndef first(): click.echo('done')\nsecond = first\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "commands_of_a_test", raising=False)
    return LazyGroup("group", table=TABLE)


def test_its_help_names_all_commands_in_order_and_imports_none(group: LazyGroup) -> None:
    said = CliRunner().invoke(group, ["--help"]).output
    assert said.index("Does the first thing.") < said.index("Does the second thing.")
    assert "commands_of_a_test" not in sys.modules


def test_a_command_is_imported_when_it_is_used(group: LazyGroup) -> None:
    assert CliRunner().invoke(group, ["first"]).output == "done\n"
    assert "commands_of_a_test" in sys.modules


def test_an_unknown_command_is_none(group: LazyGroup) -> None:
    assert group.get_command(click.Context(group), "third") is None
    assert CliRunner().invoke(group, ["third"]).exit_code == 2
