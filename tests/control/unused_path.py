"""A path of a robot for tests that use some of its methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hexwire.drivers.timed_path import PathReport, PathStart, PathState, TimedPath, TimedPoint


class UnusedPath(TimedPath):
    """Nothing of it may be called; override what a test uses."""

    def send(
        self,
        points: Sequence[TimedPoint],
        *,
        last: bool = False,
        first: int | None = None,
        rest: Callable[[TimedPoint], Sequence[TimedPoint]] | None = None,
    ) -> int:
        raise AssertionError

    def start(self, at: float | None = None) -> PathStart:
        raise AssertionError

    def report(self) -> PathReport:
        raise AssertionError

    def abort(self) -> PathState:
        raise AssertionError
