"""The board's store of requests and replies: a repeated request is not executed again.

Owns PROTOCOL.md's rule of repeats: same src, seq, cmd and body, within 2 s, among the last 4 answered. All requests
that a stop cancelled are stored for 2 s, and so are the requests of `_LASTING` executed before it. No I/O; time
comes in as `now`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame

__all__ = ["ReplyStore"]

_MAX_OPEN = 48
"""Requests without a reply: a board queues 24 and 16 stops, and executes one."""
_MAX_VOIDED = 1024
"""More requests than a serial line carries in 2 s."""
_LASTING = frozenset({Command.RESUME, Command.TORQUE, Command.MAINTENANCE})
"""Commands that end a stop, switch torque on or allow servo settings: a late repeat must not undo a stop."""


class ReplyStore:
    """Recent requests, with their replies."""

    def __init__(self) -> None:
        self._answered: deque[tuple[float, Frame, list[bytes]]] = deque(maxlen=tables.STORED_REPLIES)
        self._voided: deque[tuple[float, Frame, list[bytes]]] = deque(maxlen=_MAX_VOIDED)
        self._open: deque[tuple[float, Frame]] = deque(maxlen=_MAX_OPEN)
        self._done: deque[tuple[float, Frame]] = deque(maxlen=_MAX_VOIDED)

    def find(self, frame: Frame, now: float) -> list[bytes] | None:
        """Return the frames to send for a repeat; empty if the reply is pending; None if it is not a repeat."""
        for when, request, reply in (*self._answered, *self._voided):
            if _repeats(frame, request) and now - when < tables.REPEAT_WINDOW:
                return reply
        for when, request in self._open:
            if _repeats(frame, request) and now - when < tables.REPEAT_WINDOW:
                return []
        return None

    def find_by_number(self, src: int, seq: int, cmd: int, now: float) -> list[bytes]:
        """Return the reply to a request whose body is not available, such as a fragmented one."""
        for when, request, reply in (*self._answered, *self._voided):
            if (src, seq, cmd) == (request.src, request.seq, request.cmd) and now - when < tables.REPEAT_WINDOW:
                return reply
        return []

    def asked(self, frame: Frame, now: float) -> None:
        """Store a request that has no reply yet."""
        self._open.append((now, frame))

    def answered(self, frame: Frame, reply: list[bytes], now: float, *, voided: bool = False) -> None:
        """Store the reply to a request: the last few, and all of requests that a stop cancelled."""
        self.drop(frame)
        if not voided:
            self._answered.append((now, frame, reply))
            if frame.cmd in _LASTING:
                self._done.append((now, frame))
            return
        while self._voided and now - self._voided[0][0] >= tables.REPEAT_WINDOW:
            self._voided.popleft()
        self._voided.append((now, frame, reply))

    def drop(self, frame: Frame) -> None:
        """Forget that a request has no reply yet: what comes like it is a new one."""
        for entry in self._open:
            if _repeats(frame, entry[1]):
                self._open.remove(entry)
                break

    def void(self, make_reply: Callable[[Frame], bytes], now: float) -> None:
        """Apply a stop: repeats of requests executed before it get another reply from now on.

        Args:
            make_reply: Makes the reply to such a repeat.
            now: Seconds, monotonic.
        """
        for when, frame in self._done:
            if now - when < tables.REPEAT_WINDOW:
                self._voided.append((when, frame, [make_reply(frame)]))
        self._done.clear()

    def forget(self, src: int) -> None:
        """Drop the requests of a restarted module, so that its new requests do not count as repeats."""
        self._answered = deque((e for e in self._answered if e[1].src != src), tables.STORED_REPLIES)
        self._voided = deque((e for e in self._voided if e[1].src != src), _MAX_VOIDED)
        self._open = deque((e for e in self._open if e[1].src != src), _MAX_OPEN)
        self._done = deque((e for e in self._done if e[1].src != src), _MAX_VOIDED)


def _repeats(frame: Frame, request: Frame) -> bool:
    return (
        frame.seq == request.seq
        and frame.cmd == request.cmd
        and frame.src == request.src
        and frame.body == request.body
    )
