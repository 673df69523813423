"""`sim puma260`: an emulated PUMA 260 controller for other programs.

Owns its addresses and when it ends. Must not know how the controller works.
"""

from __future__ import annotations

import sys
import time

import click

from .exits import note
from .output import say_document
from .sim_serve import parse_address, queue_link

__all__ = ["puma260"]

_PORT = 15030
"""The port in the chapter."""


@click.command()
@click.option(
    "--tcp",
    metavar="HOST:PORT",
    default=f"127.0.0.1:{_PORT}",
    show_default=True,
    help="Address for TCP hosts; port 0 selects a free port.",
)
@click.option("--ca", metavar="FILE", help="TLS: certificate authority of the clients; needs --cert and --key.")
@click.option(
    "--cert", metavar="FILE", help="TLS: certificate of this server; 'hexwire cert new' creates the three files."
)
@click.option("--key", metavar="FILE", help="TLS: private key of this server.")
@click.option("--udp", metavar="HOST:PORT", help="Address for UDP hosts.")
@click.option(
    "--peer", metavar="HOST", help="The only host accepted; needed with --udp on an address that others reach."
)
@click.option(
    "--queue", metavar="NAME", help="Offer the POSIX message queue mq:///NAME to one program of this user, too."
)
def puma260(
    tcp: str,
    ca: str | None,
    cert: str | None,
    key: str | None,
    udp: str | None,
    peer: str | None,
    queue: str | None,
) -> None:
    """Emulate a PUMA 260 controller: prints its URLs, and runs until stopped.

    It serves the four channels of the chapter's configuration file on one port, for several dozen hosts at once. On
    an address that others reach, and without TLS, it obeys anyone who connects.
    """
    from hexwire.emulator.puma import EmulatedPuma
    from hexwire.emulator.serve_puma import serve_puma
    from hexwire.errors import UsageError
    from hexwire.link.listener import Listener
    from hexwire.link.tls import TlsFiles
    from hexwire.link.udp import UdpServer
    from hexwire.link.url import is_loopback

    if peer and not udp:
        raise UsageError("--peer needs --udp")
    tls = None
    if ca or cert or key:
        if not (ca and cert and key):
            raise UsageError("TLS needs --ca, --cert and --key together; 'hexwire cert new' creates the files")
        tls = TlsFiles(ca, cert, key)
    host, port = parse_address(tcp)
    listener = Listener(host, port, tls=tls)
    link = UdpServer(*parse_address(udp), peer=peer or "") if udp else None
    if tls is None and not is_loopback(host):
        note(
            f"warning: anyone who reaches TCP on {host} can command this robot; --ca, --cert and --key prevent that"
        )
    if udp and not is_loopback(parse_address(udp)[0]):
        note(f"warning: over UDP anyone can pretend to be {peer}; TCP with --ca, --cert and --key prevents that")
    serve_puma(
        EmulatedPuma(start=time.monotonic()),
        listener=listener,
        udp=link,
        queue=None if queue is None else queue_link(queue),
        stop=lambda: False,
        announce=_announce,
    )


def _announce(url: str) -> None:
    # From the address to listen on to the address to connect to.
    url = url.replace("-listen://", "://").partition("?")[0]
    say_document(url)
    if sys.stdout.isatty():
        note(f"try 'hexwire --robot puma260 state --port {url}' in another terminal; Ctrl-C ends it")
