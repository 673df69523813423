"""`hexwire trace decode` and the two switches that stand anywhere."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hexwire.cli.lazy import LazyGroup
from hexwire.cli.main import cli
from hexwire.cli.trace import trace

LOG = """\
SerialPort sent - Length=52
5A FA FA 5A DB 9A 7A 68 08 B7 9E 10 2F 00 00 00| Z Z zh /
07 00 00 00 08 00 00 00 03 00 00 00 34 00 00 00| 4
82 01 2F 00 08 00 02 00 FF FF 00 04 02 38 02 BF| / 8
3D 86 0D 0A |=
SerialPort receive - Length=32
5A FA FA 5A 0E 00 00 00 00 A8 CB 18 2E 00 00 00| Z Z .
08 00 00 00 00 00 00 00 08 00 00 00 34 00 00 00| 4
SerialPort receive - Length=20
82 01 2E 00 08 00 02 00 FF F5 00 04 00 05 08 EE| .
FF FF 0A 0A
"""


def test_the_chapters_log_in_words(tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    file.write_text(LOG)
    result = CliRunner().invoke(trace, ["decode", str(file)])
    assert result.exit_code == 0
    assert "read 0: present_position, 2 bytes" in result.output
    assert "present_position 2053" in result.output
    assert "ICRNL" in result.output


def test_every_field_with_the_place_of_its_bytes() -> None:
    result = CliRunner().invoke(trace, ["decode", "-", "--fields"], input=LOG)
    lines = [line.strip() for line in result.output.splitlines()]
    assert "0-3   sync: 5A FA FA 5A" in lines
    assert "45-46     present_position: 2053 = 180.439 deg" in lines
    assert "50-51   tail: 0A 0A ! is 0A 0A, not 0D 0A" in lines
    assert "pairing  answers seq 47" in lines
    result = CliRunner().invoke(trace, ["decode", "-", "--fields", "--json"], input=LOG)
    trees = [json.loads(line)["tree"] for line in result.output.splitlines()]
    assert [(tree["start"], tree["end"]) for tree in trees] == [(0, 52), (0, 52)]
    assert trees[0]["parts"][0]["parts"][0]["meaning"] == "The word by which a receiver finds a frame."


def test_the_same_for_programs_from_standard_input() -> None:
    result = CliRunner().invoke(trace, ["decode", "-", "--json"], input=LOG)
    rows = [json.loads(line) for line in result.output.splitlines()]
    assert [row["direction"] for row in rows] == ["sent", "received"]
    assert rows[1]["servo"]["registers"][0]["raw"] == 2053
    assert rows[1]["pairing"]["request_seq"] == 0x2F
    assert "ICRNL" in rows[1]["problem"]


@pytest.mark.parametrize("args", [["--trace", "trace", "decode"], ["trace", "decode", "--explain"]])
def test_the_switches_may_stand_anywhere(args: list[str], tmp_path: Path) -> None:
    file = tmp_path / "log.txt"
    file.write_text(LOG)
    assert isinstance(cli, LazyGroup)
    context = cli.make_context("hexwire", [*args, str(file)])
    with context:
        assert context.params["trace"] or context.params["explain"]
