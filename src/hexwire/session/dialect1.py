"""The host's side of dialect 1: one outstanding request, pauses for an old board, and which bytes are answers.

Owns the queue of dialect-1 requests, their deadlines and retries, the quiet times in which arriving frames are
stale, and the rules of PROTOCOL.md section 5 that protect an old board. No I/O; time comes in as `now`. Must not
know dialect 2.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire.command_frame import Command, Frame, Status, command_name, max_body
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    StatusPacket,
    make_board_error,
    make_legacy_ping_status,
    make_status,
    parse_packet,
    parse_sync_write,
)
from hexwire.wire.tables import (
    BOARD_ERRORS,
    LEGACY_HEADER,
    MAX_SERIAL_FRAME,
    SERVO_HEADER,
    TAIL,
)

from .decoder import FrameDecoder
from .events import EventQueue, Reply, TimedOut
from .frame_maker import FrameMaker
from .policy import RetryPolicy
from .servo_answers import AnswerCollector, Expected, expected_answer

__all__ = [
    "MAX_PACKET",
    "SHORT_FRAME_PACKET",
    "UNKNOWN_COMMAND_PACKET",
    "ChapterHost",
    "Pending1",
    "match_reply",
]

MAX_PACKET = 63
"""Longest servo packet of commands 01 and 02; a longer one hangs the chapter's sketch (63-byte ring buffer)."""
SHORT_FRAME_PACKET = bytes.fromhex("FFF5FF0604F6")
UNKNOWN_COMMAND_PACKET = bytes.fromhex("FFF5FF0607F3")
_TARGET = Series.SEVEN_BOT.register("target_position").address
_SYNC_WRITE_DATA = 4
_READ_ANSWER = 8
_EXCHANGED = 6
_MOST_SENT = 64
"""Packets whose echo the board may still pass on: it returns late bytes with the next answer."""


@dataclass(slots=True)
class Pending1:
    """A dialect-1 request that waits to be sent or answered.

    Raises:
        LocalProtocolError: Its body is not a servo packet, or is one that the sketch cannot process.
    """

    ticket: int
    cmd: int
    body: bytes
    window: float
    attempts: int
    sent: int = 0
    sent_at: float = 0.0
    deadline: float = 0.0
    instead: str = ""
    urgent: bool = False
    frame: bytes = b""
    murky: dict[tuple[bytes, int], StatusPacket | None] = field(default_factory=dict)
    packet: ServoPacket = field(init=False)
    expected: Expected = field(init=False)

    def __post_init__(self) -> None:
        try:
            self.packet = parse_packet(self.body)
        except RemoteProtocolError as error:
            raise LocalProtocolError(f"dialect 1 carries servo packets only: {error}") from None
        problem = _problem(self.cmd, self.packet, len(self.body))
        if problem:
            raise LocalProtocolError(problem)
        if TAIL in self.body:
            raise LocalProtocolError(
                f"the packet {self.body.hex(' ').upper()} has 0D 0A inside, where a dialect-1 board would cut it"
            )
        self.expected = expected_answer(self.packet)

    @property
    def answered(self) -> bool:
        """Whether the board answers it."""
        return self.cmd != Command.SYNC_WRITE

    @property
    def servo_id(self) -> int:
        """Id of the servo addressed."""
        return self.packet.servo_id


