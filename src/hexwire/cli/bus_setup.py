"""The `bus` commands that set servos up: ids, rates, the middle, stored settings, recovery, a new arm.

Owns the questions asked before something is changed, and the picture on the terminal. Must not know how a step is
made safe, nor which servo of an arm is next: `hexwire.bus.setup` and `hexwire.control` do.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import ServoError, UsageError
from hexwire.new_file import OutputFile

from .bus import BusOptions, bus_options, known_servo, open_bus, refuse_if_stopped, search_bar, taken_now
from .exits import note, shielded
from .options import confirm, force_option, json_option
from .output import Column, RowType, answer, print_json, say, wants_json

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.setup.arm_setup import ArmSetup, SetupStep

__all__ = ["set_baud", "set_id", "setup"]

_ID = click.IntRange(0, 253)
_YES = click.option("--yes", is_flag=True, help="Do not ask.")


@contextmanager
def _changing(options: BusOptions, servo_id: int, what: str, becomes: str, yes: bool) -> Iterator[ServoBus]:
    """The bus, once somebody has confirmed that a stored setting of a servo is changed.

    Args:
        options: Which bus.
        servo_id: The servo.
        what: The setting, for the refusal if the arm is stopped.
        becomes: What changes, for the question.
        yes: Do not ask.
    """
    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        refuse_if_stopped(opened, what)
        confirm(f"{becomes}. Continue?", yes)
        yield opened


@click.command("set-id")
@click.argument("old", type=_ID)
@click.argument("new", type=_ID)
@_YES
@bus_options
@json_option
def set_id(old: int, new: int, yes: bool, options: BusOptions) -> None:
    """Change the id of a servo. Refused if the new id is in use or two servos share the old one."""
    from hexwire.bus import setup as servo_setup

    with _changing(options, old, "an id", f"Servo {old} becomes servo {new}", yes) as opened:
        info = servo_setup.set_id(opened, old, new)
    answer({"old_id": old, "id": info.servo_id}, f"servo {old} is now servo {info.servo_id}, and answers")


@click.command("set-baud")
@click.argument("servo_id", type=_ID, metavar="ID")
@click.argument("rate", type=click.IntRange(min=1))
@_YES
@bus_options
@json_option
def set_baud(servo_id: int, rate: int, yes: bool, options: BusOptions) -> None:
    """Change the line rate of a servo; undone if it does not answer at the new rate."""
    from hexwire.bus import setup as servo_setup

    becomes = f"Servo {servo_id} will answer at {rate} baud only"
    with _changing(options, servo_id, "a line rate", becomes, yes) as opened:
        servo_setup.set_baud(opened, servo_id, rate)
    words = f"servo {servo_id} answers at {rate} baud; use --baud {rate} from now on"
    answer({"id": servo_id, "baud": rate}, words)


@click.command()
@click.argument("servo_id", type=_ID, metavar="ID")
@_YES
@bus_options
@json_option
def center(servo_id: int, yes: bool, options: BusOptions) -> None:
    """Make the present position of a servo its middle. Nothing moves; its torque must be off."""
    from hexwire.bus import setup as servo_setup

    becomes = f"The present position of servo {servo_id} becomes its middle"
    with _changing(options, servo_id, "a middle", becomes, yes) as opened:
        position = servo_setup.center(opened, servo_id)
    answer({"id": servo_id, "raw": position}, f"servo {servo_id} now reports {position} at this position")


class _Recovered(NamedTuple):
    id: int
    faults: tuple[str, ...]
    torque_on: bool = False


_RECOVERED: RowType[_Recovered] = RowType(
    *map(Column, _Recovered._fields),
    words=lambda row: f"servo {row.id}: {', '.join(row.faults) or 'ok'}, torque off",
)


@click.command()
@click.argument("ids")
@bus_options
@json_option
def recover(ids: str, options: BusOptions) -> None:
    """Reset the overload protection of servos: torque off, wait until the fault is gone. Hold the arm!"""
    from hexwire.bus import setup as servo_setup

    def recovered(opened: ServoBus, servo_id: int) -> _Recovered:
        known_servo(opened, servo_id, options)
        return _Recovered(servo_id, servo_setup.recover(opened, servo_id))

    with open_bus(options) as opened:
        rows = _RECOVERED.tell(recovered(opened, servo_id) for servo_id in parse_ids(ids))
    left = [row.id for row in rows if row.faults]
    if left:
        raise ServoError(f"faults remain on {', '.join(map(str, left))}: remove the cause and try again")


@click.command()
@click.argument("ids")
@click.argument("file", type=click.Path(dir_okay=False))
@force_option
@bus_options
@json_option
def backup(ids: str, file: str, force: bool, options: BusOptions) -> None:
    """Save the stored settings of servos to a file."""
    from hexwire.bus.backup import serialize_backups, take_backup

    wanted = parse_ids(ids)
    with OutputFile(file, force=force) as out:
        with open_bus(options) as opened:
            rows = [take_backup(opened, servo_id, taken=taken_now()) for servo_id in wanted]
        out.file.write(serialize_backups(rows).encode())
    words = f"{len(rows)} servo{'s' if len(rows) != 1 else ''} saved to {file}"
    answer({"file": file, "ids": [row.servo_id for row in rows]}, words)


class _Restored(NamedTuple):
    id: int
    changed: list[str]


_RESTORED: RowType[_Restored] = RowType(
    *map(Column, _Restored._fields),
    words=lambda row: f"servo {row.id}: {', '.join(row.changed) or 'nothing to change'}",
)


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option("--ids", metavar="IDS", help="Only these servos of the file.")
@_YES
@bus_options
@json_option
def restore(file: str, ids: str | None, yes: bool, options: BusOptions) -> None:
    """Restore saved settings, except id and line rate, and verify them."""
    from hexwire.bus.backup import load_backup, restore_backup

    rows = load_backup(file)
    wanted = None if ids is None else parse_ids(ids)
    chosen = [row for row in rows if wanted is None or row.servo_id in wanted]
    if not chosen:
        raise UsageError(
            f"{file} does not contain these servos; it has {', '.join(str(row.servo_id) for row in rows) or 'none'}"
        )
    with open_bus(options) as opened:
        refuse_if_stopped(opened, "a setting")
        names = ", ".join(str(row.servo_id) for row in chosen)
        confirm(f"Settings of servo {names} will be overwritten. Continue?", yes)
        _RESTORED.tell(_Restored(row.servo_id, restore_backup(opened, row.servo_id, row)) for row in chosen)


class _Difference(NamedTuple):
    id: int
    register: str
    servo: int | None
    file: int | None


_DIFFERENCES: RowType[_Difference] = RowType(*(Column(name, name) for name in _Difference._fields), keys=2)


@click.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@bus_options
@json_option
def diff(file: str, options: BusOptions) -> None:
    """Compare servos with their saved settings. Exit status 1 if they differ."""
    from hexwire.bus.backup import compare, load_backup, take_backup

    rows = []
    with open_bus(options) as opened:
        for saved in load_backup(file):
            now = take_backup(opened, saved.servo_id)
            rows += [_Difference(saved.servo_id, *found) for found in compare(now, saved)]
    if rows or wants_json():
        _DIFFERENCES.show(rows)
    if not rows:
        say("no differences")
        return
    several = len(rows) > 1
    raise ServoError(f"{f'{len(rows)} settings differ' if several else 'one setting differs'} from {file}")


@click.command()
@click.argument("robot")
@click.option("--leader", is_flag=True, help="A leader arm: its servos have other gears.")
@click.option("--follower", is_flag=True, help="A follower arm.")
@click.option("--joint", metavar="NAME", help="Only this joint, as after a repair: connect its servo alone.")
@click.option("--yes", is_flag=True, help="Do not ask before a change; servos must still be connected by hand.")
@bus_options
@json_option
def setup(
    robot: str,
    leader: bool,
    follower: bool,
    joint: str | None,
    yes: bool,
    options: BusOptions,
) -> None:
    """Give every servo of ROBOT (so101, so100, or a TOML file) its id and line rate, one at a time.

    Shows which servo to connect, alone or added to those that are set up already. Each servo is identified, checked
    (model, firmware, voltage class, supply), changed and read back. Press Enter after connecting a servo; `all`
    searches every id at every rate, `q` ends it.

    It can be ended and repeated at any time: what is set up is found by asking the servos. Nothing moves.
    """
    from hexwire.drivers.registry import load_bus_arm
    from hexwire.setup.arm_setup import ArmSetup

    if leader and follower:
        raise UsageError("--leader and --follower contradict each other: the arm is one of them")
    described = load_bus_arm(robot).described()
    plan = ArmSetup(described.model, described.baud, leader=leader if leader or follower else None, only=joint)
    if options.series:
        raise UsageError("--series does not apply: the servos are asked")
    with open_bus(options) as opened:
        refuse_if_stopped(opened, "an id")
        complete = _run_steps(opened, plan, yes)
        for remark in plan.remarks:
            note(f"warning: {remark}")
    if wants_json():
        print_json([_joint_json(plan, row.name) for row in plan.order])
    if not complete:
        left = [row.name for row in plan.order if row.name not in plan.done]
        raise ServoError(f"not finished: {', '.join(left) or 'the servos were not checked together'}")
    say(f"{plan.only.name if plan.only else robot} is set up; next: `hexwire bus calibrate {robot}`")


def _joint_json(plan: ArmSetup, name: str) -> dict[str, object]:
    info = plan.done.get(name)
    row: dict[str, object] = {"joint": name, "id": plan.model.joint(name).servo_id, "done": info is not None}
    return row if info is None else row | {"model": info.model_name, "firmware": info.firmware}


def _run_steps(opened: ServoBus, plan: ArmSetup, yes: bool) -> bool:
    """Go through the steps; returns whether all are done."""
    from hexwire.setup.arm_setup import StepKind

    _look(opened, plan)
    drawn = None
    while True:
        step = plan.step
        if step.kind is StepKind.DONE:
            return True
        # A servo that is connected already: which one it should be is seen before the question.
        if step.kind is StepKind.CONNECT or (step.kind is StepKind.ASSIGN and drawn != step.joint):
            _draw(plan)
            drawn = plan.target
        if step.kind is not StepKind.ASSIGN:
            note(step.text)
            answer = _ask("then press Enter (all: search every id and rate; q: end)")
        else:
            answer = _assign(opened, plan, step, yes)
        if answer == "q":
            return False
        _look(opened, plan, everywhere=answer == "all")


def _look(opened: ServoBus, plan: ArmSetup, *, everywhere: bool = False) -> None:
    from hexwire.setup.setting_up import look

    before = dict(plan.done)
    with search_bar(None) as progress:
        look(opened, plan, everywhere=everywhere, progress=progress)
    for name, info in plan.done.items():
        if name not in before:
            note(f"{name} is set up: servo {plan.model.joint(name).servo_id}, {info.model_name} {info.firmware}")


def _draw(plan: ArmSetup) -> None:
    from hexwire.setup.arm_setup import picture

    for line in ("", *picture(plan), ""):
        note(line)


def _assign(opened: ServoBus, plan: ArmSetup, step: SetupStep, yes: bool) -> str:
    """Change one servo; returns what was typed."""
    from hexwire.setup.setting_up import assign

    note(f"found {step.servo}")
    if step.warning:
        note(f"warning: {step.warning}")
    if step.blocked:
        return _ask(f"{step.blocked}. It is not changed; press Enter to look again")
    # A warning is worth an answer, whatever the options say.
    if not yes or step.warning:
        answer = _ask(f"{step.text}. Right? [y/n/q]")
        if answer not in ("y", "yes"):
            return answer if answer == "q" else _ask("unplug it, connect the right one, then press Enter")
    try:
        with shielded():
            assign(opened, plan, step, tell=note)
    except ServoError as error:
        note(f"error: {error}")
        return _ask("press Enter to look for it again")
    return ""


def _ask(question: str) -> str:
    """Ask on standard error; returns the answer in small letters.

    Raises:
        UsageError: There is nobody to answer.
    """
    note(question)
    line = sys.stdin.readline()
    if not line:
        raise UsageError("a set-up needs somebody at the arm who connects the servos: the input has ended")
    return line.strip().lower()
