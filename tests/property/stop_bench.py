"""Threads that use the host's API at random against a board, among raw frames, while one of them stops the arm.

Owns the bench: a driver in real time, a board in another thread (the emulated one, or the firmware's core in C++),
a second host that says what it likes on the same line, and a judge who sees the servos. What counts as wrong is
the judge's.

Run it by itself for as long as you like: ``python -m tests.property.stop_bench core 2 --runs 200``.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from tests.avr.machines import CoreBoard
from tests.frames import frame_bytes
from tests.property.stops import Call, Judge, watch

from hexwire.drivers.base import RobotDriver
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.servo_wire import ServoWire
from hexwire.errors import HexwireError, LinkClosedError, LinkLostError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.memory import memory_pair
from hexwire.model.state import JointTarget
from hexwire.session.decoder import FrameDecoder
from hexwire.session.policy import RetryPolicy
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.commands import MoveRequest, MoveRow, TransactRequest

__all__ = ["PATIENCE", "Bench", "bench", "move", "run"]

PATIENCE = 30.0
SILENT = 9
"""An id that no servo has: who asks it keeps the line busy for as long as the board waits."""
SLOW = 0.15
_LONG_MS = 4000
_CEILING, _SLOWLY = b"\x9a\0", b"\4\0"
_LEGACY, _HLS = 0, 4
_BOARD, _OTHER = 8, 9
_REFUSED = 0.01
"""Seconds before who was refused calls again: else the targets of a run reach where the arm stands."""
_CALLS = ("move", "move", "torque", "resume", "read", "slow")
_SENT = ("raw_move", "sent_move", "raw_resume", "limp")
_FRAMES = (
    *("move", "sync_write", "transact", "read", "resume", "torque", "limp", "slow", "stop", "noise"),
    *("move", "sync_write", "transact"),
)


def move(robot: RobotDriver, count: int, duration: float = 4.0) -> None:
    """Send J1 to counts of its servo."""
    joint = robot.model.joint("J1")
    robot.write(JointTarget.of({"J1": joint.counts_to_angle(count)}, duration))


class _Board(Protocol):
    """A board in real time."""

    wire: ServoWire

    def exchange(self, data: bytes, now: float) -> bytes: ...

    def close(self) -> None: ...


class _Emulator:
    def __init__(self, dialect: int) -> None:
        self._board = make_hex7bot_board(dialect=dialect, start=time.monotonic())
        self.wire = self._board.wire

    def exchange(self, data: bytes, now: float) -> bytes:
        if data:
            self._board.receive(data, now)
        self._board.step(now)
        return self._board.data_to_send()

    def close(self) -> None:
        pass


class _Core:
    """The firmware's core; it answers both dialects."""

    _MOST = 0.05

    def __init__(self) -> None:
        self._machine = CoreBoard()
        self._machine.settle(0.3)
        self.wire = self._machine.wire
        self._last = time.monotonic()

    def exchange(self, data: bytes, now: float) -> bytes:
        if data:
            self._machine.send(data)
        # On a busy machine its time stands still for a while, rather than hold everything up.
        self._machine.advance(min(now - self._last, self._MOST))
        self._last = now
        return self._machine.take()

    def close(self) -> None:
        self._machine.close()


