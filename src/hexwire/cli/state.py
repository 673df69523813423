"""`state`: all joints, once or live.

Owns the presentation of a joint state. Must not know how it is obtained.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import click

from .common import (
    RobotOptions,
    fault_names,
    joint_json,
    json_option,
    on_terminal,
    open_robot,
    raise_if_silent,
    robot_options,
)
from .numbers import number_option
from .output import plain, print_json, say, say_table

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointReading, JointState

__all__ = ["condition", "state", "state_json"]

_HEAD = ("joint", "deg", "deg/s", "load %", "mA", "V", "degC", "age ms", "torque", "condition")


@click.command()
@click.option("--watch", is_flag=True, help="Update until interrupted.")
@number_option("--rate", "HZ", "With --watch, the update rate.", above=0, default=5.0)
@robot_options
@json_option
def state(watch: bool, rate: float, options: RobotOptions, as_json: bool) -> None:
    """Show all joints, once or live."""
    with open_robot(options) as robot:
        if watch:
            _watch(robot, rate, as_json)
        else:
            joints = robot.read()
            if as_json:
                print_json(state_json(joints, robot.model))
            else:
                say_table(_HEAD, [_cells(joint) for joint in joints])
                for line in _remarks(joints):
                    say(line)
            raise_if_silent([(robot.model.joint(name).servo_id, name) for name in joints.silent])


def state_json(state: JointState, model: ArmModel) -> dict[str, object]:
    """A joint state for JSON, each key with its unit."""
    from hexwire.drivers.robot_state import RobotState

    return {
        "robot": model.name,
        "state": RobotState.of(state).name.lower(),
        "stopped": state.stopped,
        "watchdog_tripped": state.watchdog_tripped,
        "maintenance": state.maintenance,
        "board_time_s": state.board_time,
        "joints": [joint_json(joint, model) for joint in state],
    }


def condition(joint: JointReading) -> str:
    """Condition of a joint: ``ok``, ``no answer`` or its faults."""
    from hexwire.model.state import JointFlag

    if joint.flags & JointFlag.SILENT:
        return "no answer"
    words = fault_names(joint.flags)
    if joint.flags & JointFlag.CLAMPED:
        words.append("clamped to its limit")
    return ", ".join(words) or "ok"


def _watch(robot: RobotDriver, rate: float, as_json: bool) -> None:
    from hexwire.control.loop import RateLoop

    ticks = RateLoop(rate).ticks()
    if as_json:
        for _ in ticks:
            print_json(state_json(robot.read(), robot.model), one_line=True)
    elif not on_terminal():
        for seconds in ticks:
            joints = robot.read()
            angles = "  ".join(f"{j.name} {plain(math.degrees(j.position), 2)}" for j in joints)
            odd = [f"{j.name} {condition(j)}" for j in joints if condition(j) != "ok"]
            say("; ".join([f"{seconds:8.1f} s  {angles} deg", *odd, *_remarks(joints)]), flush=True)
    else:
        from rich.console import Group
        from rich.text import Text

        from .draw import JointTable, live

        with live() as screen:
            for _ in ticks:
                joints = robot.read()
                faulty = [condition(joint) != "ok" for joint in joints]
                remarks = [Text(line, style="bold red") for line in _remarks(joints)]
                foot = Text(f"{robot.url}, {rate:g} Hz; Ctrl-C ends", style="dim")
                table = JointTable(_HEAD, [_cells(joint) for joint in joints], faulty)
                screen.update(Group(table, *remarks, foot), refresh=True)


def _remarks(state: JointState) -> list[str]:
    if state.watchdog_tripped:
        return [f"stopped by the board's watchdog, because {state.trip_reason}; 'hexwire resume' ends the stop"]
    if state.maintenance:
        return ["in maintenance: servo settings may be written, nothing moves"]
    return ["stopped; 'hexwire resume' ends the stop"] if state.stopped else []


def _cells(joint: JointReading) -> tuple[str, ...]:
    from hexwire.model.state import JointFlag

    return (
        joint.name,
        plain(math.degrees(joint.position), 2),
        plain(math.degrees(joint.velocity), 1),
        plain(100 * joint.load, 1),
        plain(1000 * joint.current, 0),
        plain(joint.voltage, 1),
        plain(joint.temperature, 0),
        plain(1000 * joint.age, 0),
        "-" if joint.flags & JointFlag.TORQUE_UNKNOWN else "on" if joint.flags & JointFlag.TORQUE_ON else "off",
        condition(joint),
    )
