from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from hexwire.cli.main import cli
from hexwire.link import ports as ipc_ports
from hexwire.link.ports import PortInfo


def test_ping_asks_every_servo_of_the_robot(bench: Any) -> None:
    lines = bench.ok("ping").splitlines()
    assert [line.partition(":")[0] for line in lines] == [f"servo {i} (J{i + 1})" for i in range(7)]
    assert all(": ok, " in line and line.endswith(" ms") for line in lines)


def test_ping_of_chosen_servos_as_json(bench: Any) -> None:
    rows = bench.json("ping", "4", "0")
    assert [(row["servo_id"], row["joint"], row["present"], row["faults"]) for row in rows] == [
        (4, "J5", True, []),
        (0, "J1", True, []),
    ]
    assert all(0 < row["round_trip_s"] < 1 for row in rows)


@pytest.mark.parametrize("dialect", [1, 2])
def test_ping_says_which_servo_is_silent(make_bench: Any, dialect: int) -> None:
    result = make_bench("silent:4", dialect=dialect).run("ping")
    assert result.exit_code == 1
    assert "servo 4 (J5): no answer" in result.stdout
    assert result.stdout.count(": ok, ") == 6
    assert result.stderr == "error: servo 4 (J5) does not answer: check cable, power and id\n"


def test_ping_of_silent_servos_as_json_still_gives_all_rows(make_bench: Any) -> None:
    result = make_bench("silent:4", "silent:6").run("ping", "--json")
    assert result.exit_code == 1
    rows = json.loads(result.stdout)
    assert [row["servo_id"] for row in rows if not row["present"]] == [4, 6]
    assert rows[4]["round_trip_s"] is None
    assert result.stderr == "error: servos 4 (J5), 6 (J7) do not answer: check cable, power and id\n"


def test_ping_of_an_id_that_no_joint_has(bench: Any) -> None:
    result = bench.run("ping", "9")
    assert result.exit_code == 1
    assert result.stdout == "servo 9: no answer\n"


@pytest.mark.parametrize("word", ["254", "-1", "x"])
def test_ping_of_no_id_is_a_usage_error(bench: Any, word: str) -> None:
    result = bench.run("ping", "--", word, port=None)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


def test_probe_tells_who_is_there(bench: Any) -> None:
    text = bench.ok("probe")
    assert "dialect   2\n" in text
    assert "stopped   no\n" in text
    assert text.count(" yes") == 7
    report = bench.json("probe")
    assert report["dialect"] == 2
    assert report["robot"] == "hex7bot"
    assert [joint["servo_id"] for joint in report["joints"]] == list(range(7))
    assert report["counters"]["requests"] > 0


def test_probe_of_an_old_board_says_whose_dialect_it_speaks(make_bench: Any) -> None:
    text = make_bench(dialect=1).ok("probe")
    assert "dialect   1 (the chapter's)\n" in text
    assert "firmware" not in text


def test_probe_shows_a_stop_and_a_missing_servo(make_bench: Any) -> None:
    bench = make_bench("silent:4")
    bench.run("stop")
    result = bench.run("probe")
    assert result.exit_code == 1
    assert "stopped   yes" in result.stdout
    assert "NO ANSWER" in result.stdout
    assert "servo 4 (J5) does not answer" in result.stderr


def test_ports_lists_what_is_probably_there(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    mega = PortInfo("/dev/ttyACM0", 0x2341, 0x42, "S1", "Mega", "Arduino Mega 2560", True)
    built_in = PortInfo("/dev/ttyS0", guess="built-in serial port")
    monkeypatch.setattr(ipc_ports, "list_ports", lambda: [mega, built_in])
    result = bench.run("ports", port=None)
    assert result.exit_code == 0
    head, first, second = result.stdout.splitlines()
    assert head.split() == ["device", "usb", "id", "probably", "board?"]
    assert first.split() == ["/dev/ttyACM0", "2341:0042", "Arduino", "Mega", "2560", "yes"]
    assert second.split() == ["/dev/ttyS0", "-", "built-in", "serial", "port"]
    rows = json.loads(bench.run("ports", "--json", port=None).stdout)
    assert rows[0]["usb_id"] == "2341:0042"
    assert rows[0]["likely_board"] is True
    assert rows[1]["usb_id"] is None


def test_no_port_is_no_error(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ipc_ports, "list_ports", list)
    result = bench.run("ports", port=None)
    assert (result.exit_code, result.stdout) == (0, "")
    assert "no serial port" in result.stderr
    assert bench.run("ports", "--json", port=None).stdout == "[]\n"


def _plugging(monkeypatch: pytest.MonkeyPatch, *lists: list[PortInfo]) -> None:
    """The list of ports at each look, the last of them from then on; a look a quarter of a second."""
    left, now = list(lists), [0.0]

    def listed() -> list[PortInfo]:
        return left.pop(0) if len(left) > 1 else left[0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr("hexwire.link.ports.list_ports", listed)
    monkeypatch.setattr("hexwire.cli.look.time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))


def test_a_port_is_named_by_unplugging(monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = PortInfo("/dev/ttyACM0"), PortInfo("/dev/ttyACM1", guess="an adapter")
    _plugging(monkeypatch, [one, two], [one, two], [one], [one], [one, two])
    result = CliRunner().invoke(cli, ["ports", "--find"])
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines() == [
        "unplug the USB cable of the arm; or plug it in, if it is not yet",
        "/dev/ttyACM1 is gone: plug it in again",
    ]
    assert "/dev/ttyACM1" in result.stdout
    assert "/dev/ttyACM0" not in result.stdout


def test_a_port_that_does_not_come(monkeypatch: pytest.MonkeyPatch) -> None:
    _plugging(monkeypatch, [])
    result = CliRunner().invoke(cli, ["ports", "--find", "--timeout", "5"])
    assert result.exit_code == 1
    assert "no port came within 5 s: is the cable one for data?" in result.stderr
    assert CliRunner().invoke(cli, ["ports", "--timeout", "5"]).exit_code == 2
