"""What a front sets of the arm it controls: rates, tolerances, controllers, checks.

Owns the values. Must not know where they come from: parameters, a file, a command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.motion.safety import SafetyLimits

from .goals import Tolerances

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["ControllerSettings", "Settings"]


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """One trajectory controller.

    Attributes:
        name: As in ``arm_controller``; empty for the only one there is.
        joints: Names in the controller's order.
        allow_partial: A trajectory may leave joints out.
        tolerances: What holds where a goal asks for none of its own.
    """

    name: str
    joints: tuple[str, ...]
    allow_partial: bool
    tolerances: Tolerances


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of an owned arm, checked, and the arm they were checked against.

    Times are seconds, rates hertz, angles radians, lengths metres.

    Attributes:
        port: URL or device of the robot, wherever it came from.
        poses: Angle by joint, by name of the pose.
        safety: Thresholds that were given; see `safety_at`.
        controllers: At least one.
        model: The arm.
        kinematics: With limits for motion; None for an arm without geometry.
        warnings: What was given to no effect, a line each.
    """

    port: str
    robot: str
    connect_timeout: float
    publish_rate: float
    command_rate: float
    state_publish_rate: float
    action_monitor_rate: float
    diagnostics_rate: float
    watchdog: float
    command_timeout: float
    links: str
    table_height: float
    check_table: bool
    enable_on_start: bool
    torque_off_at_exit: bool
    frame_id: str
    hardware_id: str
    poses: Mapping[str, Mapping[str, float]]
    pose_speed: float
    teach_directory: str
    safety: Mapping[str, float]
    controllers: tuple[ControllerSettings, ...]
    model: ArmModel
    kinematics: KinematicModel | None
    warnings: tuple[str, ...] = ()

    @property
    def table(self) -> float | None:
        """Height of the table that must not be touched, metres; None if that is not checked."""
        return self.table_height if self.check_table and self.kinematics is not None else None

    def safety_at(self, rate: float) -> SafetyLimits:
        """Thresholds at `rate` set-points a second: on a slow line, what was not given is widened."""
        return SafetyLimits.at_period(1.0 / rate, **self.safety)
