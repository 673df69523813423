"""`bus`: servos on a bus adapter, without a board in between.

Owns the options of a bus and its opening, and the commands that find, read, write and judge servos. Those that set
servos up are in `bus_setup`, those that run for a while in `bus_live`, calibration is in `bus_calibrate`. Must not
know packets, nor what is healthy: `hexwire.bus.health` judges.
"""

from __future__ import annotations

import datetime
import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import LinkNotFoundError, ServoError, StoppedError, UsageError

from .exits import note, shielded
from .main import LazyGroup
from .options import NumbersCommand, confirm, group_port_option, json_option, on_terminal, port_option, resolve_url
from .output import Column, RowType, print_json, say_finding, wants_json, with_unit

if TYPE_CHECKING:
    from hexwire.bus.health import HealthFinding, ServoSamples
    from hexwire.bus.registers import TableRow
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.bus.setup import Found, ServoInfo
    from hexwire.bus.values import Answer, Reading

__all__ = [
    "BusOptions",
    "bus",
    "bus_options",
    "bus_url",
    "health",
    "known_servo",
    "open_bus",
    "refuse_if_stopped",
    "search_bar",
    "taken_now",
]


SearchProgress = Callable[[int, int, int], None]
"""Gets rate and id that are asked, and how many servos were found."""


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


