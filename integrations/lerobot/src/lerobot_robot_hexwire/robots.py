"""The robots: arms that LeRobot observes and moves.

Owns LeRobot's contract of a robot, and how an action becomes a target: the arm goes to the first action slowly,
then follows within its limits and speeds (`hexwire.motion.following`, the rules of `hexwire follow`). Must not know
servos or links.
"""

from __future__ import annotations

import logging
import math
import time
from types import SimpleNamespace
from typing import Any, ClassVar

from lerobot.cameras import Camera
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.motors import Motor, MotorNormMode
from lerobot.robots import Robot
from lerobot.robots.so_follower import SOFollower
from lerobot.robots.utils import ensure_safe_goal_position
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from hexwire.control.path_check import PathCheck
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_bus_arm
from hexwire.errors import HexwireError
from hexwire.model.geometry import kinematics_or_none
from hexwire.model.state import JointTarget
from hexwire.motion.following import Following

from .calibrating import calibrate
from .config_hexwire import (
    HexwireHex7botConfig,
    HexwireRemoteConfig,
    HexwireRobotConfig,
    HexwireSO100Config,
    HexwireSO101Config,
)
from .connection import Connection, faults, translated
from .joint_values import SUFFIX, names_of
from .kinds import joints_of
from .settings import configure

__all__ = ["HexwireHex7bot", "HexwireRemote", "HexwireRobot", "HexwireSO100", "HexwireSO101"]

logger = logging.getLogger(__name__)

_FRESH = 0.25
"""Seconds for which an observation says where the arm is; then `send_action` reads it."""
_PAUSE = 1.0
"""Seconds without an action after which the arm goes to the next one slowly, as at the beginning."""
_OVERLAP = 1.25
"""Duration of a motion, as a multiple of the time between two actions: the arm does not stop in between."""
_SHORTEST, _LONGEST = 0.02, 0.1


def _pictures(name: str, camera: Camera) -> list[tuple[str, int, str]]:
    """Key, channels and method of each picture of a camera; LeRobot 0.6 has cameras with a depth picture."""
    found = [(name, 3, "read_latest")] if getattr(camera, "use_rgb", True) else []
    return [*found, (f"{name}_depth", 1, "read_latest_depth")] if getattr(camera, "use_depth", False) else found


