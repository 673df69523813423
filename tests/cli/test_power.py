from __future__ import annotations

from typing import Any

import pytest

J = ["J1", "J2", "J3", "J4", "J5", "J6", "J7"]


@pytest.mark.parametrize("dialect", [1, 2])
def test_torque_on_moves_nothing_and_off_takes_it_away(make_bench: Any, dialect: int) -> None:
    bench = make_bench(dialect=dialect)
    before = bench.positions()
    assert bench.ok("torque", "on") == "torque on: J1 J2 J3 J4 J5 J6 J7\n"
    bench.clock.advance(2.0)
    assert bench.positions() == pytest.approx(before, abs=0.2)
    assert bench.ok("torque", "off") == "torque off: J1 J2 J3 J4 J5 J6 J7\n"


def test_torque_of_named_joints_whatever_the_case(bench: Any) -> None:
    assert bench.ok("torque", "on", "j2", "J5") == "torque on: J2 J5\n"
    assert bench.torque() == ["J2", "J5"]
    bench.ok("torque", "off", "J2")
    assert bench.torque() == ["J5"]


def test_torque_of_an_unknown_joint_is_a_usage_error(bench: Any) -> None:
    result = bench.run("torque", "on", "J9")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: no joint 'J9'")
    assert bench.torque() == []


def test_torque_wants_on_or_off(bench: Any) -> None:
    result = bench.run("torque", "maybe")
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


def test_torque_names_the_servo_that_did_not_confirm(make_bench: Any) -> None:
    result = make_bench("silent:4").run("torque", "off")
    assert result.exit_code == 1
    assert result.stdout == "torque off: J1 J2 J3 J4 J6 J7\n"
    assert result.stderr == "error: J5 (servo 4) did not confirm that torque is off\n"


def test_a_stop_holds_until_resume(bench: Any) -> None:
    bench.ok("torque", "on")
    assert bench.ok("stop") == "stopped, holding: J1 J2 J3 J4 J5 J6 J7\n"
    result = bench.run("move", "J1=0")
    assert result.exit_code == 1
    assert "hexwire resume" in result.stderr
    assert bench.torque() == J
    assert bench.ok("resume") == "resumed; torque on: J1 J2 J3 J4 J5 J6 J7\n"
    bench.ok("move", "J1=0")


def test_a_stop_that_nothing_keeps_is_reported(make_bench: Any) -> None:
    bench = make_bench(dialect=1)
    bench.ok("torque", "on")
    result = bench.run("stop")
    assert (result.exit_code, result.stdout) == (0, "stopped, holding: J1 J2 J3 J4 J5 J6 J7\n")
    assert result.stderr.startswith("note: this stop is not latched")


def test_torque_that_nobody_read_is_not_said_to_be_off(make_bench: Any) -> None:
    bench = make_bench(dialect=1)
    bench.ok("torque", "on")
    assert bench.ok("resume") == "resumed; torque on: none; unknown: J1 J2 J3 J4 J5 J6 J7\n"
    assert [joint["torque_on"] for joint in bench.json("state")["joints"]] == [None] * 7
    rows = [line.split() for line in bench.ok("state").splitlines()[1:8]]
    assert all(row[8] == "-" for row in rows), rows


def test_a_second_stop_after_a_resume_stops_again(bench: Any) -> None:
    # Each run begins its count of requests anew, and a board answers repeats without acting on them.
    for _ in range(3):
        bench.ok("stop")
        assert bench.json("state")["stopped"] is True
        bench.ok("resume")
        assert bench.json("state")["stopped"] is False


def test_a_stop_may_take_the_torque_away(bench: Any) -> None:
    bench.ok("torque", "on")
    assert bench.ok("stop", "--torque-off") == "stopped, limp: J1 J2 J3 J4 J5 J6 J7\n"
    assert bench.torque() == []
    assert bench.ok("resume") == "resumed; torque on: none\n"


def test_resume_switches_off_the_watchdog_of_a_program_that_died(bench: Any) -> None:
    bench.board.state.watchdog_timeout = 1.0
    bench.ok("torque", "on")
    bench.clock.advance(3.0)
    assert bench.json("state")["watchdog_tripped"]
    lines = bench.ok("resume").splitlines()
    assert lines[0] == "the watchdog of the program that fell silent is now off"
    assert lines[1].startswith("resumed; torque on: J1 ")
    bench.clock.advance(3.0)
    assert not bench.json("state")["stopped"]
    bench.ok("move", "J1=5", "--wait")
