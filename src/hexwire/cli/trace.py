"""Traffic in words: `trace decode`, the output of `--trace` and `--explain`, and `analyzers` for other programs.

Owns arguments and printing. `hexwire.trace` decodes the bytes, and knows where a program looks for plug-ins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from hexwire.inputs import read_stream
from hexwire.ipc.channel import load_own_modules
from hexwire.link.tap import Direction, wrap_new_links
from hexwire.trace import analyzers as plugins
from hexwire.trace.explain import Explained, Explainer, Part
from hexwire.trace.live import Tracer, explained_lines
from hexwire.trace.sources import LARGEST, read_traffic

from .exits import speak, tell_missed
from .options import InputFile, force_option, json_option, name_of, observing_states
from .output import Column, RowType, answer, print_json, say, wants_json

if TYPE_CHECKING:
    from hexwire.trace.reading import FrameReading

__all__ = ["analyzers", "trace", "tracing"]

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
@partial(json_option, words="Print one line per frame, with the fields of every layer.")
def decode(file: BinaryIO, fields: bool) -> None:
    """Decode FILE (- for standard input): a log of the chapter, a hex dump, a raw capture, a recording, pcapng.

    Corrupt parts are shown where they occur, with the reason, and decoding continues after them.
    """
    load_own_modules()
    explainer = Explainer()

    def show(readings: Iterable[FrameReading]) -> None:
        for reading in readings:
            tree = explainer.dissect(reading) if fields else None
            _show(explainer.explain(reading), tree)

    name = name_of(file)
    for item in read_traffic(read_stream(file, name, largest=LARGEST), name):
        if isinstance(item, str):
            if wants_json():
                print_json({"kind": "remark", "text": item}, one_line=True)
            say(f"! {item}")
            continue
        show(explainer.lines.feed(item))
    show(explainer.lines.finish())


def _show(explained: Explained, tree: Part | None) -> None:
    if wants_json():
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


_PROGRAMS = ("wireshark", "sigrok", "saleae")
_NEXT = {
    "wireshark": "start Wireshark again, or press Ctrl-Shift-L; then open a capture of port 15030",
    "sigrok": "start PulseView again; stack 'hexwire host' or 'hexwire servo' on UART",
    "saleae": "in Logic 2: Extensions, Load Existing Extension, {folder}/extension.json",
}
_STATE: dict[str, str] = {
    "none": "not installed",
    "current": "installed",
    "older": "of another version; install it again",
    "changed": "not as hexwire has written it",
    "partly": "files are missing; install it again",
}

_PLUGINS: RowType[plugins.Installed] = RowType(
    Column("program", "program"),
    Column("folder", get=lambda row: str(row.folder)),
    Column("state", "state", text=lambda row: _STATE[row.state]),
    Column("", "folder", text=lambda row: str(row.folder)),
)
program_argument = click.argument("program", type=click.Choice(_PROGRAMS))
folder_option = click.option(
    "--folder", type=click.Path(file_okay=False), metavar="DIR", help="Folder to use instead of the user's own."
)


@click.group()
def analyzers() -> None:
    """Install plug-ins that show the wire in Wireshark, sigrok (PulseView) and Saleae Logic 2."""


@analyzers.command()
@program_argument
@folder_option
@force_option
@json_option
def install(program: str, folder: str | None, force: bool) -> None:
    """Install the plug-in for PROGRAM, or bring it up to date.

    A file that hexwire has not written stays as it is, and nothing is installed, unless --force is given.
    """
    where = _folder(program, folder)
    files = plugins.install(program, where, force=force)
    value = {"program": program, "folder": str(where), "files": [str(path) for path in files]}
    answer(value, *map(str, files), _NEXT[program].format(folder=where))


@analyzers.command("list")
@json_option
def list_() -> None:
    """Show which plug-ins are installed, and where."""
    _PLUGINS.show([plugins.status(program, _folder(program, None)) for program in _PROGRAMS])


@analyzers.command()
@program_argument
@folder_option
@force_option
@json_option
def remove(program: str, folder: str | None, force: bool) -> None:
    """Remove the plug-in for PROGRAM. Files that were changed since stay, unless --force is given."""
    removed, kept = plugins.remove(program, _folder(program, folder), force=force)
    lines = [f"removed {path}" for path in removed] + [f"kept {path}: it was changed" for path in kept]
    value = {"removed": [str(path) for path in removed], "kept": [str(path) for path in kept]}
    answer(value, *(lines or ["there is nothing to remove"]))


def _folder(program: str, given: str | None) -> Path:
    return plugins.default_folder(program) if given is None else Path(given).absolute()
