"""Quality of service of ROS 2: how many messages are kept, for whom, and which ends fit together.

Owns the policies, ROS's profiles, the form in a liveliness token, and the rules of compatibility. Pure. Must not
know names nor sessions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from .errors import RemoteProtocolError

__all__ = [
    "ACTION_STATUS",
    "DEFAULT",
    "INFINITE",
    "LATCHED",
    "PARAMETERS",
    "PARAMETER_EVENTS",
    "ROSOUT",
    "SENSOR_DATA",
    "SERVICES",
    "Durability",
    "Duration",
    "History",
    "Liveliness",
    "Qos",
    "Reliability",
    "incompatible_policies",
    "parse_qos",
]


class Reliability(IntEnum):
    """Whether what was lost is sent again. The numbers are those of `rmw`."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3


class Durability(IntEnum):
    """Whether who subscribes late gets the last messages."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3


class History(IntEnum):
    """Which messages wait."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class Liveliness(IntEnum):
    """Who says that a publisher is alive."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_NODE = 2
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


Duration = tuple[int, int]
"""Seconds and nanoseconds."""
INFINITE: Duration = (9223372036, 854775807)
"""No limit; `rmw`'s number for it."""
_DEFAULT_DEPTH = 42
_LARGEST = 2**64 - 1


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of one endpoint.

    Attributes:
        depth: Messages that wait, with `History.KEEP_LAST`.
        deadline: Longest time between two messages.
        lifespan: Age at which a message expires.
        lease: Silence after which a publisher counts as gone.
    """

    reliability: Reliability = Reliability.RELIABLE
    durability: Durability = Durability.VOLATILE
    history: History = History.KEEP_LAST
    depth: int = 10
    deadline: Duration = INFINITE
    lifespan: Duration = INFINITE
    liveliness: Liveliness = Liveliness.AUTOMATIC
    lease: Duration = INFINITE

    @property
    def latched(self) -> bool:
        """Whether who subscribes late gets the last messages."""
        return self.durability is Durability.TRANSIENT_LOCAL

    @property
    def key(self) -> str:
        """The form in a liveliness token: empty fields are those of `rmw_zenoh`'s default.

        Peers read a token, write it anew, and hash that text for the id of the endpoint: any other form breaks it.
        """
        default = _TOKEN_DEFAULT

        def text(value: int, usual: int) -> str:
            return "" if value == usual else str(int(value))

        def pair(value: Duration, usual: Duration) -> str:
            return f"{text(value[0], usual[0])},{text(value[1], usual[1])}"

        return ":".join(
            (
                text(self.reliability, default.reliability),
                text(self.durability, default.durability),
                f"{text(self.history, default.history)},{text(self.depth, default.depth)}",
                pair(self.deadline, default.deadline),
                pair(self.lifespan, default.lifespan),
                f"{text(self.liveliness, default.liveliness)},{pair(self.lease, default.lease)}",
            )
        )


_TOKEN_DEFAULT = Qos(depth=_DEFAULT_DEPTH)

DEFAULT = Qos()
SENSOR_DATA = Qos(reliability=Reliability.BEST_EFFORT, depth=5)
SERVICES = Qos()
PARAMETERS = Qos(depth=1000)
"""Of the services that read and set parameters."""
PARAMETER_EVENTS = Qos(depth=1000)
ROSOUT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1000, lifespan=(10, 0))
ACTION_STATUS = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
"""As for `robot_description`."""


def parse_qos(text: str) -> Qos:
    """Read the form in a liveliness token.

    Raises:
        RemoteProtocolError: It is in another form.
    """
    try:
        reliability, durability, history, deadline, lifespan, liveliness = text.split(":")[:6]
        kind, depth = history.split(",")[:2]
        manner, *lease = liveliness.split(",")[:3]
        default = _TOKEN_DEFAULT
        qos = Qos(
            Reliability(_number(reliability, default.reliability)),
            Durability(_number(durability, default.durability)),
            History(_number(kind, default.history)),
            _number(depth, default.depth),
            _duration(deadline.split(",")[:2], default.deadline),
            _duration(lifespan.split(",")[:2], default.lifespan),
            Liveliness(_number(manner, default.liveliness)),
            _duration(lease, default.lease),
        )
    except ValueError:
        raise RemoteProtocolError(f"a quality of service in another form: {text[:80]!r}") from None
    # "Best effort" and the like stand for the default where nobody decided.
    return replace(
        qos,
        reliability=qos.reliability or default.reliability,
        durability=qos.durability or default.durability,
        history=qos.history or default.history,
        liveliness=qos.liveliness or default.liveliness,
    )


def _number(text: str, usual: int) -> int:
    if not text:
        return usual
    if not (text.isascii() and text.isdigit()) or len(text) > 20 or int(text) > _LARGEST:
        raise ValueError
    return int(text)


def _duration(parts: list[str], usual: Duration) -> Duration:
    seconds, nanoseconds = parts
    return _number(seconds, usual[0]), _number(nanoseconds, usual[1])


def incompatible_policies(offered: Qos, requested: Qos) -> tuple[str, ...]:
    """Which policies of a publisher and a subscription do not fit together, by ROS's names; empty if all fit.

    Args:
        offered: The publisher's.
        requested: The subscription's.
    """
    found = []
    if requested.durability is Durability.TRANSIENT_LOCAL and offered.durability is Durability.VOLATILE:
        found.append("DURABILITY")
    if offered.deadline > requested.deadline:
        found.append("DEADLINE")
    by_topic = Liveliness.MANUAL_BY_TOPIC
    if offered.lease > requested.lease or (requested.liveliness is by_topic and offered.liveliness is not by_topic):
        found.append("LIVELINESS")
    if requested.reliability is Reliability.RELIABLE and offered.reliability is Reliability.BEST_EFFORT:
        found.append("RELIABILITY")
    return tuple(found)
