"""The health of a servo over ten minutes: supply, temperature, current, load, faults and lost answers.

Owns what this part shows; `bus.health_history` owns the samples.
"""

from __future__ import annotations

import math
import time
from html import escape

from hexwire.bus.health import HealthFinding, Rank, check_health, judge_health
from hexwire.bus.values import fault_words
from hexwire.studio.app import FAILED
from hexwire.studio.layout import mount

from .view import View, button, facts, section

__all__ = ["build", "judged"]


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    history = view.bus.history
    section("Health", "The last ten minutes: the worst of each second, and live values.")
    place = ui.element("div")

    def show() -> None:
        worst = history.summary(servo_id)
        words = ", ".join(fault_words(worst.status)) or "none"
        share = f" ({worst.lost / worst.asked:.2%})" if worst.asked else ""
        place.clear()
        with place:
            facts(
                [
                    ("Lowest supply", _number(worst.lowest_voltage, "V")),
                    ("Hottest", _number(worst.hottest, "°C")),
                    ("Largest current", _number(worst.most_current, "A", 2)),
                    ("Largest load", _number(100 * worst.most_load, "%", 0)),
                    ("Faults seen", words),
                    ("Answers lost", f"{worst.lost} of {worst.asked}{share}"),
                ]
            )

    show()
    ui.timer(1.0, show)
    plot = ui.element("div").classes("sv-plot")
    now = time.monotonic()
    rows = [
        [
            round(row.t - now, 1),
            *(_json(value) for value in (row.voltage, row.temperature, row.current, 100 * row.load)),
        ]
        for row in history.rows(servo_id)
    ]
    mount("servos.js", plot, part="health", servo=servo_id, now=now, rows=rows)

    def forget() -> None:
        history.forget(servo_id)
        view.redraw()

    with ui.element("div").classes("hw-row"):
        button("Forget these values", forget, offline=True)
        judge = button("Judge all servos now", lambda: ask())
    found = ui.element("ul").classes("sv-remarks").props('aria-live="polite"')

    async def ask() -> None:
        judge.set_visibility(False)
        try:
            rows = await view.act(lambda: judged(view))
        finally:
            judge.set_visibility(True)
        if rows is FAILED:
            return
        found.clear()
        with found:
            for level, words in rows:
                ui.html(escape(words), sanitize=False, tag="li").props(f'data-level="{level}"')


def judged(view: View) -> list[tuple[str, str]]:
    """Read all servos for some seconds, without torque or motion; returns pairs of level and words."""
    bench = view.bus.bench
    with bench.working("a check of health", alone=True) as job:
        samples = check_health(view.bus.bus, bench.servo_ids, go_on=job.go_on)
    levels = {Rank.OK: "ok", Rank.HINT: "warn", Rank.BAD: "error"}
    return [(levels[row.rank], _words(row)) for row in judge_health(samples)]


def _words(row: HealthFinding) -> str:
    who = f"servo {', '.join(map(str, row.servo_ids))}: " if row.servo_ids else ""
    return f"{who}{row.text}{f' ({row.advice})' if row.advice else ''}"


def _number(value: float, unit: str, digits: int = 1) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f} {unit}"


def _json(value: float) -> float | None:
    return round(value, 3) if math.isfinite(value) else None
