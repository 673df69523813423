"""What is said about hands between a program and the emulator: an order in one line, its result in another.

Owns the format, and one conversation as a machine without I/O. Whatever arrives, the outcome is one of three: the
hand moves and the line of its result follows, or a line with an error does and nothing moves, or the conversation
ends without a word because the other side left. Must not know sockets.

    {"joint": "3", "degrees": 40.0, "seconds": 0.7, "hold": 0.0, "force": 0.6}
    {"joint": "elbow_flex", "moved": 39.98, "torque": false, "blocked": false}
    {"error": "no joint 'x'; so101 has shoulder_pan, ..."}
"""

from __future__ import annotations

import hmac
import json
from dataclasses import asdict, fields

from hexwire.errors import HexwireError, UsageError
from hexwire.inputs import parse_json

from .hand import Grip, HandOrder, HandResult, Hands

__all__ = ["HandConversation", "parse_result", "serialize_order"]

_LONGEST = 1000
"""Most bytes of a line."""
_PATIENCE = 2.0
"""Seconds within which an order must be complete."""
_MOST_DEGREES = 3600.0
_MOST_SECONDS = 600.0
_MOST_FORCE = 10.0


class HandConversation:
    """One conversation, seen from the emulator: an order, then its result.

    Args:
        hands: The joints.
        now: When it began.
        key: What the other side says first; empty if its socket has proved who it is.

    Attributes:
        answer: The line for the other side; empty as long as there is none. After it the conversation is over.
    """

    def __init__(self, hands: Hands, now: float, key: bytes = b"") -> None:
        self.answer = b""
        self._hands, self._until, self._key = hands, now + _PATIENCE, key
        self._heard = b""
        self._grip: Grip | None = None

    @property
    def is_moving(self) -> bool:
        """Whether its hand is at a joint."""
        return self._grip is not None and not self.answer

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes; what follows the order is ignored."""
        if self._grip is not None or self.answer:
            return
        self._heard += data
        line, end, _ = self._heard.partition(b"\n")
        if len(line) > _LONGEST:
            self._answer({"error": f"an order has at most {_LONGEST} bytes"})
        elif end and not hmac.compare_digest(line[: len(self._key)], self._key):
            self._answer({"error": "this emulated arm belongs to another program or user"})
        elif end:
            line = line[len(self._key) :]
            try:
                self._grip = self._hands.take(_parse_order(line), now)
            except HexwireError as error:
                self._answer({"error": str(error)})

    def step(self, now: float) -> None:
        """Let time pass."""
        if self._grip is None:
            if now >= self._until and not self.answer:
                self._answer({"error": "no order came"})
        elif not self.answer and (result := self._grip.step(now)) is not None:
            self._answer(asdict(result))

    def end(self) -> None:
        """The other side has left: the hand lets go."""
        if self._grip is not None:
            self._grip.let_go()

    def _answer(self, row: dict[str, object]) -> None:
        self.answer = json.dumps(row).encode() + b"\n"


def serialize_order(order: HandOrder) -> bytes:
    """The line of an order.

    Raises:
        UsageError: A number of it is out of range, or the joint's name too long.
    """
    line = json.dumps(asdict(order)).encode()
    _parse_order(line)
    return line + b"\n"


def _parse_order(line: bytes) -> HandOrder:
    names = tuple(field.name for field in fields(HandOrder))
    row = parse_json(line).table(names, names)
    return HandOrder(
        joint=row["joint"].text(100),
        degrees=row["degrees"].number(-_MOST_DEGREES, _MOST_DEGREES),
        seconds=row["seconds"].number(0.0, _MOST_SECONDS),
        hold=row["hold"].number(0.0, _MOST_SECONDS),
        force=row["force"].number(0.0, _MOST_FORCE),
    )


def parse_result(line: bytes) -> HandResult:
    """The result of an order from the line of the emulator.

    Raises:
        UsageError: The emulator refused the order; the text is its own. Or it is no such line.
    """
    row = parse_json(line[:_LONGEST]).table()
    if "error" in row:
        raise UsageError(row["error"].text(_LONGEST))
    names = tuple(field.name for field in fields(HandResult))
    row = parse_json(line).table(names, names)
    torque, blocked = (row[name].value is True for name in ("torque", "blocked"))
    return HandResult(row["joint"].text(100), row["moved"].number(), torque, blocked)
