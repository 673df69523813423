"""`joystick` and `teleop`: a stick on this machine or on another moves an arm.

Owns the loop from stick to arm, and that the arm holds however it ends. Must not know what makes a motion safe:
that is `hexwire.motion.teleop`'s.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hexwire.errors import DeviceError, HexwireError, StoppedError, UsageError

from .common import (
    FiniteFloat,
    RobotOptions,
    json_option,
    make_robot,
    open_robot,
    refuse_table,
    robot_options,
    table_options,
    watched,
)
from .exits import note, shielded
from .model import links_option
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.motion.teleop import Teleop
    from hexwire.wire.robot_bodies import JoystickState

__all__ = ["Stick", "drive", "joystick", "teleop"]

Stick = Callable[[], "tuple[JoystickState | None, float]"]
"""Gives the newest state and its age in seconds."""

_OVERLAP = 2.5
"""Set-points last this many cycles, so that one that is late makes no stop."""
_SETTLE = 0.05


@click.group()
def joystick() -> None:
    """Read a joystick, or send it over a channel."""


@joystick.command("list")
@json_option
def list_(as_json: bool) -> None:
    """List the joysticks of this machine."""
    from hexwire.joystick.device import find_joysticks

    found = find_joysticks()
    if as_json:
        print_json([str(path) for path in found])
        return
    if not found:
        note("no joystick is plugged in, or this user may not read /dev/input")
    for path in found:
        say(path)


@joystick.command()
@click.argument("device", required=False)
def show(device: str | None) -> None:
    """Print axes and buttons of a joystick as they change, to find out their numbers."""
    from hexwire.joystick.device import open_joystick

    before = None
    with contextlib.closing(open_joystick(device)) as stick:
        while True:
            state = stick.read(0.25)
            if state != before:
                axes = "  ".join(f"{number}:{value:+.2f}" for number, value in enumerate(state.axes))
                down = " ".join(str(i) for i in range(32) if state.pressed(i))
                say(f"axes {axes}  buttons {down or 'none'}", flush=True)
            before = state


@joystick.command()
@click.argument("device", required=False)
@click.option("--to", "url", metavar="URL", help="Where it goes, as udp://192.168.1.20:15040.")
@click.option("--conf", metavar="FILE", help="The file that names the channel of JOY_STICK, in place of --to.")
@click.option(
    "--rate", type=FiniteFloat("hz", above=0), default=50.0, show_default=True, metavar="HZ", help="How often."
)
def send(device: str | None, url: str | None, conf: str | None, rate: float) -> None:
    """Send a joystick over a channel, again and again, until interrupted."""
    from hexwire.control.loop import RateLoop
    from hexwire.joystick.channel import JoystickSender
    from hexwire.joystick.device import open_joystick

    if (url is None) == (conf is None):
        raise UsageError("say where to: --to URL or --conf FILE")
    sender = JoystickSender.from_url(url) if url is not None else JoystickSender.from_conf(str(conf))
    with contextlib.closing(open_joystick(device)) as stick, sender:
        note(f"sending {stick.path} to {sender.session.ipc.link.url}; Ctrl-C ends it")
        for _ in RateLoop(rate).ticks():
            sender.send(stick.read())


@click.command()
@click.option("--device", metavar="PATH", help="A joystick of this machine.")
@click.option("--from", "url", metavar="URL", help="A channel it comes over, as udp-listen://127.0.0.1:15040.")
@click.option("--conf", metavar="FILE", help="The file that names that channel, in place of --from.")
@click.option(
    "--mode", type=click.Choice(["joint", "cartesian"]), default="joint", show_default=True, help="How it begins."
)
@click.option(
    "--speed",
    type=FiniteFloat("share", above=0),
    default=0.3,
    show_default=True,
    metavar="SHARE",
    help="Share of the joints' speed limits at full deflection.",
)
@click.option(
    "--rate",
    type=FiniteFloat("hz", above=0),
    default=20.0,
    show_default=True,
    metavar="HZ",
    help="Cycles a second.",
)
@click.option(
    "--dead-man", type=click.IntRange(0, 31), default=4, show_default=True, metavar="N", help="Its button."
)
@table_options
@links_option
@robot_options
def teleop(
    device: str | None,
    url: str | None,
    conf: str | None,
    mode: str,
    speed: float,
    rate: float,
    dead_man: int,
    table: float | None,
    links: str,
    options: RobotOptions,
) -> None:
    """Move an arm by joystick, as long as the dead-man button is held.

    Letting go of it, or losing the joystick's channel, makes the arm hold at once; and it stays where the next step
    would lead through a gate of the arm or into the table. Button 7 changes between joints and the tool's
    directions; buttons 0 and 1 close and open the gripper. Without --device, --from or --conf it is the only
    joystick of this machine. The board stops the arm if this program dies, where it has a watchdog.
    """
    from hexwire.control.loop import RateLoop
    from hexwire.model.geometry import kinematics_or_none
    from hexwire.motion.fence import Fence
    from hexwire.motion.teleop import JogMode, StickMap, Teleop

    if sum(option is not None for option in (device, url, conf)) > 1:
        raise UsageError("one of --device, --from and --conf is enough")
    if speed > 1.0:
        raise UsageError(f"--speed {speed:g} is over the joints' own limits; 1 is the most")
    model = make_robot(options).model
    kinematics = kinematics_or_none(model.name, links)
    fence = None
    if kinematics is not None:
        fence = Fence(kinematics, table)
    else:
        refuse_table(model)
    rules = Teleop(model, kinematics, StickMap(dead_man=dead_man), mode=JogMode(mode), share=speed, fence=fence)
    with _stick(device, url, conf) as stick, open_robot(options) as robot:
        robot.torque(True)
        note(f"hold button {dead_man} to move {model.name}, {mode} jog; Ctrl-C ends it")
        with watched(robot, _OVERLAP / rate, 1.0 / rate), _hold_at_the_end(robot):
            drive(robot, rules, stick, RateLoop(rate).ticks(), 1.0 / rate)


def drive(robot: RobotDriver, rules: Teleop, stick: Stick, ticks: Iterator[float], period: float) -> None:
    """Do what the stick says, one cycle a tick.

    Raises:
        HexwireError: The arm is out of reach; it was told to stop first.
    """
    from hexwire.model.state import JointTarget
    from hexwire.motion.safety import board_stop
    from hexwire.motion.teleop import Action

    said = ""
    last = robot.now()
    for _ in ticks:
        joints = robot.read()
        state, age = stick()
        now = robot.now()
        # Toward a board of the chapter a cycle takes longer than asked for.
        cycle, last = max(period, now - last), now
        axes, buttons = (state.axes, state.buttons) if state is not None else ((), 0)
        if joints.stopped:
            # Whoever stopped the arm, it is not for a stick to end that; nor to move on when it is ended.
            age = math.inf
        jog = rules.update(axes, buttons, age, joints.positions, now)
        try:
            if jog.action is Action.MOVE:
                # A joint that stands outside its limits stays where it is.
                inside = {name: angle for name, angle in jog.positions.items() if _allowed(robot, name, angle)}
                if inside:
                    robot.write(JointTarget.of(inside, _OVERLAP * cycle))
            elif jog.action is Action.HOLD:
                _hold(robot)
        except StoppedError:
            continue  # by somebody else, since it was read
        except DeviceError:
            robot.stop()
            raise
        found = board_stop(joints)
        words = f"stopped: {found}; 'hexwire resume' ends that" if found is not None else jog.note
        if words and words != said:
            note(words)
        said = words


def _allowed(robot: RobotDriver, name: str, angle: float) -> bool:
    joint = robot.model.joint(name)
    return joint.minimum <= angle <= joint.maximum


def _hold(robot: RobotDriver) -> None:
    """Make where the joints are now their target."""
    from hexwire.model.state import JointTarget

    state = robot.read()
    if state.stopped:
        return
    inside = {}
    for joint in state:
        limits = robot.model.joint(joint.name)
        if math.isfinite(joint.position):
            inside[joint.name] = max(limits.minimum, min(limits.maximum, joint.position))
    if inside:
        robot.write(JointTarget.of(inside, _SETTLE))


@contextmanager
def _hold_at_the_end(robot: RobotDriver) -> Iterator[None]:
    """Hold, whatever ends it; stop where that does not work."""
    try:
        yield
    finally:
        with shielded():
            try:
                _hold(robot)
            except HexwireError:
                robot.stop()


@contextmanager
def _stick(device: str | None, url: str | None, conf: str | None) -> Iterator[Stick]:
    """Open the stick that the options name."""
    if url is not None or conf is not None:
        from hexwire.joystick.channel import JoystickReceiver

        far = JoystickReceiver.from_url(url) if url is not None else JoystickReceiver.from_conf(str(conf))

        def newest() -> tuple[JoystickState | None, float]:
            far.poll()
            return far.state, far.age

        with far:
            yield newest
        return
    from hexwire.joystick.device import open_joystick

    with contextlib.closing(open_joystick(device)) as near:
        # What is plugged in here is either heard, or gone with an error.
        yield lambda: (near.read(), 0.0)
