"""`bus calibrate`: middle and ends of every joint, by hand, automatically, or from a file.

Owns the questions, the live tables and the files. Must not know how a joint is measured: `hexwire.control` does.
"""

from __future__ import annotations

import datetime
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hexwire.errors import StoppedError, UsageError
from hexwire.new_file import OutputFile
from hexwire.system import TypedLines
from hexwire.units import plain

from .bus import BusOptions, bus_options, bus_url, taken_now
from .exits import note, shielded
from .options import confirm, force_option, json_option, on_terminal
from .output import DEGREES, Column, RowType, answer, format_table

if TYPE_CHECKING:
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.model.calibration import Calibration
    from hexwire.setup.auto_calibration import AutoCalibration
    from hexwire.setup.calibrating import CalibrationBench
    from hexwire.setup.hand_calibration import HandCalibration, JointProgress

__all__ = ["calibrate"]

_PERIOD = 0.02
"""Seconds between two samples."""
_MOST_FILES = 1000
_REDRAW = 0.1
"""Seconds between two drawings of a table."""
_SWEPT: RowType[JointProgress] = RowType(
    Column("name", "joint"),
    Column("low", "min deg", digits=1, scale=DEGREES),
    Column("position", "now", digits=1, scale=DEGREES),
    Column("high", "max deg", digits=1, scale=DEGREES),
    Column("missing", "missing", text=lambda row: row.missing or "nothing"),
)
_AUTO_HEAD = ("joint", "count", "ends", "")
_BEFORE_AUTO = (
    "every joint moves to its stops, for about two minutes:",
    "- put the arm down folded, with the gripper in the middle of its roll",
    "- clear everything out of its reach",
    "- keep a hand at the switch of its supply; Ctrl-C leaves it without torque",
)
_typed = TypedLines()


