"""`move`: joints to angles in degrees, and perhaps until they are there.

Owns what a person types as a target and how an arrival is judged. Must not know how a target is sent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import click

from .common import (
    FiniteFloat,
    RobotOptions,
    attached,
    joint_json,
    json_option,
    make_robot,
    on_terminal,
    raise_if_silent,
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
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState, JointTarget, SentTarget

__all__ = ["check_targets", "hold_on_ctrl_c", "move", "parse_targets"]

_RATE = 20.0
_LOOK = 0.1
"""Seconds between two looks that tell whether a joint stands."""
_FLICKER = math.radians(0.2)
"""Two counts: less is no motion."""
_AHEAD = 1.5
"""Steps that a target is sent ahead where the way is sent in steps, so that a late one is no pause."""
_GRACE = 2.0
"""Seconds that the joints get beyond the duration of the move: servos settle, and lag under load."""


@click.command()
@click.argument("targets", metavar="JOINT=DEGREES...", nargs=-1, required=True)
@click.option(
    "--duration",
    type=FiniteFloat("seconds", minimum=0),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Time the motion shall take; more if a speed limit asks for it.",
)
@click.option("--wait", is_flag=True, help="Wait until the joints have arrived; Ctrl-C stops the arm.")
@click.option(
    "--tolerance",
    type=FiniteFloat("degrees", above=0),
    default=1.0,
    show_default=True,
    metavar="DEGREES",
    help="With --wait, how near is there.",
)
@table_options
@links_option
@robot_options
@json_option
def move(
    targets: tuple[str, ...],
    duration: float,
    wait: bool,
    tolerance: float,
    table: float | None,
    links: str,
    options: RobotOptions,
    as_json: bool,
) -> None:
    """Move joints to angles in degrees, as J1=10 J3=-5.5.

    Joints without torque get it first, which moves nothing by itself. A way through the arm's gates or the table is
    refused, where the arm's geometry is known.

    With --wait the board stops the arm if this program dies or hangs for a second. Without it this program ends at
    once: the board takes the arm to the target on its own, and only 'hexwire stop' ends that earlier. A board of
    dialect 1 and a servo bus have no watchdog: there --wait sends the way in short steps, so that little of it is
    left to do if this program dies.
    """
    from hexwire.control.loop import RateLoop
    from hexwire.errors import ServoError
    from hexwire.model.geometry import kinematics_or_none
    from hexwire.model.state import JointTarget

    angles = parse_targets(targets)
    robot = make_robot(options)
    goal = check_targets(robot.model, angles)
    target = JointTarget.of(goal, duration)
    kinematics = kinematics_or_none(robot.model.name, links, for_motion=True)
    if kinematics is None:
        refuse_table(robot.model)
    tell: Callable[[str], object] = (lambda _: None) if as_json else say
    shortfall = ""

    def tell_sent(sent: SentTarget) -> None:
        words = "  ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in sent.positions)
        tell(f"moving to: {words} deg in {sent.duration:.2f} s")
        if sent.clamped:
            note(f"warning: the board's own limits moved the target of {', '.join(sent.clamped)}")

    with attached(robot), hold_on_ctrl_c(robot):
        switched_on = _torque_on(robot, list(goal), _check_way(robot, goal, kinematics, table))
        if switched_on:
            tell(f"torque on: {' '.join(switched_on)}")
        if wait:
            step = 1.0 / robot.command_rate
            with watched(robot, _AHEAD * step) as covered:
                sent = robot.write(target) if covered else _in_steps(robot, target, step, tell_sent)
                if covered:
                    tell_sent(sent)
                ticks = RateLoop(_RATE).ticks((sent.duration if covered else 0.0) + _GRACE)
                shortfall = _wait(robot, sent, math.radians(tolerance), ticks, draw=on_terminal() and not as_json)
        else:
            sent = robot.write(target)
            tell_sent(sent)
        if as_json:
            print_json(_as_json(robot, sent, switched_on, not shortfall if wait else None))
    raise_if_silent([(robot.model.joint(name).servo_id, name) for name in sent.silent])
    if shortfall:
        raise ServoError(shortfall)
    if wait:
        tell("arrived")


def parse_targets(words: Sequence[str]) -> list[tuple[str, float]]:
    """Take ``J1=10`` apart: pairs of name and degrees.

    Raises:
        UsageError: With everything that is wrong, on one line.
    """
    from hexwire.errors import UsageError

    targets, wrong = [], []
    for word in words:
        name, equals, text = word.partition("=")
        try:
            angle = float(text)
        except ValueError:
            angle = math.nan
        if not name or not equals or not math.isfinite(angle):
            wrong.append(repr(word))
        targets.append((name, angle))
    if wrong:
        raise UsageError(f"{', '.join(wrong)}: write a target as JOINT=DEGREES, as in J1=10 J3=-5.5")
    return targets


def check_targets(model: ArmModel, targets: Sequence[tuple[str, float]]) -> dict[str, float]:
    """Find the joints of targets in degrees.

    Returns:
        Radians by the arm's own joint names.

    Raises:
        UsageError: A joint does not exist, is named twice or would leave its limits; the text has all of it.
    """
    from hexwire.errors import LimitError, UsageError

    goal: dict[str, float] = {}
    wrong = []
    for name, angle in targets:
        if name.lower() not in (known.lower() for known in model.names):
            wrong.append(f"no joint {name!r} ({model.name} has {', '.join(model.names)})")
            continue
        joint = model.joint(name)
        if joint.name in goal:
            wrong.append(f"{joint.name} is named twice")
        goal[joint.name] = math.radians(angle)
        try:
            joint.check(goal[joint.name])
        except LimitError as error:
            wrong.append(str(error).partition(";")[0])
    if wrong:
        raise UsageError("; ".join([*wrong, "nothing was sent"]))
    return goal


@contextmanager
def hold_on_ctrl_c(robot: RobotDriver) -> Iterator[None]:
    """Stop the arm, holding, when the program is interrupted."""
    from hexwire.errors import HexwireError

    try:
        yield
    except KeyboardInterrupt:
        with shielded():
            try:
                robot.stop()
            except HexwireError as error:
                note(f"warning: the arm could not be stopped: {error}")
            else:
                kept = robot.stop_kept_by
                note("stopped: the arm holds" + ("; 'hexwire resume' ends that" if kept else ""))
        raise


def _check_way(
    robot: RobotDriver, goal: Mapping[str, float], kinematics: KinematicModel | None, table: float | None
) -> JointState:
    """Refuse a way through gates or table; returns where the joints are.

    Raises:
        LimitError: Nothing was sent.
        UsageError: Other joints are still under way, so that nobody can say where the arm will be.
    """
    from hexwire.control.loop import RateLoop
    from hexwire.errors import UsageError
    from hexwire.motion.checks import check_move

    if kinematics is None or goal.keys().isdisjoint(kinematics.joint_names):
        return robot.read()
    looks = [robot.read() for _ in RateLoop(1.0 / _LOOK).ticks(1.5 * _LOOK)]
    if len(looks) < 2:
        # One has taken so long, as with a board of dialect 1.
        looks.append(robot.read())
    state = looks[-1]
    unknown = [name for name in kinematics.joint_names if not math.isfinite(state[name].position)]
    if unknown:
        # One that is to be moved is an error of its own.
        if others := [name for name in unknown if name not in goal]:
            note(f"warning: it is not known where {', '.join(others)} is: gates and table are not checked")
        return state
    turned = [
        name
        for name in kinematics.joint_names
        if name not in goal and not abs(state[name].position - looks[0][name].position) <= _FLICKER
    ]
    if turned:
        words = f"still turning: {', '.join(turned)}; wait until the arm stands, or name all in one move"
        raise UsageError(f"{words}; nothing was sent")
    check_move(state.positions, goal, kinematics, table)
    return state


def _torque_on(robot: RobotDriver, names: Sequence[str], state: JointState) -> tuple[str, ...]:
    """Give torque to those of the joints that have none; returns their names."""
    missing = [name for name in names if name not in state.torque_on]
    if not missing:
        return ()
    confirmed = robot.torque(True, missing)
    raise_if_silent([(robot.model.joint(name).servo_id, name) for name in missing if name not in confirmed])
    return confirmed


def _in_steps(
    robot: RobotDriver, target: JointTarget, step: float, tell: Callable[[SentTarget], object]
) -> SentTarget:
    """Lead joints to a target by short ways on the straight line; returns when the last is sent.

    Args:
        robot: Attached.
        target: Where to.
        step: Seconds between two ways.
        tell: Told what will be sent before the first is.
    """
    from hexwire.control.loop import RateLoop
    from hexwire.model.state import JointTarget, SentTarget
    from hexwire.motion.limits import check_target

    start = robot.read().positions
    checked = check_target(robot.model, target, start)
    goal, duration = dict(checked.positions), checked.duration
    tell(SentTarget(checked.positions, duration))
    # Nobody can lead a joint from where it is not known to be: it is sent to its end.
    start = {name: start[name] if math.isfinite(start[name]) else goal[name] for name in goal}
    silent: dict[str, None] = {}
    for t in RateLoop(1.0 / step).ticks(duration):
        share = min(1.0, (t + step) / duration) if duration > 0 else 1.0
        place = {name: start[name] + share * (goal[name] - start[name]) for name in goal}
        sent = robot.write(JointTarget.of(place, _AHEAD * step))
        silent |= dict.fromkeys(sent.silent)
    sent = robot.write(JointTarget.of(goal, step))
    return SentTarget(sent.positions, duration, sent.clamped, tuple(silent | dict.fromkeys(sent.silent)))


def _wait(robot: RobotDriver, sent: SentTarget, tolerance: float, ticks: Iterable[float], *, draw: bool) -> str:
    """Wait until the joints are there; returns why they are not, or nothing."""
    from hexwire.motion.safety import board_stop

    goal = dict(sent.positions)
    way = 0.0
    state: JointState | None = None
    with _progress() if draw else nullcontext(lambda *_: None) as show:
        for _ in ticks:
            state = robot.read()
            left = state.distances(goal)
            farthest = max(left, key=lambda name: left[name])
            way = max(way, left[farthest])
            show(
                0.0 if way == math.inf else 1.0 - left[farthest] / way if way else 1.0,
                f"{farthest} {math.degrees(left[farthest]):.1f} deg to go",
            )
            if left[farthest] <= tolerance:
                return ""
            found = board_stop(state)
            if found is not None:
                return f"the arm was stopped before it arrived: {found}; 'hexwire resume' ends that"
            limp = [name for name in goal if name not in state.torque_on]
            if limp:
                return f"{', '.join(limp)} lost the torque before it arrived"
    if state is None:
        return "there was no time to arrive in"
    return _shortfall(state, goal, tolerance, sent.duration + _GRACE)


def _shortfall(state: JointState, goal: dict[str, float], tolerance: float, seconds: float) -> str:
    from .state import condition

    parts = []
    for name, way in state.distances(goal).items():
        if way > tolerance:
            why = condition(state[name])
            where = (
                f"{name} is {math.degrees(way):.1f} deg away" if way < math.inf else f"{name} is nobody knows where"
            )
            parts.append(where + ("" if why == "ok" else f" ({why})"))
    return f"not arrived after {seconds:.1f} s: {', '.join(parts)}"


@contextmanager
def _progress() -> Iterator[Callable[[float, str], None]]:
    from .draw import progress

    with progress() as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, text: bar.update(task, completed=share, description=text)


def _as_json(
    robot: RobotDriver, sent: SentTarget, switched_on: tuple[str, ...], arrived: bool | None
) -> dict[str, object]:
    return {
        "sent": [
            {"name": name, "position_rad": angle, "position_deg": math.degrees(angle)}
            for name, angle in sent.positions
        ],
        "duration_s": sent.duration,
        "torque_switched_on": switched_on,
        "clamped": sent.clamped,
        "silent": sent.silent,
        "arrived": arrived,
        "joints": None if arrived is None else [joint_json(joint, robot.model) for joint in robot.read()],
    }
