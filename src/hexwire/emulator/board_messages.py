"""Messages in fragments on an emulated board, which has no room to assemble them (PROTOCOL.md section 6.10).

Owns the message under way in each direction: which chunk is next, what is asked for, how long it is kept, and what
a stop does to it. What the bytes mean belongs to the commands that take them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

from hexwire.errors import RemoteProtocolError
from hexwire.session.connection import Connection
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE, FragmentHead, parse_missing, serialize_missing
from hexwire.wire.servo_table import TABLE_HEAD_SIZE, ServoTable
from hexwire.wire.tables import EXT_REPLY

from .board_bus import Clock, Job, Wait
from .board_table import BoardTable, TableMessage
from .board_trajectory import PointsMessage
from .gate import RefusedError

__all__ = ["BoardMessages"]

_ASKS_FOR = 2
"""Chunks that the board asks for at a time."""
_CHUNK = 132
"""Bytes of a chunk that the board sends."""


@dataclass(slots=True)
class _MessageTaken:
    src: int
    head: FragmentHead
    consumer: TableMessage | PointsMessage
    size: int
    last_size: int
    next: int = 0
    asked_to: int = 0
    used_at: float = 0.0
    asked_at: float = 0.0
    working: bool = False

    @property
    def key(self) -> tuple[int, int, int]:
        return self.src, self.head.message_id & 0xFF, self.head.cmd


@dataclass(slots=True)
class _TableSent:
    request: Frame
    message_id: int
    asked: ServoTable
    sent_at: float

    @property
    def chunks(self) -> int:
        return -(-(TABLE_HEAD_SIZE + self.asked.count) // _CHUNK)


class BoardMessages:
    """The messages of one board.

    Args:
        connection: Where answers go.
        clock: The board's time.
        table: Register tables of its servos.
        consumers: What takes the body of each command that may come in fragments.
    """

    def __init__(
        self,
        connection: Connection,
        clock: Clock,
        table: BoardTable,
        consumers: dict[int, Callable[[], TableMessage | PointsMessage]],
    ) -> None:
        self._connection = connection
        self._clock = clock
        self._table = table
        self._consumers = consumers
        self._in: _MessageTaken | None = None
        self._finished: tuple[int, int, int, float] | None = None
        self._voided: dict[tuple[int, int, int], float] = {}
        self._out: _TableSent | None = None
        self._count = 0

    @property
    def streams_points(self) -> bool:
        """Whether points of a trajectory are under way."""
        return self._in is not None and self._in.head.cmd == Command.TRAJECTORY_POINTS

    # -- time -----------------------------------------------------------------------------------------

    def next_timeout(self) -> float | None:
        """When `handle_timeout` has something to do; None if never."""
        message = self._in
        if message is None or message.working:
            return None
        again = max(message.used_at, message.asked_at) + tables.FRAGMENT_AGAIN
        return min(again, message.used_at + tables.FRAGMENT_LIFETIME)

    def handle_timeout(self, now: float) -> None:
        """Drop what is too old, and ask again."""
        message = self._in
        if message is not None and not message.working:
            if now >= message.used_at + tables.FRAGMENT_LIFETIME:
                self.drop_incoming()
            elif now >= max(message.used_at, message.asked_at) + tables.FRAGMENT_AGAIN:
                self._ask(message)
        if self._out is not None and now >= self._out.sent_at + tables.FRAGMENT_LIFETIME:
            self._out = None

    # -- what ends messages ---------------------------------------------------------------------------

    def identified(self, src: int) -> None:
        """IDENTIFY of a host: nothing of an earlier program of it continues."""
        if self._in is not None and self._in.src == src:
            self.drop_incoming()
        if self._finished is not None and self._finished[0] == src:
            self._finished = None
        if self._out is not None and self._out.request.src == src:
            self._out = None
        self._voided = {key: when for key, when in self._voided.items() if key[0] != src}

    def stop(self) -> None:
        """A stop voids what is under way."""
        message, self._out = self._in, None
        if message is not None:
            self._void(message.src, message.head)

    def void(self, frame: Frame) -> None:
        """A stop came while a FRAGMENT waited in the queue."""
        try:
            head = FragmentHead.parse(frame.body)
        except RemoteProtocolError:
            self._connection.answer(frame, Status.STOPPED, b"", self._clock())
        else:
            self._void(frame.src, head)

    def _void(self, src: int, head: FragmentHead) -> None:
        key, now = (src, head.message_id & 0xFF, head.cmd), self._clock()
        if self._in is not None and self._in.key == key:
            self.drop_incoming()
        if self._voided.get(key) != now:
            young = now - tables.FRAGMENT_LIFETIME
            self._voided = {k: when for k, when in self._voided.items() if when > young} | {key: now}
            self._answer(src, head, Status.STOPPED)

    def drop_incoming(self) -> None:
        """Forget the message that comes in, without an answer."""
        message, self._in = self._in, None
        if message is not None:
            message.consumer.drop()

    # -- to the board ---------------------------------------------------------------------------------

    def fragment(self, request: Request) -> Job:
        """One FRAGMENT."""
        frame, body, now = request.frame, request.frame.body, self._clock()
        if len(body) < FRAGMENT_HEAD_SIZE:
            self._connection.answer(frame, Status.BAD_LENGTH, b"", now)
            return
        try:
            head = FragmentHead.parse(body)
        except RemoteProtocolError:
            head = None
        if head is None or head.cmd_ext:
            self._connection.answer(frame, Status.BAD_RANGE, b"", now)
            return
        self.handle_timeout(now)
        chunk = body[FRAGMENT_HEAD_SIZE:]
        voided = self._voided.get((frame.src, head.message_id & 0xFF, head.cmd))
        if voided is not None and now - voided < tables.FRAGMENT_LIFETIME:
            self._answer(frame.src, head, Status.STOPPED)
        elif (message := self._under_way(frame.src, head)) is not None:
            if head.number == message.next:
                yield from self._use(message, chunk)
        elif self._was_finished(frame.src, head, now):
            self._send_missing(frame.src, head.message_id, ())
            if head.number == 0:
                self._connection.answer_again(
                    frame._replace(cmd=head.cmd, seq=head.message_id & 0xFF), self._clock()
                )
        elif self._in is not None and self._in.src != frame.src:
            self._answer(frame.src, head, Status.BUSY)
        elif head.number:
            self._send_missing(frame.src, head.message_id, (0,))
        else:
            yield from self._begin(frame.src, head, chunk)

    def _under_way(self, src: int, head: FragmentHead) -> _MessageTaken | None:
        message = self._in
        if message is None or message.src != src:
            return None
        mine = (message.head.message_id, message.head.cmd, message.head.chunks)
        return message if mine == (head.message_id, head.cmd, head.chunks) else None

    def _was_finished(self, src: int, head: FragmentHead, now: float) -> bool:
        done = self._finished
        if done is None or now - done[3] >= tables.FRAGMENT_LIFETIME:
            return False
        return done[:3] == (src, head.message_id, head.cmd)

    def _begin(self, src: int, head: FragmentHead, chunk: bytes) -> Job:
        self.drop_incoming()
        make = self._consumers.get(head.cmd)
        if make is None:
            self._answer(src, head, Status.NOT_SUPPORTED)
            return
        message = _MessageTaken(src, head, make(), len(chunk), 0)
        self._in = message
        yield from self._use(message, chunk)

    def _use(self, message: _MessageTaken, chunk: bytes) -> Job:
        """Use the next chunk, and answer the message if it was the last, or is refused."""
        message.working = True
        status, body = Status.OK, b""
        try:
            yield from self._consume(message, chunk)
            if self._in is not message:
                # The command itself has dropped it.
                return
            if message.next == message.head.chunks:
                body = message.consumer.finish()
        except RefusedError as refused:
            status = refused.status
        except RemoteProtocolError:
            status = Status.BAD_LENGTH
        finally:
            message.working = False
        if status == Status.OK and message.next < message.head.chunks:
            if message.next > message.asked_to:
                self._ask(message)
            return
        if status == Status.OK:
            self._in = None
            self._finished = (message.src, message.head.message_id, message.head.cmd, self._clock())
            self._send_missing(message.src, message.head.message_id, ())
        else:
            self.drop_incoming()
        self._reply(message.src, message.head, status, body)

    def _consume(self, message: _MessageTaken, chunk: bytes) -> Job:
        consumer, head = message.consumer, message.head

        def check_length(whole: int) -> None:
            count = -(-whole // message.size)
            message.last_size = whole - (count - 1) * message.size
            if count != head.chunks or (count == 1 and len(chunk) != whole):
                raise RefusedError(Status.BAD_LENGTH)

        data = chunk
        if message.next == 0:
            if len(chunk) < consumer.head_size:
                raise RefusedError(Status.BAD_LENGTH)
            consumer.begin(chunk[: consumer.head_size], check_length)
            data = chunk[consumer.head_size :]
        else:
            last = message.next == head.chunks - 1
            if len(chunk) != (message.last_size if last else message.size):
                raise RefusedError(Status.BAD_LENGTH)
        yield from consumer.take(data)
        message.used_at = self._clock()
        message.next += 1

    def _ask(self, message: _MessageTaken) -> None:
        end = min(message.next + _ASKS_FOR, message.head.chunks)
        message.asked_to = end - 1
        message.asked_at = self._clock()
        self._send_missing(message.src, message.head.message_id, tuple(range(message.next, end)))

    # -- from the board -------------------------------------------------------------------------------

    def table(self, request: Request) -> Job:
        """One SERVO_TABLE in a frame.

        Raises:
            RefusedError: It is refused, or failed.
        """
        frame = request.frame
        asked = ServoTable.parse(frame.body)
        joint = self._table.check_range(asked)
        if asked.data:
            self._table.check_write()
            if len(asked.data) != asked.count:
                raise RefusedError(Status.BAD_LENGTH)
            yield from self._table.write(joint, asked.first, asked.data)
            body = replace(asked, data=b"").serialize()
        else:
            if self._table.is_busy:
                raise RefusedError(Status.BUSY)
            if TABLE_HEAD_SIZE + asked.count > _CHUNK:
                yield from self._send_table(frame, asked)
                return
            data = yield from self._table.read(joint, asked.first, asked.count)
            body = replace(asked, data=data).serialize()
        self._connection.reply(request, Status.OK, body, self._clock())

    def _send_table(self, frame: Frame, asked: ServoTable) -> Job:
        self.handle_timeout(self._clock())
        if self._out is not None and self._out.request.src != frame.src:
            raise RefusedError(Status.BUSY)
        self._count = (self._count + 1) & 0xFF
        message = self._out = _TableSent(frame, self._count << 8 | frame.seq, asked, self._clock())
        yield from self._send_chunks(message, range(message.chunks))
        # It is not stored: a repeat is executed again.
        self._connection.done(frame)

    def missing(self, request: Request) -> Job:
        """One FRAGMENT_MISSING."""
        frame = request.frame
        try:
            message_id, indexes = parse_missing(frame.body)
        except RemoteProtocolError:
            self._connection.answer(frame, Status.BAD_LENGTH, b"", self._clock())
            return
        self.handle_timeout(self._clock())
        message = self._out
        known = message is not None and (message.request.src, message.message_id) == (frame.src, message_id)
        if message is None or not known or self._table.is_busy:
            return
        if not indexes:
            self._out = None
            return
        try:
            yield from self._send_chunks(message, sorted({i for i in indexes if i < message.chunks}))
        except RefusedError as refused:
            self._connection.answer(message.request, refused.status, b"", self._clock())

    def _send_chunks(self, message: _TableSent, indexes: range | list[int]) -> Generator[Wait, bytes | None, None]:
        asked = message.asked
        joint = self._table.check_range(asked)
        try:
            for index in indexes:
                start = max(index * _CHUNK - TABLE_HEAD_SIZE, 0)
                end = min((index + 1) * _CHUNK - TABLE_HEAD_SIZE, asked.count)
                data = yield from self._table.read(joint, asked.first + start, end - start)
                chunk = data if index else replace(asked, data=data).serialize()
                head = FragmentHead(
                    message.message_id, index, message.chunks, Command.SERVO_TABLE, EXT_REPLY | Status.OK
                )
                now = message.sent_at = self._clock()
                body = head.serialize() + chunk
                self._connection.send_fragment(Command.FRAGMENT, body, message.request.src, now)
        except RefusedError:
            self._out = None
            raise

    # -- answers --------------------------------------------------------------------------------------

    def _send_missing(self, src: int, message_id: int, indexes: tuple[int, ...]) -> None:
        body = serialize_missing(message_id, indexes)
        self._connection.send_fragment(Command.FRAGMENT_MISSING, body, src, self._clock())

    def _as_request(self, src: int, head: FragmentHead) -> Frame:
        local, kind = self._connection.local, self._connection.request_type
        return Frame(0, 0, 0, src, local, kind, tables.PROTO_HEXWIRE, head.message_id & 0xFF, head.cmd, b"")

    def _answer(self, src: int, head: FragmentHead, status: Status) -> None:
        """Answer a message that is not executed."""
        self._connection.answer(self._as_request(src, head), status, b"", self._clock())

    def _reply(self, src: int, head: FragmentHead, status: Status, body: bytes) -> None:
        """Answer a message; the answer is stored."""
        self._connection.reply(Request(self._as_request(src, head)), status, body, self._clock())
