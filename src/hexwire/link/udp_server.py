"""The listening side of UDP, for servers with many clients: one socket; each address and port is a separate peer.

Owns the socket and the choice of accepted hosts. Must not know what the bytes mean, nor which clients may stay.
"""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from hexwire.errors import LinkBusyError, LinkClosedError

from .listener import LOOPBACK
from .openable import Openable
from .tcp import host_and_port
from .udp import MAX_DATAGRAM, bind_udp, check_peer, heard_hosts, is_away

if TYPE_CHECKING:
    import socket

__all__ = ["Peer", "UdpServer"]

Peer = tuple[object, ...]
"""Address and port of a client, as the system gives them."""


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
