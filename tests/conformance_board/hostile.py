"""Random conversations of a hostile host with a board, and what must hold whatever it sends.

Owns the generator of sequences and the eyes on the servos. Every frame is sound; what it says is not. The rules:

- after a stop no target, torque or mode of a servo changes until RESUME is sent, but torque being taken away;
- in dialect 2 no joint has torque or moves that was never given torque by TORQUE;
- no joint leaves its limits, and no target is written that breaks its speed limit;
- no setting of a servo changes but in maintenance, and there nothing has torque.

Run it by itself for as long as you like: ``python -m tests.conformance_board.hostile emulator 2000``.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from tests.conformance_board.adapter import BoardUnderTest

from hexwire.emulator.servo import EmulatedServo
from hexwire.wire import tables
from hexwire.wire.addresses import Multicast
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import FragmentHead, JointReport, LimitRow, LimitTable
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import Instruction, ServoPacket, iter_packets, make_packet, parse_sync_write
from hexwire.wire.servo_table import ServoTable

__all__ = ["Kind", "Watch", "play", "sequence"]

LOW, HIGH = 1000, 3100
_STEP = 0.005
_STOP_TIME = 0.7
"""A hold may look for 0.4 s, and then takes torque; the line and the bus need some time besides."""
_BYTE = 10 / 115200
_IDS = (0, 1, 2, 3, 4, 5, 6)
_HARMLESS_SETTINGS = (0x21, 0x22, 0x23, 0x24, 0x13, 0x14, 0x37)
_READS = (Instruction.PING, Instruction.READ, Instruction.SYNC_READ)


@dataclass(frozen=True)
class Kind:
    """What a sequence may contain besides everything of dialect 2.

    Attributes:
        chapter: Frames of dialect 1 too.
        maintenance: MAINTENANCE too, and then no settings that change which servo is where.
    """

    chapter: bool = False
    maintenance: bool = False


@dataclass
class Step:
    """One thing that the host does: a frame, an old frame again, or nothing for a while."""

    cmd: int = -1
    body: bytes = b""
    proto: int = 2
    again: int = 0
    pause: float = 0.0
    dst: int = 8


_GO = [Step(Command.RESUME), Step(pause=0.03), Step(Command.TORQUE, b"\1\x7f\0"), Step(pause=0.1)]


def sequence(draw: random.Random, kind: Kind, length: int) -> list[Step]:
    """A sequence of steps."""
    steps = [Step(Command.TORQUE, bytes((1, draw.choice((0x7F, 0x7F, 0x11, 0)), 0)))]
    while len(steps) < length:
        if draw.randrange(16):
            step = _step(draw, kind)
            # In dialect 1 the destination means nothing.
            several = step.proto == 2 and step.cmd >= 0 and not draw.randrange(8)
            steps.append(replace(step, dst=draw.choice((-1, Multicast((8, 9)).dst))) if several else step)
        else:
            # What stands in a queue when a stop comes, and what goes on after it.
            steps.append(Step(Command.TRANSACT, bytes((8, 250)) + make_packet(9, Instruction.PING)))
            steps += [_step(draw, kind) for _ in range(draw.randint(1, 5))]
            steps.append(Step(Command.STOP, draw.choice((b"\0", b"\0", b"\1"))))
            steps.append(Step(pause=draw.choice((0.01, 0.3, 0.9))))
            steps += draw.choice(([], _GO, _GO))
    return steps


def _step(draw: random.Random, kind: Kind) -> Step:
    what = draw.randrange(24)
    if what < 3:
        return Step(pause=draw.choice((0.002, 0.01, 0.03, 0.1, 0.3, 0.8)))
    if what == 3:
        return Step(again=draw.randint(1, 6))
    if what == 4:
        return Step(Command.STOP, draw.choice((b"\0", b"\1", b"\2", b"", b"\0\0", b"\2")))
    if what < 7:
        return draw.choice(_GO)
    if what == 7:
        return Step(Command.TORQUE, bytes((draw.randrange(3), draw.randrange(0x90), draw.choice((0, 0, 1)))))
    if what == 8:
        return Step(Command.TORQUE, b"\1" + draw.choice((b"\x7f\0", b"\x11\0")))
    if what == 9:
        ms = draw.choice((0, 0, 0, 80, 400, 10, 65535))
        return Step(Command.WATCHDOG, ms.to_bytes(2, "little") + bytes((draw.randrange(3),)))
    if what < 13:
        return Step(Command.JOINT_MOVE, _move(draw))
    if what == 13 and kind.maintenance:
        return Step(Command.MAINTENANCE, draw.choice((b"\1", b"\1", b"\0", b"\2", b"")))
    if what == 14:
        return (
            Step(draw.randrange(0x80), draw.randbytes(draw.randrange(12))) if draw.random() < 0.5 else _else(draw)
        )
    if what < 17:
        return _table(draw, kind)
    return _servo_packet(draw, kind)


def _table(draw: random.Random, kind: Kind) -> Step:
    """Registers of a servo as a table, in one frame or in fragments."""
    servo_id = draw.choice((*_IDS, 9))
    address, data = _data(draw, kind, legacy=servo_id < 4)
    if not draw.randrange(4):
        body = ServoTable(servo_id, draw.randrange(60), draw.choice((1, 20, 130))).serialize()
        return Step(Command.SERVO_TABLE, body)
    count = len(data) if draw.randrange(6) else draw.randrange(300)
    body = ServoTable(servo_id, address, count, data).serialize()
    if draw.randrange(3):
        return Step(Command.SERVO_TABLE, body)
    # Whole in one chunk, or the two of a message in either order.
    number = draw.randrange(0x300)
    if draw.randrange(2):
        return Step(Command.FRAGMENT, FragmentHead(number, 0, 1, Command.SERVO_TABLE, 0).serialize() + body)
    half = (len(body) + 1) // 2
    index = draw.randrange(2)
    head = FragmentHead(number & 0x101, index, 2, Command.SERVO_TABLE, 0).serialize()
    return Step(Command.FRAGMENT, head + (body[half:] if index else body[:half]))


def _else(draw: random.Random) -> Step:
    cmd = draw.choice(
        (Command.IDENTIFY, Command.JOINT_STATE, Command.REPORT, Command.IO, Command.STATS, Command.OFFSETS)
    )
    return Step(cmd, draw.randbytes(draw.randrange(5)))


def _position(draw: random.Random) -> int:
    inside = draw.choice((draw.randint(LOW, HIGH), draw.randint(1900, 2200), LOW, HIGH))
    return inside if draw.randrange(5) else draw.choice((LOW - 300, HIGH + 300, draw.randrange(0x10000)))


def _move(draw: random.Random) -> bytes:
    ids = draw.choice(([0xFE], draw.sample(_IDS, draw.randint(1, 7)), [draw.randrange(256)], [0, 0]))
    count = draw.choice((len(ids), len(ids), len(ids), 255))
    rows = b"".join(bytes((i,)) + _position(draw).to_bytes(2, "little") for i in ids)
    return draw.choice((0, 0, 30, 400, 2000)).to_bytes(2, "little") + bytes((count,)) + rows


def _servo_packet(draw: random.Random, kind: Kind) -> Step:
    """A servo packet in one of the frames that carry one."""
    if draw.random() < 0.25:
        ids = draw.sample(_IDS, draw.randint(1, 7))
        rows = b"".join(
            bytes((i,)) + _position(draw).to_bytes(2, "little") + draw.choice((0, 1, 500)).to_bytes(2, "little")
            for i in ids
        )
        size = draw.choice((4, 4, 4, 4, 255, 0, 3))
        packet = make_packet(0xFE, Instruction.SYNC_WRITE, bytes((0x2A, size)) + rows)
        proto = draw.choice((1, 2)) if kind.chapter else 2
        return Step(Command.SYNC_WRITE, packet, proto)
    packet = _any_packet(draw, kind)
    how = draw.randrange(6 if kind.chapter else 4)
    if how < 2:
        return Step(Command.TRANSACT, bytes((draw.choice((0, 6, 8, 120, 121)), draw.choice((0, 20, 255)))) + packet)
    cmd = draw.choice((Command.READ, Command.READ, Command.PING))
    return Step(cmd, packet, 1 if how > 3 else 2)


def _any_packet(draw: random.Random, kind: Kind) -> bytes:
    servo_id = draw.choice((*_IDS, *_IDS, 9, 0xFE))
    instruction = draw.choice(
        (Instruction.WRITE,) * 6
        + (Instruction.SYNC_WRITE,) * 3
        + (Instruction.READ, Instruction.PING, Instruction.SYNC_READ)
        + (Instruction.REG_WRITE, Instruction.REG_WRITE, Instruction.ACTION)
    )
    if not kind.maintenance and draw.random() < 0.1:
        instruction = draw.choice((*Instruction, 0x77))
    if instruction in (Instruction.WRITE, Instruction.REG_WRITE):
        address, data = _data(draw, kind, legacy=servo_id < 4)
        return make_packet(servo_id, instruction, bytes((address,)) + data)
    if instruction == Instruction.SYNC_WRITE:
        ids = draw.sample(_IDS, draw.randint(1, 4)) + draw.choice(([], [], [], [9], [4, 4]))
        address, data = _data(draw, kind, legacy=draw.random() < 0.5)
        rows = b"".join(bytes((i,)) + _data_at(draw, address, len(data), legacy=i < 4) for i in ids)
        size = draw.choice((len(data), len(data), len(data), len(data), 255, 0, draw.randrange(256)))
        return make_packet(0xFE, instruction, bytes((address, size)) + rows)
    if instruction == Instruction.SYNC_READ:
        return make_packet(0xFE, instruction, bytes((0x38, draw.choice((2, 15, 0, 255)))) + bytes((4, 5)))
    return make_packet(servo_id, instruction, draw.randbytes(draw.randrange(4)))


def _data(draw: random.Random, kind: Kind, *, legacy: bool) -> tuple[int, bytes]:
    """Where a write begins, and what it writes: mostly what moves."""
    if kind.maintenance and draw.random() < 0.3:
        address = draw.choice(_HARMLESS_SETTINGS)
        return address, bytes((draw.randrange(4),))
    low = 0x28 if kind.maintenance else draw.choice((0x28, 0x28, 0x28, 0))
    if not kind.maintenance and draw.random() < 0.2:
        address = draw.choice((*_HARMLESS_SETTINGS, 5, 6, 9, 0x1F))
        return address, draw.randbytes(draw.choice((1, 2)))
    if draw.randrange(2):
        # The block that moves a servo of this kind, or the target alone.
        address, size = draw.choice(((0x2A, 2), (0x2A, 4)) if legacy else ((0x2A, 2), (0x29, 7), (0x2A, 4)))
    else:
        address = draw.choice((0x2A, 0x2A, 0x29, 0x28, 0x28, draw.randint(low, 0x50), 0xFF))
        size = draw.choice((1, 2, 2, 4, 6, 7, 8, 9))
    return address, _data_at(draw, address, size, legacy=legacy)


def _data_at(draw: random.Random, address: int, size: int, *, legacy: bool) -> bytes:
    data = bytearray(draw.randbytes(size))
    order = "big" if legacy else "little"
    at = 0x2A - address
    if 0 <= at < size - 1:
        data[at : at + 2] = _position(draw).to_bytes(2, order)  # type: ignore[arg-type]  # one of two literals
    if 0 <= at < size - 3 and draw.randrange(2):
        data[at + 2 : at + 4] = draw.choice((0, 1, 154)).to_bytes(2, order)  # type: ignore[arg-type]
    if address <= 0x28 < address + size:
        # Not what makes the present position 2048: that is no motion, but would look like one.
        data[0x28 - address] = draw.choice((0, 1, 1, 2))
    return bytes(data)


@dataclass
class _Seen:
    """A servo as it was at the last look."""

    torque: bool
    target: int
    settings: bytes
    position: float


@dataclass
class Watch:
    """Eyes on a board's servos; notes what breaks a rule.

    Args:
        board: The board.
        kind: Of sequence.
        speed: The stored speed limit of all joints, counts/s.
    """

    board: BoardUnderTest
    kind: Kind
    speed: int
    violations: list[str] = field(default_factory=list)
    given: set[int] = field(default_factory=set)
    stopped_at: float | None = None
    held_at: float = 0.0
    may_trip: bool = False
    _seen: list[_Seen] = field(default_factory=list)
    _start: list[float] = field(default_factory=list)
    _packets: int = 0

    def __post_init__(self) -> None:
        self._seen = [self._look(servo) for servo in self._servos()]
        self._start = [seen.position for seen in self._seen]
        self._packets = len(self.board.machine.line.sent)

    def _servos(self) -> list[EmulatedServo]:
        machine = self.board.machine
        machine.wire.step(machine.now)
        return machine.wire.servos

    @staticmethod
    def _look(servo: EmulatedServo) -> _Seen:
        name = "target_position" if servo.series is Series.SEVEN_BOT else "goal_position"
        registers = servo.registers
        return _Seen(servo.torque_on, registers.get(name), registers.read(5, 0x23), servo.motion.position)

    def sent(self, step: Step, arrives: float, *, again: bool = False) -> None:
        """A frame goes out, or an old one again, and will have arrived at a time."""
        if step.proto != 2 or (again and step.cmd == Command.STOP):
            # A repeat is not done again.
            return
        if step.cmd == Command.RESUME:
            self.stopped_at = None
        elif step.cmd == Command.STOP and step.body in (b"\0", b"\1"):
            self.stopped_at = arrives if self.stopped_at is None else self.stopped_at
            self.held_at = arrives
        elif step.cmd == Command.WATCHDOG:
            self.may_trip = True
        elif step.cmd == Command.TORQUE and step.body[:1] == b"\1" and len(step.body) == 3:
            mask = int.from_bytes(step.body[1:], "little")
            self.given |= {i for i in _IDS if mask >> i & 1}

    def run(self, seconds: float) -> None:
        """Let time pass, and look every few milliseconds."""
        client = self.board.client
        end = client.machine.now + seconds
        while end - client.machine.now > 1e-6:
            client.machine.advance(min(_STEP, end - client.machine.now))
            self._check()

    def _say(self, servo_id: int, what: str) -> None:
        self.violations.append(f"{self.board.machine.now:.3f} s: servo {servo_id} {what}")

    def _check(self) -> None:
        machine = self.board.machine
        servos = self._servos()
        since = None if self.stopped_at is None else machine.now - self.stopped_at
        for i, (servo, was) in enumerate(zip(servos, self._seen, strict=True)):
            now = self._look(servo)
            if not self.kind.chapter and i not in self.given:
                if now.torque:
                    self._say(i, "has torque that it was never given")
                if abs(now.position - self._start[i]) > 3:
                    self._say(i, "moves and was never given torque")
            # Where it was let go to, it may be held.
            outward = now.position < min(was.position, LOW - 60) or now.position > max(was.position, HIGH + 60)
            if outward and _can_brake(servo):
                self._say(i, f"is outside its limits at {now.position:.0f}")
            if now.settings != was.settings:
                if not self.kind.maintenance:
                    self._say(i, "has another setting")
                if now.torque or was.torque:
                    self._say(i, "has another setting while it has torque")
            if since is not None and since > 0.02:
                if now.torque and not was.torque:
                    self._say(i, "gets torque after a stop")
                # Each stop, and a trip, may hold a joint where it has got to.
                holding = machine.now - self.held_at < _STOP_TIME or self.may_trip
                near = abs(now.target - now.position) < 30 + 0.15 * self.speed
                if now.target != was.target and not (holding and near):
                    self._say(i, f"is sent to {now.target} after a stop, {since:.3f} s")
            self._seen[i] = now
        for _, data in machine.line.sent[self._packets :]:
            for packet in iter_packets(data):
                self._check_packet(packet, servos)
        self._packets = len(machine.line.sent)

    def _check_packet(self, packet: ServoPacket, servos: list[EmulatedServo]) -> None:
        if packet.instruction == Instruction.SYNC_WRITE:
            address, rows = parse_sync_write(packet)
        elif packet.instruction == Instruction.WRITE:
            address, rows = packet.params[0], ((packet.servo_id, packet.params[1:]),)
        else:
            if packet.instruction not in _READS and not self.kind.maintenance:
                self.violations.append(f"{packet} reached the bus")
            return
        for servo_id, data in rows:
            if address <= 0x2A < address + len(data) and servo_id < len(servos):
                self._check_speed(servos[servo_id], data[0x2A - address :])

    def _check_speed(self, servo: EmulatedServo, data: bytes) -> None:
        i = servo.servo_id
        slack = 12 + 0.15 * self.speed  # what a joint does between a sample and the write that follows it
        if servo.series is Series.SEVEN_BOT:
            if len(data) < 4:
                self._say(i, "has a target without a run time")
                return
            away = abs(int.from_bytes(data[:2], "big") - servo.motion.position)
            in_time = self.speed * int.from_bytes(data[2:4], "big") / 1000
            if away > in_time * 1.02 + slack:
                self._say(i, f"is sent {away:.0f} counts in {1000 * in_time / self.speed:.0f} ms")
        else:
            speed = int.from_bytes(data[4:6], "little") if len(data) >= 6 else 0
            if not 0 < speed * 50 <= max(self.speed, 50):
                self._say(i, f"is given a speed of {speed * 50} counts/s")


def _can_brake(servo: EmulatedServo) -> bool:
    """Whether it has the force; a host may take it away by torque or by a ceiling, and then it coasts."""
    if servo.series is Series.SEVEN_BOT:
        return servo.torque_on
    strong = servo.registers.get("goal_torque") >= 100 and servo.registers.get("torque_limit") >= 500
    return servo.torque_on and strong


def play(board: BoardUnderTest, steps: Iterable[Step], kind: Kind, speed: int) -> list[str]:
    """Play a sequence on a board that has just started; what broke a rule, one line each."""
    client = board.client
    limits = LimitTable.serialize_request((LimitRow(LOW, HIGH, speed),) * 7)
    assert client.ask(Command.LIMITS, limits, within=1.0).status == 0
    watch = Watch(board, kind, speed)
    free = client.machine.now
    frames: list[tuple[Step, bytes]] = []
    for step in steps:
        if step.pause:
            watch.run(step.pause)
            continue
        again = step.again
        if again > len(frames):
            continue
        if again:
            step, data = frames[-again]
        else:
            data = client.frame(step.cmd, step.body, proto=step.proto, dst=step.dst)
            frames.append((step, data))
        free = max(free, client.machine.now) + len(data) * _BYTE
        watch.sent(step, free, again=bool(again))
        client.machine.send(data)
        watch.run(0.003)
    watch.run(max(0.0, free - client.machine.now) + 1.5)
    watch.violations += _end(board, watch)
    return watch.violations


def _end(board: BoardUnderTest, watch: Watch) -> list[str]:
    """It is still there, and stops."""
    client = board.client
    client.machine.take()
    found = []
    reply = client.ask(Command.STOP, b"\0", within=1.5)
    watch.stopped_at = watch.held_at = client.machine.now - 0.1
    if reply.status:
        found.append(f"the last stop is answered with {reply.status}, {reply.body.hex(' ')}")
    for _ in range(4):
        state = client.ask(Command.JOINT_STATE, b"\0", within=1.0)
        if state.status != Status.STOPPED:
            break  # a watchdog that tripped meanwhile voids what is asked
    report = JointReport.parse(state.body)
    if not report.board_flags & tables.BOARD_FLAGS_STOPPED:
        found.append("the last stop is not latched")
    on = [bool(s & tables.SERVO_FLAGS_TORQUE_ON) for s in report.status]
    if on != [servo.torque_on for servo in board.machine.wire.servos]:
        found.append(f"the board says {on} of the torque, and it is not so")
    watch.run(0.5)
    return found


KINDS_OF_SEQUENCE = [Kind(c, m) for c in (False, True) for m in (False, True)]


def run_seed(board_kind: str, seed: int) -> list[str]:
    """One sequence by number."""
    draw = random.Random(seed)
    kind = KINDS_OF_SEQUENCE[seed % len(KINDS_OF_SEQUENCE)]
    board = BoardUnderTest(board_kind)
    try:
        steps = sequence(draw, kind, draw.randint(20, 120))
        return play(board, steps, kind, draw.choice((430, 1020, 1480)))
    finally:
        board.close()


def main(board_kind: str, count: int, first: int = 0) -> int:
    """Play many; print what broke a rule and how many there were."""
    broken = 0
    for seed in range(first, first + count):
        violations = run_seed(board_kind, seed)
        broken += bool(violations)
        for line in violations[:5]:
            print(f"sequence {seed}: {line}", flush=True)
    print(f"{board_kind}: {count} sequences, {broken} broke a rule")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], *map(int, sys.argv[2:])))
