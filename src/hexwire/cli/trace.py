"""`hexwire trace decode`, and the output of `--trace` and `--explain`.

Owns arguments and printing. `hexwire.trace` decodes the bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO

import click

from hexwire.inputs import read_stream
from hexwire.ipc.channel import load_own_modules
from hexwire.link.tap import Direction, wrap_new_links
from hexwire.trace.explain import Explained, Explainer
from hexwire.trace.live import Tracer, explained_lines
from hexwire.trace.sources import LARGEST, read_traffic

from .common import observing_states
from .exits import speak, tell_missed
from .input_file import InputFile, name_of
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.trace.parts import Part
    from hexwire.trace.reading import Reading

__all__ = ["trace", "tracing"]

_INDENT = "    "


@contextmanager
def tracing(*, explain: bool) -> Iterator[None]:
    """In this context, the traffic of every new link and every state that is read are printed on standard error.

    Lines that cannot be printed are counted and reported at the end, in one line; the command continues.
    """
    # Names for the modules in frames.
    load_own_modules()
    tracer = Tracer(explain=explain, speak=speak)
    try:
        with wrap_new_links(tracer.tap), observing_states(tracer.state):
            yield
    finally:
        tracer.finish()
        if tracer.is_ready():
            tell_missed("the trace", tracer.missed)


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
    for line in explained_lines(explained) if tree is None else _field_lines(explained, tree):
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
