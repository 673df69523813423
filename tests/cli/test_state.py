from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hexwire.model.state import JointFlag, JointReading, condition


def reading(flags: JointFlag) -> JointReading:
    return JointReading("J1", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, flags, 0.0)


def test_a_table_of_all_joints(bench: Any) -> None:
    lines = bench.ok("state").splitlines()
    assert lines[0].split()[:3] == ["joint", "deg", "deg/s"]
    assert [line.split()[0] for line in lines[1:]] == [f"J{i}" for i in range(1, 8)]
    # The pose of the chapter's log: J1 is 6 counts off -5 degrees.
    assert lines[1].split()[1] == "-4.47"
    assert all(line.endswith(" ok") for line in lines[1:])


def test_json_has_radians_and_degrees_and_null_for_what_is_not_known(make_bench: Any) -> None:
    state = make_bench(dialect=1).json("state")
    first = state["joints"][0]
    assert first["position_deg"] == pytest.approx(math.degrees(first["position_rad"]))
    assert first["position_rad"] == pytest.approx(6 * 0.001534 - 0.087265)
    assert first["voltage_v"] is None
    assert state["board_time_s"] is None
    assert state["stopped"] is False


def test_a_silent_servo_is_shown_and_the_others_are_too(make_bench: Any) -> None:
    bench = make_bench("silent:4")
    result = bench.run("state")
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    assert lines[5].endswith("no answer")
    assert sum(line.endswith(" ok") for line in lines) == 6
    assert result.stderr == "error: servo 4 (J5) does not answer: check cable, power and id\n"
    rows = json.loads(bench.run("state", "--json").stdout)["joints"]
    assert [row["name"] for row in rows if row["silent"]] == ["J5"]
    assert rows[4]["faults"] == []


def test_a_fault_has_a_name(make_bench: Any) -> None:
    bench = make_bench("hot:5")
    bench.ok("torque", "on", "J6")
    bench.clock.advance(1.0)
    line = bench.ok("state").splitlines()[6]
    assert line.endswith("temperature")
    assert bench.json("state")["joints"][5]["faults"] == ["temperature"]


def test_a_stop_is_pointed_out(bench: Any) -> None:
    bench.ok("stop")
    assert bench.ok("state").splitlines()[-1] == "stopped; 'hexwire resume' ends the stop"


def test_conditions_in_words() -> None:
    assert condition(reading(JointFlag.TORQUE_ON)) == "ok"
    assert condition(reading(JointFlag.SILENT | JointFlag.OVERLOAD)) == "no answer"
    assert condition(reading(JointFlag.OVERLOAD | JointFlag.VOLTAGE)) == "voltage, overload"
    assert condition(reading(JointFlag.CLAMPED)) == "clamped to its limit"


@pytest.mark.parametrize("as_json", [False, True])
def test_watching_gives_a_line_a_sample_until_interrupted(
    bench: Any, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    reads = 0
    step = bench.board.step

    def interrupted(now: float) -> None:
        nonlocal reads
        reads += 1
        if bench.clock() > 1002.0:
            raise KeyboardInterrupt
        step(now)

    monkeypatch.setattr(bench.board, "step", interrupted)
    result = bench.run("state", "--watch", "--rate", "4", *(["--json"] if as_json else []))
    assert result.exit_code == 130
    lines = [line for line in result.stdout.splitlines() if line]
    assert len(lines) in range(6, 9)
    if as_json:
        assert all(len(json.loads(line)["joints"]) == 7 for line in lines)
    else:
        assert lines[4].startswith("     1.0 s  J1 -4.47  J2 ")
        assert lines[4].endswith(" deg")
    assert not bench.link.is_open


def test_watching_shows_on_every_line_what_is_wrong(make_bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench("silent:4")
    monkeypatch.setattr(bench.board, "next_event_time", _until(bench, bench.board.next_event_time))
    result = bench.run("state", "--watch", "--rate", "4")
    assert "; J5 no answer" in result.stdout.splitlines()[0]


def _until(bench: Any, call: Any) -> Any:
    def next_event_time() -> float | None:
        if bench.clock() > 1001.0:
            raise KeyboardInterrupt
        return call()

    return next_event_time


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "x"])
def test_an_invalid_rate_is_refused(bench: Any, rate: str) -> None:
    result = bench.run("state", "--watch", "--rate", rate)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: Invalid value for '--rate'")


def test_help_names_the_environment_variable(bench: Any) -> None:
    assert "HEXWIRE_PORT" in bench.run("state", "--help", port=None).stdout


def test_state_and_probe_show_maintenance(bench: Any) -> None:
    assert bench.json("state")["maintenance"] is False
    assert "maintenance:" not in bench.ok("probe")
    bench.board.state.maintenance = True
    assert bench.json("state")["maintenance"] is True
    assert bench.json("probe")["maintenance"] is True
    assert "in maintenance: servo settings may be written, nothing moves" in bench.ok("state")
    assert "in maintenance: servo settings may be written, nothing moves" in bench.ok("probe")
