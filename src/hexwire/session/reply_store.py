"""The board's memory of what it was asked: a request that comes again is not executed again.

Owns PROTOCOL.md's rule of repeats: same src, seq, cmd and body, within 2 s, among the last 4 answered. What a stop
made void is remembered for 2 s however much it was, and so are the requests of `_LASTING` that were done before it.
Sans I/O; time comes in as `now`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame

__all__ = ["ReplyStore"]

_MAX_OPEN = 48
"""Requests without an answer: a board keeps 24 and 16 stops, and the one under way."""
_MAX_VOIDED = 1024
"""More than a serial line carries in 2 s."""
_LASTING = frozenset({Command.RESUME, Command.TORQUE, Command.MAINTENANCE})
"""What ends a stop, gives torque or opens the servos' settings: a late repeat must not undo a stop."""


class ReplyStore:
    """Requests of late, with their answers once they have one."""

    def __init__(self) -> None:
        self._answered: deque[tuple[float, Frame, list[bytes]]] = deque(maxlen=tables.STORED_REPLIES)
        self._voided: deque[tuple[float, Frame, list[bytes]]] = deque(maxlen=_MAX_VOIDED)
        self._open: deque[tuple[float, Frame]] = deque(maxlen=_MAX_OPEN)
        self._done: deque[tuple[float, Frame]] = deque(maxlen=_MAX_VOIDED)

    def find(self, frame: Frame, now: float) -> list[bytes] | None:
        """Frames to send for a repeat; none of them if its answer is on the way; None if it is no repeat."""
        for when, request, reply in (*self._answered, *self._voided):
            if _repeats(frame, request) and now - when < tables.REPEAT_WINDOW:
                return reply
        for when, request in self._open:
            if _repeats(frame, request) and now - when < tables.REPEAT_WINDOW:
                return []
        return None

    def find_by_number(self, src: int, seq: int, cmd: int, now: float) -> list[bytes]:
        """The answer to a request whose body is not at hand, as that of one in fragments."""
        for when, request, reply in (*self._answered, *self._voided):
            if (src, seq, cmd) == (request.src, request.seq, request.cmd) and now - when < tables.REPEAT_WINDOW:
                return reply
        return []

    def asked(self, frame: Frame, now: float) -> None:
        """Remember a request that has no answer yet."""
        self._open.append((now, frame))

    def answered(self, frame: Frame, reply: list[bytes], now: float, *, voided: bool = False) -> None:
        """Remember the frames that answered a request; the last few, but all of what a stop made void."""
        for entry in self._open:
            if _repeats(frame, entry[1]):
                self._open.remove(entry)
                break
        if not voided:
            self._answered.append((now, frame, reply))
            if frame.cmd in _LASTING:
                self._done.append((now, frame))
            return
        while self._voided and now - self._voided[0][0] >= tables.REPEAT_WINDOW:
            self._voided.popleft()
        self._voided.append((now, frame, reply))

    def void(self, make_reply: Callable[[Frame], bytes], now: float) -> None:
        """A stop came: a repeat of what was done before it gets another answer from now on.

        Args:
            make_reply: Makes the frame that answers such a repeat.
            now: Seconds, monotonic.
        """
        for when, frame in self._done:
            if now - when < tables.REPEAT_WINDOW:
                self._voided.append((when, frame, [make_reply(frame)]))
        self._done.clear()

    def forget(self, src: int) -> None:
        """Drop what a module asked: it starts anew, and nothing it asks may pass for a repeat."""
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
