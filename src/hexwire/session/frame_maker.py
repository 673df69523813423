"""The sending half of a connection that has no memory of requests: it numbers, stamps and serializes frames.

Owns the header of what is sent: who, to whom, when, the frame counter, and over datagrams the conversation.
Sans I/O; time comes in as `now`.
"""

from __future__ import annotations

from enum import Enum

from hexwire.units import split_time
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, parse_frame, serialize_frame
from hexwire.wire.tables import PROTO_CHAPTER, PROTO_HEXWIRE

from .conversation import Conversation, Conversations, Numbers
from .dialect1 import clean_frame
from .events import ConnectionCounters

__all__ = ["FrameMaker", "Role"]


class Role(Enum):
    """Which end of the line this is."""

    HOST = "host"
    BOARD = "board"


class FrameMaker:
    """What `Connection` sends with; see there for the arguments."""

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
        self.max_frame = max_frame
        self.epoch = epoch
        self.cautious = cautious
        self.sn = 0
        self.conversations = None if numbers is None else Conversations(numbers, host=role is Role.HOST)
        self.counters = ConnectionCounters()

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
            dst: Module it goes to; `remote` if None.
            offer: The conversation that an answer to IDENTIFY offers; None for the one that is.
        """
        kind = self.type
        if self.conversations is None:
            sn = (self.sn + 1) & 0xFFFFFFFF
        else:
            sn, kind = self.conversations.stamp(cmd, kind, offer)
        self.counters.frames_sent += 1
        sec, nsec = split_time(now + self.epoch)
        to = self.remote if dst is None else dst
        if self.cautious or (proto == PROTO_CHAPTER and self.role is Role.HOST):
            # Whatever the link takes, an old board behind it has a buffer of 254 bytes.
            longest = min(self.max_frame, tables.MAX_SERIAL_FRAME)
            data, sn = clean_frame(proto, cmd, body, seq, sn, self.local, to, kind, sec, nsec, ext, longest)
        else:
            data = serialize_frame(
                proto=proto,
                cmd=cmd,
                body=body,
                seq=seq,
                sn=sn,
                src=self.local,
                dst=to,
                type=kind,
                time_sec=sec,
                time_nsec=nsec,
                cmd_ext=ext,
                max_frame=self.max_frame,
            )
        self.sn = sn
        if self.conversations is not None:
            self.conversations.sent(cmd, sn)
        return data

    def build_again(self, data: bytes, now: float) -> bytes:
        """A stored frame with a new number and time: by its time the host knows how old its body is."""
        frame = parse_frame(data)
        return self.build(PROTO_HEXWIRE, frame.cmd, frame.body, frame.seq, now, frame.cmd_ext, dst=frame.dst)

    def build_dialect1(self, packet: bytes, now: float, dst: int) -> bytes:
        """An answer as the chapter's board makes it: command 02, its own count as seq, no check."""
        self.sn = (self.sn + 1) & 0xFFFFFFFF
        sec, nsec = split_time(now + self.epoch)
        self.counters.frames_sent += 1
        return serialize_frame(
            proto=PROTO_CHAPTER,
            cmd=Command.READ,
            body=packet,
            seq=self.sn & 0xFF,
            sn=self.sn,
            src=self.local,
            dst=dst,
            type=self.type,
            time_sec=sec,
            # The chapter's clock counts milliseconds, and so do its time stamps.
            time_nsec=nsec // 1_000_000 * 1_000_000,
            max_frame=self.max_frame,
        )
