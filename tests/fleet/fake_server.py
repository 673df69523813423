"""The server of a shared arm without a network, and a driver at it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from hexwire.fleet import messages as m
from hexwire.fleet.address import Address
from hexwire.fleet.names import ClientRole
from hexwire.fleet.remote import RemoteRobot
from hexwire.fleet.rows import joints_of
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget

from .fake_inbox import FakeInbox


class FakeServer:
    """A server that answers as a test wants, and keeps what it was asked."""

    def __init__(self) -> None:
        self.cert = ""
        self.connections = 1
        self.asked: list[tuple[str, Any]] = []
        # One with the time is made when it is asked for: no server tells a time from before the question.
        self.answers: list[m.Answer | bytes | Callable[[], m.Answer]] = []
        self.usual: Callable[[], bytes] = lambda: m.encode(m.Answer("", value=17, clock=time.monotonic()))

    def open(self) -> FakeServer:
        return self

    def close(self) -> None:
        pass

    def visible(self, key: str, timeout: float) -> list[str]:
        return []

    def inbox(self, key: str) -> FakeInbox:
        return FakeInbox()

    def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
        kind = m.Envelope if key.endswith("order") else m.LeaseRequest if key.endswith("lease") else m.Question
        self.asked.append((key, m.decode(payload, kind)))  # type: ignore[arg-type]
        if not self.answers:
            return self.usual()
        answer = self.answers.pop(0)
        if isinstance(answer, bytes):
            return answer
        return m.encode(answer if isinstance(answer, m.Answer) else answer())

    def orders(self) -> list[m.Envelope]:
        return [message for _, message in self.asked if isinstance(message, m.Envelope)]


FACTS = m.Facts("hex7bot", joints_of(HEX7BOT), 100.0, 20.0, 0.25, 3600.0, "", "", "", "", 0.0)
SENT = m.Answer("", value=[["J1"], [0.1], 1.0, [], []])
TARGET = JointTarget.of({"J1": 0.1}, 1.0)


def attached(monkeypatch: pytest.MonkeyPatch, timeout: float | None = None) -> tuple[RemoteRobot, FakeServer]:
    """A robot at a network that the test plays, whose server has this time-out of the lease or the usual one."""
    node = FakeServer()
    monkeypatch.setattr(Address, "network", lambda self: node)
    facts = m.decode(m.encode(FACTS), m.Facts)
    facts.timeout = facts.timeout if timeout is None else timeout
    robot = RemoteRobot(Address("lab/arm1", role=ClientRole.OPERATOR), facts)
    robot.attach()
    return robot, node
