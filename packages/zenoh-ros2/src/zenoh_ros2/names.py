"""Names of ROS 2: what is valid, how a name becomes a full one, and what remapping makes of it.

Owns validation with `rcl`'s words, expansion, and remap rules. Pure. Must not know keys, sessions, nor where rules
come from.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Flag, auto

from .errors import UsageError

__all__ = [
    "Kind",
    "Remap",
    "check_namespace",
    "check_node_name",
    "check_topic",
    "expand",
    "full_name",
    "logger_name",
    "parse_remap",
    "remap_node",
    "resolve",
]

_LONGEST_TOPIC = 247
_LONGEST_NAMESPACE = 245
_LONGEST_NODE = 255
_SUBSTITUTION = re.compile(r"\{([^{}]*)\}")
_PLAIN = re.compile(r"[A-Za-z0-9_/~{}]", re.ASCII)
_WORD = re.compile(r"[A-Za-z0-9_]", re.ASCII)
_RULE = re.compile(r"(?:([A-Za-z0-9_]+):(?!=|//))?(rostopic://|rosservice://)?(.+?):=(.+)", re.ASCII | re.DOTALL)
_RULE_NAME = re.compile(r"(?:~/|/)?[A-Za-z0-9_]+(?:/[A-Za-z0-9_]+)*", re.ASCII)


class Kind(Flag):
    """What a name is for, and what a rule applies to."""

    TOPIC = auto()
    SERVICE = auto()
    NODE = auto()
    NAMESPACE = auto()


@dataclass(frozen=True, slots=True)
class Remap:
    """A rule that replaces a name.

    Attributes:
        kind: What it applies to.
        old: The name that it replaces, as written; empty for node name and namespace.
        new: What replaces it, as written.
        node: Name of the node that it is for; empty for all.
    """

    kind: Kind
    old: str
    new: str
    node: str = ""


_SCHEMES = {"": Kind.TOPIC | Kind.SERVICE, "rostopic://": Kind.TOPIC, "rosservice://": Kind.SERVICE}


def _refuse(text: str, reason: str) -> UsageError:
    return UsageError(f"{reason}: {text[:300]!r}")


def _check_unexpanded(name: str) -> None:
    """As `rcl_validate_topic_name`."""
    if not name:
        raise _refuse(name, "topic name must not be empty string")
    if name[0].isdigit():
        raise _refuse(name, "topic name token must not start with a number")
    if name[-1] == "/":
        raise _refuse(name, "topic name must not end with a forward slash")
    opened = -1
    for index, letter in enumerate(name):
        inside = opened >= 0
        if not _PLAIN.match(letter) or (inside and letter in "/{"):
            raise _refuse(
                name,
                "substitution name must not contain characters other than alphanumerics or '_'"
                if inside
                else "topic name must not contain characters other than alphanumerics, '_', '~', '{', or '}'",
            )
        if inside and letter.isdigit() and opened == index - 1:
            raise _refuse(name, "substitution name must not start with a number")
        if letter == "~" and index:
            raise _refuse(name, "topic name must not have tilde '~' unless it is the first character")
        if letter == "}":
            if not inside:
                raise _refuse(name, "topic name must not have unmatched (unbalanced) curly braces '{}'")
            opened = -1
        elif letter == "{":
            opened = index
    if opened >= 0:
        raise _refuse(name, "topic name must not have unmatched (unbalanced) curly braces '{}'")
    if re.search(r"/[0-9]", name):
        raise _refuse(name, "topic name token must not start with a number")
    if len(name) > 1 and name[0] == "~" and name[1] != "/":
        raise _refuse(name, "topic name must not have a tilde '~' that is not followed by a forward slash '/'")


def check_topic(name: str, *, what: str = "topic name", longest: int = _LONGEST_TOPIC) -> str:
    """Check a full name, as `rmw_validate_full_topic_name`.

    Args:
        name: The name.
        what: What it is the name of, for the error.
        longest: Most characters.

    Returns:
        The name.

    Raises:
        UsageError: It is not valid.
    """
    if not name:
        raise _refuse(name, f"{what} must not be empty")
    if name[0] != "/":
        raise _refuse(name, f"{what} must be absolute, it must lead with a '/'")
    if name[-1] == "/":
        raise _refuse(name, f"{what} must not end with a '/'")
    if not re.fullmatch(r"[A-Za-z0-9_/]+", name, re.ASCII):
        raise _refuse(name, f"{what} must not contain characters other than alphanumerics, '_', or '/'")
    if "//" in name:
        raise _refuse(name, f"{what} must not contain repeated '/'")
    if re.search(r"/[0-9]", name):
        raise _refuse(name, f"{what} must not have a token that starts with a number")
    if len(name) > longest:
        raise _refuse(name, f"{what} length should not exceed '{longest}'")
    return name


def check_namespace(name: str) -> str:
    """Check a namespace; otherwise as `check_topic`."""
    return name if name == "/" else check_topic(name, what="namespace", longest=_LONGEST_NAMESPACE)


def check_node_name(name: str) -> str:
    """Check the name of a node; otherwise as `check_topic`."""
    if not name:
        raise _refuse(name, "node name must not be empty")
    if not all(_WORD.match(letter) for letter in name):
        raise _refuse(name, "node name must not contain characters other than alphanumerics or '_'")
    if name[0].isdigit():
        raise _refuse(name, "node name must not start with a number")
    if len(name) > _LONGEST_NODE:
        raise _refuse(name, f"node name length should not exceed '{_LONGEST_NODE}'")
    return name


def full_name(namespace: str, node: str) -> str:
    """Name of a node with its namespace."""
    return f"{namespace.rstrip('/')}/{node}"


def logger_name(full: str) -> str:
    """Name of a node's logger, such as ``left.driver``.

    Args:
        full: Name of the node with its namespace.
    """
    return full.strip("/").replace("/", ".")


def expand(name: str, namespace: str, node: str) -> str:
    """The full name, before any remapping.

    Args:
        name: Relative, absolute, or private (``~/...``), with substitutions ``{node}``, ``{ns}``, ``{namespace}``.
        namespace: Of the node.
        node: Its name.

    Raises:
        UsageError: It is not valid, or has another substitution.
    """
    _check_unexpanded(name)
    values = {"node": node, "ns": namespace, "namespace": namespace}

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise _refuse(name, f"unknown substitution: {match[0]}")
        return values[match[1]]

    full = full_name(namespace, node) + name[1:] if name[0] == "~" else name
    full = _SUBSTITUTION.sub(value, full)
    return full if full.startswith("/") else f"{namespace.rstrip('/')}/{full}"


def resolve(name: str, namespace: str, node: str, kind: Kind, rules: Iterable[Remap] = ()) -> str:
    """The full name after remapping, as `rcl_node_resolve_name`.

    Args:
        name: As for `expand`.
        namespace: Of the node.
        node: Its name.
        kind: What the name is for.
        rules: The first that applies counts.

    Raises:
        UsageError: The name, or what a rule makes of it, is not valid.
    """
    full = expand(name, namespace, node)
    for rule in rules:
        if not rule.kind & kind or (rule.node and rule.node != node):
            continue
        try:
            old = expand(rule.old, namespace, node)
        except UsageError:
            continue
        if old == full:
            full = expand(rule.new, namespace, node)
            break
    return check_topic(full)


def remap_node(namespace: str, node: str, rules: Iterable[Remap]) -> tuple[str, str]:
    """Namespace and name of a node after remapping.

    Args:
        namespace: Before, with or without its first slash.
        node: Name before.
        rules: The first that applies counts. A rule for the namespace goes by the new name of the node.

    Raises:
        UsageError: One of them is not valid.
    """
    rules = tuple(rules)

    def first(kind: Kind, name: str, usual: str) -> str:
        return next((rule.new for rule in rules if rule.kind & kind and rule.node in ("", name)), usual)

    check_node_name(node)
    name = check_node_name(first(Kind.NODE, node, node))
    space = first(Kind.NAMESPACE, name, namespace) or "/"
    return check_namespace(space if space.startswith("/") else f"/{space}"), name


def parse_remap(text: str) -> Remap:
    """Read a rule, such as ``joint_states:=/arm/joint_states`` or ``driver:__ns:=/left``.

    Raises:
        UsageError: It is not a rule.
    """
    match = _RULE.fullmatch(text)
    if match is None:
        raise _refuse(text, "a remap rule has the form FROM:=TO or NODE:FROM:=TO")
    node, scheme, old, new = (part or "" for part in match.groups())
    if not scheme and old in ("__node", "__name"):
        return Remap(Kind.NODE, "", check_node_name(new), node)
    if not scheme and old == "__ns":
        return Remap(Kind.NAMESPACE, "", check_namespace(new), node)
    for wildcard in ("**", "*"):
        if wildcard in old:
            raise _refuse(text, f"Wildcard '{wildcard}' is not implemented")
    if "\\" in new:
        raise _refuse(text, "Backreferences are not implemented")
    for name in (old, new):
        if not _RULE_NAME.fullmatch(name):
            raise _refuse(text, f"{name[:100]!r} is not a name that a rule may have")
    return Remap(_SCHEMES[scheme], old, new, node)
