"""How the node is started: the log on the console, and where Zenoh's router is."""

from __future__ import annotations

import logging
import re

import pytest

from hexwire.errors import UsageError
from hexwire.ros2.arguments import parse_arguments
from hexwire.ros2.start import _console, _zenoh


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ["INFO", "WARN"]),
        (["--ros-args", "--log-level", "debug"], ["DEBUG", "INFO", "WARN"]),
        (["--ros-args", "--log-level", "error"], []),
        (["--ros-args", "--disable-stdout-logs"], []),
    ],
)
def test_the_log_is_written_as_ros_nodes_do(
    capsys: pytest.CaptureFixture[str], words: list[str], wanted: list[str]
) -> None:
    log = logging.getLogger("hexwire.control.arm")
    with _console(parse_arguments(words), "left_arm"):
        for level in (logging.DEBUG, logging.INFO, logging.WARNING):
            log.log(level, "torque is %s", "on")
    captured = capsys.readouterr()
    found = [
        re.fullmatch(r"\[(\w+)\] \[\d+\.\d{9}\] \[left_arm\]: torque is on", line)
        for line in captured.err.splitlines()
    ]
    assert [match and match[1] for match in found] == wanted
    assert captured.out == ""
    log.warning("not shown after the end")
    assert "after the end" not in capsys.readouterr().err


def test_the_router_is_the_usual_one_unless_it_is_named() -> None:
    assert _zenoh("").connect == ("tcp/localhost:7447",)
    assert _zenoh('connect/endpoints=["tcp/robot:7447"]').connect == ("tcp/robot:7447",)


@pytest.mark.parametrize(
    "text", ["mode=client", "connect/endpoints", "connect/endpoints=[1]", "connect/endpoints=x"]
)
def test_other_settings_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="ZENOH_CONFIG_OVERRIDE"):
        _zenoh(text)
