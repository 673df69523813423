"""TCP links: the client side, and one connection accepted by a listener; both plain or with TLS.

Owns sockets and the errors of connecting. `hexwire.link.listen` does the listening. Must not know what the bytes
mean.
"""

from __future__ import annotations

import contextlib
import errno
import os
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
from hexwire.system import READABLE, WRITABLE, make_poll

from .base import LinkKind
from .poll_link import PollLink
from .url import LinkUrl

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .tls import TlsFiles

__all__ = ["ByteStream", "PeerLink", "PlainStream", "TcpLink", "TcpsLink", "find_addresses", "host_and_port"]

CONNECT_TIMEOUT = 5.0
_READ_SIZE = 65536
_MOST_LEFTOVERS = 64
# A peer that vanishes silently (power cut, cable) is detected after about 5 + 3 * 2 seconds.
_KEEPALIVE = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3), ("TCP_USER_TIMEOUT", 10_000))
_GONE = (
    "the other end closed the connection; a server that already has a client disconnects others, and so does a "
    "program that is no robot's"
)


class ByteStream(Protocol):
    """Bytes over a connected, non-blocking socket."""

    socket: socket.socket

    def receive(self) -> bytes:
        """Available bytes, ``b""`` after a false alarm; raises LinkLostError or OSError at the end."""

    def send(self, data: memoryview | bytes) -> int:
        """Send what fits; raises BlockingIOError if nothing does."""

    def given_up(self) -> None:
        """The caller has abandoned a write half-way."""

    def close(self) -> None:
        """Send the protocol's closing message, if it has one, and close the socket."""


class PlainStream:
    """A plain socket."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self.send = connected.send

    def receive(self) -> bytes:
        data = self.socket.recv(_READ_SIZE)
        if not data:
            raise LinkLostError(_GONE)
        return data

    def given_up(self) -> None:
        """Nothing to do: a plain stream has no state between two writes."""

    def close(self) -> None:
        self.socket.close()


class _StreamLink(PollLink):
    """Shared by the two sides of a connection."""

    kind = LinkKind.STREAM

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._stream: ByteStream | None = None

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
    """The client side of a TCP connection.

    Args:
        host: Name or address to connect to.
        port: Its port.
        timeout: Seconds that `open` may take.
        tls: Certificates; None for an unencrypted connection.
    """

    may_reset = True
    """What listens there may open a board's port when somebody connects."""

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
            if not self._wait_for(connected.fileno(), WRITABLE, deadline):
                raise LinkTimeoutError(
                    f"{self.url} does not answer within {self._timeout:g} s; check the address, and that it is on",
                    url=self.url,
                )
            result = connected.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if not result and connected.getsockname() == connected.getpeername():
            result = errno.ECONNREFUSED  # no listener, and the system chose the same port for our own side
        if result:
            raise OSError(result, os.strerror(result))

    def _wrap(self, connected: socket.socket, deadline: float) -> ByteStream:
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
                f"{self.url}: no server listens there; start it, or check the port", url=self.url
            )
        if error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT, errno.EADDRNOTAVAIL):
            return LinkNotFoundError(
                f"{self.url}: no route to that host ({error.strerror}); check the address and the cable",
                url=self.url,
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
    """One connection accepted by a listener, open from the start. It cannot be opened again.

    Attributes:
        peer: Address of the client, such as ``192.168.1.20:51234``.
    """

    def __init__(
        self, url: str, stream: ByteStream, peer: str, watched: dict[int, Callable[[], None]] | None = None
    ) -> None:
        super().__init__(url)
        self.peer = peer
        self._accepted: ByteStream | None = stream
        self._also_watched = dict(watched or {})
        self.open()

    def leftovers(self) -> Iterator[None]:
        """Yield for each read that does not wait: who has left may have sent bytes before.

        Bounded, since who goes on sending has not left. The caller leaves the loop when it closes the link.
        """
        poll = make_poll()
        poll.register(self.fileno(), READABLE)
        for _ in range(_MOST_LEFTOVERS):
            if not poll.poll(0):
                return
            yield

    def _open(self) -> None:
        if self._accepted is None:
            raise LinkNotFoundError(f"{self.url}: {self.peer} has to connect again", url=self.url)
        self._stream, self._accepted = self._accepted, None
        self._watched.update(self._also_watched)

    def _close(self) -> None:
        super()._close()
        if self._accepted is not None:
            self._accepted.close()
            self._accepted = None


def prepare(connected: socket.socket) -> None:
    """Set the options of every TCP connection: send small packets at once, and detect a vanished peer."""
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
    """Look up a host: address family and socket address, best first.

    Raises:
        LinkNotFoundError: There is no such host.
    """
    try:
        found = socket.getaddrinfo(host, port, type=kind, flags=socket.AI_PASSIVE if passive else 0)
    except (socket.gaierror, UnicodeError) as error:
        raise LinkNotFoundError(f"{url}: there is no host {host!r}; check its name", url=url) from error
    return [(family, address) for family, _, _, _, address in found]
