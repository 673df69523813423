"""`bus`: find, read and write servos on a bus adapter, without a board in between.

Owns these commands and the list of the modules with the others: those that set servos up are in `bus_setup`, those
that run for a while in `bus_live`, calibration is in `bus_calibrate`, the set-up of an arm in
`bus_arm_setup`, their condition in `bus_health`. Must not know packets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import ServoError, UsageError

from . import bus_arm_setup, bus_calibrate, bus_health, bus_live, bus_setup  # noqa: F401  # their commands join the group on import
from .bus_group import BusOptions, bus, bus_options, known_servo, open_bus, refuse_if_stopped, with_unit
from .common import confirm, json_option, on_terminal
from .exits import note
from .numbers import NumbersCommand
from .output import answer, print_json, say, say_table

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.setup import Found, ServoInfo

__all__ = ["bus"]


@bus.command()
@click.option("--all-rates", is_flag=True, help="Try every rate that servos can be set to.")
@click.option("--ids", default="0-253", show_default=True, metavar="IDS", help="Ids to try.")
@bus_options
@json_option
def scan(all_rates: bool, ids: str, options: BusOptions, as_json: bool) -> None:
    """Find servos: every id, at every rate with --all-rates. Reports ids that several servos share."""
    from hexwire.bus.setup import scan as scan_bus
    from hexwire.drivers.bus_checkup import SERVO_RATES

    wanted = parse_ids(ids)
    with open_bus(options) as opened:
        rates = SERVO_RATES if all_rates else (opened.timing.baud,)
        if on_terminal() and not as_json:
            found = _scan_with_bar(opened, rates, wanted)
        else:
            found = scan_bus(opened, bauds=rates, ids=wanted)
        if len(found) > _TOO_MANY and not any(row.info for row in found):
            raise ServoError("every ping is answered, but not by a servo: is another device on this port?")
        if as_json:
            print_json([_found_json(row) for row in found])
        elif found:
            say_table(_FOUND_HEAD, [_found_cells(row) for row in found])
        for row in found:
            if row.shared:
                note(f"several servos seem to have id {row.servo_id}: connect one alone and `hexwire bus set-id`")
        if not found:
            tried = "any rate" if all_rates else f"{opened.timing.baud} baud (--all-rates tries the others)"
            raise ServoError(f"no servo answers at {tried}: check power and cable")


_TOO_MANY = 20
"""Unreadable answers from more ids than this mean another device, not servos that share an id."""
_FOUND_HEAD = ("id", "baud", "series", "model", "firmware", "delay us", "acks", "condition")


def _found_cells(row: Found) -> tuple[str, ...]:
    from hexwire.bus.values import fault_words

    info = row.info
    if info is None:
        return (str(row.servo_id), str(row.baud), "?", "", "", "-", "-", "answers collide" if row.shared else "?")
    condition = ", ".join(fault_words(info.status)) or "ok"
    return (
        str(row.servo_id),
        str(row.baud),
        info.series.value if info.series else "unknown",
        info.model_name,
        info.firmware,
        f"{info.return_delay * 1e6:.0f}",
        "yes" if info.acknowledges else "no",
        f"{condition}, id shared" if row.shared else condition,
    )


def _found_json(row: Found) -> dict[str, object]:
    return {"id": row.servo_id, "baud": row.baud, "shared": row.shared, **_info_json(row.info)}


def _info_json(info: ServoInfo | None) -> dict[str, object]:
    if info is None:
        return {"series": None}
    return {
        "series": info.series.value if info.series else None,
        "model": info.model_name,
        "firmware": info.firmware,
        "set_baud": info.baud,
        "acknowledges": info.acknowledges,
        "return_delay_s": info.return_delay,
        "status": info.status,
    }


def _scan_with_bar(opened: ServoBus, rates: tuple[int, ...], ids: list[int]) -> list[Found]:
    from hexwire.bus.setup import scan as scan_bus

    from .draw import progress

    with progress() as bar:
        task = bar.add_task("scanning", total=len(rates) * len(ids))

        def show(baud: int, servo_id: int, found: int) -> None:
            bar.update(task, advance=1, description=f"{baud} baud, id {servo_id}, {found} found")

        return scan_bus(opened, bauds=rates, ids=ids, progress=show)


@bus.command()
@click.argument("ids")
@bus_options
@json_option
def ping(ids: str, options: BusOptions, as_json: bool) -> None:
    """Check which servos answer, as in `ping 1-6`."""
    from hexwire.bus.setup import identify

    silent = []
    data: list[dict[str, object]] = []
    with open_bus(options) as opened:
        for servo_id in parse_ids(ids):
            heard = opened.ping(servo_id)
            row = {"id": servo_id, "present": not heard.error, "faults": heard.faults, "error": heard.error or None}
            data.append(row)
            if heard.error:
                silent.append(servo_id)
                if not as_json:
                    say(f"{servo_id}: {heard.error}")
                continue
            info = identify(opened, servo_id)
            row.update(_info_json(info))
            if as_json:
                continue
            words = "" if info is None else f" {info.series.value if info.series else '?'} {info.model_name}"
            firmware = f" firmware {info.firmware}" if info and info.firmware else ""
            say(f"{servo_id}: {', '.join(heard.faults) or 'ok'}{words}{firmware}")
        if as_json:
            print_json(data)
        if silent:
            raise ServoError(f"no answer from {', '.join(map(str, silent))}: check cable, power, id and --baud")


@bus.command()
@click.argument("ids")
@click.argument("names", nargs=-1, required=True, metavar="REGISTER...")
@bus_options
@json_option
def read(ids: str, names: tuple[str, ...], options: BusOptions, as_json: bool) -> None:
    """Read registers by name, as in `read 1-6 present_position present_voltage`."""
    rows: list[tuple[str, ...]] = []
    data = []
    errors = []
    with open_bus(options) as opened:
        for servo_id in parse_ids(ids):
            known_servo(opened, servo_id, options)
            for name in names:
                reading = opened.read(servo_id, name)
                unit = reading.register.si_unit
                value = "-" if reading.raw is None else with_unit(reading.value, unit)
                condition = reading.error or ", ".join(reading.faults) or "ok"
                rows.append(
                    (str(servo_id), name, "-" if reading.raw is None else str(reading.raw), value, condition)
                )
                data.append(
                    {
                        "id": servo_id,
                        "register": name,
                        "raw": reading.raw,
                        "value": reading.value,
                        "unit": unit,
                        "faults": reading.faults,
                        "error": reading.error,
                    }
                )
                if reading.error:
                    errors.append(reading)
        if as_json:
            print_json(data)
        else:
            say_table(("id", "register", "raw", "value", "condition"), rows, keys=2)
        if errors:
            errors[0].check()


@bus.command(cls=NumbersCommand)
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@click.argument("name", metavar="REGISTER")
@click.argument("value")
@click.option("--si", is_flag=True, help="VALUE is in the SI unit (radians, seconds ...), not in counts.")
@click.option("--yes", is_flag=True, help="Do not ask before a write that may move the servo.")
@bus_options
@json_option
def write(servo_id: int, name: str, value: str, si: bool, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Write a register by name and read it back; stored settings are unlocked, written and locked again.

    A goal position switches torque on and moves the servo, so the command asks first. While the arm is stopped,
    only a torque_enable of 0 is written.
    """
    from hexwire.bus.setup import write_setting

    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        register = opened.series_of(servo_id).register(name)
        try:
            raw = register.from_si(float(value)) if si else int(value, 0)
        except ValueError as error:
            if isinstance(error, UsageError):
                raise
            raise UsageError(f"{value!r} is not {'a number' if si else 'an integer'}") from None
        if raw or name != "torque_enable":
            refuse_if_stopped(opened, f"a write of {name}")
        if name in ("goal_position", "target_position", "torque_enable", "mode"):
            confirm(f"Writing {name} may move servo {servo_id}. Continue?", yes)
        if register.area == "eeprom":
            write_setting(opened, servo_id, name, raw)
        else:
            heard = opened.write_raw(servo_id, name, raw)
            if heard.error:
                heard.check()
        now = opened.read(servo_id, name)
        shown = "-" if now.raw is None else f"{now.raw} ({with_unit(now.value, register.si_unit)})"
        data: dict[str, object] = {
            "id": servo_id,
            "register": name,
            "raw": now.raw,
            "value": now.value,
            "unit": register.si_unit,
        }
        answer(
            as_json, data | {"faults": now.faults, "error": now.error or None}, f"servo {servo_id} {name}: {shown}"
        )
        if now.faults:
            note(f"warning: servo {servo_id} reports {', '.join(now.faults)}")


@bus.command()
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@bus_options
@json_option
def table(servo_id: int, options: BusOptions, as_json: bool) -> None:
    """Show every register of a servo; a * marks stored settings that differ from the factory settings."""
    from hexwire.bus.registers import read_table

    rows = []
    data = []
    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        for row in read_table(opened, servo_id):
            register, changed = row.register, row.differs_from_factory
            rows.append(
                (
                    "*" if changed else "",
                    str(register.address),
                    register.name,
                    str(row.raw),
                    with_unit(register.to_si(row.raw or 0), register.si_unit) if register.si_unit else "",
                    "" if register.default is None else str(register.default),
                    register.access,
                    register.area,
                )
            )
            data.append(
                {"address": register.address, "register": register.name, "raw": row.raw, "changed": changed}
            )
    if as_json:
        print_json(data)
    else:
        say_table(("", "at", "register", "raw", "value", "default", "access", "area"), rows, keys=3)