class Bench:
    """A driver in real time, its board in another thread, and a judge who sees two servos.

    Args:
        dialect: Of the driver; the emulated board then knows no other.
        kind: emulator or core.
    """

    def __init__(self, dialect: int, kind: str = "emulator") -> None:
        self.judge = Judge()
        near, self._far = memory_pair()
        self._far.open()
        self._board: _Board = _Core() if kind == "core" else _Emulator(dialect)
        self.wire = self._board.wire
        for place in (_LEGACY, _HLS):
            watch(self.judge, self.wire, self.wire[place])
        self._decoder = FrameDecoder()
        self._resumed: dict[tuple[int, int], float] = {}
        self._frames: list[Callable[[], bytes]] = []
        self._ended = threading.Event()
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        session = Session(
            IpcHandle.from_link(near), policy=RetryPolicy(attempts=3, window=1.0, dialect1_window=1.0)
        )
        self.robot = Hex7BotDriver(session, dialect=dialect)
        self.robot.attach()
        self.torque()
        self.robot.read()
        self._number = 0

    def _serve(self) -> None:
        try:
            while not self._ended.is_set():
                with contextlib.suppress(LinkLostError, LinkClosedError):
                    data = self._far.read(time.monotonic() + 0.002)
                    while self._frames:
                        data += self._frames.pop(0)()
                    out = self._board.exchange(data, time.monotonic())
                    self._note_resumes(out)
                    if out:
                        self._far.write(out)
        except BaseException as error:
            self._failed = error
            raise

    def _note_resumes(self, out: bytes) -> None:
        """A RESUME that the board answers has ended the stop; that it answers again does nothing."""
        now = time.monotonic()
        self._decoder.receive(out, now)
        while (event := self._decoder.next_event()) is not None:
            if not isinstance(event, Frame) or event.cmd != Command.RESUME or event.status != Status.OK:
                continue
            key = event.dst, event.seq
            if now - self._resumed.get(key, -PATIENCE) > 2.0:
                self.judge.seen("resume")
            self._resumed[key] = now

    def close(self) -> None:
        self._ended.set()
        self._thread.join(PATIENCE)
        self.robot.session.close()
        self._far.close()
        self._board.close()
        assert self._failed is None

    # What a thread may do. Each is one call of the judge's.

    def move(self) -> None:
        count = self.judge.target()
        with self.judge.call("move", count):
            move(self.robot, count)

    def raw_move(self) -> None:
        count = self.judge.target()
        body = MoveRequest(_LONG_MS, (MoveRow(0, count),)).serialize()
        with self.judge.call("move", count):
            self.robot.session.request(Command.JOINT_MOVE, body)

    def sent_move(self) -> None:
        count = self.judge.target()
        body = MoveRequest(_LONG_MS, (MoveRow(0, count),)).serialize()
        with self.judge.call("move", count):
            self.robot.session.send(Command.JOINT_MOVE, body)

    def torque(self) -> None:
        with self.judge.call("torque"):
            self.robot.torque(True)

    def limp(self) -> None:
        self.robot.torque(False)

    def resume(self) -> None:
        with self.judge.call("resume"):
            self.robot.resume()

    def raw_resume(self) -> None:
        with self.judge.call("resume"):
            self.robot.session.request(Command.RESUME)

    def read(self) -> None:
        self.robot.read()

    def slow(self) -> None:
        """Keep the line."""
        packet = sp.make_ping(SILENT)
        if self.robot.dialect == 2:
            body = TransactRequest(6, int(SLOW * 1000), packet).serialize()
            self.robot.session.request(Command.TRANSACT, body)
        else:
            self.robot.ping(SILENT)

    def stop(self) -> None:
        with self.judge.stop():
            self.robot.stop()

    # Frames of another host on the same line, whose answers nobody waits for.

    def frame(self, what: str, dice: random.Random) -> None:
        """Send one; it counts as asked for when it goes to the board."""
        self._frames.append(lambda: self._make(what, dice))

    def _make(self, what: str, dice: random.Random) -> bytes:
        judge = self.judge
        if what == "noise":
            return dice.randbytes(dice.randint(1, 40))
        if what in ("resume", "torque", "limp", "slow", "stop"):
            if what in ("resume", "torque"):
                judge.calls.append(Call(what, judge.order(), outcome="sent"))
            slow = TransactRequest(6, int(SLOW * 1000), sp.make_ping(SILENT)).serialize()
            cmd, body = {
                "resume": (Command.RESUME, b""),
                "torque": (Command.TORQUE, b"\1\x7f\0"),
                "limp": (Command.TORQUE, b"\0" + dice.choice((b"\x7f\0", b"\x11\0"))),
                "slow": (Command.TRANSACT, slow),
                "stop": (Command.STOP, dice.choice((b"\0", b"\0", b"\1"))),
            }[what]
            return self._framed(cmd, body)
        count = judge.target()
        judge.calls.append(Call("move", judge.order(), count=count, outcome="sent"))
        servo = dice.choice((_LEGACY, _HLS))
        if what == "move":
            return self._framed(Command.JOINT_MOVE, MoveRequest(_LONG_MS, (MoveRow(servo, count),)).serialize())
        # All are slow: a joint that arrives stands at its target, and a hold would look like that move.
        row = count.to_bytes(2, "big") + _LONG_MS.to_bytes(2, "big")
        if what == "sync_write":
            return self._framed(Command.SYNC_WRITE, sp.make_sync_write(0x2A, {_LEGACY: row}))
        at = 0x2A if servo == _LEGACY else 0x29
        block = row if servo == _LEGACY else b"\0" + count.to_bytes(2, "little") + _CEILING + _SLOWLY
        packet = dice.choice((sp.make_write(servo, at, block), sp.make_sync_write(at, {servo: block})))
        if what == "transact":
            return self._framed(Command.TRANSACT, TransactRequest(6, 20, packet).serialize())
        return self._framed(Command.READ, packet)

    def _framed(self, cmd: int, body: bytes) -> bytes:
        self._number += 1
        return frame_bytes(cmd, body, seq=self._number, src=_OTHER, dst=_BOARD, time_nsec=self._number)


