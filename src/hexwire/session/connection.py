"""The session state machine: one class, two roles, both dialects, no I/O.

Owns frame numbers, sequence numbers, matching of replies, deadlines and retries, suppression of repeats, fragments.
`receive` takes bytes, `next_event` returns events, `data_to_send` returns bytes to write; time comes in as `now`.
Knows nothing of links, clocks, joints or servo registers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from hexwire.errors import LocalProtocolError, RemoteProtocolError
from hexwire.wire import tables
from hexwire.wire.addresses import address_of
from hexwire.wire.command_frame import Command, Frame, Status, command_name, serialize_frame
from hexwire.wire.commands import FragmentHead, parse_missing
from hexwire.wire.tables import EXT_REPLY, EXT_STATUS_MASK, EXT_UNSOLICITED, PROTO_CHAPTER, PROTO_HEXWIRE

from .conversation import Conversations, Numbers
from .decoder import FrameDecoder
from .dialect1 import UNKNOWN_COMMAND_PACKET, ChapterHost
from .effects import Effect, effect_of
from .events import (
    BadFrame,
    ConnectionCounters,
    Event,
    EventQueue,
    Garbage,
    Reply,
    Report,
    Request,
    Stale,
    TimedOut,
)
from .fragments import FragmentReceiver, FragmentSender, Message
from .frame_maker import FrameMaker, Role
from .policy import RetryPolicy
from .several import SeveralRequests

__all__ = ["Connection", "ConnectionCounters", "Pending", "ReplyStore", "Role"]

_NUMBERS = 256
_FORGOTTEN = tables.REPEAT_WINDOW + 0.5
"""Seconds after its end for which a request that a stop has voided is remembered, and what clocks may differ."""
_MAX_OPEN = 48
"""Requests without a reply: a board queues 24 and 16 stops, and executes one."""
_MAX_VOIDED = 1024
"""More requests than a serial line carries in 2 s."""
_LASTING = frozenset({Command.RESUME, Command.TORQUE, Command.MAINTENANCE})
"""Commands that end a stop, switch torque on or allow servo settings: a late repeat must not undo a stop."""
_Timed = ChapterHost | SeveralRequests | FrameDecoder | FragmentReceiver | FragmentSender
# An enum's attribute lookup takes longer than a comparison, and these are compared for every frame.
_HOST, _BOARD = Role.HOST, Role.BOARD
_IDENTIFY, _FRAGMENT, _FRAGMENT_MISSING = Command.IDENTIFY, Command.FRAGMENT, Command.FRAGMENT_MISSING
_FOR_SEVERAL = frozenset(
    (
        Command.SYNC_WRITE,
        Command.IDENTIFY,
        Command.JOINT_STATE,
        Command.REPORT,
        Command.JOINT_MOVE,
        Command.TORQUE,
        Command.STOP,
        Command.RESUME,
        Command.WATCHDOG,
        Command.STATS,
        Command.TRAJECTORY_START,
        Command.TRAJECTORY_STATUS,
        Command.TRAJECTORY_ABORT,
    )
)
"""Commands that may name several modules (PROTOCOL.md section 6.9)."""


@dataclass(slots=True)
class Pending:
    """A request that was sent at least once.

    Attributes:
        ticket: What the caller knows it by.
        seq: Its number on the wire.
        window: Seconds for each answer.
        attempts: Most times that it is sent.
        sent: Times that it has been sent.
        sent_at: Time of the last attempt.
        deadline: Time at which that attempt is over.
        instead: What arrived instead of the answer, in words.
        message_id: Its message in fragments; None if it fits a frame.
        urgent: It is a stop.
        frames: Frames of the last attempt; those not written yet can still be withheld.
    """

    ticket: int
    cmd: int
    body: bytes
    seq: int
    window: float
    attempts: int
    sent: int = 0
    sent_at: float = 0.0
    deadline: float = 0.0
    instead: str = ""
    message_id: int | None = None
    urgent: bool = False
    frames: list[bytes] = field(default_factory=list)

    def begin_attempt(self, now: float) -> None:
        """Count one more attempt, whose window begins now."""
        self.sent += 1
        self.sent_at = now
        self.extend(now)

    def extend(self, now: float) -> None:
        """Begin the window of this attempt anew: the peer is still busy with the request."""
        self.deadline = now + self.window


class ReplyStore:
    """The board's store of requests and replies: a repeated request is not executed again.

    It keeps PROTOCOL.md's rule of repeats: same src, seq, cmd and body, within 2 s, among the last 4 answered. All
    requests that a stop cancelled are stored for 2 s, and so are the requests of `_LASTING` executed before it.
    """

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


class Connection(FrameMaker):
    """One end of a session.

    Args:
        role: HOST sends requests, BOARD answers them.
        local: Module id of this end; src of the frames it sends.
        remote: Module id of the peer; dst of the frames it is sent.
        type: The header's type field: 3 from a host on a serial line, 8 from a board.
        dialect: Dialect of requests, 1 or 2.
        policy: Deadlines and retries.
        max_frame: Longest frame on this link, in bytes.
        epoch: Added to `now` for the header's time: wall minus monotonic on a host, minus boot time on a board.
        cautious: Keep 0D 0A out of every frame, while the kind of board is unknown.
        assembles: Fragments are put together here; otherwise each is a request of its own, which is never a repeat.
        duplex: Take requests as a host, too, and send them as a board, too: for two modules that are alike.
        numbers: On a link of datagrams, the source of random numbers from 0 to 2**31 - 1 that identify a
            conversation; frames that are old or of another conversation are then refused (PROTOCOL.md section 6.6).

    Attributes:
        conversations: The conversation over datagrams; None on a stream.
        several: Requests to several modules.
    """

    def __init__(
        self,
        role: Role,
        *,
        local: int,
        remote: int,
        type: int,
        dialect: int = PROTO_HEXWIRE,
        policy: RetryPolicy | None = None,
        max_frame: int = tables.MAX_SERIAL_FRAME,
        epoch: float = 0.0,
        cautious: bool = False,
        assembles: bool = True,
        duplex: bool = False,
        numbers: Numbers | None = None,
    ) -> None:
        super().__init__(
            role,
            local=local,
            remote=remote,
            type=type,
            max_frame=max_frame,
            epoch=epoch,
            cautious=cautious,
            numbers=numbers,
        )
        self.policy = policy or RetryPolicy()
        self.dialect = dialect
        self.assembles = assembles
        self.duplex = duplex
        self._asks = role is _HOST or duplex
        self.decoder = FrameDecoder(max_frame)
        self._events = EventQueue(self.counters)
        self._ticket = 0
        self._pending: dict[int, Pending] = {}
        # When a board has forgotten a request that acts, by its number, command and hash of the body.
        self._used: dict[tuple[int, int, int], float] = {}
        self._chapter = ChapterHost(self, self.decoder, self._events, self.policy)
        self.several = SeveralRequests(self, self._events)
        self._replies = ReplyStore()
        self._fragments_in = FragmentReceiver()

    # -- bytes and time -----------------------------------------------------------------------------

    def receive(self, data: bytes, now: float, *, end_of_message: bool = False) -> None:
        """Process bytes from the link.

        Args:
            data: The bytes.
            now: Seconds, monotonic.
            end_of_message: The link keeps message boundaries, and the bytes end a message: no frame continues.
        """
        self.decoder.receive(data, now)
        self._drain(now, end_of_message)

    def _drain(self, now: float, end_of_message: bool = False) -> None:
        decoder = self.decoder
        while True:
            event = decoder.next_event()
            if event.__class__ is Frame:
                self._receive_frame(event, now)
            elif event is not None:
                self._note(event)  # type: ignore[arg-type]  # a Frame is excluded above
            elif end_of_message and (bad := decoder.end_of_message()) is not None:
                self._note(bad)
            else:
                break

    def next_event(self) -> Event | None:
        """Return the next event, or None."""
        return self._events.pop()

    def next_timeout(self) -> float | None:
        """Time at which to call `handle_timeout`, or None."""
        first = None
        if self._pending:
            # Iterate over a copy: a signal handler may stop the arm at any line, which removes requests.
            for pending in tuple(self._pending.values()):
                if first is None or pending.deadline < first:
                    first = pending.deadline
        for part in self._timed_parts:
            when = part.next_timeout()
            if when is not None and (first is None or when < first):
                first = when
        return first

    def handle_timeout(self, now: float) -> None:
        """Handle every deadline that has passed: repeat requests, give up, resynchronise."""
        while (bad := self.decoder.handle_timeout(now)) is not None:
            self._note(bad)
            self._drain(now)
        for pending in [p for p in tuple(self._pending.values()) if p.deadline <= now]:
            if pending.sent < pending.attempts:
                self.counters.retries += 1
                self._transmit(pending, now)
            else:
                self._settle(pending)
                self.counters.timeouts += 1
                self._events.add(TimedOut(pending.ticket, pending.cmd, pending.sent, pending.instead))
        self._chapter.handle_timeout(now)
        self.several.handle_timeout(now)
        for body in self._fragments_in.handle_timeout(now):
            self._send_frame(_FRAGMENT_MISSING, body, now)
        self._fragments_out.handle_timeout(now)

    @property
    def _timed_parts(self) -> tuple[_Timed, ...]:
        return self._chapter, self.several, self.decoder, self._fragments_in, self._fragments_out

    # -- host ---------------------------------------------------------------------------------------

    def request(
        self,
        cmd: int,
        body: bytes,
        now: float,
        *,
        window: float | None = None,
        attempts: int | None = None,
        urgent: bool = False,
    ) -> int:
        """Send a request. The answer is a `Reply` or `TimedOut` event with the ticket returned here.

        In dialect 1 the body is a servo packet; one request is outstanding at a time and the others queue. A sync
        write is never answered; its `Reply` event follows when it is sent.

        Args:
            cmd: Command code.
            body: Its body.
            now: Seconds, monotonic.
            window: Seconds to wait for each answer; the policy's if None.
            attempts: Number of times to send it; the policy's if None.
            urgent: Send it before everything in the queue.

        Raises:
            LocalProtocolError: The body cannot be sent in this dialect or over this link, or IDENTIFY was not
                answered yet on a link of datagrams.
        """
        if self.conversations is not None and cmd != _IDENTIFY and not self.in_conversation:
            raise LocalProtocolError(f"over datagrams IDENTIFY comes first: {command_name(cmd)} was not sent")
        ticket = self.take_ticket()
        attempts = attempts or self.policy.attempts
        if self.dialect == PROTO_CHAPTER:
            self._chapter.request(ticket, cmd, body, now, window, attempts, urgent)
            return ticket
        window = window or self.policy.window
        seq = self.take_number(cmd, body, now, now + attempts * window)
        pending = Pending(ticket, cmd, body, seq, window, attempts, urgent=urgent)
        self._transmit(pending, now)
        self._pending[seq] = pending
        return ticket

    def take_ticket(self) -> int:
        """Count a new request; returns its ticket."""
        self._ticket += 1
        self.counters.requests += 1
        return self._ticket

    def take_number(self, cmd: int, body: bytes, now: float, end: float) -> int:
        """Take the number of a new request; LocalProtocolError if all are in use.

        A board that a stop has reached takes a request for a repeat of an earlier one with this number, command and
        body, and refuses it. So one that is not simply asked again gets a number of its own for as long as that.

        Args:
            cmd: Command code.
            body: Its body.
            now: Seconds, monotonic.
            end: When the request is over at the latest.
        """
        seq, known, used = self.seq, hash(body), self._used
        acts = effect_of(self.dialect, cmd, body) not in (Effect.NONE, Effect.STOP)
        # A signal handler may make a request at any line.
        while (first := next(iter(used), None)) is not None and used.get(first, now) <= now:
            used.pop(first, None)
        free = None
        for _ in range(_NUMBERS):
            seq = (seq + 1) % _NUMBERS
            if seq in self._pending or seq in self.several:
                continue
            if free is None:
                free = seq
            if not acts or (seq, cmd, known) not in used:
                free = seq
                break
        if free is None:
            raise LocalProtocolError("256 requests are outstanding and unanswered; wait for replies first")
        self.seq = free
        if acts:
            used.pop(key := (free, cmd, known), None)
            used[key] = end + _FORGOTTEN
        return free

    @property
    def in_conversation(self) -> bool:
        """Whether commands may be sent: in dialect 2 over datagrams, only after a reply to IDENTIFY."""
        begun = self.conversations is None or self.conversations.current is not None
        return begun or self.dialect == PROTO_CHAPTER

    @property
    def request_type(self) -> int:
        """The field type of a request that came just now: over datagrams, the number of the conversation."""
        current = None if self.conversations is None else self.conversations.current
        return 0 if current is None else current.ours

    def holds(self, ticket: int) -> bool:
        """Whether a request still waits for its answer."""
        asked = any(pending.ticket == ticket for pending in tuple(self._pending.values()))
        return asked or self._chapter.holds(ticket) or self.several.holds(ticket)

    def abandon(self, ticket: int) -> bool:
        """Forget a request; a later answer is stale, and frames not written yet are withheld.

        Returns:
            Whether part of it may have been sent.
        """
        left = True
        for pending in list(self._pending.values()):
            if pending.ticket == ticket:
                left = self._withhold(pending.frames) or pending.sent > 1
                self._settle(pending)
        frames = self.several.abandon(ticket)
        if frames is not None:
            left = self._withhold(frames)
        return self._chapter.abandon(ticket) and left

    def void(self) -> None:
        """Forget every request but stops, before a stop is sent; nothing of them is sent or repeated."""
        keep = []
        for pending in list(self._pending.values()):
            if pending.urgent:
                keep += pending.frames
            else:
                self._settle(pending)
        keep += self._chapter.void() + self.several.void()
        self._out = [data for data in self._out if any(data is kept for kept in keep)]

    def stay_quiet(self, until: float) -> None:
        """Dialect 1: send nothing before this time, and treat frames that arrive until then as stale."""
        self._chapter.stay_quiet(until)

    # -- board --------------------------------------------------------------------------------------

    def reply(self, request: Request, status: int, body: bytes, now: float, *, voided: bool = False) -> None:
        """Answer a dialect-2 request; the reply is stored for repeats of the request.

        Over datagrams, a request of a past conversation is not answered.

        Args:
            request: The request.
            status: Status code.
            body: Body of the reply.
            now: Seconds, monotonic.
            voided: A stop cancelled the request: its repeat must not be executed either, even after many other
                replies.
        """
        frame = request.frame
        ext = EXT_REPLY | status & EXT_STATUS_MASK
        if self.conversations is not None:
            if frame.cmd == _IDENTIFY:
                offer = self.conversations.offered_to(frame)
                if offer is not None:
                    data = self.build(PROTO_HEXWIRE, frame.cmd, body, frame.seq, now, ext, frame.src, offer)
                    self._out.append(data)
                return
            if not self.conversations.is_current(frame):
                return
        first = len(self._out)
        if len(body) > self._max_body:
            self._send_message(frame.cmd, ext, body, frame.seq, now, frame.src)
        else:
            self._out.append(self.build(PROTO_HEXWIRE, frame.cmd, body, frame.seq, now, ext, dst=frame.src))
        self._replies.answered(frame, self._out[first:], now, voided=voided)

    def answer(self, frame: Frame, status: int, body: bytes, now: float) -> None:
        """Answer a dialect-2 frame without storing the answer: if the frame comes again, it is a new request."""
        self._replies.drop(frame)
        ext = EXT_REPLY | status & EXT_STATUS_MASK
        self._out.append(self.build(PROTO_HEXWIRE, frame.cmd, body, frame.seq, now, ext, dst=frame.src))

    def done(self, frame: Frame) -> None:
        """A request was answered in a way that is not stored: if it comes again, it is a new one."""
        self._replies.drop(frame)

    def answer_again(self, frame: Frame, now: float) -> None:
        """Send the stored reply to a request again if there is one; only src, seq and cmd are compared."""
        for data in self._replies.find_by_number(frame.src, frame.seq, frame.cmd, now):
            self._out.append(self.build_again(data, now))

    def send_fragment(self, cmd: int, body: bytes, dst: int, now: float) -> None:
        """Send a FRAGMENT or FRAGMENT_MISSING that this connection did not make itself."""
        self._send_frame(cmd, body, now, dst)

    def take_stop(self, now: float) -> None:
        """Apply a received stop: drop unfinished requests, and refuse repeats of requests executed before it."""
        self._fragments_in.forget()
        self._replies.void(self._refusal, now)

    def _refusal(self, request: Frame) -> bytes:
        """Make the reply to a repeat that a stop cancelled; `build_again` numbers and stamps it when it is sent."""
        ext = EXT_REPLY | Status.STOPPED
        return serialize_frame(
            Frame(0, 0, 0, self.local, request.src, self.type, PROTO_HEXWIRE, request.seq, request.cmd, b"", ext)
        )

    # -- sending ------------------------------------------------------------------------------------

    def _transmit(self, pending: Pending, now: float) -> None:
        pending.begin_attempt(now)
        if len(pending.body) > self._max_body:
            before = len(self._out)
            if pending.message_id is None:
                pending.message_id = self._send_message(pending.cmd, 0, pending.body, pending.seq, now)
            else:
                for chunk in self._fragments_out.remind(pending.message_id, pending.cmd, 0, pending.body, now):
                    self._send_frame(_FRAGMENT, chunk, now)
            pending.frames = self._out[before:]
            return
        data = self.build(PROTO_HEXWIRE, pending.cmd, pending.body, pending.seq, now)
        pending.frames = [data]
        self.put(data, urgent=pending.urgent)

    def _settle(self, pending: Pending) -> None:
        self._pending.pop(pending.seq, None)
        if pending.message_id is not None:
            self._fragments_out.forget(pending.message_id)

    # -- receiving ----------------------------------------------------------------------------------

    def _receive_frame(self, frame: Frame, now: float) -> None:
        if frame.proto != PROTO_CHAPTER and (self.duplex or self.role is _BOARD) and not self._is_ours(frame):
            self._stale(frame, "not for this module")
        elif self.conversations is not None and (problem := self._judge(frame, now, self.conversations)):
            self.counters.refused += 1
            self._stale(frame, problem)
        elif frame.proto != PROTO_CHAPTER:
            self._take_frame(frame, now)
        elif self.role is _BOARD:
            self._events.add(Request(frame))
        else:
            self._receive_chapter(frame, now)

    def _is_ours(self, frame: Frame) -> bool:
        """Whether a frame may be for this end: a request that names it, or what comes unasked or as an answer."""
        if not frame.cmd_ext:
            return self._is_meant(frame)
        return self._asks and not (self.role is _BOARD and frame.cmd == _IDENTIFY)

    def _is_meant(self, frame: Frame) -> bool:
        if frame.dst == self.local:
            return True
        to = address_of(frame.dst)
        return to is not None and to.names(self.local)

    def _judge(self, frame: Frame, now: float, conversations: Conversations) -> str:
        """Return why a datagram is refused; empty if it is accepted."""
        board = self.role is _BOARD
        if frame.proto == PROTO_CHAPTER:
            return "dialect 1 has no number that identifies an old datagram" if board else ""
        if frame.cmd != _IDENTIFY:
            begun = conversations.count
            problem = conversations.take(frame, now)
            if conversations.count != begun:
                # A restarted host counts from the beginning.
                self._replies = ReplyStore()
                self._fragments_in.forget()
            return problem
        if board:
            return "" if conversations.offer(frame, now) else "it arrived before"
        return "" if conversations.is_answer(frame) else "it does not answer our IDENTIFY"

    def _take_frame(self, frame: Frame, now: float) -> None:
        ext = frame.cmd_ext
        if self._asks and ext & EXT_REPLY:
            if self.several.take(frame, now):
                return
            pending = self._pending.get(frame.seq)
            if pending is None or pending.cmd != frame.cmd or (frame.src, frame.dst) != (self.remote, self.local):
                self._stale(frame, "answers no outstanding request")
                return
            if frame.cmd == _IDENTIFY and self.conversations is not None:
                self.conversations.begin(frame, now)
            self._settle(pending)
            self.counters.replies += 1
            self._events.add(
                Reply(
                    pending.ticket,
                    frame.cmd,
                    ext & EXT_STATUS_MASK,
                    frame.body,
                    frame,
                    now - pending.sent_at,
                    pending.sent,
                )
            )
        elif (
            (frame.cmd == _FRAGMENT or frame.cmd == _FRAGMENT_MISSING)
            and self.assembles
            and (frame.dst == self.local or self.role is _HOST)
        ):
            self._receive_fragment(frame, now)
        elif self._asks and ext & EXT_UNSOLICITED:
            self._receive_report(frame)
        elif self._asks and not self.duplex:
            self._stale(frame, "a request to a host")
        else:
            self._receive_request(frame, now)

    def _receive_chapter(self, frame: Frame, now: float) -> None:
        if self._chapter.receive(frame, now):
            return
        identify = next((p for p in tuple(self._pending.values()) if p.cmd == _IDENTIFY), None)
        if identify is None or frame.body != UNKNOWN_COMMAND_PACKET:
            self._stale(frame, "dialect 1, answers no outstanding request")
            return
        self._settle(identify)
        rtt = now - identify.sent_at
        self._events.add(
            Reply(identify.ticket, identify.cmd, Status.UNKNOWN_COMMAND, b"", frame, rtt, identify.sent)
        )

    def _receive_request(self, frame: Frame, now: float) -> None:
        if self.conversations is not None:
            if frame.cmd == _IDENTIFY:
                self._events.add(Request(frame))
                return
        elif frame.cmd == _IDENTIFY:
            # A restarted host counts from the beginning.
            self._replies.forget(frame.src)
            self._fragments_in.forget()
        reply = self._replies.find(frame, now)
        if reply and frame.cmd == Command.HOST_BAUD:
            # The rate may have gone back since: it is executed again.
            reply = None
        if reply is not None:
            self.counters.repeats += 1
            self._out.extend(self.build_again(data, now) for data in reply)
            return
        if self.conversations is not None and self.conversations.is_repeat(frame):
            self.counters.refused += 1
            self._stale(frame, "it was executed before, and its reply is no longer stored")
            return
        if frame.dst != self.local and frame.cmd not in _FOR_SEVERAL:
            self.counters.not_for_several += 1
            self.answer(frame, Status.NOT_SUPPORTED, b"", now)
            return
        if frame.cmd != _FRAGMENT and frame.cmd != _FRAGMENT_MISSING:
            self._replies.asked(frame, now)
        self._events.add(Request(frame))

    def _receive_report(self, frame: Frame) -> None:
        self.counters.reports += 1
        self._events.add_report(Report(frame))

    def _receive_fragment(self, frame: Frame, now: float) -> None:
        if self.role is _HOST and frame.src != self.remote:
            self._stale(frame, "from another module")
            return
        try:
            if frame.cmd == _FRAGMENT_MISSING:
                self._receive_missing(frame, now)
                return
            head = FragmentHead.parse(frame.body)
            done = self._fragments_in.is_done(head.message_id, now)
            message, asks = self._fragments_in.receive(frame.body, now)
        except RemoteProtocolError as error:
            self._events.add(BadFrame(str(error), frame.body[:64]))
            return
        for body in asks:
            self._send_frame(_FRAGMENT_MISSING, body, now, frame.src)
        seq = head.message_id & 0xFF
        if message is not None:
            self._receive_message(frame, message, now)
        elif done and head.number == 0:
            # The host requests the reply to a fragmented request again.
            reply = self._replies.find_by_number(frame.src, seq, head.cmd, now)
            self.counters.repeats += bool(reply)
            self._out.extend(self.build_again(data, now) for data in reply)
        pending = self._pending.get(seq)
        if pending is not None and pending.cmd == head.cmd and head.cmd_ext & EXT_REPLY:
            pending.extend(now)

    def _receive_missing(self, frame: Frame, now: float) -> None:
        message_id = parse_missing(frame.body)[0]
        for chunk in self._fragments_out.receive_missing(frame.body, now):
            self._send_frame(_FRAGMENT, chunk, now, frame.src)
        pending = self._pending.get(message_id & 0xFF)
        if pending is not None and pending.message_id == message_id:
            # The peer is receiving our message: the window of its answer starts when the message is complete.
            pending.extend(now)

    def _receive_message(self, frame: Frame, message: Message, now: float) -> None:
        if message.cmd in (_FRAGMENT, _FRAGMENT_MISSING, _IDENTIFY):
            self._stale(frame, "a command that must not be fragmented")
            return
        whole = frame._replace(
            cmd=message.cmd, cmd_ext=message.cmd_ext, body=message.body, seq=message.message_id & 0xFF
        )
        self._take_frame(whole, now)

    def _stale(self, frame: Frame, reason: str) -> None:
        self.counters.stale += 1
        for pending in tuple(self._pending.values()):
            pending.instead = str(frame)
        self._chapter.note(str(frame))
        self._events.add(Stale(frame, reason))

    def _note(self, event: BadFrame | Garbage) -> None:
        for pending in tuple(self._pending.values()):
            pending.instead = str(event)
        self._chapter.note(str(event))
        self._events.add(event)
