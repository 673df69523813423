from __future__ import annotations

import json
import math
import threading
from types import SimpleNamespace
from typing import Any

import pytest
from tests.studio.running import until
from tests.studio.servos.conftest import servo_of

from hexwire.errors import UsageError
from hexwire.motion.waves import Wave
from hexwire.setup.servo_wave import WaveEnd, WaveSample
from hexwire.studio.servos.wave_run import add_wave, figures_of, read_wave

GOOD = {"servo": 3, "shape": "sine", "amplitude": 10, "period": 2, "seconds": 6.5, "last_period": 0.25}


def test_a_wave_is_read_in_degrees() -> None:
    servo_id, wave = read_wave(GOOD)
    assert servo_id == 3
    assert (wave.shape, wave.period, wave.seconds) == ("sine", 2.0, 6.5)
    assert wave.amplitude == pytest.approx(math.radians(10))
    assert read_wave({**GOOD, "last_period": None})[0] == 3, "only a sweep has one"
    assert read_wave({**GOOD, "shape": "sweep", "last_period": 0.5})[1].last_period == 0.5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("servo", "3"),
        ("servo", None),
        ("servo", True),
        ("shape", "square"),
        ("shape", 3),
        ("amplitude", 46),
        ("amplitude", "10"),
        ("amplitude", None),
        ("amplitude", math.nan),
        ("amplitude", True),
        ("period", 0.1),
        ("seconds", 1e9),
        ("seconds", math.inf),
    ],
)
def test_every_value_is_checked(name: str, value: object) -> None:
    with pytest.raises(UsageError):
        read_wave({**GOOD, name: value})


def test_the_figures_of_steps_are_json_and_leave_the_way_back_out() -> None:
    wave = Wave("step", 0.2, 2.0, 2.0)
    end = WaveEnd(complete=True)
    for i in range(1, 130):
        t = i / 50
        goal = wave.angle(t - 0.01) if t <= 2.0 else -0.2 + 0.4 * (t - 2.0)
        since = t if t <= 1.0 else t - 1.0
        start = 0.0 if t <= 1.0 else 0.2
        end.samples.append(WaveSample(t, goal, goal + (start - goal) * math.exp(-since / 0.05), 0.0, 0.0))
    found = figures_of(wave, end)
    steps = found["steps"]
    assert isinstance(steps, list)
    assert [round(step["size"]) for step in steps] == [11, -23]
    assert steps[0]["rise"] == pytest.approx(1e3 * 0.05 * math.log(9), rel=0.1)
    json.dumps(found, allow_nan=False)
    assert figures_of(Wave("sine", 0.2, 2.0, 2.0), end)["steps"] == []
    assert figures_of(wave, WaveEnd())["samples"] == 0


class Held:
    """A wave of servo 1 that somebody holds, with a sign of life every 20 ms until `let_go`."""

    def __init__(self, view: Any, **args: object) -> None:
        self.view, self.bus = view, view.bus
        kinds: dict[str, Any] = {}
        source = SimpleNamespace(need_bus=lambda: self.bus)
        holds = SimpleNamespace(add=lambda kind, begin: kinds.update({kind: begin}))
        add_wave(SimpleNamespace(source=source, holds=holds, live=view.studio.live))  # type: ignore[arg-type]
        self.entry = self.bus.hold_to_run.begin("k", 1)
        self.over = threading.Event()
        # A test that fails must not wait for it.
        self.life = threading.Thread(target=self._live, daemon=True)
        self.life.start()
        wanted = {**GOOD, "servo": 1, "shape": "triangle", "amplitude": 20, "seconds": 60, **args}
        try:
            kinds["wave"](view.tab, self.entry, wanted, self.bus.mark())
        except UsageError:
            self.let_go()
            raise

    def _live(self) -> None:
        while not self.over.wait(0.02):
            self.bus.hold_to_run.beat("k", 1)

    def let_go(self) -> None:
        self.over.set()
        self.life.join()

    def until_it_moves(self) -> None:
        servo, before = servo_of(self.view, 1), servo_of(self.view, 1).motion.position
        until(lambda: abs(servo.motion.position - before) > 40 or self.bus.hold_to_run.entry is None, "motion")
        assert self.bus.hold_to_run.entry is not None, self.view.told

    def end(self) -> dict[str, Any]:
        until(lambda: any("end" in row for row in self.view.told), "the end")
        until(lambda: self.bus.job is None and servo_of(self.view, 1).motion.settled, "rest")
        return next(row for row in self.view.told if "end" in row)


def test_a_wave_without_signs_of_life_ends_and_the_servo_holds(view: Any) -> None:
    held, servo = Held(view), servo_of(view, 1)
    held.until_it_moves()
    held.let_go()
    view.bus.bench.silence = view.bus.hold_to_run.silence = 0.5
    assert held.end()["end"] == "whoever held it is heard no more"
    there = servo.motion.position
    threading.Event().wait(0.3)
    assert servo.motion.position == pytest.approx(there, abs=3)
    assert servo.torque_on
    assert view.bus.hold_to_run.entry is None


def test_a_stop_or_a_release_ends_a_wave_and_nothing_from_before_a_stop_begins_one(view: Any) -> None:
    servo = servo_of(view, 1)
    held = Held(view)
    held.until_it_moves()
    view.bus.stop("tab 2 stopped it")
    held.let_go()
    assert "stopped" in held.end()["end"]
    there = servo.motion.position
    early = view.bus.mark
    view.bus.resume()
    view.told.clear()
    # Asked for before the stop, begun after the resume.
    token = early()
    view.bus.stop("again")
    view.bus.resume()
    view.bus.mark = lambda: token
    entry = view.bus.hold_to_run
    entry._last.clear()
    late = Held(view)
    late.let_go()
    assert "stop" in late.end()["end"]
    assert servo.motion.position == pytest.approx(there, abs=3)


def test_a_whole_wave_returns_and_leaves_the_torque_as_it_was(view: Any) -> None:
    servo = servo_of(view, 1)
    before = servo.motion.position
    held = Held(view, shape="step", amplitude=5, period=0.5, seconds=0.6)
    end = held.end()
    held.let_go()
    assert end["end"] == "complete"
    assert len(end["steps"]) >= 1
    assert servo.motion.position == pytest.approx(before, abs=6)
    assert not servo.torque_on
    rows = [row for message in view.told for row in message.get("rows", [])]
    assert len(rows) == end["samples"]


def test_a_servo_that_is_not_there_is_refused(view: Any) -> None:
    with pytest.raises(UsageError, match="servo 99 was not found"):
        Held(view, servo=99)
    view.bus.hold_to_run.end_all("over")
