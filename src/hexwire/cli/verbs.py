"""Calls the verbs of an arm for the motion commands, and tells how that goes: plan, steps, notes, picture, result.

Owns the texts and the JSON. Must not know how a user types a motion, what a program may contain, nor how
either is planned, checked or run. Commands import it when they run.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from hexwire.arm.front import Front
from hexwire.arm.verbs import Arm
from hexwire.control.motion import motions
from hexwire.control.motion.motion_options import unwatched_words
from hexwire.drivers.abilities import OwnWatchdog
from hexwire.drivers.registry import is_address
from hexwire.errors import HexwireError, UsageError
from hexwire.link.tap import Missed
from hexwire.units import plain

from .exits import note, shielded, tell_missed
from .look import joint_json
from .options import attached, refuse_idle_table
from .output import answer, print_json, say, wants_json
from .plot import MotionPlot

if TYPE_CHECKING:
    from hexwire.control.motion.motions import CheckedPath, MotionResult
    from hexwire.control.motion.rest import Rest
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.checks import MotionReport
    from hexwire.motion.safety import StopReason
    from hexwire.new_file import OutputFile

__all__ = [
    "FollowTeller",
    "GripTeller",
    "MoveTeller",
    "RunOptions",
    "Teller",
    "TorqueTeller",
    "arrived_words",
    "hold_on_ctrl_c",
    "leg_json",
    "leg_words",
    "opening_json",
    "opening_words",
    "progress_bar",
    "rest_json",
    "run_program",
    "run_verb",
]

_SHOWN = math.radians(0.1)
"""A little more than a count."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of all motion commands.

    Attributes:
        table: Height of the table above the base, metres; None for no table.
        plot: File for a picture, already created; or None.
        dry_run: Check and draw only.
        rate: Cycles per second; by dialect if None.
        host_timed: Send targets one by one, also to a board that executes trajectories itself.
        outlives: Let such a board finish the motion although this program dies.
    """

    table: float | None
    plot: OutputFile | None
    dry_run: bool
    rate: float | None
    host_timed: bool = False
    outlives: bool = False

    @property
    def how(self) -> motions.MotionOptions:
        """How a motion is run."""
        return motions.MotionOptions(rate=self.rate or 0.0, host_timed=self.host_timed, outlives=self.outlives)


class Teller(motions.MotionObserver):
    """Tells a person what a command that moves the arm must say, and stops the arm on Ctrl-C.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: RobotDriver) -> None:
        self.robot = robot

    def unwatched(self, seconds: float) -> None:
        note(f"note: {unwatched_words(self.robot, seconds)}")


class TorqueTeller(Teller):
    """Tells of `torque` which joints have confirmed it.

    Args:
        robot: The arm.
        did: What was done, in words.
    """

    def __init__(self, robot: RobotDriver, did: str) -> None:
        super().__init__(robot)
        self._did = did

    def switched(self, joints: Sequence[str], confirmed: Sequence[str]) -> None:
        """Tell which have."""
        missing = [name for name in joints if name not in confirmed]
        data = {"did": self._did, "confirmed": confirmed, "missing": missing}
        answer(data, f"{self._did}: {' '.join(confirmed) or 'none'}")


class GripTeller(Teller):
    """Tells of `grip` how far the gripper is open in the end."""

    def ended(self, result: MotionResult) -> None:
        """Tell how far it is open, if that is known and the arm was not stopped."""
        if result.stopped is None and math.isfinite(result.opening):
            told = result.opening, result.holds
            answer(opening_json(*told), opening_words(*told))


class FollowTeller(Teller):
    """Tells of `follow` that it begins, and what its rules have to say.

    Args:
        robot: The follower.
        leader: The leader, as typed.
        follower: The follower, as typed.
        several: There are other pairs, so that each note names the follower.
    """

    def __init__(self, robot: RobotDriver, leader: str, follower: str, *, several: bool) -> None:
        super().__init__(robot)
        self._leader, self._follower, self._several = leader, follower, several

    def powered(self, joints: Sequence[str]) -> None:
        """Tell who follows whom."""
        note(f"{self._follower} follows {self._leader}; Ctrl-C ends it, and it holds")
        if not self.robot.can(OwnWatchdog) and not is_address(self.robot.url):
            note(
                f"warning: nothing stops {self._follower} if this program dies: its servos go to their last "
                "set-point and hold there"
            )

    def noted(self, said: str | StopReason) -> None:
        """Tell it; a stop is told by the error that it ends in."""
        if isinstance(said, str):
            note(f"{self._follower}: {said}" if self._several else said)


