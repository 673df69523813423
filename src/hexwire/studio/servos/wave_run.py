"""Runs a wave for a tab, while somebody there holds its button.

Owns what a page may ask for, and the messages about it. The motion belongs to `setup.servo_wave`, and the rule
that it ends with the hold to `control.motion.hold_to_run`.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.inputs import Item
from hexwire.model.state import JointFlag
from hexwire.motion.step_response import step_figures
from hexwire.motion.waves import SHAPES, Wave
from hexwire.setup.servo_wave import WaveEnd, WaveSample, and_back, one_servo, run_wave, standing
from hexwire.studio.calls import Arguments, Asked, CallHost, call

if TYPE_CHECKING:
    from hexwire.control.motion.hold_to_run import HeldMotion
    from hexwire.epochs import Token
    from hexwire.studio.bus_source import BusSource
    from hexwire.studio.tabs import Tab

__all__ = ["add_wave", "figures_of", "read_wave"]

_log = logging.getLogger(__name__)

_BATCH = 0.06
"""Seconds of samples in one message."""
_HUGE = 1e9
"""Beyond all bounds of a wave, which `Wave` checks; a float can hold what is below."""


class _Wave(Arguments, frozen=True):
    args: dict[str, Any]


@call("wave.shapes", Arguments)
def _shapes(asked: Asked, args: Arguments) -> list[str]:
    return list(SHAPES)


@call("wave.check", _Wave)
def _check(asked: Asked, args: _Wave) -> str:
    """How fast it will be, in words; what is wrong with it is an error."""
    _, wave = read_wave(args.args)
    if not math.isfinite(wave.fastest):
        return "steps, as fast as it can"
    return f"fastest on the way: {math.degrees(wave.fastest):.0f} °/s"


def read_wave(args: Mapping[str, object]) -> tuple[int, Wave]:
    """Check what a page asks for: the servo and the wave.

    Raises:
        UsageError: A value is missing or out of bounds.
    """
    numbers = ("amplitude", "period", "seconds", *(("last_period",) if args.get("shape") == "sweep" else ()))
    row = Item(args).table(("servo", "shape", *numbers))
    amplitude, period, seconds, *last = (row[key].number(-_HUGE, _HUGE) for key in numbers)
    wave = Wave(row["shape"].choice(SHAPES), math.radians(amplitude), period, seconds, *last)
    return row["servo"].integer(0, 253), wave


def add_wave(studio: CallHost) -> None:
    """Let pages hold a wave."""

    def begin(tab: Tab, entry: HeldMotion, args: Mapping[str, object], arrived: Token) -> None:
        bus = studio.source.need_bus()
        servo_id, wave = read_wave(args)
        if servo_id not in bus.bench.servo_ids:
            raise UsageError(f"servo {servo_id} was not found on this bus; search first")
        run = _Run(studio, bus, tab, entry, arrived)
        thread = threading.Thread(target=run.work, args=(servo_id, wave), name="studio wave", daemon=True)
        # Its end is seen in each cycle: there is nothing more to be done for it.
        bus.hold_to_run.begun(entry, lambda why: None)
        thread.start()

    studio.holds.add("wave", begin)


class _Run:
    def __init__(self, studio: CallHost, bus: BusSource, tab: Tab, entry: HeldMotion, arrived: Token) -> None:
        self._studio, self._bus, self._tab, self._entry, self._arrived = studio, bus, tab, entry, arrived
        self._rows: list[list[float]] = []
        self._told = -math.inf

    def work(self, servo_id: int, wave: Wave) -> None:
        end, why = WaveEnd(), ""
        try:
            with self._bus.bus.epochs.using(self._arrived):
                self._run(servo_id, wave, end)
        except HexwireError as error:
            why = str(error)
        except Exception:  # noqa: BLE001  # logged and told
            _log.exception("a wave failed")
            why = "the studio failed at this; see its log"
        why = why or self._entry.ended or ("complete" if end.complete else "whoever held it is heard no more")
        self._send()
        message = {"kind": "wave", "end": why, "servo": servo_id, **figures_of(wave, end)}
        self._studio.live.tell(message, self._tab.key)
        self._bus.hold_to_run.end(self._tab.key, why, self._entry.number)
        self._bus.on_change()

    def _run(self, servo_id: int, wave: Wave, end: WaveEnd) -> None:
        bench, bus = self._bus.bench, self._bus.bus
        with bench.working(f"a wave of servo {servo_id}", acts=True) as job:

            def go_on() -> bool:
                return job.go_on() and self._entry.age(time.monotonic()) <= bench.silence

            self._studio.live.tell({"kind": "wave", "begin": servo_id}, self._tab.key)
            with one_servo(bus, servo_id, wave.amplitude) as arm:
                start = standing(arm)
                if not go_on():
                    return
                if not arm.torque(True):
                    raise ServoError(f"servo {servo_id} does not confirm its torque", servo_id=servo_id)
                angle, seconds = and_back(wave.angle, wave.seconds)
                run_wave(
                    arm,
                    start,
                    angle,
                    seconds,
                    end,
                    go_on=go_on,
                    clock=time.monotonic,
                    sleep=time.sleep,
                    on_sample=self._sample,
                )
                # Released on the way, it holds there: without torque it could fall.
                if end.complete and not start.flags & JointFlag.TORQUE_ON:
                    arm.torque(False)

    def _sample(self, row: WaveSample) -> None:
        deg = math.degrees
        self._rows.append([round(value, 3) for value in (row.t, deg(row.goal), deg(row.position), 100 * row.load)])
        now = time.monotonic()
        if now - self._told >= _BATCH:
            self._told = now
            self._send()

    def _send(self) -> None:
        if self._rows:
            self._studio.live.tell({"kind": "wave", "rows": self._rows}, self._tab.key)
            self._rows = []


def figures_of(wave: Wave, end: WaveEnd) -> dict[str, object]:
    """How the servo followed, for JSON: degrees, milliseconds, percent; None where a figure does not exist."""
    rows = [(0.0, 0.0, 0.0), *((row.t, row.goal, row.position) for row in end.samples)]
    # The way back is no step.
    steps = step_figures([row for row in rows if row[0] <= wave.seconds]) if wave.shape == "step" else []

    def known(value: float, factor: float) -> float | None:
        return round(value * factor, 2) if math.isfinite(value) else None

    factors = {
        "at": 1.0,
        "size": math.degrees(1),
        "delay": 1e3,
        "rise": 1e3,
        "overshoot": 100.0,
        "peak": 1e3,
        "settled": 1e3,
        "steady_error": math.degrees(1),
    }
    return {
        "samples": len(end.samples),
        "missed": end.missed,
        "off": round(math.degrees(end.farthest_off), 2),
        "steps": [{name: known(value, factors[name]) for name, value in asdict(step).items()} for step in steps],
    }
