"""When a path of a robot starts, and the correction of that."""

from __future__ import annotations

import pytest
from tests.control.unused_path import UnusedPath

from hexwire.control.motion.board_path_feeder import StartOrder, first_start
from hexwire.drivers.timed_path import PathStart
from hexwire.errors import CommandRefusedError, StoppedError
from hexwire.motion.trajectory import Spline, Waypoint


class Path(UnusedPath):
    """Starts as late as it is told to."""

    def __init__(self) -> None:
        self.asked: list[float | None] = []
        self.late = 0.0
        self.error: Exception | None = None

    def start(self, at: float | None = None) -> PathStart:
        if self.error is not None:
            raise self.error
        self.asked.append(at)
        return PathStart((10.0 if at is None else at) + self.late, 0.001)


def test_a_start_is_ordered_for_its_time_or_at_once() -> None:
    path, start = Path(), StartOrder(lambda: 9.0)
    assert start.given is None
    path.late = 0.25
    assert start.give(path, 12.0) == 0.25
    assert start.given == (12.25, 0.001)
    start.give(path, 9.004)
    start.give(path, 8.0)
    assert path.asked == [12.0, None, None]


class Slow(Path):
    """Each order takes its time to the robot, which refuses a start that has passed by then."""

    def __init__(self, now: list[float], *delays: float) -> None:
        super().__init__()
        self.now, self.delays = now, list(delays)

    def start(self, at: float | None = None) -> PathStart:
        self.now[0] += self.delays.pop(0)
        self.asked.append(at)
        if at is not None and at < self.now[0]:
            raise CommandRefusedError("a start", 2, "bad_range")
        return PathStart(self.now[0] if at is None else at, 0.001)


def test_a_start_whose_time_has_passed_is_tried_again_later(caplog: pytest.LogCaptureFixture) -> None:
    for delays, asked in (
        ((0.6, 0.01), [9.5, 9.7]),
        ((0.6, 0.15, 0.1), [9.5, 9.7, 9.95]),
        ((0.6, 0.15, 0.25, 0.01), [9.5, 9.7, 9.95, 10.4]),
    ):
        now = [9.0]
        path, start = Slow(now, *delays), StartOrder(lambda now=now: now[0])
        caplog.clear()
        assert start.give(path, 9.5) == pytest.approx(asked[-1] - 9.5)
        assert path.asked == pytest.approx(asked)
        assert [row.levelname for row in caplog.records] == ["WARNING"] * (len(asked) - 1)
        # The correction is of the start that was given.
        now[0], path.delays = asked[-1] - 0.2, [0.0]
        start.correct(path)
        assert path.asked[-1] == pytest.approx(asked[-1])


def test_a_start_is_tried_a_few_times_only_and_another_refusal_not_at_all(caplog: pytest.LogCaptureFixture) -> None:
    now = [9.0]
    path, start = Slow(now, *[0.5] * 9), StartOrder(lambda: now[0])
    with pytest.raises(CommandRefusedError):
        start.give(path, 9.4)
    assert len(path.asked) == 4
    for error in (CommandRefusedError("a start", 2, "a joint is elsewhere"), StoppedError("a start", 3, "stopped")):
        path.error = None
        other = Path()
        other.error = error
        for begins in (12.0, 9.0, 8.0):
            caplog.clear()
            with pytest.raises(type(error)):
                StartOrder(lambda: 9.0).give(other, begins)
            assert not caplog.records, "it did not come too late"


def test_a_start_that_has_passed_on_the_robots_clock_alone_is_tried_again() -> None:
    class Ahead(Slow):
        """Its clock is ahead of what is known of it."""

        def start(self, at: float | None = None) -> PathStart:
            return super().start(None if at is None else at - 0.012) if len(self.delays) > 1 else super().start(at)

    now = [9.0]
    path = Ahead(now, 0.39, 0.01)
    assert StartOrder(lambda: now[0]).give(path, 9.4) == pytest.approx(0.09)


def test_it_is_corrected_while_there_is_time_for_that() -> None:
    now = [9.0]
    path, start = Path(), StartOrder(lambda: now[0])
    assert start.correct(path) == 0.0
    path.late = 0.003
    start.give(path, 12.0)
    path.late = 0.001
    now[0] = 11.9
    assert start.correct(path) == pytest.approx(-0.002)
    assert start.given == (12.001, 0.001)
    now[0] = 11.96
    assert start.correct(path) == 0.0
    assert path.asked == [12.0, 12.0]


def test_a_correction_that_comes_too_late_changes_nothing_and_a_stop_is_told() -> None:
    path, start = Path(), StartOrder(lambda: 9.0)
    start.give(path, 12.0)
    path.error = CommandRefusedError("a start", 1, "it has passed")
    assert start.correct(path) == 0.0
    assert start.given == (12.0, 0.001)
    path.error = StoppedError("a start", 2, "stopped")
    with pytest.raises(StoppedError):
        start.correct(path)


def test_the_first_start_is_that_of_the_motion_that_is_not_over() -> None:
    path = Spline(("J1",), [Waypoint(0.0, (0.0,)), Waypoint(2.0, (1.0,))])
    assert first_start([(path, 5.0)]) == 5.0
    assert first_start([(path, 1.0), (path, 5.0)]) == 5.0
    assert first_start([(path, 4.0), (path, 5.0)]) == 4.0
    brake = Spline(("J1",), [Waypoint(0.0, (0.5,)), Waypoint(0.3, (0.6,))])
    assert first_start([(path, 4.0), (brake, 4.9), (path, 5.0)]) == 4.0
    # What was braked is over with its brake.
    assert first_start([(path, 4.0), (brake, 4.5), (path, 5.0)]) == 5.0
