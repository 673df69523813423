from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "schema"


@pytest.fixture
def load(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The schema's own module; the folder is a script's, not a package's."""
    monkeypatch.syspath_prepend(str(SCHEMA))
    import load  # type: ignore[import-not-found]

    return load


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what the generator reads."""
    shutil.copytree(SCHEMA, tmp_path / "schema", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "PROTOCOL.md", tmp_path)
    (tmp_path / "firmware/core").mkdir(parents=True)
    return tmp_path


def generate(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCHEMA / "generate.py"), "--root", str(root), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_what_is_committed_is_up_to_date() -> None:
    done = generate(ROOT, "--check")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_stale_file_is_named_and_left_alone(tree: Path) -> None:
    assert generate(tree).returncode == 0
    assert generate(tree, "--check").returncode == 0
    for stale in ("src/hexwire/wire/tables.py", "firmware/core/generated.h"):
        path = tree / stale
        good = path.read_text()
        path.write_text(good + "\n")
        done = generate(tree, "--check")
        assert done.returncode == 1
        assert done.stderr == f"{stale} is stale: run python schema/generate.py\n"
        assert path.read_text() == good + "\n"
        path.write_text(good)


def test_the_same_schema_gives_the_same_bytes(tree: Path) -> None:
    files = ("src/hexwire/wire/tables.py", "PROTOCOL.md", "firmware/core/generated.h")
    generate(tree)
    first = [(tree / name).read_bytes() for name in files]
    assert first[0] == (ROOT / files[0]).read_bytes()
    for name in files[::2]:
        (tree / name).unlink()
    generate(tree)
    assert [(tree / name).read_bytes() for name in files] == first


def test_documents_keep_what_is_outside_the_marks(tree: Path) -> None:
    text = "before\n<!-- generated:commands -->\nstale words\n<!-- /generated -->\nafter\n"
    (tree / "PROTOCOL.md").write_text(text)
    assert generate(tree).returncode == 0
    filled = (tree / "PROTOCOL.md").read_text()
    assert filled.startswith("before\n<!-- generated:commands -->\n| command |")
    assert filled.endswith("<!-- /generated -->\nafter\n")
    assert "stale words" not in filled
    (tree / "PROTOCOL.md").write_text("no marks\n")
    assert generate(tree).returncode == 0
    assert (tree / "PROTOCOL.md").read_text() == "no marks\n"


def test_an_unknown_mark_is_an_error(tree: Path) -> None:
    (tree / "PROTOCOL.md").write_text("<!-- generated:nothing -->\n<!-- /generated -->\n")
    done = generate(tree)
    assert done.returncode == 1
    assert "no generated block nothing" in done.stderr


def test_without_a_firmware_there_is_no_header(tree: Path) -> None:
    (tree / "firmware/core").rmdir()
    assert generate(tree).returncode == 0
    assert not (tree / "firmware").joinpath("core").exists()


def test_the_header_has_the_numbers_of_the_tables(tree: Path) -> None:
    lines = (
        "constexpr uint32_t SYNC = 0x5AFAFA5AUL;",
        "constexpr uint8_t CMD_TRANSACT = 0x1A;",
        "constexpr uint8_t HLS_REG_GOAL_TORQUE = 44;",
        "constexpr uint16_t CAPABILITY_IO = 0x0100;",
        "constexpr uint8_t JOINT_STATE_REPLY_SIZE = 8;",
        "constexpr uint8_t JOINT_STATE_REPLY_ROW_SIZE = 3;",
        "constexpr int32_t MODULE_INVALID_MODULE = -1;",
    )
    uses = [f"send(gen::{line.split()[2]});" for line in lines]
    (tree / "firmware/test").mkdir()
    (tree / "firmware/test/uses.cpp").write_text("\n".join(uses))
    generate(tree)
    header = (tree / "firmware/core/generated.h").read_text().splitlines()
    assert {line for line in header if line.startswith("constexpr")} == set(lines)
    assert "// TRANSACT: " in "\n".join(header)
    assert not [line for line in header if line.startswith("// STOP: ")]


def test_the_header_holds_only_what_the_firmware_or_its_tests_use() -> None:
    header = (ROOT / "firmware/core/generated.h").read_text()
    sources = [
        path.read_text()
        for pattern in ("core/*", "boards/*/*", "test/*")
        for path in (ROOT / "firmware").glob(pattern)
        if path.suffix in (".h", ".cpp", ".ino") and path.name != "generated.h"
    ]
    constants = re.findall(r"^constexpr \w+ (\w+) =", header, re.MULTILINE)
    macros = re.findall(r"^#define (HEXWIRE_\w+) \{", header, re.MULTILINE)
    words = set(re.findall(r"gen::\w+|\w+", "\n".join(sources)))
    assert len(constants) > 100
    assert not {f"gen::{name}" for name in constants} - words
    assert len(macros) == 2
    assert not set(macros) - words
    assert len(set(constants)) == len(constants)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows.append({**rows[0], "name": "twin"}), "twin: overlaps id at address 5"),
        (lambda rows: rows.append({**rows[0], "at": 200}), "id: the name occurs twice"),
        (lambda rows: rows[0].update(size=3), "id: size 3 is not 1 or 2 bytes"),
        (lambda rows: rows[0].update(sign=8), "id: sign bit 8 is outside its 8 bits"),
        (lambda rows: rows[0].update(default=254), "id: default 254 is outside 0..253"),
        (lambda rows: rows[0].update(max=256), r"id: range 0..256 does not fit its coding \(0..255\)"),
        (lambda rows: rows[0].update(min=9, max=8), "id: range 9..8"),
        (lambda rows: rows[0].update(at=256), "id: address 256 is not a byte"),
        (lambda rows: rows[0].update(area="flash"), "id: unknown area flash"),
        (lambda rows: rows[0].update(access="w"), "id: access w is not r or rw"),
        (lambda rows: rows[0].update(unit="furlong", scale=1), "id: unknown unit furlong"),
        (lambda rows: rows[0].update(unit="V"), "id: unit and scale belong together"),
        (lambda rows: rows[0].update(bits={"9": "x"}), "id: bit 9 is outside its 8 bits"),
        (lambda rows: rows[0].update(sing=7), "id: unknown key sing"),
    ],
)
def test_bad_register_rows(load: Any, change: Callable[[list[dict[str, Any]]], None], message: str) -> None:
    rows = load.load().registers["series"]["seven_bot"]["registers"]
    change(rows)
    with pytest.raises(load.SchemaError, match=rf"^registers.toml: seven_bot\.{message}"):
        load.check_rows("seven_bot", rows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["STOP"].update(code=1), "STOP and PING are both 1"),
        (lambda c: c["STOP"].update(request=[["mode", "u64"]]), "field mode: unknown type u64"),
        (lambda c: c["STOP"].update(request=[["a", "u8"], ["a", "u8"]]), "a field name occurs twice"),
        (lambda c: c["STOP"].update(request=[["a", "bytes"], ["b", "u8"]]), "only the last field may be bytes"),
        (lambda c: c["STOP"].update(rows=[["a", "u8"]]), "rows without a count"),
        (lambda c: c["STOP"].update(rows=[["a", "u8"]], count="n"), "the count field n is not in the body"),
        (lambda c: c["STOP"].update(reply=[["a", "u8", "warp"]]), "field a: warp is not in"),
    ],
)
def test_bad_commands(load: Any, change: Callable[[dict[str, Any]], None], message: str) -> None:
    commands = load.load().commands
    change(commands["commands"])
    with pytest.raises(load.SchemaError, match=message):
        load.check_commands(commands)


def test_bad_header(load: Any) -> None:
    session = load.load().session
    session["header"]["fields"][1][2] = 5
    with pytest.raises(load.SchemaError, match="time_sec: at 5, but the field before ends at 4"):
        load.check_session(session)
    session["header"]["fields"] = session["header"]["fields"][:1]
    with pytest.raises(load.SchemaError, match="header fields end at 4, size says 32"):
        load.check_session(session)


def test_a_broken_file_is_one_line_and_no_traceback(tree: Path) -> None:
    (tree / "schema/registers.toml").write_text("[packet\n")
    done = generate(tree)
    assert done.returncode == 1
    assert done.stderr.startswith("registers.toml: ")
    assert done.stderr.count("\n") == 1
    (tree / "schema/commands.toml").unlink()
    assert "commands.toml: cannot be read" in generate(tree).stderr
