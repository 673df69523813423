from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from hexwire.cli import demo as demo_module
from hexwire.cli.demo import turning_pose
from hexwire.errors import LimitError
from hexwire.model.arms.hex7bot.joints import HEX7BOT

ARM = ("--port", "/dev/ttyARM", "--yes-move-the-arm")


@pytest.fixture
def emulated(bench: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The demo's own board is the bench's."""
    asked: list[tuple[int, int, Sequence[str]]] = []

    @contextlib.contextmanager
    def board_process(*, baud: int, dialect: int, faults: Sequence[str]) -> Iterator[str]:
        asked.append((baud, dialect, tuple(faults)))
        yield "/dev/ttyEMULATED"

    monkeypatch.setattr(demo_module, "board_process", board_process)
    bench.asked = asked
    return bench


def test_it_goes_through_every_phase_and_sums_up(emulated: Any) -> None:
    result = emulated.run("demo", port=None)
    assert (result.exit_code, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert [line.partition(":")[0].strip() for line in lines] == [
        "started", "identified", "pinged", "read", "torque on",
        "0.0 s", "1.0 s", "2.0 s", "3.0 s", "4.0 s", "5.0 s", "6.0 s", "torque off", "summary",
    ]  # fmt: skip
    assert lines[0].endswith("at 115200 baud")
    assert lines[2] == "pinged: 7 of 7 servos answer"
    assert emulated.asked == [(115200, 2, ())]
    assert emulated.urls == ["/dev/ttyEMULATED?baud=115200"]
    summary = re.fullmatch(
        r"summary: dialect 2, (\d+) cycles at ([\d.]+) Hz \((\d+) late, (\d+) skipped\), "
        r"round trip p50 ([\d.]+) ms p99 ([\d.]+) ms, 0 retries, 0 dropped frames",
        lines[-1],
    )
    assert summary is not None, lines[-1]
    assert summary[1] == "120"
    assert float(summary[2]) == pytest.approx(20.0, rel=0.01)
    assert 1.0 < float(summary[5]) <= float(summary[6]) < 50.0


def test_what_both_sides_dropped_is_summed_up() -> None:
    host = {"requests": 100, "retries": 7, "bad_frames": 1, "stale_frames": 20, "sent": 5}
    new = SimpleNamespace(
        host_counters=lambda: host, board_counters=lambda: {"bad_checks": 300, "bad_frames": 4000}
    )
    assert demo_module._counters(new) == {"requests": 100, "retries": 7, "dropped": 4321}  # type: ignore[arg-type]
    old = SimpleNamespace(host_counters=lambda: host, board_counters=dict)
    assert demo_module._counters(old)["dropped"] == 21  # type: ignore[arg-type]


def test_all_seven_joints_go_there_and_come_back(emulated: Any) -> None:
    before = emulated.positions()
    lines = emulated.run("demo", "--duration", "2", port=None).stdout.splitlines()
    middle = next(line for line in lines if line.startswith("  1.0 s"))
    there = {name: float(angle) for name, angle in re.findall(r"(J\d) (-?[\d.]+)", middle)}
    assert all(abs(there[name] - before[name]) > 20 for name in before), "30 degrees, or half the way to the limit"
    assert emulated.positions() == pytest.approx(before, abs=0.5)
    assert emulated.torque() == []


def test_the_watchdog_guards_the_motion_and_is_off_in_the_end(emulated: Any) -> None:
    emulated.run("demo", "--duration", "2", port=None)
    emulated.clock.advance(5.0)
    assert emulated.json("state")["watchdog_tripped"] is False
    assert emulated.json("state")["stopped"] is False


def test_dialect_1_and_unpaced(make_bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench(dialect=1)
    monkeypatch.setattr(demo_module, "board_process", lambda **kw: contextlib.nullcontext("/dev/ttyOLD"))
    result = bench.run("demo", "--dialect", "1", "--baud", "0", port=None)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "started: an emulated Hex7Bot on /dev/ttyOLD, unpaced" in result.stdout
    assert "summary: dialect 1, 9 cycles at 1.50 Hz (0 late, 0 skipped)" in result.stdout


def test_a_real_arm_moves_only_if_confirmed(bench: Any) -> None:
    result = bench.run("demo", port="/dev/ttyARM")
    assert result.exit_code == 2
    assert "--yes-move-the-arm" in result.stderr
    assert bench.urls == []
    result = bench.run("demo", *ARM, "--duration", "1", port=None)
    assert (result.exit_code, result.stderr) == (0, "")
    assert bench.urls == ["/dev/ttyARM"]


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:9", "/dev/ttyARM?baud=57600"])
def test_a_rate_that_was_not_typed_is_none_of_an_address(bench: Any, url: str) -> None:
    result = bench.run("demo", "--yes", "--port", url, "--duration", "1", port=None)
    assert (result.exit_code, result.stderr) == (0, "")
    assert bench.urls == [url]
    result = bench.run("demo", "--yes", "--port", url, "--baud", "57600", port=None)
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)


def test_the_environment_does_not_move_a_real_arm(emulated: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEXWIRE_PORT", "/dev/ttyARM")
    assert emulated.run("demo", "--duration", "1", port=None).exit_code == 0
    assert emulated.urls == ["/dev/ttyEMULATED?baud=115200"]


@pytest.mark.parametrize(
    "words",
    [
        ["--yes-move-the-arm"],
        [*ARM, "--baud", "0"],
        [*ARM, "--fault", "silent:4"],
        ["--duration", "0"],
        ["--rate", "nan"],
    ],
)
def test_options_that_do_not_go_together(bench: Any, words: list[str]) -> None:
    result = bench.run("demo", *words, port=None)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("duration", ["0.1", "1"])
def test_no_joint_is_driven_faster_than_it_may(emulated: Any, duration: str) -> None:
    lines = emulated.run("demo", "--duration", duration, port=None).stdout.splitlines()
    seconds = int(re.search(r"(\d+) cycles", lines[-1])[1]) / 20  # type: ignore[index]
    # 30 degrees at 149 deg/s and the peak of a quintic, there and back.
    assert seconds == pytest.approx(max(float(duration), 2 * 30 / 149 * 15 / 8), abs=0.11)


def test_a_missing_servo_ends_it_before_anything_moves(make_bench: Any) -> None:
    bench = make_bench("silent:4")
    result = bench.run("demo", *ARM, port=None)
    assert result.exit_code == 1
    assert "pinged: 6 of 7 servos answer" in result.stdout
    assert "torque" not in result.stdout
    assert result.stderr == "error: servo 4 (J5) does not answer: check cable, power and id\n"


def test_a_servo_that_is_silent_for_a_while_does_not_end_it(emulated: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    servo, began = emulated.board.wire[4], emulated.clock()
    receive = servo.receive

    def muted(packet: Any, now: float) -> Any:
        return None if began + 3.0 < now < began + 4.0 else receive(packet, now)

    monkeypatch.setattr(servo, "receive", muted)
    result = emulated.run("demo", port=None)
    assert (result.exit_code, result.stderr) == (0, "")
    assert emulated.torque() == []


def test_an_interruption_takes_the_torque_away(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    began, hit = bench.clock(), []
    receive = bench.board.receive

    def interrupted(data: bytes, now: float) -> None:
        if now > began + 3.0 and not hit:
            hit.append(now)
            raise KeyboardInterrupt
        receive(data, now)

    monkeypatch.setattr(bench.board, "receive", interrupted)
    result = bench.run("demo", *ARM, port=None)
    assert result.exit_code == 130
    assert result.stderr.strip() == "torque off: all joints"
    assert bench.torque() == []
    assert not bench.link.is_open


def test_a_lost_port_is_reported_with_the_danger(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    began = bench.clock()
    receive = bench.board.receive

    def unplugged(data: bytes, now: float) -> None:
        if now > began + 3.0:
            bench.link.lost = True
        receive(data, now)

    def no_sleep(seconds: float) -> None:
        bench.clock.advance(seconds)

    monkeypatch.setattr(bench.board, "receive", unplugged)
    monkeypatch.setattr("hexwire.ipc.session.time.sleep", no_sleep)
    result = bench.run("demo", *ARM, port=None)
    assert result.exit_code == 1
    lines = result.stderr.splitlines()
    assert any(line.startswith("warning: the arm may still have torque: ") for line in lines)
    assert lines[-1].startswith("error: ")
    assert all(line.startswith(("warning: ", "error: ")) for line in lines)


def test_an_arm_that_does_not_come_back_is_an_error(make_bench: Any) -> None:
    # This servo gives up because of its heat and sinks.
    bench = make_bench("hot:4")
    result = bench.run("demo", *ARM, port=None)
    if result.exit_code:
        assert result.stderr.startswith("error: the arm did not come back to where it started: J5 by ")
    assert bench.torque() == []


def test_it_turns_where_there_is_room() -> None:
    middle = tuple((joint.minimum + joint.maximum) / 2 for joint in HEX7BOT.joints)
    for joint, start, goal in zip(HEX7BOT.joints, middle, turning_pose(HEX7BOT, middle), strict=True):
        assert abs(goal - start) == pytest.approx(min(math.radians(30), (joint.maximum - joint.minimum) / 4))
    for edge in ("minimum", "maximum"):
        start_pose = tuple(getattr(joint, edge) for joint in HEX7BOT.joints)
        for joint, goal in zip(HEX7BOT.joints, turning_pose(HEX7BOT, start_pose), strict=True):
            assert joint.minimum < goal < joint.maximum


def test_an_arm_outside_its_limits_is_not_moved() -> None:
    pose = tuple(joint.maximum + 0.1 for joint in HEX7BOT.joints)
    with pytest.raises(LimitError, match=r"J1=.* outside its limits"):
        turning_pose(HEX7BOT, pose)
