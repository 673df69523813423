"""Conversations over datagrams: which one a frame belongs to, and whether it is old.

Owns PROTOCOL.md section 6.6: both sides' numbers, what was there already, what came too late. A stream needs none
of it, since a line that is opened anew carries nothing of before. It keeps out mistakes and old copies, not
somebody who reads the line: it is no cryptography. Sans I/O; time and random numbers come in.
"""

from __future__ import annotations

from collections.abc import Callable

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame

from .effects import Effect, effect_of

__all__ = ["Conversation", "Conversations", "Numbers", "Window", "is_stop"]

Numbers = Callable[[], int]
"""Source of random numbers from 0 to 2**31 - 1, that nobody can foresee."""

_U32 = 0xFFFFFFFF
_HALF = 1 << 31
_MOST_OPENING = 16
_REPEATS_WITHIN = 128
"""A request that comes again has a number less than this above the first; seq comes round after 256 requests."""
_DRIFT = 0.001
"""How much the clocks of two machines may part, in seconds per second: ten times what bad quartz does."""


def is_stop(frame: Frame) -> bool:
    """Whether a request stops the arm: it is obeyed however late it comes, and voids what was sent before it."""
    return not frame.cmd_ext and effect_of(frame.proto, frame.cmd, frame.body) is Effect.STOP


class Window:
    """Which numbers of the other side were there: each is good once, and only near the newest.

    Args:
        start: The number it began with, which was there.
    """

    def __init__(self, start: int) -> None:
        self._newest = start
        # Bit i: the number i below the newest was there. Below the start nothing is to come.
        self._seen = _ALL

    def take(self, sn: int) -> str:
        """Note a number; returns why it is refused, or an empty text."""
        ahead = sn - self._newest & _U32
        if 0 < ahead < _HALF:
            self._newest = sn
            self._seen = (self._seen << min(ahead, tables.DATAGRAM_WINDOW) | 1) & _ALL
            return ""
        behind = -ahead & _U32
        if behind >= tables.DATAGRAM_WINDOW:
            return "its number is long past"
        if self._seen >> behind & 1:
            return "it was there already, or is void"
        self._seen |= 1 << behind
        return ""

    def void(self) -> None:
        """Whatever is below the newest number, and has not come yet, is too late now."""
        self._seen = _ALL


_ALL = (1 << tables.DATAGRAM_WINDOW) - 1


class Conversation:
    """What both sides of one conversation know of it.

    Args:
        theirs: The number of the other side's frame that began it; what we send bears it.
        ours: The number of ours that did; what we hear must bear it.
        behind: Seconds that our clock is ahead of the stamp of their first frame.
        now: Seconds, monotonic.
    """

    def __init__(self, theirs: int, ours: int, behind: float, now: float) -> None:
        self.theirs = theirs
        self.ours = ours
        self._sn = ours
        self._window = Window(theirs)
        self._least = behind
        self._at = now
        self._requests: dict[int, tuple[int, int]] = {}

    def next_number(self) -> int:
        """Number of the next frame of a board; that of its offer comes first."""
        sn = self._sn
        self._sn = sn + 1 & _U32
        return sn

    def take(self, frame: Frame, now: float) -> str:
        """Note a frame of this conversation; returns why it is refused, or an empty text."""
        behind = now - frame.time
        # The quickest frame so far shows how the clocks stand; what takes longer than that was held up.
        self._least = min(behind, self._least + _DRIFT * (now - self._at))
        self._at = now
        late = behind - self._least
        stop = is_stop(frame)
        # An answer does nothing by itself: as long as it is waited for, it is good however late it comes.
        if late > tables.DATAGRAM_LATE and not stop and not frame.is_reply:
            return f"it is {late:.1f} s late"
        problem = self._window.take(frame.sn)
        if stop and not problem:
            self._window.void()
        return problem

    def is_repeat(self, frame: Frame) -> bool:
        """Note a request; whether it, or a later one of its seq, was there before in a frame of another number."""
        what = hash((frame.cmd, frame.body))
        last = self._requests.get(frame.seq)
        if last is not None:
            ahead = frame.sn - last[0] & _U32
            if ahead >= _HALF or (what == last[1] and ahead < _REPEATS_WITHIN):
                return True
        self._requests[frame.seq] = frame.sn, what
        return False


class Conversations:
    """The conversation that is, and those that may become it.

    A host asks for one by IDENTIFY, and is in it when the answer has come. A board only offers one, since the
    IDENTIFY may be an old copy: it begins with the first frame that bears the number of the offer.

    Args:
        numbers: Source of random numbers.
        host: This side asks; else it answers.

    Attributes:
        current: The conversation that is; None before the first.
        count: How many began.
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
        """The fields sn and type of the next frame.

        Args:
            cmd: Its command.
            kind: Its type where it belongs to no conversation.
            offer: The conversation that it offers; None for the one that is.
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
        """A frame was made with this number, which may be another than `stamp` gave."""
        if not self._host:
            return
        self._sn = sn
        if cmd == Command.IDENTIFY:
            self._asked[sn] = None
            if len(self._asked) > _MOST_OPENING:
                del self._asked[next(iter(self._asked))]

    # -- host ---------------------------------------------------------------------------------------

    def is_answer(self, frame: Frame) -> bool:
        """Whether a reply to IDENTIFY answers one of ours."""
        return frame.type & _U32 in self._asked

    def begin(self, answer: Frame, now: float) -> None:
        """Enter the conversation that an answer offers."""
        self.current = Conversation(answer.sn, answer.type & _U32, now - answer.time, now)
        self.count += 1
        self._news = True
        for sn in list(self._asked):
            del self._asked[sn]
            if sn == self.current.ours:
                break

    # -- board --------------------------------------------------------------------------------------

    def offer(self, identify: Frame, now: float) -> bool:
        """Offer a conversation to whoever asks; False if this very frame was there before."""
        begun = [c.theirs for c in self._offered.values()]
        if identify.sn in begun or (self.current is not None and self.current.theirs == identify.sn):
            return False
        ours = self._numbers()
        self._offered[ours] = Conversation(identify.sn, ours, now - identify.time, now)
        if len(self._offered) > _MOST_OPENING:
            del self._offered[next(iter(self._offered))]
        return True

    def offered_to(self, identify: Frame) -> Conversation | None:
        """The conversation that was offered in answer to an IDENTIFY."""
        return next((c for c in self._offered.values() if c.theirs == identify.sn), None)

    # -- both ---------------------------------------------------------------------------------------

    def take(self, frame: Frame, now: float) -> str:
        """Judge a frame other than IDENTIFY and its answer; returns why it is refused, or an empty text."""
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
            # What was offered before is past; what was offered since may still be taken up.
            for ours in list(self._offered):
                del self._offered[ours]
                if ours == number:
                    break
        return problem

    def has_news(self) -> bool:
        """Whether a good frame of the conversation came since the last call."""
        news, self._news = self._news, False
        return news

    def is_repeat(self, frame: Frame) -> bool:
        """Note a request of the conversation that is; whether it was there before in a frame of another number."""
        return self.current is not None and self.current.is_repeat(frame)

    def is_current(self, frame: Frame) -> bool:
        """Whether a request was made in the conversation that is."""
        return self.current is not None and frame.type & _U32 == self.current.ours


def _signed(number: int) -> int:
    """A number as the field type holds it, which is signed."""
    return (number ^ _HALF) - _HALF
