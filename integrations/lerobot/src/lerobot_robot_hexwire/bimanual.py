"""Two arms as one robot, and two leaders as one teleoperator, as LeRobot's own bimanual SO arms are.

Owns the names of the two sides, and that neither side stays open alone. Must not know what an arm does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar

from lerobot.robots import Robot, RobotConfig
from lerobot.robots.bi_so_follower import BiSOFollower
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.teleoperators.bi_so_leader import BiSOLeader
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from .config_hexwire import (
    BiHexwireSO101Config,
    BiHexwireSO101LeaderConfig,
    HexwireSO101Config,
    HexwireSO101LeaderConfig,
)
from .leaders import HexwireSO101Leader
from .robots import HexwireSO101

if TYPE_CHECKING:
    from .device import HexwireDevice

__all__ = ["BiHexwireSO101", "BiHexwireSO101Leader"]

LEFT, RIGHT = "left", "right"
_ERRORS = (DeviceNotConnectedError, DeviceAlreadyConnectedError, ConnectionError, RuntimeError, ValueError)
"""What an arm raises; the first that fits."""


def _of_side(config: Any, side: str) -> dict[str, Any]:
    """The fields of one arm; its calibration file is named as LeRobot names it."""
    arm = getattr(config, f"{side}_arm_config")
    found = {one.name: getattr(arm, one.name) for one in fields(arm)}
    return {**found, "id": f"{config.id}_{side}" if config.id else None, "calibration_dir": config.calibration_dir}


def _prefixed(left: Mapping[str, Any], right: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **{f"{LEFT}_{key}": value for key, value in left.items()},
        **{f"{RIGHT}_{key}": value for key, value in right.items()},
    }


@contextmanager
def _told_of(side: str) -> Iterator[None]:
    """Let an error say which of the two arms it is about."""
    try:
        yield
    except _ERRORS as error:
        kind = next(one for one in _ERRORS if isinstance(error, one))
        raise kind(f"{_whose(side)}{error}") from error


def _whose(side: str) -> str:
    return f"{side} arm: "


class BiDevice:
    """What both have: each call goes to the left arm, then to the right one."""

    left_arm: HexwireDevice
    right_arm: HexwireDevice

    def _begin(self, config: Any, arm: Callable[[Any], HexwireDevice], fields_of_arm: Callable[..., Any]) -> None:
        """Take the configuration, and make the arm of each side. Nothing is opened.

        Args:
            config: Of both.
            arm: Makes an arm from its configuration.
            fields_of_arm: Makes that from its fields.
        """
        self.config = config
        self.left_arm, self.right_arm = (arm(fields_of_arm(**_of_side(config, side))) for side in (LEFT, RIGHT))
        self._sides = ((LEFT, self.left_arm), (RIGHT, self.right_arm))
        for side, one in self._sides:
            one.say_whose(_whose(side))

    @property
    def action_features(self) -> dict[str, Any]:
        return _prefixed(self.left_arm.action_features, self.right_arm.action_features)

    @property
    def is_connected(self) -> bool:
        return self.left_arm.is_connected and self.right_arm.is_connected

    @property
    def is_calibrated(self) -> bool:
        return self.left_arm.is_calibrated and self.right_arm.is_calibrated

    def connect(self, calibrate: bool = True) -> None:
        """Connect both arms, or none.

        Raises:
            DeviceAlreadyConnectedError: They are connected.
            ConnectionError: As of one arm.
            RuntimeError: Likewise.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        with ExitStack() as undo:
            for side, arm in self._sides:
                with _told_of(side):
                    arm.connect(calibrate)
                undo.callback(arm.give_up)
            undo.pop_all()

    def calibrate(self) -> None:
        self._each(lambda side, arm: arm.calibrate())

    def configure(self) -> None:
        self._each(lambda side, arm: arm.configure())

    def _each(self, call: Callable[[str, Any], Any]) -> list[Any]:
        """What a call of side and arm returns, for the left one, then for the right one."""
        found = []
        for side, arm in self._sides:
            with _told_of(side):
                found.append(call(side, arm))
        return found

    def disconnect(self) -> None:
        """Close both arms, also if one of them raises; see `HexwireDevice.disconnect`."""
        if not any(arm.was_connected for arm in (self.left_arm, self.right_arm)):
            raise DeviceNotConnectedError(f"{self} is not connected.")
        with ExitStack() as both:
            for side, arm in reversed(self._sides):
                if arm.was_connected:
                    both.callback(_told_of(side)(arm.disconnect))


class BiHexwireSO101(BiDevice, Robot):
    """Two SO-101 followers; the same names and calibration files as LeRobot's own `bi_so_follower`."""

    config_class: ClassVar[type[RobotConfig]] = BiHexwireSO101Config
    # Datasets record it.
    name = BiSOFollower.name
    left_arm: HexwireSO101
    right_arm: HexwireSO101

    def __init__(self, config: BiHexwireSO101Config) -> None:
        super().__init__(config)
        self._begin(config, HexwireSO101, HexwireSO101Config)
        self.cameras = _prefixed(self.left_arm.cameras, self.right_arm.cameras)

    @property
    def observation_features(self) -> dict[str, Any]:
        return _prefixed(self.left_arm.observation_features, self.right_arm.observation_features)

    def get_observation(self) -> dict[str, Any]:
        """Read both arms; see `HexwireRobot.get_observation`."""
        return _prefixed(*self._each(lambda side, arm: arm.get_observation()))

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Send both arms towards an action, or neither; see `HexwireRobot.send_action`."""
        parts = {
            side: {
                key.removeprefix(f"{side}_"): value for key, value in action.items() if key.startswith(f"{side}_")
            }
            for side in (LEFT, RIGHT)
        }
        self._each(lambda side, arm: arm.wanted(parts[side]))
        return _prefixed(*self._each(lambda side, arm: arm.send_action(parts[side])))


class BiHexwireSO101Leader(BiDevice, Teleoperator):
    """Two SO-101 leaders; the same names and calibration files as LeRobot's own `bi_so_leader`."""

    config_class: ClassVar[type[TeleoperatorConfig]] = BiHexwireSO101LeaderConfig
    name = BiSOLeader.name
    left_arm: HexwireSO101Leader
    right_arm: HexwireSO101Leader

    def __init__(self, config: BiHexwireSO101LeaderConfig) -> None:
        super().__init__(config)
        self._begin(config, HexwireSO101Leader, HexwireSO101LeaderConfig)

    @property
    def feedback_features(self) -> dict[str, Any]:
        return {}

    def get_action(self) -> dict[str, Any]:
        """Read both arms; see `HexwireLeader.get_action`."""
        return _prefixed(*self._each(lambda side, arm: arm.get_action()))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Not supported; see `HexwireLeader.send_feedback`."""
        self.left_arm.send_feedback(feedback)
