"""`grip` and `pump`: what the arm has at its end.

Owns what a person types for a tool. Must not know how a tool is driven.
"""

from __future__ import annotations

import math
import time

import click

from hexwire.errors import DeviceError, ServoError

from .common import FiniteFloat, RobotOptions, json_option, open_robot, robot_options, watched
from .output import answer, plain

__all__ = ["grip", "pump"]

_RATE = 20.0
_SETTLE = 0.5
_PRESSED = 3
"""Reads in a row that show pressure without motion."""


@click.command()
@click.argument("how", metavar="open|close|PERCENT")
@click.option(
    "--duration",
    type=FiniteFloat("seconds", above=0),
    default=0.8,
    show_default=True,
    metavar="SECONDS",
    help="Time from shut to open.",
)
@robot_options
@json_option
def grip(how: str, duration: float, options: RobotOptions, as_json: bool) -> None:
    """Open or close the gripper, or open it by so many percent.

    Closing ends where something is between the jaws, and keeps a little pressure on it. The board stops the gripper
    if this program dies, where it has a watchdog.
    """
    from hexwire.control.loop import RateLoop
    from hexwire.drivers.tools import Gripper
    from hexwire.motion.safety import board_stop

    share = {"open": 1.0, "close": 0.0}.get(how)
    if share is None:
        share = FiniteFloat("percent", minimum=0).convert(how.removesuffix("%"), None, None) / 100
    with open_robot(options) as robot, watched(robot, duration, 1 / _RATE):
        gripper = Gripper(robot)
        angle = gripper.angle(share)
        if gripper.joint.name not in robot.read().torque_on:
            robot.torque(True, [gripper.joint.name])
        sent = gripper.move(share, duration)
        state = robot.read()
        closing = share < gripper.share(state)
        pressed = 0
        for _ in RateLoop(_RATE).ticks(sent.duration + _SETTLE):
            state = robot.read()
            found = board_stop(state)
            if found is not None:
                raise DeviceError(f"stopped: {found}; 'hexwire resume' ends that")
            # Once may be the start of the motion, which takes effort as well.
            pressed = pressed + 1 if closing and gripper.holds(state, share) else 0
            if pressed >= _PRESSED:
                gripper.keep(state)
                opened = gripper.share(state)
                words = f"holds something at {plain(100 * opened, 0)} % open"
                answer(as_json, {"open_fraction": opened, "holds": True}, words)
                return
            if abs(state[gripper.joint.name].position - angle) < gripper.joint.scale * 5:
                break
        if not math.isfinite(gripper.share(state)):
            raise ServoError(
                f"it is not known where {gripper.joint.name} is: no answer; check cable, power and id",
                servo_id=gripper.joint.servo_id,
            )
        opened = gripper.share(state)
        answer(as_json, {"open_fraction": opened, "holds": False}, f"{plain(100 * opened, 0)} % open")
        if not abs(gripper.share(state) - share) <= 0.1:
            raise ServoError(f"{gripper.joint.name} did not get there", servo_id=gripper.joint.servo_id)


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
    """Suction cup: hold (suck), let go (release), all off, or say what is on."""
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
