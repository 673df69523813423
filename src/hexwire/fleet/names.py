"""Names of shared arms, and the keys under which they are offered.

Owns the grammar of names, roles and keys. Must not know Zenoh or messages.

    hexwire/<name>/state                   every state of the arm and of its lease, published
    hexwire/<name>/ask                     questions that move nothing
    hexwire/<name>/stop                    stops the arm, which keeps its torque; needs no lease
    hexwire/<name>/as/<role>/lease         take, renew and give back the lease
    hexwire/<name>/as/<role>/order         orders of its holder, asked; set-points of a stream, published
    hexwire/<name>/as/<role>/off           stops the arm with torque off; needs no lease
    hexwire/<name>/alive/<instance>        liveliness token of the server
    hexwire/@here/<session>                answered by the router or server that a program is connected to
"""

from __future__ import annotations

import re
from enum import IntEnum

from hexwire.errors import UsageError

__all__ = [
    "HERE",
    "ROOT",
    "SCHEME",
    "ClientRole",
    "Keys",
    "check_name",
    "check_pattern",
    "is_name",
    "matches",
    "name_of",
]

ROOT = "hexwire"
SCHEME = "zenoh"
# Wildcards do not match a part that begins with '@', and no name has one.
HERE = f"{ROOT}/@here/*"
"""Keys at which a router or server answers every certificate that it knows."""
_SEGMENT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,31}")
_WILD = re.compile(r"\*{1,2}|[A-Za-z0-9][A-Za-z0-9_.-]{0,31}")
_MOST_SEGMENTS = 4
_RULE = "a name has 1 to 4 parts of letters, digits, '-', '_' and '.', as in lab/arm1"


class ClientRole(IntEnum):
    """What a client may do. The value is its rank: a client may pre-empt its own rank and below."""

    OBSERVER = 0
    """Read, and stop."""
    OPERATOR = 1
    """And move the arm, or stop it with torque off."""
    MAINTAINER = 2
    """And write servo settings and firmware."""

    @property
    def word(self) -> str:
        """The role as it stands in keys and certificates."""
        return self.name.lower()


def is_name(name: str) -> bool:
    """Whether it is the name of an arm."""
    parts = name.split("/")
    return all(_SEGMENT.fullmatch(part) for part in parts) and len(parts) <= _MOST_SEGMENTS


def check_name(name: str) -> str:
    """Check the name of an arm.

    Raises:
        UsageError: It is not a name.
    """
    if not is_name(name):
        raise UsageError(f"{name!r} is not the name of an arm: {_RULE}")
    return name


def check_pattern(pattern: str) -> str:
    """Check a pattern for names: as a name, and ``*`` stands for a part and ``**`` for any number of them.

    Raises:
        UsageError: It is not a pattern.
    """
    parts = pattern.split("/")
    if not all(_WILD.fullmatch(part) for part in parts) or len(parts) > _MOST_SEGMENTS:
        raise UsageError(f"{pattern!r} matches no arm: {_RULE}; * stands for any part")
    return pattern


def matches(pattern: str, name: str) -> bool:
    """Whether a name is one of those that a pattern stands for; both are checked."""

    def fits(wanted: list[str], parts: list[str]) -> bool:
        if not wanted or not parts:
            return all(part == "**" for part in wanted) and not parts
        if wanted[0] == "**":
            return fits(wanted[1:], parts) or fits(wanted, parts[1:])
        return wanted[0] in ("*", parts[0]) and fits(wanted[1:], parts[1:])

    return fits(pattern.split("/"), name.split("/"))


class Keys:
    """The keys of one arm, or of the arms that match a pattern.

    Args:
        name: A name or pattern, checked.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        base = f"{ROOT}/{name}"
        self.base, self.state, self.ask, self.stop = base, f"{base}/state", f"{base}/ask", f"{base}/stop"
        self.alive = f"{base}/alive/*"

    def lease(self, role: ClientRole) -> str:
        """Key of the lease for clients of that role."""
        return f"{self.base}/as/{role.word}/lease"

    def order(self, role: ClientRole) -> str:
        """Key of the orders of clients of that role."""
        return f"{self.base}/as/{role.word}/order"

    def off(self, role: ClientRole) -> str:
        """Key of the stop with torque off of clients of that role."""
        return f"{self.base}/as/{role.word}/off"

    def asked(self, role: ClientRole) -> list[str]:
        """Keys at which clients of that role ask and order."""
        keys = (self.lease, self.order, self.off)
        return [self.ask, self.stop, *(key(each) for each in _commanding(role) for key in keys)]

    def streamed(self, role: ClientRole) -> list[str]:
        """Keys under which clients of that role publish set-points."""
        return [self.order(each) for each in _commanding(role)]

    def answered(self) -> list[str]:
        """Keys at which a server answers."""
        return self.asked(max(ClientRole))

    def token(self, instance: str) -> str:
        """Key of a server's liveliness token."""
        return f"{self.base}/alive/{instance}"


def _commanding(role: ClientRole) -> list[ClientRole]:
    """Roles as which a client of that role may command."""
    return [each for each in ClientRole if ClientRole.OBSERVER < each <= role]


def name_of(key: str) -> tuple[str, str]:
    """Name and instance in the key of a liveliness token.

    Raises:
        UsageError: It is not such a key.
    """
    parts = key.split("/")
    if len(parts) < 4 or parts[0] != ROOT or parts[-2] != "alive":
        raise UsageError(f"{key!r} is not the key of an arm")
    return check_name("/".join(parts[1:-2])), parts[-1]
