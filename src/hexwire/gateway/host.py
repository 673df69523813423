"""The hosts of a gateway: what each has sent so far, what waits for it, and the hosts that share a queue.

Owns also PROTOCOL.md section 6.6 for a gateway: whose frames count, and the numbers of those that go up; the boards
below it are on streams and know nothing of conversations. No I/O; time and random numbers come in. Must not know
boards, nor the link to a host.
"""

from __future__ import annotations

from collections.abc import Iterable

from hexwire.session.conversation import Conversations, Numbers, is_stop
from hexwire.session.decoder import FrameDecoder
from hexwire.session.fragments import FragmentReceiver
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.tables import PROTO_HEXWIRE

__all__ = ["Host", "QueueHost"]


class Host:
    """One host's side of a stream.

    Args:
        name: Who it is, for those whom it keeps out.
        modules: Ids of the boards.

    Attributes:
        in_messages: Its link keeps messages and their boundaries, so that it has conversations.
    """

    in_messages = False

    def __init__(self, name: str, modules: Iterable[int]) -> None:
        self.name = name
        self.decoder = FrameDecoder(tables.MAX_NETWORK_FRAME)
        self.messages = {module: FragmentReceiver() for module in modules}
        self.asker: Frame | None = None
        self.out: list[bytes] = []

    @property
    def generation(self) -> int:
        """Number of hosts that this side has had before: another number is another host."""
        return 0

    def forget(self) -> None:
        """The host is gone, and another one may take its side: nothing of it continues."""
        for receiver in self.messages.values():
            receiver.forget()
        self.asker = None
        self.out.clear()

    def takes(self, frame: Frame, now: float) -> bool:
        """Whether a frame counts that has arrived; a stream carries none that is old."""
        return True

    def send(self, frames: Iterable[Frame]) -> None:
        """Queue frames for it."""
        self.out += (serialize_frame(frame, tables.MAX_NETWORK_FRAME) for frame in frames)


_CHUNKS = frozenset((Command.FRAGMENT, Command.FRAGMENT_MISSING))


class QueueHost(Host):
    """A queue's side: at any time the host whose conversation is the present one.

    Args:
        name: The queue, for those whom its host keeps out.
        modules: Ids of the boards.
        numbers: Source of random numbers, as `Conversations` takes it.
    """

    in_messages = True

    def __init__(self, name: str, modules: Iterable[int], numbers: Numbers) -> None:
        super().__init__(name, modules)
        self._numbers = numbers
        self._before = 0
        self._begin()

    @property
    def generation(self) -> int:
        return self._before + self._conversations.count

    @property
    def is_heard(self) -> bool:
        """Whether somebody has asked for a conversation, or has one."""
        return bool(self._asked) or self._conversations.current is not None

    def forget(self) -> None:
        super().forget()
        self._before = self.generation
        self._begin()

    def _begin(self) -> None:
        self._conversations = Conversations(self._numbers, host=False)
        # IDENTIFY by src and seq: its answer offers the conversation.
        self._asked: dict[tuple[int, int], Frame] = {}
        self._done: dict[int, tuple[Frame, float, int]] = {}
        self._requests = 0

    def takes(self, frame: Frame, now: float) -> bool:
        if frame.proto != PROTO_HEXWIRE or frame.cmd_ext:
            return False
        if frame.cmd == Command.IDENTIFY:
            if not self._conversations.offer(frame, now):
                return False
            self._asked.pop((frame.src, frame.seq), None)
            self._asked[frame.src, frame.seq] = frame
            if len(self._asked) > tables.STORED_REPLIES:
                del self._asked[next(iter(self._asked))]
            return True
        begun = self._conversations.count
        if self._conversations.take(frame, now):
            return False
        if self._conversations.count != begun:
            super().forget()
            self._done.clear()
        return not self._is_old(frame, now)

    def _is_old(self, frame: Frame, now: float) -> bool:
        """Whether the board might execute a repeat again, since it stores requests for a while only."""
        if frame.cmd in _CHUNKS:
            return False
        if not self._conversations.is_repeat(frame):
            self._requests += 1
            self._done[frame.seq] = frame, now, self._requests
            return False
        first, when, number = self._done[frame.seq]
        if (first.cmd, first.body) != (frame.cmd, frame.body):
            return True
        stored = now - when < tables.REPEAT_WINDOW and self._requests - number < tables.STORED_REPLIES
        return not stored and not is_stop(frame)

    def send(self, frames: Iterable[Frame]) -> None:
        super().send(numbered for frame in frames if (numbered := self._numbered(frame)) is not None)

    def _numbered(self, frame: Frame) -> Frame | None:
        """A frame in the conversation that it belongs to; None if there is none. The board's clock stays."""
        offer = None
        if frame.cmd == Command.IDENTIFY and frame.is_reply:
            asked = self._asked.get((frame.dst, frame.seq))
            offer = None if asked is None else self._conversations.offered_to(asked)
        elif self._conversations.current is not None:
            offer = self._conversations.current
        if offer is None:
            return None
        sn, kind = self._conversations.stamp(frame.cmd, frame.type, offer)
        return frame._replace(sn=sn, type=kind)
