"""The `bus` commands that set servos up: ids, rates, the middle, stored settings, recovery, calibration.

Owns the questions asked before something is changed. Must not know how a step is made safe: `bus.setup` does.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.errors import ServoError, UsageError
from hexwire.new_file import OutputFile

from .bus_group import BusOptions, bus, bus_options, known_servo, open_bus, refuse_if_stopped
from .common import confirm, force_option, json_option, resolve_url
from .exits import note
from .output import answer, format_table, print_json, say, say_table
from .sim_bus import parse_ids

if TYPE_CHECKING:
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.model.calibration import Calibration

__all__ = ["calibrate"]

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


@bus.command()
@click.argument("robot")
@click.argument("file", type=click.Path(dir_okay=False))
@click.option(
    "--lerobot", type=click.Path(exists=True, dir_okay=False), help="Import this LeRobot file instead of measuring."
)
@click.option("--seconds", type=click.IntRange(min=1), metavar="N", help="End the sweep after N seconds.")
@force_option
@bus_options
@json_option
def calibrate(
    robot: str,
    file: str,
    lerobot: str | None,
    seconds: int | None,
    force: bool,
    options: BusOptions,
    as_json: bool,
) -> None:
    """Measure middle and range of every joint of ROBOT (so101, or a TOML file) and save them to FILE.

    Torque is switched off: hold the arm. Move every joint to the middle of its range, press Enter, then move every
    joint through its range and press Enter again.
    """
    from hexwire.drivers.registry import load_bus_arm

    driver = load_bus_arm(robot)
    with OutputFile(file, force=force) as out:
        found = _calibration(driver, robot, lerobot, seconds, options)
        out.file.write(found.serialize().encode())
    joints = [joint.name for joint in found.joints]
    answer(as_json, {"file": file, "joints": joints}, f"{len(joints)} joints saved to {file}")


def _calibration(
    driver: type[BusArm], robot: str, lerobot: str | None, seconds: int | None, options: BusOptions
) -> Calibration:
    """Import a calibration, or measure it."""
    from hexwire.inputs import read_text
    from hexwire.model.calibration import Calibration

    if lerobot is not None:
        text = read_text(lerobot)
        taken = datetime.datetime.fromtimestamp(Path(lerobot).stat().st_mtime).astimezone()
        return Calibration.from_lerobot(text, arm=robot, taken=taken.isoformat(timespec="seconds"), file=lerobot)
    with driver.from_url(resolve_url(options.port, options.baud)) as arm:
        return _wizard(arm, seconds)


def _wizard(arm: BusArm, seconds: int | None) -> Calibration:
    import time

    from hexwire.bus.setup import identify
    from hexwire.model.calibration import RangeSweep

    note("torque will be switched off: hold the arm")
    click.pause("press Enter when you hold it ", err=True)
    missing = set(arm.model.names) - set(arm.torque(False))
    if missing:
        raise ServoError(f"{', '.join(sorted(missing))} did not confirm torque off; nothing was saved")
    click.pause("move every joint to the middle of its range, then press Enter ", err=True)
    ids = tuple(joint.servo_id for joint in arm.model.joints)
    readings = arm.bus.sync_read("present_position", ids).check()
    middles = {joint.name: reading.raw or 0 for joint, reading in zip(arm.model.joints, readings, strict=True)}
    sweep = RangeSweep(middles)
    note(
        "now move every joint to both ends of its range, then press Enter"
        if seconds is None
        else "now move every joint to both ends of its range"
    )
    end = None if seconds is None else time.monotonic() + seconds
    while not _entered(0.02) if end is None else time.monotonic() < end:
        now = arm.bus.sync_read("present_position", ids)
        sweep.receive(dict(zip(arm.model.names, now.raw, strict=True)))
        if end is not None:
            time.sleep(0.02)
    servos = {}
    for joint in arm.model.joints:
        info = identify(arm.bus, joint.servo_id)
        has_offset = "position_offset" in arm.bus.series_of(joint.servo_id).registers
        offset = arm.bus.read(joint.servo_id, "position_offset").raw if has_offset else None
        servos[joint.name] = (offset, info.model_name if info else "", info.firmware if info else "")
    rows = [(name, str(low), str(middles[name]), str(high)) for name, (low, high) in sweep.ranges.items()]
    for line in format_table(("joint", "low", "middle", "high"), rows).splitlines():
        note(line)
    return sweep.finish(arm.model, _now(), servos)


def _entered(seconds: float) -> bool:
    import select
    import sys

    ready, _, _ = select.select([sys.stdin], [], [], seconds)
    if ready:
        sys.stdin.readline()
    return bool(ready)
