"""A device for the tests of what serves one."""

from __future__ import annotations


class Loopback:
    """A device that says what it hears, and how often it was reset."""

    def __init__(self) -> None:
        self.heard = b""
        self.out = b""
        self.resets = 0

    def receive(self, data: bytes, now: float) -> None:
        self.heard += data
        self.out += data

    def step(self, now: float) -> None:
        pass

    def data_to_send(self) -> bytes:
        out, self.out = self.out, b""
        return out

    def next_event_time(self) -> float | None:
        return None

    def reset(self, now: float) -> None:
        self.resets += 1
