"""Values of a robot as plain rows in messages, and back.

Owns the conversion of states, targets, arm models and probe reports, and of what a server says of its arm. Must not
know Zenoh.
"""

from __future__ import annotations

import math
import socket
from dataclasses import asdict, astuple
from typing import TYPE_CHECKING, Any

import msgspec

from hexwire.drivers.abilities import OnboardPaths, OwnWatchdog
from hexwire.drivers.values import ProbeReport
from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointState, SentTarget

from . import messages as m

if TYPE_CHECKING:
    from hexwire.control.sharing.shared import SharedArm

__all__ = [
    "arm_model",
    "as_probe_report",
    "as_probe_rows",
    "facts_of",
    "joint_names",
    "joint_state",
    "joints_of",
    "sent_target",
]

# Learns the type, before any second thread: see the decoders of messages.
msgspec.json.Decoder(ProbeReport)
_MOST_JOINTS = 64
_LARGEST = 1e6


def joint_state(state: m.State, stamp: float) -> JointState:
    """The joint state in a message.

    Args:
        state: The message.
        stamp: Time of its newest sample on the reader's clock, seconds.

    Raises:
        RemoteProtocolError: Its columns differ in length.
    """
    n = len(state.names)
    if not (
        len(state.position) == len(state.velocity) == len(state.load) == len(state.current) == n
        and len(state.voltage) == len(state.temperature) == len(state.flags) == len(state.age) == n
    ):
        raise RemoteProtocolError("a state whose columns differ in length")
    return JointState(
        names=state.names,
        position=state.position,
        velocity=state.velocity,
        load=state.load,
        current=state.current,
        voltage=state.voltage,
        temperature=state.temperature,
        flags=state.flags,
        age=state.age,
        stamp=stamp,
        board_time=state.board_time,
        stopped=state.stopped,
        watchdog_tripped=state.tripped,
        stalled=state.stalled / 1000.0,
        maintenance=state.maintenance,
    )


def joints_of(model: ArmModel) -> tuple[m.Joint, ...]:
    """The joints of an arm's model."""
    return tuple(m.Joint(*astuple(joint)) for joint in model.joints)


def arm_model(facts: m.Facts) -> ArmModel:
    """The arm's model.

    Raises:
        RemoteProtocolError: It is not one.
    """
    times = (facts.rate, facts.command_rate, facts.max_age, facts.timeout)
    if not all(0.0 < value < _LARGEST for value in times):
        raise RemoteProtocolError("not the model of an arm: its rates and times are impossible")
    names = [joint.name for joint in facts.joints]
    if not names or not all(names) or len(set(names)) != len(names):
        raise RemoteProtocolError("not the model of an arm: its joints need a name each")
    for joint in facts.joints:
        numbers = (joint.offset, joint.scale, joint.minimum, joint.maximum)
        most = (joint.max_speed, joint.max_acceleration, joint.max_jerk)
        if not (
            all(map(math.isfinite, (*numbers, *most, joint.free_speed)))
            and joint.minimum <= joint.maximum
            and joint.scale != 0.0
            and min(most) > 0.0
            and joint.free_speed >= 0.0
            and joint.sign in (-1, 1)
        ):
            raise RemoteProtocolError(f"not the model of an arm: joint {joint.name} has impossible values")
    try:
        joints = tuple(JointModel(*msgspec.structs.astuple(joint)) for joint in facts.joints)
        return ArmModel(facts.robot, joints, facts.geometry)
    except UsageError as error:
        raise RemoteProtocolError(f"not the model of an arm: {error}") from None


def sent_target(value: Any) -> SentTarget:
    """A target as it was sent: names, angles, duration, clamped and silent joints.

    Raises:
        RemoteProtocolError: It is not one.
    """
    try:
        names, angles, duration, clamped, silent = value
        pairs = tuple((str(name), float(angle)) for name, angle in zip(names, angles, strict=True))
        return SentTarget(pairs, float(duration), tuple(map(str, clamped)), tuple(map(str, silent)))
    except (TypeError, ValueError, OverflowError):
        raise RemoteProtocolError("not a target as sent") from None


def joint_names(value: object) -> tuple[str, ...]:
    """Names of joints.

    Raises:
        RemoteProtocolError: They are not names.
    """
    if not isinstance(value, list | tuple):
        raise RemoteProtocolError("not names of joints")
    return tuple(map(str, value))


def as_probe_rows(report: ProbeReport) -> dict[str, Any]:
    """A probe report as a table."""
    return asdict(report)


def as_probe_report(rows: object, link: str) -> ProbeReport:
    """The probe report of a table.

    Args:
        rows: What arrived.
        link: Address of the arm for this program.

    Raises:
        RemoteProtocolError: It is not the table of a probe report.
    """
    if not isinstance(rows, dict) or not isinstance(rows.get("joints"), list | tuple):
        raise RemoteProtocolError("not a probe report")
    if len(rows["joints"]) > _MOST_JOINTS:
        raise RemoteProtocolError(f"a probe report of more than {_MOST_JOINTS} joints")
    # With what this program does not know left out: a newer server may report more.
    return m.convert({**rows, "link": link}, ProbeReport)


def facts_of(shared: SharedArm, server: str) -> m.Facts:
    """What a server says of its arm.

    Args:
        shared: The arm.
        server: The server, in words.
    """
    owner, holder, lease = shared.arm.owner, shared.holder, shared.rules
    robot, settings = owner.robot, shared.arm.settings
    model = robot.model
    return m.Facts(
        model.name,
        joints_of(model),
        settings.publish_rate,
        robot.command_rate,
        lease.max_age,
        lease.timeout,
        server,
        robot.url,
        holder.client if holder else "",
        "" if owner.connected else owner.error,
        shared.now(),
        socket.gethostname(),
        robot.can(OwnWatchdog),
        robot.stop_kept_by,
        model.geometry,
        robot.can(OnboardPaths) and not settings.host_timed,
    )
