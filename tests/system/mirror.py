"""The far side of a session under test: a board that answers each request with its own body."""

from __future__ import annotations

import contextlib
import time

from hexwire.errors import LinkLostError
from hexwire.ipc.connections import random_number
from hexwire.link.base import Link, LinkKind
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Request
from hexwire.wire.command_frame import Command


class Mirror:
    """A board in a thread that answers each request with its own body."""

    def __init__(self, link: Link, max_frame: int, module: int = 8) -> None:
        self.link = link
        self.got: list[bytes] = []
        numbers = random_number if link.kind is LinkKind.DATAGRAM else None
        self.end = Connection(Role.BOARD, local=module, remote=7, type=8, max_frame=max_frame, numbers=numbers)
        self._ended = False

    def run(self) -> None:
        with contextlib.suppress(LinkLostError):  # the other side closed first
            self._run()

    def _run(self) -> None:
        while not self._ended:
            now = time.monotonic()
            due = self.end.next_timeout()
            data = self.link.read(min(now + 0.1, now + 0.1 if due is None else due))
            now = time.monotonic()
            self.end.receive(data, now, end_of_message=self.link.kind is LinkKind.DATAGRAM and bool(data))
            if due is not None and now >= due:
                self.end.handle_timeout(now)
            while (event := self.end.next_event()) is not None:
                if isinstance(event, Request):
                    if event.frame.cmd != Command.IDENTIFY:
                        self.got.append(event.frame.body)
                    self.end.reply(event, 0, event.frame.body, now)
            for frame in self.end.data_to_send():
                self.link.write(frame, now + 10)

    def stop(self) -> None:
        self._ended = True
