"""Motions of several arms with their servers: a common start, all or none, and one failure stops all."""

from __future__ import annotations

import _thread
import math
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from tests.waits import eventually

from hexwire.drivers import registry
from hexwire.fleet import player
from hexwire.fleet.player import FleetMotionError, Played, PlayedArm, PlayReport, attached_to, play_together
from hexwire.fleet.remote import RemoteRobot
from hexwire.motion.trajectory import Spline, Waypoint

from .conftest import Serve

NAMES = ("lab/arm1", "lab/arm2")
STILL = 0.006
"""Radians: three counts and a bit."""
DOUBT = 0.25
"""Seconds: on a busy machine clocks are known no better."""


def way(by: float = 0.2, seconds: float = 1.0, joint: str = "J1") -> Spline:
    """There and back."""
    points = [(0.0, 0.0), (0.5 * seconds, by), (seconds, 0.0)]
    return Spline((joint,), [Waypoint(t, (angle,), (0.0,)) for t, angle in points])


@pytest.fixture
def robots(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, RemoteRobot]]:
    # Longer times than usual, so that a busy machine is not taken for a player that died.
    monkeypatch.setattr(player, "_WATCHDOG", 5.0)
    monkeypatch.setattr(player, "_LEAD", 2.0)
    for name in NAMES:
        # The board of the first executes it, the server of the second sends the targets.
        serve(name, lease=3.0, robot="sim", host_timed=name == NAMES[1])
    with attached_to({name: f"zenoh:{name}" for name in NAMES}) as attached:
        yield attached


def arms(robots: dict[str, RemoteRobot], **paths: Spline) -> list[PlayedArm]:
    return [PlayedArm(robot, paths.get(name[-4:], way())) for name, robot in robots.items()]


def where(robots: dict[str, RemoteRobot]) -> list[float]:
    return [robot.read().positions["J1"] for robot in robots.values()]


def stand_still(robots: dict[str, RemoteRobot], before: list[float]) -> bool:
    return all(abs(a - b) < STILL for a, b in zip(where(robots), before, strict=True))


def test_arms_begin_together_and_arrive(robots: dict[str, RemoteRobot]) -> None:
    told: list[str] = []
    report = play_together(arms(robots), tell=told.append, most_doubt=DOUBT)
    assert [line.partition(" ")[0] for line in told[2:]] == ["approach:", "motion:", "lab/arm2:"]
    assert sorted(line.partition(":")[0] for line in told[:2]) == list(NAMES)
    assert told[-1] == "lab/arm2: its server sends the targets: it may begin 50 ms late"
    assert {name: row.kept_by for name, row in report.arms.items()} == {"lab/arm1": "board", "lab/arm2": "host"}
    one, two = (report.arms[name] for name in NAMES)
    assert one.doubt + one.late <= DOUBT
    assert two.late == 0.05
    assert report.apart == pytest.approx(one.doubt + one.late + two.doubt + two.late)
    assert report.duration == 1.0
    assert sorted(report.arms) == list(NAMES)
    # How far apart is tested in simulated time, in tests/control/test_shared_goals.py.
    # To the last exchange the clock may become known better.
    assert all(row.moved > -DOUBT for row in report.arms.values())
    assert report.skew >= 0.0
    assert 0.0 < report.doubt <= 2 * DOUBT
    assert not any(robot.read().stopped for robot in robots.values())
    # The leases were given back.
    eventually(lambda: not any(robot.holder for robot in robots.values()))


def test_a_dry_run_checks_and_moves_nothing(robots: dict[str, RemoteRobot]) -> None:
    before = where(robots)
    report = play_together(arms(robots), dry_run=True, most_doubt=DOUBT)
    assert (report.duration, report.arms) == (1.0, {})
    assert math.isnan(report.skew)
    assert stand_still(robots, before)
    assert not any(robot.read().torque_on for robot in robots.values())
    with pytest.raises(FleetMotionError, match=r"no arm moved: lab/arm2: .*J1 would turn at"):
        play_together(arms(robots, arm2=way(1.0, 0.1)), dry_run=True, most_doubt=DOUBT)


