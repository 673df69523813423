"""What a servo is told but its registers: ping, orders such as reboot and calibrate, and how it acknowledges.

Owns the series of each servo, acknowledged packets and the instructions that name no register. Must not know
registers by name (but for the two that say how a servo answers), nor arms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from hexwire.errors import NotSupportedError, RemoteProtocolError, UsageError
from hexwire.session.effects import packet_only_reads
from hexwire.session.servo_answers import AnswerCollector
from hexwire.session.servo_matching import expected_answer
from hexwire.wire import servo_packet as packets
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import BROADCAST_ID
from hexwire.wire.tables import LEGACY_HEADER, MAX_SERVO_ID

from .line import BusLine
from .plan import WritePlan
from .timing import LineTiming
from .values import SILENT, Answer

if TYPE_CHECKING:
    from hexwire.link.base import Link

    from .values import Reading

__all__ = ["BusOrders", "as_series", "why"]

_BROADCAST_PING_BYTES = 6
_new = tuple.__new__


class BusOrders(BusLine):
    """The part of `ServoBus` below register names; see there."""

    def __init__(
        self,
        link: Link,
        *,
        series: Series | str = Series.STS_SMS,
        servos: Mapping[int, Series | str] | None = None,
        baud: int | None = None,
        retries: int = 2,
    ) -> None:
        super().__init__(link, baud=baud, retries=retries)
        self.series = as_series(series)
        self._servos = {servo_id: as_series(kind) for servo_id, kind in (servos or {}).items()}
        self._unacknowledged: set[int] = set()
        self._known_level: set[int] = set()

    def read(self, servo_id: int, name: str) -> Reading:
        """Read a register."""
        raise NotImplementedError

    def _forget_plans(self) -> None:
        """What was prepared is out of date."""
        raise NotImplementedError

    # --- series ------------------------------------------------------------------------------------------------

    def series_of(self, servo_id: int) -> Series:
        """Series of a servo."""
        return self._servos.get(servo_id, self.series)

    _series_of = series_of

    def set_series(self, servo_id: int, series: Series | str) -> None:
        """Say what a servo is."""
        with self._lock:
            self._servos[servo_id] = as_series(series)
            self._forget_plans()

    def set_return_delay(self, servo_id: int, seconds: float) -> None:
        """Say how long a servo takes to begin its answer; `servo_setup.identify` reads it."""
        with self._lock:
            self._return_delays[servo_id] = seconds
            self._forget_plans()

    def set_acknowledges(self, servo_id: int, acknowledges: bool) -> None:
        """Say whether a servo answers writes (status_return_level 1). Learned by itself from a silent one."""
        with self._lock:
            (self._unacknowledged.discard if acknowledges else self._unacknowledged.add)(servo_id)

    def acknowledges(self, servo_id: int) -> bool:
        """Whether a servo answers writes, as far as is known."""
        return servo_id not in self._unacknowledged and self.series_of(servo_id) is not Series.SEVEN_BOT

    # --- the other instructions -----------------------------------------------------------------------------

    def ping(self, servo_id: int) -> Answer:
        """Ask a servo whether it is there."""
        legacy = self.series_of(servo_id) is Series.SEVEN_BOT
        with self._lock:
            if not legacy and self._doubted(servo_id, 0):
                status, collector = self._is_there(servo_id)
            else:
                # Who is not known yet may be of either kind.
                header = LEGACY_HEADER if legacy else None
                request = packets.make_ping(servo_id)
                base = self._base(12, (servo_id,))
                status, collector = self._ask_one(servo_id, request, 0, base=base, header=header)
                if status is None and not legacy and servo_id in collector.copies:
                    # The answer of a servo with a low supply equals its ping.
                    status, collector = self._is_there(servo_id)
            if status is None:
                return Answer(servo_id, "ping", 0, why(collector.in_words()), False)
            return Answer(servo_id, "ping", status.error)

    def broadcast_ping(self, most: int = 254) -> tuple[tuple[int, ...], int]:
        """Ping all servos at once. Only a lone servo is sure to be understood: several answer together.

        Args:
            most: How many answers to wait for.

        Returns:
            Ids heard, and the number of bytes that made no sense (a collision, for one).
        """
        with self._lock:
            request = packets.make_ping(BROADCAST_ID)
            base = self._base(6 + _BROADCAST_PING_BYTES * most, range(min(most, 8)))
            self.link.flush_input()
            data = self._exchange(request, base + self.timing.allowance)
            now = self._clock()
            deadline = now + base
            while more := self.link.read(deadline):
                data += more
            heard = AnswerCollector(request, range(MAX_SERVO_ID + 1), 0, sent=self._sent.packets(now))
            heard.receive(data)
            found = set(heard.answers) | set(heard.murky)
            # What may be the echo of a ping of before is asked by itself.
            found |= {servo_id for servo_id in heard.copies - found if not self.ping(servo_id).error}
        data = packets.strip_echo(data, request)
        return tuple(sorted(found)), max(0, len(data) - _BROADCAST_PING_BYTES * len(found))

    def restore(self, servo_id: int) -> Answer:
        """Factory settings, id kept on Feetech servos.

        Raises:
            NotSupportedError: A legacy servo would lose its id; see `servo_setup.factory_reset`.
        """
        self._must_know(servo_id, "RESTORE")
        if self.series_of(servo_id) is Series.SEVEN_BOT:
            raise NotSupportedError(f"servo {servo_id} is a legacy one: a factory reset would make it servo 1")
        return self._acknowledged(
            self._order(servo_id, packets.make_restore(servo_id)), "factory reset", repeat=False
        )

    def reboot(self, servo_id: int) -> None:
        """Restart a servo; unanswered. It is silent for 0.8 s, and its torque is off."""
        self._must_know(servo_id, "REBOOT")
        self._send(packets.make_reboot(servo_id))

    def backup(self, servo_id: int) -> Answer:
        """Have a servo store its present settings as those of `restore`."""
        self._must_know(servo_id, "BACKUP")
        return self._acknowledged(self._order(servo_id, packets.make_backup(servo_id)), "backup")

    def reset_turns(self, servo_id: int) -> Answer:
        """Clear a servo's turn counter."""
        self._must_know(servo_id, "RESET_STATE")
        return self._acknowledged(self._order(servo_id, packets.make_reset_state(servo_id)), "reset of turns")

    def calibrate(self, servo_id: int, position: int | None = None) -> Answer:
        """Make the present position 2048, or the given count where the firmware takes one. Nothing moves."""
        self._must_know(servo_id, "CALIBRATE")
        register = self.series_of(servo_id).register("goal_position")
        data = None if position is None else register.encode(position)
        return self._acknowledged(
            self._order(servo_id, packets.make_calibrate(servo_id, data)), "calibration", repeat=False
        )

    def ask(self, request: bytes, servo_id: int, params: int) -> tuple[packets.StatusPacket | None, str]:
        """Send any packet once and take the answer of one servo.

        Returns:
            The status packet or None, and in words what came instead; empty if nothing did.
        """
        with self._calling(request), self._lock:
            if self._doubted(servo_id, params, request) and not self._settle(servo_id, params):
                return None, ""
            base = self._base(len(request) + 6 + params, (servo_id,))
            collector = self._collect(request, (servo_id,), params, base, header=None)
        return collector.answers.get(servo_id), collector.in_words()

    def pause(self, seconds: float) -> None:
        """Let time pass on this bus; what comes meanwhile is dropped."""
        with self._lock:
            end = self._clock() + seconds
            while self._clock() < end:
                self.link.read(end)

    def raw(self, request: bytes, servo_ids: Sequence[int] = (), params: int = 0) -> dict[int, bytes]:
        """Send any packet and return the parameters of the answers by servo id."""
        with self._calling(request), self._lock:
            if not servo_ids:
                self._post(request)
                for servo_id, length in _answers_of(request):
                    self._doubt(servo_id, length, request, self._clock())
                return {}
            sure = [i for i in servo_ids if not self._doubted(i, params, request) or self._settle(i, params)]
            total = len(request) + len(servo_ids) * (6 + params)
            collector = self._collect(request, servo_ids, params, self._base(total, servo_ids), header=None)
        return {servo_id: status.params for servo_id, status in collector.answers.items() if servo_id in sure}

    def set_baud(self, baud: int) -> None:
        """Follow the servos to another rate. The servos are not told.

        Raises:
            NotSupportedError: This link has no rate.
        """
        with self._lock:
            change = getattr(self.link, "set_baud", None)
            if change is None:
                raise NotSupportedError(f"{self.link.url} has no line rate to change")
            change(baud)
            if self.link.is_open:
                self.link.flush_input()
            self._own_baud = None
            self._own_baud_again()

    def action(self, servo_id: int = BROADCAST_ID) -> Answer | None:
        """Let `reg_write` take effect, in one servo or, unanswered, in all."""
        if servo_id == BROADCAST_ID:
            self._send(packets.make_action())
            return None
        return self._acknowledged(self._order(servo_id, packets.make_action(servo_id)), "action", repeat=False)

    # --- inside ---

    def _own_baud_again(self) -> None:
        """The link may have been opened at another rate than before."""
        baud = getattr(self.link, "baud", 0) if self._own_baud is None else self._own_baud
        if baud != self.timing.baud:
            self.timing = LineTiming(baud)
            self._learning = True
        self._doubts.clear()
        self._mute.clear()
        self._forget_plans()

    def _calling(self, request: bytes) -> AbstractContextManager[object]:
        """The call that a packet belongs to: void if a stop comes before it has left."""
        return nullcontext() if packet_only_reads(request) else self.epochs.calling("a servo packet")

    def _send(self, packet: bytes) -> None:
        with self._calling(packet), self._lock:
            self._post(packet)

    def _order(self, servo_id: int, request: bytes) -> WritePlan:
        return WritePlan(servo_id, self.series_of(servo_id), 0, b"", request)

    def _must_know(self, servo_id: int, instruction: str) -> None:
        series = self.series_of(servo_id)
        if instruction not in series.instructions:
            raise NotSupportedError(f"servo {servo_id} is a {series.value} one and knows no {instruction.lower()}")

    def _acknowledged(self, plan: WritePlan, what: str, *, repeat: bool = True) -> Answer:
        """Send a write and take its acknowledgement, if the servo gives any."""
        servo_id = plan.servo_id
        if servo_id == BROADCAST_ID:
            self._send(plan.request)
            return Answer(servo_id, what, confirmed=False)
        with self.epochs.calling(what), self._lock:
            plan.base = self._base(plan.total, (servo_id,))
            if not self.acknowledges(servo_id):
                self._post(plan.request)
                # If it does answer after all, that must not pass for the answer to the next ping or write.
                self._doubt(servo_id, 0, plan.request, self._clock())
                return Answer(servo_id, what, confirmed=False)
            if self._doubtful and self._doubted(servo_id, 0):
                block = self._write_and_look(plan) if repeat else None
                if block is not None:
                    return Answer(servo_id, what, block.error)
                if not self._settle(servo_id, 0):
                    return Answer(servo_id, what, 0, SILENT, False)
            start = self._clock()
            self._check_call()
            self._sent.add(plan.request, start)
            try:
                data = self._exchange(plan.request, plan.base + self.timing.allowance)
            except BaseException:
                self._doubt(servo_id, 0, plan.request, start)
                raise
            self._turns += 1
            if data == plan.acknowledgement:
                self._known_level.add(servo_id)
                self._measure(plan, self._clock() - start)
                return _new(Answer, (servo_id, what, 0, "", True))
            retries = self.retries
            try:
                self.retries = retries if repeat else 0
                header = plan.series.reply_header
                status, collector = self._ask_one(
                    servo_id, plan.request, 0, base=plan.base, data=data, header=header
                )
            finally:
                self.retries = retries
            if status is None and plan.data and servo_id in collector.copies:
                # Its answer looks like the echo of something sent lately. What it did tells.
                status = self._look(plan)
            if status is not None:
                self._known_level.add(servo_id)
                return Answer(servo_id, what, status.error)
            if servo_id in self._known_level:
                return Answer(servo_id, what, 0, why(collector.in_words()), False)
            return self._unconfirmed(servo_id, what, collector.in_words())

    def _write_and_look(self, plan: WritePlan) -> packets.StatusPacket | None:
        """Write where an acknowledgement could be an earlier write's; None if it cannot be seen to be done."""
        for _ in range(1 + self.retries if plan.data else 0):
            self._collect(plan.request, (plan.servo_id,), 0, plan.base, header=plan.series.reply_header)
            found = self._look(plan)
            if found is not None:
                self._count.settled += 1
                return found
        return None

    def _look(self, plan: WritePlan) -> packets.StatusPacket | None:
        """Read a write back; None if something else is there, or no answer comes."""
        block, _ = self._ask_block(plan.servo_id, plan.address, len(plan.data))
        return block if block is not None and block.params == plan.data else None

    def _unconfirmed(self, servo_id: int, what: str, instead: str) -> Answer:
        """A write was not acknowledged: is the servo silent, or set not to acknowledge?"""
        series = self.series_of(servo_id)
        level = self.read(servo_id, "status_return_level") if "status_return_level" in series.registers else None
        if level is not None and level.raw == 0:
            self._unacknowledged.add(servo_id)
            return Answer(servo_id, what, level.status, confirmed=False)
        return Answer(servo_id, what, 0, why(instead), False)


def _answers_of(request: bytes) -> list[tuple[int, int]]:
    """Who answers a packet, and with how many parameter bytes; nobody, if it is none."""
    try:
        expected = expected_answer(packets.parse_packet(request))
    except RemoteProtocolError:
        return []
    return [(servo_id, expected.params) for servo_id in expected.servo_ids]


def as_series(series: Series | str) -> Series:
    """Series of a name.

    Raises:
        UsageError: There is none; the text lists them.
    """
    try:
        return Series(series)
    except ValueError:
        known = ", ".join(kind.value for kind in Series)
        raise UsageError(f"no servo series {series!r}; there are {known} (sts and sms are sts_sms)") from None


def why(instead: str) -> str:
    """Why there is no answer."""
    return f"{SILENT}, but {instead}" if instead else SILENT
