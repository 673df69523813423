"""A ROS 2 node: publishers, subscriptions, services and clients on the wire of `rmw_zenoh`.

Owns its session, its names and the numbers of its endpoints. Must not know what messages mean.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

from . import type_descriptions
from .callbacks import Callbacks, Inbox
from .distributions import Distribution
from .errors import SessionClosedError, UsageError
from .graph import Graph
from .keys import MOST_DOMAIN, Endpoint, Role, domain_of, gid_of, graph_pattern
from .logging import LOG, TIME, RosoutHandler
from .mismatches import describe_mismatch
from .names import Kind, Remap, full_name, logger_name, remap_node, resolve
from .parts import MessageCodec, Part, ServiceCodec, TypeSource
from .qos import DEFAULT, ROSOUT, SERVICES, Qos
from .router_watch import RouterWatch
from .services import Client, Deferred, Service
from .topics import Publisher, Subscription
from .types import Types
from .zenoh_session import Session, ZenohSettings

__all__ = ["Client", "Deferred", "Node", "NodeOptions", "Publisher", "Service", "Subscription"]

_MOST_NEWS = 10_000
"""Changes in the graph that may wait."""
_CLOSING = 3.0
"""Most seconds for which `close` waits until others are told that the node ends."""
_MOST_TOLD, _TELLING = 50, 60.0
"""Most warnings of what is in the graph, and in how many seconds."""


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
        rosout: Whether it publishes the program's log.
        loggers: Names of the loggers whose records that is, with those of the loggers below them; all by default.
        type_descriptions: Whether it serves what its messages consist of.
    """

    name: str
    namespace: str = "/"
    domain: int = 0
    remaps: tuple[Remap, ...] = ()
    enclave: str = "/"
    zenoh: ZenohSettings = field(default_factory=ZenohSettings)
    rosout: bool = True
    loggers: tuple[str, ...] = ("",)
    type_descriptions: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= MOST_DOMAIN:
            raise UsageError(f"ROS_DOMAIN_ID is {self.domain}; it must be 0 to {MOST_DOMAIN}")


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
        self._urgent = Callbacks(f"{self.name}, urgent")
        self.log = logging.getLogger(f"{__name__}.{self.full_name.strip('/').replace('/', '.')}")
        self._lock = threading.Lock()
        self._session: Session | None = None
        self._parts: list[Part] = []
        self._next_id = 0
        self._end: list[Callable[[], None]] = []
        self._news = self.callbacks.inbox(_MOST_NEWS, self._noticed)
        self._more_types: dict[str, Any] = {}
        self._told: deque[float] = deque()

    @classmethod
    def from_environment(
        cls, name: str, types: TypeSource | None = None, environment: Mapping[str, str] = os.environ
    ) -> Self:
        """A node with the domain and the router that the variables of `rmw_zenoh` name.

        Args:
            name: Its name.
            types: Its messages and services; without any, all that the package has, of the distribution that
                ROS_DISTRO names, or Jazzy.
            environment: The variables.

        Raises:
            UsageError: A variable, or the name, is not valid.
        """
        zenoh = ZenohSettings.from_environment(environment)
        options = NodeOptions(name, domain=domain_of(environment), zenoh=zenoh)
        return cls(options, types or Types(Distribution.from_environment(environment)))

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
            RouterNotFoundError: There is no router in the given time.
            SessionError: The session cannot be opened.
            UsageError: A setting of Zenoh is not valid, or a file of them.
        """
        gid_of("")
        settings = self.options.zenoh
        self._session = session = settings.open(self._miss_router)
        self.callbacks.start()
        self._urgent.start()
        watch = session.watch_tokens(graph_pattern(self.options.domain), self._changed)
        self._end = [self.show(self._endpoint(Role.NODE)), watch]
        if self.options.rosout:
            self._end.insert(0, self._publish_log())
        if self.options.type_descriptions:
            self._serve_type_descriptions()
        attempts = 1 if settings.attempts is None else settings.attempts
        if attempts >= 0:
            router = RouterWatch(
                lambda: session.routers, session.endpoints, settings.how_to_start_a_router, self.log
            )
            router.wait(attempts)
            router.start()
            self._end.insert(0, router.stop)

    def close(self) -> None:
        """Vanish from the graph: every endpoint, then the node itself."""
        session, ends = self._session, self._end
        self._end = []
        if session is None or not ends:
            return
        if self.callbacks.is_current:
            self._close(session, ends)
            return
        # Telling a node that takes nothing lasts until its connection ends. The program waits for that before its
        # end, but what it has to do until then, such as closing the robot, does not wait.
        closing = threading.Thread(target=self._close, args=(session, ends), name="close the node")
        closing.start()
        closing.join(_CLOSING)

    def _close(self, session: Session, ends: list[Callable[[], None]]) -> None:
        *before, token, watch = ends
        for end in before:
            end()
        for part in reversed(self._parts.copy()):
            part.close()
        token()
        watch()
        self.callbacks.stop()
        self._urgent.stop()
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
            SessionClosedError: The node is not open.
            UsageError: The name is not valid.
        """
        message = self.types.message(type_name)
        endpoint = self._endpoint(Role.PUBLISHER, self.resolve(topic), message, qos)
        return self._add(Publisher(self, endpoint, message, self._open_session))

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, int], object], qos: Qos = DEFAULT
    ) -> Subscription:
        """Declare a subscription; otherwise as `publisher`.

        Args:
            topic: Its name.
            type_name: Of its messages.
            callback: Gets each message, and when it was sent, nanoseconds of Unix time. It must not wait long.
            qos: Its quality of service.
        """
        message = self.types.message(type_name)
        endpoint = self._endpoint(Role.SUBSCRIPTION, self.resolve(topic), message, qos)
        return self._add(Subscription(self, endpoint, message, self._open_session, callback))

    def service(
        self,
        name: str,
        type_name: str,
        callback: Callable[[Any], Any],
        qos: Qos = SERVICES,
        *,
        urgent: bool = False,
    ) -> Service:
        """Declare a service; otherwise as `publisher`.

        Args:
            name: Its name.
            type_name: As in ``std_srvs/srv/Trigger``.
            callback: Gets each request, and returns the response or a `Deferred`. It must not wait long.
            qos: Its quality of service.
            urgent: It does not wait for what arrived earlier: reading a long message takes seconds.
        """
        service = self.types.service(type_name)
        endpoint = self._endpoint(Role.SERVICE, self.resolve(name, Kind.SERVICE), service, qos)
        callbacks = self._urgent if urgent else self.callbacks
        return self._add(Service(self, endpoint, service, self._open_session, callback, callbacks))

    def client(self, name: str, type_name: str, qos: Qos = SERVICES) -> Client:
        """Declare a client of a service; otherwise as `publisher`."""
        service = self.types.service(type_name)
        endpoint = self._endpoint(Role.CLIENT, self.resolve(name, Kind.SERVICE), service, qos)
        return self._add(Client(self, endpoint, service, self._open_session))

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

    def tell_type(self, kind: Any) -> None:
        """Serve the description of a type that the node uses as a whole, such as an action."""
        with self._lock:
            self._more_types[kind.hash] = kind

    def _miss_router(self, why: str) -> None:
        remedy = self.options.zenoh.how_to_start_a_router
        self.log.warning("%s. This node waits for a Zenoh router: %s", why, remedy)

    def _types_in_use(self) -> dict[str, Any]:
        with self._lock:
            return self._more_types | {part.type.hash: part.type for part in self._parts}

    def _serve_type_descriptions(self) -> None:
        service = self.types.service(type_descriptions.TYPE)
        # Humble knows neither hashes nor this service.
        if service.hash.startswith("RIHS01_"):
            answer = type_descriptions.make_answer(service.response, self._types_in_use)
            self.service(type_descriptions.NAME, type_descriptions.TYPE, answer)

    def _publish_log(self) -> Callable[[], None]:
        """Publish the log of the program; returns a function that ends it."""
        publisher = self.publisher("/rosout", LOG, ROSOUT)
        types = self.types.message(LOG), self.types.message(TIME)
        wake: Inbox[None] = self.callbacks.inbox(1, lambda _: handler.flush())
        handler = RosoutHandler(
            logger_name(self.full_name), self.log.name, types, publisher.publish, lambda: wake.put(None)
        )
        loggers = [logging.getLogger(name) for name in self.options.loggers]
        for logger in loggers:
            logger.addHandler(handler)

        def end() -> None:
            for logger in loggers:
                logger.removeHandler(handler)
            handler.flush()

        return end

    @property
    def _open_session(self) -> Session:
        if self._session is None:
            raise SessionClosedError(f"the node {self.full_name} is not open")
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
        self._compare(part)
        return part

    def _changed(self, token: str, alive: bool) -> None:
        endpoint = self.graph.add(token) if alive else self.graph.remove(token)
        if endpoint is not None:
            self._news.put((endpoint, token, alive))

    def _noticed(self, news: tuple[Endpoint, str, bool]) -> None:
        """Draw the consequences of a change in the graph."""
        endpoint, token, alive = news
        if not alive:
            if endpoint.role is Role.CLIENT:
                # The id is made of the token: in canonical form by `rmw_zenoh`, as it stands by others.
                gids = {gid_of(token), gid_of(endpoint.token)}
                for service in self._services(endpoint.key):
                    service.forget_clients(gids)
        elif endpoint.role is Role.NODE:
            own = endpoint.session_node == (self._open_session.zid, "0")
            if not own and full_name(endpoint.namespace, endpoint.node) == self.full_name:
                self._tell(
                    f"Another node has the name '{self.full_name}', too. Be aware that nodes in the graph that "
                    "share an exact name can have unintended side effects"
                )
        else:
            with self._lock:
                parts = self._parts.copy()
            for text in {describe_mismatch(part.endpoint, endpoint) for part in parts} - {""}:
                self._tell(text)

    def _tell(self, text: str) -> None:
        """Warn of something in the graph. Others may make up any number of nodes."""
        now = time.monotonic()
        while self._told and now - self._told[0] > _TELLING:
            self._told.popleft()
        if len(self._told) < _MOST_TOLD:
            self._told.append(now)
            self.log.warning("%s", text)

    def _compare(self, part: Part) -> None:
        """Compare a new endpoint with those that are in the graph already."""
        for endpoint in self.graph:
            if endpoint.name == part.endpoint.name and (text := describe_mismatch(part.endpoint, endpoint)):
                self._tell(text)

    def _services(self, key: str) -> Iterator[Service]:
        with self._lock:
            parts = self._parts.copy()
        return (part for part in parts if isinstance(part, Service) and part.endpoint.key == key)
