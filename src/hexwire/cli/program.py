"""Runs a program for `hexwire play`, and tells how that goes: each step, its path, and its end.

Owns the texts and the JSON. Must not know what a program may contain, nor how it is checked or run.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

from hexwire.arm.front import Front
from hexwire.arm.verbs import Arm
from hexwire.control.motion import motions
from hexwire.control.requests.program import read_program
from hexwire.errors import UsageError

from .exits import note
from .options import attached, refuse_idle_table
from .output import print_json, say, wants_json
from .verbs import Teller, arrived_words, hold_on_ctrl_c, leg_json, leg_words, opening_words, rest_json

if TYPE_CHECKING:
    from hexwire.control.motion.motions import CheckedPath, MotionResult
    from hexwire.drivers.base import RobotDriver

    from .verbs import RunOptions

__all__ = ["run_program"]


class _ProgramTeller(Teller):
    """Tells of a program: what was checked, or each step as it is run."""

    def __init__(self, robot: RobotDriver, options: RunOptions, moving: ExitStack) -> None:
        super().__init__(robot)
        self._moving, self._dry_run = moving, options.dry_run
        self._say = partial(say, flush=True)
        self._number = ""
        self.rows: list[dict[str, object]] = []

    def checked(self, number: str, path: CheckedPath) -> None:
        """Tell what a step would do, if nothing moves."""
        if self._dry_run:
            self._number = number
            self.planned(path)

    def step(self, number: str) -> None:
        """Keep the number for what follows."""
        if not self._number:
            # From here on the arm moves.
            self._moving.enter_context(hold_on_ctrl_c(self.robot))
        self._number = number

    def planned(self, path: CheckedPath) -> None:
        """Tell what a step does."""
        legs = []
        for leg, report in zip(path.legs, path.reports, strict=True):
            name = f"step {self._number}" if leg is path.legs[-1] else f"step {self._number}, approach"
            self._say(f"{name}: {leg_words(report)}")
            legs.append(leg_json(name, report))
        if path.slowed:
            note(f"note: step {self._number}: {path.slowed}")
        self.rows.append({"step": self._number, "legs": legs, "arrived": None if self._dry_run else False})

    def refused(self, why: str) -> None:
        """Tell why the board does not execute the path."""
        note(f"targets are sent one by one, since the board does not follow this path itself: {why}")

    def ended(self, result: MotionResult) -> None:
        """Tell how a step ended."""
        if not self.rows or self.rows[-1]["arrived"] is not False:
            # The gripper has no path.
            self.rows.append({"step": self._number, "legs": [], "arrived": False})
        if result.arrived is None or (result.why and not result.cut):
            return
        self.rows[-1] |= {"arrived": True, **rest_json(result.rest)}
        if result.opening == result.opening:
            self._say(f"step {self._number}: the gripper {opening_words(result.opening, result.holds)}")
        elif result.rest is not None:
            self._say(f"step {self._number}: {arrived_words(result.rest)}")


def run_program(robot: RobotDriver, options: RunOptions, file: str, step: int, repeat: int) -> None:
    """Attach a robot, and run a program on it.

    Args:
        robot: Not attached yet.
        options: As typed.
        file: The program.
        step: Where it begins, from 1.
        repeat: How often it is run.

    Raises:
        ConfigError: The file is no program.
        HexwireError: As `Arm.play`.
    """
    refuse_idle_table(robot)
    if options.plot is not None:
        raise UsageError("--plot draws one motion, and not a program")
    if read_program(file).asks and not options.dry_run and not sys.stdin.isatty():
        raise UsageError(f"{file} waits for a person: run it in a terminal, or take its steps 'ask' out")
    how = motions.MotionOptions(rate=options.rate or 0.0, host_timed=options.host_timed, outlives=options.outlives)
    with attached(robot), ExitStack() as moving:
        told = _ProgramTeller(robot, options, moving)
        arm = Arm(robot, table=options.table, front=Front(told, how, options.dry_run))
        done = False
        try:
            arm.play(file, step=step, repeat=repeat, ask=_ask)
            done = True
        finally:
            if wants_json() and (told.rows or done):
                print_json({"steps": told.rows, "arrived": None if options.dry_run else done})


def _ask(text: str) -> None:
    note(f"{text}; press Enter")
    if not sys.stdin.readline():
        raise UsageError("the input has ended while the program waited for a person")
