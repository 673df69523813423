"""Files in general: what is no plain file, what is too large, and text, JSON and TOML made to hurt."""

from __future__ import annotations

import io
import json
import math
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire import inputs
from hexwire.errors import ConfigError
from hexwire.inputs import (
    Item,
    decode_text,
    parse_json,
    parse_toml,
    read_bytes,
    read_stream,
    read_text,
)


def said(call: Any, *args: Any, **named: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        call(*args, **named)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# -- what a name may stand for ------------------------------------------------------------------------------


def test_a_pipe_or_device_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, why in (
        (tmp_path / "pipe", "is a pipe or a device, not a file"),
        (Path("/dev/zero"), "is a pipe or a device, not a file"),
        (tmp_path, "cannot be read: Is a directory"),
        (tmp_path / "none", "cannot be read: No such file or directory"),
        (tmp_path / ("x" * 300), "cannot be read: File name too long"),
        (tmp_path / "pipe" / "x", "cannot be read: Not a directory"),
    ):
        assert said(read_bytes, name) == f"{name}: {why}"
    assert "cannot be read: embedded null byte" in said(read_bytes, "a\0b")


def test_a_file_that_is_too_large_is_not_read_to_its_end(tmp_path: Path) -> None:
    with (tmp_path / "big").open("wb") as file:
        file.truncate(1 << 40)
    assert said(read_text, tmp_path / "big").endswith("big: is larger than 1 MiB, the limit for this kind of file")
    assert read_stream(io.BytesIO(b"abc"), "it", largest=3) == b"abc"
    assert said(read_stream, io.BytesIO(b"abcd"), "it", largest=3).startswith("it: is larger than")


@pytest.mark.parametrize(
    ("data", "place"),
    [
        (b"\xff", "f:1:1: not UTF-8 text"),
        (b"one\r\ntwo \xc3(", "f:2:5: not UTF-8 text"),
        (b"one\0", "f:1:4: not UTF-8 text"),
        ("x = 1".encode("utf-16"), "f:1:1: is UTF-16 text; save it as UTF-8"),
    ],
)
def test_bytes_that_are_not_text_are_reported_with_their_place(data: bytes, place: str) -> None:
    assert said(decode_text, data, "f") == place


def test_marks_and_line_ends_of_other_systems() -> None:
    assert decode_text(b"\xef\xbb\xbfa = 1\r\nb = 2\r\n") == "a = 1\nb = 2\n"
    assert parse_json(b'\xef\xbb\xbf{"a": 1}').value == parse_json('\ufeff{"a": 1}').value == {"a": 1}
    assert parse_toml(decode_text(b"\xef\xbb\xbfa = 1\r\n")).value == {"a": 1}


# -- JSON and TOML ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "f:1:1: not JSON"),
        ('{"a":\n 1,b}', "f:2:4: not JSON"),
        ("[" * 100_000, "f: brackets are nested too deeply"),
        ('{"a":' * 100_000, "f: brackets are nested too deeply"),
        ('{"a": {"b": 1, "b": 1}}', "f: the key 'b' occurs twice in one table"),
        ('{"\\u001b[2J": 1, "\\u001b[2J": 2}', "f: the key '\\x1b[2J' occurs twice in one table"),
    ],
)
def test_json_nested_too_deeply_is_refused(text: str, words: str) -> None:
    assert said(parse_json, text, "f").startswith(words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = = 1", "f:1:5: not TOML: Invalid value"),
        ("\na = " + "9" * 5000, "f:2:5: a number with too many digits"),
        ("\na = 0x" + "f" * 5000, "f:2:5: a number with too many digits"),
        ("a = " + "[" * 100_000, "f: brackets are nested too deeply"),
        ("# " + "." * 100 + "\n" + ".".join("a" * 40) + " = 1", "f:2:1: more than 32 dots in a line; split it"),
        ("a = 1\na = 2", "f: not TOML: Cannot overwrite a value (at end of document)"),
        ("a\\n = 1", "f:1:2: not TOML"),
    ],
)
def test_toml_nested_too_deeply_is_refused(text: str, words: str) -> None:
    assert said(parse_toml, text, "f").startswith(words)


SLOW = {
    "json": ("parse_json", "[" + "1e5," * 200_000 + "1]"),
    "json digits": ("parse_json", "[" + "1" * 1_000_000 + "]"),
    "json text": ("parse_json", '"' + "\\\\" * 400_000 + '"'),
    "toml keys": ("parse_toml", "".join(f"a{i} = 1\n" for i in range(60_000))),
    "toml tables": ("parse_toml", "".join(f"[a{i}.b.c.d.e.f.g.h]\n" for i in range(20_000))),
    "toml dots": ("parse_toml", ".".join("a" * 400_000) + " = 1"),
    "toml blanks": ("parse_toml", " " * 900_000 + "x"),
    "toml lines": ("parse_toml", "\n" * 900_000 + "x"),
    "toml digits": ("parse_toml", "a = " + "1" * 900_000),
    "toml brackets": ("parse_toml", "[" * 900_000),
}


