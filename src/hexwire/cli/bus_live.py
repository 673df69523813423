"""The `bus` commands that run for a while: monitor, wave, stress.

Owns what they show and save, and the loops of those that only read; `hexwire.control` moves the servo of a wave.
A wave is confirmed first, bounded by the servo's own limits, stopped by any key, and ends at its starting position.
Samples are saved however the sampling ends.
"""

from __future__ import annotations

import csv
import functools
import io
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import HexwireError, ServoError
from hexwire.model.state import JointFlag, JointReading
from hexwire.new_file import OutputFile

from .bus import BusOptions, bus_options, known_servo, open_bus
from .exits import note, shielded
from .options import confirm, force_option, json_option, number_option, on_terminal, refuse_idle_force
from .output import DEGREES, Column, RowType, answer, print_json, say_table, wants_json, with_unit
from .plot import TimePlot, open_picture

if TYPE_CHECKING:
    from hexwire.bus.latency import Bins
    from hexwire.bus.live_values import LiveValues
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.motion.step_response import StepFigures
    from hexwire.setup.servo_wave import WaveEnd, WaveSample

__all__ = ["Row", "SampleFiles", "file_options", "histogram", "saving"]

Row = tuple[float, ...]
"""One sample: one number per column."""


@dataclass(frozen=True, slots=True)
class SampleFiles:
    """Output files for samples, as typed."""

    csv: str | None
    plot: str | None
    force: bool


def file_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """``--csv``, ``--plot`` and ``--force``; the command gets ``files: SampleFiles``."""

    @functools.wraps(command)
    def given(*args: Any, csv_file: str | None, plot: str | None, force: bool, **rest: Any) -> Any:
        return command(*args, files=SampleFiles(csv_file, plot, force), **rest)

    packed: Callable[..., Any] = given
    for option in (
        force_option,
        click.option("--csv", "csv_file", metavar="FILE", help="Save the samples to this file."),
        click.option("--plot", metavar="FILE", help="Plot the samples to this file (.png, .svg or .pdf)."),
    ):
        packed = option(packed)
    return packed


@contextmanager
def saving(files: SampleFiles, head: Sequence[str], what: str) -> Iterator[list[Row]]:
    """Samples that are saved at the end, even after an error; their files are created before the first sample.

    Args:
        files: As typed.
        head: Names of the columns; the first two are time and id.
        what: The column to plot; a column named target is plotted with it.

    Raises:
        UsageError: A file cannot be created, or matplotlib is not installed.
    """
    if files.csv is None and files.plot is None:
        refuse_idle_force(files.force, "the files of --csv and --plot")
    with ExitStack() as stack:
        table = picture = None
        if files.csv is not None:
            table = stack.enter_context(OutputFile(files.csv, force=files.force))
        if files.plot is not None:
            picture = stack.enter_context(open_picture(files.plot, force=files.force))
        samples: list[Row] = []
        try:
            yield samples
        except BaseException:
            if samples:
                with shielded():
                    _save(samples, head, table, picture, what)
            raise
        _save(samples, head, table, picture, what)


def _save(
    samples: Sequence[Row], head: Sequence[str], table: OutputFile | None, picture: OutputFile | None, what: str
) -> None:
    if table is not None:
        text = io.TextIOWrapper(table.file, encoding="utf-8", newline="")
        writer = csv.writer(text)
        writer.writerow(head)
        writer.writerows(samples)
        text.detach()
        table.keep()
        note(f"{len(samples)} samples saved to {table.path}")
    if picture is not None:
        _plot(samples, head, picture, what)
        note(f"plotted to {picture.path}")


def _plot(samples: Sequence[Row], head: Sequence[str], picture: OutputFile, what: str) -> None:
    servos, words = sorted({row[1] for row in samples}), what.replace("_", " ")
    plot = TimePlot(
        f"{words} of servo{'' if len(servos) == 1 else 's'} {', '.join(f'{one:.0f}' for one in servos)}"
    )
    for i, servo_id in enumerate(servos):
        rows = [row for row in samples if row[1] == servo_id]
        times = [row[0] for row in rows]
        for column, name, dashed in ((what, "", False), ("target", ", target", True)):
            if column in head:
                place = head.index(column)
                values = [math.degrees(row[place]) for row in rows]
                plot.add(f"{words}, deg", f"servo {servo_id:.0f}{name}", i, times, values, dashed=dashed)
    plot.draw(picture)


class _Sample(NamedTuple):
    time: float
    now: LiveValues


