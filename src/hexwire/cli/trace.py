"""`hexwire trace decode`, and the output of `--trace` and `--explain`.

Owns arguments and printing. `hexwire.trace` decodes the bytes.
"""

from __future__ import annotations

import errno
import math
import select
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO

import click

from hexwire.inputs import read_stream
from hexwire.ipc.own_modules import load_own_modules
from hexwire.link.base import Link
from hexwire.link.tap import Direction, Missed, Passed, TapLink, wrap_new_links
from hexwire.trace.chapter_log import format_passed, format_positions
from hexwire.trace.explain import Explained, Explainer
from hexwire.trace.sources import LARGEST, read_traffic

from .common import observing_states
from .exits import speak, tell_missed
from .input_file import InputFile, name_of
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.trace.parts import Part
    from hexwire.trace.reading import Reading

__all__ = ["trace", "tracing"]

_INDENT = "    "
_PATIENCE = 100
"""Milliseconds to wait for a slow reader of the trace."""
_LONGEST = getattr(select, "PIPE_BUF", 512) // 4
"""Maximum number of characters in a line, at up to four bytes each."""


@contextmanager
def tracing(*, explain: bool) -> Iterator[None]:
    """In this context, the traffic of every new link and every state that is read are printed on standard error.

    Lines that cannot be printed are counted and reported at the end, in one line; the command continues.
    """
    # Names for the modules in frames.
    load_own_modules()
    missed = Missed()
    listener = _Listener()

    def show_state(robot: RobotDriver, state: JointState) -> None:
        degrees = [math.degrees(angle) for angle in state.position]
        for line in format_positions(state.names, degrees, name=robot.model.name):
            listener.tell(line)

    def wrap(link: Link) -> Link:
        return TapLink(link, missed.guard(_printer(explain, listener)))

    try:
        with wrap_new_links(wrap), observing_states(missed.guard(show_state)):
            yield
    finally:
        if listener.is_ready():
            tell_missed("the trace", missed)


def _printer(explain: bool, listener: _Listener) -> Callable[[Passed], None]:
    explainer = Explainer()
    start: list[float] = []

    def show(passed: Passed) -> None:
        if not start:
            start.append(passed.time)
        name = "SerialPort" if passed.url.startswith("serial") else passed.url.partition(":")[0].capitalize()
        lines = list(format_passed(passed, name=name, start=start[0]))
        if explain:
            # Decode everything, even if it cannot be printed: the decoding of later traffic needs the earlier.
            for explained in list(explainer.feed(passed)):
                lines += [_INDENT + line for line in _lines(explained)]
        for line in lines:
            listener.tell(line)

    return show


class _Listener:
    """Standard error, which may be closed or not read: writing to it waits only for a moment.

    A pager that is not scrolled leaves its pipe full. Waiting for it would delay the arm's next set-point.
    """

    def __init__(self) -> None:
        self._gone: OSError | None = None
        self._patience = _PATIENCE

    def is_ready(self) -> bool:
        """Whether a line can be written at once; waits a moment, but only the first time in a row."""
        try:
            number = sys.stderr.fileno()
        except (OSError, ValueError):  # not a file: a test's or another program's own stream
            return True
        if sys.platform == "win32" or not hasattr(select, "poll"):
            # There is no way to ask.
            return True
        look = select.poll()
        look.register(number, select.POLLOUT)
        ready = bool(look.poll(self._patience))
        self._patience = _PATIENCE if ready else 0
        return ready

    def tell(self, line: str) -> None:
        """Write a line.

        Raises:
            OSError: It cannot be written, or nothing reads standard error.
        """
        if self._gone is not None:
            raise self._gone
        if not self.is_ready():
            raise BlockingIOError(errno.EAGAIN, "nothing reads standard error")
        try:
            # A pipe that is ready accepts this many bytes at once.
            speak(line[:_LONGEST])
        except OSError as error:
            self._gone = error
            raise


def _lines(explained: Explained) -> Iterator[str]:
    if explained.problem:
        yield f"! {explained.problem}"
    if not explained.layers:
        yield explained.text
    for layer in explained.layers:
        yield f"{layer.name:8} {layer.text}"


@click.group()
def trace() -> None:
    """Decode recorded traffic."""


@trace.command()
@click.argument("file", type=InputFile())
@click.option("--fields", is_flag=True, help="Print every field with the place of its bytes in the frame.")
@click.option("--json", "as_json", is_flag=True, help="Print one line per frame, with the fields of every layer.")
def decode(file: BinaryIO, fields: bool, as_json: bool) -> None:
    """Decode FILE (- for standard input): a log of the chapter, a hex dump, a raw capture, a recording, pcapng.

    Corrupt parts are shown where they occur, with the reason, and decoding continues after them.
    """
    from hexwire.trace.dissect import Dissector

    load_own_modules()
    explainer = Explainer()
    dissector = Dissector() if fields else None

    def show(readings: Iterable[Reading]) -> None:
        for reading in readings:
            tree = dissector.dissect(reading) if dissector is not None else None
            _show(explainer.explain(reading), tree, as_json)

    name = name_of(file)
    for item in read_traffic(read_stream(file, name, largest=LARGEST), name):
        if isinstance(item, str):
            _remark(item, as_json)
            continue
        show(explainer.lines.feed(item))
    show(explainer.lines.finish())


def _remark(text: str, as_json: bool) -> None:
    if as_json:
        print_json({"kind": "remark", "text": text}, one_line=True)
    else:
        say(f"! {text}")


def _show(explained: Explained, tree: Part | None, as_json: bool) -> None:
    if as_json:
        print_json(explained.as_fields() | ({"tree": tree.as_fields()} if tree is not None else {}), one_line=True)
        return
    arrow = "->" if explained.direction is Direction.SENT else "<-"
    stamp = f"{explained.time:.6f} " if explained.time else ""
    say(f"{stamp}{arrow} {explained.kind}, {len(explained.data)} bytes: {explained.data.hex(' ').upper()}")
    for line in _lines(explained) if tree is None else _field_lines(explained, tree):
        say(_INDENT + line)


def _field_lines(explained: Explained, tree: Part) -> Iterator[str]:
    """Every part of a frame: first and last byte, name, value."""
    if tree.problem:
        yield f"! {tree.problem}"
    for depth, part in tree.rows():
        if depth:
            place = f"{part.start}" if part.end == part.start + 1 else f"{part.start}-{part.end - 1}"
            problem = f" ! {part.problem}" if part.problem else ""
            yield f"{place:>9} {'  ' * (depth - 1)}{part.name}: {part.words}".rstrip(": ") + problem
    yield from (f"pairing  {layer.text}" for layer in explained.layers if layer.name == "pairing")
