"""What robots and leaders share: the life of an arm in LeRobot, from `connect` to `disconnect`.

Owns the order in which an arm is opened, calibrated, configured and closed. Must not know observations, actions or
servos. LeRobot has a base class for robots and another one for teleoperators: the classes here come before either.
"""

from __future__ import annotations

import logging
from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import is_address, load_bus_arm

from .calibrating import calibrate
from .config_hexwire import HexwireRemoteConfig, HexwireRemoteLeaderConfig
from .connection import Connection, faults
from .joint_values import names_of
from .kinds import joints_of
from .servos import configure, stored

if TYPE_CHECKING:
    from .config_hexwire import HexwireRobotConfig, HexwireTeleopConfig

__all__ = ["HexwireDevice", "RemoteDevice", "SoDevice"]

logger = logging.getLogger(__name__)


class HexwireDevice:
    """An arm of hexwire.

    Values are LeRobot's: ``shoulder_pan.pos`` in degrees or -100 to 100, a gripper 0 to 100.
    """

    kind: ClassVar[str]
    """Robot of hexwire, such as ``so101``."""
    config: HexwireRobotConfig | HexwireTeleopConfig
    _arm: Connection

    def _begin(self, config: HexwireRobotConfig | HexwireTeleopConfig) -> None:
        """Take the configuration. Nothing is opened."""
        self.config = config
        file = self._calibration_file
        self._arm = Connection(
            config.port, self._kind, degrees=config.use_degrees, patience=config.patience, calibration_file=file
        )
        self._joints = joints_of(self._kind)

    @property
    def _kind(self) -> str:
        return self.kind

    @property
    def _calibration_file(self) -> Path | None:
        """LeRobot's file; None for an arm that needs none."""
        return None

    def say_whose(self, whose: str) -> None:
        """Let each line in the log begin with a text, as in ``left arm: ``."""
        self._arm.whose = whose

    # -- facts; nothing is sent -----------------------------------------------------------------------

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(names_of([row[0] for row in self._joints]), float)

    @property
    def is_connected(self) -> bool:
        return self._arm.is_open

    @property
    def was_connected(self) -> bool:
        """Whether `disconnect` has something to do; also after the line was lost."""
        return self._arm.was_opened

    @property
    def is_calibrated(self) -> bool:
        return self._arm.is_calibrated

    # -- the life of a connection ---------------------------------------------------------------------

    def connect(self, calibrate: bool = True) -> None:
        """Attach the arm and configure it: a robot gets torque where it stands, a leader gets none.

        Args:
            calibrate: Calibrate it now if it has no calibration, or another one than its file. A robot that is not
                calibrated gets no torque.

        Raises:
            DeviceAlreadyConnectedError: It is connected.
            ConnectionError: It cannot be reached, a servo does not answer, or a joint does not confirm its torque.
            RuntimeError: It is stopped (`hexwire resume` ends that), or a servo reports a fault; the text says what
                to do.
        """
        if self._arm.is_open:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._arm.open()
        try:
            if not self.is_calibrated and calibrate:
                logger.info("The servos and the calibration file differ, or there is no file")
                self.calibrate()
            self._open_more()
            self.configure()
        except BaseException:
            self._release()
            raise
        logger.info("%s connected.", self)

    def _open_more(self) -> None:
        """Open what belongs to the arm, such as cameras."""

    def calibrate(self) -> None:
        """Do nothing: this arm needs no calibration."""

    @abstractmethod
    def configure(self) -> None:
        """Write settings that differ, and switch torque on or off."""

    def disconnect(self) -> None:
        """Close the arm. A robot loses its torque, unless its configuration says otherwise.

        Raises:
            DeviceNotConnectedError: It is not connected.
            ConnectionError: The line is lost, or a joint does not confirm torque off; everything is closed.
        """
        if not self._arm.was_opened:
            raise DeviceNotConnectedError(f"{self} is not connected.")
        self._release()
        logger.info("%s disconnected.", self)

    def give_up(self) -> None:
        """Close an arm that was connected just now, because something else was not. It moves nowhere before."""
        self._release()

    def _release(self) -> None:
        """Close everything that is open."""
        self._arm.close()

    # -- for the subclasses ---------------------------------------------------------------------------

    def _check_connected(self) -> None:
        # One look, since this is asked in every cycle.
        if not self._arm.is_open:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")

    def _torque(self, on: bool, advice: str = "") -> None:
        """Switch the torque of all joints.

        Args:
            on: On or off.
            advice: What to do if a joint does not confirm it.

        Raises:
            ConnectionError: A joint does not confirm it.
            RuntimeError: The arm refuses, such as after a stop.
        """
        driver = self._arm.driver
        with faults():
            switched = driver.torque(on)
        if missing := [name for name in driver.model.names if name not in switched]:
            raise ConnectionError(f"{', '.join(missing)} does not confirm torque {'on' if on else 'off'}{advice}")

    def _write_settings(self) -> None:
        """Write what this kind of arm needs."""


class SoDevice(HexwireDevice):
    """An SO arm on its servo adapter, with LeRobot's calibration file and the settings that LeRobot writes."""

    leads: ClassVar[bool] = False
    """Whether it is a leader."""

    if TYPE_CHECKING:
        # Of LeRobot's base classes.
        calibration_fpath: Path

        def _load_calibration(self, fpath: Path | None = None) -> None: ...

    @property
    def _calibration_file(self) -> Path:
        return self.calibration_fpath

    def calibrate(self) -> None:
        """Ask whether the file is to be used, or calibrate; write file and servos.

        Raises:
            DeviceNotConnectedError: It is not connected.
            RuntimeError: Something odd happened; the text says what.
        """
        self._check_connected()
        super().calibrate()
        auto = bool(getattr(self.config, "auto_calibration", False))
        with self._arm.set_aside() as link:
            calibrate(load_bus_arm(self._kind), link, self.calibration_fpath, auto=auto)
        self._load_calibration()

    def _write_settings(self) -> None:
        driver = self._arm.driver
        assert isinstance(driver, BusArm)
        if written := configure(driver.bus, driver.model, self._arm.stored, leader=self.leads):
            self._arm.stored = stored(driver.bus, driver.model)
            logger.info("Written to the servos: %s", ", ".join(written))


class RemoteDevice(HexwireDevice):
    """An arm that `hexwire serve` shares, anywhere on the network."""

    def _begin(self, config: HexwireRobotConfig | HexwireTeleopConfig) -> None:
        if not is_address(config.port):
            # A device would be taken for an arm without a calibration of its own: its angles would be wrong.
            wanted = "the address of a shared arm, as in zenoh:lab/arm1"
            raise ValueError(f"hexwire_remote needs {wanted}, not {config.port}")
        super()._begin(config)

    @property
    def _kind(self) -> str:
        assert isinstance(self.config, HexwireRemoteConfig | HexwireRemoteLeaderConfig)
        return self.config.arm
