"""The machine of a servo bus: outstanding requests, rules for answers, and measured answer times.

Owns one request and its answers, and the state between requests: late replies, recently sent packets, which an
adapter may echo late, twice or damaged, silent servos, the measured answer time, counters. It does no I/O and reads
no clock; time comes in as `now`. A **conversation** is a generator: it yields `Send` or `Listen` and is resumed
with `Heard`, the received bytes and the time. `questions` builds longer conversations from those here; `line` runs
them on a link. Must not know registers by name.

A **late reply** is an answer to an abandoned request that may still arrive. An answer identifies only its servo and
its length. So while a late answer of some length may still arrive from a servo, no answer of that length from that
servo is trusted: registers are read with their neighbours, in a length that is free. A request without an answer is
forgotten `LATEST` after it was given up, or `AFTERMATH` after the servo has answered a later one, since a servo
answers requests in order.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple, TypeVar

from hexwire.session.servo_answers import AnswerCollector, Outlook
from hexwire.wire.registers import Register, Series
from hexwire.wire.servo_packet import BROADCAST_ID

from .plan import PlanCache, ReadPlan, SyncReadPlan, WritePlan
from .servos import KnownServos
from .timing import LineTiming

__all__ = [
    "ADAPTER_TIME",
    "AFTERMATH",
    "LATEST",
    "BusCounters",
    "BusMachine",
    "Conversation",
    "Heard",
    "Interrupted",
    "LateReplies",
    "Listen",
    "Send",
    "SentLately",
]

LATEST = 1.0
"""Seconds after which no late answer can arrive: no adapter delays bytes that long."""
AFTERMATH = 0.25
"""Seconds left after the servo has answered a later request. A line that keeps the order of bytes needs none."""
_MOST_SENT = 256
_LAST_SENT = 64


@dataclass(slots=True)
class _LateReply:
    asked: float
    until: float
    request: bytes


class LateReplies:
    """Late answers that may still arrive, by servo and by number of parameter bytes.

    Attributes:
        servos: Servos of which one may arrive; empty if there are none. Always the same object, so that checking it
            needs no call.
        ended: The time of one is over since this was last reset. It may have arrived unread: drain the line.
    """

    def __init__(self) -> None:
        self.ended = False
        self.servos: dict[int, dict[int, _LateReply]] = {}

    def add(self, servo_id: int, params: int, request: bytes, asked: float, now: float) -> None:
        """Record a request that was given up.

        Args:
            servo_id: The servo.
            params: Parameter bytes of the answer.
            request: The request.
            asked: Time of the request.
            now: Present time.
        """
        lengths = self.servos.setdefault(servo_id, {})
        before = lengths.get(params)
        if before is not None and before.request != request:
            request = b""
        lengths[params] = _LateReply(asked, now + LATEST, request)

    def holds(self, servo_id: int, params: int, now: float, request: bytes = b"") -> bool:
        """Whether an answer of that length may belong to an earlier request, and to another than `request`."""
        self._expire(servo_id, now)
        reply = self.servos.get(servo_id, {}).get(params)
        return reply is not None and (not request or reply.request != request)

    def answered(self, servo_id: int, params: int, now: float) -> None:
        """Record an answer of this length to a request after those that were given up."""
        for length, reply in self.servos.get(servo_id, {}).items():
            # An answer of the same length may be that of the earlier request; the later one's may still arrive.
            if length != params:
                reply.until = min(reply.until, now + AFTERMATH)

    def late(self, servo_id: int, params: int) -> float | None:
        """Return the time of the request that a late answer belongs to; None without one."""
        reply = self.servos.get(servo_id, {}).get(params)
        return None if reply is None else reply.asked

    def settled(self, servo_id: int, params: int) -> None:
        """Expect no late reply of a length any more: the servo has answered another request since."""
        lengths = self.servos.get(servo_id, {})
        lengths.pop(params, None)
        if not lengths:
            self.servos.pop(servo_id, None)

    def clear(self) -> None:
        """Expect no late reply any more."""
        self.servos.clear()

    def _expire(self, servo_id: int, now: float) -> None:
        lengths = self.servos.get(servo_id)
        if lengths is None:
            return
        for params in [n for n, reply in lengths.items() if reply.until <= now]:
            del lengths[params]
            self.ended = True
        if not lengths:
            del self.servos[servo_id]


class SentLately:
    """Packets whose echo may still arrive. Most reads are not kept: `servo_answers` recognises their echo.

    The last few are kept however old they are: a host that stalled receives their echoes late.
    """

    def __init__(self) -> None:
        self._when: dict[bytes, float] = {}
        self._prepared: set[bytes] = set()

    def prepare(self, packet: bytes) -> None:
        """Register a packet that may be sent at any time from now on without a call of `add`."""
        self._prepared.add(packet)

    def add(self, packet: bytes, now: float) -> None:
        """Record a packet that is sent now."""
        when = self._when
        when.pop(packet, None)
        when[packet] = now
        if len(when) > _MOST_SENT:
            self._when = self._recent(now)

    def packets(self, now: float) -> set[bytes]:
        """Return the packets of the last `LATEST` seconds, the last few, and the prepared ones."""
        lately = self._when if len(self._when) <= _LAST_SENT else self._recent(now)
        return self._prepared.union(lately)

    def _recent(self, now: float) -> dict[bytes, float]:
        old = len(self._when) - _LAST_SENT
        rows = enumerate(self._when.items())
        return {sent: at for place, (sent, at) in rows if place >= old or at > now - LATEST}


ADAPTER_TIME = 0.02
"""Seconds after which an adapter has forwarded its bytes: FTDI's timer of 16 ms, and a margin."""
MEASURED_EVERY = 16
_LEARNING = 64
"""Transactions timed at the start; after that one in `MEASURED_EVERY` is timed, since timing costs 1 us."""
_SILENT_REST = 0.5
"""Seconds without single repeats to a servo that did not answer; sync reads always include it."""
_MOST_HEARD = 4096
"""Bytes after which reading from a line with endless data ends: no sync read has as many."""
_LOOKS = 4
"""Number of further reads from such a line after all answers have arrived."""
_MOST_DRAINED = 1 << 16
_IDLE = 0.1
"""Seconds without a transaction after which the host may have stalled, and the adapter may hold bytes."""
_TO_ALL = bytes((BROADCAST_ID,))
_T = TypeVar("_T")


