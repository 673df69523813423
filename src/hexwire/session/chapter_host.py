"""The host's side of dialect 1: one outstanding request, and pauses where an old board needs them.

Owns the queue of dialect-1 requests, their deadlines and retries, and the quiet times in which arriving frames are
stale. No I/O; time comes in as `now`. Must not know dialect 2 or its owner.
"""

from __future__ import annotations

from collections import deque

from hexwire.wire.command_frame import Frame, Status

from .decoder import FrameDecoder
from .dialect1 import Pending1, match_reply
from .event_queue import EventQueue
from .events import Reply, TimedOut
from .frame_maker import FrameMaker
from .policy import RetryPolicy

__all__ = ["ChapterHost"]

_MOST_SENT = 64
"""Packets whose echo the board may still pass on: it returns late bytes with the next answer."""


class ChapterHost:
    """Dialect-1 requests of one host connection.

    Args:
        maker: Builds the frames, keeps them until they are written, and counts.
        decoder: Decoder of the received bytes; it is reset when the window of an answer ends.
        events: Queue for answers and time-outs.
        policy: Deadlines and retries.
    """

    def __init__(self, maker: FrameMaker, decoder: FrameDecoder, events: EventQueue, policy: RetryPolicy) -> None:
        self._maker = maker
        self._decoder = decoder
        self._events = events
        self._policy = policy
        self._queue: deque[Pending1] = deque()
        self._current: Pending1 | None = None
        self._quiet_until = 0.0
        self._posted: Pending1 | None = None
        self._sent: dict[bytes, None] = {}

    def request(
        self,
        ticket: int,
        cmd: int,
        body: bytes,
        now: float,
        window: float | None,
        attempts: int,
        urgent: bool,
    ) -> None:
        """Queue a request; see `Connection.request`."""
        pending = Pending1(ticket, cmd, body, window or self._policy.dialect1_window, attempts)
        pending.urgent = urgent
        if urgent:
            self._queue.appendleft(pending)
        else:
            self._queue.append(pending)
        self._pump(now)

    def receive(self, frame: Frame, now: float) -> bool:
        """Process a dialect-1 frame; False if it does not answer the outstanding request."""
        pending = self._current
        packet = match_reply(frame.body, pending, self._sent) if pending is not None else None
        if pending is None or packet is None:
            return False
        self._current = None
        self._maker.counters.replies += 1
        if pending.sent > 1:
            # An answer to an earlier attempt may still arrive, and could be taken for that of the next request.
            self._quiet_until = now + pending.window
        rtt = now - pending.sent_at
        self._events.add(Reply(pending.ticket, pending.cmd, Status.OK, packet, frame, rtt, pending.sent))
        self._pump(now)
        return True

    def holds(self, ticket: int) -> bool:
        """Whether a request is outstanding or queued."""
        current = self._current
        return (current is not None and current.ticket == ticket) or any(p.ticket == ticket for p in self._queue)

    def abandon(self, ticket: int) -> bool:
        """Forget a request. If it is outstanding, nothing is sent until the window of its answer ends.

        Returns:
            Whether it may have been sent; True for an unknown request.
        """
        left = not any(p.ticket == ticket for p in self._queue)
        self._queue = deque(p for p in self._queue if p.ticket != ticket)
        if self._current is not None and self._current.ticket == ticket:
            left = self._give_up()
        elif self._posted is not None and self._posted.ticket == ticket:
            # A signal handler may have stopped the arm just before the frame was queued.
            left = self._maker.withhold(self._posted.frame)
        return left

    def void(self) -> list[bytes]:
        """Forget every request that is not urgent; returns the frame of an urgent outstanding one."""
        self._queue = deque(p for p in self._queue if p.urgent)
        if self._current is not None and self._current.urgent:
            return [self._current.frame]
        if self._current is not None:
            self._give_up()
        return []

    def _give_up(self) -> bool:
        pending, self._current = self._current, None
        if pending is None:
            return False
        left = self._maker.withhold(pending.frame) or pending.sent > 1
        if left:
            self._quiet_until = pending.deadline
        return left

    def stay_quiet(self, until: float) -> None:
        """Send nothing before this time."""
        self._quiet_until = max(self._quiet_until, until)

    def note(self, instead: str) -> None:
        """Record what arrived instead of the answer."""
        if self._current is not None:
            self._current.instead = instead

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        if self._current is not None:
            return self._current.deadline
        return self._quiet_until if self._queue else None

    def handle_timeout(self, now: float) -> None:
        """Repeat the request, give up, or send the next one in the queue."""
        pending = self._current
        counters = self._maker.counters
        if pending is not None and pending.deadline <= now:
            self._decoder.reset()
            if pending.sent < pending.attempts:
                counters.retries += 1
                self._transmit(pending, now)
            else:
                self._current = None
                self._quiet_until = now + pending.window
                counters.timeouts += 1
                self._events.add(TimedOut(pending.ticket, pending.cmd, pending.sent, pending.instead))
        self._pump(now)

    def _pump(self, now: float) -> None:
        while self._current is None and now >= self._quiet_until:
            try:
                pending = self._queue.popleft()
            except IndexError:
                break  # no check before: a stop in a signal handler may empty the queue at any time
            self._transmit(pending, now)
            if pending.answered:
                self._current = pending
            else:
                self._posted = pending
                self._quiet_until = now + self._policy.dialect1_holdoff
                self._events.add(Reply(pending.ticket, pending.cmd, Status.OK, b"", None, 0.0, 1))

    def _transmit(self, pending: Pending1, now: float) -> None:
        pending.frame = self._maker.send_chapter(pending.cmd, pending.body, now)
        pending.sent += 1
        pending.sent_at = now
        pending.deadline = now + pending.window
        self._sent.pop(pending.body, None)
        self._sent[pending.body] = None
        if len(self._sent) > _MOST_SENT:
            del self._sent[next(iter(self._sent))]
