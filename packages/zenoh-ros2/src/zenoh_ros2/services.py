"""Services and clients of a node.

Owns which request an answer belongs to: the id of the client and its sequence number. Must not know what messages
mean.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from typing import Any

from .attachment import Attachment
from .callbacks import Callbacks
from .errors import ProtocolError, RemoteProtocolError, ServiceTimeoutError
from .keys import Endpoint, Role
from .parts import Owner, Part, ServiceCodec
from .zenoh_session import Request, Session

__all__ = ["Client", "Deferred", "Service"]

_MOST_PENDING = 1000
"""Requests of one service that may wait for their answers."""
_BURST = 200
"""Requests that may wait for the callback, if the quality of service does not allow more. `rmw_zenoh` drops the
oldest of eleven; here many clients may ask at once, and a dropped request leaves its client without any answer."""
_LOOK = 0.02
"""Seconds between two looks for a service."""


class Deferred:
    """The answer to a request, which is given later. A service's callback returns it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._send: Callable[[Any], None] | None = None
        self._response: Any = None
        self._answered = False

    def answer(self, response: Any) -> None:
        """Answer; only the first answer counts. Any thread may call it, at any time."""
        with self._lock:
            if self._answered:
                return
            self._answered, self._response = True, response
            send = self._send
        if send is not None:
            send(response)

    def bind(self, send: Callable[[Any], None]) -> None:
        """Give it the way to its client; for the node."""
        with self._lock:
            self._send = send
            answered = self._answered
        if answered:
            send(self._response)


class Service(Part):
    """Answers requests.

    Attributes:
        malformed: Requests that could not be read.
    """

    type: ServiceCodec

    def __init__(
        self,
        owner: Owner,
        endpoint: Endpoint,
        service: ServiceCodec,
        session: Session,
        callback: Callable[[Any], Any],
        callbacks: Callbacks,
    ) -> None:
        super().__init__(owner, endpoint)
        self.type, self._callback, self._callbacks = service, callback, callbacks
        self.malformed = 0
        self._lock = threading.Lock()
        self._pending: dict[tuple[bytes, int], Request] = {}
        self._inbox = callbacks.inbox(max(_BURST, self.qos.depth), self._handle)
        self._answers = callbacks.inbox(_MOST_PENDING, self._reply)
        self._begin(session.answer(endpoint.key, self._asked))

    @property
    def name(self) -> str:
        """Its full name."""
        return self.endpoint.name

    @property
    def pending(self) -> int:
        """Requests that wait for their answers."""
        with self._lock:
            return len(self._pending)

    def forget_clients(self, gids: Collection[bytes]) -> None:
        """Drop the requests of clients that have ended."""
        with self._lock:
            gone = [self._pending.pop(key) for key in list(self._pending) if key[0] in gids]
        for request in gone:
            request.drop()

    def _asked(self, request: Request) -> None:
        dropped = self._inbox.put(request)
        if dropped is not None:
            dropped.drop()
            self._warn(f"a request to {self.name} is dropped: too many wait")

    def _handle(self, request: Request) -> None:
        try:
            attachment = Attachment.parse(request.attachment)
            message = self.type.request.parse(request.payload)
            self._remember(attachment, request)
        except ProtocolError as error:
            self.malformed += 1
            request.drop()
            self._warn(f"a request to {self.name} is dropped: {error}")
            return
        try:
            response = self._callback(message)
        except Exception as error:
            self._take(attachment)
            request.fail(f"{self.name} failed: {error}")
            raise
        if isinstance(response, Deferred):
            response.bind(lambda value: self._send(attachment, value))
        else:
            self._send(attachment, response)

    def _remember(self, attachment: Attachment, request: Request) -> None:
        key = attachment.gid, attachment.sequence
        with self._lock:
            if key in self._pending:
                raise RemoteProtocolError(f"its number {attachment.sequence} is that of a request that waits")
            if len(self._pending) >= _MOST_PENDING:
                raise RemoteProtocolError(f"{_MOST_PENDING} requests wait for their answers")
            self._pending[key] = request

    def _take(self, attachment: Attachment) -> Request | None:
        with self._lock:
            return self._pending.pop((attachment.gid, attachment.sequence), None)

    def _send(self, attachment: Attachment, response: Any) -> None:
        request = self._take(attachment)
        if request is None:
            return
        try:
            payload = self.type.response.serialize(response)
        except Exception as error:
            request.fail(f"{self.name} failed: {error}")
            raise
        beside = Attachment(attachment.sequence, time.time_ns(), attachment.gid)
        answer = request, payload, beside.serialize()
        if self._callbacks.is_current:
            self._reply(answer)
        else:
            # Whoever decides an answer must not wait for a client that takes nothing.
            self._answers.put(answer)

    def _reply(self, answer: tuple[Request, bytes, bytes]) -> None:
        request, payload, beside = answer
        with self._callbacks.may_hang():
            request.reply(payload, beside)


class Client(Part):
    """Asks a service."""

    type: ServiceCodec

    def __init__(self, owner: Owner, endpoint: Endpoint, service: ServiceCodec, session: Session) -> None:
        super().__init__(owner, endpoint)
        self.type, self._session = service, session
        self._lock = threading.Lock()
        self._sequence = 0
        self._begin(lambda: None)

    @property
    def name(self) -> str:
        """Full name of the service."""
        return self.endpoint.name

    def is_offered(self) -> bool:
        """Whether a node offers the service."""
        return any(each.key == self.endpoint.key for each in self._owner.graph.find(Role.SERVICE, self.name))

    def wait_for_service(self, timeout: float) -> bool:
        """Wait until a node offers the service; returns whether one does.

        Args:
            timeout: Seconds.
        """
        deadline = time.monotonic() + timeout
        while not self.is_offered():
            if time.monotonic() >= deadline:
                return False
            time.sleep(_LOOK)
        return True

    def call(self, request: Any, timeout: float = 5.0) -> Any:
        """Ask, and wait for the answer.

        Args:
            request: The request.
            timeout: Seconds.

        Raises:
            ServiceTimeoutError: There is no answer in that time.
            LocalProtocolError: A field of the request does not fit its type.
        """
        payload = self.type.request.serialize(request)
        with self._lock:
            self._sequence += 1
            sequence = self._sequence
        beside = Attachment(sequence, time.time_ns(), self.gid).serialize()
        for answer, attached in self._session.ask(self.endpoint.key, payload, beside, timeout):
            try:
                attachment = Attachment.parse(attached)
                response = self.type.response.parse(answer)
            except ProtocolError as error:
                self._warn(f"an answer of {self.name} is dropped: {error}")
                continue
            if (attachment.gid, attachment.sequence) == (self.gid, sequence):
                return response
            self._warn(f"an answer of {self.name} is dropped: it is for another request")
        raise ServiceTimeoutError(f"{self.name} gives no answer")
