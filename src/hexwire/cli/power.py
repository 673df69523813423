"""`torque`, `stop`, `resume`, `grip` and `pump`: whether the arm may move, has torque, or holds something.

Owns the messages about the outcome, and how a user types a tool command. Must not know how it is achieved.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from hexwire.errors import DeviceError, ServoError

from .channel import all_option, resume_all, stop_all
from .exits import note
from .move import hold_on_ctrl_c, unwatched_note
from .options import (
    FiniteFloat,
    NumbersCommand,
    RobotOptions,
    json_option,
    number_option,
    open_robot,
    robot_options,
)
from .output import answer, plain, say

if TYPE_CHECKING:
    from hexwire.control.power import Torques
    from hexwire.model.arm import ArmModel

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
def torque(switch: str, joints: tuple[str, ...], options: RobotOptions, as_json: bool) -> None:
    """Switch the torque of all joints, or of the named joints, on or off.

    "on" moves nothing: the joints hold their position. After "off" the arm may sink or fall: hold it.
    """
    with open_robot(options) as robot:
        wanted = [robot.model.joint(name).name for name in joints] or list(robot.model.names)
        confirmed = robot.torque(switch == "on", wanted)
        _report(robot.model, wanted, confirmed, f"torque {switch}", as_json)


@click.command()
@click.option("--torque-off", is_flag=True, help="Switch torque off as well: the arm may fall.")
@all_option
@robot_options
@json_option
def stop(torque_off: bool, everybody: bool, options: RobotOptions, as_json: bool) -> None:
    """Stop the arm at its present position and keep it stopped: nothing moves until `hexwire resume`.

    A board with hexwire's firmware latches the stop for every program. A dialect-1 board and a servo bus cannot:
    there hexwire keeps the stop for you in a file, one per device. Other users, other computers and programs that
    do not use hexwire do not see it and can move the arm.
    """
    if everybody:
        stop_all(options, torque_off=torque_off, as_json=as_json)
        return
    from hexwire.control.power import Torques
    from hexwire.drivers.base import StopMode
    from hexwire.errors import HexwireError

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
        _report(robot.model, robot.model.names, confirmed, "stopped", as_json, torques)


@click.command()
@all_option
@robot_options
@json_option
def resume(everybody: bool, options: RobotOptions, as_json: bool) -> None:
    """End a stop. The arm does not move, and torque that the stop switched off stays off.

    If a watchdog stopped the arm because the program that had armed it died, the watchdog is switched off as well.
    """
    if everybody:
        resume_all(options, as_json)
        return
    from hexwire.control.power import end_stop
    from hexwire.model.state import JointFlag

    with open_robot(options) as robot:
        tripped = end_stop(robot)
        if tripped and not as_json:
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
        answer(as_json, data, words + (f"; unknown: {' '.join(unknown)}" if unknown else ""))


def _report(
    model: ArmModel,
    wanted: Sequence[str],
    confirmed: Sequence[str],
    words: str,
    as_json: bool,
    torques: Torques | None = None,
) -> None:
    """Print which joints confirmed, or after a stop what they do.

    Raises:
        ServoError: Some did not.
    """
    from hexwire.errors import ServoError

    missing = [model.joint(name) for name in wanted if name not in confirmed]
    data = {"did": words, "confirmed": list(confirmed), "missing": [joint.name for joint in missing]}
    if torques is None:
        answer(as_json, data, f"{words}: {' '.join(confirmed) or 'none'}")
    else:
        answer(as_json, data | asdict(torques), f"{words}, {torques}")
    if missing:
        names = ", ".join(f"{joint.name} (servo {joint.servo_id})" for joint in missing)
        raise ServoError(f"not confirmed by {names}", servo_id=missing[0].servo_id)


_NAMED = {"open": 1.0, "close": 0.0}


@click.command(cls=NumbersCommand)
@click.argument("how", metavar="open|close|PERCENT")
@number_option("--duration", "SECONDS", "Time from closed to open.", above=0, default=0.8)
@robot_options
@json_option
def grip(how: str, duration: float, options: RobotOptions, as_json: bool) -> None:
    """Open or close the gripper, or open it to a percentage.

    Closing ends when the jaws hold an object, and keeps a little pressure on it. If the board has a watchdog, it
    stops the gripper when this program dies.
    """
    from hexwire.control.gripping import run_grip
    from hexwire.control.motions import MotionObserver
    from hexwire.control.reader import position_unknown
    from hexwire.drivers.tools import Gripper

    share: float
    if how in _NAMED:
        share = _NAMED[how]
    else:
        share = FiniteFloat("percent", minimum=0).convert(how.removesuffix("%"), None, None) / 100
    with open_robot(options) as robot:
        joint = Gripper(robot).joint

        class Teller(MotionObserver):
            def unwatched(self, seconds: float) -> None:
                unwatched_note(robot, seconds)

        with hold_on_ctrl_c(robot):
            gripped = run_grip(robot, share, duration, observer=Teller())
        result, opened = gripped.motion, gripped.opening
        if result.stopped is not None:
            raise DeviceError(f"{result.why}; clear it with 'hexwire resume'")
        if not math.isfinite(opened):
            raise ServoError(
                position_unknown([joint.name]),
                servo_id=joint.servo_id,
            )
        words = f"{'holds an object at ' if gripped.holds else ''}{plain(100 * opened, 0)} % open"
        answer(as_json, {"open_fraction": opened, "holds": gripped.holds}, words)
        if not gripped.holds and not result.arrived:
            raise ServoError(f"{joint.name} did not arrive", servo_id=joint.servo_id)


@click.command()
@click.argument("how", type=click.Choice(["suck", "release", "off", "state"]))
@click.option(
    "--time",
    "seconds",
    type=FiniteFloat("seconds", minimum=0),
    default=0.5,
    show_default=True,
    metavar="SECONDS",
    help="With release, how long the valve stays open.",
)
@robot_options
@json_option
def pump(how: str, seconds: float, options: RobotOptions, as_json: bool) -> None:
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
        answer(as_json, {"pump_on": running, "valve_open": open_valve}, words)
