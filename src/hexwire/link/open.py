"""Creates a link from an address: the table of schemes.

Owns the mapping from schemes to classes, built in or from another package (entry-point group ``hexwire.links``:
name = scheme, value = a callable from `LinkUrl` to `Link`). Imports a class only when its scheme is used.
"""

from __future__ import annotations

import importlib
from operator import attrgetter
from typing import TYPE_CHECKING, cast

from hexwire.errors import UsageError
from hexwire.extras import installed

from .base import Link
from .tap import tapped
from .url import LinkUrl, parse_url

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ENTRY_POINT_GROUP", "build_link", "known_schemes", "make_link", "open_link"]

ENTRY_POINT_GROUP = "hexwire.links"

# scheme -> module, callable from `LinkUrl` to `Link`
_BUILT_IN: dict[str, tuple[str, str]] = {
    "mq": ("hexwire.link.mqueue", "QueueLink.from_url"),
    "serial": ("hexwire.link.serial_address", "make_serial_link"),
    "tcp": ("hexwire.link.tcp", "TcpLink.from_url"),
    "tcp-listen": ("hexwire.link.listen", "TcpListenLink.from_url"),
    "tcps": ("hexwire.link.tcp", "TcpsLink.from_url"),
    "tcps-listen": ("hexwire.link.listen", "TcpsListenLink.from_url"),
    "udp": ("hexwire.link.udp", "UdpLink.from_url"),
    "udp-listen": ("hexwire.link.udp", "UdpListenLink.from_url"),
}


def known_schemes() -> list[str]:
    """All schemes that `make_link` accepts, including those of other packages."""
    return sorted({*_BUILT_IN, *(point.name for point in installed(ENTRY_POINT_GROUP))})


def make_link(url: str) -> Link:
    """Create the link for an address, without opening it.

    Args:
        url: ``serial:///dev/ttyUSB0?baud=115200``, ``tcp://host:port`` and so on, or the plain path of a
            serial device.

    Raises:
        UsageError: The address is malformed, its scheme unknown or an option wrong.
    """
    return tapped(build_link(url))


def build_link(url: str) -> Link:
    """As `make_link`, but nobody observes the link: for one that is part of another."""
    parts = parse_url(url)
    if parts.scheme in _BUILT_IN:
        module, name = _BUILT_IN[parts.scheme]
        try:
            make = attrgetter(name)(importlib.import_module(module))
        except ImportError as error:
            # A module for another system says what to use here.
            raise UsageError(f"{url}: this system has no such link: {error}") from error
        return cast(Link, make(parts))
    for point in installed(ENTRY_POINT_GROUP):
        if point.name == parts.scheme:
            build = cast("Callable[[LinkUrl], Link]", point.load())
            return build(parts)
    raise UsageError(f"{url}: unknown scheme {parts.scheme!r}; known: {', '.join(known_schemes())}")


def open_link(url: str) -> Link:
    """Create and open the link for an address; the caller closes it.

    Raises:
        UsageError: The address is wrong.
        LinkError: It could not be opened; see `Link.open`.
    """
    link = make_link(url)
    link.open()
    return link
