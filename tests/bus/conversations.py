"""Conversations with a `BusMachine` played without a link, for the test files of this folder."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from hexwire.bus.machine import BusMachine, Conversation, Heard, Send
from hexwire.bus.servos import KnownServos
from hexwire.wire.registers import Series

_T = TypeVar("_T")
Answering = Callable[[bytes], list[tuple[float, bytes]]]
"""What comes of a packet: pieces of bytes, each so many seconds after it was sent."""


def make_machine(series: Series = Series.STS_SMS, *, baud: int = 1_000_000, retries: int = 0) -> BusMachine:
    machine = BusMachine(KnownServos(series), baud, retries)
    machine.now = 100.0
    return machine


class Play:
    """A line on which nothing is real: bytes come when a test says so.

    Attributes:
        sent: Packets, in order.
        steps: What the conversations asked for.
    """

    def __init__(self, machine: BusMachine, answering: Answering) -> None:
        self.machine = machine
        self.answering = answering
        self.sent: list[bytes] = []
        self.steps: list[object] = []
        self._coming: list[tuple[float, bytes]] = []

    def __call__(self, conversation: Conversation[_T]) -> _T:
        """Play a conversation to its end and return its result."""
        now = self.machine.now
        try:
            step = next(conversation)
            while True:
                self.steps.append(step)
                if isinstance(step, Send):
                    self.sent.append(step.packet)
                    self._coming += [(now + after, data) for after, data in self.answering(step.packet)]
                    self._coming.sort(key=lambda piece: piece[0])
                    until = now + step.window
                else:
                    until = step.until
                data = b""
                if self._coming and self._coming[0][0] <= until:
                    when, data = self._coming.pop(0)
                    now = max(now, when)
                else:
                    now = max(now, until)
                step = conversation.send(Heard(data, now))
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
