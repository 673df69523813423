"""`torque`, `stop` and `resume`: whether the arm may move, and has the strength to.

Owns what is said about the outcome. Must not know how it comes about.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from .common import RobotOptions, open_robot, robot_options
from .output import say

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["resume", "stop", "torque"]


@click.command()
@click.argument("switch", metavar="on|off", type=click.Choice(["on", "off"]))
@click.argument("joints", metavar="[JOINT]...", nargs=-1)
@robot_options
def torque(switch: str, joints: tuple[str, ...], options: RobotOptions) -> None:
    """Switch the torque of all joints, or of those named, on or off.

    On moves nothing: the joints hold where they are. Off lets the arm sink or fall: hold it.
    """
    with open_robot(options) as robot:
        wanted = [robot.model.joint(name).name for name in joints] or list(robot.model.names)
        confirmed = robot.torque(switch == "on", wanted)
        _report(robot.model, wanted, confirmed, f"torque {switch}")


@click.command()
@click.option("--torque-off", is_flag=True, help="Take the torque away as well: the arm may fall.")
@robot_options
def stop(torque_off: bool, options: RobotOptions) -> None:
    """Stop the arm where it is and keep it stopped: nothing moves until `hexwire resume`."""
    from hexwire.drivers.base import StopMode

    with open_robot(options) as robot:
        confirmed = robot.stop(StopMode.TORQUE_OFF if torque_off else StopMode.HOLD)
        words = "stopped, torque off" if torque_off else "stopped, holding"
        _report(robot.model, robot.model.names, confirmed, words)


@click.command()
@robot_options
def resume(options: RobotOptions) -> None:
    """End a stop. Nothing moves by it, and torque that the stop took away stays off.

    Where a watchdog stopped the arm, because the program that had set it died, it is switched off as well.
    """
    with open_robot(options) as robot:
        tripped = robot.read().watchdog_tripped
        robot.resume()
        watchdog = getattr(robot, "watchdog", None)
        if tripped and watchdog is not None:
            # Or it would stop the arm again as soon as this program has ended.
            watchdog(0.0)
            say("the watchdog of the program that fell silent is off")
        on = robot.read().torque_on
        say(f"resumed; torque on: {' '.join(on) or 'none'}")


def _report(model: ArmModel, wanted: Sequence[str], confirmed: Sequence[str], words: str) -> None:
    """Print which joints confirmed.

    Raises:
        ServoError: Some did not.
    """
    from hexwire.errors import ServoError

    say(f"{words}: {' '.join(confirmed) or 'none'}")
    missing = [model.joint(name) for name in wanted if name not in confirmed]
    if missing:
        names = ", ".join(f"{joint.name} (servo {joint.servo_id})" for joint in missing)
        raise ServoError(f"not confirmed by {names}", servo_id=missing[0].servo_id)
