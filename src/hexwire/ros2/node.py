"""A ROS 2 node: publishers, subscriptions, services and clients on the wire of `rmw_zenoh`.

Owns its session, its names and the numbers of its endpoints. Must not know what messages mean.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

from hexwire.control.log_limiter import LogLimiter
from hexwire.errors import LinkClosedError, UsageError

from .callbacks import Callbacks
from .graph import Graph
from .keys import Endpoint, Role, gid_of, graph_pattern
from .names import Kind, Remap, full_name, remap_node, resolve
from .parts import MessageCodec, Part, ServiceCodec, TypeSource
from .qos import DEFAULT, SERVICES, Qos
from .services import Client, Deferred, RequestId, Service
from .topics import Publisher, Subscription
from .zenoh_session import Session, ZenohSettings

__all__ = ["Client", "Deferred", "Node", "NodeOptions", "Publisher", "RequestId", "Service", "Subscription"]

_MOST_DOMAIN = 4294967295


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """Who a node is, and how it reaches others.

    Attributes:
        name: Its name, before remapping.
        namespace: Its namespace, before remapping.
        domain: ROS_DOMAIN_ID.
        remaps: Rules; the first that applies counts.
        enclave: Its security enclave, ``/`` for none.
        zenoh: How its session is set up.
    """

    name: str
    namespace: str = "/"
    domain: int = 0
    remaps: tuple[Remap, ...] = ()
    enclave: str = "/"
    zenoh: ZenohSettings = field(default_factory=ZenohSettings)

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= _MOST_DOMAIN:
            raise UsageError(f"ROS_DOMAIN_ID is {self.domain}; it must be 0 to {_MOST_DOMAIN}")


_T = TypeVar("_T", bound=Part)


class Node:
    """A node.

    Args:
        options: Who it is.
        types: Its messages and services.

    Attributes:
        name: Its name, after remapping.
        namespace: Its namespace, after remapping.
        graph: Which other nodes and endpoints there are.

    Raises:
        UsageError: Its name or namespace is not valid.
    """

    def __init__(self, options: NodeOptions, types: TypeSource) -> None:
        self.options, self.types = options, types
        self.namespace, self.name = remap_node(options.namespace, options.name, options.remaps)
        self.graph = Graph()
        self.callbacks = Callbacks(self.name)
        self.log = logging.getLogger(f"{__name__}.{self.full_name.strip('/').replace('/', '.')}")
        self._lock = threading.Lock()
        self._limiter = LogLimiter()
        self._session: Session | None = None
        self._parts: list[Part] = []
        self._next_id = 0
        self._end: list[Callable[[], None]] = []

    @property
    def full_name(self) -> str:
        """Namespace and name."""
        return full_name(self.namespace, self.name)

    @property
    def routers(self) -> int:
        """Number of routers that it is connected to."""
        return self._session.routers if self._session is not None else 0

    def open(self) -> None:
        """Appear in the graph. The node connects to the router in the background, and again after a loss.

        Raises:
            LinkPermissionError: The session cannot be opened.
            NotSupportedError: Zenoh or xxhash is not installed.
            UsageError: A setting of Zenoh is not valid.
        """
        gid_of("")
        self._session = session = self.options.zenoh.open()
        self.callbacks.start()
        watch = session.watch_tokens(graph_pattern(self.options.domain), self._changed)
        self._end = [self.show(self._endpoint(Role.NODE)), watch]

    def close(self) -> None:
        """Vanish from the graph: every endpoint, then the node itself."""
        session = self._session
        if session is None or session.is_closed:
            return
        for part in reversed(self._parts.copy()):
            part.close()
        for end in self._end:
            end()
        self.callbacks.stop()
        session.close()

    def __enter__(self) -> Node:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def resolve(self, name: str, kind: Kind = Kind.TOPIC) -> str:
        """The full name of a topic or service, by ROS's rules.

        Raises:
            UsageError: It is not valid.
        """
        return resolve(name, self.namespace, self.name, kind, self.options.remaps)

    def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        """Declare a publisher.

        Args:
            topic: Its name, as written in the program: relative, absolute or private.
            type_name: As in ``sensor_msgs/msg/JointState``.
            qos: Its quality of service.

        Raises:
            LinkClosedError: The node is not open.
            UsageError: The name is not valid.
        """
        message = self.types.message(type_name)
        endpoint = self._endpoint(Role.PUBLISHER, self.resolve(topic), message, qos)
        return self._add(Publisher(self, endpoint, message, self._open_session))

    def subscribe(
        self, topic: str, type_name: str, qos: Qos, callback: Callable[[Any, int], object]
    ) -> Subscription:
        """Declare a subscription; otherwise as `publisher`.

        Args:
            topic: Its name.
            type_name: Of its messages.
            qos: Its quality of service.
            callback: Gets each message, and when it was sent, nanoseconds of Unix time. It must not wait long.
        """
        message = self.types.message(type_name)
        endpoint = self._endpoint(Role.SUBSCRIPTION, self.resolve(topic), message, qos)
        return self._add(Subscription(self, endpoint, message, self._open_session, callback))

    def service(self, name: str, type_name: str, callback: Callable[[Any], Any], qos: Qos = SERVICES) -> Service:
        """Declare a service; otherwise as `publisher`.

        Args:
            name: Its name.
            type_name: As in ``std_srvs/srv/Trigger``.
            callback: Gets each request, and returns the response or a `Deferred`. It must not wait long.
            qos: Its quality of service.
        """
        service = self.types.service(type_name)
        endpoint = self._endpoint(Role.SERVICE, self.resolve(name, Kind.SERVICE), service, qos)
        return self._add(Service(self, endpoint, service, self._open_session, callback))

    def client(self, name: str, type_name: str, qos: Qos = SERVICES) -> Client:
        """Declare a client of a service; otherwise as `publisher`."""
        service = self.types.service(type_name)
        endpoint = self._endpoint(Role.CLIENT, self.resolve(name, Kind.SERVICE), service, qos)
        return self._add(Client(self, endpoint, service, self._open_session))

    def get_logger(self, name: str = "") -> logging.Logger:
        """The logger of this node, or one below it."""
        return self.log.getChild(name) if name else self.log

    def warn(self, text: str) -> None:
        """Log a warning, at most once a second."""
        if self._limiter.due(text, time.monotonic()):
            self.log.warning("%s", text)

    def show(self, endpoint: Endpoint) -> Callable[[], None]:
        """Show the token of an endpoint; returns a function that takes it back. For the endpoints."""
        self.graph.add(endpoint.token)
        end = self._open_session.declare_token(endpoint.token)

        def hide() -> None:
            end()
            self.graph.remove(endpoint.token)

        return hide

    def forget(self, part: Part) -> None:
        """Forget an endpoint that has ended. For the endpoints."""
        with self._lock, contextlib.suppress(ValueError):
            self._parts.remove(part)

    @property
    def _open_session(self) -> Session:
        if self._session is None:
            raise LinkClosedError(f"the node {self.full_name} is not open")
        return self._session

    def _endpoint(
        self, role: Role, name: str = "", kind: MessageCodec | ServiceCodec | None = None, qos: Qos | None = None
    ) -> Endpoint:
        zid = self._open_session.zid
        with self._lock:
            number, self._next_id = self._next_id, self._next_id + 1
        options = self.options
        names = (name, kind.dds_name, kind.hash, qos) if kind is not None else ("", "", "", None)
        return Endpoint(
            options.domain, zid, "0", str(number), role, options.enclave, self.namespace, self.name, *names
        )

    def _add(self, part: _T) -> _T:
        with self._lock:
            self._parts.append(part)
        return part

    def _changed(self, token: str, alive: bool) -> None:
        endpoint = self.graph.add(token) if alive else self.graph.remove(token)
        if endpoint is not None and endpoint.role is Role.CLIENT and not alive:
            gid = gid_of(token)
            for part in self._services(endpoint.key):
                part.forget_client(gid)

    def _services(self, key: str) -> Iterator[Service]:
        with self._lock:
            parts = self._parts.copy()
        return (part for part in parts if isinstance(part, Service) and part.endpoint.key == key)