def _problem(cmd: int, packet: ServoPacket, size: int) -> str:
    """Return why the sketch would hang on a request or misinterpret it; empty if it would not."""
    instruction, params = packet.instruction, packet.params
    if cmd == Command.SYNC_WRITE:
        longest = max_body(MAX_SERIAL_FRAME)
        if size > longest:
            return f"a sync write of {size} bytes would hang a dialect-1 board; {longest} is the most"
        try:
            address, rows = parse_sync_write(packet)
        except RemoteProtocolError as error:
            return f"SYNC_WRITE carries a sync write only: {error}"
        if not rows or address != _TARGET or len(rows[0][1]) != _SYNC_WRITE_DATA:
            return (
                f"a dialect-1 board writes {_SYNC_WRITE_DATA} bytes at 0x{_TARGET:02X} per servo for any sync write"
            )
        return ""
    if cmd not in (Command.PING, Command.READ):
        return f"{command_name(cmd)} does not exist in dialect 1"
    if size > MAX_PACKET:
        return f"a packet of {size} bytes would hang a dialect-1 board; {MAX_PACKET} is the most"
    if packet.servo_id == BROADCAST_ID:
        return "a packet to all servos would overrun a dialect-1 board; only a sync write may go to all"
    if cmd == Command.PING and instruction != Instruction.PING:
        return "PING carries a ping only: any longer answer would overrun a dialect-1 board"
    if instruction == Instruction.READ and params[1:] != b"\x02":
        return "a read of other than 2 bytes would overrun a dialect-1 board"
    return ""


def match_reply(body: bytes, pending: Pending1, sent: Collection[bytes] = ()) -> bytes | None:
    """Find the status packet in a dialect-1 reply that answers `pending`.

    The payload is everything that the board received on its bus, with noise, echoes and late answers. For command
    02 and a legacy servo, the board has exchanged bytes 5 and 6 of it, whatever they are. The payload is searched
    twice: with the exchange undone for a legacy servo's answer (FF F5), and unchanged for any other (FF FF).
    `AnswerCollector` decides what counts as an answer.

    Args:
        body: The payload.
        pending: The request. It keeps doubtful answers.
        sent: Packets sent before: the board returns a late echo with the next answer.

    Returns:
        Bytes of the status packet without echo and noise, a legacy servo's two data bytes little-endian; the
        board's error packet if that is the answer; None if this frame answers another request, or is ambiguous.
    """
    if body in (UNKNOWN_COMMAND_PACKET, SHORT_FRAME_PACKET):
        return body
    exchanged = _exchange(body) if pending.cmd == Command.READ else body
    params = pending.expected.params
    found = _answer(exchanged, pending, LEGACY_HEADER, params, sent)
    if found is not None:
        read = pending.packet.instruction == Instruction.READ
        return _exchange(found) if read and len(found) == _READ_ANSWER else found
    if params != 2 and pending.packet.instruction != Instruction.PING:
        # A board reports "no answer" to any packet of command 02 as for a 2-byte read.
        found = _answer(exchanged, pending, LEGACY_HEADER, 2, sent)
        if found == make_board_error(BOARD_ERRORS["read_silent"], pending.servo_id):
            return found
    if exchanged.count(pending.body) > body.count(pending.body):
        # The board exchanged the bytes, so this is a legacy servo, and the rest of the payload is not its answer.
        return None
    return _answer(body, pending, SERVO_HEADER, params, sent)


def _exchange(payload: bytes) -> bytes:
    """Exchange bytes 5 and 6 of a payload, if it has that many."""
    return payload[:5] + payload[6:7] + payload[5:6] + payload[7:] if len(payload) > _EXCHANGED else payload


def _answer(data: bytes, pending: Pending1, header: bytes, params: int, sent: Collection[bytes]) -> bytes | None:
    """Return the bytes of the only answer in a payload; None without one, or with several that differ."""
    collector = AnswerCollector(pending.body, (pending.servo_id,), params, header=header, sent=sent, all_sent=True)
    collector.receive(data)
    found = collector.answers.get(pending.servo_id)
    if found is None:
        # An answer followed by invalid bytes is trusted if it arrives twice.
        found = collector.murky.get(pending.servo_id)
        before, pending.murky[header, params] = pending.murky.get((header, params)), found
        if found is None or found != before:
            return None
    packet = make_status(found.servo_id, found.error, found.params, legacy=found.legacy)
    return packet if packet in data else make_legacy_ping_status(found.servo_id, found.error)


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
