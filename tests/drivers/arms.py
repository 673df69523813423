"""An arm in simulated time, and eyes on what goes over its line."""

from __future__ import annotations

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.board_chapter import SketchReceiver
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.wire.command_frame import Command, Frame, parse_frame
from hexwire.wire.servo_packet import Instruction, parse_packet, parse_sync_write


class Arm:
    """A driver, its emulated board and the time."""

    def __init__(
        self,
        dialect: int = 2,
        baud: int = 0,
        faults: tuple[str, ...] = (),
        *,
        seed: int = 0,
        start: float = 1000.0,
        policy: RetryPolicy | None = None,
        reconnect: ReconnectPolicy | None = None,
        attach: bool = True,
    ) -> None:
        self.clock = FakeClock(start)
        self.board: EmulatedBoard = make_hex7bot_board(
            dialect=dialect, baud=baud, faults=faults, seed=seed, start=start
        )
        self.link = BoardLink(self.board, self.clock, baud=baud)
        session = Session(IpcHandle.from_link(self.link), policy=policy, reconnect=reconnect)
        self.driver = Hex7BotDriver(session, boot_window=20.0)
        if attach:
            self.driver.attach()

    def wait(self, seconds: float) -> None:
        """Let time pass for everybody."""
        end = self.clock.time + seconds
        while self.clock.time < end:
            due = self.board.next_event_time()
            step = end if due is None else min(end, max(due, self.clock.time + 1e-6))
            self.clock.time = step
            self.board.step(step)

    def shaft(self, i: int) -> float:
        """Where a shaft really is, counts."""
        self.board.wire.step(self.clock.time)
        return self.board.wire[i].motion.position

    def shafts(self) -> list[float]:
        return [self.shaft(i) for i in range(7)]

    def torques(self) -> list[bool]:
        return [self.board.wire[i].torque_on for i in range(7)]

    def frames(self) -> list[Frame]:
        """What the host wrote, in frames."""
        return [parse_frame(data) for data in self.link.written]

    def commands(self) -> list[int]:
        return [frame.cmd for frame in self.frames()]


def check_old_board_survives(written: list[bytes]) -> None:
    """What PROTOCOL.md section 5 asks of a host toward a board that knows only dialect 1."""
    sketch = SketchReceiver()
    for data in written:
        sketch.put(data, busy=False)
        taken = sketch.next_frame()
        assert taken is not None, data.hex(" ")
        assert (taken.length, taken.data[: len(data)]) == (len(data), data)
        assert sketch.waiting == 0
        assert len(data) <= 253
        frame = parse_frame(data)
        if frame.proto == 2:
            assert frame.cmd == Command.IDENTIFY
            continue
        packet = parse_packet(frame.body)
        if frame.cmd == Command.SYNC_WRITE:
            address, rows = parse_sync_write(packet)
            assert address == 0x2A
            assert all(servo_id < 4 and len(row) == 4 for servo_id, row in rows)
            continue
        assert len(frame.body) <= 63
        assert packet.servo_id != 0xFE
        assert packet.instruction in (Instruction.PING, Instruction.READ, Instruction.WRITE)
        if packet.instruction == Instruction.READ:
            assert packet.params[1] == 2
        if packet.instruction == Instruction.WRITE and packet.params[0] == 0x2A:
            assert packet.servo_id < 4
