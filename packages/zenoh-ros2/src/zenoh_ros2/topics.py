"""Publishers and subscriptions of a node.

Owns sequence numbers, what waits for a callback, and what is dropped. Must not know what messages mean.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from .attachment import Attachment, pack_attachment
from .errors import ProtocolError
from .keys import Endpoint, Role
from .parts import MessageCodec, Owner, Part
from .qos import History
from .zenoh_session import Session

__all__ = ["Publisher", "Subscription"]

_KEEP_ALL = 10_000
"""Messages that wait at most where none should be lost."""


class Publisher(Part):
    """Publishes messages of one topic."""

    type: MessageCodec

    def __init__(self, owner: Owner, endpoint: Endpoint, message: MessageCodec, session: Session) -> None:
        super().__init__(owner, endpoint)
        self.type = message
        self._lock = threading.Lock()
        self._sequence = 0
        self._put, self._matched, end = session.publisher(endpoint.key, self.qos)
        self._begin(end)

    @property
    def topic(self) -> str:
        """Its full name."""
        return self.endpoint.name

    def publish(self, message: Any) -> None:
        """Publish a message; a slow subscriber does not delay it.

        Raises:
            LocalProtocolError: A field of the message does not fit its type.
        """
        self.publish_serialized(self.type.serialize(message))

    def publish_serialized(self, payload: bytes) -> None:
        """Publish bytes that the type's `serialize` returned, for a message that has several topics."""
        with self._lock:
            self._sequence += 1
            self._put(payload, pack_attachment(self._sequence, time.time_ns(), self.gid))

    @property
    def has_readers(self) -> bool:
        """Whether anybody would get a message, also a program without a token; always if it is latched.

        It may be 50 ms old.
        """
        return self._matched()

    def subscriber_count(self) -> int:
        """How many subscriptions of this topic and type there are."""
        found = self._owner.graph.find(Role.SUBSCRIPTION, self.topic)
        return sum(each.key == self.endpoint.key for each in found)


class Subscription(Part):
    """Receives messages of one topic.

    Attributes:
        malformed: Messages that could not be read.
    """

    type: MessageCodec

    def __init__(
        self,
        owner: Owner,
        endpoint: Endpoint,
        message: MessageCodec,
        session: Session,
        callback: Callable[[Any, int], object],
    ) -> None:
        super().__init__(owner, endpoint)
        self.type, self._callback = message, callback
        self.malformed = 0
        depth = _KEEP_ALL if self.qos.history is History.KEEP_ALL else self.qos.depth
        self._inbox = owner.callbacks.inbox(depth, self._handle)
        end = session.subscribe(endpoint.key, self.qos, lambda *sample: self._inbox.put(sample))
        self._begin(end)

    @property
    def topic(self) -> str:
        """Its full name."""
        return self.endpoint.name

    @property
    def dropped(self) -> int:
        """Messages that were dropped because newer ones arrived before they could be handled."""
        return self._inbox.dropped

    def _handle(self, sample: tuple[bytes, bytes | None]) -> None:
        payload, beside = sample
        try:
            attachment = Attachment.parse(beside)
            message = self.type.parse(payload)
        except ProtocolError as error:
            self.malformed += 1
            self._warn(f"a message of {self.topic} is dropped: {error}")
            return
        self._callback(message, attachment.stamp)
