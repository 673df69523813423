"""The robots: arms that LeRobot observes and moves.

Owns LeRobot's contract of a robot, and how an action becomes a target: the arm goes to the first action slowly,
then follows within its limits and speeds (`hexwire.motion.following`, the rules of `hexwire follow`). Must not know
servos or links.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar
from weakref import WeakSet

from lerobot.cameras import Camera
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.motors import Motor, MotorNormMode
from lerobot.robots import Robot
from lerobot.robots.so_follower import SOFollower

from hexwire.arm.verbs import Arm
from hexwire.control.motion.following import BehindCounter, following_rules
from hexwire.control.motion.operator_control import Notes
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.pose_file import PoseFile
from hexwire.drivers.abilities import SetPoints
from hexwire.drivers.bus_arm import BusArm
from hexwire.errors import HexwireError, LinkError
from hexwire.model.state import JointTarget
from hexwire.motion.following import Behind, Following, FollowStep

from .config_hexwire import (
    HexwireHex7botConfig,
    HexwireRemoteConfig,
    HexwireRobotConfig,
    HexwireSO100Config,
    HexwireSO101Config,
)
from .connection import faults, translated
from .device import HexwireDevice, RemoteDevice, SoDevice
from .joint_values import SUFFIX, JointValues, names_of

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver

__all__ = ["HexwireHex7bot", "HexwireRemote", "HexwireRobot", "HexwireSO100", "HexwireSO101"]

logger = logging.getLogger(__name__)

_FRESH, _SOON, _FAR = 0.1, 0.02, math.radians(5.0)
"""Seconds for which an observation says where the arm is; then `send_action` reads it. The second number is for
jaws that may press on something, and for actions that are further away than the third, radians."""
_ON_FAULT = ("warn", "raise", "torque_off")
_PAUSE = 1.0
"""Seconds without an action after which the arm goes to the next one slowly, as at the beginning."""
_ROUNDING = 1e-9
"""Radians by which a joint that is sent where it is led may seem to be elsewhere."""
_OVERLAP = 1.25
"""Duration of a motion, as a multiple of the time between two actions: the arm does not stop in between."""
_SHORTEST, _LONGEST = 0.02, 0.1


_Sender = Callable[[Mapping[str, float], float], tuple[tuple[str, float], ...]]
_connected: WeakSet[HexwireRobot] = WeakSet()
"""The robots that have torque, for teleoperators that move a robot of this process."""


def _pictures(name: str, camera: Camera) -> list[tuple[str, int, str]]:
    """Key, channels and method of each picture of a camera; LeRobot 0.6 has cameras with a depth picture."""
    found = [(name, 3, "read_latest")] if getattr(camera, "use_rgb", True) else []
    return [*found, (f"{name}_depth", 1, "read_latest_depth")] if getattr(camera, "use_depth", False) else found


class HexwireRobot(HexwireDevice, Robot):
    """An arm of hexwire that follows actions.

    Attributes:
        clipped: How often a joint was not sent where an action leads it, and why, as in ``elbow_flex speed``.
        check: Checks where it may be sent; of a robot that has torque.
    """

    config_class: ClassVar[type[HexwireRobotConfig]] = HexwireRobotConfig
    config: HexwireRobotConfig
    check: PathCheck

    def __init__(self, config: HexwireRobotConfig) -> None:
        super().__init__(config)
        if not 0.0 < config.meet_speed <= 1.0:
            raise ValueError(f"meet_speed must be above 0 and at most 1, not {config.meet_speed:g}")
        if not 0.0 < config.gripper_force <= 1.0:
            raise ValueError(f"gripper_force must be above 0 and at most 1, not {config.gripper_force:g}")
        if config.table_mm is not None and not math.isfinite(config.table_mm):
            raise ValueError(f"table_mm must be a height in millimetres or null, not {config.table_mm:g}")
        if config.on_fault not in _ON_FAULT:
            raise ValueError(f"on_fault is one of {', '.join(_ON_FAULT)}, not {config.on_fault!r}")
        self._begin(config)
        joints = [row[0] for row in self._joints]
        for name in ("max_relative_target", "max_speed", "max_acceleration"):
            _check_limit(name, getattr(config, name), joints)
        self.cameras = make_cameras_from_configs(config.cameras)
        # LeRobot's programs look for the joints here (lerobot-find-joint-limits).
        self.bus = SimpleNamespace(motors=self._motors())
        self.clipped = BehindCounter()
        self._rules: Following | None = None
        # Of a robot that has rules.
        self._values: JointValues
        self._send: _Sender
        self._presses = False
        self._lost = 0
        # The next action may have been made before the line was open again: it meets nobody.
        self._late = False
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
        self._holds(False)
        super().calibrate()

    def configure(self) -> None:
        """Write settings that differ, switch torque on, and begin to follow anew."""
        if not self.is_calibrated:
            return
        driver = self._arm.driver
        self._check_home()
        with faults():
            self._write_settings()
        self._torque(True)
        self._holds(True)
        height = self.config.table_mm
        check = PathCheck.of(driver, None if height is None else height / 1000)
        self.check = check
        self._rules = following_rules(
            driver,
            driver,
            check,
            meet=self.config.meet_speed,
            force=self.config.gripper_force,
            max_speed=_radians(self.config.max_speed),
            max_acceleration=_radians(self.config.max_acceleration),
        )
        self._values, self._send = self._arm.values, _sender(driver)
        self._presses = False
        self._here_at = self._sent_at = -math.inf
        _connected.add(self)

    def _check_home(self) -> None:
        """Refuse a pose for the end that nobody has saved, while the arm is still where it is safe."""
        name, driver = self.config.home_at_disconnect, self._arm.driver
        if name is not None and name not in (known := PoseFile(driver.model).known()):
            raise ValueError(
                f"home_at_disconnect: no pose {name!r} of {driver.model.name}; known are: {', '.join(known)}"
            )

    def _go_home(self) -> bool:
        """Go to the pose for the end, slowly; returns whether the arm has arrived, or was not to go anywhere."""
        name = self.config.home_at_disconnect
        if name is None:
            return True
        height = self.config.table_mm
        logger.info("%s goes to its pose %s", self, name)
        try:
            arm = Arm(
                self._arm.driver, speed=self.config.meet_speed, table=None if height is None else height / 1000
            )
            arm.move(name)
        except (HexwireError, KeyboardInterrupt) as error:
            logger.error(
                "%s has not come to its pose %s, and keeps its torque: hold it before you switch that off: %s",
                self,
                name,
                error if isinstance(error, HexwireError) else "interrupted",
            )
            if not isinstance(error, HexwireError):
                raise
            return False
        return True

    def give_up(self) -> None:
        # It has gone nowhere yet, so it rests where it was put.
        self._rules = None
        super().give_up()

    def _release(self) -> None:
        _connected.discard(self)
        had_torque, self._rules = self._rules is not None, None
        lost = not self._arm.is_open
        try:
            home = not lost and (not had_torque or self._go_home())
            if home and self.config.disable_torque_on_disconnect:
                self._torque(False, ": hold the arm")
            elif had_torque and self._arm.is_open:
                self._keep_torque()
        finally:
            super()._release()
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()
        if lost and had_torque and self.config.disable_torque_on_disconnect:
            raise ConnectionError(
                f"the line of {self} is lost, so its joints keep their torque: switch its supply off"
            )

    def _keep_torque(self) -> None:
        """Leave the arm to another program as it holds."""

    # -- for teleoperators of this process ---------------------------------------------------------------

    @property
    def driver(self) -> RobotDriver:
        """The attached arm."""
        return self._arm.driver

    def place(self) -> dict[str, float]:
        """Radians by joint, as measured a tenth of a second ago at most.

        Raises:
            ConnectionError: A joint does not answer.
            RuntimeError: A servo reports a fault (`on_fault`).
        """
        if time.monotonic() - self._here_at > _FRESH:
            self._read()
        return self._here

    def named(self, angles: dict[str, float]) -> dict[str, float]:
        """The action that leads to angles in radians by joint."""
        return self._arm.values.named(angles.items())

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
            self._lost, self._late = arm.lost, True
            self._pause()
        if arm.faults is not None and arm.faults.present and self.config.on_fault != "warn":
            self._fault(arm.faults.present)
        return state.position

    def _pause(self) -> None:
        """Let the arm meet the next action slowly."""
        if self._rules is not None:
            self._rules.pause()

    def _holds(self, on: bool) -> None:
        """Let a joint without torque be a fault, or not."""
        if self._arm.faults is not None:
            self._arm.faults.holds = on

    def _fault(self, what: str) -> None:
        if self.config.on_fault == "torque_off":
            self._rules = None
            self._holds(False)
            self._torque(False, ": hold the arm")
            what += "; its torque is off"
        raise RuntimeError(what)

    def wanted(self, action: dict[str, Any]) -> dict[str, float]:
        """Angles to which an action leads, radians by joint; nothing is sent, nor read.

        Raises:
            DeviceNotConnectedError: As `send_action`, and so are RuntimeError and ValueError.
        """
        values, _ = self._ready()
        return values.angles(action)

    def _ready(self) -> tuple[JointValues, Following]:
        self._check_connected()
        values, rules = self._arm.values, self._rules
        if rules is None:
            raise RuntimeError(f"{self} has no torque: connect it again")
        return values, rules

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
        rules = self._rules
        if rules is None:
            _, rules = self._ready()
        values = self._values
        goal = values.angles(action)
        now = time.monotonic()
        age = now - self._here_at
        if age > _FRESH or (age > _SOON and (self._presses or self._is_far(goal))):
            self._check_connected()
            self._read()
        capped: frozenset[str] = frozenset()
        if self.config.max_relative_target is not None:
            goal, capped = self._capped(goal)
        period = now - self._sent_at
        if period > _PAUSE:
            rules.pause()
        whole = len(goal) == len(self._here)
        self._goal = goal if whole else {**(self._here if period > _PAUSE else self._goal), **goal}
        step = rules.update(self._goal, 0.0, self._here, self._loads, now)
        _, target, met, note, least, behind = step
        if capped or not met:
            behind = self._behind(step, capped)
        if behind or note:
            for text in (self.clipped.see(behind), note if self._notes.is_new(note, now) else ""):
                if text:
                    logger.warning("%s%s", self._arm.whose, text)
        if self._late:
            self._late = False
            rules.pause()
        if not whole:
            target = {name: target[name] for name in goal}
            if not target:
                return {}
        duration = _OVERLAP * period
        if not _SHORTEST <= duration <= _LONGEST:
            duration = _SHORTEST if duration < _SHORTEST else _LONGEST
        try:
            sent = self._send(target, duration if duration > least else least)
        except LinkError as error:
            # The line had to be opened again: the arm meets the next action slowly.
            self._arm.open_again(error)
            self._here_at = -math.inf
            sent = ()
        except HexwireError as error:
            self._check_connected()
            rules.pause()
            raise translated(error) from error
        self._sent_at = now
        self._presses = rules.presses
        return values.named(sent)

    def _is_far(self, goal: dict[str, float]) -> bool:
        here = self._here
        return any(abs(angle - here[name]) > _FAR for name, angle in goal.items())

    def _behind(self, step: FollowStep, capped: frozenset[str]) -> dict[str, Behind]:
        """Why joints are not sent where the action leads them, also before they have met it."""
        found = dict.fromkeys(capped, Behind.DISTANCE)
        if not step.met:
            there = step.positions
            late = [name for name, angle in self._goal.items() if abs(there.get(name, angle) - angle) > _ROUNDING]
            found.update(dict.fromkeys(late, Behind.MEETING))
        return {**found, **step.behind}

    def _capped(self, goal: dict[str, float]) -> tuple[dict[str, float], frozenset[str]]:
        """The goal, no further from the present position than LeRobot's setting says; and what that changes."""
        values, most = self._values, self.config.max_relative_target
        assert most is not None
        wanted, here = values.named(goal.items()), values.named(self._here.items())
        near = {}
        for name, value in wanted.items():
            limit = most[name.removesuffix(SUFFIX)] if isinstance(most, dict) else most
            near[name] = min(max(value, here[name] - limit), here[name] + limit)
        changed = frozenset(name.removesuffix(SUFFIX) for name in near if near[name] != wanted[name])
        return (values.angles(near), changed) if changed else (goal, changed)


