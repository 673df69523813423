"""The `bus` commands that run for a while: monitor, wave, stress.

Owns what they show and save, and the loops of those that only read; `hexwire.control` moves the servo of a wave.
A wave is confirmed first, bounded by the servo's own limits, stopped by any key, and ends at its starting position.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.model.state import JointFlag

from .bus_group import BusOptions, bus, bus_options, known_servo, open_bus, with_unit
from .common import FiniteFloat, confirm, json_option, number_option, on_terminal
from .exits import note, shielded
from .output import answer, format_table, line_width, plain, print_json, say, say_table
from .samples import Row, SampleFiles, file_options, saving
from .sim_bus import parse_ids

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.model.state import JointReading

__all__ = ["histogram", "wave_angle"]

_LIVE_FIRST, _LIVE_COUNT = 56, 15
_SHOWN = ("present_position", "present_speed", "present_load", "present_voltage", "present_temperature")
_HEAD = ("id", "position deg", "speed deg/s", "load %", "V", "degC", "mA", "condition")
_WAVE_RATE = 50.0
_MOST_AMPLITUDE = 45.0
_MOST_SILENT = 25
"""Samples in a row that may be missing: half a second."""
_MOST_ROWS = 1_000_000


@bus.command()
@click.argument("ids")
@number_option("--rate", "HZ", "Sample rate.", above=0, default=10.0)
@number_option("--seconds", "S", "Duration; until Ctrl-C if not given.", above=0)
@file_options
@bus_options
@json_option
def monitor(
    ids: str, rate: float, seconds: float | None, files: SampleFiles, options: BusOptions, as_json: bool
) -> None:
    """Watch servos live: position, speed, load, voltage, temperature, current. Ctrl-C ends it.

    With --json one line per sample, in SI units.
    """
    wanted = tuple(parse_ids(ids))
    head = ("time_s", "id", *_SHOWN, "present_current")
    with saving(files, head, "present_position") as samples, open_bus(options) as opened:
        for servo_id in wanted:
            known_servo(opened, servo_id, options)
        start = time.monotonic()
        try:
            with _screen(as_json) as show:
                while seconds is None or time.monotonic() - start < seconds:
                    begin = time.monotonic()
                    rows = _sample(opened, wanted)
                    for row in rows:
                        if len(samples) < _MOST_ROWS:
                            samples.append((begin - start, *row[1]))
                    show(rows)
                    if as_json:
                        for _, values in rows:
                            print_json(dict(zip(head, (begin - start, *values), strict=True)), one_line=True)
                    time.sleep(max(0.0, begin + 1 / rate - time.monotonic()))
        except KeyboardInterrupt:
            note("ended")


def _sample(opened: ServoBus, ids: tuple[int, ...]) -> list[tuple[tuple[str, ...], Row]]:
    """Cells and SI values of each servo."""
    from hexwire.bus.values import fault_words

    rows: list[tuple[tuple[str, ...], Row]] = []
    for block in opened.sync_read_blocks(_LIVE_FIRST, _LIVE_COUNT, ids):
        registers = opened.series_of(block.servo_id).registers
        values = [block.value(registers[name]) for name in _SHOWN]
        current = registers.get("present_current")
        values.append(block.value(current) if current is not None and current.si_unit == "A" else math.nan)
        condition = block.error or ", ".join(fault_words(block.status)) or "ok"
        position, speed, load, volts, celsius, amperes = values
        cells = (
            str(block.servo_id),
            plain(math.degrees(position), 2),
            plain(math.degrees(speed), 1),
            plain(load * 100, 1),
            plain(volts, 1),
            plain(celsius, 0),
            plain(amperes * 1000, 0),
            condition,
        )
        rows.append((cells, (float(block.servo_id), *values)))
    return rows


@contextmanager
def _screen(as_json: bool) -> Iterator[Callable[[list[tuple[tuple[str, ...], Row]]], None]]:
    """A table that is redrawn in place on a terminal and printed each time elsewhere; none with JSON."""
    if as_json:
        yield lambda rows: None
        return
    if not on_terminal():
        yield lambda rows: say_table(_HEAD, [cells for cells, _ in rows], flush=True)
        return
    from rich.text import Text

    from .draw import live

    def show(rows: list[tuple[tuple[str, ...], Row]]) -> None:
        table = format_table(_HEAD, [cells for cells, _ in rows], width=line_width())
        screen.update(Text(table), refresh=True)

    with live() as screen:
        yield show


# --- wave ------------------------------------------------------------------------------------------------------


def wave_angle(shape: str, amplitude: float, period: float, t: float) -> float:
    """Angle relative to the start at a time: a sine from zero, or steps to one side and the other."""
    phase = t / period % 1.0
    if shape == "sine":
        return amplitude * math.sin(2 * math.pi * phase)
    return amplitude * (1 if phase < 0.5 else -1)


@bus.command()
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@click.option(
    "--shape", type=click.Choice(["sine", "step"]), default="sine", show_default=True, help="Shape of the motion."
)
@number_option(
    "--amplitude",
    "DEG",
    f"To either side of the present position; at most {_MOST_AMPLITUDE:g}.",
    above=0,
    default=10.0,
)
@click.option("--period", type=FiniteFloat("seconds", minimum=0.2), default=2.0, show_default=True, metavar="S")
@click.option("--seconds", type=FiniteFloat("seconds", above=0), default=6.0, show_default=True, metavar="S")
@click.option("--yes", is_flag=True, help="Do not ask.")
@file_options
@bus_options
@json_option
def wave(
    servo_id: int,
    shape: str,
    amplitude: float,
    period: float,
    seconds: float,
    yes: bool,
    files: SampleFiles,
    options: BusOptions,
    as_json: bool,
) -> None:
    """Move one servo back and forth about its present position, then return. Any key stops it.

    Its torque is switched on for this, and off again if it was off.
    """
    if amplitude > _MOST_AMPLITUDE:
        raise UsageError(f"an amplitude of {amplitude:g} deg is more than {_MOST_AMPLITUDE:g}")
    with saving(files, ("time_s", "id", "target", "position", "velocity", "load"), "position") as samples:
        confirm(f"Servo {servo_id} will move {amplitude:g} deg to either side. Is it free to move?", yes)
        with _one_servo(servo_id, amplitude, options) as arm:
            joint = _standing(arm, servo_id)
            if not arm.torque(True):
                raise ServoError(f"servo {servo_id} does not confirm its torque", servo_id=servo_id)
            with _brought_back(arm, joint, keep_torque=bool(joint.flags & JointFlag.TORQUE_ON)):
                try:
                    _wave(
                        arm,
                        joint,
                        lambda t: wave_angle(shape, math.radians(amplitude), period, t),
                        seconds,
                        samples,
                    )
                except KeyboardInterrupt:
                    note("stopped")
    if samples:
        off = max(abs(row[2] - row[3]) for row in samples)
        words = f"{len(samples)} samples, largest error: {with_unit(off, 'rad')}"
        answer(as_json, {"id": servo_id, "samples": len(samples), "farthest_off_rad": off}, words)


@contextmanager
def _one_servo(servo_id: int, amplitude: float, options: BusOptions) -> Iterator[BusArm]:
    """The servo as an arm of one joint, limited to the wave and to the servo's own limits."""
    from hexwire.drivers.arm_file import BusArmFile
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.link.open import make_link
    from hexwire.model.arm import ArmModel, JointModel

    with open_bus(options) as opened:
        known_servo(opened, servo_id, options)
        series = opened.series_of(servo_id)
        reading = opened.read(servo_id, "present_position").check()
        scale = reading.register.si_factor
        counts = reading.raw or 0
        reach = math.ceil(math.radians(amplitude) / scale) + 2
        low, high = counts - reach, counts + reach
        names = [name for name in ("min_position_limit", "min_angle_limit") if name in series.registers]
        if names:
            least = opened.read(servo_id, names[0]).raw
            most = opened.read(servo_id, names[0].replace("min", "max")).raw
            if least is not None and most is not None and most > least and (low < least or high > most):
                raise UsageError(
                    f"servo {servo_id} is at {counts} and may move from {least} to {most}: "
                    f"{amplitude:g} deg to either side is too much"
                )
        joint = JointModel(
            f"servo {servo_id}",
            servo_id,
            series.value,
            counts,
            1,
            0.0,
            scale,
            -reach * scale,
            reach * scale,
            math.inf,
        )
        url, baud = opened.link.url, opened.timing.baud
    arm = BusArmFile(ArmModel("one servo", (joint,)), baud)
    driver = BusArm(make_link(url), arm=arm)
    with driver:
        yield driver


