"""An emulated PUMA 260 controller: a robot with little in common with the Hex7Bot.

Owns the motion of six joints with encoders and what the controller answers. Any number of hosts may be connected,
each through a `PumaPeer` with a session of its own; all share one robot. Time comes in as `now`. Knows no sockets.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hexwire.errors import RemoteProtocolError
from hexwire.model.arm import JointModel
from hexwire.model.arms.puma260.kinematics import PUMA260, angles_to_counts
from hexwire.model.control_law import ControlLaw
from hexwire.session.connection import Connection, Role
from hexwire.session.events import Request
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status
from hexwire.wire.commands import Identity, JointRow
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import (
    LAW_ARRAYS,
    EncoderRow,
    EncoderStates,
    JointCommands,
    RobotStatus,
    TrajectoryPoints,
)

__all__ = ["EmulatedPuma", "Gains", "Path", "PumaPeer", "gains_of"]

INERTIA = 0.05
"""kg m^2 of every joint: the order of magnitude of a small arm, not measured."""
FRICTION = 0.05
"""N m s/rad of every joint, not measured either."""
_ACTING = ("effort", "kp_position", "ki_position", "kd_position", "kp_velocity")


class Path:
    """A cubic curve through waypoints, from the joints' present position and velocity.

    The speed at a waypoint is the one given, else the mean of its two sides; at the end the joints are at rest.

    Args:
        trajectory: The waypoints.
        origin: Present positions, radians; the path starts there unless the first waypoint is at time 0.
        velocity: Present velocities, rad/s.
    """

    def __init__(self, trajectory: TrajectoryPoints, origin: Sequence[float], velocity: Sequence[float]) -> None:
        self._times = list(trajectory.times)
        self._points = list(trajectory.positions)
        self._given = list(trajectory.velocities)
        self._start = tuple(velocity)
        if self._times[0] > 0.0:
            self._times.insert(0, 0.0)
            self._points.insert(0, tuple(origin))
            if self._given:
                self._given.insert(0, self._start)
        self.duration = self._times[-1]

    def at(self, t: float) -> tuple[float, ...]:
        """Positions `t` seconds after the start, radians."""
        times, points = self._times, self._points
        if t >= self.duration:
            return points[-1]
        if t <= times[0]:
            return points[0]
        k = bisect_right(times, t) - 1
        span = times[k + 1] - times[k]
        u = (t - times[k]) / span
        start, end = self._slopes(k), self._slopes(k + 1)
        # Hermite's polynomials.
        a, b = 2 * u**3 - 3 * u**2 + 1, 3 * u**2 - 2 * u**3
        c, d = span * (u**3 - 2 * u**2 + u), span * (u**3 - u**2)
        rows = zip(points[k], points[k + 1], start, end, strict=True)
        return tuple(a * p + b * q + c * v + d * w for p, q, v, w in rows)

    def _slopes(self, k: int) -> tuple[float, ...]:
        if self._given:
            return self._given[k]
        if k == 0:
            return self._start
        if k == len(self._times) - 1:
            return (0.0,) * len(self._start)
        span = self._times[k + 1] - self._times[k - 1]
        slopes = []
        for before, here, after in zip(self._points[k - 1], self._points[k], self._points[k + 1], strict=True):
            # A turning point is passed at rest, so that no joint overshoots its waypoint.
            slopes.append(0.0 if (here - before) * (after - here) <= 0 else (after - before) / span)
        return tuple(slopes)


@dataclass(slots=True)
class Gains:
    """One joint under a control law, in place of the controller's own loop."""

    law: ControlLaw
    integral: float = 0.0

    def torque(self, error: float, velocity: float, tick: float) -> float:
        """Torque of the drive, newton metres; `error` in radians, speeds in rad/s."""
        law = self.law
        self.integral += error * tick
        by_integral = law.ki_position * self.integral
        held = max(law.i_effort_min, min(law.i_effort_max, by_integral))
        if held != by_integral and law.ki_position:
            # Anti-windup: the integral does not grow beyond its limit.
            self.integral = held / law.ki_position
        return (
            law.effort
            + law.kp_position * error
            + held
            - law.kd_position * velocity
            + law.kp_velocity * (law.velocity - velocity)
        )

    def acceleration(self, error: float, velocity: float, tick: float) -> float:
        """The resulting acceleration, rad/s^2."""
        return (self.torque(error, velocity, tick) - FRICTION * velocity) / INERTIA


