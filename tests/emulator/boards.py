"""A host made of nothing but frames, for tests of emulated boards in simulated time."""

from __future__ import annotations

from tests.frames import frame_bytes

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.session.decoder import FrameDecoder
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.commands import ALL_FIELDS, JointReport, MoveRequest, MoveRow

HOST, BOARD = 7, 8
ALL = 0x7F


class Bench:
    """A board, the time, and what it sent."""

    def __init__(self, board: EmulatedBoard | None = None, **options: object) -> None:
        self.board = board or make_hex7bot_board(**options)  # type: ignore[arg-type]  # the caller's keywords
        self.now = 0.0
        self.seq = 0
        self.frames: list[tuple[float, Frame]] = []
        self.bus_sent: list[tuple[float, bytes]] = []
        self._decoder = FrameDecoder()
        transact = self.board.wire.transact

        def noted(packet: bytes, now: float) -> tuple[bytes, float]:
            self.bus_sent.append((now, packet))
            return transact(packet, now)

        self.board.wire.transact = noted  # type: ignore[method-assign]  # eyes on the wire

    def send(self, cmd: int, body: bytes = b"", *, proto: int = 2, seq: int | None = None, dst: int = BOARD) -> int:
        if seq is None:
            self.seq = seq = (self.seq + 1) & 0xFF
        data = frame_bytes(cmd, body, proto=proto, seq=seq, src=HOST, dst=dst)
        self.send_raw(data)
        return seq

    def send_raw(self, data: bytes) -> None:
        self.board.receive(data, self.now)
        self._collect()

    def run(self, seconds: float, *, slice: float = 1e9) -> None:
        end = self.now + seconds
        while self.now < end:
            due = self.board.next_event_time()
            target = min(end, self.now + slice) if due is None else min(end, self.now + slice, due)
            self.now = target if target > self.now else min(end, self.now + 1e-6)
            self.board.step(self.now)
            self._collect()

    def _collect(self) -> None:
        self._decoder.receive(self.board.data_to_send(), self.now)
        while (event := self._decoder.next_event()) is not None:
            assert isinstance(event, Frame), event
            self.frames.append((self.now, event))

    def take(self) -> list[Frame]:
        frames, self.frames = [frame for _, frame in self.frames], []
        return frames

    def wait(self, cmd: int, seq: int, window: float = 1.0) -> Frame:
        end = self.now + window
        while True:
            for i, (_, frame) in enumerate(self.frames):
                if frame.is_reply and frame.cmd == cmd and frame.seq == seq:
                    del self.frames[i]
                    return frame
            assert self.now < end, f"no reply to {cmd:#x}"
            self.run(0.001)

    def ask(self, cmd: int, body: bytes = b"", window: float = 1.0) -> Frame:
        """A dialect-2 request and its reply."""
        seq = self.send(cmd, body)
        return self.wait(cmd, seq, window)

    def ask1(self, cmd: int, packet: bytes, window: float = 1.0) -> bytes:
        """A dialect-1 request and the packet that answers it."""
        before = len(self.frames)
        self.send(cmd, packet, proto=1)
        end = self.now + window
        while len(self.frames) == before and self.now < end:
            self.run(0.001)
        assert len(self.frames) > before, "no reply"
        return self.frames.pop()[1].body

    def state(self, fields: int = ALL_FIELDS) -> JointReport:
        reply = self.ask(Command.JOINT_STATE, bytes((fields,)))
        assert reply.status == 0
        return JointReport.parse(reply.body)

    def torque(self, on: bool = True, mask: int = ALL) -> Frame:
        return self.ask(Command.TORQUE, bytes((on, mask, 0)))

    def move(self, targets: dict[int, int], ms: int = 1000) -> Frame:
        rows = tuple(MoveRow(*row) for row in targets.items())
        return self.ask(Command.JOINT_MOVE, MoveRequest(ms, rows).serialize())

    def writes(self) -> list[bytes]:
        """Packets on the bus that changed something, since the last call."""
        sent, self.bus_sent = self.bus_sent, []
        return [packet for _, packet in sent if packet[4] not in (0x01, 0x02, 0x82)]

    def true_positions(self) -> list[float]:
        """Where the shafts really are."""
        self.board.wire.step(self.now)
        return [self.board.wire[i].motion.position for i in range(7)]

    def torques(self) -> list[bool]:
        return [self.board.wire[i].torque_on for i in range(7)]


def u16(value: int) -> bytes:
    return value.to_bytes(2, "little")


STOPPED_FLAG = tables.BOARD_FLAGS_STOPPED
