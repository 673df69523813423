"""`fleet`: the group of commands for many shared arms.

Owns the names of its commands. Must not know what a command does.
"""

from __future__ import annotations

import click

from .lazy import LazyGroup

__all__ = ["COMMANDS", "fleet"]

COMMANDS: dict[str, tuple[str, str]] = {
    "config": ("hexwire.cli.fleet_router:config", "Write the rights of a lab from its certificates."),
    "list": ("hexwire.cli.fleet_ops:list_arms", "List the arms that this program may see."),
    "play": ("hexwire.cli.fleet_play:play", "Play a motion on several arms, with a common start."),
    "record": ("hexwire.cli.fleet_play:record", "Record all arms in one file."),
    "router": ("hexwire.cli.fleet_router:router", "Relay messages between arms and their clients."),
    "stop": ("hexwire.cli.fleet_ops:stop", "Stop many arms at once."),
    "watch": ("hexwire.cli.fleet_ops:watch", "Follow the arms until interrupted."),
}
"""Name -> location of the command (module:attribute) and its one-line help."""


@click.group(cls=LazyGroup, table=COMMANDS)
def fleet() -> None:
    """Many shared arms: see, stop, record and play them at once; the router, and rights by certificate.

    The arms are those that 'hexwire serve' of this user shares on this machine, and those behind the router that
    --router or the file in HEXWIRE_FLEET names.
    """
