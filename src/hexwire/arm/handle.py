"""What goes on while the program does something else: a motion, a recording, an arm that follows another.

Owns its thread, how it is ended, and how the program learns what came of it. Must not know what it does.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Generic, Self, TypeVar

from hexwire.errors import StoppedError

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = ["STOP_ENDS", "Handle", "MotionHandle", "told"]

_R = TypeVar("_R")

STOP_ENDS = "resume() ends the stop, and moves nothing"


@contextmanager
def told() -> Iterator[None]:
    """Say of a stop what ends it in a program, where a driver names the command."""
    try:
        yield
    except StoppedError as error:
        error.args = (str(error).replace("`hexwire resume` ends that", STOP_ENDS),)
        raise


class Handle(Generic[_R]):
    """Something that goes on in a thread of its own; at the end of a ``with`` block it is ended.

    Args:
        robot: Is stopped by Ctrl-C in `wait`.
        name: Of the thread.
        run: Is run in the thread, and returns soon after the event that it gets is set.
    """

    def __init__(self, robot: RobotDriver, name: str, run: Callable[[threading.Event], _R]) -> None:
        self._robot, self._run = robot, run
        self._ending, self._over = threading.Event(), threading.Event()
        self._results: list[_R] = []
        self._error: BaseException | None = None
        self._told = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self._results.append(self._run(self._ending))
        except BaseException as error:  # noqa: BLE001  # raised where the program waits
            self._error = error
        finally:
            self._over.set()

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._over.is_set()

    def wait(self, timeout: float | None = None) -> _R:
        """Wait for its end, and return what came of it; Ctrl-C stops the arm.

        Args:
            timeout: Seconds; None waits as long as it takes.

        Raises:
            TimeoutError: It has not ended in this time; it goes on.
            HexwireError: It failed.
        """
        try:
            over = self._over.wait(timeout)
        except KeyboardInterrupt:
            self._robot.stop()
            raise
        if not over:
            raise TimeoutError(f"it has not ended after {timeout:g} s, and goes on")
        self._told = True
        if self._error is not None:
            raise self._error
        return self._results[0]

    def end(self) -> _R:
        """End it now, and return what came of it; raises as `wait`."""
        self._ending.set()
        return self.wait()

    def abandon(self) -> None:
        """End it because of an error elsewhere: what came of it does not matter."""
        self._ending.set()
        self._over.wait()
        self._told = True

    @property
    def unheard(self) -> BaseException | None:
        """Why it failed, if it did, and nobody has waited for it."""
        return None if self._told or not self.done else self._error

    def close(self) -> None:
        """End it at the end of the program's work with the arm; raises what `wait` has not raised yet."""
        self._ending.set()
        self._over.wait()
        self._thread.join()
        if not self._told:
            self.wait()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}, {'over' if self.done else 'under way'}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.end()
        else:
            self.abandon()


class MotionHandle(Handle[_R]):
    """A motion under way. A ``with`` block waits for its end, and cancels it if the block raises an exception.

    Args:
        robot: See `Handle`.
        run: Likewise.
        duration: Seconds that the motion takes.

    Attributes:
        duration: Seconds that the motion takes.
        state: The newest state since it began; None until there is one.
    """

    def __init__(self, robot: RobotDriver, run: Callable[[threading.Event], _R], duration: float) -> None:
        self.duration = duration
        self.state: JointState | None = None
        self._began: float | None = None
        super().__init__(robot, "motion", run)

    def see(self, state: JointState) -> None:
        """Take a state of the motion."""
        self._began = state.stamp if self._began is None else self._began
        self.state = state

    @property
    def progress(self) -> float:
        """Share of the motion's time that is over, 0 to 1; 1 only when it has ended."""
        if self.done:
            return 1.0
        if self.state is None or self._began is None or not self.duration:
            return 0.0
        return min((self.state.stamp - self._began) / self.duration, 0.99)

    def cancel(self) -> _R:
        """Bring the joints to rest and hold; nothing is latched. Returns how the motion ended; raises as `wait`."""
        return self.end()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.wait()
        else:
            self.abandon()
