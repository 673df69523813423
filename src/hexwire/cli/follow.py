"""`follow`: arms that follow others, which are moved by hand.

Owns the command line. Must not know how a follower follows.
"""

from __future__ import annotations

import re
from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from hexwire.errors import UsageError

from .common import RobotOptions, attached, make_robot, refuse_idle_table, robot_at_port, table_options
from .exits import note, shielded
from .numbers import number_option

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hexwire.control.path_check import PathCheck
    from hexwire.drivers.base import RobotDriver
    from hexwire.motion.following import Following

__all__ = ["follow"]

_FACING = ("shoulder_pan", "wrist_roll", "J1", "J4", "J6")
"""Joints that turn the other way when two arms face each other."""


@click.command()
@click.argument("arms", metavar="LEADER FOLLOWER [LEADER FOLLOWER]...", nargs=-1, required=True)
@click.option("--robot", metavar="NAME", help="Type of the arms on servo buses, such as so101.")
@number_option("--rate", "HZ", "Cycles per second.", above=0, default=100.0)
@click.option("--mirror", is_flag=True, help="The arms face each other: base and wrist turn the other way.")
@number_option("--meet", "SHARE", "Fraction of the speed limits until it has met the leader.", above=0, default=0.2)
@number_option(
    "--grip", "PERCENT", "Load at which the gripper stops closing; 100 for no limit.", above=0, default=35.0
)
@table_options
def follow(
    arms: tuple[str, ...],
    robot: str | None,
    rate: float,
    mirror: bool,
    meet: float,
    grip: float,
    table: float | None,
) -> None:
    """Let FOLLOWER move as LEADER, which is moved by hand; several pairs at once.

    An arm is a port, or ROBOT@PORT with a type or the file of a calibrated arm, as in left.toml@/dev/ttyACM0. An
    address of a shared arm, such as zenoh:lab/arm1, does for both. The leader has no torque: hold it. The follower
    first meets it slowly. It holds when the leader falls silent, and at the end.
    """
    from hexwire.control.following import Pair, run_following
    from hexwire.control.path_check import PathCheck
    from hexwire.drivers.registry import is_address

    context = click.get_current_context()
    if context.find_root().params.get("port"):
        raise UsageError("--port is for commands with one arm; name the ports as LEADER and FOLLOWER")
    robot = robot or context.find_root().params.get("robot")
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
    with ExitStack() as stack:
        pairs = []
        for place in range(0, len(made), 2):
            leader, follower = made[place], made[place + 1]
            refuse_idle_table(follower)
            check = PathCheck.of(follower, table)
            rules = _rules(leader, follower, mirror, meet, grip / 100, check)
            ahead = is_address(leader.url)
            pairs.append(Pair(leader, follower, rules, _teller(arms[place + 1], len(made) > 2), ahead, check))
        for driver in made:
            stack.enter_context(attached(driver))

        def announce() -> None:
            for pair, leader, follower in zip(pairs, arms[::2], arms[1::2], strict=True):
                note(f"{follower} follows {leader}; Ctrl-C ends it, and it holds")
                if not pair.follower.has_own_watchdog and not is_address(pair.follower.url):
                    note(
                        f"warning: nothing stops {follower} if this program dies: its servos go to their last "
                        "set-point and hold there"
                    )

        run_following(pairs, rate, on_ready=announce, shield=shielded)


def _make(text: str, robot: str | None, *, observed: bool) -> RobotDriver:
    """The driver for ``PORT`` or ``ROBOT@PORT``."""
    name, at, port = text.rpartition("@")
    # An @ may also be part of an address.
    if not at or "/" in name.removesuffix(".toml").rpartition(":")[0] or "://" in name:
        name, port = "", text
    return make_robot(RobotOptions(port, name or robot or robot_at_port(port), None, None, None, observed=observed))


def _tell_apart(followers: Sequence[RobotDriver]) -> None:
    """Give each follower a name of its own in a recording: that of a shared arm, or of its arm file or type."""
    from .recording import record_as

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


def _rules(
    leader: RobotDriver, follower: RobotDriver, mirror: bool, meet: float, force: float, check: PathCheck
) -> Following:
    from hexwire.model.gripper import jaws_of
    from hexwire.motion.following import Following, GripForce

    model = follower.model
    jaws = jaws_of(model)
    return Following(
        leader.model,
        model,
        mirror=frozenset(name for name in _FACING if name in model.names) if mirror else frozenset(),
        share=meet,
        grip=None if jaws is None or force >= 1.0 else GripForce(jaws, force),
        check=check.posture,
    )


def _teller(follower: str, several: bool) -> Callable[[object], None]:
    def tell(said: object) -> None:
        text = said if isinstance(said, str) else f"stopped: {said}; end this, then 'hexwire resume'"
        note(f"{follower}: {text}" if several else text)

    return tell