_SAMPLES: RowType[_Sample] = RowType(
    Column("time_s", get="time"),
    Column("id", "id", lambda row: float(row.now.servo_id)),
    Column("present_position", "position deg", "now.position", 2, DEGREES),
    Column("present_speed", "speed deg/s", "now.speed", 1, DEGREES),
    Column("present_load", "load %", "now.load", 1, 100),
    Column("present_voltage", "V", "now.voltage", 1),
    Column("present_temperature", "degC", "now.temperature"),
    Column("present_current", "mA", "now.current", 0, 1000),
    Column("", "condition", text=lambda row: row.now.error or ", ".join(row.now.faults) or "ok"),
)
_MOST_ROWS = 1_000_000


@click.command()
@click.argument("ids")
@number_option("--rate", "HZ", "Sample rate.", above=0, default=10.0)
@number_option("--seconds", "S", "Duration; until Ctrl-C if not given.", above=0)
@file_options
@bus_options
@json_option
def monitor(ids: str, rate: float, seconds: float | None, files: SampleFiles, options: BusOptions) -> None:
    """Watch servos live: position, speed, load, voltage, temperature, current. Ctrl-C ends it.

    With --json one line per sample, in SI units.
    """
    from hexwire.bus.live_values import read_live

    wanted = tuple(parse_ids(ids))
    with saving(files, _SAMPLES.keys, "present_position") as samples, open_bus(options) as opened:
        for servo_id in wanted:
            known_servo(opened, servo_id, options)
        start = time.monotonic()
        try:
            with _screen() as show:
                while seconds is None or time.monotonic() - start < seconds:
                    begin = time.monotonic()
                    rows = [_Sample(begin - start, now) for now in read_live(opened, wanted)]
                    data = [_SAMPLES.as_json(row) for row in rows]
                    samples += [tuple(row.values()) for row in data[: _MOST_ROWS - len(samples)]]
                    show([_SAMPLES.cells(row) for row in rows], "")
                    if wants_json():
                        for sample in data:
                            print_json(sample, one_line=True)
                    time.sleep(max(0.0, begin + 1 / rate - time.monotonic()))
        except KeyboardInterrupt:
            note("ended")


@contextmanager
def _screen() -> Iterator[Callable[[Sequence[Sequence[str]], str], None]]:
    """A table that is redrawn in place on a terminal and printed each time elsewhere; none with JSON."""
    if wants_json() or not on_terminal():
        yield lambda rows, below: say_table(_SAMPLES.titles, rows, flush=True)
        return
    from .draw import live_table

    with live_table(_SAMPLES.titles) as show:
        yield show


# --- wave ------------------------------------------------------------------------------------------------------


@click.command()
@click.argument("servo_id", type=click.IntRange(0, 253), metavar="ID")
@click.option(
    "--shape",
    type=click.Choice(["sine", "step", "triangle", "sweep"]),
    default="sine",
    show_default=True,
    help="Shape of the motion.",
)
@number_option("--amplitude", "DEG", "To either side of the present position; at most 45.", above=0, default=10.0)
@number_option("--period", "S", "Period of the motion.", minimum=0.2, default=2.0)
@number_option(
    "--last-period", "S", "Period at the end of a sweep, which begins with --period.", minimum=0.2, default=0.25
)
@number_option("--seconds", "S", "Duration.", above=0, default=6.0)
@click.option("--yes", is_flag=True, help="Do not ask.")
@file_options
@bus_options
@json_option
def wave(
    servo_id: int,
    shape: str,
    amplitude: float,
    period: float,
    last_period: float,
    seconds: float,
    yes: bool,
    files: SampleFiles,
    options: BusOptions,
) -> None:
    """Move one servo back and forth about its present position, then return. Any key stops it.

    Its torque is switched on for this, and off again if it was off. A step wave also reports how fast the servo
    rises, how far it overshoots, when it settles and which error stays.
    """
    from hexwire.motion.waves import Wave
    from hexwire.setup.servo_wave import WaveEnd, one_servo, run_wave, standing

    motion = Wave(shape, math.radians(amplitude), period, seconds, last_period)
    end = WaveEnd()
    with saving(files, ("time_s", "id", "target", "position", "velocity", "load"), "position") as samples:
        confirm(f"Servo {servo_id} will move {amplitude:g} deg to either side. Is it free to move?", yes)
        with open_bus(options) as opened:
            known_servo(opened, servo_id, options)
            with one_servo(opened, servo_id, motion.amplitude) as arm:
                joint = standing(arm)
                if not arm.torque(True):
                    raise ServoError(f"servo {servo_id} does not confirm its torque", servo_id=servo_id)

                def keep(row: WaveSample) -> None:
                    goal, position = joint.position + row.goal, joint.position + row.position
                    samples.append((row.t, float(servo_id), goal, position, row.velocity, row.load))

                with _brought_back(arm, joint, keep_torque=bool(joint.flags & JointFlag.TORQUE_ON)):
                    try:
                        with _any_key() as pressed:
                            run_wave(
                                arm,
                                joint,
                                motion.angle,
                                seconds,
                                end,
                                go_on=lambda: not pressed(),
                                clock=time.monotonic,
                                sleep=time.sleep,
                                on_sample=keep,
                            )
                    except KeyboardInterrupt:
                        note("stopped")
    if end.missed:
        note(f"warning: {end.missed} sample{'s' if end.missed > 1 else ''} missing: the servo did not answer")
    if samples:
        _say_wave(servo_id, shape, end)


