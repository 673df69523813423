"""`fleet`: the group of commands for many shared arms.

Owns the names of its commands; each is imported when it is used. Must not know what a command does.
"""

from __future__ import annotations

import importlib

import click

__all__ = ["COMMANDS", "fleet"]

COMMANDS: dict[str, tuple[str, str]] = {
    "config": ("hexwire.cli.fleet_router:config", "Write the rights of a lab from its certificates."),
    "list": ("hexwire.cli.fleet_ops:list_arms", "List the arms that this program may see."),
    "play": ("hexwire.cli.fleet_play:play", "Play a motion on several arms, with a common start."),
    "record": ("hexwire.cli.fleet_play:record", "Record all arms in one file."),
    "router": ("hexwire.cli.fleet_router:router", "Pass on between arms and their clients."),
    "stop": ("hexwire.cli.fleet_ops:stop", "Stop many arms at once."),
    "watch": ("hexwire.cli.fleet_ops:watch", "Follow the arms until interrupted."),
}
"""Name -> location of the command (module:attribute) and its one-line help."""


class _Group(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])


@click.group(cls=_Group)
def fleet() -> None:
    """Many shared arms: see, stop, record and play them at once; the router, and rights by certificate.

    The arms are those that 'hexwire serve' of this user shares on this machine, and those behind the router that
    --router or the file in HEXWIRE_FLEET names.
    """
