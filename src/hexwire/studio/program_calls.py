"""What the page Move asks of the server about programs: the files, and whether a program may be run.

Owns these calls. The files are in the folder of recordings, which a program plays by their names. A page runs a
program step by step, each a motion that it holds. Must not know sockets, nor decide about motion.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexwire.control.requests.program import Move, Program, check_program, parse_program, read_program
from hexwire.errors import UsageError
from hexwire.inputs import Item
from hexwire.new_file import OutputFile

from .access import Right
from .calls import Arguments, Asked, Named, call

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hexwire.control.requests.preview import Preview
    from hexwire.motion.teach import Taught

__all__: list[str] = []

_NAME = re.compile(r"[^\W_][\w .()+,=@-]{0,80}", re.ASCII)


class _Steps(Arguments, frozen=True):
    steps: list[Any]
    first: int = 1


class _Saved(Arguments, frozen=True):
    name: str
    steps: list[Any]
    force: bool = False


@call("arm.programs", Arguments)
def _list(asked: Asked, args: Arguments) -> list[str]:
    return _names(asked)


def _names(asked: Asked) -> list[str]:
    return [name.removesuffix(".toml") for name in asked.studio.recordings.library.names(".toml")]


@call("arm.program", Named)
def _read(asked: Asked, args: Named) -> list[dict[str, Any]]:
    return read_program(_file(asked, args.name)).rows()


@call("arm.save_program", _Saved, right=Right.OPERATE)
def _save(asked: Asked, args: _Saved) -> list[str]:
    text = _parsed(args.steps).serialize()
    asked.studio.recordings.library.make_folder()
    with OutputFile(_file(asked, args.name), force=args.force) as out:
        out.file.write(text.encode())
    return _names(asked)


@call("arm.remove_program", Named, right=Right.OPERATE)
def _remove(asked: Asked, args: Named) -> list[str]:
    try:
        _file(asked, args.name).unlink()
    except OSError as error:
        raise UsageError(f"the program {args.name} cannot be removed: {error.strerror}") from None
    return _names(asked)


@call("arm.check_program", _Steps, right=Right.OPERATE)
def _check(asked: Asked, args: _Steps) -> list[dict[str, Any]]:
    arm, recordings = asked.arm, asked.studio.recordings
    taught: dict[str, Taught] = {}

    def plan(move: Move, start: Mapping[str, float] | None) -> Preview:
        if move.file and move.file not in taught:
            taught[move.file] = recordings.taught(move.file, None, arm.settings.model.names)
        return arm.motions.plan(move.request, taught.get(move.file), start)

    found = check_program(_parsed(args.steps), plan, args.first)
    return [
        {"number": number, "duration": row.duration, "refusal": row.refusal, "fits": row.fits}
        for number, row in found
    ]


def _parsed(steps: list[Any]) -> Program:
    return parse_program(Item({"steps": steps}, "program"))


def _file(asked: Asked, name: str) -> Path:
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name[:80]!r} cannot be the name of a program: use letters and digits")
    path: Path = asked.studio.recordings.library.folder / f"{name}.toml"
    return path
