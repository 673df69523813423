from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from tests.studio.running import until

from hexwire.control.requests.settings_reader import read_settings
from hexwire.errors import GoalError, UsageError
from hexwire.motion.teach import Taught
from hexwire.studio.twin import Twin


@pytest.fixture
def twin() -> Iterator[Twin]:
    made = Twin()
    try:
        yield made
    finally:
        made.stop("the test is over")


def _swing(joints: tuple[str, ...], goal: float = 0.2, seconds: float = 0.6) -> Taught:
    name = joints[0]
    return Taught.of((name,), [(seconds * i / 10, (goal * i / 10,)) for i in range(11)])


def test_the_emulated_arm_does_the_motion_and_is_gone(twin: Twin) -> None:
    assert twin.state.robot == ""
    twin.play("hex7bot", "a swing", _swing)
    until(lambda: not twin.busy, "the end")
    state = twin.state
    assert (state.arrived, state.ended, state.running) == (True, "arrived", False)
    assert state.duration >= 0.6
    history = twin.history
    assert history is not None
    last = list(history.rows())[-1][1]
    assert last[0] == pytest.approx(0.2, abs=0.03)


def test_a_program_that_stalls_is_not_taken_for_one_that_has_died(
    twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings: list[Any] = []

    def read(values: Any, faults: Any) -> Any:
        found = read_settings(values, faults)
        settings.append(found[0])
        return found

    monkeypatch.setattr("hexwire.studio.twin.read_settings", read)
    twin.play("hex7bot", "a slow swing", lambda joints: _swing(joints, seconds=30.0))
    twin.stop("stopped")
    assert [each.watchdog for each in settings] == [5.0]


def test_it_can_be_stopped_on_the_way(twin: Twin) -> None:
    twin.play("so101", "a slow swing", lambda joints: _swing(joints, seconds=30.0))
    assert twin.state.running
    with pytest.raises(UsageError, match="the twin is moving; stop it first"):
        twin.play("hex7bot", "another", _swing)
    twin.stop("stopped")
    assert not twin.busy
    assert (twin.state.arrived, twin.state.ended) == (False, "stopped")


def test_what_the_real_arm_would_refuse_is_refused(twin: Twin) -> None:
    with pytest.raises(GoalError, match="J1"):
        twin.play("hex7bot", "too far", lambda joints: _swing(joints, goal=9.0))
    assert not twin.busy
    with pytest.raises(UsageError, match="no emulated puma260"):
        twin.play("puma260", "x", _swing)


def test_the_table_is_that_of_the_real_arm(twin: Twin) -> None:
    def lower(joints: tuple[str, ...]) -> Taught:
        return Taught.of(("J2",), [(0.1 * i, (1.0 + 0.12 * i,)) for i in range(11)])

    with pytest.raises(GoalError, match="below the table at 150 mm"):
        twin.play("hex7bot", "over a high table", lower, settings={"table_height": 0.15})
    twin.play("hex7bot", "over a low one", lower, settings={"table_height": 0.0})
