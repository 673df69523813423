"""A node that is made up: it has names, publishers and services, and sends nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hexwire.ros2.names import Kind, parse_remap, resolve
from hexwire.ros2.node import Deferred, NodeOptions
from hexwire.ros2.qos import DEFAULT, SERVICES, Qos
from hexwire.ros2.types import Types


class FakePublisher:
    def __init__(self, node: FakeNode, topic: str, type_name: str, qos: Qos) -> None:
        self.topic, self.type, self.qos = topic, node.types.message(type_name), qos
        self.sent: list[Any] = []
        self.open = True
        self._node = node

    def publish(self, message: Any) -> None:
        assert self.open
        # As others read it.
        self.sent.append(self.type.parse(self.type.serialize(message)))
        self._node.said.append((self.topic, self.sent[-1]))

    def close(self) -> None:
        self.open = False


class FakeService:
    def __init__(self, node: FakeNode, name: str, type_name: str, callback: Callable[[Any], Any], qos: Qos) -> None:
        self.name, self.type, self.callback, self.qos = name, node.types.service(type_name), callback, qos
        self.open = True

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
        self, types: Types | None = None, name: str = "arm", namespace: str = "/", rules: tuple[str, ...] = ()
    ) -> None:
        self.types = types or Types()
        self._rules = tuple(map(parse_remap, rules))
        self.options = NodeOptions(name, namespace)
        self.name, self.namespace = name, namespace
        self.publishers: dict[str, FakePublisher] = {}
        self.services: dict[str, FakeService] = {}
        self.said: list[tuple[str, Any]] = []

    @property
    def full_name(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.name}"

    def resolve(self, name: str, kind: Kind = Kind.TOPIC) -> str:
        return resolve(name, self.namespace, self.name, kind, self._rules)

    def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> FakePublisher:
        made = FakePublisher(self, self.resolve(topic), type_name, qos)
        self.publishers[made.topic] = made
        return made

    def service(
        self, name: str, type_name: str, callback: Callable[[Any], Any], qos: Qos = SERVICES
    ) -> FakeService:
        made = FakeService(self, self.resolve(name, Kind.SERVICE), type_name, callback, qos)
        self.services[made.name] = made
        return made

    def call(self, name: str, **fields: Any) -> Call:
        """Ask a service, with the fields of the request."""
        return Call(self, self.services[name], fields)

    def ask(self, name: str, **fields: Any) -> Any:
        """Ask a service that answers at once."""
        response = self.call(name, **fields).response
        assert response is not None, "it answers later"
        return response
