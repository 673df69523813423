"""What the session tests share: connections, a line between two of them in fake time, and the chapter's log."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hexwire.session.connection import Connection, Role
from hexwire.session.events import Event, Request

VECTORS: list[dict[str, Any]] = [
    json.loads(line) for line in (Path(__file__).parents[2] / "vectors/session.jsonl").read_text().splitlines()
]
LOG = [row for row in VECTORS if row["source"].startswith("the chapter's log,") and row["kind"] == "frame"]
"""The chapter's log in order: request, answer, request, answer."""


def host(**changes: Any) -> Connection:
    return Connection(Role.HOST, **{"local": 7, "remote": 8, "type": 3} | changes)


def board(**changes: Any) -> Connection:
    return Connection(Role.BOARD, **{"local": 8, "remote": 7, "type": 8} | changes)


def events(connection: Connection) -> list[Event]:
    return list(iter(connection.next_event, None))  # type: ignore[arg-type]


def echo_body(connection: Connection, request: Request, now: float) -> None:
    """Answer any dialect-2 request with its own body."""
    connection.reply(request, 0, request.frame.body, now)


class Line:
    """A host and a board in fake time; frames take `delay` seconds each way.

    Args:
        host_end: The host.
        board_end: The board.
        answer: What the board does with a request.
        delay: Seconds a frame is under way.
        mangle: Turns each frame sent into what arrives, for loss, doubles and cuts.
    """

    def __init__(
        self,
        host_end: Connection,
        board_end: Connection,
        answer: Callable[[Connection, Request, float], None] = echo_body,
        *,
        delay: float = 0.001,
        mangle: Callable[[bytes], list[bytes]] = lambda data: [data],
    ) -> None:
        self.host = host_end
        self.board = board_end
        self.now = 0.0
        self.seen: list[Event] = []
        self.board_seen: list[Event] = []
        self.up = True
        self._answer = answer
        self._delay = delay
        self._mangle = mangle
        self._flying: list[tuple[float, int, Connection, bytes]] = []
        self._count = 0

    def run(self, until: float, stop: Callable[[], bool] = lambda: False) -> None:
        """Let time pass, from one thing that happens to the next."""
        idle = 0
        while not stop():
            self._collect(self.host, self.board)
            self._collect(self.board, self.host)
            times = [t for t, *_ in self._flying]
            times += [t for end in (self.host, self.board) if (t := end.next_timeout()) is not None]
            due = min(times, default=until)
            # What is due must get done: a machine that does not move on would be asked for ever.
            idle = idle + 1 if due <= self.now else 0
            assert idle < 1000, "time stands still"
            if due > until:
                break
            self.now = max(self.now, due)
            self._step()
            if not times:
                break
        self.now = max(self.now, until) if not stop() else self.now

    def _collect(self, source: Connection, target: Connection) -> None:
        for frame in source.data_to_send():
            for piece in self._mangle(frame) if self.up else []:
                self._count += 1
                self._flying.append((self.now + self._delay, self._count, target, piece))

    def _step(self) -> None:
        arrived = sorted(f for f in self._flying if f[0] <= self.now)
        self._flying = [f for f in self._flying if f[0] > self.now]
        for _, _, target, data in arrived:
            target.receive(data, self.now)
        for end in (self.host, self.board):
            due = end.next_timeout()
            if due is not None and due <= self.now:
                end.handle_timeout(self.now)
        for event in events(self.board):
            self.board_seen.append(event)
            if isinstance(event, Request):
                self._answer(self.board, event, self.now)
        self.seen += events(self.host)


def bad_line(rng: random.Random, *, loss: float = 0.0, double: float = 0.0) -> Callable[[bytes], list[bytes]]:
    """A line that loses and doubles frames."""

    def mangle(data: bytes) -> list[bytes]:
        if rng.random() < loss:
            return []
        return [data, data] if rng.random() < double else [data]

    return mangle
