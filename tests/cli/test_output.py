from __future__ import annotations

import io
import json
import math
import os
import re
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from tests.recorded import make_positions

from hexwire.cli import output
from hexwire.cli.main import cli
from hexwire.cli.output import format_table, plain, print_json, say, say_document, settings_text, shown
from hexwire.control.requests.setting import Setting
from hexwire.link import ports
from hexwire.link.ports import PortInfo
from hexwire.trace.recording import RecordingWriter

EVIL = "J\x1b]0;owned\x07\x1b[2J\u202e\x9b31m\x7f\n\rerror: x"
SHOWN = r"J\x1b]0;owned\x07\x1b[2J\u202e\x9b31m\x7f\n\rerror: x"
CONTROL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


@given(st.text())
def test_shown_text_is_one_line_without_control_characters(text: str) -> None:
    assert shown(text).isprintable()
    if text.isprintable():
        assert shown(text) == text


def test_codes() -> None:
    assert shown(EVIL) == SHOWN
    assert shown("\t\u2066\U000e0041\udcff\xa0") == r"\t\u2066\U000e0041\xff\xa0"
    assert shown("Müller → 7 °, [red] \\x1b") == "Müller → 7 °, [red] \\x1b"


def test_lines(capsys: pytest.CaptureFixture[str]) -> None:
    say("a", EVIL)
    say()
    say_document(f"one\ntwo {EVIL[:3]}\n")
    assert capsys.readouterr().out == f"a\n{SHOWN}\n\none\ntwo J\\x1b]\n"


def test_a_stream_that_cannot_write_it() -> None:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="ascii")
    output.write(stream, "Müller →\n", flush=True)
    assert raw.getvalue() == b"M\\xfcller \\u2192\n"


def test_json_stays_json(capsys: pytest.CaptureFixture[str]) -> None:
    for one_line in (False, True):
        print_json({"name": EVIL, EVIL: ["Müller", "\U000e0041"]}, one_line=one_line)
        out = capsys.readouterr().out
        assert not CONTROL.search(out)
        assert json.loads(out) == {"name": EVIL, EVIL: ["Müller", "\U000e0041"]}
        assert "Müller" in out
        assert (out.count("\n") == 1) == one_line


