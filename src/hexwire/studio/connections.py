"""Connections to the server: bounded in number and in time.

Owns which connection is closed when there are too many, and the client certificate that each has shown.
"""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from uvicorn.protocols.http.h11_impl import H11Protocol

from .guard import PEER

if TYPE_CHECKING:
    from .access import Limits, Right

__all__ = ["make_protocol", "read_little"]

_READ = 4096
"""Bytes that are read at once of a socket. The loop takes apart all that was read before it does anything else: of
the usual 256 KiB that is 16,000 short messages, and a STOP would wait for them."""


def read_little(transport: Any) -> None:
    """Let a connection read few bytes at once, and decrypt no more than these complete.

    Args:
        transport: Of asyncio, whose loop is used, plain or over TLS.
    """
    tls = getattr(transport, "_ssl_protocol", None)
    if tls is None:
        transport.max_size = _READ
        return
    # It reads into a buffer of its own, which only grows.
    tls.max_size, tls._ssl_buffer = _READ, bytearray(_READ)
    tls._ssl_buffer_view = memoryview(tls._ssl_buffer)


def make_protocol(
    limits: Limits, right_of: Callable[[Mapping[str, Any]], Right | None] = lambda peer: None
) -> type[asyncio.Protocol]:
    """The class of the connections of one server.

    Args:
        limits: The bounds.
        right_of: What the holder of a verified client certificate may do, by what stands in it.
    """
    # In the order in which they have begun or last asked; those that have become sockets are not among them.
    present: dict[Any, None] = {}

    def worth(connection: Any) -> int:
        """The less, the sooner it gives way: has asked for nothing, is answered, waits for an answer."""
        return 0 if connection.cycle is None else 1 if connection.cycle.response_complete else 2

    class BoundedConnection(H11Protocol):
        """One connection, until it becomes a socket."""

        _timer: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.app_state = {**self.app_state, PEER: self._peer()}
            present[self] = None
            self._timer = asyncio.get_running_loop().call_later(limits.request, self._too_late)
            if len(present) > limits.connections:
                # Never this one: whoever holds all the others, by asking on each now and then, keeps no STOP away.
                min((each for each in present if each is not self), key=worth)._abort()

        def connection_lost(self, exc: Exception | None) -> None:
            self._forget()
            super().connection_lost(exc)

        def handle_events(self) -> None:
            before = self.cycle
            super().handle_events()
            if self.cycle is not before:
                self._end_timer()
                if self in present:
                    present[self] = present.pop(self)

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._forget()
            read_little(self.transport)
            super().handle_websocket_upgrade(event)

        def _peer(self) -> Right | None:
            tls = self.transport.get_extra_info("ssl_object")
            if tls is None or tls.context.verify_mode is not ssl.CERT_REQUIRED:
                return None
            return right_of(tls.getpeercert() or {})

        def _too_late(self) -> None:
            self._abort()

        def _abort(self) -> None:
            self._forget()
            self.transport.abort()

        def _forget(self) -> None:
            present.pop(self, None)
            self._end_timer()

        def _end_timer(self) -> None:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None

    return BoundedConnection
