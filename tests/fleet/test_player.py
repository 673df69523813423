"""Motions of several arms: a common start, all or none, and one failure stops all."""

from __future__ import annotations

import _thread
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

import hexwire
from hexwire.errors import HexwireError
from hexwire.fleet import messages as m
from hexwire.fleet import player
from hexwire.fleet.player import Arm, FleetMotionError, Played, Report, attached_to, play_together
from hexwire.fleet.remote import RemoteRobot
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.waypoints import Spline, Waypoint

from .conftest import Serve
from .eventually import eventually

NAMES = ("lab/arm1", "lab/arm2")
STILL = 0.006
"""Radians: three counts and a bit."""


def way(by: float = 0.2, seconds: float = 1.0, joint: str = "J1") -> Spline:
    """There and back."""
    points = [(0.0, 0.0), (0.5 * seconds, by), (seconds, 0.0)]
    return Spline((joint,), [Waypoint(t, (angle,), (0.0,)) for t, angle in points])


@pytest.fixture
def robots(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, RemoteRobot]]:
    # Longer times than usual, so that a busy machine is not taken for a player that died.
    monkeypatch.setattr(player, "_WATCHDOG", 5.0)
    for name in NAMES:
        # The board of the first keeps the time, the server of the second.
        serve(name, lease=3.0, robot="sim", host_timed=name == NAMES[1])
    with attached_to({name: f"zenoh:{name}" for name in NAMES}) as attached:
        yield attached


def arms(robots: dict[str, RemoteRobot], **paths: Spline) -> list[Arm]:
    return [Arm(robot, paths.get(name[-4:], way())) for name, robot in robots.items()]


def where(robots: dict[str, RemoteRobot]) -> list[float]:
    return [robot.read().positions["J1"] for robot in robots.values()]


def stand_still(robots: dict[str, RemoteRobot], before: list[float]) -> bool:
    return all(abs(a - b) < STILL for a, b in zip(where(robots), before, strict=True))


