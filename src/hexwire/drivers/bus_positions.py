"""The positions of an arm's joints from one sync read: the shortest state of an arm on a servo bus.

Owns the way from counts to a `JointState`, for loops that run at the line's own rate. Must not know links or stops.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from hexwire.model.state import JointFlag, JointState

from .replies import torque_flag

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hexwire.bus.values import Readings
    from hexwire.model.arm import ArmModel

__all__ = ["FAULTS", "PositionReader"]

_SILENT = int(JointFlag.SILENT)
FAULTS = int(JointFlag(0xFF).faults) & ~_SILENT
"""The bits of a servo's error byte that are faults of its joint."""


class PositionReader:
    """Makes states of readings, and keeps the newest position of each joint.

    Args:
        model: The arm.

    Attributes:
        ids: Servo ids, in the order of the joints.
        positions: Newest known position by joint name, radians.
        sampled: Time of the sample by joint name, seconds.
    """

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        self.ids = tuple(joint.servo_id for joint in model.joints)
        self.positions: dict[str, float] = {}
        self.sampled: dict[str, float] = {}
        self._unknown = (math.nan,) * len(self.ids)
        self._no_ages = (0.0,) * len(self.ids)
        self._newest: JointState | None = None
        self._torque: list[bool | None] = []

    def keep(self, state: JointState, torque: Sequence[bool | None]) -> JointState:
        """Return a state, which `recent` may return again if every joint has answered.

        Args:
            state: Just read.
            torque: Whether each joint has torque; None if unknown.
        """
        self._newest, self._torque = (None if any(state.age) else state), list(torque)
        return state

    def recent(self, now: float, within: float, torque: Sequence[bool | None], stopped: bool) -> JointState | None:
        """The last state with its age, if it is recent enough. Its positions are the newest known again.

        Args:
            now: Seconds.
            within: Most age, seconds.
            torque: As in `keep`; a state from before torque was switched does not count.
            stopped: Whether the arm is stopped.
        """
        newest = self._newest
        if newest is None or not 0.0 <= now - newest.stamp <= within or self._torque != torque:
            return None
        self.positions.update(zip(newest.names, newest.position, strict=True))
        ages = (now - newest.stamp,) * len(self.ids)
        return replace(newest, age=ages, stamp=now, stopped=stopped)

    def state(self, readings: Readings, torque: Sequence[bool | None], stopped: bool) -> JointState:
        """Make the state.

        Args:
            readings: Of ``present_position``, one per joint.
            torque: Whether each joint has torque; None if unknown.
            stopped: Whether the arm is stopped.
        """
        joints, names, now = self._model.joints, self._model.names, readings.stamp
        flags = [torque_flag(on) for on in torque]
        if readings.ok:
            # Nearly every call comes here.
            angles = [
                joint.sign * (counts - joint.neutral) * joint.scale + joint.offset
                for joint, counts in zip(joints, readings.raw, strict=True)
                if counts is not None
            ]
            self.positions.update(zip(names, angles, strict=True))
            self.sampled.update(dict.fromkeys(names, now))
            ages = self._no_ages
        else:
            angles = []
            for i, (joint, one) in enumerate(zip(joints, readings, strict=True)):
                if one.raw is None:
                    flags[i] |= _SILENT
                else:
                    flags[i] |= one.status & FAULTS
                    self.positions[joint.name] = joint.counts_to_angle(one.raw)
                    self.sampled[joint.name] = now
                angles.append(self.positions.get(joint.name, math.nan))
            ages = tuple([now - self.sampled.get(name, -math.inf) for name in names])
        unknown = self._unknown
        return JointState(
            names=names,
            position=tuple(angles),
            velocity=unknown,
            load=unknown,
            current=unknown,
            voltage=unknown,
            temperature=unknown,
            flags=tuple(flags),
            age=ages,
            stamp=now,
            stopped=stopped,
        )
