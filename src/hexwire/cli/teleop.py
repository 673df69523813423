"""`joystick`, `teleop` and `follow`: arms that a person moves, by a joystick or by another arm.

Owns the command lines and the choice of the joystick.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

from .exits import note, shielded
from .options import (
    RobotOptions,
    attached,
    early_robot,
    json_option,
    links_option,
    make_robot,
    make_robot_with,
    number_option,
    refuse_idle_table,
    robot_at_port,
    robot_options,
    table_options,
)
from .output import answer, say, wants_json

if TYPE_CHECKING:
    from hexwire.arm.handle import Handle
    from hexwire.control.motion.teleop import Stick
    from hexwire.drivers.base import RobotDriver

__all__ = ["follow", "joystick", "teleop"]

_LOOK = 0.05
"""Seconds between two looks whether a pair has ended."""


@click.group()
def joystick() -> None:
    """Read a joystick, or send it over a channel."""


@joystick.command("list")
@json_option
def list_() -> None:
    """List the joysticks of this machine."""
    from hexwire.joystick.device import find_joysticks

    found = [str(path) for path in find_joysticks()]
    if found or wants_json():
        answer(found, *found)
    else:
        note("no joystick is plugged in, or this user may not read /dev/input")


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
    from hexwire.control.loop.loop import RateLoop
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
    from hexwire.control.motion.motion_options import unwatched_words
    from hexwire.control.motion.operator_control import OVERLAP
    from hexwire.control.motion.path_check import PathCheck
    from hexwire.control.motion.teleop import TeleopController, run_teleop
    from hexwire.drivers.abilities import OwnWatchdog
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
        check=check.guided(),
    )
    with _stick(device, url, conf) as stick, attached(robot):
        controller = TeleopController(rules, stick, 1.0 / rate, _tell)

        def announce() -> None:
            note(f"hold button {dead_man} to move {model.name}, {mode} jog; Ctrl-C ends it")
            if not robot.can(OwnWatchdog):
                note(f"note: {unwatched_words(robot, OVERLAP / rate)}")

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


@click.command()
@click.argument("arms", metavar="LEADER FOLLOWER [LEADER FOLLOWER]...", nargs=-1, required=True)
@click.option("--robot", metavar="NAME", help="Type of the arms on servo buses, such as so101.")
@number_option("--rate", "HZ", "Cycles per second.", above=0, default=100.0)
@click.option("--mirror", is_flag=True, help="The arms face each other: base and wrist turn the other way.")
@number_option("--meet", "SHARE", "Fraction of the speed limits until it has met the leader.", above=0, default=0.2)
@number_option(
    "--grip", "PERCENT", "Load at which the gripper stops closing; 100 for no limit.", above=0, default=35.0
)
@number_option("--max-speed", "DEG/S", "Most speed of a joint; else that of its servo without a load.", above=0)
@number_option("--max-acceleration", "DEG/S2", "Most acceleration of a joint; else that of its servo.", above=0)
@table_options
def follow(
    arms: tuple[str, ...],
    robot: str | None,
    rate: float,
    mirror: bool,
    meet: float,
    grip: float,
    max_speed: float | None,
    max_acceleration: float | None,
    table: float | None,
) -> None:
    """Let FOLLOWER move as LEADER, which is moved by hand; several pairs at once.

    An arm is a port, or ROBOT@PORT with a type or the file of a calibrated arm, as in left.toml@/dev/ttyACM0. An
    address of a shared arm, such as zenoh:lab/arm1, does for both. The leader has no torque: hold it. The follower
    first meets it slowly. It holds when the leader falls silent, and at the end.
    """
    from hexwire.arm.front import Front
    from hexwire.arm.handle import end_all
    from hexwire.arm.verbs import Arm

    from .verbs import FollowTeller

    if click.get_current_context().find_root().params.get("port"):
        raise UsageError("--port is for commands with one arm; name the ports as LEADER and FOLLOWER")
    robot = early_robot(robot)
    if len(arms) % 2:
        raise UsageError("give a LEADER and a FOLLOWER for each pair")
    if len(set(arms)) < len(arms):
        raise UsageError("an arm is named twice")
    for share, name in ((meet, "--meet"), (grip / 100, "--grip")):
        if share > 1.0:
            raise UsageError(f"{name} must be at most {'1' if name == '--meet' else '100'}")
    # Joints of the same names: a recording shows those of the follower.
    made = [_make(text, robot, observed=bool(place % 2)) for place, text in enumerate(arms)]
    # so101@PORT and PORT are one arm: it would follow itself.
    if len({driver.url for driver in made}) < len(made):
        raise UsageError("an arm is named twice")
    if len(made) > 2:
        _tell_apart(made[1::2])
    for follower in made[1::2]:
        refuse_idle_table(follower)
    with ExitStack() as stack:
        for driver in made:
            stack.enter_context(attached(driver))
        handles: list[Handle[None]] = []
        try:
            for place in range(0, len(made), 2):
                leader, follower = made[place : place + 2]
                told = FollowTeller(follower, *arms[place : place + 2], several=len(made) > 2)
                handle = Arm(follower, table=table, front=Front(told)).follow(
                    Arm(leader, front=Front()),
                    mirror=mirror,
                    meet=meet,
                    force=grip / 100,
                    max_speed=None if max_speed is None else math.radians(max_speed),
                    max_acceleration=None if max_acceleration is None else math.radians(max_acceleration),
                    rate=rate,
                    wait=False,
                )
                handles.append(handle)
            while not any(handle.done for handle in handles):
                time.sleep(_LOOK)
        finally:
            # They end together, whatever ends one.
            with shielded():
                end_all(handles)
        for handle in handles:
            handle.wait()


def _make(text: str, robot: str | None, *, observed: bool) -> RobotDriver:
    """The driver for ``PORT`` or ``ROBOT@PORT``."""
    name, at, port = text.rpartition("@")
    # An @ may also be part of an address.
    if not at or "/" in name.removesuffix(".toml").rpartition(":")[0] or "://" in name:
        name, port = "", text
    return make_robot(RobotOptions(port, name or robot or robot_at_port(port), None, None, None, observed=observed))


def _tell_apart(followers: Sequence[RobotDriver]) -> None:
    """Give each follower a name of its own in a recording: that of a shared arm, or of its arm file or type."""
    from .record import record_as

    taken: set[str] = set()
    for driver in followers:
        shared = driver.url.startswith("zenoh:")
        full = driver.url.removeprefix("zenoh:").partition("?")[0] if shared else driver.model.name
        # Letters that ROS allows, too.
        name = first = re.sub(r"[^A-Za-z0-9_/]", "_", full)
        number = 1
        while name in taken:
            number += 1
            name = f"{first}_{number}"
        taken.add(name)
        record_as(driver, name)
