"""One servo bus on one link: requests out, answers in, and no answer ever taken for another's.

Owns the careful half of a bus: deadlines, repeats, and asking in another way where an answer would be ambiguous.
`servo_bus` puts registers and the fast path on top. Must not know registers by name, nor arms.

What keeps a wrong value out is decided in `session`: `servo_answers` says what is an answer, `servo_doubts` which
answers of earlier requests may still come. Here follows what is done about it. A register is read with its
neighbours, in a length that nothing on the way has. What has one length only (a ping, an acknowledgement, a legacy
servo's two bytes) waits until another request to the same servo is answered: bytes keep their order on a link, so
what was late is there by then.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING

from hexwire.epochs import Epochs
from hexwire.errors import PreemptedError, UsageError
from hexwire.session.servo_answers import AnswerCollector, Outlook
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID, make_ping, make_read

from .blocks import BlockAnswers, places
from .counters import BusCounters
from .doubts import Doubts, SentLately
from .timing import RETURN_DELAY, LineTiming

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.link.base import Link
    from hexwire.wire.servo_packet import StatusPacket

    from .plan import ReadPlan, SyncReadPlan, WritePlan

__all__ = ["BusLine"]

_WRITE_TIME = 1.0
"""Seconds after which a line that takes no bytes is given up."""
_MUTE_REST = 0.5
"""Seconds for which a servo that answered nothing is not asked again by itself; in a sync read it always is."""
_LEARNING = 64
"""So many transactions are timed at the beginning, and after that one in `MEASURED_EVERY`: it costs 1 us."""
MEASURED_EVERY = 16
_MOST_HEARD = 4096
"""Bytes after which a line that never stops talking is not listened to any longer: no sync read has as many."""
_LOOKS = 4
"""So often such a line is looked at again once all answers are there."""
_MOST_DRAINED = 1 << 16
_ANY_REGISTER = Series.STS_SMS.register("present_temperature").address
"""What is read where only the answer matters: at the same place, one byte wide, in every series."""
_TO_ALL = bytes((BROADCAST_ID,))
_LEGACY_READ = 2
ADAPTER_TIME = 0.02
"""Seconds after which an adapter has passed on what it had: FTDI's timer of 16 ms, and a little more."""
_IDLE = 0.1
"""Seconds without a transaction after which the host may have stood still, and the adapter may have bytes left."""


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
        self._doubts = Doubts()
        self._doubtful = self._doubts.servos
        self._sent = SentLately()
        self._mute: dict[int, float] = {}
        # The fast path counts its transactions and nothing else; `counters` makes the rest of it.
        self._turns = 0
        self._fallen = 0
        self._extra_answers = 0
        self._learning = True
        self._busy_until = 0.0
        self._asked_at: float | None = None
        self._looked_at = 0.0
        self._ends = {series: max(r.address + r.size for r in series.registers.values()) for series in Series}

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
        if packet[2:3] != _TO_ALL:
            self._sent.add(packet, now)
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
        """Take in how long a transaction took whose answers were sound: an echo would teach the wrong time."""
        self.timing.measured(elapsed, plan.total)
        plan.nap.measured(elapsed)
        self._learning = self.timing.answers < _LEARNING

    # --- the careful path -------------------------------------------------------------------------------------

    def _collect(
        self,
        request: bytes,
        servo_ids: Sequence[int],
        params: int,
        base: float,
        data: bytes | None = None,
        *,
        header: bytes | None,
    ) -> AnswerCollector:
        """Gather the answers to one request.

        Args:
            request: What is asked.
            servo_ids: Who answers, in order.
            params: Parameter bytes of each answer.
            base: Seconds the answers take without the adapter.
            data: What has arrived already, if the request is sent; None sends it.
            header: First two bytes of the answers; None takes either kind.
        """
        counters = self._count
        window = base + self.timing.allowance + self._backlog()
        asked_at, self._asked_at = self._asked_at, None
        if data is not None:
            self._fallen += 1
        else:
            counters.requests += 1
            self._check_call()
            if self._doubtful:
                self._drain()
            asked_at = self._clock()
            self._sent.add(request, asked_at)
        now = self._clock()
        collector = AnswerCollector(
            request,
            servo_ids,
            params,
            header=header,
            sent=self._sent.packets(now),
            echo=self.echo is not False,
        )
        counters.careful += 1
        try:
            if data is None:
                data = self._exchange(request, window)
            self._gather(collector, data, base)
        finally:
            # Whatever ended the wait, be it Ctrl-C, an answer that is not here may come later.
            now = self._clock()
            for servo_id in collector.missing:
                counters.lost += 1
                self._doubts.add(servo_id, params, request, now if asked_at is None else asked_at, now)
        if collector.echoed:
            counters.echoes += 1
            self.echo = True
        elif collector.answers:
            self.echo = False
        answered = len(collector.answers)
        counters.answers += answered
        sound = answered * (6 + params) + (len(request) if collector.echoed else 0)
        counters.stray_bytes += max(0, collector.size - sound)
        if self._doubtful:
            for servo_id in collector.answers:
                self._doubts.answered(servo_id, params, now)
            self._notice(collector, now)
        if asked_at is not None and answered and answered == len(servo_ids):
            self.timing.measured(now - asked_at, len(request) + answered * (6 + params))
        return collector

    def _gather(self, collector: AnswerCollector, data: bytes, base: float) -> None:
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
            data = self.link.read(self._clock() + wait)
            outlook = collector.receive(data)

    def _drain(self, pause: float = 0.0) -> None:
        """Take what has come meanwhile, or comes during a pause, off the line: nobody waits for it any more."""
        data = b""
        end = self._clock() + pause
        while more := self.link.read(end):
            data += more
            if len(data) > _MOST_DRAINED:
                break
        if data:
            self._count.stray_bytes += len(data)
            late = AnswerCollector(b"", (), 0)
            late.receive(data)
            self._notice(late, self._clock())

    def _notice(self, collector: AnswerCollector, now: float) -> None:
        """Learn from answers that came too late how long answers take."""
        for status in collector.strays:
            params = len(status.params)
            asked = self._doubts.late(status.servo_id, params)
            if asked is not None:
                self.timing.late(now - asked, 14 + params)

    def _ask_one(
        self,
        servo_id: int,
        request: bytes,
        params: int,
        *,
        base: float,
        data: bytes | None = None,
        header: bytes | None,
    ) -> tuple[StatusPacket | None, AnswerCollector]:
        """Ask one servo what is answered in one length only, again if need be. Only for what may be done twice."""
        if data is None and self._doubted(servo_id, params) and not self._settle(servo_id, params):
            self._count.given_up += 1
            return None, AnswerCollector(request, (servo_id,), params)
        collector = self._collect(request, (servo_id,), params, base, data, header=header)
        for attempt in range(1 + self.retries):
            if attempt:
                self._count.repeats += 1
                collector = self._collect(request, (servo_id,), params, base, header=header)
            found = collector.answers.get(servo_id)
            if found is not None:
                self._mute.pop(servo_id, None)
                return found, collector
            if servo_id in collector.copies:
                # It may have answered; asking the same again is no help.
                break
        else:
            self._mute[servo_id] = self._clock() + _MUTE_REST
        self._count.given_up += 1
        return None, collector

    def _ask_block(
        self, servo_id: int, address: int, count: int, *, base: float = 0.0, data: bytes | None = None
    ) -> tuple[StatusPacket | None, AnswerCollector]:
        """Read registers of one servo, with their neighbours where an answer of that length could be another's.

        Args:
            servo_id: Whom to ask.
            address: First register address.
            count: Bytes wanted.
            base: Seconds that takes, if it is asked already.
            data: What has arrived, if it is; None asks.

        Returns:
            The answer with the bytes wanted, or None; and what came last.
        """
        series = self._series_of(servo_id)
        collector = AnswerCollector(b"", (servo_id,), count)
        block = BlockAnswers(address, count)
        left, first = 1 + self.retries, True
        while left > 0:
            left -= 1
            place = (address, count) if data is not None else self._place((servo_id,), address, count)
            if place is None and series is Series.SEVEN_BOT and self._settle(servo_id, count):
                place = self._place((servo_id,), address, count)
            if place is None:
                break
            request = make_read(servo_id, *place)
            self._count.repeats += not first
            if data is None:
                base = self._base(len(request) + 6 + place[1], (servo_id,))
            collector = self._collect(request, (servo_id,), place[1], base, data, header=series.reply_header)
            data = None
            found = block.take(collector, place).get(servo_id)
            if found is not None:
                self._mute.pop(servo_id, None)
                self._count.settled += place != (address, count)
                return found, collector
            if first and servo_id in collector.copies:
                # Not silence: it may have answered in the very bytes of an echo, and is asked otherwise.
                left = max(left, 1)
            first = False
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
        header = plan.series.reply_header
        block = BlockAnswers(plan.address, plan.count)
        found: dict[int, StatusPacket] = {}
        now = self._clock()
        wanted: list[int] = list(plan.ids)
        if data is None and self._mute:
            # Whoever was silent goes first: the others' answers then end the wait.
            wanted.sort(key=lambda servo_id: servo_id not in self._mute)
        attempt, attempts = 0, 1 + self.retries
        while attempt < attempts:
            if attempt:
                wanted = [i for i in plan.ids if i not in found and self._mute.get(i, 0.0) <= now]
                if not wanted:
                    break
                self._count.repeats += 1
            place: tuple[int, int] | None = (plan.address, plan.count)
            if data is None:
                place, wanted = self._place_most(wanted, plan.address, plan.count)
            if place is None:
                break
            if len(wanted) == 1 and attempt:
                request = make_read(wanted[0], *place)
                base = self._base(len(request) + 6 + place[1], wanted)
            else:
                asked = plan if data is not None else self._sync_plan(plan, tuple(wanted), *place)
                request, base = asked.request, asked.base
            collector = self._collect(request, wanted, place[1], base, data, header=header)
            data = None
            for servo_id, status in block.take(collector, place).items():
                found[servo_id] = status
                self._count.settled += place[1] != plan.count
                self._mute.pop(servo_id, None)
            if not attempt and collector.copies:
                attempts = max(attempts, 2)  # as in `_ask_block`
            attempt += 1
        for servo_id in plan.ids:
            if servo_id not in found:
                self._count.given_up += 1
                if self._mute.get(servo_id, 0.0) <= now:
                    self._mute[servo_id] = now + _MUTE_REST
        return found

    def _sync_plan(self, plan: SyncReadPlan, servo_ids: tuple[int, ...], address: int, count: int) -> SyncReadPlan:
        raise NotImplementedError

    # --- doubt ------------------------------------------------------------------------------------------------

    def _places(self, servo_id: int, address: int, count: int) -> Iterable[tuple[int, int]]:
        series = self._series_of(servo_id)
        return places(address, count, self._ends[series], series.max_read)

    def _place(self, servo_ids: Sequence[int], address: int, count: int) -> tuple[int, int] | None:
        """The shortest block around some registers whose answers cannot be late ones; None if there is none."""
        for place in self._places(servo_ids[0], address, count):
            if not self._doubtful or not any(self._doubted(i, place[1]) for i in servo_ids):
                return place
        return None

    def _place_most(
        self, servo_ids: list[int], address: int, count: int
    ) -> tuple[tuple[int, int] | None, list[int]]:
        """A block for all of them, or one that suits the most, and those."""
        place = self._place(servo_ids, address, count)
        if place is not None:
            return place, servo_ids
        best: list[int] = []
        for candidate in self._places(servo_ids[0], address, count):
            suited = [i for i in servo_ids if not self._doubted(i, candidate[1])]
            if len(suited) > len(best):
                place, best = candidate, suited
        return place, best

    def _doubt(self, servo_id: int, params: int, request: bytes, asked: float) -> None:
        """An answer may come for which nobody waits."""
        self._doubts.add(servo_id, params, request, asked, self._clock())

    def _doubted(self, servo_id: int, params: int, request: bytes = b"") -> bool:
        """Whether an answer of that length may be a late one, to another request than this."""
        if not self._doubtful:
            return False
        doubts, now = self._doubts, self._clock()
        held = doubts.holds(servo_id, params, now, request)
        idle, self._looked_at = now - self._looked_at, now
        if doubts.ended:
            doubts.ended = False
            self._drain(ADAPTER_TIME if idle > _IDLE else 0.0)
        return held

    def _suspect(self, servo_ids: Sequence[int], params: int) -> bool:
        """Whether a late answer of that length may come from any of them."""
        return any(self._doubted(servo_id, params) for servo_id in servo_ids)

    def _is_there(self, servo_id: int) -> tuple[StatusPacket | None, AnswerCollector]:
        """Ask a servo of a kind that can be asked in any length whether it is there."""
        found, collector = self._ask_block(servo_id, _ANY_REGISTER, 1)
        self._count.settled += found is not None
        return found, collector

    def _settle(self, servo_id: int, params: int) -> bool:
        """Make sure that no answer of that length is on the way from a servo; False if it does not answer at all.

        A request that is answered in another length does that.
        """
        if self._series_of(servo_id) is not Series.SEVEN_BOT:
            settled = self._is_there(servo_id)[0] is not None
        else:
            settled = self._settle_legacy(servo_id)
        if settled:
            self._doubts.settled(servo_id, params)
        else:
            self._mute[servo_id] = self._clock() + _MUTE_REST
        return settled

    def _settle_legacy(self, servo_id: int) -> bool:
        """Ask a servo that knows only two lengths in the other one, and once more after a pause.

        Nothing but order keeps its answers apart. The pause is for a line that is not as strict about it.
        """
        for _ in range(1 + self.retries):
            if not self._doubted(servo_id, 0):
                params, request = 0, make_ping(servo_id)
            elif not self._doubted(servo_id, _LEGACY_READ):
                params, request = _LEGACY_READ, make_read(servo_id, _ANY_REGISTER, _LEGACY_READ)
            else:
                break
            base = self._base(len(request) + 6 + params, (servo_id,))
            header = Series.SEVEN_BOT.reply_header
            if servo_id not in self._collect(request, (servo_id,), params, base, header=header).answers:
                continue
            self._drain(ADAPTER_TIME)
            if servo_id in self._collect(request, (servo_id,), params, base, header=header).answers:
                self._count.settled += 1
                return True
        return False
