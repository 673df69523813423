"""`conf`: check and convert channel configuration files.

Owns the presentation of channels and the choice of the file format. Must not know what a channel means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.new_file import OutputFile

from .common import force_option, json_option
from .output import print_json, say, say_document, say_table

if TYPE_CHECKING:
    from hexwire.ipc.channel import ChannelConf

__all__ = ["conf"]


@click.group()
def conf() -> None:
    """Check and convert channel configuration files: ipc_msg.conf, or the same in TOML."""


@conf.command()
@click.argument("file", metavar="FILE")
@json_option
def check(file: str, as_json: bool) -> None:
    """Show the channels in a file; errors name file, line and column."""
    from hexwire.ipc.conf import link_url, load_conf

    channels = load_conf(file)
    if as_json:
        print_json([_as_json(channel) | {"url": link_url(channel)} for channel in channels])
        return
    if channels:
        _say_table(channels)
        say()
    say(f"{file}: {len(channels)} channel{'s' if len(channels) != 1 else ''}, no error")


@conf.command()
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@force_option
def convert(source: str, target: str, force: bool) -> None:
    """Write the channels of IN to OUT: TOML if OUT ends in .toml, the chapter's format otherwise.

    Comments are lost. OUT may be - for standard output, which gets the format that IN does not have.
    """
    from hexwire.ipc.conf import load_conf, to_conf, to_toml

    channels = load_conf(source)
    wanted = Path(target).suffix if target != "-" else ("" if Path(source).suffix == ".toml" else ".toml")
    text = to_toml(channels) if wanted == ".toml" else to_conf(channels)
    if target == "-":
        say_document(text)
        return
    with OutputFile(target, force=force) as out:
        out.file.write(text.encode())


def _say_table(channels: Sequence[ChannelConf]) -> None:
    from hexwire.ipc.conf import link_url

    rows = [
        (str(c.line or "-"), c.module.name, c.direction.value, c.destination.name, c.interface.name, link_url(c))
        for c in channels
    ]
    say_table(("line", "module", "direction", "destination", "interface", "opens"), rows)


def _as_json(channel: ChannelConf) -> dict[str, object]:
    fields = asdict(channel)
    return fields | {
        "module": channel.module.name,
        "direction": channel.direction.value,
        "destination": channel.destination.name,
        "interface": channel.interface.name,
        "peer": channel.peer or None,
        "line": channel.line or None,
    }
