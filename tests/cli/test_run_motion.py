from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    pass


def test_a_stop_from_elsewhere_ends_the_motion(bench: Any) -> None:
    bench.run("stop")
    result = bench.run("goto", "0", "220", "200")
    assert result.exit_code == 1
    assert "stopped" in result.stderr
    assert "hexwire resume" in result.stderr


def test_a_stopped_arm_with_torque_is_reported_with_the_remedy(bench: Any) -> None:
    bench.ok("torque", "on")
    bench.ok("stop")
    result = bench.run("goto", "0", "220", "200")
    assert result.exit_code == 1
    assert result.stderr == "error: a stop command has stopped the arm; `hexwire resume` ends that\n"


def test_ctrl_c_during_the_motion_stops_the_arm_and_disarms_the_watchdog(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.ok("goto", "0", "220", "200")
    started = bench.clock()
    receive, hit = bench.board.receive, []

    def interrupted(data: bytes, now: float) -> None:
        if now > started + 1.0 and not hit:
            hit.append(now)
            raise KeyboardInterrupt
        receive(data, now)

    monkeypatch.setattr(bench.board, "receive", interrupted)
    result = bench.run("goto", "120", "180", "150", "--speed", "10")
    assert result.exit_code == 130
    assert result.stderr.strip() == "stopped: the arm holds; clear it with 'hexwire resume'"
    there = bench.positions()["J1"]
    bench.clock.advance(5.0)
    assert bench.positions()["J1"] == pytest.approx(there, abs=0.5)
    state = bench.json("state")
    assert state["stopped"]
    assert not state["watchdog_tripped"]


def test_the_arm_stops_at_an_unknown_table(bench: Any) -> None:
    from hexwire.emulator.physics import PhysicsTwin
    from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel

    twin = PhysicsTwin(bench.board.wire.servos, Hex7BotModel())
    bench.ok("goto", "0", "240", "40", "--down")
    result = bench.run("line", "0", "240", "-60", "--down", "--no-table", "--speed", "80")
    assert result.exit_code == 1
    assert "stopped: J" in result.stderr
    assert twin.contacts > 0
    assert bench.json("state")["stopped"]
    # It holds where it met the table, and does not press on.
    for _ in range(10):
        bench.clock.advance(0.1)
        bench.positions()
    assert max(abs(servo.motion.torque) for servo in bench.board.wire.servos) < 0.5


def test_a_picture_that_fails_does_not_change_how_a_motion_ends(
    bench: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(self: object, file: str) -> None:
        raise OSError(28, "No space left on device", file)

    monkeypatch.setattr("hexwire.cli.plot.MotionPlot.draw", draw)
    picture = str(tmp_path / "a.png")
    result = bench.run("goto", "0", "220", "200", "--plot", picture)
    assert result.exit_code == 0
    assert result.stdout.endswith("arrived\n")
    assert result.stderr.count("has gaps, it failed once: No space left on device") == 1
    assert bench.run("goto", "0", "220", "200", "--plot", picture, "--dry-run").exit_code == 1