class MoveTeller(Teller):
    """Tells of `move`: the target as it was sent, the way that is left, and the end.

    Args:
        robot: The arm.
        drawn: What is drawn; closed before the end is told.

    Attributes:
        show: Shows a share of the way, and what is left of it.
    """

    def __init__(self, robot: RobotDriver, drawn: ExitStack) -> None:
        super().__init__(robot)
        self.show: Callable[[float, str], object] = lambda share, text: None
        # At once: a program that reads this through a pipe learns that the arm moves while it moves.
        self._tell = partial(say, flush=True)
        self._drawn = drawn
        self._goal: Mapping[str, float] = {}
        self._farthest = 0.0

    def powered(self, joints: Sequence[str]) -> None:
        """Tell which joints have torque now."""
        self._tell(f"torque on: {' '.join(joints)}")

    def sent(self, sent: SentTarget) -> None:
        """Tell what was sent."""
        self._goal = dict(sent.positions)
        words = "  ".join(f"{name} {math.degrees(angle):.2f}" for name, angle in sent.positions)
        self._tell(f"moving to: {words} deg in {sent.duration:.2f} s")
        if sent.clamped:
            note(f"warning: the board's own limits clamped the target of {', '.join(sent.clamped)}")

    def seen(self, state: JointState) -> None:
        """Show how far the farthest joint is."""
        left = state.distances(self._goal)
        if left:
            name = max(left, key=lambda name: left[name])
            self._farthest = max(self._farthest, left[name])
            share = 1.0 if not self._farthest else 1.0 - left[name] / self._farthest
            self.show(share if math.isfinite(share) else 0.0, f"{name} {math.degrees(left[name]):.1f} deg to go")

    def ended(self, result: MotionResult) -> None:
        """Tell how it ended."""
        self._drawn.close()
        if wants_json():
            print_json(_move_json(self.robot, result) | rest_json(result.rest))
        if result.rest is not None:
            self._tell(arrived_words(result.rest))


def run_verb(
    robot: RobotDriver,
    options: RunOptions,
    title: Callable[[Mapping[str, float]], str],
    call: Callable[[Arm], MotionResult],
) -> None:
    """Attach a robot, call a verb of its arm, and tell what is planned and how it ended.

    Args:
        robot: Not attached yet.
        options: As typed.
        title: What the motion is, for people; gets where all joints are, in radians.
        call: Calls the verb.

    Raises:
        UsageError: The path of a leg is not allowed; nothing was sent.
        ServoError: The arm was stopped, or did not arrive.
    """
    refuse_idle_table(robot)
    with attached(robot), ExitStack() as moving:
        told = _Told(robot, options, title, moving)
        try:
            call(Arm(robot, table=options.table, front=Front(told, options.how, options.dry_run)))
        finally:
            told.finish()


class _RunTeller(Teller):
    """Tells of what `RunOptions` are for."""

    def __init__(self, robot: RobotDriver, options: RunOptions, moving: ExitStack) -> None:
        super().__init__(robot)
        self._options, self._moving = options, moving
        self._say = partial(say, flush=True)

    def refused(self, why: str) -> None:
        """Tell why the board does not execute the path."""
        note(f"targets are sent one by one, since the board does not follow this path itself: {why}")

    def _tell_legs(self, path: CheckedPath, name: str, approach: str) -> list[dict[str, object]]:
        """Tell what is planned, and return it for ``--json``; what comes before the motion leads to its start."""
        legs = []
        for leg, report in zip(path.legs, path.reports, strict=True):
            called = name if leg is path.legs[-1] else approach
            legs.append(leg_json(called, report))
            self._say(f"{called}: {leg_words(report)}")
        return legs


