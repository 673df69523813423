"""The emulated board's side of the servo bus: ask, verify, retry, and keep the joints up to date.

Owns the jobs that talk to servos, and what a job waits for: a job is a generator that yields to the board's
scheduler, and is resumed with the answer when the wait is over. Knows nothing of frames.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from functools import lru_cache
from typing import NamedTuple

from hexwire.session.servo_answers import Expected, expected_answer, match_answer
from hexwire.wire import tables
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    StatusPacket,
    find_status,
    make_ping,
    make_read,
    make_sync_read,
    make_sync_write,
    parse_packet,
    strip_echo,
)

from .board_state import SERVO_BITS, BoardState, JointSlot
from .gate import READ_ONLY, SPEED_UNIT, Admitted, speed_cap, written_ids

__all__ = [
    "BUS_TIMEOUT",
    "BoardBus",
    "BusBuffer",
    "Clock",
    "Delay",
    "Job",
    "Pause",
    "SendPacket",
    "Transaction",
    "Wait",
]

BUS_TIMEOUT = 0.005
"""Seconds for a servo to begin its answer."""

Clock = Callable[[], float]
"""The board's time, seconds; it advances while a job waits."""


class Transaction(NamedTuple):
    """Empty the buffer and put a packet on the bus; the job is resumed with the bytes that come back.

    The wait ends with the whole answer, or `timeout` seconds after the time that packet and answer take.
    """

    packet: bytes
    reply_length: int
    timeout: float = BUS_TIMEOUT


class SendPacket(NamedTuple):
    """Put a packet on the bus; the job is resumed when it is sent. What comes back stays in the buffer."""

    packet: bytes


class Delay(NamedTuple):
    """Time that the board's program takes; skipped if the bus is not paced. The job is resumed without data."""

    seconds: float


class Pause(NamedTuple):
    """Let this much time pass for the servos, paced or not. The job is resumed without data."""

    seconds: float


Wait = Transaction | SendPacket | Delay | Pause
Job = Generator[Wait, bytes | None, None]


class BusBuffer:
    """The serial buffer of the servo bus: bytes that have arrived, and bytes still to come with their times."""

    def __init__(self) -> None:
        self._input: list[tuple[float, bytes]] = []

    def put(self, data: bytes, when: float) -> None:
        """Add bytes that can be read from the time `when` on."""
        self._input.append((when, data))

    def waiting(self, now: float) -> int:
        """Number of bytes that can be read."""
        return sum(len(data) for when, data in self._input if when <= now)

    def read(self, now: float) -> bytes:
        """Remove and return the bytes that have arrived."""
        if not self._input:
            return b""
        data = b"".join(data for when, data in self._input if when <= now)
        self._input = [(when, data) for when, data in self._input if when > now]
        return data


_TRIES = 2
_TORQUE = Series.HLS.register("torque_enable").address
_LEGACY_TARGET = Series.SEVEN_BOT.register("target_position").address
_HLS_BLOCK = Series.HLS.register("acceleration").address
_MODE = Series.HLS.register("mode").address
_PRESENT = Series.HLS.register("present_position").address
_PRESENT_BYTES = 15
"""From present_position (56) to present_current (69, 2 bytes)."""
_LEGACY_PRESENT = Series.SEVEN_BOT.register("present_position")
_SAMPLE = {
    name: Series.HLS.register(f"present_{name}")
    for name in ("position", "speed", "load", "voltage", "temperature", "current")
}
_TARGETS = {Series.SEVEN_BOT: "target_position", Series.HLS: "goal_position"}


# A board asks the same of the same servos again and again, and a servo at rest answers the same.
_read = lru_cache(maxsize=256)(make_read)
_match = lru_cache(maxsize=256)(match_answer)


@lru_cache(maxsize=256)
def _expected(packet: bytes, acknowledged: bool) -> Expected:
    return expected_answer(parse_packet(packet), acknowledges_writes=acknowledged)


