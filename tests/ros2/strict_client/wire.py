"""How rmw_zenoh_cpp puts ROS 2 on Zenoh: tokens, gids, attachments, keys, and a participant that does the same.

Written from ros2/rmw_zenoh (docs/design.md, liveliness_utils.cpp, attachment_helpers.cpp, qos.cpp,
rmw_client_data.cpp, rmw_subscription_data.cpp) and rmw (qos_profiles.h). Straight on eclipse-zenoh;
everything is checked strictly.
"""

from __future__ import annotations

import json
import queue
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import xxhash
import zenoh
from tests.ros2.strict_client.cdr import Cdr
from tests.ros2.strict_client.definitions import Definitions, dds_name
from tests.waits import PATIENCE, until
from zenoh import ext
from zenoh_ros2_tests.router import Router

ADMIN = "@ros2_lv"
# rmw_qos_profile_services_default, _parameters, _default; rcl_action's status; rcl's rosout (lifespan 10 s).
SERVICES = "::,10:,:,:,,"
PARAMETERS = "::,1000:,:,:,,"
DEFAULT = "::,10:,:,:,,"
STATUS = ":1:,1:,:,:,,"
ROSOUT = ":1:,1000:,:10,0:,,"
LATCHED = ":1:,1:,:,:,,"

_NUMBER = r"(|0|[1-9]\d*)"
_QOS = re.compile(
    rf"([012]?):([012]?):([012]?),{_NUMBER}:{_NUMBER},{_NUMBER}:{_NUMBER},{_NUMBER}:([012]?),{_NUMBER},{_NUMBER}"
)
# RELIABLE, VOLATILE, KEEP_LAST, 42, infinite deadline and lifespan, AUTOMATIC, infinite lease: left empty.
_DEFAULTS = (
    "1",
    "2",
    "1",
    "42",
    "9223372036",
    "854775807",
    "9223372036",
    "854775807",
    "1",
    "9223372036",
    "854775807",
)


class WrongTokenError(Exception):
    """A token that rmw_zenoh_cpp would not have written."""


def canonical_qos(text: str) -> str:
    """The text that a peer writes that has parsed this one."""
    match = _QOS.fullmatch(text)
    if match is None:
        raise WrongTokenError(f"QoS {text!r}")
    f = ["" if value == default else value for value, default in zip(match.groups(), _DEFAULTS, strict=True)]
    return f"{f[0]}:{f[1]}:{f[2]},{f[3]}:{f[4]},{f[5]}:{f[6]},{f[7]}:{f[8]},{f[9]},{f[10]}"


@dataclass(frozen=True)
class Token:
    domain: int
    zid: str
    node_id: int
    id: int
    kind: str
    enclave: str
    namespace: str
    node: str
    topic: str = ""
    type: str = ""
    hash: str = ""
    qos: str = ""

    @classmethod
    def parse(cls, text: str) -> Token:
        parts = text.split("/")
        if len(parts) not in (9, 13) or parts[0] != ADMIN:
            raise WrongTokenError(f"{len(parts)} parts: {text}")
        if not all(parts):
            raise WrongTokenError(f"an empty part: {text}")
        kind = parts[5]
        if kind not in ("NN", "MP", "MS", "SS", "SC") or (kind == "NN") != (len(parts) == 9):
            raise WrongTokenError(f"entity {kind} with {len(parts)} parts: {text}")
        plain = [part.replace("%", "/") for part in parts]
        token = cls(
            int(parts[1]), parts[2], int(parts[3]), int(parts[4]), kind, *plain[6:9], *plain[9:12], *parts[12:]
        )
        if token.text != text:
            raise WrongTokenError(f"not canonical: {text}, a peer writes {token.text}")
        return token

    @property
    def text(self) -> str:
        parts = [ADMIN, str(self.domain), self.zid, str(self.node_id), str(self.id), self.kind]
        parts += [self.enclave.replace("/", "%"), self.namespace.replace("/", "%"), self.node]
        if self.kind != "NN":
            parts += [self.topic.replace("/", "%"), self.type, self.hash, canonical_qos(self.qos)]
        return "/".join(parts)

    @property
    def key(self) -> str:
        """Where its data travel."""
        return f"{self.domain}/{self.topic.removeprefix('/')}/{self.type}/{self.hash}"

    @property
    def gid(self) -> bytes:
        """XXH3 of the whole token, 128 bits: the low half first, each little-endian."""
        return xxhash.xxh3_128_intdigest(self.text.encode()).to_bytes(16, "little")

    @property
    def full_node(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.node}"