def taken_now() -> str:
    """The time of a backup or calibration."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


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
def scan(all_rates: bool, ids: str, options: BusOptions) -> None:
    """Find servos: every id, at every rate with --all-rates. Reports ids that several servos share."""
    from hexwire.bus.setup import scan as scan_bus
    from hexwire.drivers.checkup import SERVO_RATES

    wanted = parse_ids(ids)
    with open_bus(options) as opened:
        rates = SERVO_RATES if all_rates else (opened.timing.baud,)
        with search_bar(len(rates) * len(wanted)) as progress:
            found = scan_bus(opened, bauds=rates, ids=wanted, progress=progress)
        if len(found) > _TOO_MANY and not any(row.info for row in found):
            raise ServoError("every ping is answered, but not by a servo: is another device on this port?")
        if found or wants_json():
            _FOUND.show(found)
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


def _of_found(text: Callable[[ServoInfo], str], unknown: str = "") -> Callable[[Found], str]:
    """The cell of a fact that only a servo with an identity has."""
    return lambda row: unknown if row.info is None else text(row.info)


def _condition(row: Found) -> str:
    from hexwire.bus.values import fault_words

    if row.info is None:
        return "answers collide" if row.shared else "?"
    condition = ", ".join(fault_words(row.info.status)) or "ok"
    return f"{condition}, id shared" if row.shared else condition


_FOUND: RowType[Found] = RowType(
    Column("id", "id", "servo_id"),
    Column("baud", "baud"),
    Column("shared"),
    Column("**", get=lambda row: _info_json(row.info)),
    Column("", "series", text=_of_found(lambda info: info.series.value if info.series else "unknown", "?")),
    Column("", "model", text=_of_found(lambda info: info.model_name)),
    Column("", "firmware", text=_of_found(lambda info: info.firmware)),
    Column("", "delay us", text=_of_found(lambda info: f"{info.return_delay * 1e6:.0f}", "-")),
    Column("", "acks", text=_of_found(lambda info: "yes" if info.acknowledges else "no", "-")),
    Column("", "condition", text=_condition),
)


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


@contextmanager
def search_bar(total: int | None) -> Iterator[SearchProgress]:
    """A bar on the terminal for a search of servos, if it can be drawn on.

    Args:
        total: How many ids are asked, at all rates together; None if nobody knows.
    """
    if wants_json() or not on_terminal():
        yield lambda baud, servo_id, found: None
        return
    from .draw import progress

    with progress() as bar:
        task = bar.add_task("searching", total=total)

        def show(baud: int, servo_id: int, found: int) -> None:
            bar.update(task, advance=1, description=f"{baud} baud, id {servo_id}, {found} found")

        yield show


@bus.command()
@click.argument("ids")
@bus_options
@json_option
def ping(ids: str, options: BusOptions) -> None:
    """Check which servos answer, as in `ping 1-6`."""
    with open_bus(options) as opened:
        rows = _PINGS.tell(_ping(opened, servo_id) for servo_id in parse_ids(ids))
        if silent := [str(row.heard.servo_id) for row in rows if row.heard.error]:
            raise ServoError(f"no answer from {', '.join(silent)}: check cable, power, id and --baud")


class _Ping(NamedTuple):
    heard: Answer
    info: ServoInfo | None

    def __str__(self) -> str:
        heard, info = self.heard, self.info
        if heard.error:
            return f"{heard.servo_id}: {heard.error}"
        words = "" if info is None else f" {info.series.value if info.series else '?'} {info.model_name}"
        firmware = f" firmware {info.firmware}" if info and info.firmware else ""
        return f"{heard.servo_id}: {', '.join(heard.faults) or 'ok'}{words}{firmware}"


_PINGS: RowType[_Ping] = RowType(
    Column("id", get="heard.servo_id"),
    Column("present", get=lambda row: not row.heard.error),
    Column("faults", get="heard.faults"),
    Column("error", get=lambda row: row.heard.error or None),
    Column("**", get=lambda row: {} if row.heard.error else _info_json(row.info)),
)


def _ping(opened: ServoBus, servo_id: int) -> _Ping:
    from hexwire.bus.setup import identify

    heard = opened.ping(servo_id)
    return _Ping(heard, None if heard.error else identify(opened, servo_id))


def _value(row: Reading) -> str:
    return "-" if row.raw is None else with_unit(row.value, row.register.si_unit)


_READINGS: RowType[Reading] = RowType(
    Column("id", "id", "servo_id"),
    Column("register", "register", "register.name"),
    Column("raw", "raw"),
    Column("value", "value", text=_value),
    Column("unit", get="register.si_unit"),
    Column("faults"),
    Column("error"),
    Column("", "condition", text=lambda row: row.error or ", ".join(row.faults) or "ok"),
    keys=2,
)


@bus.command()
@click.argument("ids")
@click.argument("names", nargs=-1, required=True, metavar="REGISTER...")
@bus_options
@json_option
def read(ids: str, names: tuple[str, ...], options: BusOptions) -> None:
    """Read registers by name, as in `read 1-6 present_position present_voltage`."""
    rows = []
    with open_bus(options) as opened:
        for servo_id in parse_ids(ids):
            known_servo(opened, servo_id, options)
            rows += [opened.read(servo_id, name) for name in names]
        _READINGS.show(rows)
        for row in rows:
            if row.error:
                row.check()


_WRITTEN: RowType[Reading] = RowType(
    Column("id", get="servo_id"),
    Column("register", get="register.name"),
    Column("raw"),
    Column("value"),
    Column("unit", get="register.si_unit"),
    Column("faults"),
    Column("error", get=lambda row: row.error or None),
    words=lambda row: (
        f"servo {row.servo_id} {row.register.name}: " + ("-" if row.raw is None else f"{row.raw} ({_value(row)})")
    ),
)


@bus.command(cls=NumbersCommand)
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@click.argument("name", metavar="REGISTER")
@click.argument("value")
@click.option("--si", is_flag=True, help="VALUE is in the SI unit (radians, seconds ...), not in counts.")
@click.option("--yes", is_flag=True, help="Do not ask before a write that may move the servo.")
@bus_options
@json_option
def write(servo_id: int, name: str, value: str, si: bool, yes: bool, options: BusOptions) -> None:
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
        _WRITTEN.answer(now)
        if now.faults:
            note(f"warning: servo {servo_id} reports {', '.join(now.faults)}")


def _si_value(row: TableRow) -> str:
    unit = row.register.si_unit
    return with_unit(row.register.to_si(row.raw or 0), unit) if unit else ""


_TABLE: RowType[TableRow] = RowType(
    Column("", "", text=lambda row: "*" if row.differs_from_factory else ""),
    Column("address", "at", "register.address"),
    Column("register", "register", "register.name"),
    Column("raw", "raw"),
    Column("changed", get="differs_from_factory"),
    Column("", "value", text=_si_value),
    Column("", "default", text=lambda row: "" if row.register.default is None else str(row.register.default)),
    Column("", "access", text=lambda row: row.register.access),
    Column("", "area", text=lambda row: row.register.area),
    keys=3,
)


@bus.command()
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@bus_options
@json_option
def table(servo_id: int, options: BusOptions) -> None:
    """Show every register of a servo; a * marks stored settings that differ from the factory settings."""
    from hexwire.bus.registers import read_table

    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        rows = read_table(opened, servo_id)
    _TABLE.show(rows)


_FINDINGS: RowType[HealthFinding] = RowType(
    Column("level", get="rank.value"), Column("ids", get="servo_ids"), *map(Column, ("topic", "text", "advice"))
)


@bus.command()
@click.argument("ids")
@click.option("--backlash", is_flag=True, help="Measure the backlash too: each servo moves by 3 degrees!")
@click.option("--yes", is_flag=True, help="Do not ask.")
@bus_options
@json_option
def health(ids: str, backlash: bool, yes: bool, options: BusOptions) -> None:
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
        bad = sum(row.rank is Rank.BAD for row in findings)
        if wants_json():
            print_json({"healthy": not bad, "findings": [_FINDINGS.as_json(row) for row in findings]})
        for row in findings:
            say_finding(row.rank.value, f"{row.topic:12} {_about(row)}{row.text}", row.advice)
        if bad:
            raise ServoError(f"{bad} problem{'s' if bad > 1 else ''} found, marked BAD above")


def _about(row: HealthFinding) -> str:
    """The servos that a finding is about, where its text does not name them."""
    who = ", ".join(map(str, row.servo_ids))
    return f"servo {who}: " if row.rank.value != "ok" and who and not row.text.startswith("no ") else ""


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
