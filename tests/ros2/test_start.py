"""How the node is started: the log on the console, and where Zenoh's router is."""

from __future__ import annotations

import logging
import re
import sys

import pytest

from hexwire.errors import UsageError
from hexwire.ros2 import start
from hexwire.ros2.arguments import parse_arguments
from hexwire.ros2.secure_settings import SecureSettings
from hexwire.ros2.start import _console, _zenoh
from hexwire.ros2.wire import own_errors


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ["INFO", "WARN"]),
        (["--ros-args", "--log-level", "debug"], ["DEBUG", "INFO", "WARN"]),
        (["--ros-args", "--log-level", "error"], []),
        (["--ros-args", "--log-level", "lab.left_arm:=warn"], ["WARN"]),
        (["--ros-args", "--log-level", "lab:=warn"], ["WARN"]),
        (["--ros-args", "--log-level", "lab:=debug", "--log-level", "lab.left_arm:=warn"], ["WARN"]),
        (["--ros-args", "--log-level", "error", "--log-level", "lab:=warn"], ["WARN"]),
        (["--ros-args", "--log-level", "other:=debug"], ["INFO", "WARN"]),
        (["--ros-args", "--log-level", "left_arm:=debug"], ["INFO", "WARN"]),
        (["--ros-args", "--disable-stdout-logs"], []),
    ],
)
def test_the_log_is_written_as_ros_nodes_do(
    capsys: pytest.CaptureFixture[str], words: list[str], wanted: list[str]
) -> None:
    log = logging.getLogger("hexwire.control.requests.controlled_arm")
    with _console(parse_arguments(words), "lab.left_arm"):
        for level in (logging.DEBUG, logging.INFO, logging.WARNING):
            log.log(level, "torque is %s", "on")
    captured = capsys.readouterr()
    found = [
        re.fullmatch(r"\[(\w+)\] \[\d+\.\d{9}\] \[lab\.left_arm\]: torque is on", line)
        for line in captured.err.splitlines()
    ]
    assert [match and match[1] for match in found] == wanted
    assert captured.out == ""
    log.warning("not shown after the end")
    assert "after the end" not in capsys.readouterr().err


def test_the_log_of_a_node_in_a_namespace_has_the_name_of_its_logger(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Node:
        def __init__(self, *_: object) -> None: ...

        def run(self) -> int:
            logging.getLogger("hexwire.control.requests.controlled_arm").info("torque is on")
            return 0

    monkeypatch.setattr(start, "HardwareInterface", Node)
    start.run(["--ros-args", "-r", "__ns:=/lab/left", "-r", "__node:=arm", "-p", "port:=/dev/null"], {})
    assert "[lab.left.arm]: torque is on" in capsys.readouterr().err


def test_the_router_is_the_usual_one_unless_it_is_named() -> None:
    assert _zenoh([], {}) == SecureSettings()
    override = {"ZENOH_CONFIG_OVERRIDE": 'connect/endpoints=["tcp/robot:7447"]'}
    assert _zenoh([], override).overrides == (("connect/endpoints", '["tcp/robot:7447"]'),)
    files = ["--ca", "ca.pem", "--cert=arm.pem", "--key", "arm.key"]
    settings = _zenoh(["--router", "tls/lab-pc:7447", *files], {})
    assert (settings.connect, settings.ca, settings.cert) == (("tls/lab-pc:7447",), "ca.pem", "arm.pem")


@pytest.mark.parametrize(
    ("words", "environ", "text"),
    [
        (["--frobnicate"], {}, "no option '--frobnicate'"),
        (["sim://so101"], {}, "no option 'sim://so101'"),
        (["--router"], {}, "--router needs a value"),
        (["--router", "tcp/192.0.2.1:7447"], {}, "without certificates"),
        (["--router", "tcp/localhost:7447"], {"ZENOH_SESSION_CONFIG_URI": "x.json5"}, "leave out the options"),
        ([], {"ZENOH_CONFIG_OVERRIDE": "mode"}, "ZENOH_CONFIG_OVERRIDE has the form"),
    ],
)
def test_what_cannot_be_the_way_to_a_router_is_refused(
    words: list[str], environ: dict[str, str], text: str
) -> None:
    with pytest.raises(UsageError, match=text), own_errors():
        _zenoh(words, environ)


def test_the_owner_of_the_arm_waits_for_no_other_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []

    class Node:
        def __init__(self, *_: object) -> None: ...

        def run(self) -> int:
            seen.append(sys.getswitchinterval())
            return 0

    monkeypatch.setattr(start, "HardwareInterface", Node)
    assert start.run(["--ros-args", "-p", "port:=/dev/null"], {}) == 0
    assert max(seen) < 0.001
