"""The listening side of TCP, for servers with many clients.

Owns the listening socket, the running TLS handshakes, the admission of clients, and the poller of all these: epoll,
or what other systems have. Must not know what the bytes mean. Binds to loopback by default.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import sys
import threading
from collections import Counter
from dataclasses import dataclass, replace
from time import monotonic, sleep
from typing import TYPE_CHECKING, Protocol

from hexwire.errors import LinkBusyError, LinkClosedError, LinkError, LinkNotFoundError, LinkPermissionError
from hexwire.system import READABLE, make_poll

from .base import Openable, lock_timeout, poll_timeout
from .tcp import ByteStream, PeerLink, PlainStream, find_addresses, host_and_port, prepare
from .url import LinkUrl
from .waker import Waker

if TYPE_CHECKING:
    import ssl
    from collections.abc import Callable

    from .tls import TlsFiles, TlsStream

__all__ = ["LOOPBACK", "Listener", "PlainPoller", "Poller", "explain_bind", "listen_address", "make_poller"]

LOOPBACK = "127.0.0.1"
# Clients that may connect while another is being accepted; the kernel makes others retry a second later.
_BACKLOG = 128
# Seconds of rest when there is no free descriptor.
_PAUSE = 0.01


@dataclass
class _Handshake:
    """A client that has not shown a valid certificate yet."""

    stream: TlsStream
    peer: str
    deadline: float


class Listener(Openable):
    """Accepts clients, each as a separate link.

    Under TLS a client becomes a link only after its certificate is found valid; clients with a slow or endless
    handshake do not delay others.

    Args:
        host: Address to bind; loopback by default.
        port: Port; 0 lets the system choose, see `port` after `open`.
        tls: Certificates; None for unencrypted connections.
        handshake_timeout: Seconds that a client has for the TLS handshake.
        max_handshakes: Maximum number of simultaneous handshakes; one more ends the oldest of the host with most.

    Attributes:
        refused: Number of clients refused.
        last_refusal: Reason of the last refusal, for a log.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = 0,
        *,
        tls: TlsFiles | None = None,
        handshake_timeout: float = 5.0,
        max_handshakes: int = 16,
    ) -> None:
        self.host = host
        self.port = port
        self.refused = 0
        self.last_refusal = ""
        self._scheme = "tcp-listen" if tls is None else "tcps-listen"
        self._wanted_port = port
        self._tls = tls
        self._handshake_timeout = handshake_timeout
        self._max_handshakes = max_handshakes
        self._handshakes: dict[int, _Handshake] = {}
        self._socket: socket.socket | None = None
        # The socket and the running handshakes, as one descriptor that others can watch as well.
        self._poller: Poller | None = None
        self._waker = Waker()
        self._closing = False
        self._close_pending = False
        self._context: ssl.SSLContext | None = None
        self._accepting = threading.RLock()
        self._accepter = 0

    @property
    def url(self) -> str:
        """Address of the listener, with the actual port."""
        return f"{self._scheme}://{host_and_port(self.host, self.port)}"

    def open(self) -> None:
        """Bind and listen.

        Raises:
            LinkBusyError: The port already has a listener.
            LinkNotFoundError: This machine has no such address.
            LinkPermissionError: The port is reserved.
            UsageError: The certificates cannot be used.
        """
        if self._socket is not None:
            raise LinkBusyError(f"{self.url} is already listening", url=self.url)
        context = self._tls.server_context() if self._tls else None
        family, address = find_addresses(self.host, self._wanted_port, self.url, passive=True)[0]
        with contextlib.ExitStack() as undo:
            try:
                undo.callback(self._waker.close)
                self._waker.open()
                poller = make_poller(self._waker.fileno())
                undo.callback(poller.close)
                listening = socket.socket(family)
                undo.callback(listening.close)
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listening.setblocking(False)
                listening.bind(address)
                listening.listen(_BACKLOG)
                poller.register(listening.fileno(), READABLE)
            except OSError as error:
                raise explain_bind(error, self.url) from error
            undo.pop_all()
        self._context = context
        self._poller = poller
        self.port = listening.getsockname()[1]
        self._closing = False
        self._socket = listening

    def close(self) -> None:
        """Stop listening; accepted links stay open. Harmless if closed; allowed from any thread."""
        self._closing = True
        self._waker.set()
        if self._accepter == threading.get_ident():
            self._close_pending = True  # a signal handler inside accept(), which does it on leaving
            return
        self._close_pending = False
        with self._accepting:
            for handshake in self._handshakes.values():
                handshake.stream.close()
            self._handshakes.clear()
            if self._socket is not None and self._poller is not None:
                self._poller.close()
                self._socket.close()
                self._poller = self._socket = None
            self._waker.close()

    def fileno(self) -> int:
        """Descriptor that becomes readable when `accept` has something to do, for servers that watch many links.

        Under TLS that includes running handshakes, so `accept` may return without a client.
        """
        if self._poller is None:
            raise self._closed()
        return self._poller.fileno()

    def wake(self) -> None:
        """Make the waiting `accept`, or otherwise the next one, return None. Allowed from any thread."""
        self._waker.set()

    def accept(
        self, deadline: float | None, *, watched: Callable[[], dict[int, Callable[[], None]]] = dict
    ) -> PeerLink | None:
        """Wait for a client.

        Args:
            deadline: Value of `time.monotonic` at which to give up; None waits forever.
            watched: Further descriptors that the new link's reader serves.

        Returns:
            The open link to it, or None at the deadline or after `wake`.

        Raises:
            LinkClosedError: The listener is not open, or was closed during the wait.
        """
        if not self._accepting.acquire(timeout=lock_timeout(deadline)):
            if self._closing:
                raise self._closed()  # the one who has it is close()
            return None
        self._accepter = threading.get_ident()
        woken = False
        try:
            while self._socket is not None and self._poller is not None and not self._closing:
                if woken:
                    self._waker.clear()
                    return None
                peer, woken = self._step(self._socket, self._poller, deadline, watched)
                if peer is not None:
                    return peer
                # Woken by wake(), or because the listener was closed: look again.
                if not woken and deadline is not None and monotonic() >= deadline:
                    return None
            raise self._closed()
        finally:
            self._accepter = 0
            self._accepting.release()
            if self._close_pending:
                self.close()

    def turn_away(self) -> None:
        """Disconnect all clients that are connecting now, including running handshakes."""
        with self._accepting:
            self._accepter = threading.get_ident()
            for fd in list(self._handshakes):
                self._drop(fd, "busy with another client")
            with contextlib.suppress(OSError):  # no more clients
                while self._socket is not None:
                    self._socket.accept()[0].close()
                    self._refuse("busy with another client")
            self._accepter = 0
        if self._close_pending:
            self.close()

    def _step(
        self,
        listening: socket.socket,
        poller: Poller,
        deadline: float | None,
        watched: Callable[[], dict[int, Callable[[], None]]],
    ) -> tuple[PeerLink | None, bool]:
        """Wait once for a client, a handshake or the deadline, and serve it; True if woken."""
        until = [handshake.deadline for handshake in self._handshakes.values()]
        if deadline is not None:
            until.append(deadline)
        ready = poller.wait(poll_timeout(min(until, default=None)))
        woken = self._waker.fileno() in ready
        if self._closing:
            return None, woken
        peer = None
        called = False
        for fd in ready:
            if fd == listening.fileno():
                called = True
            elif peer is None and fd in self._handshakes:
                peer = self._shake(fd, poller, watched)
        for fd in [fd for fd, shake in self._handshakes.items() if shake.deadline <= monotonic()]:
            self._drop(fd, "no TLS handshake in time")
        if called and peer is None:
            peer = self._greet(listening, poller, watched)
        return peer, woken

    def _greet(
        self,
        listening: socket.socket,
        poller: Poller,
        watched: Callable[[], dict[int, Callable[[], None]]],
    ) -> PeerLink | None:
        """Accept a new client: as a link, or under TLS into the handshake."""
        try:
            caller, address = listening.accept()
        except OSError as error:
            # It has disconnected, or this process has no descriptor left: neither ends the listener.
            if error.errno in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
                self._refuse(f"no room: {error.strerror}")
                self._make_room()
            return None
        peer = host_and_port(address[0], address[1])
        try:
            prepare(caller)
        except OSError:
            caller.close()
            self._refuse(f"{peer}: disconnected at once")
            return None
        if self._context is None:
            return self._admit(PlainStream(caller), peer, watched)
        from .tls import TlsStream

        if len(self._handshakes) >= self._max_handshakes:
            self._drop(self._most_pressing(), "too many TLS handshakes at once")
        stream = TlsStream(caller, self._context)
        self._handshakes[caller.fileno()] = _Handshake(stream, peer, monotonic() + self._handshake_timeout)
        poller.register(caller.fileno(), stream.wants)
        return self._shake(caller.fileno(), poller, watched)

    def _shake(
        self, fd: int, poller: Poller, watched: Callable[[], dict[int, Callable[[], None]]]
    ) -> PeerLink | None:
        """Advance a handshake by one step."""
        handshake = self._handshakes[fd]
        try:
            if not handshake.stream.handshake():
                poller.modify(fd, handshake.stream.wants)
                return None
        except OSError as error:
            self._drop(fd, str(error))
            return None
        poller.unregister(fd)
        del self._handshakes[fd]
        return self._admit(handshake.stream, handshake.peer, watched)

    def _admit(
        self, stream: ByteStream, peer: str, watched: Callable[[], dict[int, Callable[[], None]]]
    ) -> PeerLink | None:
        try:
            return PeerLink(self.url, stream, peer, watched())
        except LinkError as error:  # no descriptor left for its wakers
            stream.close()
            self._refuse(str(error))
            return None

    def forget_wake(self) -> None:
        """Forget a `wake` that no `accept` has seen."""
        self._waker.clear()

    def _drop(self, fd: int, why: str) -> None:
        handshake = self._handshakes.pop(fd)
        # A client that has gone may be out of it already.
        with contextlib.suppress(OSError):
            if self._poller is not None:
                self._poller.unregister(fd)
        handshake.stream.close()
        self._refuse(f"{handshake.peer}: {why}")

    def _most_pressing(self) -> int:
        """The oldest handshake of the host with most: a host that keeps connecting must not keep others out."""
        hosts = Counter(handshake.peer.rpartition(":")[0] for handshake in self._handshakes.values())
        host = hosts.most_common(1)[0][0]
        return next(fd for fd, handshake in self._handshakes.items() if handshake.peer.rpartition(":")[0] == host)

    def _make_room(self) -> None:
        """Without a free descriptor a client can neither be accepted nor refused: wait a moment, do not spin."""
        if self._handshakes:
            self._drop(self._most_pressing(), "no room")
        else:
            sleep(_PAUSE)

    def _refuse(self, why: str) -> None:
        self.refused += 1
        self.last_refusal = why

    def _closed(self) -> LinkClosedError:
        return LinkClosedError(f"{self.url} is closed", url=self.url)


