from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import ConfigError, UsageError
from hexwire.ros2.arguments import parse_arguments
from zenoh_ros2.names import Kind, Remap


def test_what_stands_outside_is_not_for_ros() -> None:
    found = parse_arguments(["sim://so101", "--ros-args", "-r", "a:=b", "--", "--verbose", "-p", "x"])
    assert found.others == ("sim://so101", "--verbose", "-p", "x")
    assert found.remaps == (Remap(Kind.TOPIC | Kind.SERVICE, "a", "b"),)


def test_rules_are_kept_in_order() -> None:
    words = ["--ros-args", "-r", "__node:=left", "--remap", "driver:__ns:=/arm", "--ros-args", "-r", "a:=/b"]
    assert [(rule.kind, rule.node, rule.new) for rule in parse_arguments(words).remaps] == [
        (Kind.NODE, "", "left"),
        (Kind.NAMESPACE, "driver", "/arm"),
        (Kind.TOPIC | Kind.SERVICE, "", "/b"),
    ]


def test_the_old_form_of_a_rule_is_read_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    assert parse_arguments(["a:=b"]).remaps == (Remap(Kind.TOPIC | Kind.SERVICE, "a", "b"),)
    assert "Use '--ros-args --remap a:=b' instead" in caplog.text


def test_parameters_are_for_all_nodes_or_one() -> None:
    words = ["--ros-args", "-p", "rate:=50", "-p", "driver:joints:=[J1, J2]", "--param", "a.b:=x y"]
    found = parse_arguments(words)
    assert found.parameters("/driver") == {"rate": 50, "joints": ["J1", "J2"], "a.b": "x y"}
    assert found.parameters("/other") == {"rate": 50, "a.b": "x y"}
    assert found.parameters("/arm/driver") == {"rate": 50, "a.b": "x y"}


def test_files_and_single_parameters_override_in_order_of_patterns(tmp_path: Path) -> None:
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text("/**: {ros__parameters: {a: 1, b: 1, c: 1}}\ndriver: {ros__parameters: {d: 1}}")
    second.write_text("/**: {ros__parameters: {a: 2}}\n/arm/*: {ros__parameters: {e: 2}}")
    words = ["--ros-args", "--params-file", str(first), "--params-file", str(second), "-p", "b:=3", "-p", "d:=3"]
    found = parse_arguments(words)
    assert found.parameters("/arm/left") == {"a": 2, "b": 3, "c": 1, "d": 3, "e": 2}
    # A pattern that names the node comes after the one for all nodes, which stood first.
    assert found.parameters("/driver") == {"a": 2, "b": 3, "c": 1, "d": 1}


def test_logging_is_set() -> None:
    words = ["--ros-args", "--log-level", "debug", "--log-level", "driver:=ERROR"]
    words += [
        "--disable-rosout-logs",
        "--disable-stdout-logs",
        "--disable-external-lib-logs",
        "--enable-stdout-logs",
    ]
    found = parse_arguments([*words, "--enable-stdout-logs", "--log-file-name", "arm"])
    assert (found.level, found.levels) == (10, {"driver": 40})
    assert (found.rosout_logs, found.stdout_logs, found.log_file) == (False, True, "arm")


def test_the_enclave_is_read() -> None:
    assert parse_arguments(["--ros-args", "-e", "/arm/driver"]).enclave == "/arm/driver"
    assert parse_arguments([]).enclave == "/"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["-r"], "Couldn't parse trailing -r flag. No remap rule found."),
        (["-r", "a"], "Couldn't parse remap rule: '-r a'. Error: "),
        (["-r", "a:=*"], "Couldn't parse remap rule"),
        (["-r", "*:=a"], "Wildcard '*' is not implemented"),
        (["-r", r"a:=\1"], "Backreferences are not implemented"),
        (["-p", "a"], "Couldn't parse parameter override rule: '-p a'."),
        (["-p", "a:="], "No value"),
        (["-p", "a:=[1, x]"], "Sequence should be of same type"),
        (["-p"], "No parameter override rule found."),
        (["--params-file"], "No file path provided."),
        (["--params-file", "/none/such.yaml"], "Couldn't parse params file: '--params-file /none/such.yaml'."),
        (["--log-level", "loud"], "Argument does not use a valid severity level"),
        (["--log-level", ":=info"], "name is empty"),
        (["--log-config-file", "log.conf"], "there is no external logging library here"),
        (["--log-config-file"], "No file path provided."),
        (["-e"], "Couldn't parse trailing -e flag. No enclave path provided."),
        (["--log-file-name"], "Couldn't parse trailing --log-file-name flag. No string prefix provided."),
        (["-e", "arm"], "an enclave is an absolute name"),
        (["--frobnicate", "x"], "found unknown ROS arguments: '--frobnicate', 'x'"),
    ],
)
def test_faults_have_the_words_of_rcl(words: list[str], text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_arguments(["--ros-args", *words])
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_huge_value_is_refused() -> None:
    with pytest.raises(UsageError):
        parse_arguments(["--ros-args", "-p", "a:=" + "x" * 100_000])


def test_a_fault_in_a_file_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("driver: 5")
    with pytest.raises(UsageError, match=r"p.yaml:1: Cannot have a value") as caught:
        parse_arguments(["--ros-args", "--params-file", str(path)])
    assert not isinstance(caught.value, ConfigError)
