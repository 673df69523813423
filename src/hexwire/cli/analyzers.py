"""`analyzers`: plug-ins for Wireshark, sigrok and Logic 2 in this user's folders.

Owns the options and the output. Must not know where a program looks for plug-ins.
"""

from __future__ import annotations

from pathlib import Path

import click

from .common import force_option, json_option
from .output import answer, say_table

__all__ = ["analyzers"]

_PROGRAMS = ("wireshark", "sigrok", "saleae")
_NEXT = {
    "wireshark": "start Wireshark again, or press Ctrl-Shift-L; then open a capture of port 15030",
    "sigrok": "start PulseView again; stack 'hexwire host' or 'hexwire servo' on UART",
    "saleae": "in Logic 2: Extensions, Load Existing Extension, {folder}/extension.json",
}
_STATE = {
    "none": "not installed",
    "current": "installed",
    "older": "of another version; install it again",
    "changed": "not as hexwire has written it",
    "partly": "files are missing; install it again",
}

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
def install(program: str, folder: str | None, force: bool, as_json: bool) -> None:
    """Install the plug-in for PROGRAM, or bring it up to date.

    A file that hexwire has not written stays as it is, and nothing is installed, unless --force is given.
    """
    from hexwire.trace import analyzers as plugins

    where = _folder(program, folder)
    files = plugins.install(program, where, force=force)
    value = {"program": program, "folder": str(where), "files": [str(path) for path in files]}
    answer(as_json, value, *map(str, files), _NEXT[program].format(folder=where))


@analyzers.command("list")
@json_option
def list_(as_json: bool) -> None:
    """Show which plug-ins are installed, and where."""
    from hexwire.trace import analyzers as plugins

    found = [plugins.status(program, _folder(program, None)) for program in _PROGRAMS]
    if as_json:
        rows = [{"program": row.program, "folder": str(row.folder), "state": row.state} for row in found]
        answer(True, rows)
        return
    say_table(("program", "state", "folder"), [(r.program, _STATE[r.state], str(r.folder)) for r in found])


@analyzers.command()
@program_argument
@folder_option
@force_option
@json_option
def remove(program: str, folder: str | None, force: bool, as_json: bool) -> None:
    """Remove the plug-in for PROGRAM. Files that were changed since stay, unless --force is given."""
    from hexwire.trace import analyzers as plugins

    removed, kept = plugins.remove(program, _folder(program, folder), force=force)
    lines = [f"removed {path}" for path in removed] + [f"kept {path}: it was changed" for path in kept]
    value = {"removed": [str(path) for path in removed], "kept": [str(path) for path in kept]}
    answer(as_json, value, *(lines or ["there is nothing to remove"]))


def _folder(program: str, given: str | None) -> Path:
    from hexwire.trace.analyzers import default_folder

    return default_folder(program) if given is None else Path(given).absolute()