def _standing(arm: BusArm, servo_id: int) -> JointReading:
    """State of the servo before it is moved.

    Raises:
        ServoError: It does not report its position.
    """
    for _ in range(_MOST_SILENT):
        joint = arm.read()[arm.model.names[0]]
        if not joint.flags & JointFlag.SILENT:
            return joint
    raise ServoError(f"servo {servo_id} does not answer: check cable and power", servo_id=servo_id)


def _wave(
    arm: BusArm, start: JointReading, shape: Callable[[float], float], seconds: float, samples: list[Row]
) -> None:
    """Move the servo and collect samples.

    Raises:
        ServoError: The servo has a fault, is silent for too long, or was stopped.
    """
    from hexwire.control.owner import RobotOwner
    from hexwire.control.wave import WaveController

    servo_id = arm.model.joint(start.name).servo_id

    def sample(t: float, target: float, joint: JointReading) -> None:
        samples.append((t, float(servo_id), target, joint.position, joint.velocity, joint.load))

    controller = WaveController(
        start, shape, seconds, period=1 / _WAVE_RATE, most_silent=_MOST_SILENT, on_sample=sample
    )
    # After a failure the servo is brought back, and not stopped where it is.
    owner = RobotOwner(
        arm, borrowed=True, command_rate=_WAVE_RATE, stop_on_failure=False, clock=time.monotonic, sleep=time.sleep
    )
    with _any_key() as pressed, owner:
        owner.group.members = (controller,)
        while not controller.over and not pressed():
            owner.turn()
        stopped = controller.reason
    if controller.fault:
        raise ServoError(f"servo {servo_id} {controller.fault}", servo_id=servo_id)
    if stopped is not None:
        raise ServoError(f"stopped: {stopped}; clear it with 'hexwire resume'", servo_id=servo_id)
    if missed := controller.missed:
        note(f"warning: {missed} sample{'s' if missed > 1 else ''} missing: the servo did not answer")


