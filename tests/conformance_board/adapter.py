"""One view of three boards: the Python emulator, the C++ core on this computer, the ELF on the simulated chip.

Owns what may differ between them, in one place: `comparable`. Everything else has to be the same bytes.
"""

from __future__ import annotations

import math

import pytest
from tests.avr.client import Client
from tests.avr.machines import WRONG, ChipBoard, CoreBoard, Machine

from hexwire.emulator.board import EmulatedBoard
from hexwire.wire import tables
from hexwire.wire.command_frame import BODY_OFFSET, Command, Frame, serialize_frame

_BOOT = slice(4, 8)
_IDENTIFY_FLAGS = 12
_STATE_CLOCK = slice(0, 4)
_STATE_FIELDS, _STATE_FLAGS, _STATE_JOINTS, _STATE_HEAD = 4, 5, 6, 8
_FIELD_SIZES = {"speed": 2, "load": 2, "voltage": 1, "temperature": 1, "current": 2, "age": 2}


class EmulatorBoard(Machine):
    """The Python emulator with a paced servo line."""

    name = "emulator"
    _STEP = 0.0005

    def __init__(self, faults: tuple[str, ...] = (), *, seed: int = 0) -> None:
        super().__init__(faults, seed=seed)
        self._now = 0.0
        self._board = EmulatedBoard(self.wire, host_rate=115200)
        self._rate = 115200
        self._incoming: list[tuple[float, bytes]] = []
        self._free = 0.0
        transact = self.wire.transact

        def noted(packet: bytes, now: float) -> tuple[bytes, float]:
            self.line.sent.append((now, packet))
            return transact(packet, now)

        self.wire.transact = noted  # type: ignore[method-assign]  # the tests look at what was sent

    @property
    def now(self) -> float:
        return self._now

    def send(self, data: bytes) -> None:
        self._free = max(self._free, self._now) + len(data) * 10 / self._rate
        self._incoming.append((self._free, data))

    def advance(self, seconds: float) -> None:
        end = self._now + seconds
        while self._now < end:
            self._now = min(self._now + self._steps(end) * self._STEP, end)
            while self._incoming and self._incoming[0][0] <= self._now:
                self._board.receive(self._passed(self._incoming.pop(0)[1]), self._now)
            self._board.step(self._now)
            data = self._passed(self._board.data_to_send())
            self.received += data
            self.stamps += [self._now] * len(data)

    def _steps(self, end: float) -> int:
        """Steps until something happens: at the others the board has nothing to do."""
        due = self._board.next_event_time()
        first = min(end, *(time for time, _ in self._incoming[:1]), *(() if due is None else (due,)))
        return max(1, math.ceil((first - self._now) / self._STEP))

    def set_rate(self, baud: int) -> None:
        self._rate = baud

    def _passed(self, data: bytes) -> bytes:
        """Bytes of the host line as the other end hears them."""
        same = self._rate == self._board.host_rate
        return data if same else bytes(byte ^ WRONG for byte in data)

    def reset(self) -> None:
        self._board.reset(self._now)


KINDS: dict[str, type[Machine]] = {kind.name: kind for kind in (EmulatorBoard, CoreBoard, ChipBoard)}

EVERY_BOARD = ["emulator", "core", pytest.param("chip", marks=pytest.mark.slow)]
"""Parameters of a fixture. The core proves in a tenth of the time what the chip does; `tests/avr` has the rest."""


class BoardUnderTest:
    """A board of some kind that has started, and a host to ask it.

    Args:
        kind: emulator, core or chip.
        faults: As for `FaultPlan`.
    """

    def __init__(self, kind: str, faults: tuple[str, ...] = ()) -> None:
        self.machine = KINDS[kind](faults)
        self.client = Client(self.machine)
        self.machine.settle(0.3)

    def exchange(self, request: bytes, within: float = 0.3) -> list[bytes]:
        """Send bytes; the comparable form of every frame that came back."""
        self.client.frames()
        self.machine.send(request)
        end = self.machine.now + len(request) * 10 / 115200 + within
        found: list[Frame] = []
        while self.machine.now < end:
            new = self.client.run(0.002)
            found += new
            if found and not new:
                break
        # In dialect 1 the decoder does not look at the check; every board sends the same.
        for frame in found:
            assert serialize_frame(frame)[: BODY_OFFSET + len(frame.body) + 2] in self.client.heard
        return [comparable(frame) for frame in found]

    def advance(self, seconds: float) -> None:
        """Let time pass; what comes meanwhile is dropped."""
        self.client.run(seconds)

    def bus_writes(self, address: int) -> list[bytes]:
        """Writes that reached the servo line and begin at this register."""
        packets = [packet for _, packet in self.machine.line.sent]
        return [p for p in packets if len(p) > 6 and p[4] in (0x03, 0x83) and p[5] == address]

    def close(self) -> None:
        self.machine.close()


def comparable(frame: Frame) -> bytes:
    """A frame's bytes without what may differ between boards.

    That is: the clock (and with it the frame's check, which `FrameDecoder` has verified), in IDENTIFY the
    boot id, in JOINT_STATE the sample's clock, its age,
    and the speed of legacy servos, which is worked out from two samples; in both, whether settings are stored.
    """
    body = bytearray(frame.body)
    if frame.proto == tables.PROTO_HEXWIRE and frame.cmd == Command.IDENTIFY and len(body) > _IDENTIFY_FLAGS:
        body[_BOOT] = bytes(4)
        body[_IDENTIFY_FLAGS] &= ~tables.BOARD_FLAGS_SETTINGS_DEFAULT
    if frame.proto == tables.PROTO_HEXWIRE and frame.cmd == Command.JOINT_STATE and len(body) > _STATE_HEAD:
        _clean_state(body)
    if frame.proto == tables.PROTO_HEXWIRE and frame.cmd == Command.RESUME and body:
        body[0] &= ~tables.BOARD_FLAGS_SETTINGS_DEFAULT
    head = (frame.sn, frame.src, frame.dst, frame.type, frame.size)
    rest = (frame.proto, frame.seq, frame.cmd, frame.cmd_ext)
    return repr((head, rest, bytes(body).hex(" "))).encode()


def _clean_state(body: bytearray) -> None:
    body[_STATE_CLOCK] = bytes(4)
    body[_STATE_FLAGS] &= ~tables.BOARD_FLAGS_SETTINGS_DEFAULT
    at = _STATE_HEAD
    for joint in range(body[_STATE_JOINTS]):
        at += 3
        for name, size in _FIELD_SIZES.items():
            if not body[_STATE_FIELDS] & tables.STATE_FIELDS[name]:
                continue
            if name == "age" or (name == "speed" and joint < 4):
                body[at : at + size] = bytes(size)
            at += size
