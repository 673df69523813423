"""Questions to the server of an arm, and why there is no answer.

Owns the difference between "no such arm", "no right" and "no answer", which Zenoh does not tell. Must not know
what is asked.
"""

from __future__ import annotations

from typing import Any

import msgspec

from hexwire.errors import (
    HexwireError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    RemoteProtocolError,
    ReplyTimeoutError,
)

from . import messages as m
from .address import Address, rights_of
from .failures import restore
from .names import Keys
from .node import NoAnswerError, Node
from .rights import KEY_WORDS

__all__ = ["ask", "decoded"]

_TIMEOUT = 2.0
"""Seconds for the questions that find the reason."""
_SILENT = "is its program stopped, or the network slow?"
_REMEDY = "write the router's access file again with 'hexwire fleet config', and start it again"


def decoded(answer: m.Answer, kind: Any) -> Any:
    """The value of an answer as a message; raises `RemoteProtocolError` if it is not one of that kind."""
    try:
        return msgspec.convert(answer.value, kind)
    except (msgspec.MsgspecError, ValueError) as error:
        raise RemoteProtocolError(f"not a valid answer: {str(error)[:200]}") from None


def ask(node: Node, address: Address, key: str, message: Any, timeout: float, *, urgent: bool = False) -> m.Answer:
    """Ask the server of an arm.

    Raises:
        LinkNotFoundError: There is no such arm.
        LinkPermissionError: The certificate does not allow this.
        ReplyTimeoutError: The server does not answer.
        HexwireError: What the server refused, and why.
    """
    try:
        answer = m.decode(node.ask(key, m.encode(message), timeout, urgent=urgent), m.Answer)
    except NoAnswerError as none:
        raise _reason(node, address, key, none) from None
    if answer.kind:
        raise restore(answer.kind, answer.text, answer.details)
    return answer


def _reason(node: Node, address: Address, key: str, none: NoAnswerError) -> HexwireError:
    """Why nobody answered. Zenoh drops what is not allowed without a word, so other questions have to tell."""
    name, url = address.name, address.text
    if not node.connections:
        return LinkLostError(f"{url}: the connection to the server or router is lost; it is tried again", url=url)
    # The certificate comes first: the access control of the router was made from it.
    if node.cert and (missing := _missing(node.cert, name, key)):
        return LinkPermissionError(f"{url}: {missing}", url=url)
    alive = Keys(name).alive
    if not node.visible(alive, _TIMEOUT):
        try:
            node.ask_neighbours(_TIMEOUT)
        except NoAnswerError as silent:
            if silent.absent and node.cert:
                return LinkPermissionError(
                    f"{url}: the router does not know {_holder(node.cert)}; {_REMEDY}", url=url
                )
            return ReplyTimeoutError(f"a question to the router of {url}", advice=_SILENT)
        # It may have come meanwhile.
        if not node.visible(alive, _TIMEOUT):
            return LinkNotFoundError(
                f"there is no arm {name}; 'hexwire fleet list' shows those that there are", url=url
            )
    if none.absent:
        return LinkPermissionError(f"{url} is there, but this program may not {_word(key)}; {_REMEDY}", url=url)
    return ReplyTimeoutError(f"{url}, whose server is there", advice=_SILENT)


def _word(key: str) -> str:
    """What a key is for, in words."""
    return KEY_WORDS.get(key.rpartition("/")[2], "command it")


def _holder(cert: str) -> str:
    """A certificate in words."""
    rights = rights_of(cert)
    return f"the certificate {cert} ({rights if rights is not None else 'without a role'})"


def _missing(cert: str, name: str, key: str) -> str:
    """Which right a certificate does not give; empty if it gives it."""
    rights, holder, what = rights_of(cert), _holder(cert), _word(key)
    if rights is None:
        return f"{holder} does not allow to {what}; 'hexwire cert issue' creates one with a role"
    if not rights.covers(name):
        return f"{holder} is not for this arm"
    if rights.role is None:
        return f"{holder} serves, and may not {what}; use that of a client"
    if key not in Keys(name).asked(rights.role):
        return f"{holder} does not allow to command it as {key.split('/')[-2]}"
    return ""