@contextmanager
def _brought_back(arm: BusArm, start: JointReading, *, keep_torque: bool) -> Iterator[None]:
    """Return the servo to its starting position, whatever ends the wave."""
    try:
        yield
    except BaseException:
        # The error that ended the wave must be reported first.
        try:
            _end_wave(arm, start, keep_torque=keep_torque)
        except HexwireError:
            note("warning: the servo could not be returned to its start and may still have torque")
        raise
    _end_wave(arm, start, keep_torque=keep_torque)


def _end_wave(arm: BusArm, start: JointReading, *, keep_torque: bool) -> None:
    from hexwire.model.state import JointTarget

    with shielded():
        arm.write(JointTarget.of({start.name: start.position}, duration=0.5))
        time.sleep(0.7)
        if not keep_torque and not arm.torque(False):
            note("warning: the servo does not confirm that its torque is off again")


@contextmanager
def _any_key() -> Iterator[Callable[[], bool]]:
    """A function that returns whether a key was pressed; always False without a keyboard."""
    if not sys.stdin.isatty():
        yield lambda: False
        return
    import select
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield lambda: bool(select.select([sys.stdin], [], [], 0)[0])
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


# --- stress ----------------------------------------------------------------------------------------------------


@bus.command()
@click.argument("ids")
@click.option("-n", "--count", type=click.IntRange(min=1), default=1000, show_default=True, metavar="N")
@click.option("--register", "name", default="present_position", show_default=True, metavar="REGISTER")
@bus_options
@json_option
def stress(ids: str, count: int, name: str, options: BusOptions, as_json: bool) -> None:
    """Read N times as fast as possible; print errors and a histogram of the times. Nothing moves."""
    wanted = tuple(parse_ids(ids))
    took: list[float] = []
    missing = dict.fromkeys(wanted, 0)
    with open_bus(options) as opened:
        for servo_id in wanted:
            known_servo(opened, servo_id, options)
        start = time.monotonic()
        try:
            for _ in range(count):
                begin = time.perf_counter()
                readings = opened.sync_read(name, wanted)
                took.append(time.perf_counter() - begin)
                for servo_id in readings.missing:
                    missing[servo_id] += 1
        except KeyboardInterrupt:
            note("ended")
        total = time.monotonic() - start
        counters = opened.counters.as_dict()
        overhead = opened.timing.overhead
    if not took:
        return
    failed = sum(missing.values())
    values = len(took) * len(wanted)
    if as_json:
        print_json(
            {
                "reads": len(took),
                "seconds": total,
                "round_trips_s": sorted(took),
                "values": values,
                "missing": missing,
                "overhead_s": overhead,
                "counters": counters,
            }
        )
    else:
        _say_stress(took, wanted, total, missing, overhead, counters)
    if failed:
        worst = max(missing, key=lambda servo_id: missing[servo_id])
        raise ServoError(f"{failed} values are missing, most of them from servo {worst}: check its cable and power")


def _say_stress(
    took: Sequence[float],
    wanted: Sequence[int],
    total: float,
    missing: Mapping[int, int],
    overhead: float,
    counters: Mapping[str, int],
) -> None:
    failed = sum(missing.values())
    values = len(took) * len(wanted)
    say(*histogram(took).splitlines())
    say(f"{len(took)} reads of {len(wanted)} in {total:.2f} s: {len(took) / total:.0f} per second")
    say(f"values missing: {failed} of {values} ({failed / values:.3%})")
    say(f"adapter and system add {overhead * 1e6:.0f} us to each answer")
    say(", ".join(f"{key} {value}" for key, value in counters.items() if value))


def histogram(seconds: Sequence[float]) -> str:
    """Durations as a text histogram, with percentiles."""
    ordered = sorted(seconds)
    low = ordered[0]
    step = max((ordered[len(ordered) * 99 // 100] - low) / 10, 1e-6)
    counts = [0] * 11
    for value in ordered:
        counts[min(int((value - low) / step), 10)] += 1
    lines = []
    for i, count in enumerate(counts):
        label = f"{(low + i * step) * 1e6:8.0f} us" if i < 10 else f"above {(low + i * step) * 1e6:.0f}".rjust(11)
        lines.append(f"{label} {'#' * round(40 * count / max(counts))} {count}".rstrip())
    p50, p99 = ordered[len(ordered) // 2], ordered[len(ordered) * 99 // 100]
    lines.append(f"p50 {p50 * 1e6:.0f} us, p99 {p99 * 1e6:.0f} us, longest {ordered[-1] * 1e6:.0f} us")
    return "\n".join(lines)
