"""What a front sets of the arm it controls: rates, tolerances, controllers, checks.

Owns the values. Must not know where they come from: parameters, a file, a command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.motion.safety import SafetyLimits

from .goals import Tolerances
from .setting import Setting, rate_setting

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["CONTROLLER_SETTINGS", "SETTINGS", "ControllerSettings", "Settings"]


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
        connect_timeout: How long to try to reach the robot.
        publish_rate: States that are passed on a second; fewer where the link gives fewer.
        command_rate: Set-points a second; 0 for what the robot takes.
        watchdog: Silence after which the board stops the arm; 0 for never.
        command_timeout: Silence after which joints that pursue set-points hold; 0 for never.
        table: Height of the table that must not be touched; None to check none.
        enable_on_start: Give torque at the start.
        torque_off_at_exit: Take the torque away at the end.
        poses: Angle by joint, by name of the pose.
        pose_speed: Share of the speed limits on the way to a pose.
        teach_directory: Folder for what is taught; empty for none.
        safety: Thresholds that were given; see `safety_at`.
        controllers: At least one.
        model: The arm.
        kinematics: With limits for motion; None for an arm without geometry.
    """

    port: str
    connect_timeout: float
    publish_rate: float
    command_rate: float
    watchdog: float
    command_timeout: float
    table: float | None
    enable_on_start: bool
    torque_off_at_exit: bool
    poses: Mapping[str, Mapping[str, float]]
    pose_speed: float
    teach_directory: str
    safety: Mapping[str, float]
    controllers: tuple[ControllerSettings, ...]
    model: ArmModel
    kinematics: KinematicModel | None

    def safety_at(self, rate: float) -> SafetyLimits:
        """Thresholds at `rate` set-points a second: on a slow line, what was not given is widened."""
        return SafetyLimits.at_period(1.0 / rate, **self.safety)


SETTINGS = (
    Setting("port", "", "URL or device of the robot; empty is HEXWIRE_PORT, else the only likely board"),
    Setting("robot", "hex7bot", "name of the robot, or the TOML file of an arm on a servo bus"),
    Setting("connect_timeout", 10.0, "how long to try to reach the robot at the start", "s", low=0.0, high=3600.0),
    rate_setting("publish_rate", 100.0, "joint states a second, where the link allows it"),
    Setting(
        "command_rate",
        0.0,
        "set-points a second; 0 is what the robot's line allows",
        "Hz",
        low=1.0,
        high=200.0,
        zero=True,
    ),
    Setting(
        "watchdog",
        1.0,
        "silence after which the board stops the arm by itself; 0 is never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Setting(
        "command_timeout",
        0.5,
        "the arm holds when streamed set-points stay away for this long; 0 is never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Setting("links", "A", "link set of the 7Bot: A, B, V1, or the TOML file of one's own"),
    Setting("table_height", 0.0, "height of the table above the arm's base", "m", low=-2.0, high=2.0),
    Setting("check_table", True, "refuse a trajectory that would touch the table"),
    Setting("enable_on_start", False, "give torque at the start; nothing moves by it"),
    Setting("torque_off_at_exit", False, "take the torque away at the end: the arm may fall"),
    Setting("poses", {}, "poses by name, each with angles by joint", "rad"),
    Setting(
        "pose_speed", 0.3, "speed on the way to a pose, as a share of the limits", low=0.0, high=1.0, above=True
    ),
    Setting("teach_directory", "", "folder in which what was taught is saved; empty is not to save it"),
    Setting("safety", {}, "thresholds at which the arm stops by itself, by name"),
    Setting("joints", (), "joints of the only controller, in its order; empty is all"),
    Setting("allow_partial_joints_goal", False, "a trajectory may leave joints out; they stay where they are"),
    Setting("constraints", {}, "tolerances: goal_time, stopped_velocity_tolerance, JOINT/trajectory, JOINT/goal"),
    Setting("controllers", {}, "several controllers by name, each with its own of the three above"),
)
"""Every setting, in the order in which people read of them."""

CONTROLLER_SETTINGS = ("joints", "allow_partial_joints_goal", "constraints")
"""Settings of a controller, by name; where there is only one, they stand beside the others."""