def test_json_has_no_noise(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(
        {"a": 1.347e-14, "b": -0.0, "c": [0.1 + 0.2, math.nan, math.inf], "d": 2e-6, "e": 1.5}, one_line=True
    )
    assert capsys.readouterr().out == '{"a": 0.0, "b": 0.0, "c": [0.3, null, null], "d": 2e-06, "e": 1.5}\n'


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(-0.04, 1, "0.0"), (1.347e-14, 3, "0.000"), (-1.25, 1, "-1.2"), (math.nan, 1, "-"), (1234567.0, 0, "1234567")],
)
def test_numbers_for_people(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


def test_numbers_with_a_sign() -> None:
    assert [plain(value, 1, sign=True) for value in (0.3, -0.01, -2)] == ["+0.3", "+0.0", "-2.0"]


HEAD = ("joint", "deg", "deg/s", "load %", "V", "condition")
ROWS = [
    ("J1", "-104.47", "0.0", "1.5", "7.4", "ok"),
    ("J2", "54.65", "-12.0", "-", "7.3", "overload, overheated, clamped to its limit"),
]


def test_a_table_that_fits() -> None:
    lines = format_table(("joint", "deg"), [("J1", "-4.5"), ("Jaw", "10.0")]).split("\n")
    assert lines == ["joint   deg", "J1     -4.5", "Jaw    10.0"]
    assert format_table(HEAD, ROWS, width=200) == format_table(HEAD, ROWS)


def test_a_narrow_terminal_loses_nothing() -> None:
    wanted = {word for row in (HEAD, *ROWS) for cell in row for word in cell.split()}
    for width in range(18, 90):
        text = format_table(HEAD, ROWS, width=width)
        assert max(map(len, text.split("\n"))) <= width, width
        assert wanted - set(text.split()) == set(), width
        assert {block.split()[0] for block in text.split("\n\n")} == {"joint"}, width


def test_several_columns_may_say_what_a_row_is() -> None:
    blocks = format_table(("id", "name", "a", "b"), [("1", "x", "11111", "22222")], keys=2, width=16).split("\n\n")
    assert [block.split("\n")[0].split() for block in blocks] == [["id", "name", "a"], ["id", "name", "b"]]


def test_cells_cannot_command_the_terminal_nor_forge_a_row() -> None:
    lines = format_table(("joint",), [(EVIL,), ("J2",)]).split("\n")
    assert lines == ["joint", SHOWN, "J2"]


def test_lines_are_folded_between_words_on_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(output, "line_width", lambda: 24)
    say("  moving to: J1 10.00  J2 -20.25  J3 30.00 deg", "short")
    say_document("export ROS_PACKAGE_PATH=/a/very/long/path:/and/another")
    assert capsys.readouterr().out.split("\n") == [
        "  moving to: J1 10.00",
        "    J2 -20.25  J3 30.00",
        "    deg",
        "short",
        "export ROS_PACKAGE_PATH=/a/very/long/path:/and/another",
        "",
    ]


def test_the_width_is_the_terminals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert output.line_width() is None
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert output.line_width() == 60


# --- whatever text comes from outside -------------------------------------------------------------------------


def run(*words: str) -> str:
    """Everything that a command prints."""
    result = CliRunner().invoke(cli, list(words))
    assert not isinstance(result.exception, Exception), result.exception
    assert not CONTROL.search(result.stdout + result.stderr), repr(result.output)
    return result.stdout + result.stderr


def test_strings_of_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    port = PortInfo("/dev/ttyUSB0", 1, 2, EVIL, EVIL, f"unknown {EVIL} [red]x[/red] [link=http://x]y[/link]")
    monkeypatch.setattr(ports, "list_ports", lambda: [port])
    text = run("ports")
    assert SHOWN in text
    assert "[red]x[/red] [link=http://x]y[/link]" in text
    assert json.loads(run("ports", "--json"))[0]["serial_number"] == EVIL


def test_names_in_recordings(tmp_path: Path) -> None:
    file, table = tmp_path / "a.mcap", tmp_path / "a.csv"
    with RecordingWriter(file) as writer:
        writer.joint_state(make_positions((EVIL,), (0.1,)), 1.7e9)
        writer.raw(f"/{EVIL}", 1.7e9, b"x")
    assert SHOWN in run("record", "info", str(file))
    assert run("play", str(file), "--port", "/dev/ttyTEST").startswith("error: ")
    run("record", "export", str(file), str(table))
    run("trace", "decode", str(file))


def test_names_of_files(tmp_path: Path) -> None:
    for name in ("a\x1b[31m\nerror: forged", "b\u202e.conf", os.fsdecode(b"c\xff.conf")):
        file = tmp_path / name
        text = run("conf", "check", str(file))
        assert "cannot be read" in text
        file.write_text("")
        text = run("conf", "check", str(file))
        assert shown(name) in text
        assert text.count("\n") == 1
        out = str(tmp_path / f"{name}.toml")
        run("conf", "convert", str(file), out)
        assert shown(name.replace("\n", " ")) in run("conf", "convert", str(file), out)


def test_words_of_a_person() -> None:
    for words in (
        ("move", f"{EVIL}=5"),
        ("state", "--robot", EVIL),
        (EVIL,),
        ("play", EVIL),
        ("conf", "check", EVIL),
        ("bus", "scan", "--series", EVIL),
        ("bus", "scan", "--ids", EVIL),
        ("sim", "board", "--fault", EVIL),
        ("model", "fk", *["0"] * 6, "--links", EVIL),
    ):
        text = run(*words)
        assert text.startswith("error: "), words
        assert text.count("\n") == 1, words


def test_urls() -> None:
    for url in (f"tcp://{EVIL}", f"tcp://127.0.0.1:1?{EVIL}", f"/dev/{EVIL}"):
        text = run("state", "--port", url)
        assert text.startswith("error: ")
        assert text.count("\n") == 1


class Kilogram(NamedTuple):
    name: str
    mass: float
    known: bool = True


THINGS: output.RowType[Kilogram] = output.RowType(
    output.Column("name", "thing"),
    output.Column("mass_kg", "g", "mass", 1, 1000),
    output.Column("known", "known?"),
    output.Column("**", get=lambda row: {"first": row.name[0]}),
    output.Column("", "note", text=lambda row: f"<{row.name}>"),
    words=lambda row: f"{row.name} weighs {row.mass} kg",
)


def test_a_row_is_described_once(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [Kilogram("nut", 0.0015), Kilogram("bolt", math.nan, False)]
    THINGS.show(rows)
    assert capsys.readouterr().out.splitlines() == [
        "thing    g  known?  note",
        "nut    1.5  yes     <nut>",
        "bolt     -  no      <bolt>",
    ]
    assert THINGS.tell(iter(rows[:1])) == rows[:1]
    THINGS.answer(rows[0])
    assert capsys.readouterr().out == "nut weighs 0.0015 kg\n" * 2
    data = [
        {"name": "nut", "mass_kg": 0.0015, "known": True, "first": "n"},
        {"name": "bolt", "mass_kg": None, "known": False, "first": "b"},
    ]
    assert tuple(THINGS.as_json(rows[0]).values()) == ("nut", 0.0015, True, "n")
    with output.printing_json(True):
        THINGS.show(rows)
        listed = json.loads(capsys.readouterr().out)
        assert THINGS.tell(iter(rows)) == rows
        assert json.loads(capsys.readouterr().out) == listed == data
        THINGS.answer(rows[0])
        assert json.loads(capsys.readouterr().out) == data[0]


def test_with_json_nothing_is_said_until_the_command_ends(capsys: pytest.CaptureFixture[str]) -> None:
    with output.printing_json(True):
        say("one")
        output.say_table(("a",), [("1",)])
        output.say_finding("bad", "broken", "mend it")
    assert capsys.readouterr().out == ""
    output.answer({}, "two")
    output.answer({})
    assert capsys.readouterr().out == "two\n"


def test_texts_are_beside_short_names_and_below_long_ones() -> None:
    row = Setting("rate", 1.0, "states per second", "Hz", low=0.0, high=9.0)
    rows = [("rate:=1.0", row), ("r" * 50, row), ("of:=x", Setting("of", "x", "words " * 40))]
    lines = settings_text(rows).splitlines()
    assert lines[0] == "  rate:=1.0  states per second (0 to 9 Hz)"
    assert lines[1:3] == ["  " + "r" * 50, " " * 13 + "states per second (0 to 9 Hz)"]
    assert all(line.startswith(" " * 13 + "words") for line in lines[4:])
    assert max(map(len, lines)) <= 112