@contextmanager
def bench(dialect: int, kind: str = "emulator") -> Iterator[Bench]:
    """A bench that is closed in the end."""
    made = Bench(dialect, kind)
    try:
        yield made
    finally:
        made.close()


def run(b: Bench, seed: int, *, seconds: float = 1.0) -> None:
    """Threads that call at random, one that stops and resumes, and in dialect 2 another host's frames."""
    both = b.robot.dialect == 2
    deeds = _CALLS + (_SENT if both else ())
    until = time.monotonic() + seconds
    failures: list[BaseException] = []

    def work(number: int) -> None:
        dice = random.Random(f"{seed} {number}")
        while time.monotonic() < until:
            getattr(b, dice.choice(deeds))()
            time.sleep(dice.choice((0.0, 0.001, 0.01)))

    def stop() -> None:
        dice = random.Random(f"{seed} stop")
        while time.monotonic() < until:
            time.sleep(dice.uniform(0.0, 0.08))
            b.stop()
            if dice.random() < 0.7:
                time.sleep(dice.uniform(0.0, 0.03))
                b.resume()
                if both:
                    b.torque()
                time.sleep(dice.uniform(0.0, 0.1))

    def other() -> None:
        dice = random.Random(f"{seed} other")
        while time.monotonic() < until:
            b.frame(dice.choice(_FRAMES), dice)
            time.sleep(dice.choice((0.0, 0.002, 0.02, 0.05)))

    def guarded(what: Callable[[], None]) -> None:
        while time.monotonic() < until:
            try:
                what()
            except HexwireError:
                time.sleep(_REFUSED)
            except BaseException as error:
                failures.append(error)
                raise

    jobs: list[Callable[[], None]] = [lambda i=i: work(i) for i in range(4)]  # type: ignore[misc]  # binds the number
    jobs += [stop, other] if both else [stop]
    threads = [threading.Thread(target=guarded, args=(job,)) for job in jobs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert not any(thread.is_alive() for thread in threads)
    assert failures == []


def main(words: list[str]) -> int:
    """Play many runs; print what broke a rule, and how much happened."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("kind", choices=("emulator", "core"))
    parser.add_argument("dialect", type=int, choices=(1, 2))
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args(words)
    stops = calls = moves = broken = 0
    for seed in range(options.first, options.first + options.runs):
        with bench(options.dialect, options.kind) as b:
            run(b, seed)
            judge = b.judge
        wrong = [*judge.wrong(), *judge.without_torque()]
        for line in wrong[:5]:
            print(f"run {seed}: {line}", flush=True)
        stops, calls = stops + len(judge.stops), calls + len(judge.calls)
        moves, broken = moves + judge.moved(), broken + len(wrong)
    print(
        f"{options.kind}, dialect {options.dialect}: {options.runs} runs, {calls} calls and frames that act, "
        f"{stops} stops, {moves} moves; {broken} after a stop or without torque"
    )
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
