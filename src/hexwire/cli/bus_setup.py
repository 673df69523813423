"""The `bus` commands that set servos up: ids, rates, the middle, stored settings, recovery.

Owns the questions asked before something is changed. Must not know how a step is made safe: `bus.setup` does.
"""

from __future__ import annotations

import datetime

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import ServoError, UsageError
from hexwire.new_file import OutputFile

from .bus_group import BusOptions, bus, bus_options, known_servo, open_bus, refuse_if_stopped
from .common import confirm, force_option, json_option
from .output import answer, print_json, say, say_table

__all__ = ["set_baud", "set_id"]

_ID = click.IntRange(0, 253)
_YES = click.option("--yes", is_flag=True, help="Do not ask.")


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


@bus.command("set-id")
@click.argument("old", type=_ID)
@click.argument("new", type=_ID)
@_YES
@bus_options
@json_option
def set_id(old: int, new: int, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Change the id of a servo. Refused if the new id is in use or two servos share the old one."""
    from hexwire.bus import setup as servo_setup

    with open_bus(options) as opened:
        known_servo(opened, old, options)
        refuse_if_stopped(opened, "an id")
        confirm(f"Servo {old} becomes servo {new}. Continue?", yes)
        info = servo_setup.set_id(opened, old, new)
    answer(as_json, {"old_id": old, "id": info.servo_id}, f"servo {old} is now servo {info.servo_id}, and answers")


@bus.command("set-baud")
@click.argument("servo_id", type=_ID, metavar="ID")
@click.argument("rate", type=click.IntRange(min=1))
@_YES
@bus_options
@json_option
def set_baud(servo_id: int, rate: int, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Change the line rate of a servo; undone if it does not answer at the new rate."""
    from hexwire.bus import setup as servo_setup

    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        refuse_if_stopped(opened, "a line rate")
        confirm(f"Servo {servo_id} will answer at {rate} baud only. Continue?", yes)
        servo_setup.set_baud(opened, servo_id, rate)
    words = f"servo {servo_id} answers at {rate} baud; use --baud {rate} from now on"
    answer(as_json, {"id": servo_id, "baud": rate}, words)


@bus.command()
@click.argument("servo_id", type=_ID, metavar="ID")
@_YES
@bus_options
@json_option
def center(servo_id: int, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Make the present position of a servo its middle. Nothing moves; its torque must be off."""
    from hexwire.bus import setup as servo_setup

    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        refuse_if_stopped(opened, "a middle")
        confirm(f"The present position of servo {servo_id} becomes its middle. Continue?", yes)
        position = servo_setup.center(opened, servo_id)
    answer(as_json, {"id": servo_id, "raw": position}, f"servo {servo_id} now reports {position} at this position")


@bus.command()
@click.argument("ids")
@bus_options
@json_option
def recover(ids: str, options: BusOptions, as_json: bool) -> None:
    """Reset the overload protection of servos: torque off, wait until the fault is gone. Hold the arm!"""
    from hexwire.bus import setup as servo_setup

    left = []
    data: list[dict[str, object]] = []
    with open_bus(options) as opened:
        for servo_id in parse_ids(ids):
            known_servo(opened, servo_id, options)
            faults = servo_setup.recover(opened, servo_id)
            data.append({"id": servo_id, "faults": faults, "torque_on": False})
            if not as_json:
                say(f"servo {servo_id}: {', '.join(faults) or 'ok'}, torque off")
            if faults:
                left.append(servo_id)
        if as_json:
            print_json(data)
    if left:
        raise ServoError(f"faults remain on {', '.join(map(str, left))}: remove the cause and try again")


@bus.command()
@click.argument("ids")
@click.argument("file", type=click.Path(dir_okay=False))
@force_option
@bus_options
@json_option
def backup(ids: str, file: str, force: bool, options: BusOptions, as_json: bool) -> None:
    """Save the stored settings of servos to a file."""
    from hexwire.bus.backup import serialize_backups, take_backup

    wanted = parse_ids(ids)
    with OutputFile(file, force=force) as out:
        with open_bus(options) as opened:
            rows = [take_backup(opened, servo_id, taken=_now()) for servo_id in wanted]
        out.file.write(serialize_backups(rows).encode())
    words = f"{len(rows)} servo{'s' if len(rows) != 1 else ''} saved to {file}"
    answer(as_json, {"file": file, "ids": [row.servo_id for row in rows]}, words)


@bus.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@click.option("--ids", metavar="IDS", help="Only these servos of the file.")
@_YES
@bus_options
@json_option
def restore(file: str, ids: str | None, yes: bool, options: BusOptions, as_json: bool) -> None:
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
        data: list[dict[str, object]] = []
        for row in chosen:
            changed = restore_backup(opened, row.servo_id, row)
            data.append({"id": row.servo_id, "changed": changed})
            if not as_json:
                say(f"servo {row.servo_id}: {', '.join(changed) or 'nothing to change'}")
    if as_json:
        print_json(data)


@bus.command()
@click.argument("file", type=click.Path(exists=True, dir_okay=False))
@bus_options
@json_option
def diff(file: str, options: BusOptions, as_json: bool) -> None:
    """Compare servos with their saved settings. Exit status 1 if they differ."""
    from hexwire.bus.backup import compare, load_backup, take_backup

    rows = []
    with open_bus(options) as opened:
        for saved in load_backup(file):
            now = take_backup(opened, saved.servo_id)
            for name, here, there in compare(now, saved):
                rows.append((saved.servo_id, name, here, there))
    if as_json:
        print_json([dict(zip(("id", "register", "servo", "file"), row, strict=True)) for row in rows])
    elif rows:
        cells = [(str(servo_id), name, _cell(here), _cell(there)) for servo_id, name, here, there in rows]
        say_table(("id", "register", "servo", "file"), cells, keys=2)
    else:
        say("no differences")
    if not rows:
        return
    several = len(rows) > 1
    raise ServoError(f"{f'{len(rows)} settings differ' if several else 'one setting differs'} from {file}")


def _cell(value: int | None) -> str:
    return "-" if value is None else str(value)
