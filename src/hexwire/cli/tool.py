"""`grip` and `pump`: the tools of an arm.

Owns how a user types a tool command. Must not know how a tool is driven.
"""

from __future__ import annotations

import math
import time

import click

from hexwire.errors import DeviceError, ServoError

from .common import RobotOptions, json_option, open_robot, robot_options
from .move import hold_on_ctrl_c, unwatched_note
from .numbers import FiniteFloat, NumbersCommand, number_option
from .output import answer, plain

__all__ = ["grip", "pump"]

_NAMED = {"open": 1.0, "close": 0.0}
_GRACE = 0.5
"""Seconds after the duration in which the gripper must arrive."""
_NEAR = 0.1
"""Position tolerance as a fraction of its range."""
_STANDS = math.radians(3.0)
"""Radians per second below which it counts as stopped."""
_PRESSED = 3
"""Consecutive states with pressure but no motion that mean an object is held."""


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
    from hexwire.control.motions import MotionObserver, MotionOptions, run_motion
    from hexwire.control.reader import position_unknown
    from hexwire.drivers.tools import Gripper
    from hexwire.model.state import JointState, JointTarget

    share: float
    if how in _NAMED:
        share = _NAMED[how]
    else:
        share = FiniteFloat("percent", minimum=0).convert(how.removesuffix("%"), None, None) / 100
    with open_robot(options) as robot:
        gripper = Gripper(robot)
        joint = gripper.joint
        target = JointTarget.of({joint.name: gripper.angle(share)}, duration)
        pressed, closing = 0, False

        class Teller(MotionObserver):
            def unwatched(self, seconds: float) -> None:
                unwatched_note(robot, seconds)

            def started(self, timing: object) -> None:
                nonlocal closing
                closing = share < gripper.share(robot.read())

        def holds(state: JointState) -> JointTarget | None:
            nonlocal pressed
            # A single state may be the start of the motion, which takes effort too.
            pressed = pressed + 1 if closing and gripper.holds(state, share) else 0
            return gripper.grasp(state) if pressed >= _PRESSED else None

        near = _NEAR * (joint.maximum - joint.minimum)
        with hold_on_ctrl_c(robot):
            how_to = MotionOptions(tolerance=near, standing=_STANDS, grace=_GRACE, early=False)
            result = run_motion(robot, target, how_to, until=holds, observer=Teller())
        if result.stopped is not None:
            raise DeviceError(f"{result.why}; clear it with 'hexwire resume'")
        opened = math.nan if result.state is None else gripper.share(result.state)
        if not math.isfinite(opened):
            raise ServoError(
                position_unknown([joint.name]),
                servo_id=joint.servo_id,
            )
        words = f"{'holds an object at ' if result.cut else ''}{plain(100 * opened, 0)} % open"
        answer(as_json, {"open_fraction": opened, "holds": result.cut}, words)
        if not result.cut and not result.arrived:
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
