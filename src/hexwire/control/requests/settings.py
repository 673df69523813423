"""Settings of a controlled arm: rates, tolerances, controllers, checks.

Owns the values. Must not know where they come from: parameters, a file, a command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.motion.safety import SafetyLimits

from ..motion.goals import Tolerances
from .setting import Setting, rate_setting

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["CHANGEABLE", "CONTROLLER_SETTINGS", "REPORT_SETTINGS", "SETTINGS", "ControllerSettings", "Settings"]


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """One trajectory controller.

    Attributes:
        name: For example ``arm_controller``; empty if there is only one controller.
        joints: Names in the controller's order.
        allow_partial: A trajectory may omit joints.
        tolerances: Defaults for goals that give none.
        end_at_rest: Refuse a trajectory whose last point has a velocity.
    """

    name: str
    joints: tuple[str, ...]
    allow_partial: bool
    tolerances: Tolerances
    end_at_rest: bool = False


@dataclass(frozen=True, slots=True)
class Settings:
    """All settings of a controlled arm, checked, with the model of the arm they were checked against.

    Times are in seconds, rates in hertz, angles in radians, lengths in metres.

    Attributes:
        port: URL or device of the robot.
        connect_timeout: How long to try to reach the robot.
        publish_rate: States published per second; fewer on a slow link.
        command_rate: Set-points per second; 0 for the rate that the robot allows.
        watchdog: Silence after which the board stops the arm; 0 for never.
        host_timed: Send trajectories target by target, also to a board that executes trajectories itself.
        command_timeout: Silence after which joints that follow set-points hold; 0 for never.
        links: Link set of a 7Bot, as in `make_kinematics`.
        table: Height of the table that must not be touched; None for no check.
        enable_on_start: Switch torque on at the start.
        torque_off_at_exit: Switch torque off at shutdown.
        poses: Name of a pose -> joint -> angle.
        pose_speed: Fraction of the speed limits used when moving to a pose.
        teach_directory: Folder for taught motions; empty for none.
        log_positions: Log the joint positions once a second.
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
    host_timed: bool
    command_timeout: float
    links: str
    table: float | None
    enable_on_start: bool
    torque_off_at_exit: bool
    poses: Mapping[str, Mapping[str, float]]
    pose_speed: float
    teach_directory: str
    log_positions: bool
    safety: Mapping[str, float]
    controllers: tuple[ControllerSettings, ...]
    model: ArmModel
    kinematics: KinematicModel | None

    def safety_at(self, rate: float) -> SafetyLimits:
        """Thresholds at `rate` set-points per second; those that were not given are widened on a slow line."""
        return SafetyLimits.at_period(1.0 / rate, **self.safety)


SETTINGS = (
    Setting(
        "port",
        "",
        "URL or device of the robot, or its ipc_msg.conf; empty means HEXWIRE_PORT, else the only likely board",
    ),
    Setting("robot", "hex7bot", "name of the robot, or the TOML file of an arm on a servo bus"),
    Setting("connect_timeout", 10.0, "how long to try to reach the robot at the start", "s", low=0.0, high=3600.0),
    rate_setting("publish_rate", 100.0, "joint states per second, if the link allows it"),
    Setting(
        "command_rate",
        0.0,
        "set-points per second; 0 means the rate that the robot's line allows",
        "Hz",
        low=1.0,
        high=200.0,
        zero=True,
    ),
    Setting(
        "watchdog",
        1.0,
        "silence after which the board stops the arm; 0 means never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Setting("host_timed", False, "send trajectories target by target, also if the board can execute them itself"),
    Setting(
        "command_timeout",
        0.5,
        "the arm holds when no set-point has arrived for this long; 0 means never",
        "s",
        low=0.05,
        high=60.0,
        zero=True,
    ),
    Setting("links", "A", "link set of the 7Bot: A, B, V1, or your own TOML file"),
    Setting("table_height", 0.0, "height of the table above the arm's base", "m", low=-2.0, high=2.0),
    Setting("check_table", True, "refuse a trajectory that would touch the table"),
    Setting("enable_on_start", False, "switch torque on at the start; this moves nothing"),
    Setting("torque_off_at_exit", False, "switch torque off at shutdown: the arm may fall"),
    Setting("poses", {}, "poses by name, each with angles by joint", "rad"),
    Setting(
        "pose_speed", 0.3, "speed when moving to a pose, as a fraction of the limits", low=0.0, high=1.0, above=True
    ),
    Setting("teach_directory", "", "folder in which taught motions are saved; empty means not to save them"),
    Setting("log_positions", False, "log the joint positions once a second, in degrees"),
    Setting("safety", {}, "thresholds at which the arm stops automatically, by name"),
    Setting("joints", (), "joints of the only controller, in its order; empty means all"),
    Setting("allow_partial_joints_goal", False, "a trajectory may omit joints; they stay where they are"),
    Setting("constraints", {}, "tolerances: goal_time, stopped_velocity_tolerance, JOINT/trajectory, JOINT/goal"),
    Setting("controllers", {}, "several controllers by name, each with its own values of the three above"),
)
"""Every setting, in the order of the documentation."""

CONTROLLER_SETTINGS = ("joints", "allow_partial_joints_goal", "constraints")
"""Names of the settings of a controller; if there is only one, they are at the top level."""

CHANGEABLE = ("pose_speed", "allow_partial_joints_goal", "constraints", "controllers")
"""Names of the settings that may change while the arm is in use, but not the joints of a controller."""

REPORT_SETTINGS = (
    rate_setting("state_publish_rate", 50.0, "controller states per second"),
    rate_setting("action_monitor_rate", 20.0, "feedback messages per second while a goal is active"),
    rate_setting("diagnostics_rate", 1.0, "diagnostics per second; a change is published immediately", high=100.0),
    Setting("frame_id", "", "frame in the headers of joint states"),
    Setting("hardware_id", "", "hardware id in the diagnostics; empty means the URL of the link"),
)
"""Settings of a program that publishes what the arm does; they do not concern the arm."""
