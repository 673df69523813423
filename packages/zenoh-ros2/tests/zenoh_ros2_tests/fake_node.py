"""A node that is made up: it has names, publishers, subscriptions and services, and sends nothing."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from zenoh_ros2.graph import Graph
from zenoh_ros2.keys import Endpoint, Role
from zenoh_ros2.names import Kind, remap_node, resolve
from zenoh_ros2.node import Deferred, NodeOptions
from zenoh_ros2.qos import DEFAULT, SERVICES, Qos
from zenoh_ros2.types import Types


class FakePublisher:
    """
    Attributes:
        sent: What it has published, as others read it.
        has_readers: Whether anybody reads it.
    """

    has_readers = True

    def __init__(self, node: FakeNode, topic: str, type_name: str, qos: Qos) -> None:
        self.topic, self.type, self.qos = topic, node.types.message(type_name), qos
        self.sent: list[Any] = []
        self.open = True
        self._node = node

    def publish(self, message: Any) -> None:
        self.publish_serialized(self.type.serialize(message))

    def publish_serialized(self, payload: bytes) -> None:
        assert self.open
        self.sent.append(self.type.parse(payload))
        self._node.said.append((self.topic, self.sent[-1]))

    def close(self) -> None:
        self.open = False


class FakeSubscription:
    """
    Args:
        type: Of its messages.
        qos: As it was declared.
        callback: Gets each message.
    """

    def __init__(self, type: Any, qos: Qos, callback: Callable[[Any, int], object]) -> None:  # as elsewhere
        self.type, self.qos, self._callback = type, qos, callback

    def receive(self, sent: int, **fields: Any) -> None:
        """A message arrives, as it was sent at so many nanoseconds of Unix time."""
        self._callback(self.type.parse(self.type.serialize(self.type(**fields))), sent)


class FakeService:
    def __init__(
        self,
        node: FakeNode,
        name: str,
        type_name: str,
        callback: Callable[[Any], Any],
        qos: Qos,
        urgent: bool = False,
    ) -> None:
        self.name, self.type, self.callback, self.qos = name, node.types.service(type_name), callback, qos
        self.urgent, self.open = urgent, True

    def close(self) -> None:
        self.open = False


class Call:
    """A request to a service, and its response once it is there."""

    def __init__(self, node: FakeNode, service: FakeService, fields: dict[str, Any]) -> None:
        self.response: Any = None
        request = service.type.request(**fields)

        def take(response: Any) -> None:
            assert self.response is None, "answered twice"
            self.response = service.type.response.parse(service.type.response.serialize(response))
            node.said.append((service.name, self.response))

        answer = service.callback(service.type.request.parse(service.type.request.serialize(request)))
        if isinstance(answer, Deferred):
            answer.bind(take)
        else:
            take(answer)


class FakeNode:
    """As much of `Node` as what sits on it needs.

    Attributes:
        said: Everything that was published and answered, in order.
    """

    def __init__(
        self,
        types: Types | None = None,
        name: str = "arm",
        namespace: str = "/",
        options: NodeOptions | None = None,
    ) -> None:
        self.types = types or Types()
        self.options = options or NodeOptions(name, namespace)
        self.namespace, self.name = remap_node(self.options.namespace, self.options.name, self.options.remaps)
        self.graph, self.told_types = Graph(), list[Any]()
        # What arrives is handled at once.
        self.callbacks = SimpleNamespace(inbox=lambda depth, handle: SimpleNamespace(put=handle))
        self.opened = False
        self.publishers: dict[str, FakePublisher] = {}
        self.subscriptions: dict[str, FakeSubscription] = {}
        self.services: dict[str, FakeService] = {}
        self.said: list[tuple[str, Any]] = []

    @property
    def full_name(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.name}"

    def resolve(self, name: str, kind: Kind = Kind.TOPIC) -> str:
        return resolve(name, self.namespace, self.name, kind, self.options.remaps)

    def open(self) -> None:
        self.opened = True
        self.graph.add(self.token("1"))

    def close(self) -> None:
        self.opened = False

    def token(self, session: str) -> str:
        """Of a node of its name in a session."""
        return Endpoint(0, session, "0", "0", Role.NODE, "/", self.namespace, self.name).token

    def tell_type(self, kind: Any) -> None:
        self.told_types.append(kind)

    def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> FakePublisher:
        made = FakePublisher(self, self.resolve(topic), type_name, qos)
        self.publishers[made.topic] = made
        return made

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, int], object], qos: Qos = DEFAULT
    ) -> FakeSubscription:
        made = FakeSubscription(self.types.message(type_name), qos, callback)
        self.subscriptions[self.resolve(topic)] = made
        return made

    def service(
        self,
        name: str,
        type_name: str,
        callback: Callable[[Any], Any],
        qos: Qos = SERVICES,
        *,
        urgent: bool = False,
    ) -> FakeService:
        made = FakeService(self, self.resolve(name, Kind.SERVICE), type_name, callback, qos, urgent)
        self.services[made.name] = made
        return made

    def call(self, service: str, /, **fields: Any) -> Call:
        """Ask a service, with the fields of the request."""
        return Call(self, self.services[service], fields)

    def ask(self, service: str, /, **fields: Any) -> Any:
        """Ask a service that answers at once."""
        response = self.call(service, **fields).response
        assert response is not None, "it answers later"
        return response
