"""Questions to the server of an arm, and why there is no answer.

Owns the difference between "no such arm", "no right" and "no answer", which Zenoh does not tell. Must not know
what is asked.
"""

from __future__ import annotations

from contextlib import suppress
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
from .address import Address
from .failures import restore
from .names import Keys
from .network import NoAnswerError, Node

__all__ = ["ask", "decoded"]

_TIMEOUT = 2.0
"""Seconds for the questions that find the reason."""


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
    keys, url = Keys(address.name), address.text
    if not node.connections:
        return LinkLostError(f"{url}: the connection to the server or router is lost; it is tried again", url=url)
    if not node.visible(keys.alive, _TIMEOUT):
        return LinkNotFoundError(
            f"there is no arm {address.name}, or this program may not see it; 'hexwire fleet list' shows those "
            "that it may see",
            url=url,
        )
    if key != keys.ask:
        with suppress(NoAnswerError, HexwireError):
            m.decode(node.ask(keys.ask, m.encode(m.Ask("clock")), _TIMEOUT), m.Answer)
            what = key.removeprefix(f"{keys.base}/")
            return LinkPermissionError(
                f"{url} answers questions, but not this ({what}): this program's certificate does not allow it",
                url=url,
            )
    if none.absent:
        return LinkPermissionError(
            f"{url} is there, but the certificate of this program does not allow this", url=url
        )
    return ReplyTimeoutError(f"{url}, whose server is there", advice="is its program stopped, or the network slow?")
