"""Configurations: what `--robot.NAME=...` and `--teleop.NAME=...` set.

Owns the fields and the names under which LeRobot finds them. Must not know robots.
"""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

__all__ = [
    "GRIPPER_FORCE",
    "PATIENCE",
    "BiHexwireSO101Config",
    "BiHexwireSO101LeaderConfig",
    "FollowerFields",
    "GuideFields",
    "HexwireGamepadConfig",
    "HexwireHex7botConfig",
    "HexwireHex7botLeaderConfig",
    "HexwireKeyboardConfig",
    "HexwireRemoteConfig",
    "HexwireRemoteLeaderConfig",
    "HexwireRobotConfig",
    "HexwireSO100Config",
    "HexwireSO100LeaderConfig",
    "HexwireSO101Config",
    "HexwireSO101LeaderConfig",
    "HexwireTeleopConfig",
    "LeaderFields",
]


GRIPPER_FORCE = 0.2
"""Less than the load at which the servo protects itself after two seconds (`servos.GRIPPER`)."""
PATIENCE = 0.5
"""Seconds: the arm holds meanwhile, and a recording goes on."""


@dataclass(kw_only=True)
class FollowerFields:
    """What all robots have. The first five fields are those of LeRobot's own SO arms.

    Attributes:
        port: Port or address, as for `hexwire --port`.
        disable_torque_on_disconnect: Switch torque off at the end: the arm sinks.
        max_relative_target: Most that an action may differ from the present position, in units of the action; for
            all joints or by name.
        cameras: By name.
        use_degrees: Joints in degrees; otherwise -100 to 100 over their range. A gripper is always 0 to 100.
        meet_speed: Share of the speed limits at which the arm goes to the first action.
        max_speed: Most degrees per second afterwards, of all joints or by name; None for what the servos reach
            without a load.
        max_acceleration: Most degrees per second squared, likewise.
        table_mm: Height of the table above the arm's base, millimetres; null for no table.
        gripper_force: Load, as a share of full load, at which the gripper stops closing; 1 for no limit.
        on_fault: What is done about a fault that a servo reports, beside a line in the log when it comes first:
            "warn": nothing; "raise": an error, the arm holds; "torque_off": an error, the arm sinks.
        patience: Seconds in which a joint that does not answer is asked again, and a lost line is opened again.
        home_at_disconnect: Name of a saved pose to which the arm goes slowly before it is disconnected.
    """

    port: str
    disable_torque_on_disconnect: bool = True
    max_relative_target: float | dict[str, float] | None = None
    cameras: dict[str, CameraConfig] = field(default_factory=dict)
    use_degrees: bool = True
    meet_speed: float = 0.2
    max_speed: float | dict[str, float] | None = None
    max_acceleration: float | dict[str, float] | None = None
    table_mm: float | None = 0.0
    gripper_force: float = GRIPPER_FORCE
    on_fault: str = "warn"
    patience: float = PATIENCE
    home_at_disconnect: str | None = None


@dataclass(kw_only=True)
class HexwireRobotConfig(RobotConfig, FollowerFields):
    """A robot."""


@dataclass(kw_only=True)
class LeaderFields:
    """What all leaders have.

    Attributes:
        port: Port or address, as for `hexwire --port`.
        use_degrees: As for the robot; both must have the same value.
        patience: As for the robot.
    """

    port: str
    use_degrees: bool = True
    patience: float = PATIENCE


@dataclass(kw_only=True)
class HexwireTeleopConfig(TeleoperatorConfig, LeaderFields):
    """A leader."""


@RobotConfig.register_subclass("hexwire_so101")
@dataclass(kw_only=True)
class HexwireSO101Config(HexwireRobotConfig):
    """An SO-101 follower on its servo adapter.

    Attributes:
        auto_calibration: `lerobot-calibrate` lets the arm find its stops itself. It moves!
    """

    auto_calibration: bool = False


