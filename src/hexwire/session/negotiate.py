"""Which dialect does the board speak? Ask with IDENTIFY; fall back to the chapter's dialect.

Owns the order of the questions and the verdict when nobody answers. Works on a `Connection`, sans I/O: the
caller moves bytes, hands events in with `handle`, and calls `handle_timeout`. A board that is still booting
(opening its port resets a Mega) is waited for by asking, until a deadline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import RemoteProtocolError, ReplyTimeoutError
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Identity
from hexwire.wire.servo_packet import make_ping, parse_status
from hexwire.wire.tables import PROTO_CHAPTER, PROTO_HEXWIRE

from .connection import Connection
from .events import Event, Garbage, Reply, Stale, TimedOut

__all__ = ["Negotiated", "NegotiationFailed", "Negotiator"]

_ASK_WINDOW = 0.25
_LOOK_AFTER = 2
"""Unanswered questions after which it is time to look for something else on the line."""
_NOISE = 64
_ASK_ON = 2
"""IDENTIFYs after a ping that was answered: every board answers it, and one that has just booted may have
missed the questions before."""


@dataclass(frozen=True, slots=True)
class Negotiated:
    """The board answered.

    Attributes:
        dialect: 1 or 2.
        identity: What it said of itself; None in dialect 1, which has no such question.
    """

    dialect: int
    identity: Identity | None


@dataclass(frozen=True, slots=True)
class NegotiationFailed:
    """Nobody answered in either dialect.

    Attributes:
        attempts: How often we asked.
        bytes_received: Bytes that arrived meanwhile.
        frames: Good frames among them.
        servo_id: A servo that answered a ping by itself, without a board's frame around it: this is a servo bus.
        echoes: Our own frames among those.
    """

    attempts: int
    bytes_received: int
    frames: int
    servo_id: int | None = None
    echoes: int = 0

    def as_error(self, url: str) -> ReplyTimeoutError:
        """The error that says what came instead of an answer, and what to do about it."""
        if self.bytes_received == 0:
            instead = ""
            advice = (
                "is this the board's port and rate, has the board power and firmware? `hexwire ports` lists ports"
            )
        elif self.frames == 0:
            instead = f"{self.bytes_received} bytes that are no frame"
            advice = "a wrong baud rate looks like this; so does another device"
        elif self.echoes:
            instead = f"{self.echoes} of our own frames"
            advice = "the line hears itself, and no board is behind it: an adapter, or a plug with TX on RX"
        else:
            instead = f"{self.frames} frames that answer nothing"
            advice = "another program on the line, or a board of another make"
        return ReplyTimeoutError(f"IDENTIFY on {url}", attempts=self.attempts, instead=instead, advice=advice)


class Negotiator:
    """One negotiation.

    Args:
        connection: A host connection; its dialect is set to the outcome.
        now: Seconds, monotonic.
        boot_window: Seconds to go on asking.
        ping_ids: Servos to ping in dialect 1.
        dialect: Ask only in this dialect; both if None.
        look: Pause once, when the first questions were not answered, so that the caller can look for another kind
            of device; `go_on` ends the pause.

    Attributes:
        paused: Nothing is asked until `go_on`.
    """

    def __init__(
        self,
        connection: Connection,
        now: float,
        *,
        boot_window: float = tables.BOOT_WINDOW,
        ping_ids: Sequence[int] = (0,),
        dialect: int | None = None,
        look: bool = False,
    ) -> None:
        self.paused = False
        self._look = look
        self._pinged = -1
        self._noise = b""
        self._echoes = 0
        self.outcome: Negotiated | NegotiationFailed | None = None
        self._connection = connection
        self._deadline = now + boot_window
        self._ping_ids = tuple(ping_ids) or (0,)
        self._only = dialect
        self._asked = 0
        self._pings = 0
        self._left_to_ask: int | None = None
        self._knows_identify = False
        self._bytes_before = connection.decoder.counters.bytes_received
        self._frames_before = connection.decoder.counters.frames
        self._ticket = 0
        connection.cautious = True
        self._next(now)

    def handle(self, event: Event, now: float) -> None:
        """Take an event of the connection; `outcome` is set when it settles the matter."""
        if isinstance(event, Garbage):
            self._overhear(event.data)
        elif isinstance(event, Stale):
            self._echoes += event.frame.src == self._connection.local
        if self.outcome is not None or not isinstance(event, Reply | TimedOut) or event.ticket != self._ticket:
            return
        if isinstance(event, TimedOut):
            self._next(now)
        elif event.cmd != Command.IDENTIFY:
            if self._only is None:
                self._left_to_ask = _ASK_ON
                self._next(now)
            else:
                self._settle(Negotiated(PROTO_CHAPTER, None), now)
        elif event.frame is not None and event.frame.proto == PROTO_CHAPTER and self._only is None:
            self._settle(Negotiated(PROTO_CHAPTER, None), now)
        elif event.status == Status.OK:
            try:
                identity = Identity.parse(event.body)
            except RemoteProtocolError:
                self._next(now)
            else:
                self._settle(Negotiated(PROTO_HEXWIRE, identity), now)
        else:
            # It was asked before a stop, or while the board was busy: it knows dialect 2, and is asked again.
            self._knows_identify = event.status in (Status.STOPPED, Status.BUSY) or self._knows_identify
            self._left_to_ask = None if self._knows_identify else self._left_to_ask
            self._next(now)

    def go_on(self, now: float) -> None:
        """End the pause."""
        self.paused = False
        self._next(now)

    def _overhear(self, data: bytes) -> None:
        """A servo answers the ping that it hears in a frame. No frame around its answer: there is no board."""
        self._noise = (self._noise + data)[-_NOISE:]
        try:
            status = parse_status(self._noise)
        except RemoteProtocolError:
            return
        # The echo of a ping looks like an answer.
        if status.servo_id == self._pinged and self._noise != make_ping(self._pinged) and self.outcome is None:
            self._fail(status.servo_id)

    def _settle(self, outcome: Negotiated, now: float) -> None:
        self.outcome = outcome
        self._connection.dialect = outcome.dialect
        self._connection.cautious = outcome.dialect == PROTO_CHAPTER
        if outcome.dialect == PROTO_CHAPTER and self._asked > 1:
            # A board that booted meanwhile now answers what it had queued: let that pass.
            self._connection.stay_quiet(now + tables.DIALECT1_REPLY_WINDOW)

    def _next(self, now: float) -> None:
        if self._left_to_ask == 0:
            self._settle(Negotiated(PROTO_CHAPTER, None), now)
            return
        if self._left_to_ask is not None:
            self._left_to_ask -= 1
            self._ask(now, ping=False)
            return
        if self._look and self._asked == _LOOK_AFTER:
            self._look, self.paused = False, True
            return
        if self._asked == 0 or now < self._deadline:
            # IDENTIFY twice, then a dialect-1 ping, and so on: a board that answers neither of the first two
            # may still know the ping.
            both = self._only is None and not self._knows_identify
            self._ask(now, ping=self._only == PROTO_CHAPTER or (both and self._asked % 3 == 2))
            return
        self._fail(None)

    def _fail(self, servo_id: int | None) -> None:
        counters = self._connection.decoder.counters
        received = counters.bytes_received - self._bytes_before
        frames = counters.frames - self._frames_before
        self.outcome = NegotiationFailed(self._asked, received, frames, servo_id, self._echoes)

    def _ask(self, now: float, *, ping: bool) -> None:
        self._asked += 1
        self._noise = b""
        connection = self._connection
        if ping:
            servo_id = self._ping_ids[self._pings % len(self._ping_ids)]
            self._pings += 1
            self._pinged = servo_id
            connection.dialect = PROTO_CHAPTER
            self._ticket = connection.request(Command.PING, make_ping(servo_id), now, attempts=1)
        else:
            connection.dialect = PROTO_HEXWIRE
            self._ticket = connection.request(Command.IDENTIFY, b"", now, window=_ASK_WINDOW, attempts=1)
