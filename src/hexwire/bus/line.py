"""A link to servos, and the machine that says what to do on it.

Owns the I/O of a servo bus: the link and its clock, the lock that keeps transactions apart, and the check that
nothing leaves after a stop. What an answer is, `machine` decides. Must not know registers by name, nor arms.
"""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager, nullcontext, suppress
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

from hexwire.epochs import Epochs
from hexwire.errors import NotSupportedError, PreemptedError, UsageError
from hexwire.session.effects import packet_only_reads

from .machine import ADAPTER_TIME, MEASURED_EVERY, BusMachine, Conversation, Heard, Interrupted, Send

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hexwire.epochs import Token
    from hexwire.link.base import Link

    from .plan import ReadPlan, SyncReadPlan
    from .servos import KnownServos

__all__ = ["BusLine"]

_WRITE_TIME = 1.0
"""Seconds after which a line that takes no bytes is given up."""
_WHAT = "a servo packet"
_T = TypeVar("_T")


class BusLine:
    """Transactions on one link. Whoever uses it holds `lock`, but for `open` and `close`.

    Args:
        link: The line; opened and closed with this object.
        servos: What is known of the servos.
        baud: Bits a second on the wire; None takes the link's own rate, 0 if it has none.
        retries: How often a servo that did not answer is asked again.

    Attributes:
        link: The line.
        machine: What may be outstanding, and what counts as an answer.
        epochs: The stops of the arm behind it, and what they void; a driver has its own here.
        lock: Held for one transaction or call.
        clock: The link's clock: monotonic seconds.
        exchange: The link's own.
    """

    def __init__(self, link: Link, servos: KnownServos, *, baud: int | None = None, retries: int = 2) -> None:
        if retries < 0:
            raise UsageError(f"{retries} retries make no sense")
        self.link = link
        self.machine = BusMachine(servos, getattr(link, "baud", 0) if baud is None else baud, retries)
        self.epochs = Epochs()
        self.lock = threading.RLock()
        self.clock: Callable[[], float] = getattr(link, "clock", monotonic)
        self.exchange = link.exchange
        self._own_baud = baud

    # --- opening ----------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the link and drop what had arrived before, or is in the adapter: another program's answers, say."""
        self.link.open()
        self._restart()
        self.link.flush_input()
        self.run(self.machine.drain(ADAPTER_TIME))

    def set_baud(self, baud: int) -> None:
        """Follow the servos to another rate. The servos are not told.

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
        """The link may have been opened at another rate than before."""
        self.machine.restart(getattr(self.link, "baud", 0) if self._own_baud is None else self._own_baud)

    # --- calls and stops --------------------------------------------------------------------------------------

    def calling(self, request: bytes) -> AbstractContextManager[object]:
        """The call that a packet belongs to: void if a stop comes before it has left."""
        return nullcontext() if packet_only_reads(request) else self.epochs.calling(_WHAT)

    def check_call(self) -> None:
        """Send nothing more of a call that was made before a stop.

        Raises:
            StoppedError: A stop came since the call was made.
        """
        token = self.epochs.of_this_call
        if token is not None:
            self.epochs.check(token, _WHAT)

    # --- transactions -----------------------------------------------------------------------------------------

    def run(self, conversation: Conversation[_T]) -> _T:
        """Do on the link what a conversation asks for.

        Returns:
            What it returns.

        Raises:
            LinkError: The line is at fault. What was asked may be answered all the same, which is remembered.
            StoppedError: A stop came since the call was made; nothing more of it was sent.
        """
        clock = self.clock
        self.machine.now = clock()
        try:
            step = next(conversation)
            while True:
                if isinstance(step, Send):
                    try:
                        self.check_call()
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
        """Send a prepared read and take what comes: the fast path. The caller checks it.

        Where `machine.asked_at` is set afterwards and the answers are sound, the caller has `machine.learn_time`
        learn from it. If an error or Ctrl-C comes before the caller has checked the answers, it calls `gave_up`.

        Args:
            plan: What is asked.
            timed: Learn from this one how long answers take, in any case.

        Raises:
            LinkError: The line is at fault. The answers may come all the same.
        """
        machine = self.machine
        turn = machine.turns = machine.turns + 1
        allowance, left = machine.timing.allowance, 0.0
        window = plan.base + allowance
        plan.allowance = allowance
        machine.asked_at = None
        if machine.busy_until:
            left = machine.backlog(self.clock())
            window += left
        if timed or machine.learning or not turn % MEASURED_EVERY:
            machine.asked_at = self.clock() + left
        return self.exchange(plan.request, window, plan.rest)

    def gave_up(self, plan: ReadPlan | SyncReadPlan) -> None:
        """An error or Ctrl-C came before the answers to `transact` were checked; they may come all the same."""
        now = self.clock()
        self.machine.gave_up(plan.ids, plan.count, plan.request, now, now)

    def post(self, packet: bytes, token: Token | None) -> None:
        """Send what nobody answers.

        Args:
            packet: The packet.
            token: The call that it belongs to, if it belongs to one.

        Raises:
            StoppedError: A stop came since the call was made; nothing was sent.
            PreemptedError: It came as the packet was sent.
        """
        epochs = self.epochs
        if token is not None:
            epochs.check(token, _WHAT)
        now = self.clock()
        self.machine.posted(packet, now)
        self.link.write(packet, now + _WRITE_TIME)
        if token is not None and not epochs.holds(token):
            raise PreemptedError("a stop came as a servo packet was sent: it may have been done at that time")

    def send(self, packet: bytes) -> None:
        """Send any packet that nobody answers, as a call of its own. Takes `lock` itself.

        Raises:
            StoppedError: As `post`.
            PreemptedError: As `post`.
        """
        with self.calling(packet), self.lock:
            self.post(packet, self.epochs.of_this_call)
