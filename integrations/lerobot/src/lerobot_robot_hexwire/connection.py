"""One arm that LeRobot has open: its driver, its calibration file, and faults as LeRobot's exceptions.

Owns what robots and leaders share. Must not know actions, cameras or LeRobot's base classes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.drivers.arm_file import load_calibration
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_driver, make_driver
from hexwire.errors import HexwireError, LinkError, ReplyTimeoutError, UsageError
from hexwire.link.open import make_link

from .joint_values import JointValues

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.link.base import Link
    from hexwire.model.calibration import Calibration
    from hexwire.model.state import JointState

__all__ = ["RETRIES", "Connection", "faults"]

_PATIENCE = 0.1
"""Seconds in which a position that did not arrive is asked for again."""
RETRIES = 5
"""Repeats for a servo that does not answer: recording must not end because the computer stalled."""
_STORED = ("position_offset", "min_position_limit", "max_position_limit")


@contextmanager
def faults() -> Iterator[None]:
    """Turn faults of the arm into the exceptions that LeRobot's own arms raise.

    Raises:
        ConnectionError: The line is lost, or something does not answer.
        ValueError: A request is wrong.
        RuntimeError: The arm refuses, such as after a stop.
    """
    try:
        yield
    except HexwireError as error:
        raise translated(error) from error


def translated(error: HexwireError) -> Exception:
    """The exception for a fault; see `faults`."""
    if isinstance(error, UsageError):
        return error
    kind = ConnectionError if isinstance(error, LinkError | ReplyTimeoutError) else RuntimeError
    return kind(str(error))


class Connection:
    """The connection, closed at first.

    Args:
        port: Port or address.
        robot: Robot of hexwire, such as ``so101``; with an address of a shared arm its kind, which is checked.
        degrees: As in `JointValues`.
        calibration_file: LeRobot's file of an arm on a servo bus; None for an arm that needs none.
    """

    def __init__(self, port: str, robot: str, *, degrees: bool, calibration_file: Path | None = None) -> None:
        self.port, self.robot, self.degrees, self.file = port, robot, degrees, calibration_file
        self.calibration: Calibration | None = None
        self._driver: RobotDriver | None = None
        self._link: Link | None = None
        self._values: JointValues | None = None
        self._stored = False

    @property
    def is_open(self) -> bool:
        """Whether the arm can be reached."""
        return self._driver is not None and self._driver.is_attached

    @property
    def was_opened(self) -> bool:
        """Whether `close` has something to do; also after the line was lost."""
        return self._driver is not None

    @property
    def driver(self) -> RobotDriver:
        """The attached driver."""
        assert self._driver is not None
        return self._driver

    @property
    def values(self) -> JointValues:
        """The units of the attached arm.

        Raises:
            RuntimeError: It is not calibrated.
        """
        if self._values is None:
            raise RuntimeError(f"the arm at {self.port} is not calibrated: run lerobot-calibrate")
        return self._values

    @property
    def is_calibrated(self) -> bool:
        """Whether its file and its servos have the same calibration; always true for an arm that needs none."""
        return self._driver is not None and self._stored

    def open(self) -> None:
        """Attach the arm; nothing is written. Only a board with the chapter's sketch moves it, after a warning.

        Raises:
            ConnectionError: It cannot be reached.
        """
        with faults():
            if self.file is None:
                self._driver = make_driver(self.port, self.robot)
            else:
                self._link = self._link or make_link(self.port)
                self.calibration = _load(self.file, self.robot) if self.file.is_file() else None
                arm = _bus_arm(self.robot)(self._link, calibration=self.calibration)
                arm.bus.retries = RETRIES
                self._driver = arm
            try:
                self._driver.attach()
                self._examine(self._driver)
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        """Close the connection; torque stays as it is."""
        driver, self._driver, self._values, self._stored = self._driver, None, None, False
        if driver is not None:
            driver.detach()

    @contextmanager
    def set_aside(self) -> Iterator[Link]:
        """Lend the link of an arm on a servo bus to a `with` block, such as a calibration; then attach again."""
        assert self._link is not None
        self.close()
        try:
            yield self._link
        finally:
            self.open()

    def read(self) -> JointState:
        """Read the positions of all joints, each of them new.

        Raises:
            ConnectionError: A joint does not answer.
        """
        driver = self._driver
        assert driver is not None
        try:
            state = driver.read_positions()
            if state.silent:
                state = _again(driver)
        except HexwireError as error:
            raise translated(error) from error
        return state

    def _examine(self, driver: RobotDriver) -> None:
        self._values, self._stored = None, True
        reversed_joints: tuple[str, ...] = ()
        if isinstance(driver, BusArm):
            if self.calibration is None:
                self._stored = False
                return
            for row in self.calibration.joints:
                for name, wanted in zip(_STORED, (row.servo_offset, row.low, row.high), strict=True):
                    reading = driver.bus.read(row.servo_id, name)
                    if reading.raw is None:
                        reading.check()
                    self._stored = self._stored and reading.raw == wanted
            if not self._stored:
                return
            reversed_joints = tuple(row.name for row in self.calibration.joints if row.drive_mode)
        self._values = JointValues(driver.model, degrees=self.degrees, reversed_joints=reversed_joints)


def _again(driver: RobotDriver) -> JointState:
    end = time.monotonic() + _PATIENCE
    while True:
        state = driver.read_positions()
        if not state.silent:
            return state
        if time.monotonic() >= end:
            raise ConnectionError(f"{', '.join(state.silent)} does not answer: check cable and power")


def _bus_arm(robot: str) -> type[BusArm]:
    driver = load_driver(robot)
    assert issubclass(driver, BusArm)
    return driver


def _load(file: Path, robot: str) -> Calibration:
    found = load_calibration(file)
    found.apply(_bus_arm(robot).described().model)
    return found
