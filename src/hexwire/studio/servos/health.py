"""The health of a servo over ten minutes: supply, temperature, current, load, faults and lost answers.

Owns what a page is told of it; `bus.health_history` owns the samples.
"""

from __future__ import annotations

import math
import time
from typing import Any

from hexwire.bus.health import HealthFinding, Rank, check_health, judge_health
from hexwire.bus.values import fault_words
from hexwire.studio.calls import Arguments, Asked, call

__all__ = ["judged", "worst"]


class _Servo(Arguments, frozen=True):
    servo: int


@call("health.rows", _Servo)
def _rows(asked: Asked, args: _Servo) -> dict[str, Any]:
    """The worst of each second, seconds before now; `now` is on the clock of the live values."""
    now = time.monotonic()
    rows = [
        [round(row.t - now, 1), *map(_json, (row.voltage, row.temperature, row.current, 100 * row.load))]
        for row in asked.bus.history.rows(args.servo)
    ]
    return {"now": now, "rows": rows}


@call("health.worst", _Servo)
def worst(asked: Asked, args: _Servo) -> list[tuple[str, str]]:
    """The worst of ten minutes: names and values."""
    found = asked.bus.history.summary(args.servo)
    share = f" ({found.lost / found.asked:.2%})" if found.asked else ""
    return [
        ("Lowest supply", _number(found.lowest_voltage, "V")),
        ("Hottest", _number(found.hottest, "°C")),
        ("Largest current", _number(found.most_current, "A", 2)),
        ("Largest load", _number(100 * found.most_load, "%", 0)),
        ("Faults seen", ", ".join(fault_words(found.status)) or "none"),
        ("Answers lost", f"{found.lost} of {found.asked}{share}"),
    ]


@call("health.forget", _Servo)
def _forget(asked: Asked, args: _Servo) -> None:
    asked.bus.history.forget(args.servo)


@call("health.judge", Arguments, control=True)
def _judge(asked: Asked, args: Arguments) -> list[tuple[str, str]]:
    return judged(asked)


def judged(asked: Asked) -> list[tuple[str, str]]:
    """Read all servos for some seconds, without torque or motion; returns pairs of level and words."""
    bench = asked.bus.bench
    with bench.working("a check of health", alone=True) as job:
        samples = check_health(asked.bus.bus, bench.servo_ids, go_on=job.go_on)
    levels = {Rank.OK: "ok", Rank.HINT: "warn", Rank.BAD: "error"}
    return [(levels[row.rank], _words(row)) for row in judge_health(samples)]


def _words(row: HealthFinding) -> str:
    who = f"servo {', '.join(map(str, row.servo_ids))}: " if row.servo_ids else ""
    return f"{who}{row.text}{f' ({row.advice})' if row.advice else ''}"


def _number(value: float, unit: str, digits: int = 1) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f} {unit}"


def _json(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None
