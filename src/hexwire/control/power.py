"""Switches torque on and off, requires that every joint confirms it, and ends a stop.

Owns the error if a joint does not confirm. Must not know motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hexwire.drivers.values import StopCause
from hexwire.errors import ServoError

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

    from .owner import RobotOwner

__all__ = ["end_stop", "give_torque", "switch_torque"]


def give_torque(robot: RobotDriver, names: Sequence[str], state: JointState) -> tuple[str, ...]:
    """Switch torque on for those joints that have none. Nothing moves.

    Args:
        robot: Attached.
        names: Joints.
        state: Just read.

    Returns:
        Names of the joints whose torque was switched on.

    Raises:
        ServoError: A joint did not confirm it.
        StoppedError: A stop is latched.
    """
    missing = [name for name in names if name not in state.torque_on]
    if not missing:
        return ()
    confirmed = robot.torque(True, missing)
    silent = [(robot.model.joint(name).servo_id, name) for name in missing if name not in confirmed]
    if silent:
        several = len(silent) > 1
        raise ServoError(
            f"servo{'s' if several else ''} {', '.join(f'{servo_id} ({name})' for servo_id, name in silent)} "
            f"{'do' if several else 'does'} not answer: check cable, power and id",
            servo_id=silent[0][0],
        )
    return confirmed


def switch_torque(owner: RobotOwner, on: bool, names: Sequence[str]) -> None:
    """Switch torque on or off, and require that every joint confirms it.

    Raises:
        HexwireError: As `RobotOwner.torque`; or a joint did not confirm it, and the text names it.
    """
    confirmed = owner.torque(on, names)
    missing = [name for name in names if name not in confirmed]
    if missing:
        raise ServoError(f"{', '.join(missing)} did not confirm that torque is {'on' if on else 'off'}")


def end_stop(robot: RobotDriver) -> bool:
    """End a stop. Nothing moves, and torque that the stop switched off stays off.

    A watchdog that stopped the arm because its program died is switched off: otherwise it would stop the arm again
    as soon as this program ends.

    Returns:
        Whether a watchdog had stopped the arm.

    Raises:
        HexwireError: The robot failed or refused.
    """
    tripped = robot.stop_latch().cause is StopCause.WATCHDOG
    robot.resume()
    if tripped:
        robot.watchdog(0.0)
    return tripped
