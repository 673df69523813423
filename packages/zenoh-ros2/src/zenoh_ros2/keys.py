"""Keys of `rmw_zenoh`: where a topic or service is on Zenoh, and the tokens that show nodes and endpoints.

Owns their forms, the reading of tokens that others declare, and the ids that follow from them. Pure. Must not know
sessions, nor what is done with an endpoint.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from .attachment import GID
from .errors import RemoteProtocolError, UsageError
from .qos import Qos, parse_qos

__all__ = [
    "MOST_DOMAIN",
    "SPACE",
    "Endpoint",
    "Role",
    "data_key",
    "domain_of",
    "gid_of",
    "graph_pattern",
    "parse_token",
]

MOST_DOMAIN = 2**32 - 1
"""The greatest ROS_DOMAIN_ID."""
SPACE = "@ros2_lv"
_LONGEST = 2048
"""Characters of a token; longer ones are not read."""
_ZID = re.compile(r"[0-9a-f]{1,32}", re.ASCII)
_NUMBER = re.compile(r"[0-9]{1,19}", re.ASCII)


class Role(StrEnum):
    """What a token shows."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


def _mangle(name: str) -> str:
    return name.replace("/", "%")


def _demangle(text: str) -> str:
    return text.replace("%", "/")


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """Where the messages of a topic, or the requests of a service, are.

    Args:
        domain: Of ROS.
        name: Full name.
        type_name: As in ``std_msgs::msg::dds_::String_``.
        type_hash: As in ``RIHS01_...``.
    """
    return f"{domain}/{name.strip('/')}/{type_name}/{type_hash}"


def graph_pattern(domain: int) -> str:
    """All tokens of a domain."""
    return f"{SPACE}/{domain}/**"


def domain_of(environment: Mapping[str, str]) -> int:
    """The domain that ROS_DOMAIN_ID names; 0 if it is not set.

    Raises:
        UsageError: It is not a whole number in range.
    """
    text = environment.get("ROS_DOMAIN_ID", "")
    if not text:
        return 0
    if not (text.isascii() and text.isdigit()) or len(text) > 10 or int(text) > MOST_DOMAIN:
        raise UsageError(f"ROS_DOMAIN_ID is not an integral number from 0 to {MOST_DOMAIN}: {text[:80]!r}")
    return int(text)


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A node, or a publisher, subscription, service or client of one.

    Attributes:
        domain: Of ROS.
        zid: Id of its Zenoh session.
        nid: Number of its node in the session.
        eid: Its own number; that of the node for a node.
        role: What it is.
        enclave: Its security enclave, ``/`` for none.
        namespace: Of its node.
        node: Name of its node.
        name: Full name of the topic or service; empty for a node.
        type_name: Of messages or service, as in ``std_msgs::msg::dds_::String_``.
        type_hash: As in ``RIHS01_...``.
        qos: Its quality of service; None for a node.
    """

    domain: int
    zid: str
    nid: str
    eid: str
    role: Role
    enclave: str
    namespace: str
    node: str
    name: str = ""
    type_name: str = ""
    type_hash: str = ""
    qos: Qos | None = None

    @property
    def token(self) -> str:
        """The key of its token."""
        parts = [SPACE, str(self.domain), self.zid, self.nid, self.eid, self.role.value]
        parts += [_mangle(self.enclave), _mangle(self.namespace), self.node]
        if self.qos is not None:
            parts += [_mangle(self.name), _mangle(self.type_name), self.type_hash, self.qos.key]
        return "/".join(parts)

    @property
    def key(self) -> str:
        """Where its messages or requests are."""
        return data_key(self.domain, self.name, self.type_name, self.type_hash)

    @property
    def session_node(self) -> tuple[str, str]:
        """What identifies its node: two nodes may have one name."""
        return self.zid, self.nid


def gid_of(token: str) -> bytes:
    """Id of the endpoint with a token: 16 bytes."""
    from xxhash import xxh3_128_intdigest

    return xxh3_128_intdigest(token.encode()).to_bytes(GID, "little")


def parse_token(token: str) -> Endpoint:
    """Read a token. Whoever reaches the router may declare any text as one.

    Raises:
        RemoteProtocolError: It is not one of this form.
    """
    parts = token.split("/") if len(token) <= _LONGEST else []
    if len(parts) < 9 or parts[0] != SPACE or not all(parts):
        raise _malformed(token)
    try:
        role = Role(parts[5])
    except ValueError:
        raise _malformed(token) from None
    numbers = (parts[1], parts[3], parts[4])
    if not _ZID.fullmatch(parts[2]) or not all(_NUMBER.fullmatch(each) for each in numbers):
        raise _malformed(token)
    node = Endpoint(
        int(parts[1]), parts[2], parts[3], parts[4], role, _demangle(parts[6]), _demangle(parts[7]), parts[8]
    )
    if role is Role.NODE:
        return node
    # Later versions may append parts.
    if len(parts) < 13:
        raise _malformed(token)
    return Endpoint(
        node.domain,
        node.zid,
        node.nid,
        node.eid,
        role,
        node.enclave,
        node.namespace,
        node.node,
        _demangle(parts[9]),
        _demangle(parts[10]),
        parts[11],
        parse_qos(parts[12]),
    )


def _malformed(token: str) -> RemoteProtocolError:
    return RemoteProtocolError(f"a liveliness token in another form: {token[:200]!r}")
