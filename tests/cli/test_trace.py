"""`hexwire trace decode` and the two switches that stand anywhere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.cli.main import LazyGroup, cli
from hexwire.cli.trace import trace, tracing
from hexwire.link.open import make_link
from hexwire.link.tap import TapLink

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


def test_a_traced_state_is_in_the_log_of_the_chapter(bench: Any) -> None:
    said = bench.run("state", "--trace").stderr
    head, row = said.splitlines()[-2:]
    assert head == "hex7bot:: HW read (degree):"
    assert row.startswith("J1=-4.47257 J2=54.6484 J3=-3.55452 J4=-0.703134 J5=3.1641 J6=-0.0878917 J7=")


def test_a_channel_of_a_file_is_traced_once(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    file.write_text("ARM_7BOT_SERIAL_TRX CLIENT_TRX 8 TCP 127.0.0.1 15030\n")
    with tracing(explain=False):
        link = make_link(str(file))
    assert isinstance(link, TapLink)
    assert not isinstance(link.link, TapLink)


def test_modules_of_other_packages_have_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[int] = []
    monkeypatch.setattr("hexwire.cli.trace.load_own_modules", lambda: loaded.append(1))
    CliRunner().invoke(trace, ["decode", "-"], input=LOG)
    with tracing(explain=True):
        pass
    assert loaded == [1, 1]
