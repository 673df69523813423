"""`gateway`: several boards behind a TCP port or POSIX queues.

Owns the arguments and what is printed. Must not know how frames are forwarded: `hexwire.gateway` does.
"""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING, cast

import click

from .exits import ends_when_asked, note
from .output import say_document

if TYPE_CHECKING:
    from hexwire.gateway.service import HostQueue
    from hexwire.link.base import Link
    from hexwire.link.listener import Listener
    from hexwire.link.mqueue import QueueLink

__all__ = ["gateway"]

_NUMBERED = re.compile(r"([A-Za-z_0-9]+)=(.+)")
_LISTEN = "tcp://127.0.0.1:15040"


@click.command()
@click.option(
    "--listen",
    "doors",
    metavar="URL",
    multiple=True,
    default=(_LISTEN,),
    show_default=True,
    help="Where hosts connect: tcp://HOST:PORT, tcps://HOST:PORT?ca=FILE&cert=FILE&key=FILE, or mq:///NAME for "
    "programs of this user. Give it once per queue; there is one port.",
)
@click.option(
    "--board",
    "boards",
    metavar="[MODULE=]URL",
    multiple=True,
    required=True,
    help="Port of a board, and its module id for the host (8, 9, ... if not given). Give it once per board.",
)
def gateway(doors: tuple[str, ...], boards: tuple[str, ...]) -> None:
    """Forward frames between hosts and several boards: one port or several queues up, several lines down.

    A host names a board by its module id, as in --port tcp://HOST:PORT?to=9, or several at once, and has it until
    it leaves; others may only stop it. Long requests are sent to a board in fragments. A stop overtakes everything.
    If a host is lost, its boards are stopped. For boards with hexwire's firmware.
    """
    from hexwire.drivers.board_reset import warn_of_reset
    from hexwire.gateway.service import GatewayService
    from hexwire.ipc.connections import random_number
    from hexwire.link.url import is_loopback
    from hexwire.wire.modules import ModuleType

    port = next((door for door in doors if not _is_queue(door)), None)
    listener = None if port is None else _listener(port)
    links = _links(boards)
    queues = _queues(doors, port, len(links))
    if listener is not None and listener.url.startswith("tcp-") and not is_loopback(listener.host):
        note(f"warning: anyone who reaches TCP on {listener.host} can command these boards; tcps:// prevents that")
    warned: set[str] = set()

    def warn_once(link: Link) -> None:
        # A board that is plugged in later too, and not at each attempt to open its port.
        if link.url not in warned and warn_of_reset(link):
            warned.add(link.url)

    service = GatewayService(
        listener,
        links,
        local=ModuleType.ARM_7BOT_ARDUINO_TRX,
        before_open=warn_once,
        queues=queues,
        numbers=random_number,
    )
    try:
        service.open()
        for url in service.urls:
            say_document(url.replace("-listen://", "://"))
        if sys.stdout.isatty():
            note("modules: " + ", ".join(f"{module} at {link.url}" for module, link in links.items()))
        with ends_when_asked() as ended:
            service.run(ended)
    finally:
        service.close()


def _is_queue(door: str) -> bool:
    return door.lower().startswith("mq:")


def _queues(doors: tuple[str, ...], port: str | None, hosts: int) -> list[HostQueue]:
    """The servers' ends of the queues among the addresses, which have one port at most.

    Args:
        doors: The addresses.
        port: The one that is no queue, or None.
        hosts: How many each queue is for at once: each board may have one.
    """
    from hexwire.errors import UsageError
    from hexwire.link.open import build_link

    queues: list[QueueLink] = []
    for door in doors:
        if not _is_queue(door):
            if door is not port:
                raise UsageError(f"--listen {door}: a gateway has one port, and {port} is given already")
            continue
        added = "role=server" if "unlink=" in door else "role=server&unlink=1"
        link = build_link(f"{door}{'&' if '?' in door else '?'}{added}")
        if any(link.url == queue.url for queue in queues):
            raise UsageError(f"--listen {door} is given twice")
        queues.append(cast("QueueLink", link))
    # Further lines last: where memory for queues is scarce, every queue has its first.
    further = [queue.make_further(number) for number in range(2, hosts + 1) for queue in queues]
    return [*queues, *further]


def _listener(text: str) -> Listener:
    from hexwire.errors import UsageError
    from hexwire.link.listener import Listener, listen_address
    from hexwire.link.tls import TlsFiles
    from hexwire.link.url import parse_url

    url = parse_url(text)
    if url.scheme not in ("tcp", "tcps"):
        raise UsageError(f"{text}: a gateway listens on tcp://, tcps:// or mq://")
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
