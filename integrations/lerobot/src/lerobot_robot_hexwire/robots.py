"""The robots: arms that LeRobot observes and moves.

Owns LeRobot's contract of a robot, and how an action becomes a target: the arm goes to the first action slowly,
then follows within its limits and speeds (`hexwire.motion.following`, the rules of `hexwire follow`). Must not know
servos or links.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

from lerobot.cameras import Camera
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.motors import Motor, MotorNormMode
from lerobot.robots import Robot
from lerobot.robots.so_follower import SOFollower
from lerobot.robots.utils import ensure_safe_goal_position

from hexwire.control.following import following_rules
from hexwire.control.guided import Notes
from hexwire.control.path_check import PathCheck
from hexwire.errors import HexwireError, LinkError
from hexwire.model.gripper import Jaws, jaws_of
from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.following import Following

from .config_hexwire import (
    HexwireHex7botConfig,
    HexwireRemoteConfig,
    HexwireRobotConfig,
    HexwireSO100Config,
    HexwireSO101Config,
)
from .connection import faults, translated
from .device import HexwireDevice, RemoteDevice, SoDevice
from .joint_values import SUFFIX

__all__ = ["HexwireHex7bot", "HexwireRemote", "HexwireRobot", "HexwireSO100", "HexwireSO101"]

logger = logging.getLogger(__name__)

_FRESH, _PRESSING = 0.25, 0.02
"""Seconds for which an observation says where the arm is; then `send_action` reads it. The second one is for jaws
that may press on something."""
_AHEAD = math.radians(3.0)
"""How far ahead of the jaws their set-point is when they may press."""
_ON_FAULT = ("warn", "raise", "torque_off")
_PAUSE = 1.0
"""Seconds without an action after which the arm goes to the next one slowly, as at the beginning."""
_OVERLAP = 1.25
"""Duration of a motion, as a multiple of the time between two actions: the arm does not stop in between."""
_SHORTEST, _LONGEST = 0.02, 0.1


def _pictures(name: str, camera: Camera) -> list[tuple[str, int, str]]:
    """Key, channels and method of each picture of a camera; LeRobot 0.6 has cameras with a depth picture."""
    found = [(name, 3, "read_latest")] if getattr(camera, "use_rgb", True) else []
    return [*found, (f"{name}_depth", 1, "read_latest_depth")] if getattr(camera, "use_depth", False) else found


class HexwireRobot(HexwireDevice, Robot):
    """An arm of hexwire that follows actions."""

    config_class: ClassVar[type[HexwireRobotConfig]] = HexwireRobotConfig
    config: HexwireRobotConfig

    def __init__(self, config: HexwireRobotConfig) -> None:
        super().__init__(config)
        if not 0.0 < config.meet_speed <= 1.0:
            raise ValueError(f"meet_speed must be above 0 and at most 1, not {config.meet_speed:g}")
        if not 0.0 < config.gripper_force <= 1.0:
            raise ValueError(f"gripper_force must be above 0 and at most 1, not {config.gripper_force:g}")
        if config.on_fault not in _ON_FAULT:
            raise ValueError(f"on_fault is one of {', '.join(_ON_FAULT)}, not {config.on_fault!r}")
        self._begin(config)
        _check_steps(config.max_relative_target, [row[0] for row in self._joints])
        self.cameras = make_cameras_from_configs(config.cameras)
        # LeRobot's programs look for the joints here (lerobot-find-joint-limits).
        self.bus = SimpleNamespace(motors=self._motors())
        self._rules: Following | None = None
        self._jaws: Jaws | None = None
        self._presses = False
        self._lost = 0
        self._here: dict[str, float] = {}
        self._loads: dict[str, float] = {}
        self._here_at = self._sent_at = -math.inf
        self._goal: dict[str, float] = {}
        self._notes = Notes()

    def _motors(self) -> dict[str, Motor]:
        body = MotorNormMode.DEGREES if self.config.use_degrees else MotorNormMode.RANGE_M100_100
        return {
            name: Motor(servo_id, model, MotorNormMode.RANGE_0_100 if jaws else body)
            for name, servo_id, model, jaws in self._joints
        }

    # -- features; nothing is sent --------------------------------------------------------------------

    @property
    def observation_features(self) -> dict[str, Any]:
        features: dict[str, Any] = dict(self.action_features)
        for name, camera in self.config.cameras.items():
            for key, channels, _ in _pictures(name, self.cameras[name]):
                features[key] = (camera.height, camera.width, channels)
        return features

    @property
    def is_connected(self) -> bool:
        return self._arm.is_open and all(camera.is_connected for camera in self.cameras.values())

    # -- connecting -----------------------------------------------------------------------------------

    def _open_more(self) -> None:
        for camera in self.cameras.values():
            camera.connect()

    def calibrate(self) -> None:
        # Until it is configured again, the arm has no torque, and follows nothing.
        self._rules = None
        super().calibrate()

    def configure(self) -> None:
        """Write settings that differ, switch torque on, and begin to follow anew."""
        if not self.is_calibrated:
            return
        driver = self._arm.driver
        with faults():
            self._write_settings()
        self._torque(True)
        height = self.config.table_mm
        check = PathCheck.of(driver, None if height is None else height / 1000)
        self._rules = following_rules(
            driver, driver, check, meet=self.config.meet_speed, force=self.config.gripper_force
        )
        self._jaws = jaws_of(driver.model) if self.config.gripper_force < 1.0 else None
        self._presses = False
        self._here_at = self._sent_at = -math.inf

    def _release(self) -> None:
        self._rules = None
        try:
            if self.config.disable_torque_on_disconnect and self._arm.is_open:
                self._torque(False, ": hold the arm")
        finally:
            super()._release()
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()

    # -- the loop -------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """Read all joints and the newest picture of each camera.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: A joint does not answer; an answer that was lost is asked for again.
            RuntimeError: It is not calibrated, or a servo reports a fault (`on_fault`).
        """
        self._check_connected()
        values = self._arm.values
        state = self._read()
        observation: dict[str, Any] = values.values(state)
        for name, camera in self.cameras.items():
            for key, _, read in _pictures(name, camera):
                observation[key] = getattr(camera, read)()
        return observation

    def _read(self) -> tuple[float, ...]:
        arm = self._arm
        state = arm.read(loads=self._presses)
        self._here, self._here_at = state.positions, time.monotonic()
        self._loads = dict(zip(state.names, state.load, strict=True)) if self._presses else {}
        if arm.lost != self._lost:
            self._lost = arm.lost
            self._pause()
        if arm.faults is not None and arm.faults.present and self.config.on_fault != "warn":
            self._fault(arm.faults.present)
        return state.position

    def _pause(self) -> None:
        """Let the arm meet the next action slowly."""
        if self._rules is not None:
            self._rules.pause()

    def _fault(self, what: str) -> None:
        if self.config.on_fault == "torque_off":
            self._rules = None
            self._torque(False, ": hold the arm")
            what += "; its torque is off"
        raise RuntimeError(what)

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send the arm towards an action.

        Args:
            action: Values by name, of all joints or some.

        Returns:
            What was sent: within limits and speeds, and within `max_relative_target`; nothing if the line had to be
            opened again.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The line is lost.
            RuntimeError: The arm is stopped or not calibrated, a joint has no torque, or a servo reports a fault
                (`on_fault`).
            ValueError: A value is not a number, or a joint does not exist; nothing was sent.
        """
        self._check_connected()
        values, rules = self._arm.values, self._rules
        if rules is None:
            raise RuntimeError(f"{self} has no torque: connect it again")
        goal = values.angles(action)
        now = time.monotonic()
        if now - self._here_at > (_PRESSING if self._presses else _FRESH):
            self._read()
        if self.config.max_relative_target is not None:
            goal = self._capped(goal)
        period = now - self._sent_at
        if period > _PAUSE:
            rules.pause()
            self._goal = dict(self._here)
        self._goal.update(goal)
        step = rules.update(self._goal, 0.0, self._here, self._loads, now)
        if self._notes.is_new(step.note, now):
            logger.warning("%s", step.note)
        if not goal:
            return {}
        target = step.positions
        if len(goal) < len(target):
            target = {name: target[name] for name in goal}
        duration = max(min(max(_OVERLAP * period, _SHORTEST), _LONGEST), step.least)
        sent = self._write(JointTarget.of(target, duration))
        self._sent_at = now
        jaws = self._jaws
        if jaws is not None:
            self._presses = rules.holds or abs(step.positions[jaws.joint] - self._here[jaws.joint]) > _AHEAD
        return values.named(sent.positions) if sent is not None else {}

    def _write(self, target: JointTarget) -> SentTarget | None:
        """Send a target; None if the line had to be opened again: the arm then goes to the next one slowly."""
        try:
            return self._arm.driver.write(target)
        except LinkError as error:
            self._arm.open_again(error)
            self._here_at = -math.inf
            return None
        except HexwireError as error:
            self._pause()
            raise translated(error) from error

    def _capped(self, goal: dict[str, float]) -> dict[str, float]:
        """The goal, no further from the present position than LeRobot's setting says."""
        values, most = self._arm.values, self.config.max_relative_target
        pairs = {
            name: (values.value(name, angle), values.value(name, self._here[name])) for name, angle in goal.items()
        }
        assert most is not None
        # LeRobot's function takes no whole number.
        capped = ensure_safe_goal_position(pairs, most if isinstance(most, dict) else float(most))
        return values.angles({name + SUFFIX: value for name, value in capped.items()})


