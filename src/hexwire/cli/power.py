"""`torque`, `stop`, `resume`, `grip` and `pump`: whether the arm may move, has torque, or holds something.

Owns the messages about the outcome, and how a user types a tool command.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict

import click

from hexwire.errors import HexwireError

from .channel import all_option, resume_all, stop_all
from .exits import note
from .options import (
    NumbersCommand,
    RobotOptions,
    json_option,
    number_option,
    open_robot,
    parse_opening,
    robot_options,
)
from .output import answer, say

__all__ = ["grip", "pump", "resume", "stop", "torque"]

_KEPT_HERE = (
    "note: no board latches this stop: hexwire keeps it for this user on this computer until 'hexwire resume'; "
    "other users and programs can move the arm"
)
_KEPT_BY_SERVER = "note: no board latches this stop: the arm's server keeps it until 'hexwire resume'"
_KEPT_NOT = "note: this stop is not latched: it ended with this command, and the next command may move the arm"
_KEPT = {"server": _KEPT_BY_SERVER, "user": _KEPT_HERE}


@click.command()
@click.argument("switch", metavar="on|off", type=click.Choice(["on", "off"]))
@click.argument("joints", metavar="[JOINT]...", nargs=-1)
@robot_options
@json_option
def torque(switch: str, joints: tuple[str, ...], options: RobotOptions) -> None:
    """Switch the torque of all joints, or of the named joints, on or off.

    "on" moves nothing: the joints hold their position. After "off" the arm may sink or fall: hold it.
    """
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm

    from .verbs import TorqueTeller

    with open_robot(options) as robot:
        told = TorqueTeller(robot, f"torque {switch}")
        Arm(robot, front=Front(told)).torque(switch == "on", *joints)


@click.command()
@click.option("--torque-off", is_flag=True, help="Switch torque off as well: the arm may fall.")
@all_option
@robot_options
@json_option
def stop(torque_off: bool, everybody: bool, options: RobotOptions) -> None:
    """Stop the arm at its present position and keep it stopped: nothing moves until `hexwire resume`.

    A board with hexwire's firmware latches the stop for every program. A dialect-1 board and a servo bus cannot:
    there hexwire keeps the stop for you in a file, one per device. Other users, other computers and programs that
    do not use hexwire do not see it and can move the arm.
    """
    if everybody:
        stop_all(options, torque_off=torque_off)
        return
    from hexwire.control.loop.power import Torques, require_confirmed
    from hexwire.drivers.base import StopMode

    with open_robot(options) as robot:
        mode = StopMode.TORQUE_OFF if torque_off else StopMode.HOLD
        confirmed = robot.stop(mode)
        state = None
        # The arm is stopped; what it does can only be read.
        with suppress(HexwireError):
            state = robot.read()
        now = state.stamp if state is not None else 0.0
        torques = Torques.of(robot.model.names, state, now).after_stop(confirmed, mode)
        kept = robot.stop_kept_by
        if kept != "board":
            note(_KEPT.get(kept, _KEPT_NOT))
        missing = [name for name in robot.model.names if name not in confirmed]
        data = {"did": "stopped", "confirmed": confirmed, "missing": missing} | asdict(torques)
        answer(data, f"stopped, {torques}")
        require_confirmed(robot.model, robot.model.names, confirmed, "the stop")


@click.command()
@all_option
@robot_options
@json_option
def resume(everybody: bool, options: RobotOptions) -> None:
    """End a stop. The arm does not move, and torque that the stop switched off stays off.

    If a watchdog stopped the arm because the program that had armed it died, the watchdog is switched off as well.
    """
    if everybody:
        resume_all(options)
        return
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm
    from hexwire.model.state import JointFlag

    with open_robot(options) as robot:
        tripped = Arm(robot, front=Front()).resume()
        if tripped:
            say("the watchdog of the program that fell silent is now off")
        state = robot.read()
        unknown = [joint.name for joint in state if joint.flags & JointFlag.TORQUE_UNKNOWN]
        words = f"resumed; torque on: {' '.join(state.torque_on) or 'none'}"
        data = {
            "resumed": True,
            "watchdog_tripped": tripped,
            "torque_on": state.torque_on,
            "torque_unknown": unknown,
        }
        answer(data, words + (f"; unknown: {' '.join(unknown)}" if unknown else ""))


@click.command(cls=NumbersCommand)
@click.argument("how", metavar="open|close|PERCENT")
@number_option("--duration", "SECONDS", "Time from closed to open.", above=0, default=0.8)
@robot_options
@json_option
def grip(how: str, duration: float, options: RobotOptions) -> None:
    """Open or close the gripper, or open it to a percentage.

    Closing ends when the jaws hold an object, and keeps a little pressure on it. If the board has a watchdog, it
    stops the gripper when this program dies.
    """
    from hexwire.arm.front import Front
    from hexwire.arm.verbs import Arm

    from .verbs import GripTeller, hold_on_ctrl_c

    opening = parse_opening(how)
    with open_robot(options) as robot, hold_on_ctrl_c(robot):
        Arm(robot, front=Front(GripTeller(robot))).grip(opening, duration=duration)


@click.command()
@click.argument("how", type=click.Choice(["suck", "release", "off", "state"]))
@number_option(
    "--time", "SECONDS", "With release, how long the valve stays open.", minimum=0, default=0.5, dest="seconds"
)
@robot_options
@json_option
def pump(how: str, seconds: float, options: RobotOptions) -> None:
    """Suction cup: hold (suck), release, switch all off, or show the state."""
    from hexwire.drivers.tools import Suction

    with open_robot(options) as robot:
        suction = Suction(robot)
        if how == "suck":
            suction.suck()
        elif how == "release":
            suction.release()
            try:
                time.sleep(seconds)
            finally:
                suction.off()
        elif how == "off":
            suction.off()
        running, open_valve = suction.read()
        words = f"pump {'on' if running else 'off'}, valve {'open' if open_valve else 'shut'}"
        answer({"pump_on": running, "valve_open": open_valve}, words)
