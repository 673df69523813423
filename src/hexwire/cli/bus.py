"""`bus`: servos on a bus adapter, without a board in between.

Owns the options of a bus and its opening, and the commands that find, read, write and judge servos. Those that set
servos up are in `bus_setup`, those that run for a while in `bus_live`, calibration is in `bus_calibrate`. Must not
know packets, nor what is healthy: `hexwire.bus.health` judges.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import ServoError, StoppedError, UsageError

from .exits import note, shielded
from .main import LazyGroup
from .options import NumbersCommand, confirm, group_port_option, json_option, on_terminal, port_option, resolve_url
from .output import answer, print_json, say, say_table, with_unit

if TYPE_CHECKING:
    from hexwire.bus.health import HealthFinding, ServoSamples
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.setup import Found, ServoInfo

__all__ = ["BusOptions", "bus", "bus_options", "bus_url", "health", "known_servo", "open_bus", "refuse_if_stopped"]


@dataclass(frozen=True, slots=True)
class BusOptions:
    """Which bus, and which servos are on it.

    Attributes:
        port: URL or path; the only likely adapter if None.
        series: Series of every servo; the servos are asked if None.
        baud: Line rate; the series' default if None and the URL names none.
    """

    port: str | None
    series: str | None
    baud: int | None


def bus_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--port``, ``--series`` and ``--baud``; the command gets them as ``options: BusOptions``."""

    @functools.wraps(command)
    def packed(*args: Any, port: str | None, series: str | None, baud: int | None, **rest: Any) -> Any:
        return command(*args, options=BusOptions(port, series, baud), **rest)

    baud_option = click.option(
        "--baud", type=click.IntRange(min=1), metavar="N", help="Line rate (1000000; 115200 for seven_bot)."
    )
    series_option = click.option(
        "--series", metavar="S", help="sts, sms, scs, hls or seven_bot. Optional: hexwire asks the servos."
    )
    return port_option(series_option(baud_option(packed)))


@contextmanager
def open_bus(options: BusOptions) -> Iterator[ServoBus]:
    """Open the bus that the options name.

    Raises:
        UsageError: The port or series is invalid.
        LinkError: The port cannot be opened.
        WrongDeviceError: No servo answered in this context, because the device is a controller board, or
            another robot.
    """
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.servos import as_series
    from hexwire.drivers.board_reset import note_servos, warn_of_reset
    from hexwire.ipc.board_search import explain_no_servo
    from hexwire.wire.registers import Series

    series = as_series(options.series) if options.series else Series.STS_SMS
    wire = ServoBus.from_url(bus_url(options), series=series)
    # A controller board may be there by mistake.
    warn_of_reset(wire.link)
    with wire as opened:
        try:
            yield opened
        except ServoError:
            wrong = None if opened.counters.answers else explain_no_servo(opened.link)
            if wrong is not None:
                raise wrong from None
            raise
        finally:
            note_servos(opened)
        _warn_of_latency(opened)


def bus_url(options: BusOptions) -> str:
    """The URL of the bus that the options name, or of the only likely adapter.

    Raises:
        UsageError: The port is invalid, or there are several adapters.
        LinkNotFoundError: No port is named, and there is no adapter.
    """
    return resolve_url(options.port or _only_adapter(), options.baud)


def refuse_if_stopped(opened: ServoBus, what: str) -> None:
    """Apply this user's stop: a bus cannot latch one, and a single write can move a servo.

    Raises:
        StoppedError: The arm on this bus is stopped.
    """
    from hexwire.drivers.stop_memory import StopMemory
    from hexwire.wire.command_frame import Status

    if StopMemory(opened.link.url).stopped:
        raise StoppedError.unsent(what, Status.STOPPED, "the arm is stopped; `hexwire resume` ends that")


def _only_adapter() -> str:
    from hexwire.errors import LinkNotFoundError
    from hexwire.link.ports import list_ports

    found = [port for port in list_ports() if port.likely_adapter]
    if len(found) == 1:
        return found[0].device
    if found:
        raise UsageError(f"several likely adapters: {', '.join(map(str, found))}; name one with --port")
    raise LinkNotFoundError("no likely servo adapter found: plug it in, or name a port with --port")


def _warn_of_latency(opened: ServoBus) -> None:
    from hexwire.link.adapter import inspect_adapter

    device = getattr(opened.link, "device", None)
    if isinstance(device, str):
        report = inspect_adapter(device, opened.timing.overhead, opened.timing.holds_back)
        if report.advice:
            note(f"warning: {report.advice}")


