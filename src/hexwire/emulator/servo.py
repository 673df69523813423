"""An emulated bus servo: packets in, status packets out, and a shaft that moves.

Owns one servo's registers, motion and protection, and what each instruction does to them. Knows no line: echo,
collisions and line rate belong to `servo_wire`. Time comes in as `now`; `step` works in whole milliseconds from 0,
so that the same commands at the same times give the same registers, whatever steps the time is divided into.

Assumptions where the public documents say nothing:

- A goal written while the torque is off turns the torque on. That is measured for STS; the chapter's board moves
  legacy servos only by such writes.
- Turning the torque on without a new goal holds the shaft where it is.
- A legacy servo answers reads of 1 or 2 bytes, but no longer ones, and no writes unless `answers_writes` is set.
- HLS secondary_id 0 means none: this is the factory value, and id 0 belongs to another servo.
- The answer to a write of the id still has the old id.
- Instructions that a series does not have are not answered.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import lru_cache

from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import (
    BROADCAST_ID,
    Instruction,
    ServoPacket,
    make_legacy_ping_status,
    make_status,
    parse_sync_write,
)
from hexwire.wire.tables import INSTRUCTIONS

from . import servo_control as control
from .servo_motion import TICK, Mechanics, Motion, MotorDrive
from .servo_protection import Protection
from .servo_registers import RegisterFile

__all__ = ["REBOOT_TIME", "EmulatedServo"]

REBOOT_TIME = 0.8
"""Seconds of silence after REBOOT (vendor protocol document)."""

_CALIBRATE_MID = 128
_PRESSES = 12
"""Counts from where a shaft stands to a goal that presses on what blocks it; a servo that holds is closer."""
_NAMES = {code: name for name, code in INSTRUCTIONS.items()}
_METHODS = {code: f"_do_{name.lower()}" for code, name in _NAMES.items()}
# All servos of a bus parse the same packet.
_rows_of = lru_cache(maxsize=64)(parse_sync_write)


class EmulatedServo:
    """One servo on an emulated bus.

    Args:
        series: Its family.
        servo_id: Its stored id, 0..253.
        position: Shaft position at power-up, counts; None for the neutral position of the series.
        seed: Seed of the noise.
        firmware: Version, if the series reports one.
        settings: Stored values of EEPROM registers, by name, instead of the factory's.
        gravity: Torque of gravity at a shaft position, as a fraction of the stall torque, positive toward higher
            counts.
        idle_load: Offset of the load reading, 0.1 %.
        noise: Standard deviation of readings, in counts of position and 0.1 % of load; 0 is none.
        answers_writes: Legacy only: acknowledge writes as Feetech servos do.
        mechanics: Motor and gears; None for those of the series.
        stops: Mechanical stops of the arm, counts of the shaft; None if only the servo's own are there.
        start: The time of power-up.

    Attributes:
        registers: Its memory.
        motion: Its shaft; hooks `gravity`, `external_torque`, `hand` and `obstacle` are there.
        protection: Its status bits and temperature.
        return_delay: Seconds from a request to the answer, where no register sets it.
    """

    def __init__(
        self,
        series: Series,
        servo_id: int,
        *,
        position: float | None = None,
        seed: int = 0,
        firmware: tuple[int, int] | None = None,
        settings: dict[str, int] | None = None,
        gravity: Callable[[float], float] | None = None,
        idle_load: int = 0,
        noise: float = 0.0,
        answers_writes: bool = False,
        mechanics: Mechanics | None = None,
        stops: tuple[float, float] | None = None,
        start: float = 0.0,
    ) -> None:
        if not 0 <= servo_id <= 253:
            raise UsageError(f"servo id {servo_id} is outside 0..253")
        self.series = series
        self.registers = RegisterFile(series, servo_id, firmware=firmware, settings=settings)
        self.motion = Motion(
            mechanics or control.MECHANICS[series], series.neutral if position is None else position
        )
        self.motion.gravity = gravity
        self.motion.stops = stops or self.motion.stops
        self.protection = Protection(control.limits_of(self.registers), temperature=28.0)
        self.idle_load = idle_load
        self.noise = noise
        self.answers_writes = answers_writes
        self.return_delay = 250e-6
        self._seed = seed
        self._supply = control.SUPPLY[series]
        self._tick = int(start / TICK + 1e-6)
        self._silent_until = self._tick
        self._goal_distance = 0.0
        self._target = self.motion.position
        self._pending: tuple[int, bytes] | None = None
        self._shown: tuple[object, ...] | None = ()
        self._goal = control.goal_name(series)
        # Every servo of a bus compares its id with that of every request.
        self._live, self._id_at = self.registers.live, self.registers.rows["id"].address
        # Kept here because each request asks for them: looking up a member of an enum is slow.
        self._baud_codes, self._instructions = series.baud_codes, series.instructions
        self._is_legacy = series is Series.SEVEN_BOT
        self._is_hls, self._is_scs = series is Series.HLS, series is Series.SCS
        self._power_up()

    # --- what the line needs to know ---------------------------------------------------------------------------

    @property
    def servo_id(self) -> int:
        """The id it answers to now."""
        return self._live[self._id_at]

    @property
    def baud(self) -> int:
        """Line rate it listens at now."""
        codes = self._baud_codes
        return codes[self.registers.get("baud_code")] if codes else self.series.baud

    @property
    def answer_delay(self) -> float:
        """Seconds from the end of a request to its answer; register return_delay counts on SCS only."""
        if self._is_scs:
            return max(50, self.registers.get("return_delay")) * 2e-6
        return self.return_delay

    @property
    def supply(self) -> float:
        """Supply voltage, volts."""
        return self._supply

    @supply.setter
    def supply(self, volts: float) -> None:
        self._supply = float(volts)
        self._watch()

    @property
    def torque_on(self) -> bool:
        """Whether the motor is driven; damping does not count."""
        return self.registers.get("torque_enable") == 1

    @property
    def present_position(self) -> int:
        """What the position register says, without noise."""
        return self._present(self.motion.position)

    # --- time --------------------------------------------------------------------------------------------------

    def step(self, now: float) -> None:
        """Let time pass up to `now`, in seconds; an earlier time does nothing."""
        until = int(now / TICK + 1e-6)
        motion, protection = self.motion, self.protection
        stall = motion.mechanics.stall_current
        advance, tick = protection.advance, self._tick
        while tick < until:
            count = 1
            if motion.settled:
                push = abs(motion.torque)
                count = min(until - tick, protection.horizon(tick, push, push * stall))
            else:
                motion.tick()
                push = abs(motion.torque)
            if advance(tick, count, push, push * stall, self._supply):
                self._drive()
            tick += count
            self._tick = tick

    def power_cycle(self, now: float, silent: float = 0.0) -> None:
        """Interrupt the supply: RAM is lost, the shaft stays, the servo answers again after `silent` seconds."""
        self.step(now)
        self._silent_until = self._tick + round(silent / TICK)
        turn = self.series.counts_per_rev
        if self.motion.mechanics.stops is None:
            self.motion.rename(-(self.motion.position // turn) * turn)
        self.registers.power_up()
        self._power_up()

    def _power_up(self) -> None:
        self._pending = None
        self._target = self.motion.position
        self.protection.clear()
        self._watch()

    # --- packets -----------------------------------------------------------------------------------------------

    def is_addressed(self, packet: ServoPacket) -> bool:
        """Whether a request is for this servo, alone or among others."""
        asked = packet.servo_id
        if asked == BROADCAST_ID or asked == self._live[self._id_at]:
            return True
        # Zero means no second id.
        return bool(self._is_hls and asked and asked == self.registers.get("secondary_id"))

    def receive(self, packet: ServoPacket, now: float) -> bytes | None:
        """Take a request off the bus.

        Returns:
            The answer's bytes, or None: not addressed, nothing to answer, or still starting.
        """
        if not self.is_addressed(packet):
            # Nothing changes; the servo catches up in time at its next request or step.
            return None
        own = self._live[self._id_at]
        broadcast = packet.servo_id == BROADCAST_ID
        self.step(now)
        instruction = _NAMES.get(packet.instruction)
        if self._tick < self._silent_until or instruction not in self._instructions:
            return None
        if packet.servo_id == own or broadcast:
            status: bytes | None = getattr(self, _METHODS[packet.instruction])(packet, own)
            return None if broadcast and instruction not in ("PING", "SYNC_READ") else status
        if instruction in ("WRITE", "REG_WRITE"):
            getattr(self, _METHODS[packet.instruction])(packet, own)
        return None

    def _status(self, servo_id: int, params: bytes = b"") -> bytes:
        return make_status(servo_id, self.protection.status, params, legacy=self._is_legacy)

    def _acknowledge(self, servo_id: int) -> bytes | None:
        if self._is_legacy:
            return self._status(servo_id) if self.answers_writes else None
        return self._status(servo_id) if self.registers.get("status_return_level") else None

    def _do_ping(self, packet: ServoPacket, own: int) -> bytes | None:
        return make_legacy_ping_status(own) if self._is_legacy else self._status(own)

    def _do_read(self, packet: ServoPacket, own: int) -> bytes | None:
        if len(packet.params) != 2:
            return None
        address, count = packet.params
        if not 0 < count <= self.series.max_read or address + count > 256:
            return None
        self.refresh()
        return self._status(own, self.registers.read(address, count))

    def _do_write(self, packet: ServoPacket, own: int) -> bytes | None:
        if len(packet.params) < 2:
            return None
        answer = self._acknowledge(own)
        self._write(packet.params[0], packet.params[1:])
        return answer

    def _do_reg_write(self, packet: ServoPacket, own: int) -> bytes | None:
        if len(packet.params) < 2:
            return None
        self._pending = (packet.params[0], packet.params[1:])
        self._flag_pending()
        return self._acknowledge(own)

    def _do_action(self, packet: ServoPacket, own: int) -> bytes | None:
        answer = self._acknowledge(own)
        pending, self._pending = self._pending, None
        self._flag_pending()
        if pending is not None:
            self._write(*pending)
        return answer

    def _do_restore(self, packet: ServoPacket, own: int) -> bytes | None:
        answer = self._acknowledge(own)
        self.registers.restore(1 if self._is_legacy else own)
        self._power_up()
        return answer

    def _do_reboot(self, packet: ServoPacket, own: int) -> bytes | None:
        self.power_cycle(self._tick * TICK, REBOOT_TIME)
        return None

    def _do_backup(self, packet: ServoPacket, own: int) -> bytes | None:
        self.registers.backup()
        return self._acknowledge(own)

    def _do_reset_state(self, packet: ServoPacket, own: int) -> bytes | None:
        turns = self.motion.position // self.series.counts_per_rev * self.series.counts_per_rev
        self.motion.rename(-turns)
        self._target -= turns
        self._drive()
        return self._acknowledge(own)

    def _do_calibrate(self, packet: ServoPacket, own: int) -> bytes | None:
        firmware = self.registers.firmware
        takes_position = firmware >= ((3, 43) if self._is_hls else (3, 10))
        if len(packet.params) not in (0, 2) or (packet.params and not takes_position):
            return None
        if self.series is Series.STS_SMS and firmware < (3, 10):
            return None
        row = self.registers.rows["goal_position"]
        self._calibrate(row.decode(packet.params) if packet.params else self.series.neutral)
        return self._acknowledge(own)

    def _do_sync_read(self, packet: ServoPacket, own: int) -> bytes | None:
        if own not in packet.params[2:]:
            return None
        return self._do_read(ServoPacket(own, Instruction.READ, packet.params[:2]), own)

    def _do_sync_write(self, packet: ServoPacket, own: int) -> bytes | None:
        try:
            address, rows = _rows_of(packet)
        except RemoteProtocolError:
            return None
        for servo_id, data in rows:
            if servo_id == own:
                self._write(address, data)
        return None

    # --- what writes do ----------------------------------------------------------------------------------------

    def _write(self, address: int, data: bytes) -> None:
        was_on = self.registers.get("torque_enable")
        touched = self.registers.write(address, data)
        if not touched:
            return
        if "torque_enable" in touched:
            self._torque_written(was_on)
        if self._goal in touched or (self._is_scs and "goal_time" in touched):
            self.registers.put("torque_enable", 1)
            self._goal_written()
        self._watch()

    def _torque_written(self, was: int) -> None:
        value = self.registers.get("torque_enable")
        if value == _CALIBRATE_MID:
            self.registers.put("torque_enable", was)
            self._calibrate(self.series.neutral)
        elif value > 2:
            self.registers.put("torque_enable", was)
        else:
            self.protection.clear()
            if value == 1 and was != 1:
                self._target = self.motion.position
                self.registers.put(self._goal, self.present_position)

    def _goal_written(self) -> None:
        goal = self.registers.get(self._goal)
        position = self.motion.position
        if control.drive_mode(self.registers) == "step":
            self._target += goal
        else:
            goal = control.clamp_goal(self.registers, goal)
            self._target = goal + self._offset() + self._turns(position)
        before, self._goal_distance = self._goal_distance, self._target - position
        presses_on = self._goal_distance * before > 0.0 and abs(self._goal_distance) > _PRESSES
        if not presses_on:
            self.protection.clear()

    def _calibrate(self, position: int) -> None:
        """Calibrate so that the present position reads `position`; stored at once, as in the real servos."""
        wanted = round(self.motion.position) % self.series.counts_per_rev - position
        self.registers.put_stored("position_offset", wanted)
        self._target = self.motion.position
        self._drive()

    def _offset(self) -> int:
        return self.registers.get("position_offset") if "position_offset" in self.registers.rows else 0

    def _turns(self, shaft: float) -> int:
        """Counts of whole turns that the position register leaves out."""
        if self.motion.mechanics.stops is not None or control.is_multi_turn(self.registers):
            return 0
        turn = self.series.counts_per_rev
        return (round(shaft) - self._offset()) // turn * turn

    def _present(self, shaft: float) -> int:
        return round(shaft) - self._offset() - self._turns(shaft)

    def _watch(self) -> None:
        """Registers or supply have changed: update the limits, then the drive."""
        self.protection.limits = control.limits_of(self.registers)
        self.protection.sense(self._supply)
        self._drive()

    def _drive(self) -> None:
        """Command the motor as the registers and the protection say."""
        torque = self.registers.get("torque_enable")
        allowed = self.protection.ceiling
        motion = self.motion
        if torque != 1 or allowed == 0.0:
            drive = MotorDrive.DAMPED if torque == 2 else MotorDrive.FREE
            motion.command(drive, target=motion.position, speed=0.0, acceleration=0.0, ceiling=0.0)
            return
        order = control.order_for(self.registers, motion.mechanics, self._supply, self._goal_distance, self._target)
        motion.command(
            order.drive,
            target=order.target,
            speed=order.speed,
            acceleration=order.acceleration,
            ceiling=min(order.ceiling, allowed),
        )

    def _flag_pending(self) -> None:
        if "reg_write_pending" in self.registers.rows:
            self.registers.put("reg_write_pending", int(self._pending is not None))

    # --- what reads see ----------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Bring the read-only registers up to date."""
        shown = self._as_it_was()
        if shown is not None and shown == self._shown:
            return
        self._show()
        self._shown = self._as_it_was()

    def _as_it_was(self) -> tuple[object, ...] | None:
        """All that the read-only registers of a servo at rest depend on; None if they change on their own."""
        motion, protection = self.motion, self.protection
        if self.noise or not motion.settled:
            return None
        return (
            self.registers.version,
            protection.status,
            round(protection.temperature),
            self._supply,
            self.idle_load,
            self._target,
            motion.position,
            motion.velocity,
            motion.torque,
        )

    def _show(self) -> None:
        registers, motion = self.registers, self.motion
        jitter_position = jitter_load = 0
        if self.noise:
            # Seeded by the tick, so that more frequent reads do not change the noise.
            draw = random.Random(self._seed * 1_000_003 + self._tick)
            jitter_position = round(draw.gauss(0, self.noise))
            jitter_load = round(draw.gauss(0, self.noise))
        position = self.present_position + jitter_position
        if self._is_legacy:
            registers.put("present_position", max(0, min(4095, position)))
            return
        duty = motion.torque + motion.velocity / motion.mechanics.max_speed if self.torque_on else 0.0
        load = round(max(-1.0, min(1.0, duty)) * 1000) + self.idle_load + jitter_load
        amperes = motion.torque * motion.mechanics.stall_current
        moving = abs(motion.velocity) >= 1.0
        registers.put("present_position", max(0, position) if self._is_scs else position)
        registers.put("present_speed", round(motion.velocity / control.speed_unit(registers)))
        registers.put("present_load", max(-1000, min(1000, load)))
        registers.put("present_voltage", round((self._supply - 0.3 * abs(motion.torque)) * 10))
        registers.put("present_temperature", round(self.protection.temperature))
        registers.put("status", self.protection.status)
        registers.put("present_current", round(amperes / control.AMPERES))
        if self._is_hls:
            arrived = not self.torque_on or abs(self._target - motion.position) < 2
            registers.put("moving", int(moving) | (0 if arrived else 2))
        else:
            registers.put("moving", int(moving))
        if "target_position" in registers.rows:
            registers.put("target_position", self._present(self._target))
