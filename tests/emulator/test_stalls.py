"""Stalls of a program, with a clock that tests set forward."""

from __future__ import annotations

import gc
import threading
from types import SimpleNamespace

import pytest
from tests.waits import eventually

from hexwire.emulator import stalls
from hexwire.emulator.stalls import Stalls

PATIENCE = 30.0


class User:
    pass


class Clock:
    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        patch.setattr(stalls, "time", SimpleNamespace(monotonic=lambda: self.now))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def looking() -> bool:
    return any(thread.name == "hexwire-stalls" for thread in threading.enumerate())


def test_time_that_passes_while_somebody_looks_is_no_stall(clock: Clock) -> None:
    found, user = Stalls(), User()
    found.open(user)
    for _ in range(100):
        clock.now += 0.1
        assert found.seconds(0.0) == 0.0
    found.close(user)


def test_time_without_a_look_is_one_from_when_the_look_was_due(clock: Clock) -> None:
    found, user = Stalls(), User()
    found.open(user)
    clock.now += 0.85
    assert found.seconds(0.0) == pytest.approx(0.8)
    assert found.seconds(100.45) == pytest.approx(0.4), "only what came after that counts"
    clock.now += 0.1
    assert found.seconds(0.0) == pytest.approx(0.8)
    clock.now += 0.55
    assert found.seconds(0.0) == pytest.approx(1.3)
    assert found.seconds(clock.now) == 0.0
    found.close(user)


def test_nobody_looks_for_nobody(clock: Clock) -> None:
    found, one, two = Stalls(), User(), User()
    for _ in range(3):
        found.open(one)
        found.open(two)
        found.close(one)
        assert looking()
        found.close(two)
        found.close(two)
        eventually(lambda: not looking())
        clock.now += 5.0
        assert found.seconds(0.0) == 0.0


def test_an_arm_that_nobody_has_any_more_needs_no_looks(clock: Clock) -> None:
    found, user = Stalls(), User()
    found.open(user)
    assert looking()
    del user
    gc.collect()
    eventually(lambda: not looking())
    assert found.seconds(0.0) == 0.0