def known_servo(opened: ServoBus, servo_id: int, options: BusOptions) -> None:
    """Ask a servo for its series, unless the user gave it.

    Raises:
        ServoError: It does not answer.
    """
    if options.series:
        return
    from hexwire.bus.setup import identify

    if identify(opened, servo_id) is None:
        raise ServoError(
            f"servo {servo_id} does not answer: check cable, power, id and --baud; `hexwire bus scan` searches "
            "all ids",
            servo_id=servo_id,
        )


_ELSEWHERE = {
    **dict.fromkeys(("set-id", "set-baud", "center", "recover", "backup", "restore", "diff", "setup"), "bus_setup"),
    **dict.fromkeys(("monitor", "wave", "stress"), "bus_live"),
    "calibrate": "bus_calibrate",
}


@click.group(
    cls=LazyGroup,
    locations={name: f"hexwire.cli.{module}:{name.replace('-', '_')}" for name, module in _ELSEWHERE.items()},
)
@group_port_option
def bus(port: str | None) -> None:
    """Talk to bus servos through an adapter: find, read, write, set up, watch, test."""


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
            baud = opened.timing.baud  # 0 where the address has no rate
            tried = f" at {baud} baud (--all-rates tries the others)" if baud else ""
            tried = " at any rate" if all_rates else tried
            raise ServoError(f"no servo answers{tried}: check power and cable")


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


_MARKS = {"ok": "ok   ", "hint": "hint ", "bad": "BAD  "}


@bus.command()
@click.argument("ids")
@click.option("--backlash", is_flag=True, help="Measure the backlash too: each servo moves by 3 degrees!")
@click.option("--yes", is_flag=True, help="Do not ask.")
@bus_options
@json_option
def health(ids: str, backlash: bool, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Say how servos are, as in `health 1-6`, in the order of the chain from the adapter on.

    Judges faults, supply against voltage class, temperature, current at rest, firmware with known problems, and
    lost answers by their place in the chain. Put the arm down first. Nothing moves without --backlash.

    The exit status is 0 if nothing is BAD, 1 if something is. Hints do not count.
    """
    from hexwire.bus.health import Rank, check_health, judge_health

    wanted = parse_ids(ids)
    if options.series:
        raise UsageError("--series does not apply: the servos are asked")
    with open_bus(options) as opened:
        if backlash:
            refuse_if_stopped(opened, "a motion")
            confirm("Each servo moves by 3 deg to either side. Is the arm put down and free to move?", yes)
        servos = check_health(opened, wanted)
        if backlash:
            servos = [_with_backlash(opened, servo) for servo in servos]
        findings = judge_health(servos)
        if as_json:
            print_json({"healthy": _healthy(findings), "findings": [_finding_json(row) for row in findings]})
        else:
            _say_findings(findings)
        if not _healthy(findings):
            bad = sum(row.rank is Rank.BAD for row in findings)
            raise ServoError(f"{bad} problem{'s' if bad > 1 else ''} found, marked BAD above")


def _healthy(findings: list[HealthFinding]) -> bool:
    from hexwire.bus.health import Rank

    return all(row.rank is not Rank.BAD for row in findings)


def _finding_json(row: HealthFinding) -> dict[str, object]:
    return {
        "level": row.rank.value,
        "ids": row.servo_ids,
        "topic": row.topic,
        "text": row.text,
        "advice": row.advice,
    }


def _say_findings(findings: list[HealthFinding]) -> None:
    from hexwire.bus.health import Rank

    for row in findings:
        who = ", ".join(map(str, row.servo_ids))
        about = f"servo {who}: " if row.rank is not Rank.OK and who and not row.text.startswith("no ") else ""
        say(f"{_MARKS[row.rank.value]} {row.topic:12} {about}{row.text}")
        if row.advice:
            say(f"      -> {row.advice}")


def _with_backlash(opened: ServoBus, servo: ServoSamples) -> ServoSamples:
    from hexwire.setup.servo_wave import measure_backlash

    if not servo.answers:
        return servo
    note(f"servo {servo.servo_id} moves")
    try:
        found = measure_backlash(opened, servo.servo_id, clock=time.monotonic, sleep=time.sleep, shield=shielded)
    except UsageError as error:
        note(f"warning: its backlash is unknown: {error}")
        return servo
    return replace(servo, backlash=found)