def gains_of(commands: JointCommands, i: int) -> Gains | None:
    """The control law for the i-th joint of `commands`; None if they give neither an effort nor a gain."""
    if not any(getattr(commands, array) for array in _ACTING):
        return None
    return Gains(ControlLaw(**{array: values[i] for array in LAW_ARRAYS if (values := getattr(commands, array))}))


TICK = 0.001
_GAIN = 12.0
"""Proportional gain toward a set-point, 1/s; the joints' speed limits apply as well."""
_ACCELERATION = math.radians(400.0)
_REST_EFFORT = 0.02
_MODE_POSITION, _MODE_TEACH = 0, 1
_STOP, _STOP_TORQUE_OFF, _RESUME, _TORQUE_ON, _TORQUE_OFF = 1, 2, 3, 4, 5
_SCALE = tuple(joint.scale for joint in PUMA260.joints)
_RUN_ON = 0.5
"""Seconds for which a velocity without a position, or gains, are obeyed: without a host no joint runs on."""
_FIRMWARE = (1, 0, 0)


class EmulatedPuma:
    """The robot and its controller.

    Args:
        start: The time at which it starts.

    Attributes:
        position: Radians.
        velocity: Radians per second.
        executed: The last JOINT_COMMANDS and JOINT_TRAJECTORY that were accepted.
    """

    def __init__(self, *, start: float = 0.0) -> None:
        n = len(PUMA260.joints)
        self.start = start
        self.boot_id = 1
        self.mode = _MODE_POSITION
        self.stopped = False
        self.power = False
        self.position = [0.0] * n
        self.velocity = [0.0] * n
        self.executed: deque[JointCommands | TrajectoryPoints] = deque(maxlen=256)
        self._setpoint = list(self.position)
        self._path: Path | None = None
        self._began = 0.0
        self._running = [0.0] * n
        self._run_until = 0.0
        self._gains: list[Gains | None] = [None] * n
        self._ticks = 0

    def connect(
        self, max_frame: int = tables.MAX_NETWORK_FRAME, *, numbers: Callable[[], int] | None = None
    ) -> PumaPeer:
        """Connect a new host; over datagrams, with a source of random numbers as `Connection` takes it."""
        return PumaPeer(self, max_frame, numbers=numbers)

    # -- motion -------------------------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether a joint moves or is about to move."""
        if self._path is not None or any(self._running) or any(abs(v) > 1e-6 for v in self.velocity):
            return True
        return self.power and any(
            abs(goal - at) > scale for goal, at, scale in zip(self._setpoint, self.position, _SCALE, strict=True)
        )

    @property
    def flags(self) -> int:
        """The robot flags."""
        return (
            (tables.ROBOT_FLAGS_STOPPED if self.stopped else 0)
            | (tables.ROBOT_FLAGS_POWER_ON if self.power else 0)
            | (tables.ROBOT_FLAGS_MOVING if self.moving else 0)
            | tables.ROBOT_FLAGS_CALIBRATED
        )

    def step(self, now: float) -> None:
        """Let time pass, in whole ticks."""
        target = int((now - self.start) / TICK + 1e-9)
        if not self.moving and not any(self._gains):
            self._ticks = target
        while self._ticks < target:
            self._ticks += 1
            self._tick(self.start + self._ticks * TICK)

    def hold(self) -> None:
        """Make the present position the target."""
        n = len(self.position)
        self._path = None
        self._setpoint = list(self.position)
        self._running = [0.0] * n
        self._gains = [None] * n
        self.velocity = [0.0] * n

    def _tick(self, now: float) -> None:
        # Joints may reach twice the speed limit on a path: following it at the limit needs a reserve.
        reserve = 1.0
        if self._path is not None:
            reserve = 2.0
            self._setpoint = list(self._path.at(now - self._began))
            if now - self._began >= self._path.duration:
                self._path = None
        if now > self._run_until:
            self._running = [0.0] * len(self._running)
            for i, gains in enumerate(self._gains):
                if gains is not None:
                    self._gains[i], self._setpoint[i] = None, self.position[i]
        for i, joint in enumerate(PUMA260.joints):
            if self._running[i]:
                goal = self._setpoint[i] + self._running[i] * TICK
                self._setpoint[i] = max(joint.minimum, min(joint.maximum, goal))
            self._move(i, joint, reserve * joint.max_speed)

    def _move(self, i: int, joint: JointModel, fastest: float) -> None:
        error = self._setpoint[i] - self.position[i]
        gains = self._gains[i]
        if gains is not None:
            pull = gains.acceleration(error, self.velocity[i], TICK)
            wanted = max(-fastest, min(fastest, self.velocity[i] + pull * TICK))
        else:
            wanted = max(-fastest, min(fastest, _GAIN * error))
        change = max(-_ACCELERATION * TICK, min(_ACCELERATION * TICK, wanted - self.velocity[i]))
        self.velocity[i] += change
        there = abs(error) < 0.25 * joint.scale and abs(self.velocity[i]) < joint.scale / TICK / 50
        if there and gains is None:
            self.velocity[i] = 0.0
            self.position[i] = self._setpoint[i]
            return
        moved = self.position[i] + self.velocity[i] * TICK
        self.position[i] = max(joint.minimum, min(joint.maximum, moved))
        if self.position[i] != moved:
            # The joint has reached its limit.
            self.velocity[i] = 0.0

    # -- what hosts ask -----------------------------------------------------------------------------

    def states(self, now: float) -> EncoderStates:
        """JOINT_STATES at this moment."""
        counts = angles_to_counts(self.position)
        # Speeds go through the same coupling: counts of the angles one second later, minus the present counts.
        later = angles_to_counts([p + v for p, v in zip(self.position, self.velocity, strict=True)])
        rows = []
        for i, joint in enumerate(PUMA260.joints):
            effort = _REST_EFFORT if self.power else 0.0
            effort += 0.3 * self.velocity[i] / joint.max_speed
            rows.append(EncoderRow(counts[i], later[i] - counts[i], round(max(-1.0, min(1.0, effort)) * 1000)))
        return EncoderStates(int((now - self.start) * 1e6) & 0xFFFFFFFF, self.flags, tuple(rows))

    def signal(self, number: int) -> Status:
        """Act on a signal."""
        if number in (_STOP, _STOP_TORQUE_OFF):
            self.stopped = True
            self.hold()
            self.power = self.power and number == _STOP
        elif number == _RESUME:
            self.stopped = False
        elif number == _TORQUE_ON:
            if self.stopped:
                return Status.STOPPED
            if self.mode != _MODE_POSITION:
                return Status.NOT_SUPPORTED
            if not self.power:
                self.hold()
            self.power = True
        elif number == _TORQUE_OFF:
            self.hold()
            self.power = False
        else:
            return Status.BAD_RANGE
        return Status.OK

    def set_mode(self, mode: int) -> Status:
        """Switch to position or teach mode; both begin at the present position."""
        if mode not in (_MODE_POSITION, _MODE_TEACH):
            return Status.BAD_RANGE
        if self.stopped:
            return Status.STOPPED
        self.mode = mode
        self.hold()
        self.power = self.power and mode == _MODE_POSITION
        return Status.OK

    def command(self, commands: JointCommands, now: float) -> Status:
        """Apply set-points, speeds, efforts and gains to some joints; the others continue."""
        refusal = self._refusal()
        if refusal is not Status.OK:
            return refusal
        names = PUMA260.names
        if any(name not in names for name in commands.name):
            return Status.BAD_RANGE
        goal = list(self._setpoint)
        for name, angle in zip(commands.name, commands.position, strict=False):
            goal[names.index(name)] = angle
        if not self._inside(goal):
            return Status.BAD_RANGE
        self._path = None
        self._setpoint = goal
        self._run_until = now + _RUN_ON
        for k, name in enumerate(commands.name):
            i = names.index(name)
            speed = commands.velocity[k] if commands.velocity and not commands.position else 0.0
            self._running[i] = max(-PUMA260.joints[i].max_speed, min(PUMA260.joints[i].max_speed, speed))
            self._gains[i] = gains_of(commands, k)
        self.executed.append(commands)
        return Status.OK

    def follow(self, trajectory: TrajectoryPoints, now: float) -> Status:
        """Follow a trajectory, from the joints' position or, if one is under way, from that one's present point."""
        refusal = self._refusal()
        if refusal is not Status.OK:
            return refusal
        if len(trajectory.positions[0]) != len(PUMA260.joints) or not all(map(self._inside, trajectory.positions)):
            return Status.BAD_RANGE
        n = len(self.position)
        self._running, self._gains = [0.0] * n, [None] * n
        self._path = Path(trajectory, *self._reference(now))
        self._began = now
        self.executed.append(trajectory)
        return Status.OK

    def _reference(self, now: float) -> tuple[Sequence[float], Sequence[float]]:
        """Position and velocity at which a new path starts."""
        if self._path is None:
            return self.position, self.velocity
        here, before = self._path.at(now - self._began), self._path.at(now - self._began - TICK)
        return here, [(b - a) / TICK for a, b in zip(before, here, strict=True)]

    def _refusal(self) -> Status:
        if self.stopped:
            return Status.STOPPED
        if self.mode != _MODE_POSITION:
            return Status.NOT_SUPPORTED
        return Status.OK if self.power else Status.TORQUE_OFF

    @staticmethod
    def _inside(angles: Sequence[float]) -> bool:
        return all(
            joint.minimum - joint.scale <= angle <= joint.maximum + joint.scale
            for joint, angle in zip(PUMA260.joints, angles, strict=True)
        )


