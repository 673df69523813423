"""`registers`: the register table of a joint's servo, read through a board by one request.

Owns how registers are shown. Must not know how a board reads them.
"""

from __future__ import annotations

import click

from .bus_group import with_unit
from .common import RobotOptions, json_option, open_robot, robot_options
from .output import print_json, say_table

__all__ = ["registers"]


@click.command()
@click.argument("joint", metavar="JOINT")
@click.argument("names", metavar="[REGISTER]...", nargs=-1)
@robot_options
@json_option
def registers(joint: str, names: tuple[str, ...], options: RobotOptions, as_json: bool) -> None:
    """Show the registers of a joint's servo behind a board: all of them, or those that are named.

    The board reads the whole table by one request. For servos on a bus adapter use 'hexwire bus read'.
    """
    from hexwire.wire.registers import Series

    with open_robot(options) as robot:
        row = robot.model.joint(joint)
        series = Series(row.series)
        wanted = [series.register(name) for name in names] or list(series.registers.values())
        first = min(register.address for register in wanted)
        end = max(register.address + register.size for register in wanted)
        table = robot.read_table(row.name, first, end - first)
    data, rows = [], []
    for register in wanted:
        at = register.address - first
        raw = register.decode(table[at : at + register.size])
        value = register.to_si(raw)
        data.append({"register": register.name, "address": register.address, "raw": raw, "value": value})
        data[-1]["unit"] = register.si_unit
        rows.append((str(register.address), register.name, str(raw), with_unit(value, register.si_unit)))
    if as_json:
        print_json({"joint": row.name, "servo": row.servo_id, "series": series.value, "registers": data})
    else:
        say_table(("address", "register", "raw", "value"), rows, keys=2)
