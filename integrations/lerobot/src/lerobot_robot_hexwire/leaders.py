"""The teleoperators: arms without torque that a hand moves.

Owns LeRobot's contract of a teleoperator. Must not know servos or links.
"""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any, ClassVar

from lerobot.teleoperators import Teleoperator
from lerobot.teleoperators.so_leader import SOLeader
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_bus_arm

from .calibrating import calibrate
from .config_hexwire import (
    HexwireHex7botLeaderConfig,
    HexwireRemoteLeaderConfig,
    HexwireSO100LeaderConfig,
    HexwireSO101LeaderConfig,
    HexwireTeleopConfig,
)
from .connection import Connection, faults
from .joint_values import names_of
from .kinds import joints_of
from .settings import configure

__all__ = [
    "HexwireHex7botLeader",
    "HexwireLeader",
    "HexwireRemoteLeader",
    "HexwireSO100Leader",
    "HexwireSO101Leader",
]

logger = logging.getLogger(__name__)


class HexwireLeader(Teleoperator):
    """An arm of hexwire that is moved by hand; its values are those of `HexwireRobot`."""

    config_class: ClassVar[type[HexwireTeleopConfig]] = HexwireTeleopConfig
    kind: ClassVar[str]

    def __init__(self, config: HexwireTeleopConfig) -> None:
        super().__init__(config)
        self.config = config
        self._arm = self._make_connection()
        self.bus = SimpleNamespace(motors=[row[0] for row in joints_of(self._kind)])

    def _make_connection(self) -> Connection:
        return Connection(self.config.port, self._kind, degrees=self.config.use_degrees)

    @property
    def _kind(self) -> str:
        return self.kind

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(names_of(self.bus.motors), float)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self._arm.is_open

    @property
    def is_calibrated(self) -> bool:
        return self._arm.is_calibrated

    def connect(self, calibrate: bool = True) -> None:
        """Attach the arm and switch its torque off.

        Args:
            calibrate: Calibrate it now if it has no calibration, or another one than its file.

        Raises:
            DeviceAlreadyConnectedError: It is connected.
            ConnectionError: It cannot be reached, or a joint does not confirm torque off.
        """
        if self._arm.is_open:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._arm.open()
        try:
            if not self.is_calibrated and calibrate:
                logger.info("The servos and the calibration file differ, or there is no file")
                self.calibrate()
            self.configure()
        except BaseException:
            self._arm.close()
            raise
        logger.info("%s connected.", self)

    def calibrate(self) -> None:
        """Do nothing: this arm needs no calibration."""

    def configure(self) -> None:
        """Switch torque off: a joint with torque works against the hand."""
        driver = self._arm.driver
        with faults():
            off = driver.torque(False)
            if missing := [name for name in driver.model.names if name not in off]:
                raise ConnectionError(f"{', '.join(missing)} does not confirm torque off")
            self._write_settings()

    def _write_settings(self) -> None:
        """Write what this kind of arm needs."""

    def get_action(self) -> dict[str, float]:
        """Read all joints.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: A joint does not answer; an answer that was lost is asked for again.
            RuntimeError: It is not calibrated.
        """
        self._check_connected()
        return self._arm.values.values(self._arm.read().position)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Not supported, as by LeRobot's own leaders.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("a leader without torque gives no feedback")

    def disconnect(self) -> None:
        """Close the arm.

        Raises:
            DeviceNotConnectedError: It is not connected.
        """
        if not self._arm.was_opened:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._arm.close()
        logger.info("%s disconnected.", self)

    def _check_connected(self) -> None:
        if not self._arm.is_open:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")


class HexwireSO101Leader(HexwireLeader):
    """An SO-101 leader; shares calibration files with LeRobot's own `so101_leader`."""

    config_class = HexwireSO101LeaderConfig
    name = SOLeader.name
    kind = "so101"

    def _make_connection(self) -> Connection:
        config = self.config
        return Connection(
            config.port, self.kind, degrees=config.use_degrees, calibration_file=self.calibration_fpath
        )

    def calibrate(self) -> None:
        """Ask whether the file is to be used, or calibrate by hand; write file and servos.

        Raises:
            DeviceNotConnectedError: It is not connected.
            RuntimeError: Something odd happened; the text says what.
        """
        self._check_connected()
        with self._arm.set_aside() as link:
            calibrate(load_bus_arm(self.kind), link, self.calibration_fpath, auto=False)
        self._load_calibration()

    def _write_settings(self) -> None:
        driver = self._arm.driver
        assert isinstance(driver, BusArm)
        if written := configure(driver.bus, driver.model, leader=True):
            logger.info("Written to the servos: %s", ", ".join(written))


class HexwireSO100Leader(HexwireSO101Leader):
    """An SO-100 leader; shares calibration files with LeRobot's own `so100_leader`."""

    config_class = HexwireSO100LeaderConfig
    kind = "so100"


class HexwireHex7botLeader(HexwireLeader):
    """A Hex7Bot without torque."""

    config_class = HexwireHex7botLeaderConfig
    name = "hexwire_hex7bot_leader"
    kind = "hex7bot"


class HexwireRemoteLeader(HexwireLeader):
    """A leader that `hexwire serve` shares, anywhere on the network."""

    config_class = HexwireRemoteLeaderConfig
    name = "hexwire_remote_leader"
    config: HexwireRemoteLeaderConfig

    @property
    def _kind(self) -> str:
        return self.config.arm
