"""What publishers, subscriptions, services and clients have in common: token, id, end, and what they need.

Owns the order in which an endpoint appears and vanishes, and the contracts of node and types. Must not know the
fields of messages, nor Zenoh.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from .callbacks import Callbacks
from .graph import Graph
from .keys import Endpoint, gid_of
from .qos import Qos

__all__ = ["Codec", "MessageCodec", "Owner", "Part", "ServiceCodec", "TypeSource"]


_PAUSE = 1.0
"""Least seconds between two warnings of an endpoint."""


class Codec(Protocol):
    """A type of messages or of services."""

    @property
    def name(self) -> str:
        """As in ``sensor_msgs/msg/JointState``."""

    @property
    def dds_name(self) -> str:
        """As in ``sensor_msgs::msg::dds_::JointState_``."""

    @property
    def hash(self) -> str:
        """As in ``RIHS01_...``."""


class MessageCodec(Codec, Protocol):
    """A type of messages."""

    def __call__(self, **fields: Any) -> Any:
        """A new message."""

    def serialize(self, message: Any) -> bytes:
        """The bytes of a message; raises `LocalProtocolError` if a field does not fit."""

    def parse(self, data: bytes) -> Any:
        """A message from bytes; raises `ProtocolError` if they are malformed."""


class ServiceCodec(Codec, Protocol):
    """A type of services."""

    @property
    def request(self) -> MessageCodec:
        """Its requests."""

    @property
    def response(self) -> MessageCodec:
        """Its responses."""


class TypeSource(Protocol):
    """Where types are found by their names."""

    def message(self, name: str) -> MessageCodec:
        """A type of messages, as in ``sensor_msgs/msg/JointState``; raises `UsageError` if there is none."""

    def service(self, name: str) -> ServiceCodec:
        """A type of services, as in ``std_srvs/srv/Trigger``; raises `UsageError` if there is none."""


class Owner(Protocol):
    """The node of an endpoint."""

    graph: Graph
    callbacks: Callbacks
    log: logging.Logger

    def show(self, endpoint: Endpoint) -> Callable[[], None]:
        """Show a token; returns a function that takes it back."""

    def forget(self, part: Part) -> None:
        """Forget an endpoint that has ended."""


class Part:
    """What every endpoint has: its token, its id, and its end."""

    type: Codec
    """Of its messages or requests."""

    def __init__(self, owner: Owner, endpoint: Endpoint) -> None:
        self._owner, self.endpoint = owner, endpoint
        self.gid = gid_of(endpoint.token)
        self._end: list[Callable[[], None]] = []
        self._warned = -math.inf

    @property
    def qos(self) -> Qos:
        """Its quality of service."""
        assert self.endpoint.qos is not None  # only nodes have none
        return self.endpoint.qos

    def _begin(self, end: Callable[[], None]) -> None:
        """Show it to others: once it works."""
        self._end = [self._owner.show(self.endpoint), end]

    def _warn(self, text: str) -> None:
        """Log a warning, unless there was one in the last second: what arrives must not fill the log."""
        now = time.monotonic()
        if now - self._warned >= _PAUSE:
            self._warned = now
            self._owner.log.warning("%s", text)

    def close(self) -> None:
        """End it; its token first."""
        ends, self._end = self._end, []
        for end in ends:
            end()
        self._owner.forget(self)
