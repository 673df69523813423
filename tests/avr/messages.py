"""A host of messages in fragments (PROTOCOL.md section 6.10), over a line that may lose some of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tests.avr.client import BOARD, HOST, Client
from tests.frames import frame_bytes

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, parse_missing, serialize_missing

Lost = Callable[[], bool]
STEP = 0.002


def nothing_lost() -> bool:
    return False


class MessageHost:
    """Sends messages to a board, and joins those that come from it.

    Args:
        client: The line.
        lost: Asked for every frame of a message, either way, whether the line loses it.

    Attributes:
        asked: The indices in each FRAGMENT_MISSING of the board, in the order in which they came.
    """

    def __init__(self, client: Client, lost: Lost = nothing_lost, src: int = HOST) -> None:
        self.client = client
        self.lost = lost
        self.src = src
        self.asked: list[tuple[int, ...]] = []
        self._number = 0

    def chunk(
        self, message_id: int, index: int, count: int, cmd: int, data: bytes, *, cmd_ext: int = 0, dst: int = BOARD
    ) -> None:
        """Put one chunk on the line."""
        body = FragmentHead(message_id, index, count, cmd, cmd_ext).serialize() + data
        self.client.sn += 1
        self.client.machine.send(
            frame_bytes(Command.FRAGMENT, body, seq=99, sn=self.client.sn, src=self.src, dst=dst, time_nsec=0)
        )

    def missing(self, message_id: int, *indices: int) -> None:
        """Ask the board for chunks; for none: it has all."""
        body = serialize_missing(message_id, indices)
        self.client.sn += 1
        self.client.machine.send(
            frame_bytes(Command.FRAGMENT_MISSING, body, seq=98, sn=self.client.sn, src=self.src, time_nsec=0)
        )

    def new_id(self) -> int:
        """The id of the next message; its low byte is a new seq."""
        self._number += 1
        self.client.seq = (self.client.seq + 1) & 0xFF
        return self._number << 8 | self.client.seq

    def run(self, seconds: float) -> Iterator[Frame]:
        """Let time pass; what came to this host meanwhile."""
        for frame in self.client.run(seconds):
            if frame.dst == self.src and not frame.cmd_ext & tables.EXT_UNSOLICITED:
                yield frame

    def send(self, cmd: int, body: bytes, size: int = 200, *, within: float = 4.0) -> Frame:
        """Send a message in chunks of that size; the reply to it."""
        message = self.new_id()
        chunks = [body[at : at + size] for at in range(0, len(body), size)]
        wanted = [0]
        begun = self.client.machine.now
        heard = begun
        while self.client.machine.now - begun < within:
            for index in wanted:
                if not self.lost():
                    self.chunk(message, index, len(chunks), cmd, chunks[index])
            wanted = []
            for frame in self.run(STEP):
                if self.lost():
                    continue
                heard = self.client.machine.now
                if frame.cmd == Command.FRAGMENT_MISSING:
                    number, indices = parse_missing(frame.body)
                    assert number == message
                    assert frame.cmd_ext == 0
                    self.asked.append(indices)
                    wanted += indices
                elif frame.is_reply and frame.seq == message & 0xFF:
                    assert frame.cmd == cmd
                    return frame
            if self.client.machine.now - heard > 0.3:
                heard = self.client.machine.now
                wanted = [0]
        raise AssertionError(f"no reply to message {message:04X} within {within} s")

    def ask(self, cmd: int, body: bytes, *, within: float = 4.0) -> tuple[Frame, bytes]:
        """The reply to a request, joined if it came in fragments: its last frame, and the body."""
        self.client.seq = (self.client.seq + 1) & 0xFF
        request = self.client.frame(cmd, body, seq=self.client.seq)
        parts: dict[int, dict[int, bytes]] = {}
        begun = self.client.machine.now
        asked = sent = -1.0
        while self.client.machine.now - begun < within:
            now = self.client.machine.now
            if not parts and now - sent > 0.4:
                sent = now
                if not self.lost():
                    self.client.machine.send(request)
            for frame in self.run(STEP):
                if self.lost():
                    continue
                if frame.is_reply and frame.seq == self.client.seq:
                    return frame, frame.body
                if frame.cmd != Command.FRAGMENT:
                    continue
                head = FragmentHead.parse(frame.body)
                assert head.message_id & 0xFF == self.client.seq
                assert (head.cmd, head.cmd_ext, frame.cmd_ext) == (cmd, tables.EXT_REPLY, 0)
                chunks = parts.setdefault(head.message_id, {})
                chunks[head.number] = frame.body[FRAGMENT_HEAD_SIZE:]
                asked = self.client.machine.now
                if len(chunks) == head.chunks:
                    self.missing(head.message_id)
                    return frame, b"".join(chunks[i] for i in range(head.chunks))
            if parts and self.client.machine.now - asked > 0.1:
                asked = self.client.machine.now
                message, chunks = next(iter(parts.items()))
                absent = [i for i in range(2) if i not in chunks]
                if not self.lost():
                    self.missing(message, *absent)
        raise AssertionError(f"no whole reply within {within} s")