class HexwireRobot(Robot):
    """An arm of hexwire.

    Values are LeRobot's: ``shoulder_pan.pos`` in degrees or -100 to 100, a gripper 0 to 100.
    """

    config_class: ClassVar[type[HexwireRobotConfig]] = HexwireRobotConfig
    kind: ClassVar[str]
    """Robot of hexwire, such as ``so101``."""

    def __init__(self, config: HexwireRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        if not 0.0 < config.meet_speed <= 1.0:
            raise ValueError(f"meet_speed must be above 0 and at most 1, not {config.meet_speed:g}")
        self._arm = self._make_connection()
        self.cameras = make_cameras_from_configs(config.cameras)
        # LeRobot's programs look for the joints here (lerobot-find-joint-limits).
        self.bus = SimpleNamespace(motors=self._motors())
        self._rules: Following | None = None
        self._here: dict[str, float] = {}
        self._here_at = self._sent_at = -math.inf
        self._goal: dict[str, float] = {}
        self._said = ""

    def _make_connection(self) -> Connection:
        return Connection(self.config.port, self._kind, degrees=self.config.use_degrees)

    @property
    def _kind(self) -> str:
        return self.kind

    def _motors(self) -> dict[str, Motor]:
        body = MotorNormMode.DEGREES if self.config.use_degrees else MotorNormMode.RANGE_M100_100
        return {
            name: Motor(servo_id, model, MotorNormMode.RANGE_0_100 if jaws else body)
            for name, servo_id, model, jaws in joints_of(self._kind)
        }

    # -- features; nothing is sent --------------------------------------------------------------------

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(names_of(self.bus.motors), float)

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

    @property
    def is_calibrated(self) -> bool:
        return self._arm.is_calibrated

    # -- connecting -----------------------------------------------------------------------------------

    def connect(self, calibrate: bool = True) -> None:
        """Attach the arm and switch its torque on where it stands; an arm that is not calibrated gets none.

        Args:
            calibrate: Calibrate it now if it has no calibration, or another one than its file.

        Raises:
            DeviceAlreadyConnectedError: It is connected.
            ConnectionError: It cannot be reached.
            RuntimeError: It is stopped; `hexwire resume` ends that.
        """
        if self._arm.is_open:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._arm.open()
        try:
            if not self.is_calibrated and calibrate:
                logger.info("The servos and the calibration file differ, or there is no file")
                self.calibrate()
            for camera in self.cameras.values():
                camera.connect()
            self.configure()
        except BaseException:
            self._release(torque_off=self.config.disable_torque_on_disconnect)
            raise
        logger.info("%s connected.", self)

    def calibrate(self) -> None:
        """Do nothing: this arm needs no calibration."""

    def configure(self) -> None:
        """Write settings that differ, switch torque on, and begin to follow anew."""
        if not self.is_calibrated:
            return
        driver = self._arm.driver
        with faults():
            self._write_settings()
            on = driver.torque(True)
            if missing := [name for name in driver.model.names if name not in on]:
                raise ConnectionError(f"{', '.join(missing)} does not confirm torque on")
        kinematics = kinematics_or_none(driver.model.geometry or driver.model.name)
        kinematics = None if kinematics is None else kinematics.for_arm(driver.model)
        check = PathCheck(driver.model, kinematics, None).posture
        self._rules = Following(driver.model, driver.model, share=self.config.meet_speed, check=check)
        self._here_at = self._sent_at = -math.inf

    def _write_settings(self) -> None:
        """Write what this kind of arm needs."""

    def disconnect(self) -> None:
        """Switch torque off, unless the configuration says otherwise, and close the arm and the cameras.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The line is lost, or a joint does not confirm torque off; everything is closed.
        """
        if not self._arm.was_opened:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._release(torque_off=self.config.disable_torque_on_disconnect)
        logger.info("%s disconnected.", self)

    def _release(self, *, torque_off: bool) -> None:
        self._rules = None
        try:
            if torque_off and self._arm.is_open:
                with faults():
                    off = self._arm.driver.torque(False)
                if missing := [name for name in self._arm.driver.model.names if name not in off]:
                    raise ConnectionError(f"{', '.join(missing)} does not confirm torque off: hold the arm")
        finally:
            self._arm.close()
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()

    # -- the loop -------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """Read all joints and the newest picture of each camera.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: A joint does not answer; an answer that was lost is asked for again.
            RuntimeError: It is not calibrated.
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
        state = self._arm.read()
        self._here, self._here_at = state.positions, time.monotonic()
        return state.position

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send the arm towards an action.

        Args:
            action: Values by name, of all joints or some.

        Returns:
            What was sent: within limits and speeds, and within `max_relative_target`.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The line is lost.
            RuntimeError: The arm is stopped or not calibrated, or a joint has no torque.
            ValueError: A value is not a number, or a joint does not exist; nothing was sent.
        """
        self._check_connected()
        values, rules = self._arm.values, self._rules
        if rules is None:
            raise RuntimeError(f"{self} has no torque: connect it again")
        goal = values.angles(action)
        now = time.monotonic()
        if now - self._here_at > _FRESH:
            self._read()
        if self.config.max_relative_target is not None:
            goal = self._capped(goal)
        period = now - self._sent_at
        if period > _PAUSE:
            rules.pause()
            self._goal = dict(self._here)
        self._goal.update(goal)
        step = rules.update(self._goal, 0.0, self._here, {}, now)
        if step.note and step.note != self._said:
            logger.warning("%s", step.note)
        self._said = step.note
        target = {name: step.positions[name] for name in goal}
        if not target:
            return {}
        duration = max(min(max(_OVERLAP * period, _SHORTEST), _LONGEST), step.least)
        try:
            sent = self._arm.driver.write(JointTarget.of(target, duration))
        except HexwireError as error:
            rules.pause()
            raise translated(error) from error
        self._sent_at = now
        return {name + SUFFIX: values.value(name, angle) for name, angle in sent.positions}

    def _capped(self, goal: dict[str, float]) -> dict[str, float]:
        """The goal, no further from the present position than LeRobot's setting says."""
        values, most = self._arm.values, self.config.max_relative_target
        pairs = {
            name: (values.value(name, angle), values.value(name, self._here[name])) for name, angle in goal.items()
        }
        capped = ensure_safe_goal_position(pairs, float(most) if isinstance(most, int) else most)
        return values.angles({name + SUFFIX: value for name, value in capped.items()})

    def _check_connected(self) -> None:
        # One look at each part, since this is asked in every cycle.
        if not self._arm.is_open:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")


class HexwireSO101(HexwireRobot):
    """An SO-101 follower; shares calibration files with LeRobot's own `so101_follower`."""

    config_class = HexwireSO101Config
    # The name of LeRobot's own class: datasets record it, and calibration files are in a folder of this name.
    name = SOFollower.name
    kind = "so101"
    config: HexwireSO101Config

    def _make_connection(self) -> Connection:
        config = self.config
        return Connection(
            config.port, self.kind, degrees=config.use_degrees, calibration_file=self.calibration_fpath
        )

    def calibrate(self) -> None:
        """Ask whether the file is to be used, or calibrate by hand or automatically; write file and servos.

        Raises:
            DeviceNotConnectedError: It is not connected.
            RuntimeError: Something odd happened; the text says what.
        """
        self._check_connected()
        self._rules = None
        with self._arm.set_aside() as link:
            calibrate(load_bus_arm(self.kind), link, self.calibration_fpath, auto=self.config.auto_calibration)
        self._load_calibration()

    def _write_settings(self) -> None:
        driver = self._arm.driver
        assert isinstance(driver, BusArm)
        driver.torque(False)
        if written := configure(driver.bus, driver.model, leader=False):
            logger.info("Written to the servos: %s", ", ".join(written))


class HexwireSO100(HexwireSO101):
    """An SO-100 follower; shares calibration files with LeRobot's own `so100_follower`."""

    config_class = HexwireSO100Config
    kind = "so100"


class HexwireHex7bot(HexwireRobot):
    """A Hex7Bot on its board."""

    config_class = HexwireHex7botConfig
    name = "hexwire_hex7bot"
    kind = "hex7bot"


class HexwireRemote(HexwireRobot):
    """An arm that `hexwire serve` shares, anywhere on the network."""

    config_class = HexwireRemoteConfig
    name = "hexwire_remote"
    config: HexwireRemoteConfig

    def __init__(self, config: HexwireRemoteConfig) -> None:
        super().__init__(config)
        if config.arm in ("so100", "so101"):
            # Its datasets are those of an SO arm.
            self.robot_type = self.name = SOFollower.name

    @property
    def _kind(self) -> str:
        return self.config.arm