@RobotConfig.register_subclass("hexwire_so100")
@dataclass(kw_only=True)
class HexwireSO100Config(HexwireSO101Config):
    """An SO-100 follower on its servo adapter."""


@RobotConfig.register_subclass("hexwire_hex7bot")
@dataclass(kw_only=True)
class HexwireHex7botConfig(HexwireRobotConfig):
    """A Hex7Bot on its board."""


@RobotConfig.register_subclass("hexwire_remote")
@dataclass(kw_only=True)
class HexwireRemoteConfig(HexwireRobotConfig):
    """An arm that `hexwire serve` shares; the port is its address, as in ``zenoh:lab/arm1``.

    Attributes:
        arm: Kind of the arm: so101, so100 or hex7bot. LeRobot asks for the joints before it connects.
    """

    arm: str = "so101"


@TeleoperatorConfig.register_subclass("hexwire_so101_leader")
@dataclass(kw_only=True)
class HexwireSO101LeaderConfig(HexwireTeleopConfig):
    """An SO-101 leader on its servo adapter."""


@TeleoperatorConfig.register_subclass("hexwire_so100_leader")
@dataclass(kw_only=True)
class HexwireSO100LeaderConfig(HexwireTeleopConfig):
    """An SO-100 leader on its servo adapter."""


@TeleoperatorConfig.register_subclass("hexwire_hex7bot_leader")
@dataclass(kw_only=True)
class HexwireHex7botLeaderConfig(HexwireTeleopConfig):
    """A Hex7Bot without torque, moved by hand."""


@TeleoperatorConfig.register_subclass("hexwire_remote_leader")
@dataclass(kw_only=True)
class HexwireRemoteLeaderConfig(HexwireTeleopConfig):
    """A leader that `hexwire serve` shares.

    Attributes:
        arm: As in `HexwireRemoteConfig`.
    """

    arm: str = "so101"


@RobotConfig.register_subclass("bi_hexwire_so101")
@dataclass(kw_only=True)
class BiHexwireSO101Config(RobotConfig):
    """Two SO-101 followers, with the fields of LeRobot's own `bi_so_follower`."""

    # LeRobot's parser reads on for a text below each field that is a class, beyond the end of the file.
    left_arm_config: FollowerFields
    """The left one; its calibration file has the id with ``_left``."""
    right_arm_config: FollowerFields
    """The right one, likewise."""


@TeleoperatorConfig.register_subclass("bi_hexwire_so101_leader")
@dataclass(kw_only=True)
class BiHexwireSO101LeaderConfig(TeleoperatorConfig):
    """Two SO-101 leaders, with the fields of LeRobot's own `bi_so_leader`."""

    # LeRobot's parser reads on for a text below each field that is a class, beyond the end of the file.
    left_arm_config: LeaderFields
    """The left one; its calibration file has the id with ``_left``."""
    right_arm_config: LeaderFields
    """The right one, likewise."""


@dataclass(kw_only=True)
class GuideFields:
    """What the keyboard and a game pad have.

    Attributes:
        arm: Kind of the robot that they move: so101, so100 or hex7bot.
        speed: Of the tip, millimetres per second.
        turn: Of the tool, degrees per second.
        share: Share of the gripper's speed limit.
    """

    arm: str = "so101"
    speed: float = 80.0
    turn: float = 30.0
    share: float = 0.3


@TeleoperatorConfig.register_subclass("hexwire_keyboard")
@dataclass(kw_only=True)
class HexwireKeyboardConfig(TeleoperatorConfig, GuideFields):
    """The keyboard moves the tip of the robot that the program has connected."""


@TeleoperatorConfig.register_subclass("hexwire_gamepad")
@dataclass(kw_only=True)
class HexwireGamepadConfig(TeleoperatorConfig, GuideFields):
    """A game pad moves the tip of the robot that the program has connected.

    Attributes:
        device: The pad, as in ``/dev/input/js0``; the only one that is plugged in if not given.
        dead_man: Number of the button that must be held for anything to move.
    """

    device: str | None = None
    dead_man: int = 4
