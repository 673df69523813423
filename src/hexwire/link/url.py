"""The address of a link, as typed by the user: ``scheme://host:port/path?key=value``.

Owns the syntax and the wording of its errors.
"""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from urllib.parse import unquote

from hexwire.errors import UsageError

__all__ = ["LinkUrl", "is_loopback", "parse_url", "split_host_port"]

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]*")
_YES = frozenset({"1", "yes", "true", "on"})
_NO = frozenset({"0", "no", "false", "off"})


@dataclass(frozen=True)
class LinkUrl:
    """A link's address in parts.

    Attributes:
        text: The address as given.
        scheme: ``serial``, ``tcp`` and so on, in lower case.
        netloc: The part between ``//`` and the next ``/`` or ``?``.
        path: From the first ``/`` on, percent signs decoded; may be empty.
        query: The keys and values after ``?``.
    """

    text: str
    scheme: str
    netloc: str
    path: str
    query: Mapping[str, str] = field(default_factory=dict)

    def check_keys(self, known: Collection[str]) -> None:
        """Raise UsageError if the query has a key that is not in `known`."""
        for key in self.query:
            if key not in known:
                offer = ", ".join(known) if known else "none"
                raise UsageError(f"{self.text}: unknown option {key!r}; options of {self.scheme}://: {offer}")

    def without(self, key: str) -> str:
        """The address as given, without one key of the query."""
        head, _, query = self.text.partition("?")
        rest = "&".join(item for item in query.split("&") if item.partition("=")[0] != key)
        return f"{head}?{rest}" if rest else head

    def check_no_path(self) -> None:
        """Raise UsageError if there is a path but the scheme does not use one."""
        if self.path not in ("", "/"):
            raise UsageError(f"{self.text}: {self.path!r} is not allowed after the host and port")

    def host_port(self) -> tuple[str, int]:
        """Host and port; both are required."""
        return split_host_port(self.netloc, self.text)

    def integer(self, key: str, default: int, low: int, high: int) -> int:
        """An integer of the query, from `low` to `high`."""
        text = self.query.get(key)
        if text is None:
            return default
        if not re.fullmatch(r"[0-9]{1,12}", text) or not low <= int(text) <= high:
            raise UsageError(f"{self.text}: {key} must be an integer from {low} to {high}, not {text!r}")
        return int(text)

    def seconds(self, key: str, default: float) -> float:
        """A time of the query in seconds, above 0."""
        text = self.query.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise UsageError(f"{self.text}: {key} must be a time in seconds above 0, not {text!r}")
        return value

    def yes_no(self, key: str, default: bool) -> bool:
        """A switch of the query: 1, yes, true, on or 0, no, false, off."""
        text = self.query.get(key)
        if text is None:
            return default
        if text.lower() not in _YES | _NO:
            raise UsageError(f"{self.text}: {key} must be 1 or 0, not {text!r}")
        return text.lower() in _YES

    def choice(self, key: str, default: str, known: Collection[str]) -> str:
        """A word of the query, one of `known`."""
        text = self.query.get(key, default)
        if text not in known:
            raise UsageError(f"{self.text}: {key} must be one of {', '.join(known)}, not {text!r}")
        return text


def parse_url(text: str) -> LinkUrl:
    """Parse the address of a link.

    A text without ``://`` is the path of a serial device, ``/dev/ttyUSB0?baud=115200``, or of a configuration file
    whose name ends in ``.conf``.

    Raises:
        UsageError: The text is not an address; the error names the wrong part.
    """
    if not isinstance(text, str):
        raise UsageError(f"an address is text, as in 'serial:///dev/ttyUSB0'; this is {text!r}")
    if not text or text != text.strip() or any(ord(char) < 0x21 for char in text):
        raise UsageError(f"{text!r} is not a link address: it is empty or contains blanks")
    head, separator, query_text = text.partition("?")
    scheme, has_scheme, rest = head.partition("://")
    if not has_scheme:
        if re.fullmatch(r"(conf|serial|tcp|tcps|udp|mq|tcp-listen|tcps-listen|udp-listen):.*", head):
            raise UsageError(f"{text!r}: write '//' after the first colon, as in tcp://192.168.1.10:15030")
        scheme, rest = "conf" if head.endswith(".conf") else "serial", head
        netloc, path = "", head
    else:
        netloc, slash, path = rest.partition("/")
        path = unquote(slash + path)
    if not _SCHEME.fullmatch(scheme.lower()):
        raise UsageError(f"{text!r}: {scheme!r} is not a scheme such as serial, tcp, udp or mq")
    if "#" in text:
        raise UsageError(f"{text!r}: '#' is not allowed in a link address")
    if separator and not query_text:
        raise UsageError(f"{text!r}: nothing follows the '?'")
    return LinkUrl(text, scheme.lower(), netloc, path, _parse_query(query_text, text))


def _parse_query(query_text: str, text: str) -> dict[str, str]:
    query: dict[str, str] = {}
    for item in query_text.split("&") if query_text else ():
        key, equals, value = item.partition("=")
        if not key or not equals or not value:
            raise UsageError(f"{text!r}: {item!r} is not an option of the form key=value")
        if key in query:
            raise UsageError(f"{text!r}: option {key!r} is given twice")
        query[key] = unquote(value)
    return query


def split_host_port(netloc: str, text: str, *, port_needed: bool = True) -> tuple[str, int]:
    """Split ``host:port``, ``[::1]:port`` or, if the port is optional, ``host``.

    Args:
        netloc: The text to split.
        text: The whole address, for the error.
        port_needed: Whether a missing port is an error; otherwise it is returned as 0.

    Raises:
        UsageError: The host or the port is missing or wrong.
    """
    if "@" in netloc:
        raise UsageError(f"{text}: a link address has no user name or password")
    if netloc.startswith("["):
        host, bracket, rest = netloc[1:].partition("]")
        if not bracket or (rest and not rest.startswith(":")):
            raise UsageError(f"{text}: write an IPv6 address in brackets, as in [::1]:15030")
        port_text = rest[1:]
    else:
        host, _, port_text = netloc.partition(":")
        if ":" in port_text:
            raise UsageError(f"{text}: write an IPv6 address in brackets, as in [::1]:15030")
    if not host:
        raise UsageError(f"{text}: the host is missing")
    if not port_text:
        if port_needed:
            raise UsageError(f"{text}: the port is missing, as in {host}:15030")
        return host, 0
    if not re.fullmatch(r"[0-9]{1,5}", port_text) or int(port_text) > 65535:
        raise UsageError(f"{text}: the port must be a number from 0 to 65535, not {port_text!r}")
    return host, int(port_text)


def is_loopback(host: str) -> bool:
    """Whether a host name or address is this machine's loopback."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
