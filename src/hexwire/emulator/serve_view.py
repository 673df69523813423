"""A window onto the physics twin: MuJoCo's own viewer, which only watches.

Owns the window and its rate. Must not know servos beyond letting time pass for them. Needs a display and GLFW.
"""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from hexwire.errors import UsageError

from .serve import FRAME

if TYPE_CHECKING:
    from .physics import PhysicsTwin
    from .servo import EmulatedServo

__all__ = ["TwinView", "open_window"]

_AWAY = 1.6
"""Distance of the camera, as a multiple of the arm's reach."""
_OPENS = 20.0
"""Seconds that a window may take to appear, on a computer that draws in software."""


class TwinView:
    """A window that shows a twin until somebody closes it.

    Args:
        twin: What it shows.
        servos: Those of the twin; they move although no program asks for them.
        opener: Opens the window: takes an ``MjModel`` and an ``MjData``, returns a handle as of MuJoCo's
            ``viewer.launch_passive``.

    Raises:
        UsageError: There is no display, or no window appears.
    """

    def __init__(
        self,
        twin: PhysicsTwin,
        servos: Sequence[EmulatedServo],
        opener: Callable[[Any, Any], Any] | None = None,
    ) -> None:
        self._twin, self._servos = twin, servos
        self._data = twin.make_data()
        twin.show(self._data)
        self._window = (opener or open_window)(twin.model, self._data)
        self._next = 0.0
        self._aim()

    def _aim(self) -> None:
        """Start where the camera of the body stands; the viewer itself would start behind the arm."""
        model, camera = self._twin.model, self._window.cam
        with self._window.lock():
            camera.lookat[:] = model.stat.center
            camera.distance = _AWAY * model.stat.extent
            camera.azimuth, camera.elevation = model.vis.global_.azimuth, model.vis.global_.elevation

    def step(self, now: float) -> bool:
        """Show the twin as it is now, if a picture is due; False once the window is closed."""
        if not self._window.is_running():
            return False
        if now >= self._next:
            self._next = now + FRAME
            for servo in self._servos:
                servo.step(now)
            with self._window.lock():
                self._twin.show(self._data)
            self._window.sync()
        return True

    def close(self) -> None:
        """Close the window."""
        self._window.close()


def open_window(model: Any, data: Any) -> Any:
    """Open MuJoCo's viewer without its panels; returns its handle.

    Raises:
        UsageError: There is no display, the package ``glfw`` is missing, or no window appears.
    """
    _check_display()
    from mujoco import viewer

    opened: list[Any] = []

    def launch() -> None:
        opened.append(viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False))

    before = set(threading.enumerate())
    # MuJoCo waits for its window for ever, also when its thread has ended with an error.
    thread = threading.Thread(target=launch, daemon=True)
    thread.start()
    thread.join(_OPENS)
    if not opened:
        raise UsageError("no window for --view: this display has no OpenGL; leave out --view")
    return _Window(opened[0], [thread for thread in threading.enumerate() if thread not in before])


class _Window:
    """A viewer's handle, and the threads that draw it: the interpreter must not end before them."""

    def __init__(self, handle: Any, threads: Sequence[threading.Thread]) -> None:
        self._handle, self._threads = handle, threads

    def __getattr__(self, name: str) -> Any:
        return getattr(self._handle, name)

    def close(self) -> None:
        self._handle.close()
        for thread in self._threads:
            thread.join(_OPENS)


def _check_display() -> None:
    if sys.platform == "darwin":
        raise UsageError("on macOS, --view does not work: its window must belong to the main thread")
    try:
        import glfw
    except ImportError:
        raise UsageError("--view needs GLFW: pip install 'hexwire[sim]'") from None
    with warnings.catch_warnings():
        # It warns about what it then returns.
        warnings.simplefilter("ignore")
        there = glfw.init()
        if there:
            glfw.terminate()
    if not there:
        raise UsageError(
            "no display for --view: run it in a desktop session, or over 'ssh -X'; without --view it works the same"
        )
