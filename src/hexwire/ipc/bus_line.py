"""One servo bus on one link: requests out, answers in, and no answer ever taken for another's.

Owns the careful half of a bus: echo, deadlines, repeats, and which servos may still have an answer on the way.
`servo_bus` puts registers and the fast path on top. Must not know registers by name, nor arms.

**Doubt.** A request that was not answered in time may be answered late. Id and length of that answer may fit the
next question, and the value would be of the wrong register or of an older time. So every unanswered request leaves
a doubt: the lengths of answers that may still come from that servo. Before such a length is asked of it again, the
line is settled by a request whose answer has another length: bytes keep their order on a link, so once that answer
is there the late one is too. A doubt ends by itself a second after the last unanswered request.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.errors import PreemptedError, UsageError
from hexwire.session.servo_answers import AnswerCollector, Outlook
from hexwire.session.servo_timing import RETURN_DELAY, LineTiming
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_ping, make_read

from .epochs import Epochs

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.ipc.link import Link
    from hexwire.session.servo_plan import ReadPlan, SyncReadPlan, WritePlan
    from hexwire.wire.servo_packet import StatusPacket

__all__ = ["BusCounters", "BusLine"]

_WRITE_TIME = 1.0
"""Seconds after which a line that takes no bytes is given up."""
_DOUBT_TIME = 1.0
"""Seconds after which no answer is on the way any more: no adapter holds bytes back that long."""
_MUTE_REST = 0.5
"""Seconds for which a servo that answered nothing is not asked again by itself; in a sync read it always is."""
_LEARNING = 64
"""So many transactions are timed at the beginning, and after that one in `MEASURED_EVERY`: it costs 1 us."""
MEASURED_EVERY = 16
_ID_REGISTER = Series.STS_SMS.register("id").address


@dataclass(slots=True)
class BusCounters:
    """What happened on a bus since it was opened.

    Attributes:
        requests: Packets sent that want an answer.
        answers: Status packets taken.
        repeats: Requests sent again, for those servos only that had not answered.
        lost: Answers that did not come in time, or came damaged.
        given_up: Questions without an answer after all repeats.
        careful: Transactions that the fast path did not recognise at a glance.
        echoes: Requests that came back.
        settled: Doubts about late answers that were settled by another request.
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
        """By name."""
        return asdict(self)


@dataclass(slots=True)
class _Doubt:
    lengths: set[int]
    since: float


