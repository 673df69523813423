"""How `sim` shows the physics twin: the option `--view`, and the window for as long as the emulator runs.

Owns the option. Must not know how the window is drawn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from hexwire.emulator.physics import PhysicsTwin
    from hexwire.emulator.serve_view import TwinView
    from hexwire.emulator.servo import EmulatedServo

__all__ = ["shown", "view_option"]

view_option = click.option(
    "--view", is_flag=True, help="With --physics, show the arm in a window; closing it ends the emulator."
)


@contextmanager
def shown(
    twin: PhysicsTwin | None, servos: Sequence[EmulatedServo], stop: Callable[[], bool], *, view: bool
) -> Iterator[tuple[TwinView | None, Callable[[], bool]]]:
    """The window of a twin while the block runs, if `view`, and what tells the emulator to stop.

    Args:
        twin: None if there are no physics.
        servos: The servos of the twin.
        stop: What else tells the emulator to stop.
        view: Show a window.

    Raises:
        UsageError: There are no physics to show, or no window can be opened.
    """
    if not view:
        yield None, stop
        return
    if twin is None:
        raise UsageError("--view needs --physics")
    from hexwire.emulator.serve_view import TwinView

    window = TwinView(twin, servos)
    try:
        yield window, lambda: stop() or not window.step(time.monotonic())
    finally:
        window.close()
