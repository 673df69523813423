"""The machine of a servo bus: what may be outstanding, what counts as an answer, and how long answers take.

Owns one request and its answers, and everything that is remembered between requests: doubts, packets sent lately,
silent servos, the learned answer time, counters. It does no I/O and reads no clock. A **conversation** is a
generator: it yields `Send` or `Listen` and is resumed with `Heard`, the bytes that came and the time. `questions`
builds longer conversations from the ones here; `line` runs them on a link. Must not know registers by name.

A **doubt** is an answer that may still come although nobody waits for it any longer; `doubts` has the rule.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

from hexwire.session.servo_answers import AnswerCollector, Outlook
from hexwire.wire.registers import Register, Series
from hexwire.wire.servo_packet import BROADCAST_ID

from .counters import BusCounters
from .doubts import Doubts, SentLately
from .plan import ReadPlan, SyncReadPlan, WritePlan
from .plan_cache import PlanCache
from .servos import KnownServos
from .timing import LineTiming

__all__ = ["ADAPTER_TIME", "BusMachine", "Conversation", "Heard", "Interrupted", "Listen", "Send"]

ADAPTER_TIME = 0.02
"""Seconds after which an adapter has passed on what it had: FTDI's timer of 16 ms, and a little more."""
MEASURED_EVERY = 16
_LEARNING = 64
"""So many transactions are timed at the beginning, and after that one in `MEASURED_EVERY`: it costs 1 us."""
_SILENT_REST = 0.5
"""Seconds for which a servo that answered nothing is not asked again by itself; in a sync read it always is."""
_MOST_HEARD = 4096
"""Bytes after which a line that never stops talking is not listened to any longer: no sync read has as many."""
_LOOKS = 4
"""So often such a line is looked at again once all answers are there."""
_MOST_DRAINED = 1 << 16
_IDLE = 0.1
"""Seconds without a transaction after which the host may have stood still, and the adapter may have bytes left."""
_TO_ALL = bytes((BROADCAST_ID,))


class Send(NamedTuple):
    """Send a packet and take the first bytes that come within `window` seconds."""

    packet: bytes
    window: float


class Listen(NamedTuple):
    """Take the next bytes that come before the clock reads `until`; a time in the past takes what is there."""

    until: float


class Heard(NamedTuple):
    """What came of a `Send` or `Listen`: the bytes, empty if none came, and the time, monotonic seconds."""

    data: bytes
    now: float


class Interrupted(Exception):  # noqa: N818 (an event, thrown into a conversation)
    """The wait for an answer ended with an error or Ctrl-C; the answer may come all the same.

    Attributes:
        now: When, monotonic seconds.
    """

    def __init__(self, now: float) -> None:
        super().__init__(now)
        self.now = now


_T = TypeVar("_T")
Conversation = Generator[Send | Listen, Heard, _T]
"""Steps on the line that end with a result. Closing one where it would send means that nothing was sent."""