class _Told(_RunTeller):
    def __init__(
        self,
        robot: RobotDriver,
        options: RunOptions,
        title: Callable[[Mapping[str, float]], str],
        moving: ExitStack,
    ) -> None:
        super().__init__(robot, options, moving)
        self._title = title
        self._outcome: dict[str, object] = {}
        self._plot = MotionPlot((), "")
        self._began: float | None = None
        # After a motion, a failure to draw must not hide how the motion ended.
        self._missed = Missed()

    def planned(self, path: CheckedPath) -> None:
        """Tell what will be done."""
        title = self._title(path.start)
        legs = self._tell_legs(path, title, "approach")
        if path.slowed:
            note(f"note: {path.slowed}")
        self._plan(path, title)
        arrived = None if self._options.dry_run else False
        self._outcome |= {"legs": legs, "arrived": arrived, "plot": None, **rest_json(None)}
        # From here on the arm moves.
        self._moving.enter_context(hold_on_ctrl_c(self.robot))

    def seen(self, state: JointState) -> None:
        """Draw the way that the arm takes."""
        if self._options.plot is not None:
            self._missed.guard(self._draw)(state)

    def ended(self, result: MotionResult) -> None:
        """Tell how it ended."""
        # A board that executes trajectories does not mind.
        if result.stopped is None and (skipped := result.timing.skipped) and not result.timed:
            rate = self._options.rate or self.robot.command_rate
            note(f"warning: the line or the machine is too slow for {rate:g} Hz; {skipped} cycles were skipped")
        if not result.arrived:
            return
        with_grip = not math.isnan(result.opening)
        held = f"; the gripper {opening_words(result.opening, result.holds)}" if with_grip else ""
        if result.rest is not None:
            self._say(arrived_words(result.rest) + held)
        self._outcome |= {"arrived": True, **rest_json(result.rest)}
        if with_grip:
            self._outcome |= opening_json(result.opening, result.holds)

    def finish(self) -> None:
        """Draw the picture, and print the JSON; nothing if no motion was planned."""
        picture = self._options.plot
        if not self._outcome:
            return
        if picture is not None:
            draw = self._plot.draw if self._options.dry_run else self._missed.guard(self._plot.draw)
            draw(picture)
            if self._missed.first is None:
                self._outcome["plot"] = str(picture.path)
                self._say(f"drawn: {picture.path}")
            # Does nothing if the picture was drawn.
            picture.discard()
        tell_missed(f"the picture {picture.path if picture else ''}", self._missed)
        if wants_json():
            print_json(self._outcome)

    def _plan(self, path: CheckedPath, title: str) -> None:
        if self._options.plot is None:
            return
        self._plot.names, self._plot.title = path.legs[0].names, title
        begin = 0.0
        for leg in path.legs:
            for t, sample in leg.samples(max(leg.duration / 200, 1e-3)):
                self._plot.planned.append((begin + t, sample.position))
                self._trace(self._plot.path, {**path.start, **dict(zip(leg.names, sample.position, strict=True))})
            begin += leg.duration

    def _draw(self, state: JointState) -> None:
        positions = state.positions
        self._began = state.stamp if self._began is None else self._began
        row = [positions[name] for name in self._plot.names]
        self._plot.measured.append((state.stamp - self._began, row))
        self._trace(self._plot.measured_path, positions)

    def _trace(self, tips: list[Sequence[float]], positions: Mapping[str, float]) -> None:
        if (model := self.robot.kinematics) is not None:
            tips.append(model.forward(model.from_joints(positions)).position)


@contextmanager
def hold_on_ctrl_c(robot: RobotDriver) -> Iterator[None]:
    """Stop the arm when the program is interrupted; the arm holds."""
    try:
        yield
    except KeyboardInterrupt:
        with shielded():
            try:
                robot.stop()
            except HexwireError as error:
                note(f"warning: the arm could not be stopped: {error}")
            else:
                kept = robot.stop_kept_by
                note("stopped: the arm holds" + ("; clear it with 'hexwire resume'" if kept else ""))
        raise


