"""The sending half of a connection: numbers, stamps and serializes frames, and queues them for writing.

Owns the header of sent frames (source, destination, time, frame counter, over datagrams the conversation) and the
queue of frames to write. No I/O; time comes in as `now`.
"""

from __future__ import annotations

from enum import Enum

from hexwire.errors import LocalProtocolError
from hexwire.units import split_time
from hexwire.wire import tables
from hexwire.wire.command_frame import (
    BODY_OFFSET,
    Command,
    Frame,
    command_name,
    max_body,
    parse_frame,
    serialize_frame,
)
from hexwire.wire.commands import FRAGMENT_HEAD_SIZE
from hexwire.wire.tables import EXT_UNSOLICITED, HEADER_FIELDS, PROTO_CHAPTER, PROTO_HEXWIRE, TAIL

from .conversation import Conversation, Conversations, Numbers
from .events import ConnectionCounters
from .fragments import WINDOW, FragmentSender

__all__ = ["FrameMaker", "Role", "clean_frame"]

_OFFSETS = {name: offset for name, _, offset in HEADER_FIELDS}
_SEC, _NSEC, _SN, _SRC = (_OFFSETS[name] for name in ("time_sec", "time_nsec", "sn", "src"))
_ATTEMPTS = 256
"""Attempts to build a frame. The nanoseconds need at most 66 steps, every other field one."""
_SMALLEST_FRAME = 128
"""Smaller limits of a peer are ignored: the reply of a 16-joint board to IDENTIFY needs this size."""


class Role(Enum):
    """End of the line: host or board."""

    HOST = "host"
    BOARD = "board"


