"""Who may do what in a lab: the roles that stand in certificates, and Zenoh's access control from them.

Owns how a role and its arms are written into a certificate, what each role may do, and the rules that a router or
server enforces. Pure. Must not know files, sessions or cryptography.

A certificate names its role and arms as URIs, such as ``hexwire:operator:lab/*``. Zenoh knows a program by the
common name of its certificate, so these are unique, and each rule lists those that it is for. All that no rule
allows is denied. Zenoh allows a message if its key is included in the key of a rule: one with wildcards reaches no
arm that the rule does not name.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from hexwire.errors import UsageError

from .names import HERE, ROOT, ClientRole, Keys, check_pattern, matches

__all__ = ["KEY_WORDS", "Kind", "Rights", "access_control"]

_SCHEME = "hexwire"
_ALL_MESSAGES = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
]
_FLOWS = ("ingress", "egress")
_DOMAIN = re.compile(r"0|[1-9][0-9]{0,9}", re.ASCII)
_MOST_ARMS = 64
"""Arms or patterns in one certificate."""


class Kind(StrEnum):
    """What the holder of a certificate is."""

    OBSERVER = "observer"
    """May read, and stop with torque on."""
    OPERATOR = "operator"
    """May also move, and stop with torque off."""
    MAINTAINER = "maintainer"
    """May also write servo settings and firmware."""
    ARM = "arm"
    """Serves arms."""
    ROUTER = "router"
    """Passes on what others send."""
    ROS = "ros"
    """Takes part in a ROS domain, where every node may command every arm. Its `arms` are the numbers of domains."""


_ROLES = {
    Kind.OBSERVER: ClientRole.OBSERVER,
    Kind.OPERATOR: ClientRole.OPERATOR,
    Kind.MAINTAINER: ClientRole.MAINTAINER,
}

KEY_WORDS = {"ask": "read", "state": "read", "stop": "stop", "off": "switch its torque off"}
"""What the last part of a key is for, in words; all others command."""


@dataclass(frozen=True, slots=True)
class Rights:
    """What stands in a certificate.

    Attributes:
        kind: What its holder is.
        arms: Names or patterns of the arms that it is for; none for a router, which passes on for all; numbers of
            domains for `Kind.ROS`.
    """

    kind: Kind
    arms: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind is Kind.ROS and not (self.arms and all(_DOMAIN.fullmatch(each) for each in self.arms)):
            raise UsageError("the role ros is for ROS domains: give their numbers, as in --for 0")
        for pattern in self.arms:
            check_pattern(pattern)
        if self.kind is Kind.ROUTER and self.arms:
            raise UsageError("a router passes on for all arms; leave out --for")
        if self.kind is not Kind.ROUTER and not 0 < len(self.arms) <= _MOST_ARMS:
            raise UsageError(
                f"the role {self.kind} needs 1 to {_MOST_ARMS} names or patterns of arms, as in --for 'lab/*'"
            )

    def __str__(self) -> str:
        return f"{self.kind} for {', '.join(self.arms)}" if self.arms else str(self.kind)

    @property
    def role(self) -> ClientRole | None:
        """The role of a client; None for what is no client."""
        return _ROLES.get(self.kind)

    def covers(self, name: str) -> bool:
        """Whether they are for the arm of that name."""
        if self.kind is Kind.ROS:
            return False
        return self.kind is Kind.ROUTER or any(matches(pattern, name) for pattern in self.arms)

    def uris(self) -> tuple[str, ...]:
        """As written in a certificate."""
        return tuple(f"{_SCHEME}:{self.kind}:{pattern}" for pattern in self.arms or ("",))

    @classmethod
    def from_uris(cls, uris: Iterable[str]) -> Rights | None:
        """Read the URIs of a certificate.

        Returns:
            None if none of them is ours.

        Raises:
            UsageError: They contradict each other, or are of a form that this version does not know.
        """
        ours = [uri.split(":", 2) for uri in uris if uri.startswith(f"{_SCHEME}:")]
        if not ours:
            return None
        kinds = {parts[1] for parts in ours}
        if any(len(parts) != 3 for parts in ours) or len(kinds) > 1 or not kinds <= set(Kind):
            raise UsageError("a role that this version does not know, or more than one")
        return cls(Kind(kinds.pop()), tuple(parts[2] for parts in ours if parts[2]))


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _ros_keys(domain: str) -> list[str]:
    """What the nodes of a ROS domain say to each other: messages, what keeps the last ones, and who is there."""
    # Wildcards do not match a part that begins with '@'.
    return [f"{domain}/**", f"{domain}/**/@adv/**", f"@ros2_lv/{domain}/**"]


def _rules(name: str, rights: Rights) -> list[dict[str, Any]]:
    """What one group of certificates may do, as seen by the router or server: ingress comes from them."""
    rows: list[tuple[str, list[str], list[str]]] = []
    arms = [Keys(pattern) for pattern in rights.arms]
    alive = [keys.alive for keys in arms]
    role = rights.role
    if rights.kind is Kind.ROUTER:
        rows = [(flow, _ALL_MESSAGES, ["**"]) for flow in _FLOWS]
    elif rights.kind is Kind.ROS:
        rows = [(flow, _ALL_MESSAGES, [key for each in rights.arms for key in _ros_keys(each)]) for flow in _FLOWS]
    elif role is None:
        states, answered = [keys.state for keys in arms], [key for keys in arms for key in keys.answered()]
        streamed = [key for keys in arms for key in keys.streamed(max(ClientRole))]
        rows = [
            ("ingress", ["put"], states),
            ("ingress", ["declare_subscriber"], streamed),
            ("ingress", ["declare_queryable", "reply"], answered),
            ("ingress", ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"], alive),
            ("ingress", ["query"], [HERE]),
            # An arm receives only what it has declared, so these may name any: a question to several arms names
            # them by a pattern, which no rule for a single one includes.
            ("egress", ["query", "declare_subscriber"], [f"{ROOT}/**"]),
            ("egress", ["put"], streamed),
            ("egress", ["liveliness_token"], alive),
            ("egress", ["reply"], [HERE]),
        ]
    else:
        asked = [key for keys in arms for key in keys.asked(role)]
        rows = [
            ("ingress", ["declare_subscriber"], [keys.state for keys in arms]),
            ("ingress", ["query"], [*asked, HERE]),
            ("ingress", ["liveliness_query", "declare_liveliness_subscriber"], alive),
            ("egress", ["put"], [keys.state for keys in arms]),
            ("egress", ["reply", "declare_queryable"], [*asked, HERE]),
            ("egress", ["liveliness_token"], alive),
        ]
        if streamed := [key for keys in arms for key in keys.streamed(role)]:
            rows += [("ingress", ["put"], streamed), ("egress", ["declare_subscriber"], streamed)]
    return [_rule(f"{name} {number}", *row) for number, row in enumerate(rows)]


def access_control(certificates: Sequence[tuple[str, Rights]]) -> dict[str, Any]:
    """Zenoh's access control for the certificates of a lab.

    Args:
        certificates: Common name and rights of each.

    Returns:
        The value of ``access_control`` in Zenoh's settings.

    Raises:
        UsageError: Two certificates have one common name.
    """
    groups: dict[tuple[Kind, tuple[str, ...]], list[str]] = {}
    seen: set[str] = set()
    for common_name, rights in certificates:
        if not common_name.strip() or common_name in seen:
            raise UsageError(f"the common name {common_name!r} is empty or not unique; issue the certificate anew")
        seen.add(common_name)
        groups.setdefault((rights.kind, tuple(sorted(rights.arms))), []).append(common_name)
    # Programs of the user who runs the server: they reach its socket because the system lets them.
    local = "programs of this user"
    rules = [_rule(f"{local} {flow}", flow, _ALL_MESSAGES, ["**"]) for flow in ("ingress", "egress")]
    subjects: list[dict[str, Any]] = [{"id": local, "link_protocols": ["unixsock-stream"]}]
    policies = [{"id": local, "rules": [rule["id"] for rule in rules], "subjects": [local]}]
    for number, ((kind, arms), names) in zip(itertools.count(1), sorted(groups.items()), strict=False):
        group = f"{number} {Rights(kind, arms)}"
        own = _rules(group, Rights(kind, arms))
        rules += own
        subjects.append({"id": group, "cert_common_names": sorted(names), "link_protocols": ["tls"]})
        policies.append({"id": group, "rules": [rule["id"] for rule in own], "subjects": [group]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
