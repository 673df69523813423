"""UDP links: whole messages, each of which may be lost, duplicated or late, from the peer only; and a server.

Owns the sockets, the rule that selects the peer, and for a server the choice of accepted hosts: there each address
and port is a separate peer. Must not know what the bytes mean, nor which clients may stay. The session detects
losses.
"""

from __future__ import annotations

import errno
import math
import socket
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.errors import LinkBusyError, LinkClosedError, LinkNotFoundError, LinkTimeoutError, UsageError

from .base import LinkKind, Openable
from .listener import LOOPBACK, explain_bind, listen_address
from .poll_link import PollLink
from .tcp import find_addresses, host_and_port
from .url import LinkUrl, is_loopback, split_host_port

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "MAX_DATAGRAM",
    "Peer",
    "UdpLink",
    "UdpListenLink",
    "UdpServer",
    "bind_udp",
    "check_peer",
    "heard_hosts",
    "is_away",
]

# The longest frame on a network link (PROTOCOL.md, command frame).
MAX_DATAGRAM = 8192
# Room for a window of fragments that arrive together; the system may grant less (net.core.rmem_max).
_RECEIVE_BUFFER = 1 << 20
# Network errors about an earlier datagram when the peer is temporarily absent.
_AWAY = (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EHOSTDOWN, errno.ETIMEDOUT)
_SILENCE = 0.3
"""Seconds without a valid datagram after which another port may be the peer: a program that is run again is one,
and its first request is tried three times in 0.6 s."""
Peer = tuple[object, ...]
"""Address and port of a client, as the system gives them."""


def bind_udp(host: str, port: int, url: str, family: int | None = None) -> socket.socket:
    """Create a socket bound to an address of this machine.

    Raises:
        LinkError: It cannot be bound.
        UsageError: The address is not of the required family.
    """
    found = find_addresses(host, port, url, kind=socket.SOCK_DGRAM, passive=True)
    matching = [pair for pair in found if family in (None, pair[0])]
    if not matching:
        raise UsageError(f"{url}: {host} and the peer are of different kinds, one IPv4 and one IPv6")
    made = socket.socket(matching[0][0], socket.SOCK_DGRAM)
    try:
        made.setblocking(False)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if made.family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        made.bind(matching[0][1])
    except OSError as error:
        made.close()
        raise explain_bind(error, url) from error
    return made


def check_peer(host: str, port: int, peer: str) -> str:
    """The host that a listening side accepts: the one named, or this machine if no other can reach `host`.

    Raises:
        UsageError: Others can reach it, and no host is named.
    """
    if not peer and not is_loopback(host):
        raise UsageError(
            f"udp-listen://{host_and_port(host, port)}: name the host to accept, as in ?peer=192.168.1.20"
        )
    return peer or host


def heard_hosts(peer: str, url: str) -> set[str]:
    """The addresses of the accepted host."""
    return {str(address[0]) for _, address in find_addresses(peer, 0, url, kind=socket.SOCK_DGRAM)}


def is_away(error: OSError) -> bool:
    """Whether an error only reports that an earlier datagram was not received."""
    return error.errno in _AWAY


