"""Verbose mode: the traffic of links, printed while it passes, in the layout of the chapter's log.

Owns the thread that decodes and prints, so that a line waits for a slow stream 0.1 s at most, once, and 1 s at its
end; and what happens if the stream is slow, closed or broken: lines are left out and counted. Must not know
commands or robots.
"""

from __future__ import annotations

import errno
import math
import os
import select
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TextIO
from weakref import WeakSet

from hexwire.link.base import Link
from hexwire.link.tap import TRACE_VARIABLE, Direction, Missed, Passed, TapLink, wrap_every_link
from hexwire.system import next_within

from .chapter_log import format_passed, format_positions
from .explain import Explained, Explainer
from .reading import FrameReading

if TYPE_CHECKING:
    from hexwire.model.state import JointState

__all__ = ["Tracer", "explained_lines", "process_tracer", "trace_this_process"]

_INDENT = "    "
_OFF = ("", "0", "f", "false", "n", "no", "off")
"""Values of `TRACE_VARIABLE` that switch it off, as for the command line."""
_PATIENCE = 0.1
"""Seconds to wait for a slow stream, the first time."""
_LAST_PATIENCE = 1.0
"""Seconds to wait for it at the end, or for its next line."""
_IDLE = 0.5
"""Seconds without traffic after which an incomplete frame is printed as it is."""
_MOST = 1000
"""Transfers that wait to be printed."""
_LONGEST = getattr(select, "PIPE_BUF", 512) // 4
"""Maximum number of characters in a line, at up to four bytes each: a pipe that is ready accepts them at once."""


_TRACERS: WeakSet[Tracer] = WeakSet()


class Tracer:
    """Prints one block for each frame or servo packet of the links that it taps, however they were read.

    A thread decodes and prints. Whoever moves the bytes waits a moment for it, so that the print is there when the
    call returns; but never again once the stream was too slow for that.

    Args:
        stream: Where to print; standard error at that moment if None.
        explain: Print what each frame means, too.
        speak: Prints a line on the stream; if None, the stream's `write`.

    Attributes:
        missed: What could not be decoded or printed.
        explain: Whether it prints what each frame means, too.
    """

    def __init__(
        self, stream: TextIO | None = None, *, explain: bool = False, speak: Callable[[str], None] | None = None
    ) -> None:
        self.missed = Missed()
        self.explain = explain
        self._stream, self._speak = stream, speak or self._write
        self._ready_patience = _PATIENCE
        self._start: float | None = None
        self._gone: Exception | None = None
        self._printed = 0
        self._begin()
        _TRACERS.add(self)

    def _begin(self) -> None:
        """Begin without traffic and without a thread, as a forked process does: it has neither of its parent's."""
        self._queue: SimpleQueue[tuple[Callable[[], Iterable[str]] | None, threading.Event]] = SimpleQueue()
        self._patience = _PATIENCE
        self._dropped = self._unprinted = 0
        self._links: list[_TracedLink] = []
        # At most one. A signal handler may come between a look for it and its start; a dict does both at once.
        self._threads: dict[str, threading.Thread] = {}
        # Re-entrant: a signal handler may stop the arm, and be traced, at any line.
        self._lock = threading.RLock()

    def tap(self, link: Link) -> Link:
        """The link, traced by this tracer and by no other."""
        return _TracedLink(link.link if isinstance(link, _TracedLink) else link, self)

    def state(self, robot: Any, state: JointState) -> None:
        """Print the joint positions that a robot has read, as that log has them."""
        degrees = [math.degrees(angle) for angle in state.position]
        self._put(lambda: format_positions(state.names, degrees, name=robot.model.name))

    def finish(self) -> None:
        """Print what is incomplete and what waits, as long as the stream takes lines."""
        done = self._end()
        while done is not None and not done.is_set():
            before = self._printed
            if not done.wait(_LAST_PATIENCE) and self._printed == before:
                self.missed.add(TimeoutError(errno.ETIMEDOUT, "the stream is too slow"))
                return

    # -- in the threads that move bytes ---------------------------------------------------------------

    def _opened(self, link: _TracedLink) -> None:
        with self._lock:
            self._links.append(link)

    def _closed(self, link: _TracedLink) -> None:
        with self._lock:
            self._links = [one for one in self._links if one is not link]
            last = not self._links
        self._put(link.given_up)
        done = self._end() if last else None
        if done is not None:
            done.wait(self._patience and _LAST_PATIENCE)

    def _put(self, lines: Callable[[], Iterable[str]]) -> bool:
        """Have lines made and printed; False if there is no room for them."""
        done = threading.Event()
        with self._lock:
            if self._queue.qsize() >= _MOST:
                self.missed.add(BlockingIOError(errno.EAGAIN, "the stream is too slow"))
                self._dropped += 1
                return False
            self._tell_gap()
            self._queue.put((lines, done))
            if not self._threads:
                new = threading.Thread(target=self._run, name="trace", daemon=True)
                if self._threads.setdefault("trace", new) is new:
                    new.start()
        if self._patience and not done.wait(self._patience):
            self._patience = 0.0
        return True

    def _end(self) -> threading.Event | None:
        """Have the thread end once it has printed everything."""
        with self._lock:
            if not self._threads:
                return None
            self._tell_gap()
            done = threading.Event()
            self._queue.put((None, done))
            return done

    def _tell_gap(self) -> None:
        if self._dropped:
            gap, self._dropped = _gap(self._dropped), 0
            self._queue.put((lambda: [gap], threading.Event()))

    # -- in the thread that prints ----------------------------------------------------------------------

    def _run(self) -> None:
        work = self.missed.guard(self._print)
        while True:
            try:
                lines, done = next_within(self._queue, _IDLE)
            except Empty:
                for link in list(self._links):
                    work(link.given_up)
                continue
            if lines is not None:
                work(lines)
            else:
                with self._lock:
                    if self._queue.empty():
                        self._threads.clear()
                        done.set()
                        return
            done.set()

    def _print(self, make: Callable[[], Iterable[str]]) -> None:
        """Make lines and print them.

        Raises:
            OSError: They cannot be printed at once; or whatever a stream raised, once.
        """
        # They are made even if they cannot be printed: the decoding of later traffic needs the earlier.
        lines = list(make())
        if lines and self._unprinted:
            lines.insert(0, _gap(self._unprinted))
        try:
            for line in lines:
                if self._gone is not None:
                    raise self._gone
                if not self.is_ready():
                    raise BlockingIOError(errno.EAGAIN, "nothing reads the stream")
                self._speak(line[:_LONGEST])
                self._unprinted, self._printed = 0, self._printed + 1
        except Exception as error:
            self._unprinted += 1
            if not isinstance(error, BlockingIOError):
                # A stream that failed once gets nothing more.
                self._gone = error
            raise

    def is_ready(self) -> bool:
        """Whether a line can be written at once; waits a moment, but only the first time in a row.

        A pager that is not scrolled leaves its pipe full. A thread that waits in its `write` would hold up the end
        of the program.
        """
        try:
            number = (self._stream or sys.stderr).fileno()
        except (AttributeError, OSError, ValueError):  # not a file: a program's own stream
            return True
        if sys.platform == "win32" or not hasattr(select, "poll"):
            # There is no way to ask.
            return True
        look = select.poll()
        look.register(number, select.POLLOUT)
        ready = bool(look.poll(1000 * self._ready_patience))
        self._ready_patience = _PATIENCE if ready else 0.0
        return ready

    def _write(self, line: str) -> None:
        stream = self._stream or sys.stderr
        stream.write(line + "\n")
        stream.flush()

    def block(self, passed: Passed) -> Iterator[str]:
        """The lines of one frame, with the seconds since the first one of all links."""
        if self._start is None:
            self._start = passed.time
        name = "SerialPort" if passed.url.startswith("serial") else passed.url.partition(":")[0].capitalize()
        yield from format_passed(passed, name=name, start=self._start)


