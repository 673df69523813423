"""The values of a path, and its interface."""

from __future__ import annotations

import pytest

from hexwire.drivers.timed_path import TimedPath, TimedPoint


def test_a_point_is_straight_unless_it_has_velocities() -> None:
    assert TimedPoint(0.0, (1.0,)).velocities is None
    assert TimedPoint(0.5, (1.0,), (0.1,)) == (0.5, (1.0,), (0.1,))


def test_the_interface_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="abstract"):
        TimedPath()  # type: ignore[abstract]  # that is the point