@click.command()
@click.argument("robot")
@click.argument("file", type=click.Path(dir_okay=False), required=False)
@click.option("--auto", is_flag=True, help="Let the arm find its stops itself. It moves!")
@click.option(
    "--from",
    "--lerobot",
    "source",
    type=click.Path(exists=True, dir_okay=False),
    help="Take over this calibration, of hexwire or LeRobot (.json), instead of measuring.",
)
@click.option("--store", "stores", is_flag=True, help="With --from: store its offsets and limits in the servos.")
@click.option("--seconds", type=click.IntRange(min=1), metavar="N", help="By hand: end after N seconds.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@force_option
@bus_options
@json_option
def calibrate(
    robot: str,
    file: str | None,
    auto: bool,
    source: str | None,
    stores: bool,
    seconds: int | None,
    yes: bool,
    force: bool,
    options: BusOptions,
) -> None:
    """Measure middle and ends of every joint of ROBOT (so101, or a TOML file) and save them to FILE.

    Without FILE it is a new one in this folder, such as so101-calibration.toml; nothing is overwritten. A FILE that
    ends with .json has LeRobot's format. The offsets and limits are stored in the servos, as LeRobot
    does.

    By hand: torque is switched off, so hold the arm. Put wrist_roll in its middle, press Enter, move every joint to
    both ends, and press Enter when nothing is missing. It does not matter where the joints are at the beginning.

    With --auto the arm does this itself with low torque, in an order that keeps it off the table. It stops at
    anything odd, and Ctrl-C leaves it without torque.
    """
    from hexwire.drivers.registry import load_bus_arm

    if source is not None and (auto or seconds is not None):
        raise UsageError("--from takes a calibration from a file, so --auto and --seconds do not apply")
    if auto and seconds is not None:
        raise UsageError("--auto ends by itself; leave out --seconds")
    if stores and source is None:
        raise UsageError("a new calibration is always stored in the servos; --store is for --from")
    driver = load_bus_arm(robot)
    if file is None:
        file = str(_new_name(robot, force))
    with OutputFile(file, force=force) as out:
        if source is not None:
            found = _loaded(source, robot, driver)
            text = _text(found, file)
            if stores:
                with _bench(driver, options) as bench:
                    _store(bench, found)
        else:
            with _bench(driver, options) as bench:
                found = _automatic(bench, yes) if auto else _by_hand(bench, seconds, yes)
                text = _text(found, file)
                _store(bench, found)
        out.file.write(text.encode())
    joints = [joint.name for joint in found.joints]
    answer(
        {"file": file, "joints": joints},
        f"{len(joints)} {'joint' if len(joints) == 1 else 'joints'} saved to {file}",
    )


def _new_name(robot: str, force: bool) -> Path:
    """A name for the file if none is given: that of the robot, with a number if there is such a file already."""
    first = Path.cwd() / f"{Path(robot).stem}-calibration.toml"
    names = (first, *(first.with_name(f"{first.stem}-{number}.toml") for number in range(2, _MOST_FILES)))
    return next((name for name in names if force or not os.path.lexists(name)), first)


def _text(found: Calibration, file: str) -> str:
    return found.to_lerobot() if _is_lerobot(file) else found.serialize()


def _is_lerobot(file: str) -> bool:
    return Path(file).suffix.lower() == ".json"


def _loaded(source: str, robot: str, driver: type[BusArm]) -> Calibration:
    from dataclasses import replace

    from hexwire.drivers.arm_file import load_calibration

    found = load_calibration(source)
    if _is_lerobot(source):
        taken = datetime.datetime.fromtimestamp(Path(source).stat().st_mtime).astimezone()
        found = replace(found, arm=robot, taken=taken.isoformat(timespec="seconds"))
    model = driver.described().model
    found.apply(model)
    if missing := [name for name in model.names if name not in {joint.name for joint in found.joints}]:
        note(f"warning: {source} has no {', '.join(missing)}: not calibrated")
    return found


@contextmanager
def _bench(driver: type[BusArm], options: BusOptions) -> Iterator[CalibrationBench]:
    from hexwire.setup.calibrating import CalibrationBench, counting_arm
    from hexwire.wire.command_frame import Status

    described = driver.described()
    with driver.from_url(bus_url(options), arm=counting_arm(described)) as arm:
        if arm.epochs.stopped:
            why = "the arm is stopped; `hexwire resume` ends that"
            raise StoppedError.unsent("a calibration", int(Status.STOPPED), why)
        bench = CalibrationBench(arm, described, shield=shielded)
        bench.examine()
        yield bench


def _store(bench: CalibrationBench, found: Calibration) -> None:
    from hexwire.setup.calibrating import store

    with shielded():
        changed = store(bench.arm.bus, found)
    if len(changed) == len(found.joints):
        note("offsets and limits are stored in all servos")
    else:
        note(f"stored in the servos of {', '.join(changed)}" if changed else "the servos have these values already")


# --- by hand ---------------------------------------------------------------------------------------------------


def _by_hand(bench: CalibrationBench, seconds: int | None, yes: bool) -> Calibration:
    note("torque will be switched off: hold the arm")
    if not yes:
        _wait_for_enter("press Enter when you hold it")
    with _told_at_ctrl_c():
        bench.release()
        hand = bench.by_hand()
        if hand.endless:
            middle = f"put {' and '.join(hand.endless)} in its middle"
            note(f"{middle}: it has no stops, so this is where its angle is 0")
            _wait_for_enter("then press Enter")
        _sample(bench, hand)
        hand.mark_middle()
        note("now move every joint to both ends" + (", then press Enter" if seconds is None else ""))
        _sweep(bench, hand, seconds)
        return hand.finish(taken_now())


def _sample(bench: CalibrationBench, hand: HandCalibration) -> None:
    hand.receive(bench.positions(), time.monotonic())


def _sweep(bench: CalibrationBench, hand: HandCalibration, seconds: int | None) -> None:
    """Sample until nothing is missing and Enter is pressed; Enter twice accepts what is there."""
    end = None if seconds is None else time.monotonic() + seconds
    warned, said, redraw = "", "", 0.0
    with _screen() as show:
        while end is None or time.monotonic() < end:
            _sample(bench, hand)
            if time.monotonic() >= redraw:
                redraw = time.monotonic() + _REDRAW
                show(_rows(hand), said)
            if end is not None:
                time.sleep(_PERIOD)
            elif _entered(_PERIOD):
                missing = "; ".join(f"{row.name} {row.missing}" for row in hand.missing)
                if not hand.unmoved and missing in ("", warned):
                    break
                warned = missing
                said = "not yet" if hand.unmoved else "something is missing: Enter again accepts it as it is"
                if not on_terminal():
                    note(f"still missing: {missing}" + ("" if hand.unmoved else " (Enter accepts it as it is)"))
    if not on_terminal():
        for line in format_table(_SWEPT.titles, _rows(hand)).splitlines():
            note(line)


def _rows(hand: HandCalibration) -> list[tuple[str, ...]]:
    return [_SWEPT.cells(row) for row in hand.progress]


def _wait_for_enter(text: str) -> None:
    """Wait for Enter at a terminal. Unlike with `click.pause`, Ctrl-C ends the command: the arm may not be held."""
    if sys.stdin.isatty():
        note(text)
        sys.stdin.readline()


@contextmanager
def _told_at_ctrl_c() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        note("ended: torque is off, nothing was saved")
        raise


def _entered(seconds: float) -> bool:
    """Wait for some time; returns whether Enter was pressed."""
    entered = _typed.entered(seconds)
    if entered is None:
        raise UsageError("the input has ended; give --seconds if nobody presses Enter")
    return entered


# --- automatically ---------------------------------------------------------------------------------------------


def _automatic(bench: CalibrationBench, yes: bool) -> Calibration:
    if not yes:
        for line in _BEFORE_AUTO:
            note(line)
    confirm("Go on?", yes)
    bench.release()
    said, redraw = "", 0.0
    with _told_at_ctrl_c(), _screen(_AUTO_HEAD) as show:

        def watch(auto: AutoCalibration) -> None:
            nonlocal said, redraw
            if auto.doing not in ("", said) and not on_terminal():
                note(auto.doing)
            if auto.doing != said or time.monotonic() >= redraw:
                redraw = time.monotonic() + _REDRAW
                show(_auto_rows(auto), f"{auto.step} of {auto.steps} motions, Ctrl-C ends it; {auto.doing}")
            said = auto.doing

        return bench.automatic(taken_now(), watch=watch, clock=time.monotonic, sleep=time.sleep)


def _auto_rows(auto: AutoCalibration) -> list[tuple[str, ...]]:
    ranges = auto.ranges
    rows: list[tuple[str, ...]] = []
    for name, counts in auto.positions.items():
        ends = "{} to {}".format(*ranges[name]) if name in ranges else ""
        doing = auto.doing.partition(": ")[2] if auto.doing.startswith(f"{name}:") else ""
        rows.append((name, plain(counts, 0), ends, doing))
    return rows


@contextmanager
def _screen(head: tuple[str, ...] = _SWEPT.titles) -> Iterator[Callable[[list[tuple[str, ...]], str], None]]:
    """A table with a line below, redrawn in place on a terminal; nothing elsewhere."""
    if not on_terminal():
        yield lambda rows, below: None
        return
    from .draw import live_table

    with _no_echo(), live_table(head) as show:
        yield show


@contextmanager
def _no_echo() -> Iterator[None]:
    """Keep the terminal from showing what is typed: each Enter would move a table that is redrawn in place."""
    if sys.platform == "win32" or not sys.stdin.isatty():
        yield
        return
    import termios

    before = termios.tcgetattr(sys.stdin)
    quiet = termios.tcgetattr(sys.stdin)
    quiet[3] &= ~termios.ECHO
    termios.tcsetattr(sys.stdin, termios.TCSADRAIN, quiet)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
