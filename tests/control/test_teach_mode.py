"""Teaching an emulated arm by hand, in simulated time."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.control.arm_bench import SPLIT, SUCCEEDED, Bench, free, guide, make_bench, order
from tests.drivers.arms import Arm as EmulatedArm
from tests.motion.arms import HOME, NAMES

from hexwire.control.requests.teach_mode import record_by_hand
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.errors import HexwireError, ReplyTimeoutError, ServoError, UsageError
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.waypoint_file import parse_waypoints

J1 = HOME["J1"]


@pytest.mark.slow
def test_teaching_and_playing_back(tmp_path: Path) -> None:
    bench = make_bench(teach_directory=str(tmp_path))
    assert bench.ask(bench.arm.teach_start) == f"teaching {', '.join(NAMES)}; they have no torque"
    assert not any(bench.torques())
    guide(bench, "J1", 0.4)
    guide(bench, "J1", -0.1)
    end = bench.where("J1")
    words = bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert "taught " in words
    (path,) = tmp_path.iterdir()
    assert str(path) in words
    assert json.loads(path.read_text(encoding="utf-8"))["joint_names"] == list(NAMES)
    way = parse_waypoints(path.read_bytes(), path.name)
    assert way.goal[0] == pytest.approx(end, abs=0.02)
    (taught,) = bench.taught
    assert taught is bench.arm.teach_mode.taught
    bench.ask(lambda: bench.arm.go_to("home"))
    assert bench.ask(bench.arm.teach_play) == f"played {taught.duration:.1f} s"
    assert bench.where("J1") == pytest.approx(end, abs=0.02)


def test_nothing_moves_while_somebody_holds_the_arm() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    requests = [
        lambda: bench.command(order((1.0, {}))),
        lambda: bench.arm.command("", order()),
        lambda: bench.arm.set_points({"J1": J1}),
        lambda: bench.arm.go_to("home"),
        lambda: bench.arm.enable(True),
        lambda: bench.arm.enable(False),
        bench.arm.teach_start,
    ]
    for request in requests:
        with pytest.raises(UsageError, match="the arm is in teach mode; end teach mode first"):
            request()
    assert not any(bench.torques())
    with pytest.raises(UsageError, match="nothing was taught since"):
        bench.arm.teach_play()
    assert free(bench)


def switch(bench: Bench, names: tuple[str, ...]) -> None:
    """Switch the torque of these joints on."""
    if names:
        bench.ask(lambda: bench.owner.torque(True, names))


@pytest.mark.slow
def test_teach_mode_ends_holding_whatever_had_torque_before() -> None:
    """In every front: ROS 1, ROS 2 and the studio call the arm's, `hexwire teach` calls `record_by_hand`."""

    def services(bench: Bench) -> None:
        bench.ask(bench.arm.teach_start)
        assert not any(bench.torques())
        guide(bench, "J1", 0.4)
        bench.ask(bench.arm.teach_stop)
        assert bench.arm.teach_mode.taught is not None

    def a_program_that_ends(bench: Bench) -> None:
        bench.ask(bench.arm.teach_start)
        bench.ask(lambda: bench.arm.teach_mode.shutdown(hold=True))

    for front in (services, a_program_that_ends):
        for before in ((), ("J2", "J5"), NAMES):
            bench = make_bench(on=False)
            switch(bench, before)
            front(bench)
            assert bench.torques() == [True] * 7, (front.__name__, before)
            assert not bench.arm.teach_mode.hand.active
    for before in ((), ("J2", "J5"), NAMES):
        arm = EmulatedArm(2)
        if before:
            arm.driver.torque(True, before)
        record(arm, lambda state: None, duration=0.2)
        assert arm.torques() == [True] * 7, before


def test_a_program_that_switches_torque_off_at_its_end_leaves_it_off_in_teach_mode_too() -> None:
    bench = make_bench(torque_off_at_exit=True)
    bench.ask(bench.arm.teach_start)
    bench.ask(lambda: bench.arm.teach_mode.shutdown(hold=not bench.arm.settings.torque_off_at_exit))
    assert not any(bench.torques())
    assert not bench.arm.teach_mode.hand.active


@pytest.mark.slow
def test_a_moving_arm_is_not_taught() -> None:
    bench = make_bench()
    told = bench.command(order((1.0, {"J1": J1 + 0.3})))
    with pytest.raises(UsageError, match="the arm is moving; wait, or cancel the goal first"):
        bench.arm.teach_start()
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    with pytest.raises(UsageError, match="the arm is not in teach mode"):
        bench.arm.teach_stop()