def arrived_words(rest: Rest) -> str:
    """That the arm has arrived, and how far off its goal it came to rest."""
    if math.isnan(rest.off):
        return f"arrived; since then the position of {rest.joint} is unknown"
    if rest.off < _SHOWN:
        return "arrived"
    text = f"arrived, {rest.joint} {math.degrees(rest.off):.1f} deg off"
    return text if rest.tip is None else f"{text}, the tip {1e3 * rest.tip:.1f} mm"


def opening_words(opening: float, holds: bool) -> str:
    """How far the gripper is open, and whether it holds an object."""
    return f"{'holds an object at ' if holds else ''}{plain(100 * opening, 0)} % open"


def opening_json(opening: float, holds: bool) -> dict[str, object]:
    """As `opening_words`, for ``--json``."""
    return {"open_fraction": opening, "holds": holds}


def rest_json(rest: Rest | None) -> dict[str, float | None]:
    """How far off its goal the arm came to rest, for ``--json``; None if it has not arrived."""
    if rest is None:
        return {"off_deg": None, "off_mm": None}
    return {
        "off_deg": None if math.isnan(rest.off) else math.degrees(rest.off),
        "off_mm": None if rest.tip is None else 1e3 * rest.tip,
    }


def leg_json(name: str, report: MotionReport) -> dict[str, object]:
    """What was planned for a leg of a motion, for ``--json``."""
    return {
        "name": name,
        "duration_s": report.duration,
        "peak_speed_deg_per_s": {joint: math.degrees(speed) for joint, speed in report.peak_speed.items()},
        "lowest_point_m": report.lowest,
    }


def leg_words(report: MotionReport) -> str:
    """What was planned for a leg of a motion."""
    fastest = max(report.peak_speed, key=lambda name: report.peak_speed[name])
    text = f"{report.duration:.2f} s, fastest {fastest} at {math.degrees(report.peak_speed[fastest]):.0f} deg/s"
    if math.isfinite(report.lowest):
        text += f", lowest point {1e3 * report.lowest:.0f} mm"
    return text


@contextmanager
def progress_bar() -> Iterator[Callable[[float, str], None]]:
    """A bar on the terminal: gives what shows a share of the way, and what is left of it."""
    from .draw import progress

    with progress() as bar:
        task = bar.add_task("", total=1.0)
        yield lambda share, text: bar.update(task, completed=share, description=text)


def _move_json(robot: RobotDriver, result: MotionResult) -> dict[str, object]:
    sent = result.sent
    return {
        "sent": [
            {"name": name, "position_rad": angle, "position_deg": math.degrees(angle)}
            for name, angle in (sent.positions if sent is not None else ())
        ],
        "duration_s": sent.duration if sent is not None else None,
        "torque_switched_on": result.powered,
        "clamped": sent.clamped if sent is not None else (),
        "silent": sent.silent if sent is not None else (),
        "arrived": result.arrived,
        "joints": (None if result.arrived is None else [joint_json(joint, robot.model) for joint in robot.read()]),
    }


class _ProgramTeller(_RunTeller):
    """Tells of a program: what was checked, or each step as it is run."""

    def __init__(self, robot: RobotDriver, options: RunOptions, moving: ExitStack) -> None:
        super().__init__(robot, options, moving)
        self._number = ""
        self.rows: list[dict[str, object]] = []

    def checked(self, number: str, path: CheckedPath) -> None:
        """Tell what a step would do, if nothing moves."""
        if self._options.dry_run:
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
        legs = self._tell_legs(path, f"step {self._number}", f"step {self._number}, approach")
        if path.slowed:
            note(f"note: step {self._number}: {path.slowed}")
        self.rows.append({"step": self._number, "legs": legs, "arrived": None if self._options.dry_run else False})

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
    from hexwire.control.requests.program import read_program

    refuse_idle_table(robot)
    if options.plot is not None:
        raise UsageError("--plot draws one motion, and not a program")
    if read_program(file).asks and not options.dry_run and not sys.stdin.isatty():
        raise UsageError(f"{file} waits for a person: run it in a terminal, or take its steps 'ask' out")
    with attached(robot), ExitStack() as moving:
        told = _ProgramTeller(robot, options, moving)
        arm = Arm(robot, table=options.table, front=Front(told, options.how, options.dry_run))
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
