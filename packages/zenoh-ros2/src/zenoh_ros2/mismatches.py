"""What does not fit between an endpoint of this node and one of another, in ROS's words.

Owns when a publisher and a subscription, or a service and a client, do not reach each other, and the text about it.
Pure. Must not know how it is logged.
"""

from __future__ import annotations

from .keys import Endpoint, Role
from .names import full_name
from .qos import incompatible_policies

__all__ = ["describe_mismatch"]

_OTHER_SIDE = {
    Role.PUBLISHER: Role.SUBSCRIPTION,
    Role.SUBSCRIPTION: Role.PUBLISHER,
    Role.SERVICE: Role.CLIENT,
    Role.CLIENT: Role.SERVICE,
}
_WORDS = {
    Role.PUBLISHER: "publisher",
    Role.SUBSCRIPTION: "subscription",
    Role.SERVICE: "service",
    Role.CLIENT: "client",
}


def describe_mismatch(own: Endpoint, other: Endpoint) -> str:
    """What does not fit, in one line; empty if all fits, or if they have nothing to do with each other.

    Args:
        own: Of this node.
        other: Of any node.
    """
    if own.name != other.name or _OTHER_SIDE.get(own.role) is not other.role:
        return ""
    node, word = full_name(other.namespace, other.node), _WORDS[other.role]
    if own.type_name != other.type_name:
        return (
            f"The {word} of {node} on '{own.name}' has another type, {other.type_name}; nothing passes between them"
        )
    if own.type_hash != other.type_hash:
        return (
            f"The {word} of {node} on '{own.name}' has another definition of {own.type_name} ({other.type_hash}, "
            f"here {own.type_hash}); nothing passes between them. Is the parameter 'distribution' right?"
        )
    if own.qos is None or other.qos is None or own.role not in (Role.PUBLISHER, Role.SUBSCRIPTION):
        return ""
    offered, requested = (own.qos, other.qos) if own.role is Role.PUBLISHER else (other.qos, own.qos)
    policies = incompatible_policies(offered, requested)
    if not policies:
        return ""
    # ROS says this over DDS. Zenoh delivers all the same, but whoever changes the middleware loses the messages.
    how = "requesting" if own.role is Role.PUBLISHER else "offering"
    lost = "sent to it" if own.role is Role.PUBLISHER else "received from it"
    return (
        f"New {word} discovered on topic '{own.name}', {how} incompatible QoS. No messages will be {lost}. Last "
        f"incompatible policy: {policies[-1]}_QOS_POLICY. This is so over DDS; Zenoh delivers them"
    )