def test_torque_comes_back_even_if_nothing_was_recorded() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    bench.owner.observers = ()
    bench.arm.teach_mode._teacher._samples.clear()
    with pytest.raises(UsageError, match="nothing was recorded"):
        bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert free(bench)
    bench.ask(lambda: bench.arm.go_to("home"))


def test_teaching_without_a_motion_keeps_what_was_taught_before() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    bench.ask(bench.arm.teach_stop)
    taught = bench.arm.teach_mode.taught
    bench.ask(bench.arm.teach_start)
    bench.turn(2.0)
    with pytest.raises(UsageError, match=r"^nothing was recorded: no joint moved;"):
        bench.ask(bench.arm.teach_stop)
    assert bench.arm.teach_mode.taught is taught
    assert all(bench.torques())
    assert free(bench)


def test_a_stop_in_teaching_leaves_the_arm_without_torque() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    assert bench.arm.stop("test") == f"stopped, limp: {' '.join(NAMES)}; all joints confirmed it"
    bench.turn(0.5)
    assert not any(bench.torques()), "somebody has a hand in it"
    with pytest.raises(UsageError, match="the arm is not in teach mode"):
        bench.arm.teach_stop()
    bench.ask(bench.arm.reset)
    bench.turn(0.5)
    with pytest.raises(UsageError, match="the arm is not in teach mode"):
        bench.arm.teach_stop()
    assert not any(bench.torques())
    bench.ask(lambda: bench.arm.enable(True))
    assert all(bench.torques())


def test_a_stop_while_teaching_begins() -> None:
    bench = make_bench()
    service = bench.begin(bench.arm.teach_start)
    pause = threading.Event()
    while not bench.arm.teach_mode.hand.active and service.thread.is_alive():
        pause.wait(0.001)
    bench.arm.stop("test")
    bench.settle(service)
    with pytest.raises(HexwireError):
        service.answer()
    assert free(bench)
    assert not bench.arm.teach_mode.hand.active
    assert not bench.arm.teach_mode._teacher.active


def test_a_recording_is_kept_if_a_joint_gets_no_torque() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    bench.silence("J6")
    with pytest.raises(UsageError, match=r"^taught .* points; J6 \(servo 5\) did not confirm that torque is on$"):
        bench.ask(bench.arm.teach_stop)
    assert bench.arm.teach_mode.taught is not None
    assert not bench.arm.teach_mode.hand.active
    assert free(bench)


