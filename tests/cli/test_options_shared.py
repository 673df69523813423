from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hexwire.cli import look, output
from hexwire.cli.options import RobotOptions, make_robot, resolve_url
from hexwire.control.loop import reader
from hexwire.errors import LinkNotFoundError, ServoError, UsageError
from hexwire.link import ports
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointFlag, JointReading, fault_names


def options(**changes: Any) -> RobotOptions:
    values: dict[str, Any] = {
        "port": "/dev/ttyUSB7",
        "robot": "hex7bot",
        "baud": None,
        "dialect": None,
        "timeout": None,
    }
    return RobotOptions(**(values | changes))


# --- which port ------------------------------------------------------------------------------------------


def test_the_url_is_what_was_typed() -> None:
    assert resolve_url("tcp://host:15030") == "tcp://host:15030"


def test_a_rate_goes_into_the_url_of_a_serial_port() -> None:
    assert resolve_url("/dev/ttyUSB0", 9600) == "/dev/ttyUSB0?baud=9600"
    assert resolve_url("serial:///dev/ttyUSB0?reset=1", 9600) == "serial:///dev/ttyUSB0?reset=1&baud=9600"


@pytest.mark.parametrize(
    ("port", "text"),
    [("tcp://host:15030", "only a serial port has a rate"), ("/dev/ttyUSB0?baud=19200", "give the rate only once")],
)
def test_a_rate_that_does_not_go_with_the_url(port: str, text: str) -> None:
    with pytest.raises(UsageError, match=text):
        resolve_url(port, 9600)


def test_a_raised_rate_goes_into_the_url_too() -> None:
    assert resolve_url("/dev/ttyUSB0", None, 500_000) == "/dev/ttyUSB0?raise=500000"
    assert resolve_url("/dev/ttyUSB0", 57600, 500_000) == "/dev/ttyUSB0?baud=57600&raise=500000"
    with pytest.raises(UsageError, match="--raise-baud does not apply to tcp://host:15030"):
        resolve_url("tcp://host:15030", None, 500_000)
    with pytest.raises(UsageError, match="--raise-baud 9600 and /dev/ttyUSB0"):
        resolve_url("/dev/ttyUSB0?raise=500000", None, 9600)
    with pytest.raises(UsageError, match="--raise-baud, --dialect and --timeout belong to a port"):
        make_robot(options(port="zenoh:lab/arm1", raise_baud=500_000))


def test_without_a_port_the_only_board_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "find_only_board", lambda: "/dev/ttyACM3")
    assert resolve_url(None) == "/dev/ttyACM3"
    assert resolve_url(None, 9600) == "/dev/ttyACM3?baud=9600"
    # An empty HEXWIRE_PORT is as good as none.
    assert resolve_url("") == "/dev/ttyACM3"


def test_a_missing_port_and_board_is_reported(monkeypatch: pytest.MonkeyPatch, bench: Any) -> None:
    def nothing() -> str:
        raise LinkNotFoundError("no serial port on this machine")

    monkeypatch.setattr(ports, "find_only_board", nothing)
    result = bench.run("ping", port=None)
    assert (result.exit_code, result.stderr) == (1, "error: no serial port on this machine\n")


def test_the_port_may_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, bench: Any) -> None:
    monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyENV")
    assert bench.run("ping", "0", port=None).exit_code == 0
    assert bench.run("ping", "0", port="/dev/ttyARG").exit_code == 0
    assert bench.urls == ["/dev/ttyENV", "/dev/ttyARG"]


# --- which robot -----------------------------------------------------------------------------------------


def test_a_robot_gets_its_options() -> None:
    robot = make_robot(options(dialect=1, timeout=1.5))
    assert robot.model is HEX7BOT
    assert not robot.session.is_open


def test_an_unknown_robot_is_reported(bench: Any) -> None:
    result = bench.run("state", "--robot", "r2d2")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: no robot 'r2d2'; installed are ")


def test_only_the_dialect_that_was_asked_for(make_bench: Any) -> None:
    assert "dialect   1" in make_bench().ok("probe", "--dialect", "1")
    result = make_bench(dialect=1).run("probe", "--dialect", "2", "--timeout", "1")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: no answer to IDENTIFY")


def test_the_link_is_closed_after_an_error(make_bench: Any) -> None:
    bench = make_bench("silent:4")
    for command in (["ping"], ["state"], ["probe"], ["torque", "off"], ["move", "J5=1"]):
        assert bench.run(*command).exit_code == 1
        assert not bench.link.is_open


# --- numbers and text ------------------------------------------------------------------------------------


def test_json_has_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_json({"a": [math.nan, (1.5, math.inf)], "b": {"c": -math.inf, "d": True, "e": "ö"}}, one_line=True)
    text = capsys.readouterr().out
    assert text.count("\n") == 1
    assert json.loads(text) == {"a": [None, [1.5, None]], "b": {"c": None, "d": True, "e": "ö"}}


def test_a_joint_as_json() -> None:
    flags = JointFlag.TORQUE_ON | JointFlag.OVERLOAD | JointFlag.CLAMPED
    joint = JointReading("J5", math.pi, 0.5, 0.25, 0.1, 7.4, 31.0, flags, 0.01)
    row = look.joint_json(joint, HEX7BOT)
    assert row["servo_id"] == 4
    assert row["position_rad"] == math.pi
    assert row["position_deg"] == pytest.approx(180.0)
    assert row["velocity_deg_per_s"] == pytest.approx(math.degrees(0.5))
    assert (row["torque_on"], row["silent"], row["clamped"], row["faults"]) == (True, False, True, ["overload"])


def test_silence_is_not_among_the_faults() -> None:
    assert fault_names(JointFlag.SILENT | JointFlag.TORQUE_ON) == []
    assert fault_names(JointFlag.VOLTAGE | JointFlag.CURRENT) == ["voltage", "current"]


def test_silent_servos_are_named() -> None:
    reader.raise_if_silent([])
    with pytest.raises(ServoError, match=r"servo 4 \(J5\) does not answer") as caught:
        reader.raise_if_silent([(4, "J5")])
    assert caught.value.servo_id == 4
    with pytest.raises(ServoError, match=r"servos 4 \(J5\), 9 do not answer"):
        reader.raise_if_silent([(4, "J5"), (9, None)])


def test_a_table_is_aligned_numbers_to_the_right() -> None:
    rows = [("J1", "-4.5", "ok"), ("J10", "123.0", "-"), ("J2", "-", "hot")]
    assert output.format_table(("joint", "deg", "condition"), rows) == (
        "joint    deg  condition\nJ1      -4.5  ok\nJ10    123.0  -\nJ2         -  hot"
    )


def test_versions_are_words_not_numbers() -> None:
    lines = output.format_table(("id", "firmware"), [("1", "3.9.10"), ("2", "1.0")]).split("\n")
    assert lines == ["id  firmware", " 1  3.9.10", " 2  1.0"]
