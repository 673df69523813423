"""`lerobot-calibrate` for SO arms: the questions, and LeRobot's file.

Owns what is asked and shown. How an arm is calibrated is in `hexwire.setup.calibrating`.
"""

from __future__ import annotations

import datetime
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.drivers.arm_file import load_calibration
from hexwire.new_file import OutputFile
from hexwire.setup.calibrating import CalibrationBench, counting_arm, store
from hexwire.system import TypedLines

from .connection import RETRIES, faults

if TYPE_CHECKING:
    from hexwire.drivers.bus_arm import BusArm
    from hexwire.link.base import Link
    from hexwire.model.calibration import Calibration
    from hexwire.setup.auto_calibration import AutoCalibration
    from hexwire.setup.hand_calibration import HandCalibration

__all__ = ["calibrate"]

_PERIOD = 0.02
_REDRAW = 0.2
_FREE = """Every joint moves to its stops, for about two minutes:
- put the arm down folded, with the gripper in the middle of its roll
- clear everything out of its reach
- keep a hand at the switch of its supply; Ctrl-C leaves it without torque"""
_ENDED = "the input has ended; nothing was saved"
_typed = TypedLines()


def calibrate(arm: type[BusArm], link: Link, file: Path, *, auto: bool) -> None:
    """Calibrate an arm, store the result in its servos, and write LeRobot's file; or store that of the file.

    Args:
        arm: Class of the driver.
        link: Closed.
        file: LeRobot's calibration file; need not exist.
        auto: The arm finds its stops itself.

    Raises:
        RuntimeError: Something odd happened; the text says what.
    """
    if file.is_file():
        answer = _ask(f"Press ENTER to use the calibration in {file}, or type 'c' and press ENTER for a new one: ")
        if answer.strip().lower() != "c":
            with faults(), arm(link) as driver:
                driver.bus.retries = RETRIES
                off = driver.torque(False)
                if len(off) < len(driver.model.names):
                    raise RuntimeError("not every joint confirms torque off; nothing was changed")
                changed = store(driver.bus, load_calibration(file))
            print(
                f"Stored in the servos of {', '.join(changed)}"
                if changed
                else "The servos have these values already"
            )
            return
    described = arm.described()
    with faults(), arm(link, arm=counting_arm(described)) as driver:
        driver.bus.retries = RETRIES
        if driver.epochs.stopped:
            raise RuntimeError("the arm is stopped; `hexwire resume` ends that")
        bench = CalibrationBench(driver, described)
        bench.examine()
        found = _automatic(bench) if auto else _by_hand(bench)
        text = found.to_lerobot()
        store(driver.bus, found)
    with OutputFile(file, force=True, mode=0o644) as out:
        out.file.write(text.encode())
    print(f"Calibration saved to {file}")


def _by_hand(bench: CalibrationBench) -> Calibration:
    _ask("Torque will be switched off: hold the arm and press ENTER....")
    bench.release()
    hand = bench.by_hand()
    _ask(f"Put {' and '.join(hand.endless)} in the middle of its range of motion and press ENTER....")
    hand.receive(bench.positions(), time.monotonic())
    hand.mark_middle()
    print(
        "Move all joints one by one through their entire ranges of motion.\nPress ENTER when nothing is missing..."
    )
    _sweep(bench, hand)
    return hand.finish(_now())


def _sweep(bench: CalibrationBench, hand: HandCalibration) -> None:
    redraw, warned, lines = 0.0, "", 0
    while True:
        hand.receive(bench.positions(), time.monotonic())
        if _entered(_PERIOD):
            missing = "; ".join(f"{row.name} {row.missing}" for row in hand.missing)
            if not hand.unmoved and missing in ("", warned):
                break
            warned, lines = missing, 0
            print(f"Still missing: {missing}" + ("" if hand.unmoved else "; ENTER again accepts it as it is"))
        if sys.stdout.isatty() and time.monotonic() >= redraw:
            redraw = time.monotonic() + _REDRAW
            print(f"\033[{lines}A" if lines else "", end="")
            lines = _show(hand)


def _show(hand: HandCalibration) -> int:
    rows = hand.progress
    print(f"\033[K{'NAME':<15} {'MIN':>7} {'POS':>7} {'MAX':>7}  MISSING")
    for row in rows:
        angles = " ".join(f"{math.degrees(angle):7.1f}" for angle in (row.low, row.position, row.high))
        print(f"\033[K{row.name:<15} {angles}  {row.missing}")
    return len(rows) + 1


def _automatic(bench: CalibrationBench) -> Calibration:
    print(_FREE)
    _ask("Press ENTER to begin....")
    bench.release()
    said = ""

    def watch(auto: AutoCalibration) -> None:
        nonlocal said
        if auto.doing not in ("", said):
            print(f"{auto.step} of {auto.steps}: {auto.doing}")
        said = auto.doing

    return bench.automatic(_now(), watch=watch)


def _ask(text: str) -> str:
    """Show a text and wait for a line.

    Raises:
        RuntimeError: As `_entered`.
    """
    try:
        return input(text)
    except EOFError:
        raise RuntimeError(_ENDED) from None


def _entered(seconds: float) -> bool:
    """Wait, and tell whether Enter was pressed.

    Raises:
        RuntimeError: Nobody can press it: the input has ended.
    """
    entered = _typed.entered(seconds)
    if entered is None:
        raise RuntimeError(_ENDED)
    return entered


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")
