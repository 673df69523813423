"""Bodies of the commands for robot controllers other than the Hex7Bot's board, and of the joystick channel.

Owns the packing of ROBOT_*, JOINT_COMMANDS, JOINT_STATES, JOINT_TRAJECTORY and JOYSTICK (PROTOCOL.md section 6).
Knows nothing of frames or particular robots.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import NamedTuple

from hexwire.errors import RemoteProtocolError, UsageError

__all__ = [
    "COMMAND_ARRAYS",
    "LAW_ARRAYS",
    "MAX_JOINTS",
    "EncoderRow",
    "EncoderStates",
    "JointCommands",
    "JoystickState",
    "RobotStatus",
    "TrajectoryPoints",
]

COMMAND_ARRAYS = (
    "position",
    "velocity",
    "effort",
    "kp_position",
    "ki_position",
    "kd_position",
    "kp_velocity",
    "i_effort_min",
    "i_effort_max",
)
"""Arrays of osrf_msgs/JointCommands, in the order of their mask bits."""
LAW_ARRAYS = COMMAND_ARRAYS[1:]
"""Those of them that say how the position is followed."""

MAX_JOINTS = 32
MAX_POINTS = 0xFFFF
MAX_AXES = 32
AXIS_FULL = 32767

_PROBE = struct.Struct("<IBBBB")
_STATES = struct.Struct("<IBB")
_STATE_ROW = struct.Struct("<iih")
_COMMANDS = struct.Struct("<BH")
_TRAJECTORY = struct.Struct("<BBH")
_JOYSTICK = struct.Struct("<BI")
_WITH_VELOCITIES = 0x01


def _need(name: str, body: bytes, size: int) -> None:
    if len(body) < size:
        raise RemoteProtocolError(f"{name}: {len(body)} bytes, at least {size} are needed")


class RobotStatus(NamedTuple):
    """Reply to ROBOT_PROBE."""

    boot_id: int
    mode: int
    robot_flags: int
    joints: int

    def serialize(self) -> bytes:
        """Serialize the body."""
        return _PROBE.pack(*self, 0)

    @classmethod
    def parse(cls, body: bytes) -> RobotStatus:
        """Parse the body."""
        _need("ROBOT_PROBE reply", body, _PROBE.size)
        return cls(*_PROBE.unpack_from(body)[:4])


class EncoderRow(NamedTuple):
    """One joint of JOINT_STATES: counts, counts/s, effort in 0.1 % of full."""

    counts: int
    speed: int
    effort: int


class EncoderStates(NamedTuple):
    """Body of JOINT_STATES."""

    time_us: int
    robot_flags: int
    rows: tuple[EncoderRow, ...]

    def serialize(self) -> bytes:
        """Serialize the body."""
        head = _STATES.pack(self.time_us & 0xFFFFFFFF, self.robot_flags, len(self.rows))
        return head + b"".join(_STATE_ROW.pack(*row) for row in self.rows)

    @classmethod
    def parse(cls, body: bytes) -> EncoderStates:
        """Parse the body."""
        _need("JOINT_STATES", body, _STATES.size)
        time_us, flags, n = _STATES.unpack_from(body)
        if len(body) != _STATES.size + n * _STATE_ROW.size:
            raise RemoteProtocolError(f"JOINT_STATES: {len(body)} bytes do not hold {n} rows")
        return cls(time_us, flags, tuple(EncoderRow(*row) for row in _STATE_ROW.iter_unpack(body[_STATES.size :])))


@dataclass(frozen=True, slots=True)
class JointCommands:
    """The fields of osrf_msgs/JointCommands: arrays in the order of `name`, each of the same length or empty.

    The effort that a controller applies is effort + kp_position * e + ki_position * (integral of e, its effort
    limited to i_effort_min..i_effort_max) + kd_position * de/dt + kp_velocity * (velocity error). Units:
    radians, seconds, newton metres.
    """

    name: tuple[str, ...]
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    kp_position: tuple[float, ...] = ()
    ki_position: tuple[float, ...] = ()
    kd_position: tuple[float, ...] = ()
    kp_velocity: tuple[float, ...] = ()
    i_effort_min: tuple[float, ...] = ()
    i_effort_max: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.name)
        if not 1 <= n <= MAX_JOINTS or len(set(self.name)) != n:
            raise UsageError(f"joint commands for {n} joints: 1 to {MAX_JOINTS}, each named once")
        if any(not 0 < len(name.encode()) <= 255 for name in self.name):
            raise UsageError("a joint name must have 1 to 255 bytes")
        for array in COMMAND_ARRAYS:
            values = getattr(self, array)
            if values and len(values) != n:
                raise UsageError(f"joint commands: {array} has {len(values)} values for {n} joints")
            if not all(map(math.isfinite, values)):
                raise UsageError(f"joint commands: {array} holds a value that is not a finite number")

    def serialize(self) -> bytes:
        """Serialize the body."""
        arrays = [getattr(self, array) for array in COMMAND_ARRAYS]
        mask = sum(1 << i for i, values in enumerate(arrays) if values)
        names = b"".join(bytes((len(name.encode()),)) + name.encode() for name in self.name)
        numbers = [value for values in arrays for value in values]
        return _COMMANDS.pack(len(self.name), mask) + names + struct.pack(f"<{len(numbers)}d", *numbers)

    @classmethod
    def parse(cls, body: bytes) -> JointCommands:
        """Parse the body."""
        _need("JOINT_COMMANDS", body, _COMMANDS.size)
        n, mask = _COMMANDS.unpack_from(body)
        at, names = _COMMANDS.size, []
        for _ in range(n):
            _need("JOINT_COMMANDS", body, at + 1)
            end = at + 1 + body[at]
            _need("JOINT_COMMANDS", body, end)
            try:
                names.append(body[at + 1 : end].decode())
            except UnicodeDecodeError:
                raise RemoteProtocolError("JOINT_COMMANDS: a joint name is not UTF-8") from None
            at = end
        present = [array for i, array in enumerate(COMMAND_ARRAYS) if mask >> i & 1]
        if mask >> len(COMMAND_ARRAYS) or len(body) != at + 8 * n * len(present):
            raise RemoteProtocolError(f"JOINT_COMMANDS: {len(body)} bytes do not hold {len(present)} arrays of {n}")
        numbers = struct.unpack_from(f"<{n * len(present)}d", body, at)
        arrays = {array: numbers[i * n : (i + 1) * n] for i, array in enumerate(present)}
        try:
            return cls(tuple(names), **arrays)
        except UsageError as error:
            raise RemoteProtocolError(f"JOINT_COMMANDS: {error}") from None


@dataclass(frozen=True, slots=True)
class TrajectoryPoints:
    """Body of JOINT_TRAJECTORY.

    Attributes:
        times: Seconds from the start, increasing.
        positions: Radians: one row per point, one value per joint.
        velocities: Radians per second, in the same shape; empty if not given.
    """

    times: tuple[float, ...]
    positions: tuple[tuple[float, ...], ...]
    velocities: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        n = len(self.times)
        joints = len(self.positions[0]) if self.positions else 0
        if not 1 <= n <= MAX_POINTS or not 1 <= joints <= MAX_JOINTS:
            raise UsageError(f"a trajectory of {n} points and {joints} joints cannot be sent")
        for rows in (self.positions, self.velocities):
            if rows and (len(rows) != n or any(len(row) != joints for row in rows)):
                raise UsageError("a trajectory needs one value per joint at every point")
            if not all(math.isfinite(value) for row in rows for value in row):
                raise UsageError("a trajectory holds a value that is not a finite number")
        if self.times[0] < 0 or not all(a < b for a, b in zip(self.times, self.times[1:], strict=False)):
            raise UsageError("times of a trajectory must start at 0 or later and increase")
        if not math.isfinite(self.times[-1]):
            raise UsageError("the last time of a trajectory must be finite")

    def serialize(self) -> bytes:
        """Serialize the body."""
        joints = len(self.positions[0])
        numbers: list[float] = []
        for i, when in enumerate(self.times):
            numbers.append(when)
            numbers.extend(self.positions[i])
            if self.velocities:
                numbers.extend(self.velocities[i])
        flags = _WITH_VELOCITIES if self.velocities else 0
        return _TRAJECTORY.pack(joints, flags, len(self.times)) + struct.pack(f"<{len(numbers)}d", *numbers)

    @classmethod
    def parse(cls, body: bytes) -> TrajectoryPoints:
        """Parse the body."""
        _need("JOINT_TRAJECTORY", body, _TRAJECTORY.size)
        joints, flags, points = _TRAJECTORY.unpack_from(body)
        with_velocities = bool(flags & _WITH_VELOCITIES)
        width = 1 + joints * (2 if with_velocities else 1)
        if not joints or len(body) != _TRAJECTORY.size + 8 * width * points:
            raise RemoteProtocolError(
                f"JOINT_TRAJECTORY: {len(body)} bytes do not hold {points} points of {joints}"
            )
        rows = list(struct.iter_unpack(f"<{width}d", body[_TRAJECTORY.size :]))
        try:
            return cls(
                tuple(row[0] for row in rows),
                tuple(row[1 : 1 + joints] for row in rows),
                tuple(row[1 + joints :] for row in rows) if with_velocities else (),
            )
        except UsageError as error:
            raise RemoteProtocolError(f"JOINT_TRAJECTORY: {error}") from None


@dataclass(frozen=True, slots=True)
class JoystickState:
    """Body of JOYSTICK.

    Attributes:
        axes: Positions of the axes, -1..1 each.
        buttons: Bit i is button i.
    """

    axes: tuple[float, ...]
    buttons: int

    def __post_init__(self) -> None:
        if len(self.axes) > MAX_AXES or not all(-1.0 <= axis <= 1.0 for axis in self.axes):
            raise UsageError(f"a joystick has at most {MAX_AXES} axes of -1 to 1")
        if not 0 <= self.buttons <= 0xFFFFFFFF:
            raise UsageError("a joystick has at most 32 buttons")

    def pressed(self, button: int) -> bool:
        """Whether a button, counted from 0, is down."""
        return bool(self.buttons >> button & 1)

    def serialize(self) -> bytes:
        """Serialize the body."""
        raw = [round(axis * AXIS_FULL) for axis in self.axes]
        return _JOYSTICK.pack(len(raw), self.buttons) + struct.pack(f"<{len(raw)}h", *raw)

    @classmethod
    def parse(cls, body: bytes) -> JoystickState:
        """Parse the body."""
        _need("JOYSTICK", body, _JOYSTICK.size)
        n, buttons = _JOYSTICK.unpack_from(body)
        if n > MAX_AXES or len(body) != _JOYSTICK.size + 2 * n:
            raise RemoteProtocolError(f"JOYSTICK: {len(body)} bytes do not hold {n} axes")
        raw = struct.unpack_from(f"<{n}h", body, _JOYSTICK.size)
        return cls(tuple(max(-1.0, value / AXIS_FULL) for value in raw), buttons)
