"""TCP links: the calling side, and one connection that a listener accepted; both in the clear or under TLS.

Owns sockets and the errors a person meets when connecting. Listening is `hexwire.link.listen`'s. Must not know
what the bytes mean.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
from time import monotonic
from typing import TYPE_CHECKING, Protocol

from hexwire.errors import (
    LinkError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    LinkTimeoutError,
)

from .base import LinkKind
from .poll_link import PollLink
from .url import LinkUrl

if TYPE_CHECKING:
    from collections.abc import Callable

    from .tls import TlsFiles

__all__ = ["PeerLink", "PlainStream", "Stream", "TcpLink", "TcpsLink", "find_addresses", "host_and_port"]

CONNECT_TIMEOUT = 5.0
_READ_SIZE = 65536
# A peer that vanished without a word (power cut, cable) is noticed after about 5 + 3 * 2 seconds of silence.
_KEEPALIVE = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3), ("TCP_USER_TIMEOUT", 10_000))
_GONE = "the other end closed the connection; a server that has a client already turns others away"


class Stream(Protocol):
    """Bytes over a connected socket, which is non-blocking."""

    socket: socket.socket

    def receive(self) -> bytes:
        """What is there, ``b""`` if there was nothing after all; LinkLostError or OSError if it is over."""

    def send(self, data: memoryview | bytes) -> int:
        """Take what fits; BlockingIOError if none does."""

    def given_up(self) -> None:
        """The caller gives a write up half-way."""

    def close(self) -> None:
        """Say good-bye if the protocol has a word for it, and close the socket."""


class PlainStream:
    """A socket as it is."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self.send = connected.send

    def receive(self) -> bytes:
        data = self.socket.recv(_READ_SIZE)
        if not data:
            raise LinkLostError(_GONE)
        return data

    def given_up(self) -> None:
        """A plain stream keeps nothing between two writes."""

    def close(self) -> None:
        self.socket.close()


class _StreamLink(PollLink):
    """What the two sides of a connection share."""

    kind = LinkKind.STREAM

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._stream: Stream | None = None

    def _close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _fileno(self) -> int:
        return -1 if self._stream is None else self._stream.socket.fileno()

    def _read_ready(self) -> bytes:
        assert self._stream is not None
        try:
            return self._stream.receive()
        except LinkLostError as error:
            raise LinkLostError(f"{self.url}: {error}", url=self.url) from error

    def _write_ready(self, data: memoryview | bytes) -> int:
        assert self._stream is not None
        return self._stream.send(data)

    def _write_given_up(self) -> None:
        assert self._stream is not None
        self._stream.given_up()


