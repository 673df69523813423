"""Held motions: silence ends them, each one ends once, and nothing old comes back."""

from __future__ import annotations

from hexwire.control.motion.hold_to_run import SILENCE, HoldToRun, silence_for


class _Clock:
    time = 100.0

    def __call__(self) -> float:
        return self.time


def _held() -> tuple[HoldToRun, _Clock, list[str]]:
    clock, ended = _Clock(), list[str]()
    return HoldToRun(clock=clock, on_end=lambda entry: ended.append(entry.ended)), clock, ended


def test_a_motion_lasts_while_beats_arrive() -> None:
    held, clock, ended = _held()
    entry = held.begin("ann", 1)
    assert entry is not None
    for _ in range(20):
        clock.time += 0.1
        assert held.beat("ann", 1)
        held.check()
    assert not entry.ended
    assert not ended


def test_silence_ends_it_once() -> None:
    held, clock, ended = _held()
    finished: list[str] = []
    entry = held.begin("ann", 1)
    assert entry is not None
    held.begun(entry, finished.append)
    clock.time += SILENCE
    held.check()
    held.check()
    held.end("ann", "released")
    assert finished == ended == ["whoever held it is heard no more"]


def test_a_late_beat_does_not_revive_a_motion() -> None:
    held, clock, ended = _held()
    held.begin("ann", 1)
    clock.time += SILENCE + 0.01
    assert not held.beat("ann", 1)
    assert not held.beat("ann", 1)
    assert ended == ["whoever held it is heard no more"]


def test_a_motion_that_ended_while_it_was_checked_is_finished_when_it_begins() -> None:
    held, _, _ = _held()
    entry = held.begin("ann", 1)
    assert entry is not None
    held.end("ann", "released", 1)
    finished: list[str] = []
    held.begun(entry, finished.append)
    assert finished == ["released"]


def test_a_beat_in_flight_over_a_stop_does_nothing() -> None:
    held, _, _ = _held()
    held.begin("ann", 1)
    held.end_all("stopped")
    assert not held.beat("ann", 1)
    assert held.entry is None


def test_a_release_that_overtakes_its_beginning_voids_it() -> None:
    held, _, _ = _held()
    held.end("ann", "released", 7)
    assert held.begin("ann", 7) is None
    assert held.begin("ann", 8) is not None


def test_another_motion_ends_the_one_before() -> None:
    held, _, ended = _held()
    first = held.begin("ann", 1)
    assert held.begin("bob", 1) is not None
    assert first is not None
    assert ended == ["another motion was begun"]
    assert not held.beat("ann", 1)


def test_a_slow_line_needs_less_silence() -> None:
    assert silence_for(0.1) == SILENCE
    assert silence_for(1.0) == 0.15
    assert silence_for(1.0, 0.1) == 0.1
    assert silence_for(0.1, 5.0) == 5.0
