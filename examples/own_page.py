"""A page of one's own: joint angles, live, and a button that stops the arm.

    python examples/own_page.py [PORT]

Then open http://127.0.0.1:8000. Needs `hexwire[studio]`. `hexwire studio` is the page for everything else.
"""

import math
import os
import sys

from nicegui import app, run, ui

import hexwire

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"
arm = hexwire.connect(port)
app.on_shutdown(lambda: arm.detach())


async def stop() -> None:
    """Stop the arm, latched until `hexwire resume`; in a thread, so that a slow line does not hold up the page."""
    await run.io_bound(arm.stop)
    ui.notify("stopped")


@ui.page("/")
def page() -> None:
    """What a browser shows."""
    ui.button("STOP", color="red", on_click=stop)
    labels: dict[str, ui.label] = {}
    with ui.grid(columns=2):
        for name in arm.model.names:
            ui.label(name)
            labels[name] = ui.label()

    async def update() -> None:
        state = await run.io_bound(arm.read)
        if state is None:  # the program ends
            return
        for joint in state:
            known = joint.name not in state.silent
            labels[joint.name].text = f"{math.degrees(joint.position):.1f}" if known else "no answer"

    ui.timer(0.1, update)


ui.run(host="127.0.0.1", port=int(os.environ.get("PAGE_PORT", "8000")), show=False, reload=False, title="my arm")
