"""`serve`: share arms with other programs and machines.

Owns the command line, the file with several arms, and the shutdown. Must not know how an arm is shared.
"""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import UsageError

from .common import DEFAULT_ROBOT, early_port, number_option
from .exits import note
from .output import say

if TYPE_CHECKING:
    from hexwire.fleet.network import Network

__all__ = ["serve"]

_PATIENCE = 12.0
"""Seconds from the signal in which all arms must be safe."""
_LOOK = 0.2
"""Seconds between two checks of the arms."""
_SWITCH = 0.001
"""Seconds for which one thread may run while others wait: the owner of an arm waits for no answer to a client."""


@click.command()
@click.option("--robot", metavar="NAME", help=f"Type of robot; sim: an emulated one.  [default: {DEFAULT_ROBOT}]")
@click.option("--port", metavar="URL", envvar="HEXWIRE_PORT", show_envvar=True, help="Device or link of the robot.")
@click.option("--name", metavar="NAME", help="Name to share it under, such as lab/arm1.  [default: its model]")
@click.option("--config", "file", metavar="FILE", help="A file with several arms, and the settings of the network.")
@click.option("--listen", multiple=True, metavar="ENDPOINT", help="Also listen there, as in tls/0.0.0.0:7447.")
@click.option("--router", multiple=True, metavar="ENDPOINT", help="Also connect to this router.")
@click.option("--ca", metavar="FILE", help="Certificate of the lab's authority, for tls endpoints.")
@click.option("--cert", metavar="FILE", help="Certificate of this arm.")
@click.option("--key", metavar="FILE", help="Its key.")
@click.option("--access", metavar="FILE", help="Rights by certificate, as 'hexwire fleet config' writes them.")
@click.option(
    "--reachable-without-certificates",
    is_flag=True,
    help="Allow tcp endpoints beyond this machine: anybody there can then move the arm.",
)
@number_option("--lease", "SECONDS", "Silence after which a lease is lost.", minimum=0.1, default=0.5)
def serve(
    robot: str | None,
    port: str | None,
    name: str | None,
    file: str | None,
    listen: tuple[str, ...],
    router: tuple[str, ...],
    ca: str | None,
    cert: str | None,
    key: str | None,
    access: str | None,
    reachable_without_certificates: bool,
    lease: float,
) -> None:
    """Share an arm: any number of programs read it, one at a time commands it, and each can stop it.

    Others open it as zenoh:NAME. Without --listen and --router only programs of this user on this machine reach it.
    Nothing moves until a program commands it. Ends with Ctrl-C, and the arm stays where it is.
    """
    from hexwire.fleet.service import ArmSettings, Service

    port = early_port(port)
    if file is not None:
        if robot or name:
            raise UsageError("--config names the arms; leave out --robot and --name")
        arms, network = _read_config(file)
    else:
        given: dict[str, Any] = {"robot": robot} if robot else {}
        if port:
            given["port"] = port
        arms, network = [ArmSettings(name or "", given)], {}
    rows = {"listen": listen, "connect": router, "ca": ca, "cert": cert, "key": key}
    network |= {row: value for row, value in rows.items() if value}
    if reachable_without_certificates:
        network["reachable_without_certificates"] = True
    if access is not None:
        network["access"] = access
    service = Service(arms, _network(network), lease=lease, server=_server())
    _run(service)


def _server() -> str:
    from hexwire.fleet.remote import whoami

    return f"{whoami()}, Python {platform.python_version()}"


def _network(rows: dict[str, Any]) -> Network:
    from hexwire.fleet.network import Network, read_access

    if "access" in rows:
        rows["access"] = read_access(rows["access"])
    return Network(**rows)


def _read_config(file: str) -> tuple[list[Any], dict[str, Any]]:
    """Arms and network of a file. It has a table ``[arms.NAME]`` for each arm, and perhaps one ``[network]``."""
    from hexwire.fleet.service import read_service_file

    return read_service_file(file)


def _run(service: Any) -> None:
    import sys

    from hexwire.control.shutdown import Shutdown

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(_PATIENCE)
    shutdown.listen()
    shutdown.interrupts = True
    with service:
        shutdown.interrupts = False
        for line in service.lines():
            say(line, flush=True)
        while not shutdown.wait(_LOOK):
            service.check()
    note("the arms are no longer shared")
