"""`fleet router` and `fleet config`: the connection between machines, and the rights in it.

Owns the command lines. `hexwire.fleet.rights` owns the rules, `hexwire.fleet.network` the session.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

from .common import force_option
from .exits import note
from .fleet_options import certificate_options
from .output import say

if TYPE_CHECKING:
    from hexwire.control.shutdown import Shutdown
    from hexwire.fleet.node import Node
    from hexwire.link.certs import CertFacts

__all__ = ["config", "router"]

_FILE = "ZENOH_ROUTER_CONFIG_URI"
"""The environment variable of `rmw_zenoh` for a router's settings."""
_PATIENCE = 5.0
"""Seconds from the signal in which the router must have ended."""
_LOOK = 0.2
"""Seconds between two looks for the end."""


@click.command()
@click.option(
    "--listen",
    multiple=True,
    default=("tcp/127.0.0.1:7447",),
    show_default=True,
    metavar="ENDPOINT",
    help="Where arms and clients connect, as in tls/0.0.0.0:7447; repeatable.",
)
@click.option("--router", "connect", multiple=True, metavar="ENDPOINT", help="Another router to connect to.")
@certificate_options("this router")
@click.option("--access", metavar="FILE", help="Rights by certificate, as 'hexwire fleet config' writes them.")
@click.option(
    "--zenoh-config",
    metavar="FILE",
    help="Zenoh's own settings in JSON5 instead of all other options; without any option, those of the file that "
    "ZENOH_ROUTER_CONFIG_URI names, as for a router of ROS 2. They may let anybody in.",
)
@click.pass_context
def router(
    context: click.Context,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    ca: str,
    cert: str,
    key: str,
    access: str | None,
    reachable_without_certificates: bool,
    zenoh_config: str | None,
) -> None:
    """Relay messages between arms and their clients until Ctrl-C.

    Arms connect with 'hexwire serve --router', clients with 'zenoh:NAME?router='. Nodes of ROS 2 on this machine
    (hexwire-ros2, or any with rmw_zenoh) find its default endpoint without an option. It moves nothing by itself;
    while it is gone, arms go on, and those that a client of it commanded hold.
    """
    from hexwire.control.shutdown import Shutdown
    from hexwire.fleet.network import Network, open_router_file, read_access

    shutdown = Shutdown(_PATIENCE)
    shutdown.listen()
    default = click.core.ParameterSource.DEFAULT
    given = [name for name in context.params if context.get_parameter_source(name) is not default]
    if not given and (named := os.environ.get(_FILE, "").removeprefix("file://")):
        note(f"settings from {named}, which {_FILE} names")
        zenoh_config = named
    if zenoh_config:
        if given not in ([], ["zenoh_config"]):
            raise UsageError("--zenoh-config has all settings of the router; leave out the other options")
        _relay(*open_router_file(zenoh_config), shutdown)
        return
    network = Network(
        listen=listen,
        connect=connect,
        ca=ca,
        cert=cert,
        key=key,
        router=True,
        reachable_without_certificates=reachable_without_certificates,
        access=read_access(access) if access else None,
    )
    if cert:
        _check_certificate(cert)
    _relay(network.open(wait=False), listen, shutdown)


def _relay(node: Node, listen: tuple[str, ...], shutdown: Shutdown) -> None:
    try:
        say(f"passing on at {', '.join(listen)}", flush=True)
        while not shutdown.wait(_LOOK):
            pass
    finally:
        shutdown.request()
        node.close()
    note("the router has ended")


def _check_certificate(cert: str) -> None:
    from hexwire.fleet.address import rights_of
    from hexwire.fleet.rights import Kind

    rights = rights_of(cert)
    if rights is None or rights.kind is not Kind.ROUTER:
        what = f"is for the role {rights}" if rights is not None else "names no role"
        raise UsageError(f"{cert} {what}; a router needs one from 'hexwire cert issue --role router'")


@click.command()
@click.argument("folder", metavar="DIR")
@click.argument("certificates", nargs=-1, metavar="[CERT]...")
@click.option("--output", "-o", metavar="FILE", help="The file to write.  [default: DIR/access.json]")
@force_option
def config(folder: str, certificates: tuple[str, ...], output: str | None, force: bool) -> None:
    """Write the rights of a lab from its certificates: those in DIR, or those named.

    DIR has the authority's certificate, ca.pem. A router or server that is started with --access FILE enforces the
    rights: a certificate that is not in the file gives none. To revoke a certificate, remove it, run this again
    with --force, and restart the router.
    """
    from hexwire.fleet.rights import access_control
    from hexwire.link.certs import AUTHORITY
    from hexwire.new_file import OutputFile

    ca = Path(folder) / f"{AUTHORITY}.pem"
    paths = [Path(name) for name in certificates] or sorted(Path(folder).glob("*.pem"))
    rows, lines = [], []
    for facts in _read(paths, ca, named=bool(certificates)):
        from hexwire.fleet.address import rights_of

        rights = rights_of(str(facts.path))
        if rights is None:
            lines.append(f"{facts.path}: no role, no rights")
            continue
        rows.append((facts.common_name, rights))
        lines.append(f"{facts.path}: {rights}, until {facts.expires:%Y-%m-%d}")
    if not rows:
        raise UsageError(f"{folder} has no certificate with a role; 'hexwire cert issue {folder} NAME' creates one")
    text = json.dumps(access_control(rows), indent=1) + "\n"
    target = Path(output) if output else Path(folder) / "access.json"
    with OutputFile(target, force=force) as file:
        file.file.write(text.encode())
    say(*lines, f"{target}: rights of {len(rows)} certificates")


def _read(paths: list[Path], ca: Path, *, named: bool) -> list[CertFacts]:
    """The certificates that count.

    Raises:
        UsageError: One that was named is of another authority.
    """
    from datetime import UTC, datetime

    from hexwire.link.certs import read_certificate

    found = []
    for path in paths:
        facts = read_certificate(path, ca)
        if facts.authority:
            continue
        if not facts.signed:
            if named:
                raise UsageError(f"{path} was not signed by the authority {ca}")
            note(f"{path} was not signed by the authority {ca}; left out")
        elif facts.expires < datetime.now(UTC):
            note(f"{path} expired on {facts.expires:%Y-%m-%d}; left out")
        else:
            found.append(facts)
    return found
