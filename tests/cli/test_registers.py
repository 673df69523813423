"""`hexwire registers`: the table of a servo behind a board."""

from __future__ import annotations

import itertools
import json

import pytest
from click.testing import CliRunner, Result

from hexwire.cli.main import cli
from hexwire.wire.registers import Series

_NUMBERS = itertools.count()


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["registers", *words])


@pytest.fixture
def port() -> str:
    return f"sim://hex7bot?name=registers{next(_NUMBERS)}"


def test_all_registers_of_a_servo(port: str) -> None:
    result = run("J6", "--json", "--port", port)
    assert result.exit_code == 0, result.output
    shown = json.loads(result.stdout)
    assert (shown["joint"], shown["servo"], shown["series"]) == ("J6", 5, "hls")
    rows = {row["register"]: row for row in shown["registers"]}
    assert list(rows) == list(Series.HLS.registers)
    assert rows["id"]["raw"] == 5
    assert rows["present_position"]["raw"] == pytest.approx(2046, abs=3)


def test_those_that_are_named_of_a_legacy_servo_too(port: str) -> None:
    result = run("J2", "present_position", "id", "--port", port)
    assert result.exit_code == 0, result.output
    lines = [line.split() for line in result.stdout.splitlines()]
    assert [line[:2] for line in lines[-2:]] == [["56", "present_position"], ["5", "id"]]
    assert [abs(int(lines[-2][2]) - 2043) < 4, lines[-1][2]] == [True, "1"]


@pytest.mark.parametrize(
    ("words", "why"),
    [(("J9",), "J9"), (("J6", "nothing"), "no register"), (("J6", "present_positio"), "did you mean")],
)
def test_what_there_is_not(port: str, words: tuple[str, ...], why: str) -> None:
    result = run(*words, "--port", port)
    assert result.exit_code == 2
    assert why in result.stderr


def test_an_arm_without_a_board() -> None:
    result = run("shoulder_pan", "--port", "sim://so101?name=registers")
    assert result.exit_code == 1
    assert "hexwire bus read" in result.stderr
