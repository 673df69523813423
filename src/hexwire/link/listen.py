"""The listening side of TCP as a link: one client at a time.

Owns the choice of the peer and the treatment of further clients. `hexwire.link.listener` does the listening. Must
not know what the bytes mean.
"""

from __future__ import annotations

import math
import threading
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.errors import LinkBusyError, LinkClosedError, LinkLostError, LinkTimeoutError

from .base import Link, LinkKind, lock_timeout
from .listener import LOOPBACK, Listener, listen_address
from .tcp import PeerLink
from .url import LinkUrl

if TYPE_CHECKING:
    from collections.abc import Callable

    from .tls import TlsFiles

__all__ = ["TcpListenLink", "TcpsListenLink"]

_PATIENCE = 5.0


class TcpListenLink(Link):
    """The listening side of a line with one peer: the first client is the peer until the line is lost.

    `open` binds and returns; the first read or write waits for a client. While one is connected, others are
    disconnected at once, except that a client without a certificate that has sent nothing for five seconds is
    replaced by the next. After a loss, `open` waits for the next client, on the same port.

    Args:
        host: Address to bind; loopback by default.
        port: Port; 0 lets the system choose.
        tls: Certificates; None for unencrypted connections.
        clock: Monotonic seconds.
    """

    kind = LinkKind.STREAM

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = 0,
        *,
        tls: TlsFiles | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._listener = Listener(host, port, tls=tls)
        self._patience = math.inf if tls else _PATIENCE
        self._clock = clock
        self._silent_since: float | None = None
        self._gives_way = False
        self._peer: PeerLink | None = None
        self._meeting = threading.Lock()
        self._open = False
        self._lost = ""

    @classmethod
    def from_url(cls, url: LinkUrl) -> TcpListenLink:
        """Build from ``tcp-listen://host:port``; without a host it binds to loopback."""
        url.check_keys(())
        url.check_no_path()
        return cls(*listen_address(url))

    @property
    def url(self) -> str:  # type: ignore[override]  # the port is known only after open()
        """Address, with the actual port."""
        return self._listener.url

    @property
    def listener(self) -> Listener:
        """The listener, for its counters."""
        return self._listener

    @property
    def is_open(self) -> bool:
        return self._open and not self._lost

    def open(self) -> None:
        if self._open and not self._lost:
            raise LinkBusyError(f"{self.url} is already open: one link object has one owner", url=self.url)
        if self._open:
            self._part()
            self._listener.forget_wake()
        else:
            self._listener.open()
        self._lost = ""
        self._open = True

    def close(self) -> None:
        self._open = False
        # The peer first: its reader may be serving the listener's descriptor.
        self._part()
        self._listener.close()
        self._part()
        self._lost = ""

    def _part(self) -> None:
        peer, self._peer = self._peer, None
        if peer is not None:
            peer.close()

    def wake(self) -> None:
        self._listener.wake()
        if self._peer is not None:
            self._peer.wake()

    def read(self, deadline: float | None) -> bytes:
        while True:
            peer = self._meet(deadline)
            if peer is None:
                return b""
            try:
                data = peer.read(deadline)
            except LinkLostError as error:
                raise self._lose(error) from error
            if data:
                self._silent_since = None
            if data or not self._gives_way:
                return data
            self._gives_way = False
            self._part()

    def write(self, data: bytes, deadline: float | None = None) -> None:
        peer = self._meet(deadline)
        if peer is None:
            if data:
                raise LinkTimeoutError(f"{self.url}: no client has connected yet", url=self.url)
            return
        try:
            peer.write(data, deadline)
        except LinkLostError as error:
            raise self._lose(error) from error

    def flush_input(self) -> int:
        peer = self._meet(0.0)
        return 0 if peer is None else peer.flush_input()

    def _meet(self, deadline: float | None) -> PeerLink | None:
        """The peer; waits for a client to connect."""
        peer = self._peer
        if peer is not None and not self._lost and self._open:
            return peer
        if not self._meeting.acquire(timeout=lock_timeout(deadline)):
            return None
        try:
            if not self._open:
                raise LinkClosedError(f"{self.url} is closed", url=self.url)
            if self._lost:
                raise LinkLostError(self._lost, url=self.url)
            if self._peer is None:
                self._peer = self._listener.accept(deadline, watched=self._doorbell)
                if self._peer is not None:
                    self._silent_since, self._gives_way = self._clock(), False
                    self._listener.turn_away()
            if not self.is_open:  # closed meanwhile, by a thread that did not see this peer
                self._part()
                raise LinkClosedError(f"{self.url} is closed", url=self.url)
            return self._peer
        finally:
            self._meeting.release()

    def _doorbell(self) -> dict[int, Callable[[], None]]:
        return {self._listener.fileno(): self._answer_door}

    def _answer_door(self) -> None:
        """Another client connects: disconnect it, or replace a silent client by it."""
        silent = self._silent_since
        if silent is None or self._clock() - silent < self._patience or self._peer is None:
            self._listener.turn_away()
        else:
            self._gives_way = True
            self._peer.wake()

    def _lose(self, error: LinkLostError) -> LinkLostError:
        self._lost = self._lost or str(error)
        return LinkLostError(self._lost, url=self.url)


class TcpsListenLink:
    """Builds `TcpListenLink` with TLS from an address."""

    @staticmethod
    def from_url(url: LinkUrl) -> TcpListenLink:
        """Build from ``tcps-listen://host:port?ca=ca.pem&cert=server.pem&key=server.key``."""
        from .tls import TlsFiles

        files = TlsFiles.from_url(url)
        host, port = listen_address(url)
        return TcpListenLink(host, port, tls=files)
