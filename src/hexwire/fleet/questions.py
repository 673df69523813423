"""Questions to the server of an arm, and the reason if there is no answer.

Owns the distinction between "no such arm", "no right" and "no answer", which Zenoh does not make, and the stop that
replaces a denied torque off.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hexwire.drivers.values import StopMode
from hexwire.errors import (
    HexwireError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    ReplyTimeoutError,
)

from . import messages as m
from .address import Address, rights_of
from .failures import restore
from .names import ClientRole, Keys
from .node import NoAnswerError, Node
from .rights import KEY_WORDS

__all__ = ["KEEPS_TORQUE", "Questions", "ask", "unknown_certificate"]

_TIMEOUT = 2.0
"""Time-out of the questions that find out why there was no answer, seconds."""
KEEPS_TORQUE = "an observer may stop it, but not switch its torque off"
_BACK = 0.5
"""Seconds until a server answers questions again after its token has returned."""
_SILENT = "is its program stopped, or the network slow?"
_REMEDY = "write the router's access file again with 'hexwire fleet config', and start it again"


def ask(node: Node, address: Address, key: str, message: Any, timeout: float, *, urgent: bool = False) -> m.Answer:
    """Ask the server of an arm.

    Raises:
        LinkNotFoundError: There is no such arm.
        LinkPermissionError: The certificate does not allow this.
        ReplyTimeoutError: The server does not answer.
        HexwireError: What the server refused, and why.
    """
    try:
        return _answer(node.ask(key, m.encode(message), timeout, urgent=urgent))
    except NoAnswerError as none:
        raise _reason(node, address, key, none) from None


def _answer(payload: bytes) -> m.Answer:
    answer = m.decode(payload, m.Answer)
    if answer.kind:
        raise restore(answer.kind, answer.text, answer.details)
    return answer


class Questions:
    """Asks the server of an arm, and counts and times the questions.

    Args:
        address: The arm.

    Attributes:
        counters: Numbers of requests, replies and time-outs.
        round_trips: Seconds from question to answer, newest last.
    """

    def __init__(self, address: Address) -> None:
        self._address, self._keys = address, Keys(address.name)
        self.counters = dict.fromkeys(("requests", "replies", "timeouts"), 0)
        self.round_trips: deque[float] = deque(maxlen=1000)

    def ask(self, node: Node, key: str, message: Any, timeout: float, *, urgent: bool = False) -> m.Answer:
        """As the function `ask`."""
        with self._timed():
            return ask(node, self._address, key, message, timeout, urgent=urgent)

    def stop(self, node: Node, role: ClientRole, request: m.StopRequest, timeout: float) -> tuple[m.Answer, str]:
        """Stop the arm. If this program may not switch torque off, the arm is stopped anyway and holds.

        Args:
            node: The session.
            role: Role of this program.
            request: The stop.
            timeout: Seconds for an answer.

        Returns:
            The answer to the stop, and why torque stays on although torque off was asked for; otherwise empty.

        Raises:
            HexwireError: As `ask`: the stop is not confirmed.
        """
        if request.mode != StopMode.TORQUE_OFF:
            return self.ask(node, self._keys.stop, request, timeout, urgent=True), ""
        if role is ClientRole.OBSERVER:
            whose = f"with {_holder(node.cert)}" if node.cert else "as the address says"
            kept = f"{KEEPS_TORQUE} ({whose})"
            return self.ask(node, self._keys.stop, request, timeout, urgent=True), kept
        key = self._keys.off(role)
        try:
            with self._timed():
                return _answer(node.ask(key, m.encode(request), timeout, urgent=True)), ""
        except NoAnswerError as none:
            if not none.absent:
                raise _reason(node, self._address, key, none) from None
            # Stop the arm first; then find out why torque off was denied.
            answer = self.ask(node, self._keys.stop, request, timeout, urgent=True)
            return answer, str(_reason(node, self._address, key, none)).removeprefix(f"{self._address.text}: ")

    @contextmanager
    def _timed(self) -> Iterator[None]:
        self.counters["requests"] += 1
        sent = time.monotonic()
        try:
            yield
        except ReplyTimeoutError:
            self.counters["timeouts"] += 1
            raise
        received = time.monotonic()
        self.counters["replies"] += 1
        self.round_trips.append(received - sent)


def _reason(node: Node, address: Address, key: str, none: NoAnswerError) -> HexwireError:
    """Why there was no answer. Zenoh drops forbidden messages silently, so other questions must show the reason."""
    # The other end of the connection.
    url, other = address.text, "server or router" if address.router else "server"
    lost = LinkLostError(f"{url}: the connection to the {other} is lost", url=url)
    if not node.connections:
        return lost
    error = _found_out(node, address, key, none, other)
    # If the connection was lost meanwhile, the other questions did not arrive either.
    return error if node.connections else lost


def _found_out(node: Node, address: Address, key: str, none: NoAnswerError, other: str) -> HexwireError:
    """Why there was no answer, by other questions."""
    name, url = address.name, address.text
    # Check the certificate first: the access control of the router was made from it.
    if node.cert and (missing := _missing(node.cert, name, key)):
        return LinkPermissionError(f"{url}: {missing}", url=url)
    alive = Keys(name).alive
    if not node.visible(alive, _TIMEOUT):
        try:
            node.ask_neighbours(_TIMEOUT)
        except NoAnswerError as silent:
            if silent.absent and node.cert:
                return LinkPermissionError(f"{url}: {unknown_certificate(node.cert)}", url=url)
            return ReplyTimeoutError(f"a question to the {other} of {url}", advice=_SILENT)
        # The server may have started meanwhile.
        if not node.visible(alive, _TIMEOUT):
            return LinkNotFoundError(
                f"there is no arm {name}; 'hexwire fleet list' shows the arms that exist", url=url
            )
    if none.absent and node.is_offered(key, _BACK):
        # A lost connection also ends the wait like this, so it is unknown whether the request was carried out.
        return LinkLostError(f"{url}: the connection to its server was interrupted and is back", url=url)
    if none.absent:
        return LinkPermissionError(f"{url} is there, but this program may not {_word(key)}; {_REMEDY}", url=url)
    return ReplyTimeoutError(f"{url}, whose server is there", advice=_SILENT)


def unknown_certificate(cert: str) -> str:
    """Error text for a certificate that the router's access control does not know."""
    return f"the router does not know {_holder(cert)}; {_REMEDY}"


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
        return f"{holder} does not allow a program to {what}; 'hexwire cert issue' creates one with a role"
    if not rights.covers(name):
        return f"{holder} is not for this arm"
    if rights.role is None:
        return f"{holder} is for a server, which may not {what}; use the certificate of a client"
    if key not in Keys(name).asked(rights.role):
        return f"{holder} does not allow a program to {what} as {key.split('/')[-2]}"
    return ""
