"""One arm that LeRobot has open: its driver, its calibration file, and faults as LeRobot's exceptions.

Owns what robots and leaders share, and what is done when a servo or the line is silent. Must not know actions,
cameras or LeRobot's base classes.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.control.motion.following import reopened
from hexwire.drivers.arm_file import load_calibration
from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_driver, make_driver
from hexwire.errors import HexwireError, LinkError, ReplyTimeoutError, ServoError, UsageError
from hexwire.link.diagnose import Level
from hexwire.link.open import make_link
from hexwire.wire.registers import Series

from . import servos
from .joint_values import JointValues
from .servo_faults import ServoFaults, told

if TYPE_CHECKING:
    from hexwire.bus.values import ServoBlock
    from hexwire.drivers.base import RobotDriver
    from hexwire.link.base import Link
    from hexwire.link.diagnose import Finding
    from hexwire.model.calibration import Calibration
    from hexwire.model.state import JointState

__all__ = ["RETRIES", "Connection", "faults"]

logger = logging.getLogger(__name__)

_SILENT, _AGAIN = 0.005, 0.02
"""Seconds between two questions to a servo that is silent, and between two tries to open a line that was lost."""
_TORQUE_EVERY = 2.0
"""Seconds between two questions to the servos of an arm that holds whether they still have torque."""
RETRIES = 5
"""Repeats for a servo that does not answer: recording must not end because the computer stalled."""
_REGISTERS = Series.STS_SMS.registers
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
    silent = isinstance(error, LinkError | ReplyTimeoutError) or (
        isinstance(error, ServoError) and not error.status
    )
    return (ConnectionError if silent else RuntimeError)(str(error))


class Connection:
    """The connection, closed at first.

    Args:
        port: Port or address.
        robot: Robot of hexwire, such as ``so101``; with an address of a shared arm its kind, which is checked.
        degrees: As in `JointValues`.
        patience: Seconds in which a joint that does not answer is asked again, and a lost line is opened again.
        calibration_file: LeRobot's file of an arm on a servo bus; None for an arm that needs none.

    Attributes:
        stored: What each servo of an arm on a servo bus has stored, by joint; empty for other arms.
        faults: What servos report while the arm is in use; None before it was opened.
        lost: How often the line was lost and opened again.
        whose: What comes before each line in the log, as in ``left arm: ``; empty for an arm that is alone.
    """

    def __init__(
        self, port: str, robot: str, *, degrees: bool, patience: float, calibration_file: Path | None = None
    ) -> None:
        if not (math.isfinite(patience) and patience >= 0.0):
            raise ValueError(f"patience must be a number of seconds from 0, not {patience}")
        self.port, self.robot, self.degrees, self.file = port, robot, degrees, calibration_file
        self.patience = patience
        self.stored: dict[str, ServoBlock] = {}
        self.faults: ServoFaults | None = None
        self.lost = 0
        self.whose = ""
        self.calibration: Calibration | None = None
        self._driver: RobotDriver | None = None
        self._link: Link | None = None
        self._values: JointValues | None = None
        self._stored = False
        self._ask_torque = -math.inf

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
            ConnectionError: It cannot be reached, or a servo does not answer.
            RuntimeError: A servo reports a fault, or has a supply or a temperature outside its limits.
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

    def read(self, *, loads: bool = False) -> JointState:
        """Read the positions of all joints, each of them new.

        Args:
            loads: Read the loads, too.

        Raises:
            ConnectionError: A joint does not answer, or the line is lost, for longer than the patience.
        """
        end = math.inf
        while True:
            driver = self._driver
            assert driver is not None
            try:
                if self.faults is not None and self.faults.holds and isinstance(driver, BusArm):
                    now = time.monotonic()
                    if now >= self._ask_torque:
                        self._ask_torque = now + _TORQUE_EVERY
                        driver.read_torque()
                state = driver.read_loads() if loads else driver.read_positions()
            except LinkError as error:
                # One patience for all of it: a line that is lost again and again does not keep its caller.
                end = min(end, time.monotonic() + self.patience)
                self.open_again(error, end)
                continue
            except HexwireError as error:
                raise translated(error) from error
            if not state.silent:
                if self.faults is not None:
                    self.faults.see(state)
                return state
            now = time.monotonic()
            # It may have restarted, and has no torque then.
            self._ask_torque = now
            end = min(end, now + self.patience)
            if now >= end:
                raise ConnectionError(f"{', '.join(state.silent)} does not answer: check cable and power")
            # A servo that was silent is soon asked without waiting for it.
            time.sleep(_SILENT)

    def open_again(self, lost: LinkError, end: float = math.inf) -> None:
        """Open a line that was lost; torque is as the servos have it.

        Args:
            lost: What the line said.
            end: Until when at most, monotonic seconds.

        Raises:
            ConnectionError: It was lost for longer than the patience.
        """
        driver, began = self.driver, time.monotonic()
        end = min(end, began + self.patience)
        while time.monotonic() < end:
            # Before the first try, too: a line that is lost again at once is not opened again without a pause.
            time.sleep(_AGAIN)
            if reopened(driver):
                self.lost += 1
                logger.warning("%s%s; it is open again after %.2f s", self.whose, lost, time.monotonic() - began)
                return
        raise translated(lost) from lost

    def _examine(self, driver: RobotDriver) -> None:
        self._values, self._stored, self.stored = None, True, {}
        if isinstance(driver, BusArm):
            self.stored = servos.stored(driver.bus, driver.model)
            silent = {name for name, block in self.stored.items() if block.error}
        else:
            silent = set()
        state = driver.read()
        silent |= set(state.silent)
        if silent and isinstance(driver, BusArm):
            raise ConnectionError(told(servos.unreadable(driver.bus, driver.model, silent), driver.model))
        if silent:
            raise ConnectionError(f"{', '.join(sorted(silent))} does not answer: check cable and power")
        probes = servos.probes(driver.model, self.stored) if self.stored else driver.probe().joints
        self.faults = ServoFaults(driver.model, probes, self.whose)
        self._ask_torque = -math.inf
        self._refuse(self.faults.judge(state), driver)
        reversed_joints: tuple[str, ...] = ()
        if isinstance(driver, BusArm):
            if self.calibration is None:
                self._stored = False
                return
            names = {row.servo_id: row.name for row in driver.model.joints}
            for row in self.calibration.joints:
                block = self.stored[names[row.servo_id]]
                for name, wanted in zip(_STORED, (row.servo_offset, row.low, row.high), strict=True):
                    self._stored = self._stored and block.raw(_REGISTERS[name]) == wanted
            if not self._stored:
                return
            reversed_joints = tuple(row.name for row in self.calibration.joints if row.drive_mode)
        self._values = JointValues(driver.model, degrees=self.degrees, reversed_joints=reversed_joints)

    def _refuse(self, findings: Sequence[Finding], driver: RobotDriver) -> None:
        if bad := [one for one in findings if one.level is Level.BAD]:
            raise RuntimeError(told(bad, driver.model))
        if hints := [one for one in findings if one.level is Level.HINT]:
            logger.warning("%s%s", self.whose, told(hints, driver.model))


def _bus_arm(robot: str) -> type[BusArm]:
    driver = load_driver(robot)
    assert issubclass(driver, BusArm)
    return driver


def _load(file: Path, robot: str) -> Calibration:
    found = load_calibration(file)
    found.apply(_bus_arm(robot).described().model)
    return found