class PumaPeer:
    """One host's session with the controller; a served device like a board.

    Attributes:
        heard: When the last valid request arrived; None before the first.
        commanded: When the last request arrived that changed something; None before the first.
    """

    def __init__(
        self,
        robot: EmulatedPuma,
        max_frame: int = tables.MAX_NETWORK_FRAME,
        *,
        numbers: Callable[[], int] | None = None,
    ) -> None:
        self.robot = robot
        self.heard: float | None = None
        self.commanded: float | None = None
        self.connection = Connection(
            Role.BOARD,
            local=ModuleType.PUMA260_RBT_IO_SVR,
            remote=ModuleType.PUMA260_HOST_IO_TRX,
            type=ModuleType.PUMA260_RBT_IO_SVR,
            max_frame=max_frame,
            epoch=-robot.start,
            numbers=numbers,
        )
        self._conversation = 0
        self._asked: list[Request] = []
        self._report_period = 0.0
        self._report_due: float | None = None

    def receive(self, data: bytes, now: float, *, end_of_message: bool = False) -> None:
        """Take bytes from the host. They end a silence; only `step` judges it, see `serve.deliver`.

        So it also answers who asks where the joints are: what other hosts have sent may wait to be read.
        """
        self.connection.receive(data, now, end_of_message=end_of_message)
        self._answer_all(now)

    def step(self, now: float) -> None:
        """Do what is due."""
        self.robot.step(now)
        asked, self._asked = self._asked, []
        for request in asked:
            self._reply(request, now)
        due = self.connection.next_timeout()
        if due is not None and due <= now:
            self.connection.handle_timeout(now)
            self._answer_all(now)
        if self._report_due is not None and self._report_due <= now:
            self.connection.report(Command.JOINT_STATES, self.robot.states(now).serialize(), now)
            self._report_due = max(self._report_due + self._report_period, now)

    def frames_to_send(self) -> list[bytes]:
        """Frames for the host, one a message."""
        return self.connection.data_to_send()

    def data_to_send(self) -> bytes:
        """The frames for the host as a stream of bytes."""
        return b"".join(self.frames_to_send())

    def next_event_time(self) -> float | None:
        """When `step` has something to do."""
        times = [t for t in (self._report_due, self.connection.next_timeout()) if t is not None]
        return min(times, default=None)

    def reset(self, now: float) -> None:
        """Change nothing: a line that is reopened does not restart the robot."""

    def _answer_all(self, now: float) -> None:
        while (event := self.connection.next_event()) is not None:
            if isinstance(event, Request) and event.frame.proto == tables.PROTO_HEXWIRE:
                conversations = self.connection.conversations
                if conversations is None or event.frame.cmd != Command.IDENTIFY:
                    self.heard = now
                if conversations is not None and conversations.count != self._conversation:
                    # A host has identified itself anew, and this is not a late copy of an earlier IDENTIFY.
                    self._conversation = conversations.count
                    self._report_due = None
                if event.frame.cmd in _LOOKS:
                    self._asked.append(event)
                else:
                    self._reply(event, now)

    def _reply(self, request: Request, now: float) -> None:
        try:
            status, body = self._answer(request, now)
        except RemoteProtocolError:
            status, body = Status.BAD_LENGTH, b""
        if request.frame.cmd in _COMMANDS and status is Status.OK:
            self.commanded = now
        self.connection.reply(request, status, body if status is Status.OK else b"", now)

    def _answer(self, request: Request, now: float) -> tuple[Status, bytes]:
        robot, cmd, body = self.robot, request.frame.cmd, request.frame.body
        if cmd == Command.JOINT_COMMANDS:
            return robot.command(JointCommands.parse(body), now), b""
        if cmd == Command.JOINT_TRAJECTORY:
            trajectory = TrajectoryPoints.parse(body)
            return robot.follow(trajectory, now), len(trajectory.times).to_bytes(2, "little")
        if cmd not in _BODY_SIZE:
            return Status.UNKNOWN_COMMAND, b""
        if len(body) != _BODY_SIZE[cmd]:
            return Status.BAD_LENGTH, b""
        if cmd == Command.IDENTIFY:
            if self.connection.conversations is None:
                self._report_due = None
            return Status.OK, self._identity().serialize()
        if cmd == Command.ROBOT_PROBE:
            n = len(PUMA260.joints)
            return Status.OK, RobotStatus(robot.boot_id, robot.mode, robot.flags, n).serialize()
        if cmd == Command.JOINT_STATES:
            return Status.OK, robot.states(now).serialize()
        if cmd == Command.ROBOT_SIGNAL:
            return robot.signal(body[0]), bytes((robot.mode, robot.flags))
        if cmd == Command.ROBOT_MODE:
            return robot.set_mode(body[0]), bytes((robot.mode, robot.flags))
        return self._report(body, now, request.frame.src)

    def _report(self, body: bytes, now: float, src: int) -> tuple[Status, bytes]:
        period = int.from_bytes(body[:2], "little") / 1000
        if period and not 0.005 <= period <= 10:
            return Status.BAD_RANGE, b""
        self._report_period = period
        self._report_due = now + period if period else None
        self.connection.remote = src
        return Status.OK, body

    def _identity(self) -> Identity:
        rows = tuple(JointRow(joint.servo_id, tables.SERIES_CODES["unknown"], True) for joint in PUMA260.joints)
        can = tables.CAPABILITY_REPORT | tables.CAPABILITY_FRAGMENTS
        flags = tables.BOARD_FLAGS_STOPPED if self.robot.stopped else 0
        boot_id, longest = self.robot.boot_id, self.connection.max_frame
        return Identity(tables.PROTO_HEXWIRE, _FIRMWARE, boot_id, can, longest, flags, rows)


_COMMANDS = {Command.JOINT_COMMANDS, Command.JOINT_TRAJECTORY, Command.ROBOT_SIGNAL, Command.ROBOT_MODE}
"""Requests that change something."""
_LOOKS = {Command.JOINT_STATES, Command.ROBOT_PROBE}
"""Requests whose answer shows where the joints are."""
_BODY_SIZE: dict[int, int] = {
    Command.IDENTIFY: 0,
    Command.ROBOT_PROBE: 0,
    Command.JOINT_STATES: 0,
    Command.ROBOT_SIGNAL: 1,
    Command.ROBOT_MODE: 1,
    Command.REPORT: 3,
}
"""Body lengths, in bytes, of the requests whose body has a fixed length."""
