"""What goes on while the program does something else: a motion, a recording, an arm that follows another.

Owns its thread, how it is ended, and how the program learns what came of it.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from hexwire.arguments import SECONDS, check, or_none
from hexwire.control.loop.power import STOP_LATCHED
from hexwire.errors import HexwireError, LinkClosedError, LinkLostError

from .claim import WORK_ENDED, Claim, forget_ctrl_c

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = ["DETACHED", "STOP_ENDS", "Handle", "MotionHandle", "end_all", "told"]

_R = TypeVar("_R")

_INTERRUPTED = "cancelled by Ctrl-C"

STOP_ENDS = "resume() ends the stop, and moves nothing"

DETACHED = "this arm is detached, as at the end of its with block: connect() again"

_AGAIN = "connect() again once it is there"
_METHODS = {
    "the driver is not attached; call attach() first": DETACHED,
    STOP_LATCHED: STOP_ENDS,
    "clear it with 'hexwire resume'": STOP_ENDS,
    "take it with --take": "take it with arm.driver.take(force=True)",
    "`hexwire move NAME=DEGREES`": "move(NAME=deg(10))",
    "choose one with --arm": "`hexwire play --arm NAME` plays one of them",
    "with --from and --to": "with begin= and end=",
    "--force overwrites": "force=True overwrites",
    "with --port": "in connect()",
}
"""What a driver, a server or a file says of commands, and what is said of methods instead."""
_ARGUMENTS = {
    r"--robot (\w+) --baud (\d+)": r"robot='\1' and ?baud=\2 after the port",
    r"--robot (\w+\d\w*)": r"robot='\1'",
    r"--robot\b": "robot=",
    r"--port (\w+://\w+)": r"connect('\1')",
    r"--speed ([\d.]+), or --fit": r"factor=\1, or fit=True",
}
"""Options of commands, and the arguments that they are; what is within back quotes stays a command."""


@contextmanager
def told() -> Iterator[None]:
    """Name methods and arguments to a program where a driver names commands and options."""
    try:
        yield
    except HexwireError as error:
        text = said = str(error)
        for words, method in _METHODS.items():
            text = text.replace(words, method)
        for option, argument in _ARGUMENTS.items():
            text = re.sub(option, argument, text)
        if isinstance(error, LinkLostError | LinkClosedError) and _AGAIN not in text:
            text += f" ({_AGAIN})"
        if text != said:
            error.args = (text,)
        raise


class Handle(Generic[_R]):
    """Something that goes on in a thread of its own; at the end of a ``with`` block it is ended.

    Args:
        robot: Is stopped by Ctrl-C in `wait`, unless what goes on ends without a stop.
        name: Of the thread.
        run: Is run in the thread, and returns soon after the event that it gets is set.
        claim: What the arm does then; None for what moves nothing.

    Attributes:
        told: The program knows what came of it.
    """

    def __init__(
        self, robot: RobotDriver, name: str, run: Callable[[threading.Event], _R], claim: Claim | None = None
    ) -> None:
        self._robot, self._run = robot, run
        self._claim = claim
        self._ending = threading.Event() if claim is None else claim.ending
        self._over = threading.Event()
        self._results: list[_R] = []
        self._error: BaseException | None = None
        self.told = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            with nullcontext() if self._claim is None else self._claim.doing_it():
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
        """Wait for its end, and return what came of it. Ctrl-C stops the arm; a lesson or following holds it.

        Args:
            timeout: Seconds; None waits as long as it takes.

        Raises:
            TimeoutError: It has not ended in this time; it goes on.
            HexwireError: It failed.
        """
        check("wait", "timeout", or_none(SECONDS), timeout)
        try:
            # Half a million years, which no lock takes, are as good as no end.
            over = self._over.wait(timeout if timeout is None or timeout < threading.TIMEOUT_MAX else None)
        except KeyboardInterrupt:
            if self._claim is None or self._claim.stops:
                self._robot.stop()
            else:
                self._end(_INTERRUPTED)
            raise
        finally:
            forget_ctrl_c()
        if not over:
            raise TimeoutError(f"it has not ended after {timeout:g} s, and goes on")
        self.told = True
        if self._error is not None:
            raise self._error
        return self._results[0]

    def end(self) -> _R:
        """End it now, and return what came of it; raises as `wait`."""
        self._end("cancelled by the program")
        return self.wait()

    def cancel(self) -> _R:
        """As `end`; a motion comes to rest and holds, and nothing is latched. Raises as `wait`."""
        return self.end()

    def _end(self, why: str) -> None:
        if self._claim is None:
            self._ending.set()
        else:
            self._claim.end(why)

    @property
    def progress(self) -> float:
        """1 when it has ended; 0 until then, where nobody knows how long it takes."""
        return float(self.done)

    def abandon(self) -> None:
        """End it because of an error elsewhere: what came of it does not matter."""
        self._end("cancelled by an error elsewhere in the program")
        self._over.wait()
        self.told = True

    @property
    def unheard(self) -> BaseException | None:
        """Why it failed, if it did, and nobody has waited for it."""
        return None if self.told or not self.done else self._error

    def close(self) -> None:
        """End it at the end of the program's work with the arm; raises what `wait` has not raised yet."""
        self._end(WORK_ENDED)
        self._over.wait()
        self._thread.join()
        if not self.told:
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
        run: See `Handle`.
        duration: Seconds that the motion takes.
        claim: See `Handle`.

    Attributes:
        duration: Seconds that the motion takes.
        state: The newest state since it began; None until there is one.
    """

    def __init__(
        self, robot: RobotDriver, run: Callable[[threading.Event], _R], duration: float, claim: Claim | None = None
    ) -> None:
        self.duration = duration
        self.state: JointState | None = None
        self._began: float | None = None
        super().__init__(robot, "motion", run, claim)

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.wait()
        else:
            self.abandon()


def end_all(handles: Iterable[Handle[Any]]) -> None:
    """End all of these now, at the same time, whatever comes of it."""
    handles = tuple(handles)
    for handle in handles:
        handle._end("cancelled by the program")
    for handle in handles:
        handle._over.wait()
