from __future__ import annotations

import json
import math
from typing import Any

import pytest

from hexwire.arm.plans import joint_angles
from hexwire.cli.motion import parse_targets
from hexwire.cli.verbs import arrived_words, hold_on_ctrl_c, rest_json
from hexwire.control.motion.rest import Rest
from hexwire.drivers.timed_path import PathState
from hexwire.errors import LinkLostError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.wire.command_frame import Command, parse_frame

# --- what a person types ---------------------------------------------------------------------------------


NOTE = {
    1: "note: hex7bot has no watchdog on this port: "
    "if this program dies, the arm moves on to its last target, for up to 1 s\n",
    2: "",
}


BUSY = {
    1: "",
    2: "warning: targets are sent one by one, since the board does not follow this path itself: "
    "the board is busy; try again\n",
}


def test_targets_are_taken_apart() -> None:
    pairs = parse_targets(["J1=10", "J3=-5.5", "wrist=1e1"])
    assert [(name, math.degrees(angle)) for name, angle in pairs] == [("J1", 10), ("J3", -5.5), ("wrist", 10)]


def test_all_malformed_targets_are_named_at_once() -> None:
    with pytest.raises(UsageError) as caught:
        parse_targets(["J1=1", "J2", "=3", "J4=", "J5=x", "J6=nan", "J7=inf"])
    text = str(caught.value)
    for word in ("'J2'", "'=3'", "'J4='", "'J5=x'", "'J6=nan'", "'J7=inf'"):
        assert word in text
    assert "'J1=1'" not in text


def test_targets_get_the_arms_own_names_and_radians() -> None:
    assert joint_angles(HEX7BOT, [("j4", 1.5)], within=True) == {"J4": 1.5}


def test_all_faults_are_reported_at_once() -> None:
    targets = parse_targets(["J1=200", "J9=0", "J2=50", "j2=51", "J4=1"])
    with pytest.raises(UsageError) as caught:
        joint_angles(HEX7BOT, targets, within=True)
    text = str(caught.value)
    assert "J1=200 deg is outside its limits -85 to 75 deg" in text
    assert "no joint 'J9'; hex7bot has J1," in text
    assert "J2 is named twice" in text
    assert "J4" not in text.replace("J1, J2, J3, J4", "")
    assert text.endswith("nothing was sent")


@pytest.mark.parametrize(
    "words", [["J1"], ["J1=x"], ["J9=1"], ["J1=200"], ["J1=1", "J1=2"], [], ["J1=1", "--duration", "nan"]]
)
def test_a_wrong_target_is_one_line_and_nothing_is_sent(bench: Any, words: list[str]) -> None:
    result = bench.run("move", *words)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert bench.link.written == []


# --- moving ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_move_switches_the_torque_on_where_it_is_missing_and_says_so(make_bench: Any, dialect: int) -> None:
    bench = make_bench(dialect=dialect)
    bench.ok("torque", "on", "J1")
    result = bench.run("move", "J1=10", "J5=-5.5", "--wait")
    assert (result.exit_code, result.stderr) == (0, NOTE[dialect])
    lines = result.stdout.splitlines()
    assert lines[0] == ("torque on: J5" if dialect == 2 else "torque on: J1 J5")
    assert lines[1].startswith("moving to: J1 10.0")
    assert lines[1].endswith(" deg in 1.00 s")
    assert lines[2] == "arrived"
    after = bench.positions()
    assert after["J1"] == pytest.approx(10.0, abs=1.0)
    assert after["J5"] == pytest.approx(-5.5, abs=1.0)
    assert after["J4"] == pytest.approx(-0.7, abs=0.2)


def test_without_wait_it_returns_at_once_and_the_arm_continues(bench: Any) -> None:
    bench.ok("move", "J4=30", "--duration", "2")
    assert bench.positions()["J4"] < 10
    bench.clock.advance(3.0)
    assert bench.positions()["J4"] == pytest.approx(30.0, abs=0.5)


