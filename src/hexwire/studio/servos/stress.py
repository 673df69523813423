"""A stress test of the bus: reads as fast as possible, errors by servo, a histogram of the times. Nothing moves.

Owns what is asked and shown; `bus.latency` owns the test.
"""

from __future__ import annotations

from html import escape

from hexwire.bus.latency import StressTest
from hexwire.errors import UsageError

from .view import View, button, facts, section, table

__all__ = ["build"]

_MOST = 100_000


def build(view: View, servo_id: int) -> None:
    """Build the part."""
    from nicegui import ui

    bus = view.bus
    section(
        "Stress test",
        "Reads positions as fast as the line allows. Missing values name the servo whose cable or supply is weak.",
    )
    with ui.element("div").classes("sv-form"):
        who = ui.select({"all": "all servos", "one": f"servo {servo_id}"}, value="all", label="Servos").props(
            "dense outlined options-dense"
        )
        count = ui.number("Reads", value=1000, min=1, max=_MOST, step=1, format="%d").props("dense outlined")
        start = button("Start", lambda: run(), level="main")
        cancel = button("Cancel", lambda: bus.bench.cancel(), late=True)
    cancel.set_visibility(False)
    bar = ui.element("progress").classes("sv-progress").props('max="1" aria-label="Progress of the stress test"')
    bar.set_visibility(False)
    place = ui.element("div")

    def progress() -> None:
        job = bus.bench.job
        if job is not None:
            bar.props["value"] = round(job.share, 3)
            bar.update()

    watch = ui.timer(0.2, progress, active=False)

    async def run() -> None:
        ids = bus.bench.servo_ids if who.value == "all" else (servo_id,)
        for made in (start, cancel, bar):
            made.set_visibility(made is not start)
        watch.activate()
        try:
            test = await view.act(lambda: _run(view, ids, count.value))
        finally:
            watch.deactivate()
            for made in (start, cancel, bar):
                made.set_visibility(made is start)
        if isinstance(test, StressTest) and test.reads:
            place.clear()
            with place:
                _show(view, test)


def _run(view: View, ids: tuple[int, ...], count: float | None) -> StressTest:
    if count is None or not 1 <= count <= _MOST or count != int(count):
        raise UsageError(f"the number of reads is a whole number from 1 to {_MOST}")
    if not ids:
        raise UsageError("no servo is known; search first")
    test = StressTest(ids)
    # Live values would come between, and distort the times.
    with view.bus.bench.working("a stress test", alone=True) as job:

        def go_on() -> bool:
            job.share = test.reads / count
            return job.go_on()

        test.run(view.bus.bus, int(count), go_on=go_on)
    return test


def _show(view: View, test: StressTest) -> None:
    from nicegui import ui

    bins = test.took.bins()
    facts(
        [
            ("Reads", f"{test.reads} in {test.seconds:.2f} s"),
            ("Per second", f"{test.reads / test.seconds:.0f}"),
            ("Median", f"{bins.p50 * 1e3:.2f} ms"),
            ("99 of 100 within", f"{bins.p99 * 1e3:.2f} ms"),
            ("Longest", f"{bins.longest * 1e3:.2f} ms"),
            ("Values missing", f"{test.lost} of {test.values} ({test.lost / test.values:.2%})"),
        ]
    )
    most = max(bins.counts)
    rows = []
    for i, (edge, count) in enumerate(zip(bins.edges, bins.counts, strict=True)):
        name = f"{edge * 1e3:.2f} ms" if i < len(bins.edges) - 1 else f"above {edge * 1e3:.2f} ms"
        bar = f'<span class="sv-bar" style="width:{100 * count / most:.1f}%"></span>'
        rows.append((escape(name), bar, str(count)))
    ui.html(table(("From", "Share", "#Reads"), rows, caption="Histogram of the times"), sanitize=False).classes(
        "sv-histogram"
    )
    missing = [(f"servo {i}", str(count)) for i, count in test.missing.items() if count]
    if missing:
        ui.html(table(("Servo", "#Missing"), missing, caption="Missing values"), sanitize=False)
