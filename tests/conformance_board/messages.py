"""A host that sends and receives messages in fragments chunk by chunk, for tests of boards.

Owns nothing but what PROTOCOL.md section 6.10 asks of a host, so that a test can leave out, repeat or spoil any
chunk.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tests.conformance_board.adapter import BoardUnderTest

from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import FragmentHead, parse_missing, serialize_missing
from hexwire.wire.servo_table import ServoTable

__all__ = ["MessageHost", "Sent"]

PATIENCE = 3.0


@dataclass
class Sent:
    """What came back while a message was sent.

    Attributes:
        asks: The chunks of each FRAGMENT_MISSING.
        reply: The reply to the message; None if there was none.
        stray: Replies to FRAGMENT itself.
    """

    asks: list[tuple[int, ...]] = field(default_factory=list)
    reply: Frame | None = None
    stray: list[Frame] = field(default_factory=list)

    @property
    def status(self) -> int:
        assert self.reply is not None, "no reply"
        return self.reply.status


class MessageHost:
    """A host on the line of a board."""

    def __init__(self, board: BoardUnderTest) -> None:
        self.board = board
        self.machine, self.client = board.machine, board.client
        self.number = 0
        self._unread: list[Frame] = []

    def ask(self, cmd: int, body: bytes = b"") -> Frame:
        return self.client.ask(cmd, body, within=2.5)

    def new_id(self) -> int:
        """The id of a new message: its low byte is the sequence number of the request."""
        self.number = (self.number + 1) & 0xFF
        self.client.seq = (self.client.seq + 1) & 0xFF
        return self.number << 8 | self.client.seq

    def put(self, message_id: int, index: int, count: int, cmd: int, chunk: bytes, *, ext: int = 0) -> None:
        """Send one chunk."""
        head = FragmentHead(message_id, index, count, cmd, ext).serialize()
        self.machine.send(self.client.frame(Command.FRAGMENT, head + chunk, seq=self.client.seq))

    def missing(self, message_id: int, *indexes: int) -> None:
        """Send a FRAGMENT_MISSING."""
        body = serialize_missing(message_id, indexes)
        self.machine.send(self.client.frame(Command.FRAGMENT_MISSING, body, seq=self.client.seq))

    def hear(self, message_id: int, sent: Sent, seconds: float) -> tuple[int, ...] | None:
        """Wait for what the board says of a message; returns the chunks that it asks for."""
        end = self.machine.now + seconds
        while self.machine.now < end:
            self._unread = self._unread or self.client.run(0.001)
            while self._unread:
                frame = self._unread.pop(0)
                if frame.is_reply and frame.cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
                    sent.stray.append(frame)
                elif frame.is_reply and frame.seq == message_id & 0xFF:
                    sent.reply = frame
                elif frame.cmd == Command.FRAGMENT_MISSING and not frame.is_reply:
                    assert (frame.cmd_ext, frame.src, frame.dst) == (0, 8, 7)
                    number, indexes = parse_missing(frame.body)
                    assert number == message_id
                    sent.asks.append(indexes)
                    return indexes
            if sent.reply is not None:
                return None
        return None

    def send(
        self,
        cmd: int,
        body: bytes,
        *,
        size: int = 200,
        message_id: int | None = None,
        lose: Callable[[int, int], bool] = lambda index, time: False,
        wait: float = PATIENCE,
    ) -> Sent:
        """Send a message as a host does.

        Args:
            cmd: Its command.
            body: Its body.
            size: Bytes of each chunk.
            message_id: Its id; a new one if None.
            lose: Whether a chunk is lost at its n-th time.
            wait: Seconds to wait for anything.
        """
        number = self.new_id() if message_id is None else message_id
        chunks = [body[at : at + size] for at in range(0, len(body), size)]
        times = [0] * len(chunks)
        sent, due = Sent(), (0,)
        while True:
            for index in due:
                times[index] += 1
                if not lose(index, times[index]):
                    self.put(number, index, len(chunks), cmd, chunks[index])
            asked = self.hear(number, sent, wait)
            if sent.reply is not None or (asked is None and times[0] > 5):
                return sent
            due = (0,) if asked is None else asked  # type: ignore[assignment]  # any number of them

    def read_table(
        self, servo: int, first: int, count: int, *, lose: Callable[[int, int], bool] = lambda index, time: False
    ) -> bytes | Frame:
        """Read registers in a message; the data, or the reply if there is one."""
        self.machine.send(self.client.frame(Command.SERVO_TABLE, ServoTable(servo, first, count).serialize()))
        seq = self.client.seq
        chunks: dict[int, bytes] = {}
        times: dict[int, int] = {}
        head, heard = None, self.machine.now
        end = self.machine.now + PATIENCE
        while self.machine.now < end:
            for frame in self.client.run(0.001):
                if frame.is_reply and frame.seq == seq:
                    return frame
                if frame.cmd == Command.FRAGMENT and not frame.is_reply:
                    head, heard = FragmentHead.parse(frame.body), self.machine.now
                    assert (head.message_id & 0xFF, head.cmd, head.cmd_ext) == (seq, Command.SERVO_TABLE, 0x80)
                    assert (frame.cmd_ext, frame.src, frame.dst) == (0, 8, 7)
                    times[head.number] = times.get(head.number, 0) + 1
                    if not lose(head.number, times[head.number]):
                        chunks[head.number] = frame.body[8:]
            if head is not None and len(chunks) == head.chunks:
                self.missing(head.message_id)
                self.client.run(0.03)
                assert [len(chunks[n]) for n in range(head.chunks - 1)] == [132] * (head.chunks - 1)
                whole = ServoTable.parse(b"".join(chunks[n] for n in range(head.chunks)))
                assert (whole.servo_id, whole.first, whole.count) == (servo, first, count)
                assert len(whole.data) == count
                return whole.data
            if head is not None and self.machine.now - heard > 0.15:
                heard = self.machine.now
                self.missing(head.message_id, *(n for n in range(head.chunks) if n not in chunks))
        raise AssertionError(f"no table: {sorted(chunks)}")
