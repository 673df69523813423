"""`bus setup`: gives the servos of a new arm their ids and rates, one at a time.

Owns the questions and the picture on the terminal. Must not know which servo is next: `hexwire.control` does.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from hexwire.errors import ServoError, UsageError

from .bus_group import BusOptions, bus, bus_options, open_bus, refuse_if_stopped
from .common import json_option, on_terminal
from .exits import note, shielded
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.control.arm_setup import ArmSetup, SetupStep

__all__ = ["setup"]


@bus.command()
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
    as_json: bool,
) -> None:
    """Give every servo of ROBOT (so101, so100, or a TOML file) its id and line rate, one at a time.

    Shows which servo to connect, alone or added to those that are set up already. Each servo is identified, checked
    (model, firmware, voltage class, supply), changed and read back. Press Enter after connecting a servo; `all`
    searches every id at every rate, `q` ends it.

    It can be ended and repeated at any time: what is set up is found by asking the servos. Nothing moves.
    """
    from hexwire.control.arm_setup import ArmSetup
    from hexwire.drivers.registry import load_bus_arm

    if leader and follower:
        raise UsageError("--leader and --follower contradict each other: the arm is one of them")
    described = load_bus_arm(robot).described()
    plan = ArmSetup(described.model, described.baud, leader=leader if leader or follower else None, only=joint)
    if options.series:
        raise UsageError("--series does not apply: the servos are asked")
    with open_bus(options) as opened:
        refuse_if_stopped(opened, "an id")
        complete = _run(opened, plan, yes)
        for remark in plan.remarks:
            note(f"warning: {remark}")
    if as_json:
        print_json([_json(plan, row.name) for row in plan.order])
    if not complete:
        left = [row.name for row in plan.order if row.name not in plan.done]
        raise ServoError(f"not finished: {', '.join(left) or 'the servos were not checked together'}")
    if not as_json:
        say(f"{plan.only.name if plan.only else robot} is set up; next: `hexwire bus calibrate {robot}`")


def _json(plan: ArmSetup, name: str) -> dict[str, object]:
    info = plan.done.get(name)
    row: dict[str, object] = {"joint": name, "id": plan.model.joint(name).servo_id, "done": info is not None}
    return row if info is None else row | {"model": info.model_name, "firmware": info.firmware}


def _run(opened: ServoBus, plan: ArmSetup, yes: bool) -> bool:
    """Go through the steps; returns whether all are done."""
    from hexwire.control.arm_setup import StepKind

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
    from hexwire.control.setting_up import look

    before = dict(plan.done)
    if not on_terminal():
        look(opened, plan, everywhere=everywhere)
    else:
        from .draw import progress

        with progress() as bar:
            task = bar.add_task("looking", total=None)

            def show(baud: int, servo_id: int, found: int) -> None:
                bar.update(task, description=f"{baud} baud, id {servo_id}")

            look(opened, plan, everywhere=everywhere, progress=show)
    for name, info in plan.done.items():
        if name not in before:
            note(f"{name} is set up: servo {plan.model.joint(name).servo_id}, {info.model_name} {info.firmware}")


def _draw(plan: ArmSetup) -> None:
    from hexwire.control.arm_setup import picture

    for line in ("", *picture(plan), ""):
        note(line)


def _assign(opened: ServoBus, plan: ArmSetup, step: SetupStep, yes: bool) -> str:
    """Change one servo; returns what was typed."""
    from hexwire.control.setting_up import assign

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