_STEPS: RowType[StepFigures] = RowType(
    Column("at", "step at s", digits=2),
    Column("size", "deg", digits=1, scale=DEGREES),
    Column("rise", "rise ms", scale=1000),
    Column("overshoot", "overshoot %", digits=1, scale=100),
    Column("settled", "settled ms", scale=1000),
    Column("steady_error", "steady error deg", digits=2, scale=DEGREES),
)


def _say_wave(servo_id: int, shape: str, end: WaveEnd) -> None:
    """Report how the servo followed; for steps, the figures of each."""
    from hexwire.motion.step_response import step_figures

    rows = [(0.0, 0.0, 0.0), *((row.t, row.goal, row.position) for row in end.samples)]
    steps = step_figures(rows) if shape == "step" else []
    words = f"{len(end.samples)} samples, largest error: {with_unit(end.farthest_off, 'rad')}"
    data: dict[str, object] = {
        "id": servo_id,
        "samples": len(end.samples),
        "farthest_off_rad": end.farthest_off,
    }
    if shape == "step":
        data["steps"] = [asdict(step) for step in steps]
    answer(data, words)
    if steps and not wants_json():
        _STEPS.show(steps)


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
    from hexwire.setup.servo_wave import bring_back

    with shielded():
        if not bring_back(arm, start, keep_torque=keep_torque, sleep=time.sleep):
            note("warning: the servo does not confirm that its torque is off again")


@contextmanager
def _any_key() -> Iterator[Callable[[], bool]]:
    """A function that returns whether a key was pressed; always False without a keyboard."""
    if not sys.stdin.isatty():
        yield lambda: False
        return
    if sys.platform == "win32":
        import msvcrt

        yield msvcrt.kbhit
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


@click.command()
@click.argument("ids")
@click.option(
    "-n",
    "--count",
    type=click.IntRange(min=1),
    default=1000,
    show_default=True,
    metavar="N",
    help="How often all of them are read.",
)
@click.option(
    "--register", "name", default="present_position", show_default=True, metavar="REGISTER", help="What is read."
)
@bus_options
@json_option
def stress(ids: str, count: int, name: str, options: BusOptions) -> None:
    """Read N times as fast as possible; print errors and a histogram of the times. Nothing moves."""
    from hexwire.bus.latency import StressTest

    test = StressTest(tuple(parse_ids(ids)), name)
    took: list[float] = []
    with open_bus(options) as opened:
        for servo_id in test.ids:
            known_servo(opened, servo_id, options)
        try:
            test.run(opened, count, clock=time.perf_counter, each=took.append if wants_json() else lambda _: None)
        except KeyboardInterrupt:
            note("ended")
        counters = opened.counters.as_dict()
        overhead = opened.timing.overhead
    if not test.reads:
        return
    answer(
        {
            "reads": test.reads,
            "seconds": test.seconds,
            "round_trips_s": sorted(took),
            "values": test.values,
            "missing": test.missing,
            "overhead_s": overhead,
            "counters": counters,
        },
        *histogram(test.took.bins()).splitlines(),
        f"{test.reads} reads of {len(test.ids)} in {test.seconds:.2f} s: "
        f"{test.reads / test.seconds:.0f} per second",
        f"values missing: {test.lost} of {test.values} ({test.lost / test.values:.3%})",
        f"adapter and system add {overhead * 1e6:.0f} us to each answer",
        ", ".join(f"{key} {value}" for key, value in counters.items() if value),
    )
    if test.lost:
        raise ServoError(
            f"{test.lost} values are missing, most of them from servo {test.worst}: check its cable and power"
        )


def histogram(bins: Bins) -> str:
    """A histogram of durations as text, with percentiles."""
    lines = []
    for i, (edge, count) in enumerate(zip(bins.edges, bins.counts, strict=True)):
        label = f"{edge * 1e6:8.0f} us" if i < len(bins.edges) - 1 else f"above {edge * 1e6:.0f}".rjust(11)
        lines.append(f"{label} {'#' * round(40 * count / max(bins.counts))} {count}".rstrip())
    lines.append(f"p50 {bins.p50 * 1e6:.0f} us, p99 {bins.p99 * 1e6:.0f} us, longest {bins.longest * 1e6:.0f} us")
    return "\n".join(lines)