class FrameMaker:
    """The sending half of `Connection`, which documents the arguments."""

    def __init__(
        self,
        role: Role,
        *,
        local: int,
        remote: int,
        type: int,
        max_frame: int,
        epoch: float,
        cautious: bool,
        numbers: Numbers | None,
    ) -> None:
        self.role = role
        self.local = local
        self.remote = remote
        self.type = type
        self.epoch = epoch
        self.cautious = cautious
        self.sn = 0
        self.seq = 0
        self.conversations = None if numbers is None else Conversations(numbers, host=role is Role.HOST)
        self.counters = ConnectionCounters()
        self._out: list[bytes] = []
        self._message_count = 0
        self._take_limit(max_frame)

    def build(
        self,
        proto: int,
        cmd: int,
        body: bytes,
        seq: int,
        now: float,
        ext: int = 0,
        dst: int | None = None,
        offer: Conversation | None = None,
    ) -> bytes:
        """Number, stamp and serialize a frame.

        Args:
            proto: Dialect.
            cmd: Command code.
            body: Its body.
            seq: Its command counter.
            now: Seconds, monotonic.
            ext: Flags and status.
            dst: Destination module; `remote` if None.
            offer: The conversation that a reply to IDENTIFY offers; None for the current one.
        """
        kind = self.type
        if self.conversations is None:
            sn = (self.sn + 1) & 0xFFFFFFFF
        else:
            sn, kind = self.conversations.stamp(cmd, kind, offer)
        self.counters.frames_sent += 1
        sec, nsec = split_time(now + self.epoch)
        to = self.remote if dst is None else dst
        frame = Frame(sec, nsec, sn, self.local, to, kind, proto, seq, cmd, body, ext)
        if self.cautious or (proto == PROTO_CHAPTER and self.role is Role.HOST):
            # Whatever the link allows, an old board has a buffer of 254 bytes.
            longest = min(self.max_frame, tables.MAX_SERIAL_FRAME)
            frame, data = clean_frame(frame, longest)
            sn = frame.sn
        else:
            data = serialize_frame(frame, self.max_frame)
        self.sn = sn
        if self.conversations is not None:
            self.conversations.sent(cmd, sn)
        return data

    def build_again(self, data: bytes, now: float) -> bytes:
        """Build a stored frame again with a new number and time; the time shows the host the age of the body."""
        frame = parse_frame(data)
        return self.build(PROTO_HEXWIRE, frame.cmd, frame.body, frame.seq, now, frame.cmd_ext, dst=frame.dst)

    def build_dialect1(self, packet: bytes, now: float, dst: int) -> bytes:
        """Build an answer as the chapter's board does: command 02, its frame counter as seq, no check."""
        self.sn = (self.sn + 1) & 0xFFFFFFFF
        sec, nsec = split_time(now + self.epoch)
        self.counters.frames_sent += 1
        frame = Frame(
            time_sec=sec,
            # The chapter's clock counts milliseconds, and so do its time stamps.
            time_nsec=nsec // 1_000_000 * 1_000_000,
            sn=self.sn,
            src=self.local,
            dst=dst,
            type=self.type,
            proto=PROTO_CHAPTER,
            seq=self.sn & 0xFF,
            cmd=Command.READ,
            body=packet,
        )
        return serialize_frame(frame, self.max_frame)

    # -- frames to write ---------------------------------------------------------------------------

    def data_to_send(self) -> list[bytes]:
        """Take the frames to write now, in order; each is one message on a link that keeps boundaries."""
        out = self._out
        if out:
            self._out = []
        return out

    def report(self, cmd: int, body: bytes, now: float) -> None:
        """Send an unsolicited frame.

        Raises:
            LocalProtocolError: The body does not fit one frame.
        """
        self.seq = (self.seq + 1) & 0xFF
        self._out.append(self.build(PROTO_HEXWIRE, cmd, body, self.seq, now, EXT_UNSOLICITED))

    def reply_dialect1(self, packet: bytes, now: float, *, dst: int = 0) -> None:
        """Send an answer as the chapter's board does: command 02, its frame counter as seq, no check."""
        self._out.append(self.build_dialect1(packet, now, dst))

    def send_chapter(self, cmd: int, body: bytes, now: float) -> bytes:
        """Queue a dialect-1 frame and return it. For the dialect-1 half only."""
        self.seq = (self.seq + 1) & 0xFF
        data = self.build(PROTO_CHAPTER, cmd, body, self.seq, now)
        self._out.append(data)
        return data

    def put(self, data: bytes, *, urgent: bool) -> None:
        """Queue a frame; an urgent one goes before all others."""
        self._out.insert(0 if urgent else len(self._out), data)

    def withhold(self, data: bytes) -> bool:
        """Remove a frame from the queue; returns whether it was too late. For the dialect-1 half only."""
        return self._withhold([data])

    def _withhold(self, frames: list[bytes]) -> bool:
        """Remove frames from the queue; returns whether any was taken to be written before."""
        waiting = [data for data in self._out if any(data is frame for frame in frames)]
        self._out = [data for data in self._out if not any(data is frame for frame in frames)]
        return len(waiting) < len(frames)

    def _send_frame(self, cmd: int, body: bytes, now: float, dst: int | None = None) -> None:
        self._out.append(self.build(PROTO_HEXWIRE, cmd, body, self.seq, now, dst=dst))

    def _send_message(self, cmd: int, ext: int, body: bytes, seq: int, now: float, dst: int | None = None) -> int:
        # The low byte of a message id is the seq of its request, which identifies a fragmented reply.
        self._message_count = (self._message_count + 1) & 0xFF
        message_id = self._message_count << 8 | seq
        for chunk in self._fragments_out.send(message_id, cmd, ext, body, now):
            self._send_frame(Command.FRAGMENT, chunk, now, dst)
        return message_id

    @property
    def longest_body(self) -> int:
        """Bytes of the longest body that fits one frame."""
        return self._max_body

    def limit_frame(self, max_frame: int) -> None:
        """Limit the length of frames to what the peer accepts; longer bodies are sent in fragments."""
        self._take_limit(min(self.max_frame, max(max_frame, _SMALLEST_FRAME)), first=1)

    def _take_limit(self, max_frame: int, *, first: int = WINDOW) -> None:
        self.max_frame = max_frame
        self._max_body = max_body(max_frame)
        # Who accepts short frames only has no room for a whole message either.
        first = first if max_frame <= tables.MAX_SERIAL_FRAME else WINDOW
        self._fragments_out = FragmentSender(self._max_body - FRAGMENT_HEAD_SIZE, first=first)


def clean_frame(frame: Frame, max_frame: int) -> tuple[Frame, bytes]:
    """Build a frame without 0D 0A in bytes 4..len-3, by changing fields that may change.

    These are the nanoseconds (in steps of 1 us), sn (to the next without the marker), and the seconds, which stay
    at the last value without the marker, for 256 s at most on a clock of this century.

    Returns:
        The frame as it is sent, and its bytes.

    Raises:
        LocalProtocolError: 0D 0A is in the body or a module id, which may not change; or the frame is too long.
    """
    body_end = BODY_OFFSET + len(frame.body)
    step = 1000 if frame.time_nsec < 999_000_000 else -1000
    for _ in range(_ATTEMPTS):
        data = serialize_frame(frame, max_frame)
        at = data.find(TAIL, 4, -2)
        if at < 0:
            return frame, data
        if at < _NSEC - 1:
            low = 8 * (at - _SEC)
            frame = frame._replace(time_sec=(frame.time_sec >> low << low) - 1)
        elif at < _SN - 1 or body_end - 1 <= at <= body_end:
            # The check of dialect 2 too: it changes with the time.
            frame = frame._replace(time_nsec=frame.time_nsec + step)
        elif at < _SRC:
            low = 8 * max(at - _SN, 0)
            frame = frame._replace(sn=((frame.sn >> low) + 1 << low) & 0xFFFFFFFF)
        else:
            break
    raise LocalProtocolError(
        f"{command_name(frame.cmd)} has 0D 0A inside, where a dialect-{PROTO_CHAPTER} board would cut it"
    )