class TcpLink(_StreamLink):
    """The calling side of a TCP connection.

    Args:
        host: Name or address to call.
        port: Its port.
        timeout: Seconds that `open` may take.
        tls: Certificates; None for a connection in the clear.
    """

    def __init__(
        self, host: str, port: int, *, timeout: float = CONNECT_TIMEOUT, tls: TlsFiles | None = None
    ) -> None:
        super().__init__(f"{'tcp' if tls is None else 'tcps'}://{host_and_port(host, port)}")
        self._host = host
        self._port = port
        self._timeout = timeout
        self._tls = tls

    @classmethod
    def from_url(cls, url: LinkUrl) -> TcpLink:
        """Build from ``tcp://host:port?timeout=5``."""
        url.check_keys(("timeout",))
        url.check_no_path()
        host, port = url.host_port()
        return cls(host, port, timeout=url.seconds("timeout", CONNECT_TIMEOUT))

    def _open(self) -> None:
        deadline = monotonic() + self._timeout
        fault: OSError | None = None
        for family, address in find_addresses(self._host, self._port, self.url):
            connected = socket.socket(family, socket.SOCK_STREAM)
            try:
                self._connect(connected, address, deadline)
                self._stream = self._wrap(connected, deadline)
                return
            except OSError as error:
                connected.close()
                if isinstance(error, LinkError):
                    raise
                fault = error
            except BaseException:
                connected.close()
                raise
        raise self._explain(fault or OSError(errno.EADDRNOTAVAIL, "no address"))

    def _connect(self, connected: socket.socket, address: tuple[object, ...], deadline: float) -> None:
        prepare(connected)
        result = connected.connect_ex(address)
        if result == errno.EINPROGRESS:
            if not self._wait_for(connected.fileno(), select.POLLOUT, deadline):
                raise LinkTimeoutError(
                    f"{self.url} does not answer within {self._timeout:g} s; check the address, and that it is on",
                    url=self.url,
                )
            result = connected.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if not result and connected.getsockname() == connected.getpeername():
            result = errno.ECONNREFUSED  # nobody there, and the system chose that very port for our own side
        if result:
            raise OSError(result, os.strerror(result))

    def _wrap(self, connected: socket.socket, deadline: float) -> Stream:
        if self._tls is None:
            return PlainStream(connected)
        from .tls import TlsStream

        stream = TlsStream(connected, self._tls.client_context(), host=self._tls.name or self._host)
        try:
            while not stream.handshake():
                if not self._wait_for(connected.fileno(), stream.wants, deadline):
                    raise LinkTimeoutError(
                        f"{self.url}: no TLS handshake within {self._timeout:g} s; is that a TLS server?",
                        url=self.url,
                    )
        except LinkLostError as error:
            raise LinkPermissionError(f"{self.url}: {error}", url=self.url) from error
        return stream

    def _explain(self, error: OSError) -> LinkError:
        if error.errno == errno.ECONNREFUSED:
            return LinkNotFoundError(
                f"{self.url}: nobody listens there; start the server, or check the port", url=self.url
            )
        if error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT, errno.EADDRNOTAVAIL):
            return LinkNotFoundError(
                f"{self.url}: no way to that host ({error.strerror}); check the address and the cable", url=self.url
            )
        if error.errno in (errno.EACCES, errno.EPERM):
            return LinkPermissionError(f"{self.url}: this machine's firewall forbids the connection", url=self.url)
        return LinkError(f"{self.url} cannot be reached: {error.strerror or error}", url=self.url)


class TcpsLink:
    """Builds `TcpLink` with TLS from an address."""

    @staticmethod
    def from_url(url: LinkUrl) -> TcpLink:
        """Build from ``tcps://host:port?ca=ca.pem&cert=client.pem&key=client.key``."""
        from .tls import TlsFiles

        files = TlsFiles.from_url(url, ("timeout",))
        host, port = url.host_port()
        return TcpLink(host, port, timeout=url.seconds("timeout", CONNECT_TIMEOUT), tls=files)


class PeerLink(_StreamLink):
    """One connection that a listener accepted, open from the start. Once closed or lost it does not come back.

    Attributes:
        peer: Who called, as ``192.168.1.20:51234``.
    """

    def __init__(
        self, url: str, stream: Stream, peer: str, watched: dict[int, Callable[[], None]] | None = None
    ) -> None:
        super().__init__(url)
        self.peer = peer
        self._accepted: Stream | None = stream
        self._also_watched = dict(watched or {})
        self.open()

    def _open(self) -> None:
        if self._accepted is None:
            raise LinkNotFoundError(f"{self.url}: {self.peer} has to call again", url=self.url)
        self._stream, self._accepted = self._accepted, None
        self._watched.update(self._also_watched)

    def _close(self) -> None:
        super()._close()
        if self._accepted is not None:
            self._accepted.close()
            self._accepted = None


def prepare(connected: socket.socket) -> None:
    """Set what every TCP connection here has: small packets at once, and notice of a peer that vanished."""
    connected.setblocking(False)
    connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _KEEPALIVE:
        if hasattr(socket, name):
            with contextlib.suppress(OSError):
                connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def host_and_port(host: str, port: int) -> str:
    """``host:port``, with brackets around an IPv6 address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def find_addresses(
    host: str, port: int, url: str, *, kind: int = socket.SOCK_STREAM, passive: bool = False
) -> list[tuple[int, tuple[object, ...]]]:
    """Look a host up: address family and socket address, best first.

    Raises:
        LinkNotFoundError: There is no such host.
    """
    try:
        found = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE if passive else 0)
    except (socket.gaierror, UnicodeError) as error:
        raise LinkNotFoundError(f"{url}: there is no host {host!r}; check its name", url=url) from error
    return [(family, address) for family, _, _, _, address in found]
