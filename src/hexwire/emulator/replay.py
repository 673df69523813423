"""A board that answers requests as they were answered in recorded traffic.

Owns the table of requests and their answers. With it a fault can be reproduced without the arm: a program gets
exactly the answers that were recorded. Knows no servos, nor where the traffic was recorded.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from hexwire.errors import UsageError
from hexwire.session.connection import Connection, Role
from hexwire.session.decoder import FrameDecoder
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.modules import ModuleType
from hexwire.wire.tables import PROTO_CHAPTER

__all__ = ["RecordedTransfer", "ReplayedBoard"]


_Asked = tuple[int, int, bytes]
"""Dialect, command and body of a request."""


class RecordedTransfer(NamedTuple):
    """Bytes that went over a line, seen from the host, at a time in seconds."""

    sent: bool
    data: bytes
    time: float


class _Reply(NamedTuple):
    # The chapter's board answers a dialect-2 request in its own dialect.
    proto: int
    status: int
    body: bytes


class ReplayedBoard:
    """A served device that answers from a recording.

    A request is identified by dialect, command and body. One that was recorded several times gets its answers in
    turn. One that is not in the recording is refused in dialect 2 (`not_supported`) and not answered in dialect 1.
    Reports are sent at the recorded pace once the host has asked for them with REPORT.

    Args:
        transfers: The recorded traffic, in order.
        start: The time at which it starts.

    Raises:
        UsageError: The traffic contains no answered request.
    """

    def __init__(self, transfers: Iterable[RecordedTransfer], *, start: float = 0.0) -> None:
        self.unknown = 0
        """Requests that are not in the recording."""
        # In the order they came; after the last, the first is given again.
        self._answers: dict[_Asked, list[_Reply]] = {}
        self._given: Counter[_Asked] = Counter()
        self._reports: list[tuple[float, Frame]] = []
        self._learn(transfers)
        if not self._answers:
            raise UsageError("this traffic contains no answered request; choose another recording")
        self._next_report = 0
        self._report_due: float | None = None
        self._max_frame = tables.MAX_NETWORK_FRAME
        self.reset(start)

    @property
    def known(self) -> int:
        """Number of different requests it can answer."""
        return len(self._answers)

    # -- a served device ----------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the host."""
        self._connection.receive(data, now)
        while (event := self._connection.next_event()) is not None:
            if isinstance(event, Request):
                self._answer(event, now)

    def step(self, now: float) -> None:
        """Send the reports that are due."""
        timeout = self._connection.next_timeout()
        if timeout is not None and timeout <= now:
            self._connection.handle_timeout(now)
        while self._report_due is not None and self._report_due <= now:
            due, frame = self._reports[self._next_report]
            self._connection.report(frame.cmd, frame.body, now)
            self._next_report = (self._next_report + 1) % len(self._reports)
            following = self._reports[self._next_report][0]
            self._report_due += max(following - due, 0.005)

    def data_to_send(self) -> bytes:
        """Bytes for the host since the last call."""
        return b"".join(self._connection.data_to_send())

    def next_event_time(self) -> float | None:
        """When `step` has something to do."""
        times = [t for t in (self._report_due, self._connection.next_timeout()) if t is not None]
        return min(times, default=None)

    def reset(self, now: float) -> None:
        """Restart with the first answers."""
        self._connection = Connection(
            Role.BOARD,
            local=ModuleType.ARM_7BOT_ARDUINO_TRX,
            remote=ModuleType.ARM_7BOT_SERIAL_TRX,
            type=ModuleType.ARM_7BOT_ARDUINO_TRX,
            max_frame=self._max_frame,
            epoch=-now,
        )
        self._report_due = None
        self._next_report = 0
        self._given.clear()

    # -- the recording ------------------------------------------------------------------------------

    def _learn(self, transfers: Iterable[RecordedTransfer]) -> None:
        asked: dict[int, Frame] = {}
        asked_chapter: Frame | None = None
        decoders = {True: FrameDecoder(tables.MAX_NETWORK_FRAME), False: FrameDecoder(tables.MAX_NETWORK_FRAME)}
        for transfer in transfers:
            decoder = decoders[transfer.sent]
            decoder.receive(transfer.data, transfer.time)
            while (event := decoder.next_event()) is not None:
                if not isinstance(event, Frame):
                    continue
                if transfer.sent:
                    asked[event.seq] = event
                    asked_chapter = event
                elif event.proto == PROTO_CHAPTER:
                    if asked_chapter is not None:
                        self._remember(asked_chapter, _Reply(PROTO_CHAPTER, Status.OK, event.body))
                    asked_chapter = None
                elif event.is_unsolicited:
                    self._reports.append((transfer.time, event))
                elif event.is_reply and event.seq in asked and asked[event.seq].cmd == event.cmd:
                    self._remember(asked.pop(event.seq), _Reply(event.proto, event.status, event.body))

    def _remember(self, request: Frame, reply: _Reply) -> None:
        key = (request.proto, request.cmd, request.body)
        self._answers.setdefault(key, []).append(reply)

    def _answer(self, request: Request, now: float) -> None:
        frame = request.frame
        asked = (frame.proto, frame.cmd, frame.body)
        answers = self._answers.get(asked)
        if answers is None:
            self.unknown += 1
            if frame.proto != PROTO_CHAPTER:
                self._connection.reply(request, Status.NOT_SUPPORTED, b"", now)
            return
        reply = answers[self._given[asked] % len(answers)]
        self._given[asked] += 1
        if reply.proto == PROTO_CHAPTER:
            self._connection.reply_dialect1(reply.body, now)
            return
        self._connection.reply(request, reply.status, reply.body, now)
        if frame.cmd == Command.REPORT and self._reports:
            self._report_due = now if any(frame.body[:2]) else None