@dataclass(frozen=True)
class Attachment:
    sequence: int
    stamp: int
    gid: bytes

    def serialize(self) -> bytes:
        return struct.pack("<qq", self.sequence, self.stamp) + b"\x10" + self.gid

    @classmethod
    def of(cls, attached: Any) -> Attachment:
        assert attached is not None, "no attachment: rmw_zenoh drops such a message"
        data = bytes(attached)
        assert len(data) == 33, f"an attachment has 33 bytes, not {len(data)}"
        assert data[16] == 16, "the gid has its length before it"
        sequence, stamp = struct.unpack_from("<qq", data)
        return cls(sequence, stamp, data[17:])


@dataclass(frozen=True)
class Received:
    message: SimpleNamespace
    attachment: Attachment
    raw: bytes
    key: str
    at: float
    """By the clock of this machine, in seconds since 1970."""


def session_config(port: int, **more: Any) -> zenoh.Config:
    """The session of rmw_zenoh_cpp's DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5, with the router on another port."""
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": [f"tcp/127.0.0.1:{port}"],
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "timestamping/enabled": {"router": True, "peer": True, "client": True},
        **more,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


@contextmanager
def router(port: int) -> Iterator[None]:
    """What `ros2 run rmw_zenoh_cpp rmw_zenohd` is: a session of mode router."""
    made = Router(f"tcp/127.0.0.1:{port}")
    try:
        yield
    finally:
        made.stop()


class Participant:
    """A ROS 2 context with one node, as rmw_zenoh_cpp has it: ids, tokens, graph."""

    def __init__(
        self,
        port: int,
        name: str = "strict",
        *,
        namespace: str = "/",
        domain: int = 0,
        distribution: str = "jazzy",
        config: zenoh.Config | None = None,
    ) -> None:
        self.definitions = Definitions(distribution)
        self.cdr = Cdr(self.definitions)
        self.domain = domain
        self.namespace = namespace
        self.name = name
        self.session = zenoh.open(config or session_config(port))
        self.zid = str(self.session.info.zid())
        self._next_id = 0
        self._declared: list[Any] = []
        self.ends: list[tuple[Subscription | Publisher, Any]] = []
        self.graph = Graph(self.session, domain)
        self.node = self._token("NN")
        self._declare(self.node)

    def close(self) -> None:
        self.session.close()

    def __enter__(self) -> Participant:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _token(self, kind: str, topic: str = "", name: str = "", qos: str = "", hash: str | None = None) -> Token:
        own, self._next_id = self._next_id, self._next_id + 1
        if kind == "NN":
            return Token(self.domain, self.zid, own, own, kind, "/", self.namespace, self.name)
        return Token(
            self.domain, self.zid, self.node.id, own, kind, "/", self.namespace, self.name,
            topic, dds_name(name), hash or self.definitions.hash(name), qos,
        )  # fmt: skip

    def _declare(self, token: Token) -> Any:
        declared = self.session.liveliness().declare_token(token.text)
        self._declared.append(declared)
        return declared

    def drop_later_than(self, count: int) -> None:
        """Undeclare subscriptions and publishers except the first ones; the endpoint goes after its token."""
        for end, token in self.ends[count:]:
            token.undeclare()
            end.undeclare()
        del self.ends[count:]

    def subscribe(self, topic: str, name: str, qos: str = DEFAULT) -> Subscription:
        token = self._token("MS", topic, name, qos)
        subscription = Subscription(self, token, name)
        self.ends.append((subscription, self._declare(token)))
        return subscription

    def publisher(self, topic: str, name: str, qos: str = DEFAULT) -> Publisher:
        token = self._token("MP", topic, name, qos)
        publisher = Publisher(self, token, name)
        self.ends.append((publisher, self._declare(token)))
        return publisher

    def client(self, service: str, name: str, qos: str = SERVICES, *, hash: str | None = None) -> ServiceClient:
        token = self._token("SC", service, name, qos, hash)
        client = ServiceClient(self, token, name)
        self._declare(token)
        return client


