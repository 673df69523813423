from __future__ import annotations

import itertools

import pytest

from hexwire.control.motion.operator_control import Notes, OperatorController
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.motion.safety import StopReason


def test_it_moves_all_joints_latches_nothing_and_has_no_goals() -> None:
    controller = OperatorController(HEX7BOT, 0.05, lambda said: None)
    assert controller.joints == HEX7BOT.names
    controller.moving = True
    assert controller.busy
    controller.stop(StopReason("asked", "a test"))
    assert not controller.busy
    assert controller.reason is None
    assert controller.take_ended() == []


def test_a_cycle_counts_as_long_as_it_was_but_never_less_than_wanted() -> None:
    controller = OperatorController(HEX7BOT, 0.05, lambda said: None)
    assert [controller._period(now) for now in (10.0, 10.02, 10.5)] == pytest.approx([0.05, 0.05, 0.48])


def test_each_note_is_said_once_until_another_one_comes() -> None:
    said: list[object] = []
    controller = OperatorController(HEX7BOT, 0.05, said.append)
    for i, note in enumerate(("a", "a", "", "a", "b", "", "")):
        controller._period(0.6 * i)
        controller._say(note)
    assert said == ["a", "a", "b"]
    stops = [StopReason("asked", "one"), StopReason("asked", "one"), StopReason("board", "two")]
    for reason in (*stops, "", stops[0]):
        controller._say(reason)
    assert said[3:] == [stops[0], stops[2], stops[0]]


def test_a_note_whose_number_changes_or_that_comes_and_goes_is_not_new() -> None:
    notes = Notes()
    cycle = itertools.count()

    def new(note: str, after: float = 0.01) -> bool:
        return notes.is_new(note, 0.01 * next(cycle) + after)

    assert [new(f"the tool would be {d} mm below the table") for d in ("2.6", "12", "-3.25")] == [
        True,
        False,
        False,
    ]
    assert [new(text) for text in ("", "the tool would be 4.1 mm below the table")] == [False, False]
    assert [new(text) for text in ("J1=90 deg is too far", "J2=90 deg is too far", "")] == [True, True, False]
    assert new("J2=91 deg is too far", after=2.0)


def test_a_period_that_no_loop_keeps_is_refused() -> None:
    with pytest.raises(UsageError, match="is not possible"):
        OperatorController(HEX7BOT, 1e-9, lambda said: None)