def _sender(driver: RobotDriver) -> _Sender:
    """What sends a set-point to an arm, and returns what was really sent."""
    if (able := SetPoints.find(driver)) is not None:
        return able.guide
    return lambda positions, duration: driver.write(JointTarget.of(positions, duration, guided=True)).positions


def meet_again() -> None:
    """Let the robots of this process meet their next action slowly: a leader was away."""
    for robot in _connected:
        robot._pause()


def connected_robot(joints: Sequence[str]) -> HexwireRobot:
    """The robot with these joints that this process has connected and that has torque.

    Raises:
        RuntimeError: There is none, or there are several.
    """
    found = [robot for robot in _connected if list(robot.action_features) == list(names_of(joints))]
    if len(found) != 1:
        many = "several robots" if found else "no robot"
        raise RuntimeError(f"the program has connected {many} of hexwire with the joints {', '.join(joints)}")
    return found[0]


def _check_limit(field: str, most: float | dict[str, float] | None, joints: Sequence[str]) -> None:
    """Refuse a limit with which the arm would move another way than it should.

    Raises:
        ValueError: It is not above 0, or its joints are not the arm's.
    """
    limits = most if isinstance(most, dict) else {} if most is None else {"": most}
    for name, limit in limits.items():
        if not (math.isfinite(limit) and limit > 0.0):
            raise ValueError(f"{field}{name and f' of {name}'} must be above 0, not {limit:g}")
    if isinstance(most, dict) and set(most) != set(joints):
        raise ValueError(f"{field} names {', '.join(most)}; the joints are {', '.join(joints)}")


def _radians(most: float | dict[str, float] | None) -> float | dict[str, float] | None:
    if isinstance(most, dict):
        return {name: math.radians(one) for name, one in most.items()}
    return None if most is None else math.radians(most)


class HexwireSO101(SoDevice, HexwireRobot):
    """An SO-101 follower; shares calibration files with LeRobot's own `so101_follower`."""

    config_class = HexwireSO101Config
    # The name of LeRobot's own class: datasets record it, and calibration files are in a folder of this name.
    name = SOFollower.name
    kind = "so101"

    def _write_settings(self) -> None:
        self._arm.driver.torque(False)
        super()._write_settings()

    def _keep_torque(self) -> None:
        driver = self._arm.driver
        assert isinstance(driver, BusArm)
        with faults():
            driver.unbind()


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