def listen_address(url: LinkUrl) -> tuple[str, int]:
    """Host and port to bind; ``:15030`` means loopback."""
    if url.netloc.startswith(":") and not url.netloc.startswith("::"):
        url = replace(url, netloc=LOOPBACK + url.netloc)
    return url.host_port()


def explain_bind(error: OSError, url: str) -> LinkError:
    """Turn a failed bind into an error with advice."""
    if error.errno == errno.EADDRINUSE:
        return LinkBusyError(f"{url}: that port is in use; stop the other program, or choose another port", url=url)
    if error.errno == errno.EADDRNOTAVAIL:
        return LinkNotFoundError(f"{url}: this machine has no such address; see 'ip address'", url=url)
    if error.errno in (errno.EACCES, errno.EPERM):
        return LinkPermissionError(f"{url}: this user may not use that port; choose one above 1023", url=url)
    return LinkError(f"{url} cannot be opened: {error.strerror or error}", url=url)


class Poller(Protocol):
    """Descriptors with the events that are waited for, and a waker."""

    def fileno(self) -> int:
        """A descriptor that becomes readable when one of them is ready, for programs that watch many servers.

        Of `PlainPoller` it is the first one, so only asking shows what a client has sent that is still connecting.
        """

    def register(self, fd: int, eventmask: int, /) -> None:
        """Add a descriptor."""

    def modify(self, fd: int, eventmask: int, /) -> None:
        """Change the events of a descriptor."""

    def unregister(self, fd: int, /) -> None:
        """Remove a descriptor, before it is closed."""

    def wait(self, timeout: float | None) -> list[int]:
        """Wait at most `timeout` milliseconds, forever if None; returns what is ready, the waker included."""

    def close(self) -> None:
        """Free what the system holds for it; the descriptors stay open."""