class BusLine:
    """Transactions on one link; `ServoBus` is what programs use.

    Args:
        link: The line; opened and closed with this object.
        baud: Bits a second on the wire; None takes the link's own rate, 0 if it has none.
        retries: How often a servo that did not answer is asked again.

    Attributes:
        link: The line.
        timing: Windows and the adapter's measured overhead.
        epochs: The stops of the arm behind it, and what they void; a driver has its own here.
        echo: Whether the adapter hears itself; None until it is known. Learned by itself.
        retries: See above; may be changed at any time.
    """

    def __init__(self, link: Link, *, baud: int | None = None, retries: int = 2) -> None:
        if retries < 0:
            raise UsageError(f"{retries} retries make no sense")
        self.link = link
        self.retries = retries
        self.epochs = Epochs()
        self.echo: bool | None = None
        self._count = BusCounters()
        self.timing = LineTiming(getattr(link, "baud", 0) if baud is None else baud)
        self._own_baud = baud
        self._clock: Callable[[], float] = getattr(link, "clock", monotonic)
        self._exchange = link.exchange
        self._lock = threading.RLock()
        self._return_delays: dict[int, float] = {}
        self._doubts: dict[int, _Doubt] = {}
        self._mute: dict[int, float] = {}
        # The fast path counts its transactions and nothing else; `counters` makes the rest of it.
        self._turns = 0
        self._fallen = 0
        self._extra_answers = 0
        self._learning = True
        self._busy_until = 0.0

    @property
    def counters(self) -> BusCounters:
        """What happened so far."""
        quick = self._turns - self._fallen
        count = self._count
        return replace(
            count,
            requests=count.requests + self._turns,
            answers=count.answers + quick + self._extra_answers,
        )

    def now(self) -> float:
        """The link's clock: monotonic seconds."""
        return self._clock()

    # --- what a plan needs ------------------------------------------------------------------------------------

    def _base(self, total: int, servo_ids: Sequence[int]) -> float:
        """Seconds a transaction takes on the wire, return delays included."""
        delays = sum(self._return_delays.get(servo_id, RETURN_DELAY) for servo_id in servo_ids)
        return self.timing.line_time(total) + delays

    def _series_of(self, servo_id: int) -> Series:
        raise NotImplementedError

    def _post(self, packet: bytes) -> None:
        """Send what nobody answers. The line is busy with it, and what is asked next waits as long."""
        self._check_call()
        now = self._clock()
        self.link.write(packet, now + _WRITE_TIME)
        busy = self._busy_until
        self._busy_until = (busy if busy > now else now) + len(packet) * self.timing.byte_time
        token = self.epochs.of_this_call
        if token is not None and not self.epochs.holds(token):
            raise PreemptedError("a stop came as a servo packet was sent: it may have been done at that time")

    def _check_call(self) -> None:
        """Send nothing more of a call that was made before a stop."""
        token = self.epochs.of_this_call
        if token is not None:
            self.epochs.check(token, "a servo packet")

    def _backlog(self) -> float:
        """Seconds until the line has carried what was sent before."""
        if not self._busy_until:
            return 0.0
        left = self._busy_until - self._clock()
        if left <= 0.0:
            self._busy_until = left = 0.0
        return left

    def _measure(self, plan: ReadPlan | SyncReadPlan | WritePlan, elapsed: float) -> None:
        """Take in how long a transaction took."""
        self.timing.measured(elapsed, plan.total)
        plan.nap.measured(elapsed)
        self._learning = self.timing.answers < _LEARNING

    # --- the careful path -------------------------------------------------------------------------------------

    def _collect(
        self, request: bytes, servo_ids: Sequence[int], params: int, base: float, data: bytes | None = None
    ) -> AnswerCollector:
        """Gather the answers to one request.

        Args:
            request: What is asked.
            servo_ids: Who answers, in order.
            params: Parameter bytes of each answer.
            base: Seconds the answers take without the adapter.
            data: What has arrived already, if the request is sent; None sends it.
        """
        counters = self._count
        window = base + self.timing.allowance + self._backlog()
        collector = AnswerCollector(request, servo_ids, params)
        if data is None:
            counters.requests += 1
            self._check_call()
            data = self._exchange(request, window)
        else:
            self._fallen += 1
        counters.careful += 1
        outlook = collector.receive(data)
        share = base / max(1, len(servo_ids))
        lingered = False
        while outlook is not Outlook.DONE and data:
            # Counted from what came last: it shows that the line is alive, and a machine that stalled in between
            # has not lost the rest by it.
            if outlook is Outlook.WAIT:
                wait = share * collector.due + self.timing.allowance
            elif lingered:
                break
            else:
                wait, lingered = self.timing.linger(6 + params), True
            data = self.link.read(self._clock() + wait)
            outlook = collector.receive(data)
        if collector.echoed:
            counters.echoes += 1
            self.echo = True
        elif collector.answers:
            self.echo = False
        answered = len(collector.answers)
        counters.answers += answered
        sound = answered * (6 + params) + (len(request) if collector.echoed else 0)
        counters.stray_bytes += max(0, collector.size - sound)
        for servo_id in collector.missing:
            counters.lost += 1
            self._doubt(servo_id, params)
        return collector

    def _ask_one(
        self, servo_id: int, request: bytes, params: int, *, base: float, data: bytes | None = None
    ) -> tuple[StatusPacket | None, AnswerCollector]:
        """Ask one servo, again if need be. Only for what may be done twice."""
        if self._doubts and self._doubted(servo_id, params) and data is None and not self._settle(servo_id):
            collector = AnswerCollector(request, (servo_id,), params)
            self._count.given_up += 1
            return None, collector
        collector = self._collect(request, (servo_id,), params, base, data)
        for attempt in range(1 + self.retries):
            if attempt:
                self._count.repeats += 1
                collector = self._collect(request, (servo_id,), params, base)
            found = collector.answers.get(servo_id)
            if found is not None:
                self._mute.pop(servo_id, None)
                return found, collector
            if collector.only_echo:
                # An answer that equals its request cannot be told from an echo; asking again is no help.
                break
        else:
            self._mute[servo_id] = self._clock() + _MUTE_REST
        self._count.given_up += 1
        return None, collector

    def _ask_many(self, plan: SyncReadPlan, data: bytes | None) -> dict[int, StatusPacket]:
        """Answers to a sync read, asking again those only that did not answer.

        Args:
            plan: The sync read.
            data: What has arrived, if it is sent; None sends it.
        """
        params, found = plan.count, {}
        if data is None:
            for servo_id in plan.ids:
                if servo_id not in self._mute and self._doubted(servo_id, params):
                    self._settle(servo_id)
        # Whoever was silent goes first: the others' answers then end the wait.
        suspects = {servo_id for servo_id in plan.ids if self._doubted(servo_id, params)}
        asked = plan
        if data is None and self._mute:
            order = sorted(plan.ids, key=lambda servo_id: servo_id not in self._mute)
            asked = self._sync_plan(plan, tuple(order))
        collector = self._collect(asked.request, asked.ids, params, asked.base, data)
        for servo_id, status in collector.answers.items():
            if servo_id not in suspects:
                found[servo_id] = status
                self._mute.pop(servo_id, None)
            elif self._settle(servo_id):
                # It is back; but this answer may be one of its late ones.
                self._mute.pop(servo_id, None)
        now = self._clock()
        for _ in range(self.retries):
            missing = [i for i in plan.ids if i not in found and self._mute.get(i, 0.0) <= now]
            if not missing:
                break
            self._count.repeats += 1
            if len(missing) == 1:
                request = make_read(missing[0], plan.address, params)
                base = self._base(len(request) + 6 + params, missing)
                collector = self._collect(request, missing, params, base)
            else:
                again = self._sync_plan(plan, tuple(missing))
                collector = self._collect(again.request, again.ids, params, again.base)
            for servo_id, status in collector.answers.items():
                found[servo_id] = status
                self._mute.pop(servo_id, None)
        for servo_id in plan.ids:
            if servo_id not in found:
                self._count.given_up += 1
                if self._mute.get(servo_id, 0.0) <= now:
                    self._mute[servo_id] = now + _MUTE_REST
        return found

    def _sync_plan(self, plan: SyncReadPlan, servo_ids: tuple[int, ...]) -> SyncReadPlan:
        raise NotImplementedError

    # --- doubt ------------------------------------------------------------------------------------------------

    def _doubt(self, servo_id: int, params: int) -> None:
        doubt = self._doubts.get(servo_id)
        if doubt is None:
            self._doubts[servo_id] = _Doubt({params}, self._clock())
        else:
            doubt.lengths.add(params)
            doubt.since = self._clock()

    def _doubted(self, servo_id: int, params: int) -> bool:
        """Whether an answer of that length may be a late one."""
        doubt = self._doubts.get(servo_id)
        if doubt is None:
            return False
        if self._clock() - doubt.since > _DOUBT_TIME:
            del self._doubts[servo_id]
            return False
        return params in doubt.lengths

    def _suspect(self, servo_ids: Sequence[int], params: int) -> bool:
        """Whether a late answer of that length may come from any of them."""
        return any(servo_id in servo_ids and self._doubted(servo_id, params) for servo_id in tuple(self._doubts))

    def _settle(self, servo_id: int) -> bool:
        """Make sure that no late answer of a servo is on the way; False if it does not answer at all."""
        doubt = self._doubts[servo_id]
        # A legacy servo answers pings and 2-byte reads. Elsewhere a ping comes second, since its answer may
        # look like its echo; so may the answer to a 2-byte read, which is not used.
        legacy = self._series_of(servo_id) is Series.SEVEN_BOT
        for _ in range(1 + self.retries):
            # Another length each time, so that this answer also ends the doubt about the attempt before.
            usable = [n for n in ((0, 2) if legacy else (1, 0, 3, 4, 5)) if n not in doubt.lengths]
            if not usable:
                return False
            params = usable[0]
            request = make_read(servo_id, _ID_REGISTER, params) if params else make_ping(servo_id)
            collector = self._collect(
                request, (servo_id,), params, self._base(len(request) + 6 + params, (servo_id,))
            )
            if servo_id in collector.answers:
                self._count.settled += 1
                self._doubts.pop(servo_id, None)
                return True
        self._mute[servo_id] = self._clock() + _MUTE_REST
        return False
