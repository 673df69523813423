"""The health of a servo over ten minutes: supply, temperature, current, load, faults and lost answers.

Owns what a page is told of it; `bus.health` owns the samples and what counts as healthy. Behind a board the samples
are the states of the arm.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from hexwire.bus.health import HealthFinding, HealthHistory, Rank, ServoSamples, check_health, judge_health
from hexwire.bus.values import fault_words
from hexwire.errors import HexwireError
from hexwire.studio.arm_source import live_values
from hexwire.studio.calls import Arguments, Asked, OfServo, call
from hexwire.wire.registers import Series

from .board import raw_registers

if TYPE_CHECKING:
    from hexwire.bus.live_values import LiveValues
    from hexwire.model.state import JointState
    from hexwire.studio.source import ArmSource

__all__ = ["judged", "told", "worst"]


_STATES, _WATCHED = 150, 5.0
"""States of an arm from which its servos are judged, and the most seconds to wait for them."""


@call("health.rows", OfServo)
def _rows(asked: Asked, args: OfServo) -> dict[str, Any]:
    """The worst of each second, seconds before now; `now` is on the clock of the live values."""
    now = time.monotonic()
    rows = [
        [round(row.t - now, 1), *map(_json, (row.voltage, row.temperature, row.current, 100 * row.load))]
        for row in _history(asked).rows(args.servo)
    ]
    return {"now": now, "rows": rows}


@call("health.worst", OfServo)
def worst(asked: Asked, args: OfServo) -> list[tuple[str, str]]:
    """The worst of ten minutes: names and values."""
    found = _history(asked).summary(args.servo)
    share = f" ({found.lost / found.asked:.2%})" if found.asked else ""
    return [
        ("Lowest supply", _number(found.lowest_voltage, "V")),
        ("Hottest", _number(found.hottest, "°C")),
        ("Largest current", _number(found.most_current, "A", 2)),
        ("Largest load", _number(100 * found.most_load, "%", 0)),
        ("Faults seen", ", ".join(fault_words(found.status)) or "none"),
        ("Answers lost", f"{found.lost} of {found.asked}{share}"),
    ]


@call("health.forget", OfServo)
def _forget(asked: Asked, args: OfServo) -> None:
    _history(asked).forget(args.servo)


@call("health.judge", Arguments, control=True)
def _judge(asked: Asked, args: Arguments) -> list[tuple[str, str]]:
    return told(_samples(asked.arm)) if asked.studio.source.bus is None else judged(asked)


def _history(asked: Asked) -> HealthHistory:
    return asked.arm.health if asked.studio.source.bus is None else asked.bus.history


def judged(asked: Asked) -> list[tuple[str, str]]:
    """Read all servos for some seconds, without torque or motion; returns pairs of level and words."""
    bench = asked.bus.bench
    with bench.working("a check of health", alone=True) as job:
        return told(check_health(asked.bus.bus, bench.servo_ids, go_on=job.go_on))


def told(samples: Sequence[ServoSamples]) -> list[tuple[str, str]]:
    """What samples say, as pairs of level and words."""
    levels = {Rank.OK: "ok", Rank.HINT: "warn", Rank.BAD: "error"}
    return [(levels[row.rank], _words(row)) for row in judge_health(samples)]


def _samples(arm: ArmSource) -> list[ServoSamples]:
    """What the states of an arm say of its servos, in the order of its joints."""
    model, enough = arm.settings.model, threading.Event()
    rows: list[list[LiveValues]] = []
    torque: list[tuple[str, ...]] = []

    def see(state: JointState, goals: object) -> None:
        if not enough.is_set():
            rows.append(live_values(model, state))
            torque.append(state.torque_on)
            if len(rows) >= _STATES:
                enough.set()

    arm.listeners = (*arm.listeners, see)
    try:
        enough.wait(_WATCHED)
    finally:
        enough.set()
        arm.listeners = tuple(one for one in arm.listeners if one is not see)
    found = []
    for i, joint in enumerate(model.joints):
        seen = [row[i] for row in rows]
        live = tuple(row for row in seen if not row.error)
        settings = {}
        with suppress(HexwireError):
            register = Series(joint.series).registers.get("max_temperature")
            raws = {} if register is None else raw_registers(arm, joint)
            if register is not None and register.name in raws:
                settings[register.name] = register.si_factor * raws[register.name]
        holds = all(joint.name in names for names in torque) if torque else None
        lost = len(seen) - len(live)
        found.append(ServoSamples(joint.servo_id, bool(live), (), settings, holds, live, len(seen), lost))
    return found


def _words(row: HealthFinding) -> str:
    who = f"servo {', '.join(map(str, row.servo_ids))}: " if row.servo_ids else ""
    return f"{who}{row.text}{f' ({row.advice})' if row.advice else ''}"


def _number(value: float, unit: str, digits: int = 1) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f} {unit}"


def _json(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None
