"""`cert`: certificates for a lab.

Owns which files one command makes. Must not know what is in them.
"""

from __future__ import annotations

from pathlib import Path

import click

from .common import FiniteFloat, json_option
from .output import answer

__all__ = ["cert"]


@click.group()
def cert() -> None:
    """Make certificates for a lab, for links with TLS (tcps://)."""


@cert.command()
@click.argument("folder", metavar="DIR")
@click.option("--server", "servers", multiple=True, metavar="NAME", help="A machine that is called; repeatable.")
@click.option("--client", "clients", multiple=True, metavar="NAME", help="Somebody who calls; repeatable.")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    metavar="HOST",
    help="Name or address under which the servers are called; repeatable. Without any: NAME and this machine.",
)
@click.option("--lab", default="hexwire lab", show_default=True, metavar="TEXT", help="Name of a new authority.")
@click.option("--days", type=FiniteFloat("days", above=0), metavar="DAYS", help="How long they are good for (825).")
@json_option
def new(
    folder: str,
    servers: tuple[str, ...],
    clients: tuple[str, ...],
    hosts: tuple[str, ...],
    lab: str,
    days: float | None,
    as_json: bool,
) -> None:
    """Make certificates in DIR: an authority (ca.pem, ca.key) if there is none, and what it signs.

    Without --server and --client there is one of each, called server and client. Whoever has ca.key can let
    anybody in: keep it off the robots.
    """
    from hexwire.errors import UsageError
    from hexwire.link.certs import AUTHORITY, CERTIFICATE_DAYS, issue_certificate, make_authority

    if not servers and not clients:
        if hosts and (Path(folder) / "server.pem").exists():
            raise UsageError("--host is for a new server: name it, as in --server arm2")
        servers, clients = ("server",), ("client",)
    if hosts and not servers:
        raise UsageError("--host makes no sense without --server")
    wanted = [(name, "server") for name in servers] + [(name, "client") for name in clients]
    _check_names([name for name, _ in wanted], Path(folder))
    made = []
    lines = []
    if not any((Path(folder) / f"{AUTHORITY}{end}").exists() for end in (".pem", ".key")):
        files = make_authority(folder, name=lab)
        made.append({"kind": "authority", "cert": str(files.cert), "key": str(files.key)})
        lines += [
            f"{files.cert}  the authority; every machine needs it",
            f"{files.key}  its key; keep it to yourself",
        ]
    for name, kind in wanted:
        if kind == "server":
            files = issue_certificate(folder, name, "server", hosts=hosts, days=days or CERTIFICATE_DAYS)
        else:
            files = issue_certificate(folder, name, "client", days=days or CERTIFICATE_DAYS)
        made.append({"kind": kind, "cert": str(files.cert), "key": str(files.key)})
        lines.append(f"{files.cert}, {files.key}  {kind}")
        if kind == "client":
            lines.append(f"    calls tcps://HOST:PORT?ca={folder}/ca.pem&cert={files.cert}&key={files.key}")
    answer(as_json, made, *lines)


def _check_names(names: list[str], folder: Path) -> None:
    """Refuse before anything is written what would stop half-way."""
    from hexwire.errors import UsageError

    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise UsageError(f"{', '.join(twice)} is named twice: each certificate has files of its own")
    there = [name for name in names if any((folder / f"{name}{end}").exists() for end in (".pem", ".key"))]
    if there:
        raise UsageError(f"{folder / there[0]}.pem is there already; remove it first, or take another name")