Sub = Generator[Wait, bytes | None, StatusPacket | None]
Raw = Generator[Wait, bytes | None, bytes]
Several = Generator[Wait, bytes | None, list[StatusPacket]]
Many = Generator[Wait, bytes | None, int]
Value = Generator[Wait, bytes | None, int | None]


class BoardBus:
    """Bus jobs of one board.

    Args:
        state: What the board knows; the jobs keep its joints up to date.
        clock: The board's time.
        paced: Bytes take as long as on a real bus, and joints are polled in the background.

    Attributes:
        cycles: How often all joints were polled in the background.
    """

    def __init__(self, state: BoardState, clock: Clock, *, paced: bool) -> None:
        self._state = state
        self._clock = clock
        self._joints = state.joints
        self._paced = paced
        self._poll_at = 0
        self.cycles = 0

    # -- asking -------------------------------------------------------------------------------------

    def ask(self, packet: bytes, *, tries: int = _TRIES, acknowledged: bool = True) -> Sub:
        """Send one packet and verify the answer; send it again if the answer is missing or bad."""
        state = self._state
        expected = _expected(packet, acknowledged)
        for attempt in range(tries):
            answer = yield Transaction(packet, expected.length)
            if not expected.servo_ids:
                return None
            found = _match(answer or b"", packet, expected)
            if found is not None:
                return found
            if strip_echo(answer or b"", packet):
                state.bus_bad += 1
            else:
                state.bus_timeouts += 1
            if attempt + 1 < tries:
                state.bus_retries += 1
        return None

    def ask_all(self, passed: Admitted) -> Several:
        """Send what the gate let through; returns the answers of all addressed servos. A write is not retried."""
        yield from self._send_first(passed)
        packet = passed.packets[-1]
        request = parse_packet(packet)
        expected = expected_answer(request)
        if len(expected.servo_ids) < 2:
            tries = _TRIES if request.instruction in READ_ONLY else 1
            status = yield from self.ask(packet, tries=tries)
            return [status] if status is not None else []
        answer = yield Transaction(packet, expected.length)
        data = strip_echo(answer or b"", packet)
        found = [find_status(data, servo_id, expected.params) for servo_id in expected.servo_ids]
        return [f[0] for f in found if f is not None]

    def raw(self, passed: Admitted, reply_length: int, timeout: float) -> Raw:
        """Send what the gate let through; returns the bytes that came back, echo removed."""
        yield from self._send_first(passed)
        answer = yield Transaction(passed.packets[-1], reply_length, timeout)
        return strip_echo(answer or b"", passed.packets[-1])

    def note(self, passed: Admitted) -> None:
        """Record what packets change, before they are sent: a stop may come between a packet and its answer."""
        for packet in passed.packets:
            for servo_id in written_ids(parse_packet(packet)):
                for joint in self._joints:
                    if servo_id in (joint.servo_id, BROADCAST_ID):
                        joint.unsure = True
                        joint.ceiling = 0
        for joint in self._joints:
            joint.torque_on = passed.torque.get(joint.servo_id, joint.torque_on)
            joint.target = passed.targets.get(joint.servo_id, joint.target)

    def _send_first(self, passed: Admitted) -> Job:
        """Record what the packets change, then send all but the last."""
        self.note(passed)
        for packet in passed.packets[:-1]:
            yield Transaction(packet, 0)

    def discover(self) -> Job:
        """At start, find which servos answer, their positions and which have torque; hold those that have it.

        If a stop comes meanwhile, nothing is written: the stop holds them.
        """
        for joint in self._joints:
            status = yield from self.ask(make_ping(joint.servo_id))
            if status is None:
                continue
            joint.series = Series.SEVEN_BOT if status.legacy else Series.HLS
            joint.present = True
            joint.unsure = True
        yield from self.poll_all()
        if not self._state.stopped:
            yield from self.hold([j for j in self._joints if j.present and j.torque_on])

    def recheck(self, joint: JointSlot) -> Job:
        """Read what the board must know before it writes a target: torque and mode, an HLS servo's ceiling.

        A joint that has torque in a mode other than position mode loses it.
        """
        yield from self.read_switches(joint)
        if joint.torque_on and joint.mode:
            yield from self.torque_off([joint])
        yield from self.read_ceiling(joint)

    def read_ceiling(self, joint: JointSlot) -> Job:
        """Read an HLS servo's current ceiling if it is not known."""
        if joint.series is Series.HLS and not joint.ceiling:
            register = Series.HLS.register("goal_torque")
            found = yield from self.ask(_read(joint.servo_id, register.address, register.size))
            if found is not None:
                # With a ceiling of 0 it could not move at all.
                joint.ceiling = abs(register.decode(found.params)) or tables.DEFAULT_CEILING

    def read_switches(self, joint: JointSlot) -> Many:
        """Read a joint's torque switch and mode; returns 1 if it answered."""
        legacy = joint.series is Series.SEVEN_BOT
        first = _TORQUE if legacy else _MODE
        status = yield from self.ask(_read(joint.servo_id, first, _TORQUE - first + 1))
        if status is None:
            return 0
        # A legacy servo has no modes.
        joint.mode = 0 if legacy else status.params[0]
        joint.torque_on = status.params[-1] == 1
        joint.unsure = False
        return 1

    def read_target(self, joint: JointSlot) -> Value:
        """Read the target of a joint's servo; None if it does not answer."""
        row = joint.series.register(_TARGETS[joint.series])
        status = yield from self.ask(_read(joint.servo_id, row.address, row.size))
        return None if status is None else row.decode(status.params)

    # -- state --------------------------------------------------------------------------------------

    def poll_all(self) -> Job:
        """Sample every joint once."""
        for joint in self._joints:
            if joint.series is Series.SEVEN_BOT:
                yield from self._poll_legacy(joint)
        yield from self._poll_hls()

    def refresh(self) -> Job:
        """Sample every joint once, unless joints are polled in the background."""
        if not self._paced:
            yield from self.poll_all()

    def poll_next(self) -> Job:
        """Sample the next legacy joint, or all HLS joints, in turn."""
        legacy = [j for j in self._joints if j.series is Series.SEVEN_BOT]
        self._poll_at = (self._poll_at + 1) % (len(legacy) + 1)
        if self._poll_at < len(legacy):
            yield from self._poll_legacy(legacy[self._poll_at])
        else:
            yield from self._poll_hls()
            self.cycles += 1

    def _poll_legacy(self, joint: JointSlot) -> Job:
        if joint.unsure and joint.present:
            yield from self.recheck(joint)
        status = yield from self.ask(_read(joint.servo_id, _PRESENT, 2), tries=_TRIES if joint.present else 1)
        if status is None:
            joint.present = False
            return
        self._is_there(joint)
        position = _LEGACY_PRESENT.decode(status.params)
        now = self._clock()
        # These servos report no speed: it is computed from the previous sample.
        elapsed = now - joint.sampled_at if joint.sampled_at is not None else 0.0
        if elapsed > 0:
            joint.speed = max(-32768, min(32767, round((position - joint.position) / elapsed)))
        joint.position, joint.error, joint.sampled_at = position, status.error & SERVO_BITS, now

    def _poll_hls(self) -> Job:
        joints = [j for j in self._joints if j.series is not Series.SEVEN_BOT]
        for joint in joints:
            if joint.unsure and joint.present:
                yield from self.recheck(joint)
        wanted = joints
        for _ in range(_TRIES):
            if not wanted:
                return
            packet = make_sync_read(_PRESENT, _PRESENT_BYTES, [j.servo_id for j in wanted])
            answer = yield Transaction(packet, len(wanted) * (6 + _PRESENT_BYTES))
            data = strip_echo(answer or b"", packet)
            missing = []
            for joint in wanted:
                found = find_status(data, joint.servo_id, _PRESENT_BYTES)
                if found is None:
                    missing.append(joint)
                else:
                    self._sample_hls(joint, found[0])
            self._state.bus_timeouts += len(missing)
            # Only servos that were present are asked again: an absent one must not slow the others down.
            wanted = [j for j in missing if j.present]
        for joint in wanted:
            joint.present = False

    def _sample_hls(self, joint: JointSlot, status: StatusPacket) -> None:
        data = status.params

        def value(name: str) -> int:
            register = _SAMPLE[name]
            start = register.address - _PRESENT
            return register.decode(data[start : start + register.size])

        joint.position = value("position")
        joint.speed = max(-32768, min(32767, value("speed") * SPEED_UNIT))
        joint.load = value("load")
        joint.voltage = value("voltage")
        joint.temperature = value("temperature")
        joint.current = value("current") * 13 // 2
        joint.error = status.error & SERVO_BITS
        self._is_there(joint)
        joint.sampled_at = self._clock()

    @staticmethod
    def _is_there(joint: JointSlot) -> None:
        # A servo that was absent may have lost its supply, and so its torque.
        joint.unsure |= not joint.present
        joint.present = True

    # -- motion -------------------------------------------------------------------------------------

    def move(self, targets: Iterable[tuple[JointSlot, int]], duration_ms: int) -> Job:
        """Write target positions, in the block of registers of each series."""
        legacy, hls = {}, {}
        for joint, position in targets:
            # A target may switch torque on, and a stop may come before the board knows it.
            joint.unsure |= not joint.torque_on
            joint.target = position
            if joint.series is Series.SEVEN_BOT:
                block = position.to_bytes(2, "big") + duration_ms.to_bytes(2, "big")
                legacy[joint.servo_id] = block
            else:
                hls[joint.servo_id] = self._hls_block(joint, position, duration_ms)
        if legacy:
            yield Transaction(make_sync_write(_LEGACY_TARGET, legacy), 0)
        if hls:
            yield Transaction(make_sync_write(_HLS_BLOCK, hls), 0)

    def _hls_block(self, joint: JointSlot, position: int, duration_ms: int) -> bytes:
        series = Series.HLS
        distance = abs(position - joint.position)
        most = speed_cap(self._state.limits[self._joints.index(joint)].speed)
        speed = min(-(-distance * 1000 // (max(duration_ms, 1) * SPEED_UNIT)), most)
        return (
            b"\0"
            + series.register("goal_position").encode(position)
            + series.register("goal_torque").encode(joint.ceiling or tables.DEFAULT_CEILING)
            + series.register("goal_speed").encode(max(speed, 1))
        )

    def hold(self, joints: list[JointSlot]) -> Job:
        """Make the present positions the targets."""
        yield from self.move([(j, j.position) for j in joints if j.sampled_at is not None], 0)

    def torque_on(self, joints: list[JointSlot]) -> Many:
        """Switch torque on without motion; returns the mask of joints (by index) that confirmed."""
        yield from self.poll_all()
        for joint in joints:
            if joint.present:
                yield from self.recheck(joint)
        joints = [j for j in joints if j.present and not j.mode and not j.unsure]
        yield from self.hold(joints)
        return (yield from self._switch(joints, on=True))

    def torque_off(self, joints: list[JointSlot]) -> Many:
        """Switch torque off and read it back; returns the mask of joints (by index) that confirmed."""
        return (yield from self._switch(joints, on=False))

    def _switch(self, joints: list[JointSlot], on: bool) -> Many:
        mask = 0
        for _ in range(_TRIES):
            missing = [j for j in joints if not mask >> self._joints.index(j) & 1]
            if not missing:
                break
            for joint in missing:
                # From now on a hold must not write a target to it, which could switch torque on again.
                joint.torque_on = joint.torque_on and on
                joint.unsure = True
            yield Transaction(make_sync_write(_TORQUE, {j.servo_id: bytes((int(on),)) for j in missing}), 0)
            mask |= yield from self.confirm(missing, on)
        return mask

    def confirm(self, joints: list[JointSlot], on: bool) -> Many:
        """Read torque switches back; returns the mask of joints (by index) that are as wanted."""
        mask = 0
        for joint in joints:
            if (yield from self.read_switches(joint)) and joint.torque_on == on:
                mask |= 1 << self._joints.index(joint)
        return mask