@dataclass(slots=True)
class BusCounters:
    """Counters of a bus since it was opened.

    Attributes:
        requests: Packets sent that expect an answer.
        answers: Status packets accepted.
        repeats: Requests repeated, to the servos without an answer only.
        lost: Answers that were late or damaged.
        given_up: Requests without an answer after all repeats.
        careful: Transactions that took the careful path.
        echoes: Echoes of requests.
        settled: Answers to another form of a request, used where a late answer could be taken for the new one.
        stray_bytes: Bytes that belonged to no answer.
    """

    requests: int = 0
    answers: int = 0
    repeats: int = 0
    lost: int = 0
    given_up: int = 0
    careful: int = 0
    echoes: int = 0
    settled: int = 0
    stray_bytes: int = 0

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        return asdict(self)


class Send(NamedTuple):
    """Send a packet and receive the first bytes that arrive within `window` seconds."""

    packet: bytes
    window: float


class Listen(NamedTuple):
    """Receive the next bytes that arrive before the time `until`; a past time takes the bytes already received."""

    until: float


class Heard(NamedTuple):
    """The result of a `Send` or `Listen`: the bytes, empty if none arrived, and the time, monotonic seconds."""

    data: bytes
    now: float


class Interrupted(Exception):  # noqa: N818 (an event, thrown into a conversation)
    """The wait for an answer ended with an error or Ctrl-C; the answer may still arrive.

    Attributes:
        now: Present time, monotonic seconds.
    """

    def __init__(self, now: float) -> None:
        super().__init__(now)
        self.now = now


Conversation = Generator[Send | Listen, Heard, _T]
"""Steps on the line that end with a result. To close one at a `Send` means that the packet was not sent."""