def test_a_recording_is_kept_if_it_cannot_be_saved(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    bench = make_bench(teach_directory=str(tmp_path / "taken"))
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    with pytest.raises(UsageError, match="cannot be saved"):
        bench.ask(bench.arm.teach_stop)
    assert all(bench.torques())
    assert bench.arm.teach_mode.taught is not None


def test_a_joint_that_keeps_its_torque_is_not_taught() -> None:
    bench = make_bench()
    bench.silence("J2")
    with pytest.raises(ServoError, match=r"J2 \(servo 1\) did not confirm that torque is off"):
        bench.ask(bench.arm.teach_start)
    assert not bench.arm.teach_mode.hand.active
    assert free(bench)
    assert bench.torques()[0], "the others hold again"


def test_a_robot_that_is_lost_while_it_is_taught() -> None:
    bench = make_bench()
    bench.ask(bench.arm.teach_start)
    guide(bench, "J1", 0.3)
    bench.link.lost = True
    bench.turn(1.0)
    with pytest.raises(UsageError, match="the robot cannot be reached"):
        bench.arm.teach_stop()
    assert bench.arm.teach_mode.taught is not None
    bench.link.lost = False
    bench.until(lambda: bench.owner.connected)
    bench.turn(1.0)
    assert not any(bench.torques())
    assert free(bench)


@pytest.mark.slow
def test_a_part_of_what_was_taught() -> None:
    bench = make_bench(controllers=SPLIT)
    bench.ask(bench.arm.teach_start)
    guide(bench, "J7", 0.3)
    bench.ask(bench.arm.teach_stop)
    assert bench.arm.teach_mode.taught is not None
    part = bench.arm.teach_mode.taught.part(("J7", "J1")).trajectory()
    assert part.names == ("J7", "J1")
    assert part.goal == pytest.approx((0.3, J1), abs=0.02)
    bench.ask(bench.arm.teach_play)


def test_a_stopped_arm_keeps_its_torque_and_is_not_taught() -> None:
    bench = make_bench()
    bench.arm.stop("test")
    with pytest.raises(UsageError, match=r"the arm is stopped \(test\); reset it first"):
        bench.ask(bench.arm.teach_start)
    assert all(bench.torques())
    assert free(bench)


def record(arm: EmulatedArm, take: Callable[[JointState], object], **options: Any) -> None:
    record_by_hand(arm.driver, take, sleep=arm.wait, **options)


@pytest.mark.parametrize("limp", [False, True])
def test_an_arm_guided_by_hand_holds_at_the_end_unless_torque_stays_off(limp: bool) -> None:
    arm = EmulatedArm(2)
    arm.driver.torque(True)
    started: list[list[bool]] = []
    states: list[JointState] = []

    def take(state: JointState) -> None:
        states.append(state)
        assert arm.torques() == [False] * 7
        if len(states) == 3:
            raise KeyboardInterrupt

    record(arm, take, torque_off_at_end=limp, on_start=lambda: started.append(arm.torques()))
    assert started == [[False] * 7]
    assert len(states) == 3
    assert arm.torques() == [not limp] * 7


def test_a_recording_by_hand_ends_when_somebody_else_switches_torque_on() -> None:
    arm = EmulatedArm(2)
    arm.driver.torque(True)
    states: list[JointState] = []

    def take(state: JointState) -> None:
        states.append(state)
        if len(states) == 3:
            arm.driver.torque(True, ["J2"])

    with pytest.raises(ServoError, match="torque of J2 was switched on from elsewhere"):
        record(arm, take, duration=60.0)
    assert len(states) == 4
    # Nobody needs to go on holding it.
    assert arm.torques() == [True] * 7


@pytest.mark.parametrize(
    ("duration", "rate", "count"),
    [
        (1.0, {}, 20),
        (1.0, {"rate": 0.0}, 20),
        (0.3, {"rate": 10.0}, 3),
        (0.01, {"rate": 10.0}, 1),
        (0.25, {"rate": 10.0}, 3),
    ],
)
def test_a_recording_has_as_many_states_as_periods_begin_in_its_time(
    duration: float, rate: dict[str, float], count: int
) -> None:
    arm = EmulatedArm(2)
    states: list[JointState] = []
    record(arm, states.append, duration=duration, **rate)
    assert len(states) == count
    assert arm.torques() == [True] * 7, "all hold, also those that had no torque"


def test_torque_comes_back_when_a_state_does_not_come_and_no_stop_is_latched() -> None:
    arm = EmulatedArm(2)
    arm.driver.torque(True)
    read = arm.driver.read

    def take(state: JointState) -> None:
        def fails_once() -> JointState:
            arm.driver.read = read  # type: ignore[method-assign]  # the one failure is over
            raise ReplyTimeoutError("nothing came")

        arm.driver.read = fails_once  # type: ignore[method-assign]  # a state that does not come

    with pytest.raises(ReplyTimeoutError, match="nothing came"):
        record(arm, take, duration=1.0)
    assert arm.torques() == [True] * 7
    assert not arm.driver.read().stopped


def test_a_program_that_stalls_while_it_records_latches_no_stop() -> None:
    arm = EmulatedArm(2)
    record(arm, lambda state: arm.wait(3.0), duration=1.0)
    assert arm.torques() == [True] * 7
    assert not arm.driver.read().stopped


def test_a_rate_that_makes_no_sense_leaves_the_torque_on() -> None:
    arm = EmulatedArm(2)
    arm.driver.torque(True)
    with pytest.raises(UsageError, match="is not possible"):
        record(arm, lambda state: None, rate=1e300)
    assert arm.torques() == [True] * 7


@pytest.mark.parametrize("limp", [False, True])
def test_joints_whose_torque_is_unknown_count_as_having_torque(limp: bool) -> None:
    arm = EmulatedArm(1)
    arm.driver.torque(True)
    arm.driver.detach()
    stranger = Hex7BotDriver(arm.driver.session, boot_window=20.0)
    stranger.attach()
    assert all(flags & JointFlag.TORQUE_UNKNOWN for flags in stranger.read().flags)
    started: list[list[bool]] = []
    record_by_hand(
        stranger,
        lambda state: None,
        duration=1.0,
        torque_off_at_end=limp,
        on_start=lambda: started.append(arm.torques()),
        sleep=arm.wait,
    )
    assert started == [[False] * 7]
    assert arm.torques() == [not limp] * 7
