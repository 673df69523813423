"""`gateway`: several boards behind one TCP port.

Owns the arguments and what is printed. Must not know how frames are forwarded: `hexwire.gateway` does.
"""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING

import click

from .exits import ends_when_asked, note
from .output import say_document

if TYPE_CHECKING:
    from hexwire.link.base import Link
    from hexwire.link.listener import Listener

__all__ = ["gateway"]

_NUMBERED = re.compile(r"([A-Za-z_0-9]+)=(.+)")
_LISTEN = "tcp://127.0.0.1:15040"


@click.command()
@click.option(
    "--listen",
    metavar="URL",
    default=_LISTEN,
    show_default=True,
    help="Where the host connects: tcp://HOST:PORT, or tcps://HOST:PORT?ca=FILE&cert=FILE&key=FILE.",
)
@click.option(
    "--board",
    "boards",
    metavar="[MODULE=]URL",
    multiple=True,
    required=True,
    help="Port of a board, and its module id for the host (8, 9, ... if not given). Give it once per board.",
)
def gateway(listen: str, boards: tuple[str, ...]) -> None:
    """Forward frames between one host and several boards: one link up, several lines down.

    A host names a board by its module id, as in --port tcp://HOST:PORT?to=9, or several at once, and has it until
    it leaves; others may only stop it. Long requests are sent to a board in fragments. A stop overtakes everything.
    If a host is lost, its boards are stopped. For boards with hexwire's firmware.
    """
    from hexwire.gateway.service import GatewayService
    from hexwire.link.url import is_loopback
    from hexwire.wire.modules import ModuleType

    listener = _listener(listen)
    links = _links(boards)
    if listen.lower().startswith("tcp:") and not is_loopback(listener.host):
        note(f"warning: anyone who reaches TCP on {listener.host} can command these boards; tcps:// prevents that")
    service = GatewayService(listener, links, local=ModuleType.ARM_7BOT_ARDUINO_TRX)
    try:
        service.open()
        say_document(service.url.replace("-listen://", "://"))
        if sys.stdout.isatty():
            note("modules: " + ", ".join(f"{module} at {link.url}" for module, link in links.items()))
        with ends_when_asked() as ended:
            service.run(ended)
    finally:
        service.close()


def _listener(text: str) -> Listener:
    from hexwire.errors import UsageError
    from hexwire.link.listener import Listener, listen_address
    from hexwire.link.tls import TlsFiles
    from hexwire.link.url import parse_url

    url = parse_url(text)
    if url.scheme not in ("tcp", "tcps"):
        raise UsageError(f"{text}: a gateway listens on tcp:// or tcps://")
    if url.scheme == "tcps":
        return Listener(*listen_address(url), tls=TlsFiles.from_url(url))
    url.check_keys(())
    url.check_no_path()
    return Listener(*listen_address(url))


def _links(boards: tuple[str, ...]) -> dict[int, Link]:
    """The links by module id."""
    from hexwire.errors import UsageError
    from hexwire.gateway.line import GATEWAY_MODULE
    from hexwire.link.open import make_link
    from hexwire.wire.addresses import module_id
    from hexwire.wire.modules import ModuleType

    links: dict[int, Link] = {}
    number = int(ModuleType.ARM_7BOT_ARDUINO_TRX)
    for text in boards:
        match = _NUMBERED.fullmatch(text)
        if match is not None and "://" not in match[1]:
            number, text = module_id(match[1]), match[2]
        if number >= GATEWAY_MODULE:
            raise UsageError(f"--board {text}: module ids behind a gateway are 0 to {GATEWAY_MODULE - 1}")
        if number in links:
            raise UsageError(f"--board {text}: module {number} is {links[number].url} already")
        if any(link.url == make_link(text).url for link in links.values()):
            raise UsageError(f"--board {text} is given twice")
        links[number] = make_link(text)
        if getattr(links[number], "raise_to", 0):
            raise UsageError(f"--board {text}: a gateway does not raise the rate of a line; leave out raise")
        number += 1
    return links
