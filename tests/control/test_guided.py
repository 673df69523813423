from __future__ import annotations

import pytest

from hexwire.control.guided import GuidedController
from hexwire.errors import UsageError
from hexwire.model.hex7bot import HEX7BOT
from hexwire.motion.safety import StopReason


def test_it_moves_all_joints_latches_nothing_and_has_no_goals() -> None:
    controller = GuidedController(HEX7BOT, 0.05, lambda said: None)
    assert controller.joints == HEX7BOT.names
    controller.moving = True
    assert controller.busy
    controller.stop(StopReason("asked", "a test"))
    assert not controller.busy
    assert controller.reason is None
    assert controller.take_ended() == []


def test_a_cycle_counts_as_long_as_it_was_but_never_less_than_wanted() -> None:
    controller = GuidedController(HEX7BOT, 0.05, lambda said: None)
    assert [controller._period(now) for now in (10.0, 10.02, 10.5)] == pytest.approx([0.05, 0.05, 0.48])


def test_each_note_is_said_once_until_another_one_comes() -> None:
    said: list[object] = []
    controller = GuidedController(HEX7BOT, 0.05, said.append)
    for note in ("a", "a", "", "a", "b", ""):
        controller._say(note)
    assert said == ["a", "a", "b"]


def test_a_period_that_no_loop_keeps_is_refused() -> None:
    with pytest.raises(UsageError, match="is not possible"):
        GuidedController(HEX7BOT, 1e-9, lambda said: None)