def test_a_text_made_to_be_slow_is_not() -> None:
    """All of them in processor time of which each takes little; the square of these lengths would be hours."""
    code = (
        "import json, sys, hexwire.inputs as i\nfrom hexwire.errors import ConfigError\n"
        "for what, (name, text) in json.load(sys.stdin).items():\n"
        "    print(what, flush=True)\n"
        "    try: getattr(i, name)(text)\n"
        "    except ConfigError: pass"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(SLOW).encode(),
        capture_output=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (60, 60)),
    )
    assert (done.returncode, done.stderr) == (0, b""), f"at the last of {done.stdout.decode().splitlines()}"
    assert done.stdout.decode().splitlines() == list(SLOW)


PLACES = """\
top = 1
a.b = 2
inline = [{x = 1}]
[[arm]]
name = "x"
[[arm.joint]]
id = 1
[[arm.joint]]
  id =   2
"quoted" = 3
[arm.base]
z = 1
[[arm]]
[[arm.joint]]
id = 3
[other."o.o"]
y = 1
"""


@pytest.mark.parametrize(
    ("steps", "place"),
    [
        (["top"], (1, 7)),
        (["a", "b"], (2, 7)),
        (["inline", 0, "x"], (3, 10)),
        (["arm"], (4, 1)),
        (["arm", 0], (4, 1)),
        (["arm", 0, "name"], (5, 8)),
        (["arm", 0, "joint", 0, "id"], (7, 6)),
        (["arm", 0, "joint", 1], (8, 1)),
        (["arm", 0, "joint", 1, "id"], (9, 10)),
        (["arm", 0, "joint", 1, "quoted"], (10, 12)),
        (["arm", 0, "base", "z"], (12, 5)),
        (["arm", 1, "joint", 0, "id"], (15, 6)),
        (["other"], (0, 0)),
        (["other", "o.o", "y"], (0, 0)),
    ],
    ids=str,
)
def test_a_value_of_toml_knows_its_line(steps: list[str | int], place: tuple[int, int]) -> None:
    item = parse_toml(PLACES, "f")
    for step in steps:
        item = item.table()[step] if isinstance(step, str) else list(item.rows())[step]
    assert item.line_and_column == place
    shown = ":".join(map(str, ("f", *place))) if place[0] else "f"
    assert said(item.integer, 9, 9).startswith(f"{shown}: ")


def test_a_missing_key_has_the_line_of_its_table() -> None:
    (arm, _) = parse_toml(PLACES, "f").table()["arm"].rows()
    assert said(arm.table, ("speed",)) == "f:4:1: arm[0].speed is missing"


# -- values -------------------------------------------------------------------------------------------------


def at(text: str) -> Item:
    return parse_json(f'{{"rows": [{text}]}}', "f").table()["rows"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1e999", "must be a finite number"),
        ("NaN", "must be a finite number"),
        ("-Infinity", "must be a finite number"),
        ("9" * 5000, "must be a finite number"),
        ("null", "must be a number, not nothing"),
        ("true", "must be a number, not true"),
        ('"1"', "must be a number, not the text '1'"),
        ("[1]", "must be a number, not the list [1]"),
        ("{}", "must be a number, not a table"),
        ("-0.5", "is -0.5, but must be 0 to 10 mm"),
        ("1e308", "is 1e+308, but must be 0 to 10 mm"),
    ],
)
def test_an_invalid_number_is_refused(text: str, words: str) -> None:
    (item,) = at(text).rows()
    assert said(item.number, 0, 10, "mm") == f"f: rows[0] {words}"


def test_numbers_texts_lists_and_tables() -> None:
    (item,) = at("3").rows()
    assert (item.number(), item.integer(0, 3)) == (3.0, 3)
    assert said(item.integer, 0, 2) == "f: rows[0] is 3, but must be 0 to 2"
    assert said(item.number, 4) == "f: rows[0] is 3, but must be 4 or more"
    assert said(item.number, high=2) == "f: rows[0] is 3, but must be 2 or less"
    assert said(item.text) == "f: rows[0] must be text, not 3"
    assert said(item.rows) == "f: rows[0] must be a list, not 3"
    assert said(item.table) == "f: rows[0] must be a table, not 3"
    (half,) = at("0.5").rows()
    assert said(half.integer, 0, 9) == "f: rows[0] must be a whole number, not 0.5"
    assert said(at("1, 2, 3").rows, 2) == "f: rows has 3 values, but must have 0 to 2"
    (text,) = at('"a\\u0007"').rows()
    assert said(text.text) == "f: rows[0] has characters that cannot be printed"
    assert said(text.text, 1) == "f: rows[0] has 2 characters, but must have 0 to 1"
    assert parse_json("true").flag()
    assert said(item.flag) == "f: rows[0] must be true or false, not 3"
    assert parse_json('"a"').choice(("a", "b")) == "a"
    for other in (item, *at('["a"]').rows(), *at('"c"').rows()):
        assert "must be one of a, b, not " in said(other.choice, ("a", "b"))
    (table,) = at('{"a": 1, "b\\n": {"c": null}}').rows()
    assert said(table.table, (), ("a",)) == "f: rows[0].'b\\n' is an unknown key; known: a"
    assert said(table.table, ("z",)) == "f: rows[0].z is missing"
    assert said(table.table()["b\n"].table()["c"].number) == "f: rows[0].'b\\n'.c must be a number, not nothing"
    huge = Item(10**400, "f", "x")
    assert said(huge.number) == "f: x must be a finite number"
    assert said(huge.integer, 0, 1) == "f: x is too large, but must be 0 to 1"
    assert said(huge.text) == "f: x must be text, not a number with too many digits"


