"""A link to servos, and the machine that decides what to send on it.

Owns the I/O of a servo bus: the link and its clock, the lock for transactions, and the check that nothing is sent
after a stop. `machine` decides what counts as an answer. Must not know registers by name, nor arms.
"""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager, nullcontext, suppress
from time import monotonic, sleep
from typing import TYPE_CHECKING, TypeVar

from hexwire.epochs import Epochs, Token
from hexwire.errors import NotSupportedError, PreemptedError, UsageError
from hexwire.session.effects import packet_only_reads
from hexwire.system import SLEEP_ERROR
from hexwire.wire.servo_packet import BROADCAST_ID

from .machine import ADAPTER_TIME, MEASURED_EVERY, BusMachine, Conversation, Heard, Interrupted, Send

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hexwire.link.base import Link

    from .plan import ReadPlan, SyncReadPlan
    from .servos import KnownServos

__all__ = ["BusLine"]

_WHAT = "a servo packet"
_SHORTEST_NAP, _LONGEST_NAP = 50e-6, 0.001
"""Seconds: less saves nothing; a line that is closed during a nap is noticed after it."""
_T = TypeVar("_T")


class BusLine:
    """Transactions on one link. Callers hold `lock`, except for `open` and `close`.

    Args:
        link: The link; opened and closed with this object.
        servos: Known facts of the servos.
        baud: Bits per second on the wire; None takes the link's rate, 0 if it has none.
        retries: Number of times to repeat a request to a servo that did not answer.

    Attributes:
        link: The link.
        machine: Outstanding requests, and the rules for answers.
        epochs: The stops of the arm, and the calls that they cancel; a driver sets its own.
        lock: Held for one transaction or call.
        clock: The link's clock: monotonic seconds.
        exchange: The method of the link, as are `ask`, which is its `post`, and `collect`.
    """

    def __init__(self, link: Link, servos: KnownServos, *, baud: int | None = None, retries: int = 2) -> None:
        if retries < 0:
            raise UsageError(f"{retries} retries are too few; give 0 or more")
        if getattr(link, "raise_to", 0):
            raise UsageError(f"{link.url}: only a board's line can be raised; name the servos' rate with baud")
        self.link = link
        self.machine = BusMachine(servos, getattr(link, "baud", 0) if baud is None else baud, retries)
        self.epochs = Epochs()
        self.lock = threading.RLock()
        self.clock: Callable[[], float] = getattr(link, "clock", monotonic)
        self.exchange = link.exchange
        self.ask = link.post
        self.collect = link.collect
        self._post = link.post
        self._own_baud = baud

    # --- opening ----------------------------------------------------------------------------------------------

    def open(self, *, settle: bool = True) -> None:
        """Open the link and discard old bytes in it and in the adapter, such as answers to another program.

        Args:
            settle: Wait until the adapter has forwarded its bytes. Who begins with pings need not: bytes keep their
                order, so old ones come before the first answer, and all they can pass for is the answer to a ping.
        """
        self.link.open()
        self._restart()
        self.link.flush_input()
        if settle:
            self.run(self.machine.drain(ADAPTER_TIME))

    def set_baud(self, baud: int) -> None:
        """Change the rate of the link. The servos' own rate does not change.

        Raises:
            NotSupportedError: This link has no rate.
        """
        change = getattr(self.link, "set_baud", None)
        if change is None:
            raise NotSupportedError(f"{self.link.url} has no line rate to change")
        change(baud)
        if self.link.is_open:
            self.link.flush_input()
        self._own_baud = None
        self._restart()

    def _restart(self) -> None:
        """Restart the machine at the link's rate, which may have changed."""
        self.machine.restart(getattr(self.link, "baud", 0) if self._own_baud is None else self._own_baud)

    # --- calls and stops --------------------------------------------------------------------------------------

    def calling(self, request: bytes) -> AbstractContextManager[object]:
        """Return the call that a packet belongs to, which a stop cancels until the packet is sent."""
        return nullcontext() if packet_only_reads(request) else self.epochs.calling(_WHAT)

    def check_call(self, packet: bytes | None = None) -> None:
        """Refuse to send more of a call made before a stop.

        Args:
            packet: The packet that is sent next, if it is known.

        Raises:
            StoppedError: The arm was stopped after the call.
        """
        token = self.epochs.of_this_call
        if token is None:
            return
        if packet is None or packet_only_reads(packet):
            self.epochs.check(token, _WHAT)
        else:
            self.epochs.check_leaving(token, _WHAT)

    # --- transactions -----------------------------------------------------------------------------------------

    def run(self, conversation: Conversation[_T]) -> _T:
        """Run a conversation on the link.

        Returns:
            The result of the conversation.

        Raises:
            LinkError: The line has a fault. An answer may still arrive, which is recorded as a late reply.
            StoppedError: The arm was stopped after the call; nothing more of it was sent.
        """
        clock = self.clock
        self.machine.now = clock()
        try:
            step = next(conversation)
            while True:
                if isinstance(step, Send):
                    try:
                        self.check_call(step.packet)
                    except BaseException:
                        conversation.close()
                        raise
                    data = self.exchange(step.packet, step.window)
                else:
                    data = self.link.read(step.until)
                step = conversation.send(Heard(data, clock()))
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]  # the conversation's result
        except BaseException:
            with suppress(Interrupted):
                conversation.throw(Interrupted(clock()))
            self.machine.interrupted(clock())
            raise

    def doubted(self, servo_ids: Sequence[int], params: int) -> bool:
        """Whether a late answer of that length may come from any of these servos; see `BusMachine.any_doubted`."""
        return self.run(self.machine.any_doubted(servo_ids, params))

    def transact(self, plan: ReadPlan | SyncReadPlan, *, timed: bool = False) -> bytes:
        """Send a prepared read and return the bytes received: the fast path. The caller checks them.

        If `machine.asked_at` is set afterwards and the answers are valid, the caller passes the time to
        `machine.learn_time`. If an error or Ctrl-C comes before the caller has checked the answers, it calls
        `gave_up`.

        Args:
            plan: The read.
            timed: Measure the time of this transaction in any case.

        Raises:
            LinkError: The line has a fault. The answers may still arrive.
        """
        machine = self.machine
        asked_at = None
        if timed or machine.time_next:
            asked_at = self.clock()
            asked_at += machine.backlog(asked_at)
        self.ask(plan.request)
        # The line was idle up to here, and is again from the answer to the next request. Until the answer comes,
        # time is free.
        machine.asked_at = asked_at
        turn = machine.turns = machine.turns + 1
        machine.time_next = machine.learning or not (turn + 1) % MEASURED_EVERY
        plan.allowance = allowance = machine.timing.allowance
        window = plan.base + allowance
        if machine.busy_until:
            window += machine.backlog(self.clock())
        rest = plan.rest
        if rest is None or self.clock is not monotonic:
            return self.collect(window, rest)
        length, byte_time = plan.length, machine.timing.byte_time

        def napping(data: bytes) -> float:
            # The answers come one by one. To wake up for each of them costs a fifth of the CPU time of a read.
            wait = rest(data)
            nap = min((length - len(data)) * byte_time - SLEEP_ERROR, _LONGEST_NAP)
            if nap < _SHORTEST_NAP or wait <= 0.0:
                return wait
            sleep(nap)
            return wait - nap

        return self.collect(window, napping)

    def gave_up(self, plan: ReadPlan | SyncReadPlan) -> None:
        """Record an error or Ctrl-C before the answers to `transact` were checked; they may still arrive."""
        now = self.clock()
        self.machine.gave_up(plan.ids, plan.count, plan.request, now, now)

    def post(self, packet: bytes, token: Token | None) -> None:
        """Send a packet without an answer.

        Args:
            packet: The packet.
            token: The call that it belongs to, if any.

        Raises:
            StoppedError: The arm was stopped after the call; nothing was sent.
            PreemptedError: The arm was stopped while the packet was sent.
        """
        epochs = self.epochs
        if token is not None and not epochs.undisturbed(token):
            epochs.check_leaving(token, _WHAT)
        machine = self.machine
        if packet[2] != BROADCAST_ID:
            # Its echo may pass for an answer.
            machine.sent.add(packet, self.clock())
        try:
            self._post(packet)
        finally:
            # The rest of the record afterwards, while the packet is on the wire.
            machine.posted(packet, self.clock())
        if token is not None and not epochs.undisturbed(token) and not epochs.holds(token):
            raise PreemptedError("a stop came while a servo packet was sent; the servo may have executed it")

    def send(self, packet: bytes) -> None:
        """Send any packet without an answer, as a separate call. Takes `lock`.

        Raises:
            StoppedError: As `post`.
            PreemptedError: As `post`.
        """
        with self.calling(packet), self.lock:
            self.post(packet, self.epochs.of_this_call)