class PlainPoller:
    """For systems without epoll.

    Args:
        waker: Descriptor of the waker.
    """

    def __init__(self, waker: int) -> None:
        self._waker = waker
        self._events: dict[int, int] = {}

    def fileno(self) -> int:
        return next(iter(self._events), -1)

    def register(self, fd: int, eventmask: int) -> None:
        self._events[fd] = eventmask

    def modify(self, fd: int, eventmask: int) -> None:
        self._events[fd] = eventmask

    def unregister(self, fd: int) -> None:
        del self._events[fd]

    def wait(self, timeout: float | None) -> list[int]:
        poll = make_poll()
        for fd, events in ((self._waker, READABLE), *self._events.items()):
            poll.register(fd, events)
        return [fd for fd, _ in poll.poll(timeout)]

    def close(self) -> None:
        self._events.clear()


if sys.platform == "linux" and hasattr(select, "epoll"):

    class _EpollPoller:
        def __init__(self, waker: int) -> None:
            self._all = select.epoll()
            self.register, self.modify, self.unregister = self._all.register, self._all.modify, self._all.unregister
            self._poll = make_poll()
            self._poll.register(self._all.fileno(), READABLE)
            self._poll.register(waker, READABLE)

        def fileno(self) -> int:
            return self._all.fileno()

        def wait(self, timeout: float | None) -> list[int]:
            ready = [fd for fd, _ in self._poll.poll(timeout)]
            if self._all.fileno() not in ready:
                return ready
            ready.remove(self._all.fileno())
            return ready + [fd for fd, _ in self._all.poll(0.0)]

        def close(self) -> None:
            self._all.close()


def make_poller(waker: int) -> Poller:
    """Nothing but a waker's descriptor.

    Raises:
        OSError: The system has no descriptor left.
    """
    if sys.platform == "linux" and hasattr(select, "epoll"):
        return _EpollPoller(waker)
    return PlainPoller(waker)
