"""One warning when states stop arriving, and one when they arrive again."""

from __future__ import annotations

import pytest

from hexwire.fleet.clock import ClockOffset
from hexwire.fleet.remote import Silence
from hexwire.fleet.states import ArrivedStates

NEVER = ArrivedStates("zenoh:arm", ClockOffset()).arrived


def test_a_pause_is_reported_once_and_within_a_second(caplog: pytest.LogCaptureFixture) -> None:
    silence = Silence("zenoh:lab/arm1", 10.0)
    for i in range(60):
        # States come for 2 s.
        silence.look(10.0 + 0.1 * i, min(10.0 + 0.1 * i, 12.0))
        if i < 28:
            assert caplog.messages == []
        elif i >= 30:
            (said,) = caplog.messages
            assert said.startswith("zenoh:lab/arm1: its states have stopped arriving for 0.")
    silence.look(16.0, 15.95)
    assert caplog.messages[1:] == ["zenoh:lab/arm1: its states arrive again"]
    silence.look(16.1, 16.05)
    assert len(caplog.messages) == 2


def test_an_arm_that_never_sends_a_state_is_reported_too(caplog: pytest.LogCaptureFixture) -> None:
    silence = Silence("zenoh:arm", 10.0)
    for i in range(12):
        silence.look(10.0 + 0.1 * i, NEVER)
    (said,) = caplog.messages
    assert said.startswith("zenoh:arm: no state has arrived for 0.")


def test_a_program_that_was_halted_itself_tells_nothing(caplog: pytest.LogCaptureFixture) -> None:
    silence = Silence("zenoh:arm", 10.0)
    silence.look(10.1, 10.05)
    # Three seconds later it goes on; what has arrived meanwhile is taken next.
    silence.look(13.1, 10.05)
    silence.look(13.2, 13.15)
    assert caplog.messages == []
