"""`make man`: the man pages hexwire(1), hexwire-ros1(1) and hexwire-ros2(1).

    python release/man.py DIR

Owns the form of the pages; the text is that of `--help`: click's commands and options, and the two ROS programs'
own text. A page has neither a date nor a folder in it, so that the same sources give the same bytes.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "src"))

from hexwire.cli import ros1, ros2  # noqa: E402  (only now does Python find it)
from hexwire.cli.main import cli  # noqa: E402

SUMMARY = {
    "hexwire": "control a robot arm, from joint commands down to the bytes on the wire",
    "hexwire-ros1": "ROS 1 node of a robot arm",
    "hexwire-ros2": "ROS 2 node of a robot arm, without ROS",
}
ENVIRONMENT = {
    "HEXWIRE_PORT": "The port of every command that takes --port.",
    "HEXWIRE_TRACE": "Set to 1: as --trace.",
}
STATUS = {"0": "success", "1": "device or line error", "2": "usage error", "130": "interrupted by Ctrl-C"}


def escape(text: str) -> str:
    """Text that roff prints as it is."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("~", "\\(ti").replace("^", "\\(ha")
    return re.sub(r"^(?=[.'])", r"\\&", text, flags=re.M)


def commands(command: click.Command, path: str) -> Iterator[tuple[str, click.Command, click.Context]]:
    """A command and all below it, each with its full name and the context for its help."""
    context = click.Context(command, info_name=path, **command.context_settings)
    yield path, command, context
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from commands(below, f"{path} {name}")


def paragraphs(text: str) -> Iterator[str]:
    """Requests for a help text: click's paragraphs, those that it would not wrap line by line."""
    for number, block in enumerate(re.split(r"\n\s*\n", inspect.cleandoc(text).strip())):
        between = ".PP\n" if number else ""
        kept = block.startswith("\b")
        lines = [line for line in block.splitlines() if line.strip("\b ")]
        if kept:
            yield f"{between}.nf\n" + "\n".join(escape(line) for line in lines) + "\n.fi"
        elif lines:
            yield between + escape(" ".join(line.strip() for line in lines))


def options(command: click.Command, context: click.Context) -> Iterator[str]:
    """A tagged paragraph for each option that `--help` shows."""
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        below = context.info_name != "hexwire" and "--help" in parameter.opts
        if record is not None and isinstance(parameter, click.Option) and not below:
            yield f".TP\n.B {escape(record[0])}\n{escape(' '.join(record[1].split()))}"


def section(path: str, command: click.Command, context: click.Context) -> Iterator[str]:
    """What the page says of one command below `hexwire`."""
    usage = " ".join(command.collect_usage_pieces(context))
    yield f".SS {escape(path)} {escape(usage)}".rstrip()
    yield from paragraphs((command.help or "").partition("\f")[0])
    yield from options(command, context)


def program_page() -> str:
    """The page hexwire(1)."""
    (_, top, context), *rest = commands(cli, "hexwire")
    parts = [
        *head("hexwire"),
        ".SH SYNOPSIS",
        f".B hexwire\n{escape(' '.join(top.collect_usage_pieces(context)))}",
        ".SH DESCRIPTION",
        *paragraphs((top.help or "").partition("\f")[0]),
        ".SH OPTIONS",
        *options(top, context),
        ".SH COMMANDS",
        "Every command also has the option\n.BR \\-\\-help .",
    ]
    for path, command, below in rest:
        parts += section(path, command, below)
    parts.append(".SH EXIT STATUS")
    parts += [f".TP\n.B {number}\n{escape(meaning)}" for number, meaning in STATUS.items()]
    parts.append(".SH ENVIRONMENT")
    parts += [f".TP\n.B {name}\n{escape(meaning)}" for name, meaning in ENVIRONMENT.items()]
    return page([*parts, *see_also("hexwire")])


def node_page(program: str, text: str) -> str:
    """The page of a ROS program, whose help is one text."""
    body = "\n".join(escape(line) for line in text.splitlines())
    return page([*head(program), ".SH DESCRIPTION", f".nf\n{body}\n.fi", *see_also(program)])


def head(program: str) -> list[str]:
    """Title and name."""
    version = re.search(r'^version = "(.*)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    assert version is not None
    title = f'.TH {escape(program.upper())} 1 "" "hexwire {version[1]}" "User commands"'
    return [title, ".SH NAME", f"{escape(program)} \\- {escape(SUMMARY[program])}"]


def see_also(program: str) -> list[str]:
    """References to the other pages."""
    others = [name for name in SUMMARY if name != program]
    return [".SH SEE ALSO", *(f".BR {escape(name)} (1)" + ("," if name != others[-1] else "") for name in others)]


def page(parts: list[str]) -> str:
    """The parts of a page, as a file."""
    return "\n".join(parts) + "\n"


def write(into: Path) -> list[Path]:
    """Write all pages; returns their paths."""
    into.mkdir(parents=True, exist_ok=True)
    texts = {
        "hexwire": program_page(),
        "hexwire-ros1": node_page("hexwire-ros1", ros1.help_text()),
        "hexwire-ros2": node_page("hexwire-ros2", ros2.help_text()),
    }
    for name, text in texts.items():
        (into / f"{name}.1").write_text(text, encoding="utf-8")
    return [into / f"{name}.1" for name in texts]


def main(arguments: list[str] | None = None) -> int:
    """Write the pages; returns the exit status."""
    parser = argparse.ArgumentParser(description="write the man pages")
    parser.add_argument("into", nargs="?", type=Path, default=ROOT / "build/man", metavar="DIR")
    for path in write(parser.parse_args(arguments).into):
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