class BusMachine:
    """State of one bus.

    Args:
        servos: What is known of the servos.
        baud: Bits a second on the wire; 0 for a line that costs no time.
        retries: How often a servo that did not answer is asked again.

    Attributes:
        now: Time of the newest event, monotonic seconds. Whoever begins a conversation sets it; then `Heard` does.
        servos: See above.
        retries: See above; may be changed at any time.
        timing: Windows and the adapter's measured overhead.
        plans: Requests built once.
        count: What happened on the careful path; `counters` adds the fast path.
        echo: Whether the adapter hears itself; None until it is known.
        doubts: Answers that may still come.
        doubtful: Servos with doubts; empty if there is none. Always the same object.
        sent: Packets whose echo may still come.
        silent: Servos that answered nothing, and until when they are not asked again by themselves.
        learning: Every transaction is to be timed.
        busy_until: When the line has carried what was sent and is not answered; 0.0 if that is over.
        turns: Transactions begun on the fast path.
        extra_answers: Answers taken there beyond one for each of them.
        asked_at: When the line was free for what the fast path sent last; None if that is not timed, or done.
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
        self.doubts = Doubts()
        self.doubtful = self.doubts.servos
        self.sent = SentLately()
        self.silent: dict[int, float] = {}
        self.learning = True
        self.busy_until = 0.0
        self.turns = 0
        self.extra_answers = 0
        self.asked_at: float | None = None
        self.asking: tuple[Sequence[int], int, bytes] | None = None
        self._fallen = 0
        self._looked_at = 0.0

    # --- what is known ----------------------------------------------------------------------------------------

    @property
    def counters(self) -> BusCounters:
        """What happened so far."""
        count = self.count
        return replace(
            count,
            requests=count.requests + self.turns,
            answers=count.answers + self.turns - self._fallen + self.extra_answers,
        )

    def restart(self, baud: int) -> None:
        """Begin anew on a line that was opened, perhaps at another rate: nothing is on the way."""
        if baud != self.timing.baud:
            self.timing = LineTiming(baud)
            self.learning = True
        self.doubts.clear()
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
            # Its echo, one byte of the header wrong, is a sound answer, and the fast path keeps no record.
            self.sent.prepare(entry[0].request)
        return entry

    def base(self, total: int, servo_ids: Collection[int]) -> float:
        """Seconds that a transaction of `total` bytes takes on the wire, return delays included."""
        return self.timing.line_time(total) + self.servos.return_delays(servo_ids)

    def backlog(self, now: float) -> float:
        """Seconds until the line has carried what was sent before."""
        if not self.busy_until:
            return 0.0
        left = self.busy_until - now
        if left <= 0.0:
            self.busy_until = left = 0.0
        return left

    def mark_silent(self, servo_id: int, now: float) -> None:
        """A servo answered nothing: leave it alone for a while."""
        self.silent[servo_id] = now + _SILENT_REST

    # --- events of the fast path ------------------------------------------------------------------------------

    def posted(self, packet: bytes, now: float) -> None:
        """A packet goes out that nobody answers. The line is busy with it, and what is asked next waits."""
        if packet[2:3] != _TO_ALL:
            self.sent.add(packet, now)
        busy = self.busy_until
        self.busy_until = (busy if busy > now else now) + len(packet) * self.timing.byte_time

    def learn_time(self, plan: ReadPlan | SyncReadPlan | WritePlan, now: float) -> None:
        """Learn how long the transaction begun at `asked_at` took, if it is timed.

        Its answers were sound: an echo would teach a wrong time.
        """
        if self.asked_at is None:
            return
        # The line may have carried what was sent before sooner than its rate says.
        elapsed, self.asked_at = max(0.0, now - self.asked_at), None
        self.timing.measured(elapsed, plan.total)
        self.learning = self.timing.answers < _LEARNING

    def gave_up(self, servo_ids: Sequence[int], params: int, request: bytes, asked: float, now: float) -> None:
        """Nobody waits any longer for the answers to a request; they may come all the same.

        Args:
            servo_ids: Whose answers.
            params: Parameter bytes of each.
            request: What was asked.
            asked: When, monotonic seconds.
            now: The time.
        """
        for servo_id in servo_ids:
            self.doubts.add(servo_id, params, request, asked, now)

    def interrupted(self, now: float) -> None:
        """An error or Ctrl-C ended a conversation, perhaps at the moment at which it recorded an outcome."""
        if self.asking is not None:
            self.gave_up(*self.asking, now, now)
            self.asking = None

    # --- conversations ----------------------------------------------------------------------------------------

    def doubted(self, servo_id: int, params: int, request: bytes = b"") -> Conversation[bool]:
        """Whether an answer of that length may be a late one, to another request than this.

        Where a doubt has ended by itself, the line is emptied first.
        """
        if not self.doubtful:
            return False
        doubts, now = self.doubts, self.now
        held = doubts.holds(servo_id, params, now, request)
        idle, self._looked_at = now - self._looked_at, now
        if doubts.ended:
            doubts.ended = False
            yield from self.drain(ADAPTER_TIME if idle > _IDLE else 0.0)
        return held

    def any_doubted(self, servo_ids: Sequence[int], params: int) -> Conversation[bool]:
        """Whether a late answer of that length may come from any of them."""
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
        """Gather the answers to one request.

        Args:
            request: What is asked.
            servo_ids: Who answers, in order.
            params: Parameter bytes of each answer.
            base: Seconds the answers take without the adapter.
            data: What has arrived already, if the request is sent; None sends it.
            header: First two bytes of the answers; None takes either kind.
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
        # Ctrl-C may come between any two steps: what may have been sent counts as sent.
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
            # Whatever ended the wait, be it Ctrl-C, an answer that is not here may come later.
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
        """Take what has come meanwhile, or comes during a pause, off the line: nobody waits for it any more."""
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
            # Counted from what came last: it shows that the line is alive, and a machine that stalled in between
            # has not lost the rest by it.
            if outlook is Outlook.DONE:
                if not looks:
                    break
                # What is there already may show that the last answer lacks bytes.
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
        """Count what came, and learn from it about echo and doubts."""
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
                self.doubts.answered(servo_id, params, now)
            self._notice(collector, now)

    def _notice(self, collector: AnswerCollector, now: float) -> None:
        """Learn from answers that came too late how long answers take."""
        for status in collector.strays:
            params = len(status.params)
            asked = self.doubts.late(status.servo_id, params)
            if asked is not None:
                self.timing.late(now - asked, 14 + params)