def test_a_list_of_numbers_has_as_many_as_it_must() -> None:
    assert at("1, 2.5").numbers(2, 0, 3) == (1.0, 2.5)
    assert said(at("1, 2").numbers, 3, 0, 3) == "f: rows has 2 values, but must have 3"
    assert said(at("1, 4").numbers, 2, 0, 3, "m") == "f: rows[1] is 4, but must be 0 to 3 m"


def test_the_faults_of_all_values_of_a_list_are_told_together() -> None:
    item = parse_toml("rows = [1, 'x', 9, 3]", "f").table()["rows"]

    def small(row: Item) -> int:
        return row.integer(0, 5)

    told = "1:8: rows[1] must be a whole number, not the text 'x'; 1:8: rows[2] is 9, but must be 0 to 5"
    assert said(item.each, small) == f"f: {told}"
    assert said(item.each, small, 3) == "f:1:8: rows has 4 values, but must have 0 to 3"
    assert said(parse_toml("rows = [1, 'x']", "f").table()["rows"].each, small).startswith("f:1:8: rows[1] must be")
    many = parse_toml(f"rows = {[9] * 21}", "f").table()["rows"]
    assert said(many.each, small).endswith("1:8: rows[9] is 9, but must be 0 to 5; and 11 more")
    assert parse_toml("rows = [1, 2]", "f").table()["rows"].each(small) == [1, 2]


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@given(values)
def test_any_value_is_taken_or_refused_in_one_line(value: Any) -> None:
    item = parse_json(json.dumps(value), "f")
    for take in (
        lambda: item.number(-1e9, 1e9),
        lambda: item.integer(0, 9),
        lambda: item.text(5),
        lambda: list(item.rows(3)),
        lambda: item.table(("a",), ()),
    ):
        found, words = None, "f: "
        try:
            found = take()
        except ConfigError as error:
            words = str(error)
        assert words.startswith("f: ")
        assert words.isprintable()
        assert not isinstance(found, float) or math.isfinite(found)


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_any_bytes_are_parsed_or_refused_by_one_error(data: bytes) -> None:
    for parse in (lambda: parse_json(data, "f"), lambda: parse_toml(decode_text(data, "f"), "f")):
        words = "f:"
        try:
            parse()
        except ConfigError as error:
            words = str(error)
        assert words.startswith("f:")


def test_only_faults_that_are_not_told_are_counted() -> None:
    texts = [str(i) for i in range(inputs.MOST_FAULTS + 1)]
    assert inputs.first_faults(texts[:-1]) == texts[:-1]
    assert inputs.first_faults(texts) == [*texts[:-1], "and 1 more"]


def test_a_text_has_its_least_and_its_most_characters() -> None:
    item = parse_json(b'"abc"')
    assert [item.text(3), item.text(least=3), item.text(3, least=3)] == ["abc"] * 3
    for most, least in ((2, 0), (9, 4)):
        with pytest.raises(ConfigError, match=f"has 3 characters, but must have {least} to {most}"):
            item.text(most, least=least)


@pytest.mark.parametrize(
    ("number", "told"), [(10**15, "not 1000000000000000"), (10**20, "not a number with too many digits")]
)
def test_a_number_where_a_text_must_be_is_told_unless_it_is_endless(number: int, told: str) -> None:
    with pytest.raises(ConfigError, match=f"must be text, {told}"):
        Item(number).text()


def test_a_message_that_is_too_large_is_not_parsed() -> None:
    text = b'"' + b"a" * (inputs.LARGEST_MESSAGE - 2) + b'"'
    assert len(inputs.parse_message(text, "a.mcap", "message 5").text(2**21)) == len(text) - 2
    with pytest.raises(ConfigError, match=r"a.mcap: message 5 has 1048577 bytes; no message has more than 1 MiB"):
        inputs.parse_message(b" " + text, "a.mcap", "message 5")


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xff")
    with pytest.raises(ConfigError) as info:
        read_text(path)
    assert str(info.value).startswith(f"{path}:")
