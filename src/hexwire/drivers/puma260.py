"""`Puma260Driver`: a six-joint robot with its own controller, over TCP or UDP.

Owns the translation between joints in SI units and encoder counts with their wrist coupling, and the use of the
chapter's channels. Must not know sockets or callers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import IntEnum
from pathlib import Path
from typing import Any, ClassVar, Self

from hexwire.arguments import WHOLE, Wanted, one_of
from hexwire.errors import ConfigError, RemoteProtocolError, UsageError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.url import parse_url
from hexwire.model.arms.puma260.kinematics import PUMA260, angles_to_counts, counts_to_angles
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.motion.limits import check_target, needed_duration
from hexwire.session.effects import Effect, effect_of
from hexwire.units import decimal
from hexwire.wire import tables
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import IpcType, ModuleType
from hexwire.wire.robot_bodies import (
    LAW_ARRAYS,
    EncoderStates,
    JointCommands,
    RobotStatus,
    TrajectoryPoints,
)

from .abilities import ObeysGains, StateReports
from .base import JointProbe, ProbeReport, Signal, StopMode
from .replies import check_reply
from .session_driver import SessionDriver

__all__ = ["Puma260Driver", "Puma260Mode"]

_MINIMUM_DURATION = 0.02
_BOOT_WINDOW = 1.5
_MIN_PERIOD, _MAX_PERIOD = 0.005, 10.0


class Puma260Mode(IntEnum):
    """Modes of the controller, for `ioctl(Command.ROBOT_MODE, bytes([mode]))` and `set_mode`."""

    POSITION = 0
    """Follows joint commands and trajectories."""
    TEACH = 1
    """Without torque: the arm is moved by hand; commands are refused."""


class Puma260Driver(SessionDriver, StateReports, ObeysGains):
    """The PUMA 260 behind its controller.

    One channel is enough. With a configuration file, or over TCP, each of the chapter's modules has its own:
    PUMA260_HOST_IO_TRX for signals and modes, HOST_JNT_CMD_TX for joint commands, HOST_JSTATE_RX for joint states,
    HOST_JTRAJ_TX for trajectories, so that a long trajectory does not delay a stop.

    `ioctl` takes ROBOT_MODE, ROBOT_PROBE, ROBOT_SIGNAL and JOINT_STATES with the bodies of PROTOCOL.md section 6.
    `signal` takes the numbers of `hexwire.drivers.base.Signal`.

    Args:
        session: The I/O channel.
        commands: Channel of joint commands; the I/O channel if None.
        states: Channel of joint states; the I/O channel if None.
        trajectories: Channel of trajectories; the I/O channel if None.
        boot_window: Seconds to wait for a controller that does not answer yet.
    """

    _arguments: ClassVar = {
        "command": {"commands": one_of(JointCommands)},
        "follow": {"trajectory": one_of(TrajectoryPoints)},
        "set_mode": {"mode": Wanted("a Puma260Mode", lambda value: WHOLE.fits(value) and value in (*Puma260Mode,))},
    }

    def __init__(
        self,
        session: Session,
        *,
        commands: Session | None = None,
        states: Session | None = None,
        trajectories: Session | None = None,
        boot_window: float = _BOOT_WINDOW,
    ) -> None:
        super().__init__(session, *filter(None, (commands, states, trajectories)))
        self.model = PUMA260
        self.commands = commands or session
        self.states = states or session
        self.trajectories = trajectories or session
        self._boot_window = boot_window

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """Make a driver for the controller that `url` names: four TCP connections, or one UDP channel.

        A configuration file is read by `from_conf`.

        Raises:
            UsageError: The URL is invalid, or there is an option other than `boot_window`.
        """
        unknown = set(options) - {"boot_window"}
        if unknown:
            raise UsageError(f"puma260 has no option {', '.join(sorted(unknown))}")

        parts = parse_url(url)
        if parts.scheme == "conf":
            from hexwire.ipc.conf import conf_parts

            return cls.from_conf(conf_parts(parts)[0], **options)

        def channel(module: ModuleType) -> Session:
            return Session(IpcHandle.from_url(url, module, ModuleType.PUMA260_RBT_IO_SVR))

        io = channel(ModuleType.PUMA260_HOST_IO_TRX)
        if io.ipc.type is not IpcType.TCP:
            return cls(io, **options)
        return cls(
            io,
            commands=channel(ModuleType.PUMA260_HOST_JNT_CMD_TX),
            states=channel(ModuleType.PUMA260_HOST_JSTATE_RX),
            trajectories=channel(ModuleType.PUMA260_HOST_JTRAJ_TX),
            **options,
        )

    @classmethod
    def from_conf(cls, file: str | Path, **options: Any) -> Self:
        """Make a driver for the channels that an `ipc_msg.conf` names; other modules share the I/O channel.

        The options are those of the constructor.

        UDP channels to the same port of the controller also share it, since one port answers one caller.

        Raises:
            ConfigError: The file is invalid, or has no channel of PUMA260_HOST_IO_TRX.
        """
        from hexwire.ipc.conf import link_url, load_conf

        named = {channel.module: channel for channel in load_conf(file)}
        io = named.get(ModuleType.PUMA260_HOST_IO_TRX)
        if io is None:
            raise ConfigError("no channel of PUMA260_HOST_IO_TRX", file=str(file))

        def channel(module: ModuleType) -> Session | None:
            found = named.get(module)
            if found is None or not found.direction.sends:
                # One that only receives cannot ask for states: they are asked for on the I/O channel.
                return None
            if found.interface is IpcType.UDP and link_url(found) == link_url(io):
                return None
            return Session.from_conf(file, module)

        return cls(
            Session.from_conf(file, ModuleType.PUMA260_HOST_IO_TRX),
            commands=channel(ModuleType.PUMA260_HOST_JNT_CMD_TX),
            states=channel(ModuleType.PUMA260_HOST_JSTATE_RX),
            trajectories=channel(ModuleType.PUMA260_HOST_JTRAJ_TX),
            **options,
        )

    # -- attaching and detaching --------------------------------------------------------------------

    def attach(self) -> None:
        self._check_directions()
        try:
            for session in self.sessions:
                session.open()
                # The negotiation also makes the controller restart the sequence numbers.
                session.negotiate(dialect=tables.PROTO_HEXWIRE, boot_window=self._boot_window)
            self._status()
        except BaseException:
            self.detach()
            raise

    def detach(self, *, torque_off: bool = False) -> None:
        try:
            if torque_off and self.session.is_open:
                self.torque(False)
        finally:
            for session in self.sessions:
                session.close()

    def probe(self) -> ProbeReport:
        status = self._status()
        return ProbeReport(
            robot=self.model.name,
            link=self.session.ipc.link.url,
            dialect=tables.PROTO_HEXWIRE,
            boot_id=status.boot_id,
            capabilities=(Puma260Mode(status.mode).name.lower(),) if status.mode in (0, 1) else (),
            stopped=bool(status.robot_flags & tables.ROBOT_FLAGS_STOPPED),
            joints=tuple(
                JointProbe(j.name, j.servo_id, j.series, j.servo_id < status.joints) for j in self.model.joints
            ),
            counters=self.host_counters(),
        )

    def host_counters(self) -> dict[str, int]:
        counters = self.session.connection.counters
        return {"requests": counters.requests, "replies": counters.replies, "retries": counters.retries}

    # -- reading ------------------------------------------------------------------------------------

    def read(self) -> JointState:
        reply = check_reply(self.states.request(Command.JOINT_STATES, repeatable=True))
        return self._decode(EncoderStates.parse(reply.body), self.states.now())

    def stream(self, period: float, timeout: float = 1.0, *, slow: float | None = None) -> Iterator[JointState]:
        """Yield the states that the controller reports every `period` seconds.

        Ends after `timeout` seconds without a report. Continues after a reconnection. `slow` has no effect: these
        reports have no values that could be left out.
        """
        if not _MIN_PERIOD <= period <= _MAX_PERIOD:
            raise UsageError(f"a report every {period:g} s is outside {_MIN_PERIOD:g}..{_MAX_PERIOD:g} s")
        body = round(period * 1000).to_bytes(2, "little") + b"\0"
        states = self.states
        try:
            while True:
                check_reply(states.request(Command.REPORT, body, repeatable=True))
                generation = states.generation
                for frame, arrived in states.reports(timeout):
                    if frame.cmd == Command.JOINT_STATES:
                        yield self._decode(EncoderStates.parse(frame.body), arrived)
                if states.generation == generation:
                    return
        finally:
            if states.is_open:
                check_reply(states.request(Command.REPORT, b"\0\0\0", repeatable=True))

    def _decode(self, states: EncoderStates, now: float) -> JointState:
        counts = [row.counts for row in states.rows]
        if len(counts) != len(self.model.joints):
            raise RemoteProtocolError(f"JOINT_STATES of {len(counts)} joints; puma260 has {len(self.model.joints)}")
        position = counts_to_angles(counts)
        # Velocities have the same coupling: the angles of the counts one second later minus the present angles.
        later = counts_to_angles([row.counts + row.speed for row in states.rows])
        return JointState.of(
            dict(zip(self.model.names, position, strict=True)),
            velocity=tuple(b - a for a, b in zip(position, later, strict=True)),
            load=tuple(row.effort / 1000 for row in states.rows),
            torque=bool(states.robot_flags & tables.ROBOT_FLAGS_POWER_ON),
            stamp=now,
            board_time=states.time_us * 1e-6,
            stopped=bool(states.robot_flags & tables.ROBOT_FLAGS_STOPPED),
        )

    # -- motion -------------------------------------------------------------------------------------

    def write(self, target: JointTarget) -> SentTarget:
        """Send joints to a target as a trajectory of one waypoint; the other joints hold.

        A target with gains is sent as joint commands instead, and the other joints continue.
        """
        if target.laws:
            with self.session.epochs.calling("a move"):
                return self._write_with_gains(target)
        with self.session.epochs.calling("a move"):
            # Read again, so that a joint that was moved meanwhile is not sent back.
            present = self.read().positions
            checked = check_target(self.model, target, present)
            goal = present | dict(checked.positions)
            # Encoders count whole steps: send angles that they can represent.
            angles = counts_to_angles(angles_to_counts([goal[name] for name in self.model.names]))
            duration = max(checked.duration, _MINIMUM_DURATION)
            self._send(TrajectoryPoints((duration,), (angles,)))
        named = dict(zip(self.model.names, angles, strict=True))
        return SentTarget(tuple((name, named[name]) for name, _ in checked.positions), duration)

    def _write_with_gains(self, target: JointTarget) -> SentTarget:
        laws = {self.model.joint(name).name: law for name, law in target.laws}
        positions = {self.model.joint(name).name: angle for name, angle in target.positions}
        for name, angle in positions.items():
            # Before the first of two commands is sent.
            self.model.joint(name).check(angle)
        if others := {name: angle for name, angle in positions.items() if name not in laws}:
            # In a command of their own: an array of gains puts every joint that it names under them.
            self.command(JointCommands(tuple(others), tuple(others.values())))
        arrays = {field: tuple(getattr(law, field) for law in laws.values()) for field in LAW_ARRAYS}
        self.command(JointCommands(tuple(laws), tuple(positions[name] for name in laws), **arrays))
        return SentTarget(tuple(positions.items()), target.duration)

    def follow(self, trajectory: TrajectoryPoints) -> None:
        """Follow a trajectory of all joints; replaces the present one. Long trajectories are sent in fragments.

        Raises:
            LimitError: A waypoint is outside the limits; nothing was sent.
            UsageError: A joint would exceed its speed limit between two waypoints.
        """
        names = self.model.names
        if len(trajectory.positions[0]) != len(names):
            raise UsageError(f"a trajectory of {len(trajectory.positions[0])} joints; puma260 has {len(names)}")
        with self.session.epochs.calling("a trajectory"):
            self._check_speeds(trajectory, self.read().positions)
            self._send(trajectory)

    def _check_speeds(self, trajectory: TrajectoryPoints, before: dict[str, float]) -> None:
        names, when = self.model.names, 0.0
        for time, row in zip(trajectory.times, trajectory.positions, strict=True):
            goal = dict(zip(names, row, strict=True))
            for joint, angle in zip(self.model.joints, row, strict=True):
                joint.check(angle)
            needed = needed_duration(self.model, before, goal)
            # One millisecond of tolerance: a duration that one call has lengthened must pass the next check.
            if needed > time - when + 0.001:
                raise UsageError(
                    f"the waypoint at {time:g} s is {decimal(needed - (time - when), 3)} s too early for the "
                    "speed limits"
                )
            before, when = goal, time

    def _send(self, trajectory: TrajectoryPoints) -> None:
        check_reply(self.trajectories.request(Command.JOINT_TRAJECTORY, trajectory.serialize()))

    def command(self, commands: JointCommands) -> None:
        """Send set-points with the fields of osrf_msgs/JointCommands; the other joints continue.

        Positions go to the controller's own loop, and so does a velocity without a position, for half a second. An
        effort or a gain selects the control law of JointCommands for the named joints instead.

        Raises:
            LimitError: A position is outside the limits; nothing was sent.
            UsageError: A joint does not exist, or a velocity is over its limit.
        """
        joints = [self.model.joint(name) for name in commands.name]
        for joint, angle in zip(joints, commands.position, strict=False):
            joint.check(angle)
        for joint, speed in zip(joints, commands.velocity, strict=False):
            if abs(speed) > joint.max_speed * (1 + 1e-9):
                raise UsageError(
                    f"{joint.name} at {decimal(math.degrees(speed))} deg/s is over its limit of "
                    f"{decimal(math.degrees(joint.max_speed))} deg/s; nothing was sent"
                )
        named = replace(commands, name=tuple(joint.name for joint in joints))
        with self.session.epochs.calling("joint commands"):
            check_reply(self.commands.request(Command.JOINT_COMMANDS, named.serialize()))

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        """Switch power on or off. The controller has one switch, so power on for one joint is power on for all.

        Raises:
            UsageError: Power off is requested for single joints.
        """
        named = {self.model.joint(name).name for name in joints or self.model.names}
        if not on and named != set(self.model.names):
            raise UsageError("puma260 has one power switch and cannot switch single joints off; name no joints")
        self._signal(Signal.TORQUE_ON if on else Signal.TORQUE_OFF)
        return self.model.names

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        number = Signal.STOP if mode == StopMode.HOLD else Signal.STOP_TORQUE_OFF
        with self.session.epochs.stopping():
            check_reply(
                self.session.request(
                    Command.ROBOT_SIGNAL, bytes((number,)), urgent=True, repeatable=True, attempts=5
                )
            )
        return self.model.names

    def resume(self) -> None:
        with self.session.epochs.calling("resume", freeing=True):
            # Requests sent over another channel before the stop must arrive, and be refused, before the stop ends.
            for session in self.sessions[1:]:
                check_reply(session.request(Command.ROBOT_PROBE, repeatable=True))
            self._signal(Signal.RESUME)

    def set_mode(self, mode: Puma260Mode) -> None:
        """Switch between position and teach mode. Nothing moves."""
        check_reply(self.session.request(Command.ROBOT_MODE, bytes((mode,))))

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        allowed = (Command.ROBOT_MODE, Command.ROBOT_PROBE, Command.ROBOT_SIGNAL, Command.JOINT_STATES)
        if sub_cmd not in allowed:
            known = ", ".join(f"0x{c:02X} {c.name}" for c in allowed)
            raise UsageError(f"puma260 has no ioctl 0x{sub_cmd:02X}; it has {known}")
        return check_reply(self.session.request(sub_cmd, data)).body

    def may_move(self, sub_cmd: int, data: bytes = b"") -> bool:
        return effect_of(tables.PROTO_HEXWIRE, sub_cmd, data) is Effect.ACT

    def _signal(self, signal: Signal) -> None:
        check_reply(self.session.request(Command.ROBOT_SIGNAL, bytes((signal,))))

    def _status(self) -> RobotStatus:
        reply = self.session.request(Command.ROBOT_PROBE, repeatable=True)
        return RobotStatus.parse(check_reply(reply).body)
