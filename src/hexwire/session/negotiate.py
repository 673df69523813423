"""Negotiation of the dialect: try IDENTIFY, then fall back to the chapter's dialect.

Owns the order of the requests and the diagnosis when nothing answers. Works on a `Connection`, without I/O: the
caller moves bytes, passes events to `handle`, and calls `handle_timeout`. Requests are repeated until a deadline,
since a board may still be booting (opening its port resets a Mega).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import LinkBusyError, RemoteProtocolError, ReplyTimeoutError, WrongDeviceError
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
"""Unanswered requests after which the caller may look for another device on the line."""
_WORTH_SAYING = 1.0
"""Seconds still to wait from which on a word about it helps."""
_NOISE = 64
_NETWORK = ("tcp:", "tcps:", "udp:", "mq:")
_NOTHING = "check the port, the rate, and the board's power and firmware; `hexwire ports` lists ports"
_NOBODY = "check the address, and that a robot is there; another one needs its name, as in --robot puma260"
_GREETING = re.compile(rb"(?:HTTP/\d|SSH-\d|<!doctype |<html|220[ -]|\* OK|\+OK)[ -~]*", re.IGNORECASE)
"""What other servers begin with."""
_ASK_ON = 2
"""IDENTIFYs after an answered ping: every board answers the ping, and one that has just booted may have missed
the IDENTIFYs before."""


@dataclass(frozen=True, slots=True)
class Negotiated:
    """The board answered.

    Attributes:
        dialect: 1 or 2.
        identity: Its reply to IDENTIFY; None in dialect 1, which has no such command.
    """

    dialect: int
    identity: Identity | None


@dataclass(frozen=True, slots=True)
class NegotiationFailed:
    """Nothing answered in either dialect.

    Attributes:
        attempts: Number of requests sent.
        bytes_received: Bytes that arrived meanwhile.
        frames: Valid frames among them.
        servo_id: Servo that answered a ping directly, without a board's frame: this is a servo bus.
        echoes: Our own frames among those frames.
        told: Why the other end refuses, in its words.
        greeting: The first line of a program that is no robot's.
    """

    attempts: int
    bytes_received: int
    frames: int
    servo_id: int | None = None
    echoes: int = 0
    told: str = ""
    greeting: str = ""

    def as_error(self, url: str) -> ReplyTimeoutError | LinkBusyError:
        """Make the error that says what arrived instead of an answer, and what to do about it."""
        if self.told:
            return LinkBusyError(f"{url} refuses: {self.told}", url=url)
        if self.greeting:
            return WrongDeviceError(f"{url} is no robot: it says {self.greeting!r}; check the address")
        network = url.startswith(_NETWORK)
        if self.bytes_received == 0:
            instead = ""
            advice = _NOBODY if network else _NOTHING
        elif self.frames == 0:
            instead = f"{self.bytes_received} bytes that are not a frame"
            advice = _NOBODY if network else "the baud rate may be wrong, or this is another device"
        elif self.echoes:
            instead = f"{self.echoes} of our own frames"
            advice = "the line only echoes, and no board is connected: an adapter, or a plug with TX on RX"
        else:
            instead = f"{self.frames} frames that answer no request"
            advice = "another program uses the line, or the board is of another make"
        return ReplyTimeoutError(f"IDENTIFY on {url}", attempts=self.attempts, instead=instead, advice=advice)


class Negotiator:
    """One negotiation.

    Args:
        connection: A host connection; its dialect is set to the outcome.
        now: Seconds, monotonic.
        boot_window: Seconds to repeat the requests.
        ping_ids: Servos to ping in dialect 1.
        dialect: Try this dialect only; both if None.
        look: Pause once after the first unanswered requests, so that the caller can look for another kind of
            device; `go_on` ends the pause.

    Attributes:
        paused: Nothing is sent until `go_on`.
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
        self._heard = b""
        self._echoes = 0
        self.outcome: Negotiated | NegotiationFailed | None = None
        self._connection = connection
        self._deadline = now + boot_window
        self._ping_ids = tuple(ping_ids) or (0,)
        self._only = dialect
        self._asked = 0
        self._pings = 0
        self._left_to_ask: int | None = None
        self._clearing = False
        self._knows_identify = False
        self._bytes_before = connection.decoder.counters.bytes_received
        self._frames_before = connection.decoder.counters.frames
        self._ticket = 0
        connection.cautious = True
        self._next(now)

    def handle(self, event: Event, now: float) -> None:
        """Process an event of the connection; sets `outcome` when the negotiation ends."""
        if isinstance(event, Garbage):
            self._overhear(event.data)
        elif isinstance(event, Stale):
            self._echoes += event.frame.src == self._connection.local
        if self.outcome is not None or not isinstance(event, Reply | TimedOut) or event.ticket != self._ticket:
            return
        if self._clearing:
            # Whatever the answer, the end of this ping was the end of a frame for the board.
            self._settle(Negotiated(PROTO_CHAPTER, None))
        elif isinstance(event, TimedOut):
            self._next(now)
        elif event.cmd != Command.IDENTIFY:
            if self._only is None:
                self._left_to_ask = _ASK_ON
                self._next(now)
            else:
                self._settle_chapter(now)
        elif event.frame is not None and event.frame.proto == PROTO_CHAPTER and self._only is None:
            self._settle_chapter(now)
        elif event.status == Status.OK:
            try:
                identity = Identity.parse(event.body)
            except RemoteProtocolError:
                self._next(now)
            else:
                self._settle(Negotiated(PROTO_HEXWIRE, identity))
        elif event.status == Status.BUSY and event.body:
            # A gateway whose board has another host: asking again would not help.
            text = event.body.decode(errors="replace")
            self._fail(None, "".join(letter if letter.isprintable() else "?" for letter in text))
        else:
            # Refused because of a stop or a busy board: the board speaks dialect 2, so repeat the request.
            self._knows_identify = event.status in (Status.STOPPED, Status.BUSY) or self._knows_identify
            self._left_to_ask = None if self._knows_identify else self._left_to_ask
            self._next(now)

    def hint(self, url: str, now: float) -> str:
        """What to say of an address that is silent for long, though a board may still be booting there.

        Empty for a serial port, where nothing but a board or servos can be, and if the end is near anyway.
        """
        left = self._deadline - now
        if self.outcome is not None or left < _WORTH_SAYING or not url.startswith(_NETWORK):
            return ""
        return f"{url}: nothing has answered yet; {_NOBODY}. A board may be booting: {left:.0f} s more for it"

    def go_on(self, now: float) -> None:
        """End the pause."""
        self.paused = False
        self._next(now)

    def _overhear(self, data: bytes) -> None:
        """Detect another server, and a servo that answers the ping inside a frame directly: it has no board."""
        if not self._heard:
            self._heard = data
            greeting = _GREETING.match(data)
            if greeting is not None and self.outcome is None:
                self._fail(None, greeting=greeting[0].decode())
                return
        self._noise = (self._noise + data)[-_NOISE:]
        try:
            status = parse_status(self._noise)
        except RemoteProtocolError:
            return
        # The echo of a ping looks like an answer.
        if status.servo_id == self._pinged and self._noise != make_ping(self._pinged) and self.outcome is None:
            self._fail(status.servo_id)

    def _settle(self, outcome: Negotiated) -> None:
        self.outcome = outcome
        self._connection.dialect = outcome.dialect
        self._connection.cautious = outcome.dialect == PROTO_CHAPTER

    def _settle_chapter(self, now: float) -> None:
        if self._asked == 1:
            self._settle(Negotiated(PROTO_CHAPTER, None))
            return
        # A board that booted meanwhile now answers queued requests: ignore those answers. It also has half a frame
        # if its buffer was full, and takes the next one for the rest of it: that must be nobody's request.
        self._connection.stay_quiet(now + tables.DIALECT1_REPLY_WINDOW)
        self._clearing = True
        self._ask(now, ping=True)

    def _next(self, now: float) -> None:
        if self._left_to_ask == 0:
            self._settle_chapter(now)
            return
        if self._left_to_ask is not None:
            self._left_to_ask -= 1
            self._ask(now, ping=False)
            return
        if self._look and self._asked == _LOOK_AFTER:
            self._look, self.paused = False, True
            return
        if self._asked == 0 or now < self._deadline:
            # IDENTIFY twice, then a dialect-1 ping, and so on: a board that does not answer IDENTIFY may answer the
            # ping.
            both = self._only is None and not self._knows_identify
            self._ask(now, ping=self._only == PROTO_CHAPTER or (both and self._asked % 3 == 2))
            return
        self._fail(None)

    def _fail(self, servo_id: int | None, told: str = "", greeting: str = "") -> None:
        counters = self._connection.decoder.counters
        received = counters.bytes_received - self._bytes_before
        frames = counters.frames - self._frames_before
        self.outcome = NegotiationFailed(self._asked, received, frames, servo_id, self._echoes, told, greeting)

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