class BusMachine:
    """State of one bus.

    Args:
        servos: Known facts of the servos.
        baud: Bits per second on the wire; 0 for a line without transmission time.
        retries: Number of times to repeat a request to a servo that did not answer.

    Attributes:
        now: Time of the newest event, monotonic seconds. Set by the caller of a conversation, then by `Heard`.
        servos: See above.
        retries: See above; may be changed at any time.
        timing: Windows and the adapter's measured overhead.
        plans: Prepared requests.
        count: Counters of the careful path; `counters` adds the fast path.
        echo: Whether the adapter echoes what is sent; None until it is known.
        late_replies: Those that may still arrive.
        doubtful: Servos of which a late reply may arrive; empty if there are none. Always the same object.
        sent: Packets whose echo may still arrive.
        silent: Servos that did not answer, with the time until which single requests to them are not repeated.
        learning: Whether to time every transaction.
        time_next: Whether to time the next one.
        busy_until: Time at which the line has transmitted packets without an answer; 0.0 if that has passed.
        turns: Transactions begun on the fast path.
        extra_answers: Answers received there beyond one per transaction.
        asked_at: Time at which the line was free for the last request of the fast path; None if it is not timed,
            or was measured.
        asking: Servos, parameter bytes and packet of the careful request whose outcome is not recorded yet.
    """

    def __init__(self, servos: KnownServos, baud: int, retries: int) -> None:
        self.now = 0.0
        self.servos = servos
        self.retries = retries
        self.timing = LineTiming(baud)
        self.plans = PlanCache(servos, self.timing)
        self.count = BusCounters()
        self.echo: bool | None = None
        self.late_replies = LateReplies()
        self.doubtful = self.late_replies.servos
        self.sent = SentLately()
        self.silent: dict[int, float] = {}
        self.learning = True
        self.time_next = True
        self.busy_until = 0.0
        self.turns = 0
        self.extra_answers = 0
        self.asked_at: float | None = None
        self.asking: tuple[Sequence[int], int, bytes] | None = None
        self._fallen = 0
        self._looked_at = 0.0

    # --- state ------------------------------------------------------------------------------------------------

    @property
    def counters(self) -> BusCounters:
        """The counters so far."""
        count = self.count
        return replace(
            count,
            requests=count.requests + self.turns,
            answers=count.answers + self.turns - self._fallen + self.extra_answers,
        )

    def restart(self, baud: int) -> None:
        """Reset for a newly opened line, perhaps at another rate: no answers are outstanding."""
        if baud != self.timing.baud:
            self.timing = LineTiming(baud)
            self.learning = True
        self.late_replies.clear()
        self.silent.clear()
        self.forget_plans()

    def forget_plans(self) -> None:
        """Drop the plans: the rate, a series or a return delay has changed."""
        self.plans.clear(self.timing)

    def plan_read(self, servo_id: int, name: str) -> tuple[ReadPlan, Register]:
        """Make the plan of a single read.

        Raises:
            UsageError: The servo's series has no such register.
        """
        entry = self.plans.read(servo_id, name)
        if entry[0].series is Series.SEVEN_BOT:
            # Its echo with one wrong header byte is a valid answer, and the fast path does not record requests.
            self.sent.prepare(entry[0].request)
        return entry

    def base(self, total: int, servo_ids: Collection[int]) -> float:
        """Return the seconds that a transaction of `total` bytes takes on the wire, with return delays."""
        return self.timing.line_time(total) + self.servos.return_delays(servo_ids)

    def backlog(self, now: float) -> float:
        """Return the seconds until the line has transmitted earlier packets."""
        if not self.busy_until:
            return 0.0
        left = self.busy_until - now
        if left <= 0.0:
            self.busy_until = left = 0.0
        return left

    def mark_silent(self, servo_id: int, now: float) -> None:
        """Record a servo that did not answer, so that single requests to it are not repeated for a while."""
        self.silent[servo_id] = now + _SILENT_REST

    # --- events of the fast path ------------------------------------------------------------------------------

    def posted(self, packet: bytes, now: float) -> None:
        """Record a packet without an answer; the line is busy with it, and the next request waits."""
        if packet[2:3] != _TO_ALL:
            self.sent.add(packet, now)
        busy = self.busy_until
        self.busy_until = (busy if busy > now else now) + len(packet) * self.timing.byte_time

    def learn_time(self, plan: ReadPlan | SyncReadPlan | WritePlan, now: float) -> None:
        """Measure the transaction begun at `asked_at`, if it is timed.

        Call it only for valid answers: an echo would give a wrong time.
        """
        if self.asked_at is None:
            return
        # The line may have transmitted earlier packets faster than its rate implies.
        elapsed, self.asked_at = max(0.0, now - self.asked_at), None
        self.timing.measured(elapsed, plan.total)
        self.learning = self.time_next = self.timing.answers < _LEARNING

    def gave_up(self, servo_ids: Sequence[int], params: int, request: bytes, asked: float, now: float) -> None:
        """Record a request that was given up, whose answers may still arrive.

        Args:
            servo_ids: Servos without an answer.
            params: Parameter bytes of each answer.
            request: The request.
            asked: Time of the request, monotonic seconds.
            now: Present time.
        """
        for servo_id in servo_ids:
            self.late_replies.add(servo_id, params, request, asked, now)

    def interrupted(self, now: float) -> None:
        """Record that an error or Ctrl-C ended a conversation, perhaps while it recorded an outcome."""
        if self.asking is not None:
            self.gave_up(*self.asking, now, now)
            self.asking = None

    # --- conversations ----------------------------------------------------------------------------------------

    def doubted(self, servo_id: int, params: int, request: bytes = b"") -> Conversation[bool]:
        """Whether an answer of that length may be a late one, to another request.

        If the time of a late reply is over, drains the line first.
        """
        if not self.doubtful:
            return False
        late, now = self.late_replies, self.now
        held = late.holds(servo_id, params, now, request)
        idle, self._looked_at = now - self._looked_at, now
        if late.ended:
            late.ended = False
            yield from self.drain(ADAPTER_TIME if idle > _IDLE else 0.0)
        return held

    def any_doubted(self, servo_ids: Sequence[int], params: int) -> Conversation[bool]:
        """Whether a late answer of that length may arrive from any of these servos."""
        for servo_id in servo_ids:
            if (yield from self.doubted(servo_id, params)):
                return True
        return False

    def collect(
        self,
        request: bytes,
        servo_ids: Sequence[int],
        params: int,
        base: float,
        data: bytes | None = None,
        *,
        header: bytes | None,
    ) -> Conversation[AnswerCollector]:
        """Collect the answers to one request.

        Args:
            request: The request.
            servo_ids: Ids of the servos that answer, in order.
            params: Parameter bytes of each answer.
            base: Seconds that the answers take without the adapter.
            data: Bytes received so far, if the request was sent; None sends it.
            header: First two bytes of the answers; None accepts either kind.
        """
        count = self.count
        window = base + self.timing.allowance + self.backlog(self.now)
        asked_at, self.asked_at = self.asked_at, None
        if data is not None:
            self._fallen += 1
        else:
            count.requests += 1
            if self.doubtful:
                yield from self.drain()
            asked_at = self.now
            self.sent.add(request, asked_at)
        collector = AnswerCollector(
            request,
            servo_ids,
            params,
            header=header,
            sent=self.sent.packets(self.now),
            echo=self.echo is not False,
        )
        count.careful += 1
        # Ctrl-C may come between any two steps: a request that may have been sent counts as sent.
        sent, self.asking = True, (servo_ids, params, request)
        try:
            if data is None:
                try:
                    data = yield from self._hear(Send(request, window))
                except GeneratorExit:
                    sent = False
                    raise
            yield from self._gather(collector, data, base)
        finally:
            # Whatever ended the wait, even Ctrl-C, a missing answer may arrive later.
            now = self.now
            if sent:
                count.lost += len(collector.missing)
                self.gave_up(collector.missing, params, request, now if asked_at is None else asked_at, now)
            self.asking = None
        self._take(collector, now)
        if asked_at is not None and len(collector.answers) == len(servo_ids) > 0:
            self.timing.measured(now - asked_at, len(request) + len(servo_ids) * (6 + params))
        return collector

    def drain(self, pause: float = 0.0) -> Conversation[None]:
        """Read and discard bytes that have arrived, or arrive during a pause."""
        data = b""
        end = self.now + pause
        while more := (yield from self._hear(Listen(end))):
            data += more
            if len(data) > _MOST_DRAINED:
                break
        if data:
            self.count.stray_bytes += len(data)
            late = AnswerCollector(b"", (), 0)
            late.receive(data)
            self._notice(late, self.now)

    def _hear(self, step: Send | Listen) -> Conversation[bytes]:
        try:
            data, self.now = yield step
        except Interrupted as interrupted:
            self.now = interrupted.now
            raise
        return data

    def _gather(self, collector: AnswerCollector, data: bytes, base: float) -> Conversation[None]:
        outlook = collector.receive(data)
        share = base / max(1, len(collector.servo_ids))
        lingered, looks = False, _LOOKS
        while data and collector.size < _MOST_HEARD:
            # The wait starts at the last bytes: they show that the line is alive, and a stall of the computer does
            # not lose the rest.
            if outlook is Outlook.DONE:
                if not looks:
                    break
                # Bytes already received may show that the last answer is incomplete.
                wait, looks = 0.0, looks - 1
            elif outlook is Outlook.WAIT:
                wait = share * collector.due + self.timing.allowance
            elif lingered:
                break
            else:
                wait, lingered = self.timing.linger(6 + collector.params), True
            data = yield from self._hear(Listen(self.now + wait))
            outlook = collector.receive(data)

    def _take(self, collector: AnswerCollector, now: float) -> None:
        """Count the received bytes, and update the echo and the late replies."""
        count, params = self.count, collector.params
        if collector.echoed:
            count.echoes += 1
            self.echo = True
        elif collector.answers:
            self.echo = False
        answered = len(collector.answers)
        count.answers += answered
        sound = answered * (6 + params) + (len(collector.request) if collector.echoed else 0)
        count.stray_bytes += max(0, collector.size - sound)
        if self.doubtful:
            for servo_id in collector.answers:
                self.late_replies.answered(servo_id, params, now)
            self._notice(collector, now)

    def _notice(self, collector: AnswerCollector, now: float) -> None:
        """Measure answer times from late answers."""
        for status in collector.strays:
            params = len(status.params)
            asked = self.late_replies.late(status.servo_id, params)
            if asked is not None:
                self.timing.late(now - asked, 14 + params)
