"""`joystick` and `teleop`: move an arm with a joystick on this machine or on another.

Owns the choice of the joystick. Must not know how a joystick moves an arm.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

from .common import RobotOptions, attached, json_option, refuse_idle_table, robot_options, table_options
from .exits import note, shielded
from .model import links_option, make_robot_with
from .move import unwatched_note
from .numbers import number_option
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.control.teleop import Stick

__all__ = ["joystick", "teleop"]


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
@click.option("--to", "url", metavar="URL", help="Destination, such as udp://192.168.1.20:15040.")
@click.option("--conf", metavar="FILE", help="The file with the channel of JOY_STICK, instead of --to.")
@number_option("--rate", "HZ", "Messages per second.", above=0, default=50.0)
def send(device: str | None, url: str | None, conf: str | None, rate: float) -> None:
    """Send the state of a joystick over a channel repeatedly, until interrupted."""
    from hexwire.control.loop import RateLoop
    from hexwire.joystick.channel import JoystickSender
    from hexwire.joystick.device import open_joystick

    if (url is None) == (conf is None):
        raise UsageError("name the destination with --to URL or --conf FILE")
    sender = JoystickSender.from_url(url) if url is not None else JoystickSender.from_conf(str(conf))
    with contextlib.closing(open_joystick(device)) as stick, sender:
        note(f"sending {stick.path} to {sender.session.ipc.link.url}; Ctrl-C ends it")
        for _ in RateLoop(rate).ticks():
            sender.send(stick.read())


@click.command()
@click.option("--device", metavar="PATH", help="A joystick of this machine.")
@click.option("--from", "url", metavar="URL", help="Receive from a channel, such as udp-listen://127.0.0.1:15040.")
@click.option("--conf", metavar="FILE", help="The file with that channel, instead of --from.")
@click.option(
    "--mode", type=click.Choice(["joint", "cartesian"]), default="joint", show_default=True, help="Initial mode."
)
@number_option("--speed", "SHARE", "Fraction of the joints' speed limits at full deflection.", above=0, default=0.3)
@number_option("--rate", "HZ", "Cycles per second.", above=0, default=20.0)
@click.option(
    "--dead-man",
    type=click.IntRange(0, 31),
    default=4,
    show_default=True,
    metavar="N",
    help="Number of the dead-man button.",
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
    """Move an arm by joystick while the dead-man button is held.

    The arm brakes when the button is released or the joystick's channel is lost, and makes no step after which it
    could not brake before a joint coupling limit or the table. Button 7 switches between joint and cartesian
    mode; buttons 0 and 1 close and open the gripper. Without --device, --from or --conf, the only joystick of this
    machine is used. If the board has a watchdog, it stops the arm when this program dies.
    """
    from hexwire.control.guided import OVERLAP
    from hexwire.control.path_check import PathCheck
    from hexwire.control.teleop import TeleopController, run_teleop
    from hexwire.motion.teleop import JogMode, StickMap, Teleop

    if sum(option is not None for option in (device, url, conf)) > 1:
        raise UsageError("give only one of --device, --from and --conf")
    if speed > 1.0:
        raise UsageError(f"--speed {speed:g} exceeds the joints' speed limits; give at most 1")
    robot = make_robot_with(links, options)
    refuse_idle_table(robot)
    model, check = robot.model, PathCheck.of(robot, table)
    rules = Teleop(
        model,
        robot.kinematics,
        StickMap(dead_man=dead_man),
        mode=JogMode(mode),
        share=speed,
        check=check.posture,
    )
    with _stick(device, url, conf) as stick, attached(robot):
        controller = TeleopController(rules, stick, 1.0 / rate, _tell)

        def announce() -> None:
            note(f"hold button {dead_man} to move {model.name}, {mode} jog; Ctrl-C ends it")
            if not robot.has_own_watchdog:
                unwatched_note(robot, OVERLAP / rate)

        run_teleop(robot, controller, rate, check=check, on_ready=announce, shield=shielded)


def _tell(said: object) -> None:
    note(said if isinstance(said, str) else f"stopped: {said}; clear it with 'hexwire resume'")


@contextmanager
def _stick(device: str | None, url: str | None, conf: str | None) -> Iterator[Stick]:
    """Open the joystick that the options name."""
    if url is not None or conf is not None:
        from hexwire.joystick.channel import JoystickReceiver

        far = JoystickReceiver.from_url(url) if url is not None else JoystickReceiver.from_conf(str(conf))

        def newest() -> tuple[Sequence[float], int, float]:
            far.poll()
            return (far.state.axes, far.state.buttons, far.age) if far.state is not None else ((), 0, far.age)

        with far:
            yield newest
        return
    from hexwire.joystick.device import open_joystick

    def now() -> tuple[Sequence[float], int, float]:
        # A local joystick that is unplugged raises an error, so its state is never old.
        state = near.read()
        return state.axes, state.buttons, 0.0

    with contextlib.closing(open_joystick(device)) as near:
        yield now