def _check_steps(most: float | dict[str, float] | None, joints: Sequence[str]) -> None:
    """Refuse a `max_relative_target` with which the arm would move another way than it should.

    Raises:
        ValueError: It is not above 0, or its joints are not the arm's.
    """
    steps = most if isinstance(most, dict) else {} if most is None else {"": most}
    for name, step in steps.items():
        if not (math.isfinite(step) and step > 0.0):
            raise ValueError(f"max_relative_target{name and f' of {name}'} must be above 0, not {step:g}")
    if isinstance(most, dict) and set(most) != set(joints):
        raise ValueError(f"max_relative_target names {', '.join(most)}; the joints are {', '.join(joints)}")


class HexwireSO101(SoDevice, HexwireRobot):
    """An SO-101 follower; shares calibration files with LeRobot's own `so101_follower`."""

    config_class = HexwireSO101Config
    # The name of LeRobot's own class: datasets record it, and calibration files are in a folder of this name.
    name = SOFollower.name
    kind = "so101"

    def _write_settings(self) -> None:
        self._arm.driver.torque(False)
        super()._write_settings()


class HexwireSO100(HexwireSO101):
    """An SO-100 follower; shares calibration files with LeRobot's own `so100_follower`."""

    config_class = HexwireSO100Config
    kind = "so100"


class HexwireHex7bot(HexwireRobot):
    """A Hex7Bot on its board."""

    config_class = HexwireHex7botConfig
    name = "hexwire_hex7bot"
    kind = "hex7bot"


class HexwireRemote(RemoteDevice, HexwireRobot):
    """An arm that `hexwire serve` shares, anywhere on the network."""

    config_class = HexwireRemoteConfig
    name = "hexwire_remote"

    def __init__(self, config: HexwireRemoteConfig) -> None:
        super().__init__(config)
        if config.arm in ("so100", "so101"):
            # Its datasets are those of an SO arm.
            self.robot_type = self.name = SOFollower.name