class Graph:
    """All tokens that are alive, by a liveliness subscriber with history."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._alive: dict[str, None] = {}
        self.gone: list[str] = []
        self._key = f"{ADMIN}/{domain}/**"
        self._subscriber = session.liveliness().declare_subscriber(self._key, self._heard, history=True)

    def _heard(self, sample: zenoh.Sample) -> None:
        text = str(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive[text] = None
            else:
                self._alive.pop(text, None)
                self.gone.append(text)

    @property
    def texts(self) -> list[str]:
        with self._lock:
            return list(self._alive)

    def tokens(self, **wanted: Any) -> list[Token]:
        """Those with these fields; the others are not parsed strictly if they are not wanted."""
        found = [Token.parse(text) for text in self.texts]
        return [token for token in found if all(getattr(token, field) == value for field, value in wanted.items())]

    def one(self, patience: float = PATIENCE, **wanted: Any) -> Token:
        def there() -> Token | None:
            found = self.tokens(**wanted)
            assert len(found) < 2, f"twice: {found}"
            return found[0] if found else None

        return until(there, f"there is a token with {wanted}", lambda: f"there are {len(self.texts)}", patience)

    def asked(self) -> set[str]:
        """What a get of all tokens answers, as rmw_zenoh_cpp does when a context starts."""
        replies = self._session.liveliness().get(self._key, timeout=30.0)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


class Subscription:
    def __init__(self, participant: Participant, token: Token, name: str) -> None:
        self.token = token
        self.name = name
        self._participant = participant
        self._samples: queue.Queue[Received | BaseException] = queue.Queue()
        if token.qos.split(":")[1] == "1":
            self._subscriber: Any = ext.declare_advanced_subscriber(
                participant.session,
                token.key,
                self._heard,
                history=ext.HistoryConfig(
                    detect_late_publishers=True, max_samples=int(re.findall(r",(\d+):", token.qos)[0])
                ),
                recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                subscriber_detection=True,
            )
        else:
            self._subscriber = participant.session.declare_subscriber(token.key, self._heard)

    def _heard(self, sample: zenoh.Sample) -> None:
        at = time.time()
        try:
            raw = bytes(sample.payload)
            attachment = Attachment.of(sample.attachment)
            message = self._participant.cdr.parse(self.name, raw)
            self._samples.put(Received(message, attachment, raw, str(sample.key_expr), at))
        except Exception as error:  # noqa: BLE001 (whoever takes it sees it)
            self._samples.put(error)

    def take(self, timeout: float = PATIENCE) -> Received:
        try:
            got = self._samples.get(timeout=timeout)
        except queue.Empty:
            raise AssertionError(f"nothing came on {self.token.topic} in {timeout:g} s") from None
        if isinstance(got, BaseException):
            raise got
        return got

    def wait(self, condition: Callable[[SimpleNamespace], object], timeout: float = PATIENCE) -> Received:
        """The first message for which something holds; those before it are dropped."""
        deadline = time.monotonic() + timeout
        last = None
        while (left := deadline - time.monotonic()) > 0:
            got = self.take(left) if last is None else self._take_or(last, left)
            if condition(got.message):
                return got
            last = got
        raise AssertionError(f"no such message on {self.token.topic}; the last was {last and last.message}")

    def _take_or(self, last: Received, left: float) -> Received:
        try:
            return self.take(left)
        except AssertionError:
            raise AssertionError(f"no such message on {self.token.topic}; the last was {last.message}") from None

    def take_all(self) -> list[Received]:
        """Everything that has come so far."""
        found = []
        while not self._samples.empty():
            found.append(self.take(0))
        return found

    def listen(self, seconds: float) -> list[Received]:
        time.sleep(seconds)
        return self.take_all()

    def undeclare(self) -> None:
        self._subscriber.undeclare()


class Publisher:
    def __init__(self, participant: Participant, token: Token, name: str) -> None:
        self.token = token
        self.name = name
        self._participant = participant
        self._publisher = participant.session.declare_publisher(token.key)
        self.sequence = 0

    def publish(self, **fields: Any) -> None:
        self.put(self._participant.cdr.serialize(self.name, fields))

    def put(self, payload: bytes, *, attachment: bytes | None = None, attach: bool = True) -> None:
        """Bytes that need not be a message."""
        self.sequence += 1
        if attachment is None:
            attachment = Attachment(self.sequence, time.time_ns(), self.token.gid).serialize()
        self._publisher.put(payload, attachment=attachment if attach else None)

    def undeclare(self) -> None:
        self._publisher.undeclare()

    def wait_for_subscriber(self) -> None:
        until(lambda: self._publisher.matching_status.matching, f"someone subscribes to {self.token.key}")


class Reply:
    """The answers to one request, collected until Zenoh says that there are no more."""

    def __init__(self, client: ServiceClient, sequence: int) -> None:
        self._client = client
        self.sequence = sequence
        self._replies: list[zenoh.Reply] = []
        self._done = threading.Event()
        self.at = 0.0

    def heard(self, reply: zenoh.Reply) -> None:
        self._replies.append(reply)
        self.at = time.time()

    def dropped(self) -> None:
        self._done.set()

    @property
    def done(self) -> bool:
        return self._done.is_set()

    def raw(self, timeout: float = PATIENCE) -> list[zenoh.Reply]:
        assert self._done.wait(timeout), f"{self._client.token.topic} did not answer in {timeout:g} s"
        return self._replies

    def received(self, timeout: float = PATIENCE) -> Received:
        """The only answer, checked as strictly as rcl does, and more."""
        replies = self.raw(timeout)
        token = self._client.token
        assert len(replies) == 1, f"{len(replies)} answers from {token.topic}"
        sample = replies[0].ok
        assert sample is not None, f"{token.topic} answered an error: {bytes(replies[0].err.payload)!r}"
        assert str(sample.key_expr) == token.key
        attachment = Attachment.of(sample.attachment)
        assert attachment.sequence == self.sequence, "the sequence number of the request comes back"
        assert attachment.gid == token.gid, "the gid of the client comes back"
        raw = bytes(sample.payload)
        message = self._client.participant.cdr.parse(f"{self._client.name}_Response", raw)
        return Received(message, attachment, raw, str(sample.key_expr), self.at)

    def message(self, timeout: float = PATIENCE) -> SimpleNamespace:
        return self.received(timeout).message


class ServiceClient:
    def __init__(self, participant: Participant, token: Token, name: str) -> None:
        self.participant = participant
        self.token = token
        self.name = name
        long = "/_action/get_result/" in f"/{token.key}/"
        self._querier = participant.session.declare_querier(
            token.key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=3600.0 if long else 10.0,
        )
        self.sequence = 0

    def wait(self, patience: float = PATIENCE) -> None:
        """As `wait_for_service`: the server is in the graph, and Zenoh knows a way to it."""
        graph = self.participant.graph
        until(
            lambda: graph.tokens(kind="SS", topic=self.token.topic) or None,
            f"{self.token.topic} is there",
            patience=patience,
        )
        matched = lambda: self._querier.matching_status.matching  # noqa: E731
        until(matched, f"there is a way to {self.token.key}", patience=patience)

    def send(self, **fields: Any) -> Reply:
        return self.put(self.participant.cdr.serialize(f"{self.name}_Request", fields))

    def put(self, payload: bytes | None, *, attachment: bytes | None = None, attach: bool = True) -> Reply:
        """Bytes that need not be a request."""
        self.sequence += 1
        reply = Reply(self, self.sequence)
        if attachment is None:
            attachment = Attachment(self.sequence, time.time_ns(), self.token.gid).serialize()
        handler = (zenoh.handlers.Callback(reply.heard, reply.dropped), reply)
        self._querier.get(handler, payload=payload, attachment=attachment if attach else None)
        return reply

    def call(self, **fields: Any) -> SimpleNamespace:
        self.wait()
        return self.send(**fields).message()

    @property
    def there(self) -> bool:
        return bool(self._querier.matching_status.matching)
