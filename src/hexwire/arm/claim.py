"""The one thing at a time that an arm does for its program, and what ends it: the program, a detach, or Ctrl-C.

Owns whose turn it is, why it ended, and the handler of SIGINT while something goes on for which no verb waits.

A list is the lock: a signal handler may raise KeyboardInterrupt at any line, so that nothing here may be left half
done by it, nor wait for what it has interrupted.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError

if TYPE_CHECKING:
    from hexwire.epochs import Token

__all__ = ["WORK_ENDED", "Claim", "Claims", "Ending", "forget_ctrl_c"]

WORK_ENDED = "cancelled by the end of the program's work with the arm"

_going: set[Claim] = set()
"""What Ctrl-C ends, wherever the main thread is then."""


class Ending(threading.Event):
    """Whether something is to end.

    Attributes:
        interrupted: By Ctrl-C. A signal handler may set this, but not the event, which has a lock.
    """

    interrupted = False

    def is_set(self) -> bool:
        """Whether it is."""
        return self.interrupted or self.asked

    @property
    def asked(self) -> bool:
        """Whether it is because the program says so."""
        return super().is_set()


class Claim:
    """What an arm does, or is about to do.

    Args:
        claims: Those of the arm.
        asked: When it was asked for; None for what only its program ends.
        doing: What the arm does then, for others.
        here: It is done in this thread, which waits for it; otherwise in one of its own.
        stop: Stops the arm after Ctrl-C; None for what ends without a stop.

    Attributes:
        ending: It is to end.
        over: It is over, and the arm may do something else.
        thread: The thread in which it is done, if that waits for it.
        why: Why it was to end; empty if it was not.
        stops: Ctrl-C stops the arm.
    """

    def __init__(
        self,
        claims: Claims,
        asked: Token | None,
        doing: str,
        *,
        here: bool = False,
        stop: Callable[[], object] | None = None,
    ) -> None:
        self.asked, self.doing, self.why = asked, doing, ""
        self.thread = threading.get_ident() if here else None
        self.ending, self.over = Ending(), threading.Event()
        self._claims, self._stop = claims, stop
        self.stops = stop is not None
        self._turns = [True]

    def end(self, why: str) -> None:
        """Have it end soon."""
        self.why = self.why or why
        self.ending.set()

    def ends(self) -> bool:
        """Whether a motion is to end; its cycles ask this in its thread, and so stop the arm after Ctrl-C."""
        if self.ending.interrupted and (stop := self._stop) is not None:
            self._stop = None
            stop()
        return self.ending.asked

    @contextmanager
    def doing_it(self) -> Iterator[None]:
        """What is done, in a ``with`` block: at its end the arm is free.

        Raises:
            UsageError: Nobody waits for it any more; it must not begin.
        """
        try:
            if not self._begins():
                raise UsageError("it was ended before it began")
            yield
        finally:
            with suppress(HexwireError):
                self.ends()
            self.release()

    def give_up(self, *, stops: bool) -> None:
        """End it because its verb was interrupted, so that nobody has a handle of it; with a stop after Ctrl-C."""
        if not self._begins() and self.thread is None:
            self.end("cancelled: its verb was interrupted")
            if stops and self._stop is not None:
                self._stop()
            self.over.wait()
        self.release()

    def watch(self) -> None:
        """Have Ctrl-C end it, wherever this program is then, if this is its main thread without a handler."""
        if threading.current_thread() is not threading.main_thread():
            return
        _going.add(self)
        _handle_ctrl_c()
        _outlast_cell()

    def release(self) -> None:
        """Let the next one begin."""
        _going.discard(self)
        with suppress(ValueError):
            self._claims.remove(self)
        self.over.set()

    def _begins(self) -> bool:
        """Whether it is done now: for one caller only, so that it is either done or given up."""
        with suppress(IndexError):
            return self._turns.pop()
        return False


class Claims(list[Claim]):
    """What an arm does, and behind it what waits for its end."""

    @property
    def now(self) -> Claim | None:
        """What it does."""
        first = self[:1]
        return first[0] if first else None

    def take(self, claim: Claim, seconds: float) -> str:
        """Begin something.

        Args:
            claim: What.
            seconds: How long to wait for the end of what goes on.

        Returns:
            What goes on, so that this may not begin; empty if it may.
        """
        self.append(claim)
        before = self.now
        if before is not None and before is not claim and seconds:
            before.over.wait(seconds)
            before = self.now
        if before in (None, claim):
            return ""
        self.remove(claim)
        return before.doing


def forget_ctrl_c() -> None:
    """Give SIGINT back if nothing goes on; called where the main thread may be."""
    here = threading.current_thread() is threading.main_thread()
    if here and not _going and signal.getsignal(signal.SIGINT) is _on_ctrl_c:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _handle_ctrl_c(*_: object) -> None:
    if _going and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _on_ctrl_c)


def _on_ctrl_c(number: int, frame: FrameType | None) -> None:
    _between_cells(number, frame)
    signal.default_int_handler(number, frame)


def _between_cells(number: int, frame: FrameType | None) -> None:
    # No stop here: the main thread may hold what a stop waits for. What goes on stops the arm within a cycle.
    for claim in tuple(_going):
        claim.ending.interrupted = True


def _outlast_cell() -> None:
    """In a notebook, have its stop button end what goes on between cells and in later ones.

    The kernel gives each cell the default handler, and ignores the button between them. Nothing there waits for a
    KeyboardInterrupt, which would end the kernel.
    """
    find = getattr(sys.modules.get("IPython"), "get_ipython", None)
    shell = None if find is None else find()
    kernel = getattr(shell, "kernel", None)
    if shell is not None and getattr(kernel, "saved_sigint_handler", None) is signal.SIG_IGN:
        kernel.saved_sigint_handler = _between_cells  # type: ignore[union-attr]
        shell.events.register("pre_run_cell", _handle_ctrl_c)
