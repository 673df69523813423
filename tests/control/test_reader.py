from __future__ import annotations

import math
from dataclasses import replace

import pytest
from tests.drivers.arms import Arm

from hexwire.control.loop.reader import StateReader, read_known, read_state
from hexwire.errors import DeviceError, LinkError, PreemptedError, ReplyTimeoutError
from hexwire.model.state import JointFlag, JointState
from hexwire.session.policy import ReconnectPolicy


def make(rate: float = 100.0, **options: object) -> tuple[Arm, StateReader]:
    arm = Arm(reconnect=ReconnectPolicy(enabled=False), **options)  # type: ignore[arg-type]  # as the bench takes them
    return arm, StateReader(arm.driver, rate, clock=arm.clock, sleep=arm.clock.sleep)


def read(reader: StateReader, count: int) -> list[JointState]:
    states = [reader.next() for _ in range(count)]
    found = [state for state in states if state is not None]
    assert len(found) == count
    return found


def reports(arm: Arm) -> bool:
    return arm.board.state.report_due is not None


@pytest.mark.parametrize(("dialect", "exact"), [(2, True), (1, False)])
def test_states_at_a_rate_by_reports_or_by_asking(dialect: int, exact: bool) -> None:
    arm, reader = make(50.0, dialect=dialect)
    begun = arm.clock.time
    states = read(reader, 101)
    assert arm.clock.time - begun == pytest.approx(2.0, abs=0.03)
    assert reports(arm) is exact
    stamps = [state.stamp for state in states]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize(("rate", "period"), [(1000.0, 0.005), (100.0, 0.01), (0.5, 0.25)])
def test_a_rate_that_no_board_takes_is_one_that_it_takes(rate: float, period: float) -> None:
    arm, reader = make(rate)
    assert reader.period == period
    begun = arm.clock.time
    read(reader, 11)
    assert arm.clock.time - begun == pytest.approx(11 * period, rel=0.2)


def test_the_end_of_reading_ends_the_reports() -> None:
    arm, reader = make()
    reader.close()
    read(reader, 3)
    assert reports(arm)
    reader.close()
    reader.close()
    assert not reports(arm)
    read(reader, 3)
    assert reports(arm)


def test_reports_that_end_are_one_none_and_begin_again() -> None:
    arm, reader = make()
    read(reader, 3)
    arm.board.state.report_due = None
    found = [reader.next() for _ in range(2)]
    assert [state is None for state in found] == [False, True]
    read(reader, 3)


def test_a_failed_read_is_reported_and_reading_continues() -> None:
    arm, reader = make()
    read(reader, 3)
    arm.link.lost = True
    for _ in range(2):
        with pytest.raises(LinkError):
            reader.next()
    arm.link.lost = False
    reader.close()
    arm.driver.attach()
    read(reader, 3)


def test_a_reader_is_closed_whatever_the_line_says() -> None:
    arm, reader = make()
    read(reader, 3)
    arm.link.lost = True
    reader.close()
    assert not arm.link.is_open


def test_silence_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, reader = make()
    read(reader, 3)
    monkeypatch.setattr(arm.board.faults, "host_out", lambda data, now: b"")
    with pytest.raises(ReplyTimeoutError):
        reader.next()


def test_preempted_between_two_states(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, reader = make(dialect=1)

    def preempted() -> JointState:
        raise PreemptedError("a stop took the line")

    read(reader, 2)
    with monkeypatch.context() as patch:
        patch.setattr(arm.driver, "read", preempted)
        with pytest.raises(PreemptedError):
            reader.next()
    read(reader, 2)


def test_reports_that_wait_are_dropped() -> None:
    arm, reader = make(baud=115200)
    read(reader, 3)
    arm.driver.torque(True)
    # Reports from before it came in while it was answered.
    for _ in range(5):
        arm.driver.read()
    now = arm.driver.read().board_time
    reader.drop_waiting()
    assert read(reader, 1)[0].board_time >= now


def test_without_reports_nothing_is_dropped() -> None:
    arm, reader = make(dialect=1)
    reader.drop_waiting()
    read(reader, 2)
    written = len(arm.link.written)
    reader.drop_waiting()
    assert len(arm.link.written) == written


def test_restarts_of_the_board() -> None:
    arm, reader = make()
    read(reader, 3)
    assert arm.driver.restarts == 0
    arm.board.reset(arm.clock.time)
    read(reader, 3)
    assert arm.driver.restarts == 1


@pytest.mark.parametrize("places", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 3, 4, 5, 6), ()])
def test_a_state_without_a_joint_or_in_another_order_is_an_error(places: tuple[int, ...]) -> None:
    arm = Arm()
    whole = read_state(arm.driver)
    tuples = {name: value for name in JointState.__slots__ if isinstance(value := getattr(whole, name), tuple)}
    part = replace(whole, **{name: tuple(value[i] for i in places) for name, value in tuples.items()})
    arm.driver.read = lambda: part  # type: ignore[method-assign]  # a driver that loses a joint
    with pytest.raises(DeviceError, match=r"^the robot reports the joints .*; correct its driver$"):
        read_state(arm.driver)


class Missed:
    """A driver's `read` that misses the first answers of a joint; counts its calls."""

    def __init__(self, arm: Arm, joint: str, misses: float) -> None:
        self.read, self.at, self.misses, self.calls = (
            arm.driver.read,
            arm.driver.model.names.index(joint),
            misses,
            0,
        )
        arm.driver.read = self  # type: ignore[method-assign]  # it misses answers

    def __call__(self) -> JointState:
        state, self.calls = self.read(), self.calls + 1
        if self.calls > self.misses:
            return state
        flags, position = list(state.flags), list(state.position)
        flags[self.at], position[self.at] = JointFlag.SILENT, math.nan
        return replace(state, flags=tuple(flags), position=tuple(position))


@pytest.mark.parametrize("dialect", [1, 2])
@pytest.mark.parametrize("misses", [0, 1, 3])
def test_a_joint_that_misses_some_answers_is_known(dialect: int, misses: int) -> None:
    arm = Arm(dialect=dialect)
    missed = Missed(arm, "J3", misses)
    state = read_known(arm.driver, sleep=arm.clock.sleep)
    assert (state.silent, missed.calls) == ((), misses + 1)
    assert all(map(math.isfinite, state.position))


@pytest.mark.parametrize(("dialect", "longest"), [(1, 1.5), (2, 0.75)])
def test_a_joint_that_never_answers_is_unknown_soon(dialect: int, longest: float) -> None:
    arm = Arm(dialect=dialect)
    missed, begun = Missed(arm, "J3", math.inf), arm.clock.time
    assert read_known(arm.driver, sleep=arm.clock.sleep).silent == ("J3",)
    assert missed.calls >= 4
    # A board asks a silent servo again every half second.
    assert 0.5 < arm.clock.time - begun < longest


def test_only_the_joints_that_are_needed_are_waited_for() -> None:
    arm = Arm()
    missed = Missed(arm, "J3", math.inf)
    assert read_known(arm.driver, ["J1", "J2"], sleep=arm.clock.sleep).silent == ("J3",)
    assert missed.calls == 1


def test_a_clock_that_stands_still_does_not_keep_it_asking() -> None:
    arm = Arm()
    missed = Missed(arm, "J3", math.inf)
    arm.driver.now = lambda: 0.0  # type: ignore[method-assign]
    read_known(arm.driver, sleep=lambda seconds: None)
    assert missed.calls <= 30
