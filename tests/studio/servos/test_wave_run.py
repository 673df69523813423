from __future__ import annotations

import json
import math

import pytest

from hexwire.control.servo_wave import WaveEnd, WaveSample
from hexwire.errors import UsageError
from hexwire.motion.waves import Wave
from hexwire.studio.servos.wave_run import figures_of, read_wave

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
