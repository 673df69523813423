from __future__ import annotations

from typing import Any

import pytest


def test_pump(bench: Any) -> None:
    assert bench.ok("pump", "suck") == "pump on, valve shut\n"
    assert bench.ok("pump", "state") == "pump on, valve shut\n"
    assert bench.ok("pump", "release", "--time", "0") == "pump off, valve shut\n"
    assert bench.ok("pump", "off") == "pump off, valve shut\n"
    assert bench.board.state.io == 0


def test_grip(bench: Any) -> None:
    assert bench.ok("grip", "close") == "0 % open\n"
    assert bench.ok("grip", "open") == "100 % open\n"
    assert bench.ok("grip", "40%") == "40 % open\n"
    assert bench.positions()["J7"] == pytest.approx(45 - 0.4 * 90, abs=1.0)


def test_grip_ends_where_something_is_between_the_jaws(bench: Any) -> None:
    bench.ok("grip", "open")
    shaft = bench.board.wire.servos[6].motion
    shaft.obstacle = (None, shaft.position + 500)
    out = bench.ok("grip", "close")
    assert out == "holds an object at 51 % open\n"
    # Three degrees further than it got, and not the whole way: little pressure.
    assert shaft.target - shaft.position == pytest.approx(34, abs=3)


@pytest.mark.parametrize("tripped", [True, False])
def test_grip_says_why_the_arm_was_stopped_during_the_motion(
    bench: Any, tripped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.ok("grip", "open")
    begin, step = bench.clock(), bench.board.step

    def stopped(now: float) -> None:
        step(now)
        if now > begin + 0.5:
            bench.board.state.stopped = True
            bench.board.state.watchdog_tripped = tripped

    monkeypatch.setattr(bench.board, "step", stopped)
    result = bench.run("grip", "close")
    assert result.exit_code == 1
    watchdog = "the board has stopped the arm: its watchdog tripped, because the host fell silent"
    why = watchdog if tripped else "a stop command has stopped the arm"
    assert result.stderr == f"error: stopped: {why}; `hexwire resume` ends that\n"


def test_grip_wants_a_share(bench: Any) -> None:
    assert "open, close or a percentage, as in 40%, not 'half'" in bench.run("grip", "half").stderr
    assert bench.run("grip", "130").exit_code == 2
    assert "-5 is less than 0" in bench.run("grip", "-5").stderr
    assert bench.run("grip", "wide").exit_code == 2


def test_no_pump_without_the_firmware(make_bench: Any) -> None:
    result = make_bench(dialect=1).run("pump", "suck")
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 1
