"""`cert`: certificates for a lab.

Owns which files a command creates. Must not know their contents.
`cert new` is for links (tcps://), `cert issue` for programs of a fleet, with a role.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from hexwire.errors import UsageError

from .options import json_option, number_option
from .output import answer

__all__ = ["cert"]


_F = TypeVar("_F", bound=Callable[..., Any])


def _common_options(listeners: str) -> Callable[[_F], _F]:
    """The options of every command that creates certificates, after its own; `listeners` names what has hosts."""
    options = (
        click.option(
            "--host",
            "hosts",
            multiple=True,
            metavar="HOST",
            help=f"Host name or address of {listeners}; repeatable. Default: NAME and this machine.",
        ),
        click.option(
            "--lab",
            default="hexwire lab",
            show_default=True,
            metavar="TEXT",
            help="Name for a new certificate authority.",
        ),
        number_option("--days", "DAYS", "Validity in days (825).", above=0),
        json_option,
    )

    def decorate(command: _F) -> _F:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@click.group()
def cert() -> None:
    """Create certificates for a lab: for TLS links (tcps://), and with a role for shared arms (zenoh:)."""


@cert.command()
@click.argument("folder", metavar="DIR")
@click.option(
    "--server", "servers", multiple=True, metavar="NAME", help="Name of a machine that listens; repeatable."
)
@click.option(
    "--client", "clients", multiple=True, metavar="NAME", help="Name of a client that connects; repeatable."
)
@_common_options("the servers")
def new(
    folder: str,
    servers: tuple[str, ...],
    clients: tuple[str, ...],
    hosts: tuple[str, ...],
    lab: str,
    days: float | None,
) -> None:
    """Create certificates in DIR, and a certificate authority (ca.pem, ca.key) if there is none.

    Without --server and --client, one of each is created, named server and client. Anyone who has ca.key can give
    others access: do not copy it to the robots.
    """
    from hexwire.link.certs import CERTIFICATE_DAYS, issue_certificate

    if not servers and not clients:
        if hosts and (Path(folder) / "server.pem").exists():
            raise UsageError("--host is for a new server: name it, as in --server arm2")
        servers, clients = ("server",), ("client",)
    if hosts and not servers:
        raise UsageError("--host needs --server")
    wanted = [(name, "server") for name in servers] + [(name, "client") for name in clients]
    _check_names([name for name, _ in wanted], Path(folder))
    made, lines = _authority(folder, lab)
    for name, kind in wanted:
        if kind == "server":
            files = issue_certificate(folder, name, "server", hosts=hosts, days=days or CERTIFICATE_DAYS)
        else:
            files = issue_certificate(folder, name, "client", days=days or CERTIFICATE_DAYS)
        made.append({"kind": kind, "cert": str(files.cert), "key": str(files.key)})
        lines.append(f"{files.cert}, {files.key}  {kind}")
        if kind == "client":
            lines.append(f"    calls tcps://HOST:PORT?ca={folder}/ca.pem&cert={files.cert}&key={files.key}")
    answer(made, *lines)


@cert.command()
@click.argument("folder", metavar="DIR")
@click.argument("name", metavar="NAME")
@click.option(
    "--role",
    required=True,
    type=click.Choice(["observer", "operator", "maintainer", "arm", "router", "ros"]),
    help="observer: reads and stops; operator: also moves; maintainer: also servo settings and firmware; arm: for "
    "'hexwire serve'; router: for 'hexwire fleet router'; ros: for nodes of ROS 2, each of "
    "which may command every arm of its domain.",
)
@click.option(
    "--for",
    "arms",
    multiple=True,
    metavar="PATTERN",
    help="Arm, or pattern as in 'lab/*'; for ros a domain, as in 0; repeatable.",
)
@_common_options("an arm or router")
def issue(
    folder: str,
    name: str,
    role: str,
    arms: tuple[str, ...],
    hosts: tuple[str, ...],
    lab: str,
    days: float | None,
) -> None:
    """Create a certificate NAME with a role for arms in DIR, and an authority if there is none.

    The role takes effect after 'hexwire fleet config DIR' and a restart of the router.
    """
    from hexwire.fleet.rights import Kind, Rights
    from hexwire.link.certs import CERTIFICATE_DAYS, issue_certificate

    rights = Rights(Kind(role), arms)
    listens = rights.role is None
    if hosts and not listens:
        raise UsageError(
            "--host is for the roles arm, router and ros: a client is identified by its certificate alone"
        )
    _check_names([name], Path(folder))
    made, lines = _authority(folder, lab)
    files = issue_certificate(
        folder,
        name,
        "both" if listens else "client",
        hosts=hosts,
        uris=rights.uris(),
        # Zenoh knows a program by this name. Another certificate with these files' names must not get its rights.
        subject=f"{name[:40]} {secrets.token_hex(8)}",
        days=days or CERTIFICATE_DAYS,
    )
    made.append({"kind": role, "arms": ",".join(arms), "cert": str(files.cert), "key": str(files.key)})
    lines.append(f"{files.cert}, {files.key}  {rights}")
    answer(made, *lines)


def _authority(folder: str, lab: str) -> tuple[list[dict[str, str]], list[str]]:
    """Create an authority if there is none; returns what was made, and lines about it."""
    from hexwire.link.certs import AUTHORITY, make_authority

    if any((Path(folder) / f"{AUTHORITY}{end}").exists() for end in (".pem", ".key")):
        return [], []
    files = make_authority(folder, name=lab)
    return [{"kind": "authority", "cert": str(files.cert), "key": str(files.key)}], [
        f"{files.cert}  certificate of the authority; every machine needs it",
        f"{files.key}  its private key; keep it to yourself",
    ]


def _check_names(names: list[str], folder: Path) -> None:
    """Refuse names that would fail, before anything is written."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"{', '.join(twice)} is named twice: each certificate has its own files")
    there = [name for name in names if any((folder / f"{name}{end}").exists() for end in (".pem", ".key"))]
    if there:
        raise UsageError(f"{folder / there[0]}.pem already exists; remove it first, or choose another name")
