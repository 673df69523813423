"""What follows from having sessions, at a driver with two of them."""

from __future__ import annotations

from tests.drivers.arms import Arm

from hexwire.drivers.puma260 import Puma260Driver
from hexwire.ipc.session import Session
from hexwire.session.policy import ReconnectPolicy


def two() -> Puma260Driver:
    session, other = (Session.from_url(f"udp://127.0.0.1:{port}") for port in (15040, 15041))
    return Puma260Driver(session, commands=other, states=other)


def test_address_and_clock_are_those_of_the_session() -> None:
    arm = Arm(2)
    robot = arm.driver
    assert robot.url == arm.link.url
    assert robot.now() == arm.clock.time
    assert robot.epochs is robot.session.epochs
    assert robot.is_attached
    robot.detach()
    assert not robot.is_attached


def test_round_trips_are_measured() -> None:
    robot = Arm(2, baud=115200).driver
    before = len(robot.round_trips)
    robot.read()
    assert len(robot.round_trips) == before + 1
    assert 0.005 < robot.round_trips[-1] < 0.1


def test_each_session_counts_once() -> None:
    robot = two()
    assert robot.sessions == (robot.session, robot.commands)
    robot.session.board_restarts, robot.commands.board_restarts = 1, 2
    assert robot.restarts == 3


def test_a_stop_voids_what_waits_at_any_session() -> None:
    robot = two()
    assert robot.commands.epochs is robot.session.epochs is robot.epochs


def test_reconnection_is_switched_and_its_times_stay() -> None:
    robot = two()
    robot.session.reconnect = ReconnectPolicy(give_up_after=3.0)
    robot.auto_reconnect(False)
    assert robot.session.reconnect == ReconnectPolicy(enabled=False, give_up_after=3.0)
    assert not robot.commands.reconnect.enabled
    robot.auto_reconnect(True)
    assert all(session.reconnect.enabled for session in robot.sessions)


def test_reports_that_wait_are_forgotten() -> None:
    arm = Arm(2)
    states = arm.driver.stream(0.02)
    next(states)
    arm.wait(0.1)
    arm.driver.read()
    arm.driver.discard_reports()
    assert arm.driver.session.poll_reports() is None


def test_abort_closes_every_session_and_sends_nothing() -> None:
    arm = Arm(2)
    said = len(arm.link.written)
    arm.driver.abort()
    assert not arm.driver.is_attached
    assert len(arm.link.written) == said
