from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import ConfigError
from hexwire.ros2.params_file import matches, parse_value, read_params_file


def written(folder: Path, text: str) -> str:
    path = folder / "params.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("true", True),
        ("y", True),
        ("Off", False),
        ("'true'", "true"),
        ("!!str 5", "5"),
        ("5", 5),
        ("-5", -5),
        ("0x1F", 31),
        ("010", 8),
        ("08", 8.0),
        ("0", 0),
        ("9223372036854775807", 2**63 - 1),
        ("9223372036854775808", 9223372036854775808.0),
        ("5.", 5.0),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("1e999", "1e999"),
        ("-.inf", -math.inf),
        ("+.INF", math.inf),
        ("1_000", "1_000"),
        ("so101", "so101"),
        ("[1, 2]", [1, 2]),
        ("[a, b]", ["a", "b"]),
        ("[0.5, .inf]", [0.5, math.inf]),
        ("[]", []),
        ("''", ""),
    ],
)
def test_a_scalar_means_what_it_means_to_rcl(text: str, value: Any) -> None:
    found = parse_value(text)
    assert (found, type(found)) == (value, type(value))


def test_not_a_number_is_read() -> None:
    assert math.isnan(parse_value(".nan"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "No value"),
        ("[a", r"expected ',' or '\]', but got '<stream end>'$"),
        ("{a: 1}", "scalar or a list"),
        ("[1, 2.0]", "Sequence should be of same type. Value type 'double'"),
        ("[1, true]", "Value type 'bool'"),
        ("[[1]]", "scalars only"),
        ("&a [1]", "aliasing"),
        ("*a", "aliasing"),
        ("a\n---\nb", "more than one document"),
    ],
)
def test_what_is_no_value_is_refused(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        parse_value(text)
    assert "\n" not in str(caught.value)


def test_a_file_has_nodes_namespaces_and_nested_names(tmp_path: Path) -> None:
    text = """
/**:
  ros__parameters:
    publish_rate: 50.0
driver:
  ros__parameters:
    port: /dev/ttyUSB0
    constraints:
      goal_time: 0.5
      J1: {goal: 0.01, trajectory: 0.1}
/arm/left:
  driver:
    ros__parameters: {joints: [J1, J2]}
lab:
  '*':
    ros__parameters: {offset: 5}
"""
    assert read_params_file(written(tmp_path, text)) == {
        "/**": {"publish_rate": 50.0},
        "/driver": {
            "port": "/dev/ttyUSB0",
            "constraints.goal_time": 0.5,
            "constraints.J1.goal": 0.01,
            "constraints.J1.trajectory": 0.1,
        },
        "/arm/left/driver": {"joints": ["J1", "J2"]},
        "/lab/*": {"offset": 5},
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("driver: 5", "1: Cannot have a value before ros__parameters"),
        ("ros__parameters: {a: 1}", "no node names before ros__parameters"),
        ("a:\n  ros__parameters:\n    x:\n", "3: No value"),
        ("a:\n  ros__parameters: 5", "table of parameters"),
        ("a b:\n  ros__parameters: {x: 1}", "node name must not contain"),
        ("a: &x\n  ros__parameters: {x: 1}\nb: *x", "aliasing"),
        ("? [1]\n: 2", "Sequences cannot be key"),
        ("a: {b: {ros__parameters: {x: [1, a]}}}", "Sequence should be of same type"),
        ("a: [", "params.yaml"),
        ("a:\n\t- x", "params.yaml:2"),
        ("{a: " * 40, "deeper than 32 levels"),
        ("a: !!python/object/apply:os.system [ls]", "Cannot have a value"),
    ],
)
def test_faults_have_their_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        read_params_file(written(tmp_path, text))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["a: " * 50_000, "[" * 200_000, "{a: " * 60_000, "- " * 100_000, "x" * 250_000, "#\n" * 100_000]
)
def test_hostile_files_take_little_time(tmp_path: Path, text: str) -> None:
    try:
        assert read_params_file(written(tmp_path, text)) == {}
    except ConfigError:
        return


def test_an_empty_file_has_no_parameters(tmp_path: Path) -> None:
    assert read_params_file(written(tmp_path, "# nothing\n")) == {}


def test_files_have_bounds(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="256 KiB"):
        read_params_file(written(tmp_path, "#" * 300_000))
    many = "a:\n  ros__parameters:\n    x: [" + "1," * 20_000 + "1]"
    with pytest.raises(ConfigError, match="more than 10000 values"):
        read_params_file(written(tmp_path, many))


@pytest.mark.parametrize(
    ("pattern", "name", "found"),
    [
        ("/**", "/driver", True),
        ("/**", "/arm/left/driver", True),
        ("/*", "/driver", True),
        ("/*", "/arm/driver", False),
        ("driver", "/driver", True),
        ("driver", "/arm/driver", False),
        ("/arm/*", "/arm/driver", True),
        ("/**/driver", "/driver", True),
        ("/**/driver", "/a/b/driver", True),
        ("/**/driver", "/a/b/other", False),
        ("/*/driver", "/arm/driver", True),
        ("/arm/**/driver", "/arm/driver", True),
        ("/arm/driver", "/arm/driver", True),
    ],
)
def test_patterns_stand_for_nodes(pattern: str, name: str, found: bool) -> None:
    assert matches(pattern, name) is found


def test_a_pattern_of_many_wildcards_takes_little_time() -> None:
    assert not matches("/**" * 100 + "/x", "/a" * 100)


@given(st.text(alphabet="ab:*/[]{}-,'\"\n &!?|>%@`#.0", max_size=80))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(ConfigError):
        assert isinstance(parse_value(text), bool | int | float | str | list)