class _UdpBase(PollLink):
    kind = LinkKind.DATAGRAM
    max_message = MAX_DATAGRAM

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self.dropped = 0
        """Datagrams from other hosts, from another port than the peer's, or too long."""
        self._socket: socket.socket | None = None

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _fileno(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    def _whole(self, data: bytes) -> bytes:
        if len(data) > MAX_DATAGRAM:
            self.dropped += 1
            return b""
        return data


class UdpLink(_UdpBase):
    """A line to one peer with known address and port. The system drops datagrams from others.

    Args:
        host: The peer's name or address.
        port: The peer's port.
        bind: Own address. Without it: loopback for a peer on loopback, otherwise the interface that leads to
            the peer.
        bind_port: Own port; 0 lets the system choose.
    """

    def __init__(self, host: str, port: int, *, bind: str = "", bind_port: int = 0) -> None:
        super().__init__(f"udp://{host_and_port(host, port)}")
        if not port:
            raise UsageError(f"{self.url}: the peer's port must be from 1 to 65535")
        self._host = host
        self._port = port
        self._bind = bind
        self._bind_port = bind_port

    @classmethod
    def from_url(cls, url: LinkUrl) -> UdpLink:
        """Build from ``udp://host:port?bind=address`` or ``?bind=address:port``."""
        url.check_keys(("bind",))
        url.check_no_path()
        bind, bind_port = "", 0
        if "bind" in url.query:
            bind, bind_port = split_host_port(url.query["bind"], url.text, port_needed=False)
        host, port = url.host_port()
        return cls(host, port, bind=bind, bind_port=bind_port)

    def _open(self) -> None:
        family, address = find_addresses(self._host, self._port, self.url, kind=socket.SOCK_DGRAM)[0]
        any_address = "::" if family == socket.AF_INET6 else "0.0.0.0"
        loopback = "::1" if family == socket.AF_INET6 else LOOPBACK
        default = loopback if is_loopback(str(address[0])) else any_address
        self._socket = bind_udp(self._bind or default, self._bind_port, self.url, family)
        try:
            self._socket.connect(address)
        except OSError as error:
            raise LinkNotFoundError(
                f"{self.url}: no route to that host ({error.strerror}); check the address and bind=", url=self.url
            ) from error

    def _read_ready(self) -> bytes:
        assert self._socket is not None
        try:
            return self._whole(self._socket.recv(MAX_DATAGRAM + 1))
        except OSError as error:
            if is_away(error):
                return b""
            raise

    def _write_ready(self, data: memoryview | bytes) -> int:
        assert self._socket is not None
        try:
            return self._socket.send(data)
        except OSError as error:
            if not is_away(error):
                raise
        # The error concerned an earlier datagram, so this one has not been sent yet. If it fails too, it is lost,
        # like any datagram.
        try:
            return self._socket.send(data)
        except OSError as error:
            if not is_away(error):
                raise
            return len(data)


class UdpListenLink(_UdpBase):
    """The listening side of a line to one program on one host, whose port is unknown until it sends.

    The first port of the host that sends is the peer. Datagrams from other hosts, and from other ports of that
    host, are dropped and counted. Another port takes over when the last valid datagram (see `confirm`) is `silence`
    seconds old; if there was none, that long after the first.

    Args:
        host: Own address; loopback by default.
        port: Own port; 0 lets the system choose, see `port` after `open`.
        peer: The accepted host; loopback if the own address is.
        silence: Seconds after which another port may take over.
        clock: Monotonic seconds.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = 0,
        *,
        peer: str = "",
        silence: float = _SILENCE,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        peer = check_peer(host, port, peer)
        super().__init__(f"udp-listen://{host_and_port(host, port)}?peer={peer}")
        self.port = port
        self._host = host
        self._wanted_port = port
        self._peer = peer
        self._heard: set[str] = set()
        self._silence = silence
        self._clock = clock
        self._caller: tuple[object, ...] | None = None
        self._kept_until = -math.inf

    @classmethod
    def from_url(cls, url: LinkUrl) -> UdpListenLink:
        """Build from ``udp-listen://host:port?peer=host``; without a host it binds to loopback."""
        url.check_keys(("peer",))
        url.check_no_path()
        peer = url.query.get("peer", "")
        if peer:
            peer, peer_port = split_host_port(peer, url.text, port_needed=False)
            if peer_port:
                raise UsageError(f"{url.text}: for a peer with a known port use udp://{url.query['peer']}?bind=...")
        host, port = listen_address(url)
        return cls(host, port, peer=peer)

    def _open(self) -> None:
        self._caller = None
        self._heard = heard_hosts(self._peer, self.url)
        self._socket = bind_udp(self._host, self._wanted_port, self.url)
        self.port = self._socket.getsockname()[1]
        self.url = f"udp-listen://{host_and_port(self._host, self.port)}?peer={self._peer}"

    def _read_ready(self) -> bytes:
        assert self._socket is not None
        data, sender = self._socket.recvfrom(MAX_DATAGRAM + 1)
        if sender[0] not in self._heard:
            self.dropped += 1
            return b""
        if sender != self._caller:
            if self._caller is not None and self._clock() < self._kept_until:
                self.dropped += 1
                return b""
            self._caller = sender
            self.confirm()
        return self._whole(data)

    def confirm(self) -> None:
        if self._caller is not None:
            self._kept_until = self._clock() + self._silence

    def write(self, data: bytes, deadline: float | None = None) -> None:
        if data and self.is_open and self._caller is None:
            raise LinkTimeoutError(
                f"{self.url}: {self._peer} has not sent anything yet, so its port is unknown", url=self.url
            )
        super().write(data, deadline)

    def _write_ready(self, data: memoryview | bytes) -> int:
        assert self._socket is not None
        assert self._caller is not None
        return self._socket.sendto(data, self._caller)


class UdpServer(Openable):
    """Receives datagrams with their senders; sends each answer only to its peer.

    Args:
        host: Own address; loopback by default.
        port: Own port; 0 lets the system choose, see `port` after `open`.
        peer: The accepted host; loopback if the own address is.

    Attributes:
        dropped: Datagrams from other hosts, or too long.

    Raises:
        UsageError: Others can reach the own address, and no host is named.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 0, *, peer: str = "") -> None:
        self._peer = check_peer(host, port, peer)
        self.port = port
        self.dropped = 0
        self._host = host
        self._wanted_port = port
        self._heard: set[str] = set()
        self._socket: socket.socket | None = None

    @property
    def url(self) -> str:
        """Address of the server, with the actual port."""
        return f"udp-listen://{host_and_port(self._host, self.port)}?peer={self._peer}"

    def open(self) -> None:
        """Bind.

        Raises:
            LinkError: As `Link.open`.
        """
        if self._socket is not None:
            raise LinkBusyError(f"{self.url} is already listening", url=self.url)
        self._heard = heard_hosts(self._peer, self.url)
        self._socket = bind_udp(self._host, self._wanted_port, self.url)
        self.port = self._socket.getsockname()[1]

    def close(self) -> None:
        """Close the socket. Harmless if closed."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def fileno(self) -> int:
        """Descriptor that becomes readable when a datagram has arrived."""
        return self._open_socket().fileno()

    def receive(self) -> tuple[Peer, bytes] | None:
        """The next datagram and its sender; None if there is none, or it is not accepted."""
        try:
            data, sender = self._open_socket().recvfrom(MAX_DATAGRAM + 1)
        except BlockingIOError:
            return None
        except OSError as error:
            if not is_away(error):
                raise
            return None
        if sender[0] not in self._heard or len(data) > MAX_DATAGRAM or not data:
            self.dropped += 1
            return None
        return sender, data

    def send(self, peer: Peer, data: bytes) -> bool:
        """Send a datagram; False if it could not be sent, which has the same effect as a loss."""
        try:
            self._open_socket().sendto(data, peer)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.ENOBUFS, errno.EPERM, errno.EMSGSIZE) or is_away(error):
                return False
            raise
        return True

    def _open_socket(self) -> socket.socket:
        if self._socket is None:
            raise LinkClosedError(f"{self.url} is closed", url=self.url)
        return self._socket