def test_a_move_that_is_too_fast_gets_more_time(bench: Any) -> None:
    text = bench.ok("move", "J4=80", "--duration", "0.01")
    seconds = float(text.split(" deg in ")[1].split()[0])
    # 80.7 degrees at 6 rad/s^2 and 60 rad/s^3, smooth at both ends.
    assert seconds == pytest.approx(math.sqrt(10 / math.sqrt(3) * math.radians(80.7) / 6.0), rel=0.01)


def test_json_tells_what_was_sent_and_that_it_arrived(bench: Any) -> None:
    answer = bench.json("move", "J4=20", "--wait")
    assert answer["sent"][0]["name"] == "J4"
    assert answer["sent"][0]["position_deg"] == pytest.approx(20.0, abs=0.1)
    assert answer["torque_switched_on"] == ["J4"]
    assert answer["arrived"] is True
    assert len(answer["joints"]) == 7
    assert answer["duration_s"] == pytest.approx(1.0)
    answer = bench.json("move", "J4=10")
    assert answer["arrived"] is None
    assert answer["joints"] is None
    assert answer["torque_switched_on"] == []


def test_a_move_of_a_silent_servo_is_an_error_before_anything_moves(make_bench: Any) -> None:
    bench = make_bench("silent:4")
    result = bench.run("move", "J1=5", "J5=20", "--wait")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr == "error: the position of J5 is unknown: no answer; check cable, power and id\n"
    bench.clock.advance(2.0)
    state = json.loads(bench.run("state", "--json").stdout)
    assert state["joints"][0]["position_deg"] == pytest.approx(-4.47, abs=0.1)


