"""One special command to the robot, byte for byte."""

from __future__ import annotations

from typing import Any

import pytest

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.registry import load_driver
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_ping, make_read, make_write


def test_the_body_of_the_reply_in_hex(bench: Any) -> None:
    out = bench.ok("ioctl", "limits")
    rows = [row.partition("|")[0].split() for row in out.splitlines()]
    assert sum(map(len, rows)) == 2 + 7 * 6
    assert bench.ok("ioctl", "0x18") == bench.ok("ioctl", "24") == bench.ok("ioctl", "LIMITS") == out


def test_json_has_request_and_reply(bench: Any) -> None:
    said = bench.json("ioctl", "IO", "00", "00")
    assert (said["command"], said["code"], said["body"], len(said["reply"])) == ("IO", 0x1E, "0000", 4)


def test_a_reply_without_a_body(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hex7BotDriver, "ioctl", lambda robot, sub_cmd, data: b"")
    assert bench.ok("ioctl", "watchdog", "0000", "00") == "the reply has no body\n"


def test_a_stop_is_a_stop(bench: Any) -> None:
    bench.ok("torque", "on")
    bench.ok("ioctl", "stop", "00")
    assert bench.json("state")["stopped"] is True
    assert bench.json("state")["state"] == "stopped"


@pytest.mark.parametrize("words", [("torque", "01", "7f00"), ("maintenance", "01"), ("0x7F",)])
def test_what_may_move_the_arm_asks_first(bench: Any, words: tuple[str, ...]) -> None:
    result = bench.run("ioctl", *words)
    assert (result.exit_code, bench.torque()) == (2, [])
    assert "may move hex7bot, and nothing checks where to; --yes sends it" in result.stderr


def test_yes_sends_it(bench: Any) -> None:
    bench.ok("ioctl", "torque", "01", "0300", "--yes")
    assert bench.torque() == ["J1", "J2"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("NOTHING",), "no command 'NOTHING'; there are numbers from 0 to 255 (0xFF) and PING, READ"),
        (("256",), "no command '256'"),
        (("0x100",), "no command '0x100'"),
        (("IO", "0"), "'0' is not hex"),
        (("IO", "0x00"), "'0x00' is not hex"),
        (("IO", "0" * 16386), "8193 bytes is too long"),
    ],
)
def test_what_is_not_a_command_or_a_body(bench: Any, words: tuple[str, ...], text: str) -> None:
    result = bench.run("ioctl", *words)
    assert result.exit_code == 2
    assert text in result.stderr
    assert result.stderr.count("\n") == 1


def test_what_the_robot_refuses(make_bench: Any) -> None:
    result = make_bench().run("ioctl", "0x7F", "--yes")
    assert (result.exit_code, "error: " in result.stderr) == (1, True)
    result = make_bench(dialect=1).run("ioctl", "STATS")
    assert (result.exit_code, "error: " in result.stderr) == (1, True)


def test_the_chapters_board_gets_the_chapters_commands(make_bench: Any) -> None:
    bench = make_bench(dialect=1)
    # Nothing is asked before what only reads.
    assert bench.ok("ioctl", "PING", make_ping(4).hex()).startswith("FF FF 04 02")
    assert bench.ok("ioctl", "READ", make_read(4, 56, 2).hex()).startswith("FF FF 04 04")
    asked = bench.run("ioctl", "READ", make_write(4, 0x28, b"\1").hex())
    assert (asked.exit_code, "may move" in asked.stderr) == (2, True)
    wrong = bench.run("ioctl", "READ", make_read(4, 56, 4).hex())
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (2, 1)
    assert "other than 2 bytes" in wrong.stderr


@pytest.mark.parametrize("robot", ["hex7bot", "puma260", "so101"])
def test_what_only_asks_may_not_move(robot: str) -> None:
    driver = load_driver(robot).from_url("tcp://127.0.0.1:1" if robot == "puma260" else "/dev/null")
    ping = b"\6\0" + make_ping(4)
    asks = {
        "hex7bot": [(Command.STATS, b""), (Command.LIMITS, b""), (Command.TRANSACT, ping), (Command.STOP, b"\0")],
        "puma260": [(Command.ROBOT_PROBE, b""), (Command.JOINT_STATES, b""), (Command.ROBOT_SIGNAL, b"\1")],
        "so101": [(Command.TRANSACT, ping)],
    }
    acts = {
        "hex7bot": [(Command.TORQUE, b"\1\0\0"), (0x7F, b"")],
        "puma260": [
            (Command.ROBOT_MODE, b"\0"),
            (Command.ROBOT_SIGNAL, b"\4"),
            (Command.ROBOT_SIGNAL, b""),
            (0x7F, b""),
        ],
        "so101": [(Command.TRANSACT, b"\6\0" + make_write(4, 0x28, b"\1")), (Command.TRANSACT, b"")],
    }
    assert [driver.may_move(*words) for words in asks[robot]] == [False] * len(asks[robot])
    assert [driver.may_move(*words) for words in acts[robot]] == [True] * len(acts[robot])
