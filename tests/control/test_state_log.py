"""The joint positions in a node's log."""

from __future__ import annotations

import logging
import math

import pytest
from tests.control.arm_bench import make_bench
from tests.model.states import make_state

from hexwire.control.loop.known_state import KnownState
from hexwire.control.requests.controlled_arm import logging_states
from hexwire.model.state import JointState

LINE = "arm:: HW read (degree):\nJ1=-4.47257 J2=54.6484"


def test_the_chapters_line_once_a_second(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "hexwire")
    seen: list[JointState] = []
    note = logging_states(lambda state, published: seen.append(state), "arm")
    angles = [math.radians(-4.47257), math.radians(54.6484)]
    states = [make_state(*angles, stamp=stamp) for stamp in (5.0, 5.5, 5.99, 6.0, 9.0)]
    for state in states:
        note(state, KnownState(state.names, state.position, (0.0, 0.0), 0.0))
    assert seen == states
    assert caplog.messages == [LINE] * 3


@pytest.mark.parametrize("wanted", [False, True])
def test_an_arm_logs_if_asked(caplog: pytest.LogCaptureFixture, wanted: bool) -> None:
    caplog.set_level(logging.INFO, "hexwire")
    bench = make_bench(log_positions=wanted)
    bench.turn(0.3)
    lines = [text for text in caplog.messages if "HW read" in text]
    assert len(lines) == wanted
    assert all("J1=-4.47257 J2=54.6484 J3=" in line for line in lines)