def test_if_one_refuses_none_begins(robots: dict[str, RemoteRobot], monkeypatch: pytest.MonkeyPatch) -> None:
    before = where(robots)
    with pytest.raises(FleetMotionError, match=r"lab/arm2: .*J1 would turn at"):
        play_together(arms(robots, arm2=way(1.0, 0.1)), most_doubt=DOUBT)
    with pytest.raises(FleetMotionError, match="lab/arm1: it has no X1, but J1"):
        play_together(arms(robots, arm1=way(joint="X1")), most_doubt=DOUBT)
    robots["lab/arm2"].stop()
    with pytest.raises(FleetMotionError, match="lab/arm2: it is stopped"):
        play_together(arms(robots), most_doubt=DOUBT)
    robots["lab/arm2"].resume()
    monkeypatch.setattr(player, "_CLOCKS", 0.1)
    with pytest.raises(FleetMotionError, match=r"lab/arm[12]: its clock is known to .* and 0\.0 ms are needed"):
        play_together(arms(robots), most_doubt=0.0)
    assert stand_still(robots, before)


@pytest.mark.slow
def test_the_stop_of_one_arm_stops_all(robots: dict[str, RemoteRobot]) -> None:
    other = registry.connect("zenoh:lab/arm1")
    before = where(robots)

    def stop() -> None:
        eventually(lambda: abs(other.read().positions["J1"] - before[0]) > 0.1)
        other.stop()

    stopping = threading.Thread(target=stop)
    stopping.start()
    with pytest.raises(FleetMotionError, match=r"all arms are stopped: .*lab/arm1"):
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)), most_doubt=DOUBT)
    stopping.join()
    assert eventually(lambda: all(robot.read().stopped for robot in robots.values()))
    other.detach()


@pytest.mark.slow
def test_an_arm_that_another_program_has_taken_is_left_to_it(robots: dict[str, RemoteRobot]) -> None:
    other, told = registry.connect("zenoh:lab/arm1"), list[str]()
    assert isinstance(other, RemoteRobot)
    before = where(robots)

    def take() -> None:
        eventually(lambda: abs(other.read().positions["J1"] - before[0]) > 0.1)
        other.take(force=True)

    taking = threading.Thread(target=take)
    taking.start()
    with pytest.raises(FleetMotionError, match=r"the arms that nobody else has taken are stopped: .*lab/arm1"):
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)), tell=told.append, most_doubt=DOUBT)
    taking.join()
    assert any(line.startswith("lab/arm1: not stopped, since ") for line in told), told
    assert eventually(lambda: robots["lab/arm2"].read().stopped)
    assert not other.read().stopped
    other.detach()


@pytest.mark.slow
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
        play_together(arms(robots, arm1=way(0.4, 6.0), arm2=way(0.4, 6.0)), shield=shield, most_doubt=DOUBT)
    interrupting.join()
    assert shields
    assert eventually(lambda: all(robot.read().stopped for robot in robots.values()))


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
    report = PlayReport(2.0, rows)
    assert report.skew == pytest.approx(0.03)
    assert report.doubt == pytest.approx(0.007)
    rows = {"a": Played(0.1, 0.001, 0, "", "board", 0.0002), "b": Played(0.1, 0.002, 0, "", "host", 0.05)}
    assert PlayReport(2.0, rows).apart == pytest.approx(0.0532)
    rows = dict.fromkeys(("a", "b"), Played(0.1, 0.002, 0, "", "host", 0.05))
    assert PlayReport(2.0, rows).apart == pytest.approx(0.054), "both are late, not one early"
    assert PlayReport(2.0, {"a": rows["a"]}).apart == 0.0
    assert math.isnan(PlayReport(2.0, {"a": rows["a"]}).skew)
