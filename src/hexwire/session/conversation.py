"""Conversations over datagrams: the conversation of each frame, and whether the frame is old.

Owns PROTOCOL.md section 6.6: the numbers of both sides, repeated frames, late frames. A stream needs none of this,
since a newly opened line carries no old frames. It protects against mistakes and old copies, not against an
attacker who reads the line: it is not cryptography. No I/O; time and random numbers come in.
"""

from __future__ import annotations

from collections.abc import Callable

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame

from .effects import Effect, effect_of

__all__ = ["Conversation", "Conversations", "Numbers", "Window", "is_stop"]

Numbers = Callable[[], int]
"""Source of unpredictable random numbers from 0 to 2**31 - 1."""

_U32 = 0xFFFFFFFF
_HALF = 1 << 31
_MOST_OPENING = 16
_REPEATS_WITHIN = 128
"""A repeat has a number less than this above that of the first frame; seq wraps after 256 requests."""
_DRIFT = 0.001
"""Drift between the clocks of two computers, seconds per second: ten times that of a poor crystal."""


def is_stop(frame: Frame) -> bool:
    """Whether a request stops the arm: it is executed however late it is, and cancels earlier requests."""
    return not frame.cmd_ext and effect_of(frame.proto, frame.cmd, frame.body) is Effect.STOP


class Window:
    """The frame numbers received from the peer: each is valid once, and only near the newest.

    Args:
        start: The first number, which has been received.
    """

    def __init__(self, start: int) -> None:
        self._newest = start
        # Bit i: the number i below the newest was received. Numbers below the start are invalid.
        self._seen = _ALL

    def take(self, sn: int) -> str:
        """Record a number; returns why it is refused, or an empty text."""
        ahead = sn - self._newest & _U32
        if 0 < ahead < _HALF:
            self._newest = sn
            self._seen = (self._seen << min(ahead, tables.DATAGRAM_WINDOW) | 1) & _ALL
            return ""
        behind = -ahead & _U32
        if behind >= tables.DATAGRAM_WINDOW:
            return "its number is too old"
        if self._seen >> behind & 1:
            return "it arrived before, or is cancelled"
        self._seen |= 1 << behind
        return ""

    def void(self) -> None:
        """Refuse all numbers below the newest from now on."""
        self._seen = _ALL


_ALL = (1 << tables.DATAGRAM_WINDOW) - 1


class Conversation:
    """One conversation, as seen from one side.

    Args:
        theirs: Number of the peer's frame that began it; our frames carry it.
        ours: Number of our frame that began it; the peer's frames must carry it.
        behind: Our clock minus the stamp of the peer's first frame, seconds.
        now: Seconds, monotonic.
        module: On a host's side, the module that sent that frame: a gateway has several behind it, each with a
            clock of its own. None if all frames have one clock.
    """

    def __init__(self, theirs: int, ours: int, behind: float, now: float, module: int | None = None) -> None:
        self.theirs = theirs
        self.ours = ours
        self._sn = ours
        self._window = Window(theirs)
        self._by_module = module is not None
        # By clock: the least difference between ours and that one, and when it was found.
        self._least = {module or 0: (behind, now)}
        self._requests: dict[int, tuple[int, int]] = {}

    def next_number(self) -> int:
        """Return the number of the board's next frame, starting with that of its offer."""
        sn = self._sn
        self._sn = sn + 1 & _U32
        return sn

    def take(self, frame: Frame, now: float) -> str:
        """Record a frame of this conversation; returns why it is refused, or an empty text."""
        behind = now - frame.time
        # The fastest frame so far gives the clocks' difference; a frame that takes longer was delayed.
        clock = frame.src if self._by_module else 0
        least, at = self._least.get(clock, (behind, now))
        least = min(behind, least + _DRIFT * (now - at))
        self._least[clock] = least, now
        late = behind - least
        stop = is_stop(frame)
        # A reply executes nothing: it is valid however late, as long as its request is outstanding.
        if late > tables.DATAGRAM_LATE and not stop and not frame.is_reply:
            return f"it is {late:.1f} s late"
        problem = self._window.take(frame.sn)
        if stop and not problem:
            self._window.void()
        return problem

    def is_repeat(self, frame: Frame) -> bool:
        """Record a request; returns whether it, or a later one with its seq, arrived before with another number."""
        what = hash((frame.cmd, frame.body))
        last = self._requests.get(frame.seq)
        if last is not None:
            ahead = frame.sn - last[0] & _U32
            if ahead >= _HALF or (what == last[1] and ahead < _REPEATS_WITHIN):
                return True
        self._requests[frame.seq] = frame.sn, what
        return False


