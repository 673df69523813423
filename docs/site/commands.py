"""The reference of the command line, from click: every command with all of its arguments and options.

Owns the wording around what the commands say of themselves. Must not know any command.
"""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Iterator

import click

from hexwire.cli import ros1, ros2
from hexwire.cli.main import cli

__all__ = ["every_command", "pages"]

FOLDER = "reference/commands"
_WIDE = 30
"""Characters of an option that fit a narrow column."""
_NODES = {"hexwire-ros1": ros1, "hexwire-ros2": ros2}


def every_command() -> Iterator[tuple[tuple[str, ...], click.Command, click.Context]]:
    """Each command and group, with its words and its context; the program itself first."""
    yield from _below(cli, ("hexwire",), None)


def _below(
    command: click.Command, words: tuple[str, ...], parent: click.Context | None
) -> Iterator[tuple[tuple[str, ...], click.Command, click.Context]]:
    context = click.Context(command, info_name=words[-1], parent=parent, **command.context_settings)
    yield words, command, context
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from _below(below, (*words, name), context)


def pages() -> dict[str, str]:
    """Page of the site -> its text."""
    made: dict[str, list[str]] = {}
    rows: list[str] = []
    for words, command, context in every_command():
        if len(words) == 1:
            top = _command(words, command, context, 2)
            continue
        page = f"{FOLDER}/{words[1]}.md"
        level = len(words) - 1
        made.setdefault(page, []).append(_command(words, command, context, level))
        if level == 1:
            rows.append(f"| [`{words[1]}`]({words[1]}.md) | {_cell(command.get_short_help_str(200))} |")
    for name, module in _NODES.items():
        made[f"{FOLDER}/{name}.md"] = [_node(name, module.help_text())]
        rows.append(f"| [`{name}`]({name}.md) | {_cell(module.__doc__.splitlines()[0].partition(': ')[2])} |")
    index = [
        "# Command line",
        "",
        "Every command and option, as `--help` shows them. The exit status is 0 on success, 1 for an error of the",
        "device or the line, and 2 for a wrong use; nothing was sent then. [Errors](../errors/index.md) lists what",
        "the commands say when something fails.",
        "",
        "| command | does |",
        "|---|---|",
        *rows,
        "",
        top,
    ]
    return {f"{FOLDER}/index.md": "\n".join(index), **{page: "\n".join(parts) for page, parts in made.items()}}


def _command(words: tuple[str, ...], command: click.Command, context: click.Context, level: int) -> str:
    lines = [f"{'#' * level} {' '.join(words)}", "", _paragraphs(command.help or ""), ""]
    pieces = " ".join(command.collect_usage_pieces(context))
    lines += ["```text", f"{' '.join(words)} {pieces}", "```", ""]
    # The names of arguments are in the usage; what they mean is in the text.
    options = [one for one in command.params if isinstance(one, click.Option)]
    shown = [(one, record) for one in options if (record := one.get_help_record(context)) is not None]
    if shown:
        lines += ["| option | meaning |", "|---|---|"]
        for option, (names, text) in shown:
            known = option.envvar if isinstance(option.envvar, str) and not option.show_envvar else ""
            variable = f" [env var: `{known}`]" if known else ""
            if len(names) > _WIDE and (choices := re.search(r" \[([\w|-]+)\]$", names)):
                names = names[: choices.start()]
                variable = f" One of {', '.join(f'`{one}`' for one in choices[1].split('|'))}.{variable}"
            lines.append(f"| {_names(names)} | {_cell(text)}{variable} |")
        lines.append("")
    if isinstance(command, click.Group):
        for name in command.list_commands(context) if len(words) > 1 else ():
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                anchor = "-".join((*words, name))
                lines.append(
                    f"- [`{' '.join((*words[1:], name))}`](#{anchor}): {_text(below.get_short_help_str(200))}"
                )
        lines.append("")
    return "\n".join(lines)


def _node(name: str, text: str) -> str:
    return f"# {name}\n\n```text\n{text.rstrip()}\n```\n"


def _names(names: str) -> str:
    """The spellings of an option, each in code."""
    return "<br>".join(f"`{one.strip()}`" for one in re.split(r",\s+(?=-)| / ", names))


def _paragraphs(text: str) -> str:
    """A command's help: its paragraphs, and as they are those that it keeps from being filled."""
    parts = []
    for part in textwrap.dedent(text.replace("\b\n", "\b")).split("\n\n"):
        if part.startswith("\b"):
            parts.append("```text\n" + textwrap.dedent(part[1:]).rstrip() + "\n```")
        else:
            parts.append(_text(" ".join(part.split())))
    return "\n\n".join(parts)


def _text(text: str) -> str:
    """Plain text as Markdown that shows it unchanged; what stands in single quotes is code."""
    text = re.sub(r"(?<![\w`])'((?:hexwire|--|-)[^']*)'", r"`\1`", text)
    text = "".join(
        piece if piece.startswith("`") else re.sub(r"(?<![\w-])--[a-z][\w-]*", r"`\g<0>`", piece)
        for piece in re.split(r"(`[^`]*`)", text)
    )
    pieces = re.split(r"(`[^`]*`)", text)
    return "".join(piece if piece.startswith("`") else _plain(piece) for piece in pieces)


def _plain(text: str) -> str:
    return re.sub(r"([\\*_\[\]])", r"\\\1", html.escape(text, quote=False))


def _cell(text: str) -> str:
    pieces = re.split(r"(`[^`]*`)", _text(" ".join(text.split())))
    return "".join(piece if piece.startswith("`") else piece.replace("|", "\\|") for piece in pieces)