def _forked() -> None:
    for tracer in tuple(_TRACERS):
        # A lock that another thread of the parent held would never be free here.
        tracer._begin()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


class _TracedLink(TapLink):
    """A link whose traffic a tracer prints."""

    def __init__(self, link: Link, tracer: Tracer) -> None:
        super().__init__(link, self._passed)
        self._tracer = tracer
        self._explainer = Explainer()
        self._gap, self._heard = False, 0.0

    def open(self) -> None:
        super().open()
        self.missed.guard(self._tracer._opened)(self)

    def close(self) -> None:
        super().close()
        self.missed.guard(self._tracer._closed)(self)

    def _passed(self, passed: Passed) -> None:
        if not self._tracer._put(lambda: self._lines(passed)):
            self._gap = True

    def _lines(self, passed: Passed) -> Iterator[str]:
        if self._gap:
            # Transfers are missing: the next ones complete no frame from before.
            self._gap, self._explainer = False, Explainer()
        self._heard = passed.time
        yield from self._blocks(self._explainer.lines.feed(passed))

    def given_up(self) -> Iterator[str]:
        """The lines of what is incomplete."""
        for way in Direction:
            yield from self._blocks(self._explainer.lines.silence(way, self._heard))

    def _blocks(self, found: Iterable[FrameReading]) -> Iterator[str]:
        for reading in found:
            yield from self._tracer.block(Passed(reading.way, reading.data, reading.time, self.url))
            if self._tracer.explain:
                yield from (_INDENT + line for line in explained_lines(self._explainer.explain(reading)))


def _gap(times: int) -> str:
    return f"! {times} times, lines are left out here: nothing read them in time"


def explained_lines(explained: Explained) -> Iterator[str]:
    """What a frame means: a line for its problem, if there is one, and one for each layer."""
    if explained.problem:
        yield f"! {explained.problem}"
    if not explained.layers:
        yield explained.text
    for layer in explained.layers:
        yield f"{layer.name:8} {layer.text}"


_process: list[Tracer] = []


def process_tracer() -> Tracer | None:
    """The tracer of every new link of this program, if HEXWIRE_TRACE has asked for it."""
    return _process[0] if _process else None


def trace_this_process() -> None:
    """Trace every link that this program makes from now on; see `TRACE_VARIABLE`."""
    if not _process and os.environ.get(TRACE_VARIABLE, "").lower() not in _OFF:
        _process.append(Tracer())
        wrap_every_link(_process[0].tap)