def test_a_missed_answer_before_a_motion_is_asked_for_again(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a server whose computer was busy for a moment."""
    read, missed = RemoteRobot.read, set()

    def seldom(robot: RemoteRobot) -> JointState:
        state = read(robot)
        if robot.url in missed:
            return state
        missed.add(robot.url)
        return replace(state, flags=(int(JointFlag.SILENT),) * len(state.names))

    monkeypatch.setattr(RemoteRobot, "read", seldom)
    assert play_together(arms(robots)).duration == 1.0
    assert len(missed) == 2


def test_arms_begin_together_and_arrive(robots: dict[str, RemoteRobot]) -> None:
    told: list[str] = []
    report = play_together(arms(robots), tell=told.append)
    assert [line.partition(" ")[0] for line in told[2:]] == ["approach:", "motion:", "lab/arm2:"]
    assert sorted(line.partition(":")[0] for line in told[:2]) == list(NAMES)
    assert told[-1] == "lab/arm2: its server keeps the time: it may begin 50 ms late"
    assert {name: row.kept_by for name, row in report.arms.items()} == {"lab/arm1": "board", "lab/arm2": "host"}
    one, two = (report.arms[name] for name in NAMES)
    assert one.doubt + one.late <= player.MOST_DOUBT
    assert two.late == 0.05
    assert report.apart == pytest.approx(one.doubt + one.late + two.doubt + two.late)
    assert report.duration == 1.0
    assert sorted(report.arms) == list(NAMES)
    # How far apart is tested in simulated time, in tests/control/test_shared_goals.py.
    # To the last exchange the clock may become known better.
    assert all(row.moved > -player.MOST_DOUBT for row in report.arms.values())
    assert report.skew >= 0.0
    assert 0.0 < report.doubt <= 2 * player.MOST_DOUBT
    assert not any(robot.read().stopped for robot in robots.values())
    # The leases were given back.
    eventually(lambda: not any(robot.holder for robot in robots.values()))


def test_a_dry_run_checks_and_moves_nothing(robots: dict[str, RemoteRobot]) -> None:
    before = where(robots)
    report = play_together(arms(robots), dry_run=True)
    assert (report.duration, report.arms) == (1.0, {})
    assert math.isnan(report.skew)
    assert stand_still(robots, before)
    assert not any(robot.read().torque_on for robot in robots.values())
    with pytest.raises(FleetMotionError, match=r"no arm moved: lab/arm2: .*J1 would turn at"):
        play_together(arms(robots, arm2=way(1.0, 0.1)), dry_run=True)


def test_if_one_refuses_none_begins(robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch) -> None:
    before = where(robots)
    with pytest.raises(FleetMotionError, match=r"lab/arm2: .*J1 would turn at"):
        play_together(arms(robots, arm2=way(1.0, 0.1)))
    with pytest.raises(FleetMotionError, match="lab/arm1: it has no X1, but J1"):
        play_together(arms(robots, arm1=way(joint="X1")))
    robots["lab/arm2"].stop()
    with pytest.raises(FleetMotionError, match="lab/arm2: it is stopped"):
        play_together(arms(robots))
    robots["lab/arm2"].resume()
    monkeypatch.setattr(player, "_CLOCKS", 0.1)
    with pytest.raises(FleetMotionError, match=r"lab/arm[12]: its clock is known to .* and 0\.0 ms are needed"):
        play_together(arms(robots), most_doubt=0.0)
    assert stand_still(robots, before)


def test_a_clock_that_is_known_better_a_moment_later_is_waited_for(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    poor = [0.2, 0.2]

    def offset(robot: RemoteRobot) -> tuple[float, float]:
        return 0.0, poor.pop() if poor else 0.001

    monkeypatch.setattr(RemoteRobot, "clock_offset", property(offset))
    assert play_together(arms(robots), dry_run=True).duration == 1.0
    assert not poor


def test_a_refusal_at_the_last_moment_cancels_the_others(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    follow, refuses = RemoteRobot.follow, robots["lab/arm2"]

    def refused(self: RemoteRobot, *args: Any, **options: Any) -> int:
        if self is refuses:
            raise HexwireError("not now")
        return follow(self, *args, **options)

    monkeypatch.setattr(RemoteRobot, "follow", refused)
    before = where(robots)
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: not now"):
        play_together(arms(robots))
    assert stand_still(robots, before)
    assert not any(robot.read().stopped for robot in robots.values())


def test_the_start_is_confirmed_when_all_are_ready_and_a_refusal_then_calls_it_off(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    refuses, ready = robots["lab/arm2"], list[bool]()
    plain = RemoteRobot.confirm

    def confirm(self: RemoteRobot, number: int) -> None:
        ready.append(bool(self.goal(number).ready))
        if self is refuses:
            raise HexwireError("not now")
        plain(self, number)

    monkeypatch.setattr(RemoteRobot, "confirm", confirm)
    before = where(robots)
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: not now"):
        play_together(arms(robots))
    assert ready == [True, True]
    time.sleep(0.5)
    assert stand_still(robots, before)
    assert not robots["lab/arm1"].read().stopped


def test_an_arm_whose_start_is_not_known_well_enough_is_refused(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = RemoteRobot.goal

    def goal(self: RemoteRobot, number: int) -> m.Goal:
        row = plain(self, number)
        row.doubt += 0.05
        return row

    monkeypatch.setattr(RemoteRobot, "goal", goal)
    with pytest.raises(
        FleetMotionError, match=r"lab/arm1: its start is known to 5.\.. ms only, and 40\.0 ms"
    ) as error:
        play_together(arms(robots), most_doubt=0.04)
    assert list(error.value.why) == ["lab/arm1"], "a server that keeps the time itself has another doubt"


def test_an_arm_that_does_not_answer_in_time_is_stopped_and_none_begins(
    robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    follow, hangs, over = RemoteRobot.follow, robots["lab/arm2"], threading.Event()

    def hanging(self: RemoteRobot, *args: Any, **options: Any) -> int:
        number = follow(self, *args, **options)
        if self is hangs:
            over.wait(30.0)
        return number

    monkeypatch.setattr(RemoteRobot, "follow", hanging)
    before = where(robots)
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: no answer in"):
        play_together(arms(robots))
    over.set()
    assert stand_still(robots, before)
    eventually(lambda: robots["lab/arm2"].read().stopped)
    assert not robots["lab/arm1"].read().stopped


def test_the_stop_of_one_arm_stops_all(robots: dict[str, RemoteRobot]) -> None:
    other = hexwire.connect("zenoh:lab/arm1")
    before = where(robots)

    def stop() -> None:
        eventually(lambda: abs(other.read().positions["J1"] - before[0]) > 0.1)
        other.stop()

    stopping = threading.Thread(target=stop)
    stopping.start()
    with pytest.raises(FleetMotionError, match=r"all arms are stopped: .*lab/arm1"):
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)))
    stopping.join()
    assert eventually(lambda: all(robot.read().stopped for robot in robots.values()))
    other.detach()


def test_an_arm_that_another_program_has_taken_is_left_to_it(robots: dict[str, RemoteRobot]) -> None:
    other, told = hexwire.connect("zenoh:lab/arm1"), list[str]()
    assert isinstance(other, RemoteRobot)
    before = where(robots)

    def take() -> None:
        eventually(lambda: abs(other.read().positions["J1"] - before[0]) > 0.1)
        other.take(force=True)

    taking = threading.Thread(target=take)
    taking.start()
    with pytest.raises(FleetMotionError, match=r"the arms that nobody else has taken are stopped: .*lab/arm1"):
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)), tell=told.append)
    taking.join()
    assert any(line.startswith("lab/arm1: not stopped, since ") for line in told), told
    assert eventually(lambda: robots["lab/arm2"].read().stopped)
    assert not other.read().stopped
    other.detach()


def test_an_interruption_stops_all(robots: dict[str, RemoteRobot]) -> None:
    before, shields = where(robots), []

    def shield() -> Any:
        shields.append(True)
        return threading.Lock()

    def interrupt() -> None:
        eventually(lambda: abs(where(robots)[0] - before[0]) > 0.1)
        _thread.interrupt_main()

    interrupting = threading.Thread(target=interrupt)
    interrupting.start()
    with pytest.raises(KeyboardInterrupt):
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)), shield=shield)
    interrupting.join()
    assert shields
    assert eventually(lambda: all(robot.read().stopped for robot in robots.values()))


def test_another_holder_is_named_and_can_be_preempted(robots: dict[str, RemoteRobot]) -> None:
    with hexwire.connect("zenoh:lab/arm2") as other:
        other.torque(True)
        with pytest.raises(FleetMotionError, match=r"no arm moved: lab/arm2: .* holds the lease"):
            play_together(arms(robots))
        # The lease of the first was given back.
        eventually(lambda: not robots["lab/arm1"].holder)
        with pytest.raises(FleetMotionError, match="holds the lease"):
            play_together(arms(robots), take=True, dry_run=True)
        play_together(arms(robots), take=True)


def test_arms_that_cannot_be_reached_are_named(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    urls = {name: f"zenoh:{name}" for name in (*NAMES, "lab/arm3")}
    with (
        pytest.raises(FleetMotionError, match=r"no arm lab/arm2 is served.*no arm lab/arm3 is served"),
        attached_to(urls),
    ):
        raise AssertionError


def test_the_report_says_how_far_apart_arms_began() -> None:
    rows = {"a": Played(0.10, 0.001, 0), "b": Played(0.13, 0.002, 0), "c": Played(math.nan, 0.005, 0)}
    report = Report(2.0, rows)
    assert report.skew == pytest.approx(0.03)
    assert report.doubt == pytest.approx(0.007)
    rows = {"a": Played(0.1, 0.001, 0, "", "board", 0.0002), "b": Played(0.1, 0.002, 0, "", "host", 0.05)}
    assert Report(2.0, rows).apart == pytest.approx(0.0532)
    rows = dict.fromkeys(("a", "b"), Played(0.1, 0.002, 0, "", "host", 0.05))
    assert Report(2.0, rows).apart == pytest.approx(0.054), "both are late, not one early"
    assert Report(2.0, {"a": rows["a"]}).apart == 0.0
    assert math.isnan(Report(2.0, {"a": rows["a"]}).skew)