class Conversations:
    """The current conversation, and those on offer.

    A host requests a conversation by IDENTIFY and enters it with the reply. A board only offers one, since the
    IDENTIFY may be an old copy: it enters the conversation with the first frame that carries the offer's number.

    Args:
        numbers: Source of random numbers.
        host: Whether this is the host's side.

    Attributes:
        current: The current conversation; None before the first.
        count: Number of conversations entered.
    """

    def __init__(self, numbers: Numbers, *, host: bool) -> None:
        self.current: Conversation | None = None
        self.count = 0
        self._news = False
        self._numbers = numbers
        self._host = host
        self._sn = numbers()
        self._asked: dict[int, None] = {}
        self._offered: dict[int, Conversation] = {}

    # -- sending ------------------------------------------------------------------------------------

    def stamp(self, cmd: int, kind: int, offer: Conversation | None) -> tuple[int, int]:
        """Return the fields sn and type of the next frame.

        Args:
            cmd: Its command.
            kind: Its type outside conversations.
            offer: The conversation that it offers; None for the current one.
        """
        if self._host:
            self._sn = self._sn + 1 & _U32
            current = None if cmd == Command.IDENTIFY else self.current
            return self._sn, kind if current is None else _signed(current.theirs)
        conversation = offer or self.current
        if conversation is None:
            return self._numbers(), kind
        return conversation.next_number(), _signed(conversation.theirs)

    def sent(self, cmd: int, sn: int) -> None:
        """Record the number of a frame that was made, which may differ from that of `stamp`."""
        if not self._host:
            return
        self._sn = sn
        if cmd == Command.IDENTIFY:
            self._asked[sn] = None
            if len(self._asked) > _MOST_OPENING:
                del self._asked[next(iter(self._asked))]

    # -- host ---------------------------------------------------------------------------------------

    def is_answer(self, frame: Frame) -> bool:
        """Whether a reply to IDENTIFY answers one of this host's requests."""
        return frame.type & _U32 in self._asked

    def begin(self, answer: Frame, now: float) -> None:
        """Enter the conversation that a reply offers."""
        self.current = Conversation(answer.sn, answer.type & _U32, now - answer.time, now, answer.src)
        self.count += 1
        self._news = True
        for sn in list(self._asked):
            del self._asked[sn]
            if sn == self.current.ours:
                break

    # -- board --------------------------------------------------------------------------------------

    def offer(self, identify: Frame, now: float) -> bool:
        """Offer a conversation in reply to IDENTIFY; False if this frame arrived before."""
        begun = [c.theirs for c in self._offered.values()]
        if identify.sn in begun or (self.current is not None and self.current.theirs == identify.sn):
            return False
        ours = self._numbers()
        self._offered[ours] = Conversation(identify.sn, ours, now - identify.time, now)
        if len(self._offered) > _MOST_OPENING:
            del self._offered[next(iter(self._offered))]
        return True

    def offered_to(self, identify: Frame) -> Conversation | None:
        """Return the conversation that was offered in reply to an IDENTIFY."""
        return next((c for c in self._offered.values() if c.theirs == identify.sn), None)

    # -- both ---------------------------------------------------------------------------------------

    def take(self, frame: Frame, now: float) -> str:
        """Check a frame other than IDENTIFY and its reply; returns why it is refused, or an empty text."""
        number = frame.type & _U32
        current = self.current
        if current is not None and number == current.ours:
            problem = current.take(frame, now)
            self._news = self._news or not problem
            return problem
        offered = self._offered.get(number)
        if offered is None:
            return "it is of another conversation"
        problem = offered.take(frame, now)
        if not problem:
            self.current = offered
            self.count += 1
            self._news = True
            # Earlier offers end; later offers may still be accepted.
            for ours in list(self._offered):
                del self._offered[ours]
                if ours == number:
                    break
        return problem

    def has_news(self) -> bool:
        """Whether a valid frame of the conversation arrived since the last call."""
        news, self._news = self._news, False
        return news

    def is_repeat(self, frame: Frame) -> bool:
        """Record a request of the current conversation; returns whether it arrived before with another number."""
        return self.current is not None and self.current.is_repeat(frame)

    def is_current(self, frame: Frame) -> bool:
        """Whether a request belongs to the current conversation."""
        return self.current is not None and frame.type & _U32 == self.current.ours


def _signed(number: int) -> int:
    """Convert a number to the signed value of the field type."""
    return (number ^ _HALF) - _HALF
