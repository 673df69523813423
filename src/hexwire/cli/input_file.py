"""A file to read, as an argument of a command.

Owns its opening and its name in errors. Must not know what the file means.
"""

from __future__ import annotations

import sys
from typing import IO, Any

import click

from hexwire.inputs import open_file

__all__ = ["InputFile", "name_of"]


class InputFile(click.File):
    """A file to read, opened once and closed at the end of the command; ``-`` is standard input, perhaps a pipe.

    It is opened with the other arguments: nothing else has been opened, written or moved when it is refused.
    """

    def __init__(self) -> None:
        super().__init__("rb")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> IO[Any]:
        """Open it; raises as `open_file`."""
        if value == "-":
            return sys.stdin.buffer
        file = open_file(value)
        if ctx is not None:
            ctx.call_on_close(file.close)
        return file


def name_of(file: IO[bytes]) -> str:
    """Name for error texts of an `InputFile`."""
    name = getattr(file, "name", None)
    return name if isinstance(name, str) and name != "<stdin>" else "standard input"
