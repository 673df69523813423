"""How `sim` offers an emulated device to other programs: a pseudo-terminal, or a TCP port.

Owns that choice and its option. Must not know the device.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, NoReturn

import click

from hexwire.errors import UsageError

from .exits import note

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.emulator.hand import Hands
    from hexwire.emulator.serve import ServedDevice
    from hexwire.link.poll_link import PollLink

__all__ = [
    "no_terminals",
    "parse_address",
    "queue_link",
    "queue_option",
    "serve_device",
    "serve_on_tcp",
    "tcp_option",
]

tcp_option = click.option(
    "--tcp", metavar="HOST:PORT", help="Offer a TCP port instead of a terminal; port 0 selects a free one."
)

queue_option = click.option(
    "--queue", metavar="NAME", help="Offer the POSIX message queue mq:///NAME to a program of this user."
)


def queue_link(name: str) -> PollLink:
    """The server's end of a queue, not open yet; raises UsageError if this system has none, or for a bad name."""
    from hexwire.link.open import build_link
    from hexwire.link.poll_link import PollLink

    link = build_link(f"mq:///{name.removeprefix('/')}?role=server&unlink=1")
    assert isinstance(link, PollLink)
    return link


def parse_address(text: str) -> tuple[str, int]:
    """Parse ``host:port`` or ``:port``; the default host is the loopback address.

    Raises:
        UsageError: The text is malformed.
    """
    from hexwire.link.listener import LOOPBACK
    from hexwire.link.url import split_host_port

    host, port = split_host_port(f"{LOOPBACK}{text}" if text.startswith(":") else text, text)
    return host, port


def serve_device(
    device: ServedDevice,
    *,
    tcp: str | None,
    link: str | None,
    baud: int,
    reset_on_open: bool = False,
    hands: Hands | None = None,
    rate: Callable[[], int] | None = None,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
) -> None:
    """Serve a device until told to stop; arguments as of `serve_board` and `serve_tcp`.

    Raises:
        UsageError: Options that exclude each other, or this system has no pseudo-terminals for it.
    """
    if tcp is not None:
        serve_on_tcp(device, tcp, link=link, baud=baud, reset_on_open=reset_on_open, stop=stop, announce=announce)
        return
    try:
        from hexwire.emulator.serve_pty import serve_board
    except ImportError:
        no_terminals()
    serve_board(
        device,
        link=link,
        baud=baud,
        reset_on_open=reset_on_open,
        hands=hands,
        rate=rate,
        stop=stop,
        announce=announce,
    )


def serve_on_tcp(
    device: ServedDevice,
    tcp: str,
    *,
    link: str | None,
    baud: int,
    reset_on_open: bool = False,
    stop: Callable[[], bool],
    announce: Callable[[str], None],
) -> None:
    """Serve a device on a TCP port; arguments and errors as of `serve_device`."""
    from hexwire.emulator.serve_tcp import serve_tcp
    from hexwire.link.url import is_loopback

    if link is not None:
        raise UsageError("--link names a terminal, and --tcp makes none; leave out one of them")
    host, port = parse_address(tcp)
    if not is_loopback(host):
        note(f"warning: anyone who reaches TCP on {host} can command this emulated arm")
    serve_tcp(device, host, port, baud=baud, reset_on_open=reset_on_open, stop=stop, announce=announce)


def no_terminals() -> NoReturn:
    """Say that this system lacks the terminals that emulated arms use; raises UsageError."""
    raise UsageError(f"no pseudo-terminals for emulated arms on {sys.platform}; add --tcp 127.0.0.1:0") from None