def test_a_joint_that_falls_short_is_an_error_with_its_reason(make_bench: Any) -> None:
    # This servo protects itself from heat by giving up.
    bench = make_bench("hot:4")
    result = bench.run("move", "J4=20", "J5=20", "--wait")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: did not arrive: J5 is 16.")
    assert result.stderr.endswith(" deg off (temperature)\n")
    assert "arrived" not in result.stdout
    result = bench.run("move", "J5=20", "--wait", "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["arrived"] is False


def test_a_board_reset_during_a_move_is_reported(make_bench: Any) -> None:
    bench = make_bench("brownout:3:0.1")
    result = bench.run("move", "J4=80", "--duration", "5", "--wait")
    assert result.exit_code == 1
    assert "lost torque before the arrival" in result.stderr


def test_a_stop_during_a_move_is_reported(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    step = bench.board.step

    def stopped(now: float) -> None:
        step(now)
        if now > 1002.0:
            bench.board.state.stopped = True

    monkeypatch.setattr(bench.board, "step", stopped)
    result = bench.run("move", "J4=80", "--duration", "5", "--wait")
    assert result.exit_code == 1
    why = "a stop command has stopped the arm; `hexwire resume` ends that"
    assert result.stderr == f"error: stopped: {why}\n"


def test_a_board_that_keeps_the_time_gets_a_path_and_host_timed_is_one_target(bench: Any) -> None:
    for words, taken in (((), Command.TRAJECTORY_START), (("--host-timed",), Command.JOINT_MOVE)):
        for wait in ((), ("--wait",)):
            bench.link.written.clear()
            bench.ok("move", "J4=20", *words, *wait)
            sent = [parse_frame(data).cmd for data in bench.link.written]
            assert [sent.count(cmd) for cmd in (Command.TRAJECTORY_START, Command.JOINT_MOVE)] == [
                int(cmd == taken) for cmd in (Command.TRAJECTORY_START, Command.JOINT_MOVE)
            ]
            bench.clock.advance(2.0)


def test_a_board_reset_that_keeps_the_torque_is_told_at_once(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    step, hit = bench.board.step, []

    def reset(now: float) -> None:
        step(now)
        if now > 1002.5 and not hit:
            hit.append(now)
            bench.board.trajectory.state = PathState.NONE

    monkeypatch.setattr(bench.board, "step", reset)
    result = bench.run("move", "J4=80", "--duration", "9", "--wait")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: did not arrive: J4 is ")
    assert result.stderr.endswith(" deg off; the board was reset, or another program began another path\n")
    assert "resume" not in result.stderr
    assert bench.clock() < 1006.0


# --- a motion that was left to the board --------------------------------------------------------------------


def test_a_second_move_replaces_the_first(bench: Any) -> None:
    bench.ok("move", "J4=60", "--duration", "4")
    bench.clock.advance(2.0)
    assert bench.ok("move", "J4=0", "--wait").endswith("arrived\n")
    assert bench.positions()["J4"] == pytest.approx(0.0, abs=0.5)


def test_a_second_move_that_would_leave_a_joint_short_is_refused(bench: Any) -> None:
    bench.ok("move", "J4=20", "J7=20", "--duration", "3")
    bench.clock.advance(1.0)
    result = bench.run("move", "J4=0")
    assert result.exit_code == 2
    assert result.stderr == (
        "error: still moving: J7, as a program has told the board; wait until they have stopped, "
        "or move all joints together; nothing was sent\n"
    )
    bench.clock.advance(3.0)
    assert [bench.positions()[name] for name in ("J4", "J7")] == pytest.approx([20.0, 20.0], abs=0.5)


def test_a_stop_ends_it_and_resume_continues_nothing(bench: Any) -> None:
    bench.ok("move", "J4=60", "--duration", "4")
    bench.clock.advance(1.5)
    bench.ok("stop")
    place = bench.positions()["J4"]
    assert 2.0 < place < 50.0
    bench.ok("resume")
    bench.clock.advance(4.0)
    assert bench.positions()["J4"] == pytest.approx(place, abs=0.5)


def test_goto_and_grip_begin_where_it_came_to_rest(bench: Any) -> None:
    bench.ok("torque", "on")
    bench.ok("move", "J1=60", "--duration", "5")
    bench.clock.advance(2.0)
    assert "arrived" in bench.ok("goto", "0", "220", "150")
    bench.ok("move", "J7=20", "--duration", "3")
    bench.clock.advance(1.0)
    assert bench.ok("grip", "close").endswith("% open\n")
    bench.ok("move", "J1=40", "--duration", "3")
    bench.ok("line", "0", "0", "-10", "--relative", "--dry-run")
    bench.clock.advance(3.0)
    assert bench.positions()["J1"] == pytest.approx(40.0, abs=0.5)


# --- when this program dies ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("dialect", "left"), [(1, 25.0), (2, 20.0)])
def test_only_a_short_step_remains_when_the_program_dies(make_bench: Any, dialect: int, left: float) -> None:
    bench = make_bench(dialect=dialect)
    bench.run("torque", "on")
    before = bench.positions()["J4"]
    begin = bench.clock()
    receive = bench.board.receive

    def deaf(data: bytes, now: float) -> None:
        if now < begin + 3.0:
            receive(data, now)

    # From then on nothing comes any more, whatever the program still tries.
    bench.board.receive = deaf
    result = bench.run("move", "J4=70", "--duration", "8", "--wait")
    assert result.exit_code == 1
    bench.board.wire.step(bench.clock())
    bench.board.receive = receive
    there = bench.positions()["J4"]
    assert 5.0 < there - before < left + 15.0
    bench.clock.advance(5.0)
    assert bench.positions()["J4"] == pytest.approx(there, abs=0.5)
    if dialect == 2:
        assert bench.json("state")["watchdog_tripped"]
        assert "watchdog" in bench.ok("state")


def test_after_a_stall_it_says_that_the_watchdog_has_tripped(bench: Any) -> None:
    bench.ok("torque", "on")
    begin, hit = bench.clock(), []
    read = bench.link.read

    def stalls(deadline: float | None) -> bytes:
        if bench.clock() > begin + 2.0 and not hit:
            hit.append(1)
            bench.board.step(bench.clock())
            end = bench.clock() + 2.0
            while bench.clock() < end:
                bench.clock.advance(0.01)
                bench.board.step(bench.clock())
        data: bytes = read(deadline)
        return data

    bench.link.read = stalls
    result = bench.run("move", "J4=80", "--duration", "6", "--wait")
    assert result.exit_code == 1
    assert "stopped: the board has stopped the arm: its watchdog tripped" in result.stderr
    assert bench.json("state")["watchdog_tripped"], "and whoever asks later learns it too"


def test_without_wait_the_watchdog_is_left_alone(bench: Any) -> None:
    bench.ok("move", "J4=30", "--duration", "4")
    assert bench.board.state.watchdog_timeout == 0
    bench.clock.advance(6.0)
    assert bench.positions()["J4"] == pytest.approx(30.0, abs=0.5)


# --- Ctrl-C ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [1, 2])
def test_ctrl_c_while_waiting_stops_the_arm_where_it_is(
    make_bench: Any, monkeypatch: pytest.MonkeyPatch, dialect: int
) -> None:
    bench = make_bench(dialect=dialect)
    bench.ok("torque", "on")
    started = bench.clock()
    receive, hit = bench.board.receive, []

    def interrupted(data: bytes, now: float) -> None:
        if now > started + 3.0 and not hit:
            hit.append(now)
            raise KeyboardInterrupt
        receive(data, now)

    monkeypatch.setattr(bench.board, "receive", interrupted)
    result = bench.run("move", "J4=80", "--duration", "6", "--wait")
    assert result.exit_code == 130
    note = result.stderr.strip()
    # The emulated link of dialect 1 is no device: nobody keeps a stop of it.
    words = "stopped: the arm holds" + ("; clear it with 'hexwire resume'" if dialect == 2 else "")
    assert note.removeprefix(NOTE[dialect]) == words
    there = bench.positions()["J4"]
    assert 5 < there < 60
    bench.clock.advance(5.0)
    assert bench.positions()["J4"] == pytest.approx(there, abs=1.0)
    if dialect == 2:
        assert bench.json("state")["stopped"] is True


def test_a_stop_that_fails_on_ctrl_c_is_reported_and_it_still_counts_as_interrupted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Gone:
        def stop(self) -> None:
            raise LinkLostError("the port went away")

    with pytest.raises(KeyboardInterrupt), hold_on_ctrl_c(Gone()):  # type: ignore[arg-type]
        raise KeyboardInterrupt
    assert capsys.readouterr().err == "warning: the arm could not be stopped: the port went away\n"


def test_a_move_that_would_fold_the_arm_is_refused_and_nothing_moves(bench: Any) -> None:
    bench.ok("move", "J3=37.5", "--wait")
    before = bench.positions()
    result = bench.run("move", "J2=115")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: elbow ")
    assert result.stderr.endswith(" of the path; nothing was sent\n")
    bench.clock.advance(2.0)
    assert bench.positions() == pytest.approx(before, abs=0.3)
    bench.ok("move", "J2=80", "--wait")


def test_a_move_into_the_table_is_refused_unless_there_is_none(bench: Any) -> None:
    low = ("J2=25", "J3=62", "--duration", "3")
    result = bench.run("move", *low, "--table", "60")
    assert result.exit_code == 2
    assert "mm below the table at 60 mm" in result.stderr
    bench.ok("move", *low, "--no-table", "--wait")


@pytest.mark.parametrize("dialect", [1, 2])
def test_a_move_is_refused_while_another_joint_moves(make_bench: Any, dialect: int) -> None:
    bench = make_bench(dialect=dialect)
    bench.ok("move", "J2=110", "--duration", "6")
    result = bench.run("move", "J3=37")
    assert result.exit_code == 2
    words = "still moving: J2; wait until the arm has stopped, or move all joints together; nothing was sent"
    assert result.stderr == f"error: {words}\n"
    result = bench.run("move", "J7=20")
    assert (result.exit_code, result.stderr) == (0, BUSY[dialect])
    bench.clock.advance(6.0)
    assert bench.run("move", "J3=10", "--wait").stderr == NOTE[dialect]


def test_with_a_silent_joint_a_path_that_cannot_be_checked_is_refused(make_bench: Any) -> None:
    bench = make_bench("silent:2")
    result = bench.run("move", "J2=60", "--wait")
    assert result.exit_code == 1
    assert result.stderr == "error: the position of J3 is unknown: no answer; check cable, power and id\n"


def test_an_option_about_the_table_must_have_an_effect(bench: Any) -> None:
    result = bench.run("move", "J1=5", "--table", "60", "--no-table")
    assert result.exit_code == 2
    assert result.stderr == "error: --table and --no-table contradict each other\n"
    result = bench.run("move", "J1=5", "--robot", "chain", "--table", "60")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: no geometry is known for chain")
    assert bench.link.written == []


def test_another_link_set_has_its_own_coupling_limits(bench: Any) -> None:
    result = bench.run("move", "J1=5", "--links", "Z")
    assert result.exit_code == 2
    assert "Z" in result.stderr


def test_a_silent_gripper_is_reported_instead_of_its_effect_on_the_path(make_bench: Any) -> None:
    bench = make_bench("silent:6")
    result = bench.run("move", "J1=5", "J7=5")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: servo 6 (J7) does not answer")


def test_a_duration_that_makes_no_sense_is_refused_before_the_torque(bench: Any) -> None:
    bench.ok("torque", "off")
    result = bench.run("move", "J1=5", "--duration", "1e308")
    assert result.exit_code == 2
    assert "a motion takes 0 to 3600 s" in result.stderr
    assert not any(joint["torque_on"] for joint in bench.json("state")["joints"])


def test_how_far_off_the_arm_came_to_rest() -> None:
    off = Rest("J2", math.radians(0.8), 0.00394)
    assert arrived_words(off) == "arrived, J2 0.8 deg off, the tip 3.9 mm"
    assert arrived_words(Rest("J2", math.radians(0.8), None)) == "arrived, J2 0.8 deg off"
    assert arrived_words(Rest("J2", math.radians(0.05), 0.001)) == "arrived"
    assert arrived_words(Rest("J2", math.nan, None)) == "arrived; since then the position of J2 is unknown"
    assert rest_json(off) == {"off_deg": pytest.approx(0.8), "off_mm": pytest.approx(3.94)}
    assert rest_json(Rest("J2", math.nan, None)) == rest_json(None) == {"off_deg": None, "off_mm": None}


def test_move_says_where_the_arm_came_to_rest(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    goals: list[dict[str, float]] = []

    def rest(robot: object, goal: dict[str, float], **how: object) -> Rest:
        goals.append(goal)
        return Rest("J4", math.radians(0.8), 0.004)

    monkeypatch.setattr("hexwire.control.motion.motions.come_to_rest", rest)
    assert bench.ok("move", "J4=20", "--wait").endswith("arrived, J4 0.8 deg off, the tip 4.0 mm\n")
    told = bench.json("move", "J4=10", "--wait")
    assert (told["off_deg"], told["off_mm"]) == (pytest.approx(0.8), pytest.approx(4.0))
    assert [math.degrees(goal["J4"]) for goal in goals] == pytest.approx([20.0, 10.0], abs=0.1)
    # Without waiting nobody knows.
    assert bench.json("move", "J4=0")["off_deg"] is None
    assert len(goals) == 2


def test_a_move_of_no_duration_is_as_fast_as_the_limits_allow(bench: Any) -> None:
    assert bench.run("move", "J1=10", "--duration", "0", "--wait").exit_code == 0
