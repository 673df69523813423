from __future__ import annotations

import csv
import re
from contextlib import nullcontext
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.cli.bus_cli import BusCli

from hexwire.bus.latency import LatencyCounts
from hexwire.cli.bus_live import histogram
from hexwire.cli.main import cli
from hexwire.control import run_motion
from hexwire.drivers.bus_arm import BusArm
from hexwire.errors import UsageError
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.wire.registers import Series


def test_monitor_prints_and_saves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch, (1, 2, 3), (Series.STS_SMS, Series.HLS, Series.SCS))
    table, plot = tmp_path / "m.csv", tmp_path / "m.svg"
    output = bus.ok("monitor", "1-3", "--seconds", "1", "--csv", str(table), "--plot", str(plot))
    assert "position deg" in output
    assert len(re.findall(r"^ *[123] .*\bok *$", output, re.MULTILINE)) >= 27
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert {row["id"] for row in rows} == {"1.0", "2.0", "3.0"}
    assert len(rows) >= 27
    assert plot.read_text().startswith("<?xml")


def test_monitor_shows_a_servo_that_went(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, faults=["silent:2:0.9"])
    result = bus.run("monitor", "1,2", "--seconds", "1")
    assert result.exit_code in (0, 1)
    assert "no answer" in result.output


def test_files_that_cannot_be_created_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bus = BusCli(monkeypatch)
    assert bus.run("monitor", "1", "--csv", str(tmp_path / "no" / "m.csv")).exit_code == 2
    assert bus.run("monitor", "1", "--plot", str(tmp_path / "m.txt")).exit_code == 2


@pytest.mark.parametrize("series", [Series.STS_SMS, Series.HLS])
@pytest.mark.parametrize("shape", ["sine", "step", "triangle", "sweep"])
def test_wave_moves_and_comes_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, series: Series, shape: str
) -> None:
    bus = BusCli(monkeypatch, (1, 2), (series,))
    servo = bus.device.wire[2]
    start = servo.motion.position
    table = tmp_path / "w.csv"
    bus.ok("wave", "2", "--shape", shape, "--amplitude", "10", "--csv", str(table), "--seconds", "4", answer="y\n")
    positions = [float(row["position"]) for row in csv.DictReader(table.read_text().splitlines())]
    assert max(positions) - min(positions) > 0.28
    assert max(positions) - min(positions) < 0.40
    assert servo.motion.position == pytest.approx(start, abs=4)
    assert servo.registers.get("torque_enable") == 0
    assert bus.device.wire[1].registers.get("torque_enable") == 0


def test_wave_is_refused_before_anything_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    servo = bus.device.wire[1]
    assert bus.run("wave", "1", answer="n\n").exit_code == 130
    assert bus.run("wave", "1", "--amplitude", "50", "--yes").exit_code == 2
    bus.ok("write", "1", "min_position_limit", "2040")
    result = bus.run("wave", "1", "--yes")
    assert result.exit_code == 2
    assert "is too much" in result.stderr
    assert servo.registers.get("torque_enable") == 0


class Killed(BaseException):
    """Nothing else of this program is done."""


def test_a_wave_that_is_killed_leaves_the_servo_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, write = BusCli(monkeypatch), BusArm.write
    targets: list[int] = []

    def dies(arm: BusArm, target: JointTarget) -> SentTarget:
        sent = write(arm, target)
        targets.append(arm.model.joints[0].angle_to_counts(target.positions[0][1]))
        if len(targets) == 60:
            raise Killed
        return sent

    monkeypatch.setattr(BusArm, "write", dies)
    monkeypatch.setattr("hexwire.cli.bus_live._brought_back", lambda *_, **__: nullcontext())
    with pytest.raises(Killed):
        CliRunner().invoke(cli, ["bus", "wave", "1", "--yes", "--port", "/dev/ttyTEST"], catch_exceptions=False)
    servo = bus.device.wire[1]
    there = servo.motion.position
    bus.link.clock.advance(5.0)
    # A target lasts 20 ms, and the servo is never far behind it; a degree has 11 counts.
    assert servo.motion.position == pytest.approx(targets[-1], abs=11)
    assert servo.motion.position == pytest.approx(there, abs=22)
    assert servo.registers.get("torque_enable") == 1, "it holds"


def test_a_wave_has_the_servo_for_itself_and_a_stop_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, read = BusCli(monkeypatch), BusArm.read
    reads = iter(range(1000))

    def busy(arm: BusArm) -> JointState:
        number = next(reads)
        if number == 30:
            with pytest.raises(UsageError, match="already in motion"):
                run_motion(arm, JointTarget.of({arm.model.names[0]: 0.0}))
        if number == 40:
            arm.stop()
            arm.resume()
        return read(arm)

    monkeypatch.setattr(BusArm, "read", busy)
    result = bus.run("wave", "1", "--yes")
    assert result.exit_code == 1
    assert "stopped: a stop command has stopped the arm" in result.stderr
    assert next(reads) < 45


def test_wave_ends_at_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch, faults=["hot:1"])
    bus.link.clock.advance(1.0)
    result = bus.run("wave", "1", "--yes")
    assert result.exit_code == 1
    assert "temperature" in result.stderr


def test_stress(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = BusCli(monkeypatch)
    output = bus.ok("stress", "1-3", "-n", "50")
    assert "50 reads of 3" in output
    assert "missing: 0 of 150" in output
    bad = BusCli(monkeypatch, faults=["silent:2:0.98"])
    bad.run("ping", "1")
    result = bad.run("stress", "1,2", "-n", "50", "--series", "sts_sms")
    assert result.exit_code == 1
    assert "most of them from servo 2" in result.stderr


def test_histogram() -> None:
    counts = LatencyCounts()
    for seconds in [0.001] * 90 + [0.002] * 9 + [0.1]:
        counts.add(seconds)
    text = histogram(counts.bins())
    assert "p50 1000 us" in text
    assert "longest 100000 us" in text
    assert len(text.splitlines()) == 12
    one = LatencyCounts()
    one.add(0.5)
    assert "#" in histogram(one.bins())
