"""Simulated time does not end a wait in real time: a busy machine simulates slowly."""

from __future__ import annotations

import pytest

from hexwire.control.motion.motion_run import MotionRun


class _PatientRun(MotionRun):
    def wait(self, timeout: float) -> None:
        # Less is a test of what becomes of a request that nobody serves.
        super().wait(600.0 if timeout >= 1.0 else timeout)


@pytest.fixture(autouse=True)
def _an_owner_that_is_slow_has_not_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The controllers judge the arrival, in simulated time; the limit of a request in real time is for none."""
    monkeypatch.setattr("hexwire.control.requests.controlled_arm.MotionRun", _PatientRun)
