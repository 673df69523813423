"""A program of an arm: its steps as paths, checked as a whole, and then run one after the other.

Owns what each step is for the verbs of an arm, and where one is while a program runs. Must not know the format of
its file, nor how a motion is checked or run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from hexwire.control.loop.power import what_helps
from hexwire.control.loop.reader import read_start
from hexwire.control.motion import motions
from hexwire.control.motion.jaws import MOST_SECONDS
from hexwire.control.motion.played import check_played
from hexwire.control.requests.preview import TIP_SPEED
from hexwire.control.requests.program import Move, Wait, along
from hexwire.drivers.tools import Gripper
from hexwire.errors import StoppedError, UsageError
from hexwire.motion.teach import Edits
from hexwire.motion.trajectory import Trajectory

if TYPE_CHECKING:
    from hexwire.control.motion.motions import CheckedPath, MotionObserver, MotionOptions, MotionResult
    from hexwire.control.motion.via import Place
    from hexwire.control.requests.program import Program
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.motion.teach import Taught

    from .claim import Claim
    from .plans import Plans

__all__ = ["ProgramRun", "asking"]

_LOOK = 0.02
"""Seconds between two looks, in a pause, at whether it is to end."""
_MOST_STEPS = 100_000
"""Steps in all repetitions: more than a week of the shortest motions."""
_STOPPED = 5
"""Status `stopped` of PROTOCOL.md section 6.2."""

Asking = Callable[[str], object]
"""Called with what a person is to do; returns when it is done."""


def asking(program: Program, ask: Asking | None) -> Asking:
    """Who asks a person.

    Raises:
        UsageError: The program has questions, and nobody asks them.
    """
    if ask is None and program.asks:
        raise UsageError("this program waits for a person: say how, as in play('pick.toml', ask=input)")
    return ask or (lambda text: None)


class ProgramRun:
    """One run of a program.

    Args:
        driver: Attached.
        plans: Of the arm.
        program: What is run.
        first: The step to begin with, from 1.
        times: How often it is run.
        how: How its motions are run and checked.

    Raises:
        UsageError: There is no such step, there are too many, or a recording cannot be read.
    """

    def __init__(
        self, driver: RobotDriver, plans: Plans, program: Program, first: int, times: int, how: MotionOptions
    ) -> None:
        from .recorded import read_taught

        self._driver, self._plans, self._how = driver, plans, how
        self._steps = list(islice(program.run_from(first, times), _MOST_STEPS + 1))
        if len(self._steps) > _MOST_STEPS:
            raise UsageError(f"this program runs more than {_MOST_STEPS} steps, repetitions counted")
        wanted = {does.file for _, does in self._steps if isinstance(does, Move) and does.file}
        self._taught: dict[str, Taught] = {
            name: read_taught(str(path)) for name, path in program.recordings().items() if name in wanted
        }

    def check(self, start: Mapping[str, float], observer: MotionObserver) -> float:
        """Check all motions, each from where the one before it ends; nothing moves.

        Args:
            start: Present positions of all joints, radians.
            observer: Is told of each step and its path.

        Returns:
            Seconds that the motions and pauses take.

        Raises:
            LimitError: A path is not allowed; the text names the step.
            UsageError: A step cannot be, such as one to a pose that is not there; likewise.
        """

        def ends(number: str, move: Move, here: dict[str, float]) -> tuple[float, dict[str, float]]:
            if move.request.what == "grip":
                gripper = Gripper(self._driver)
                return MOST_SECONDS, {**here, gripper.joint.name: gripper.angle(move.request.share)}
            path = self._path(move, here)
            observer.checked(number, path)
            leg = path.legs[-1]
            return sum(leg.duration for leg in path.legs), {**here, **dict(zip(leg.names, leg.goal, strict=True))}

        pauses = sum(does.seconds for _, does in self._steps if isinstance(does, Wait))
        return pauses + sum(along(self._steps, start, ends))

    def run(
        self,
        claim: Claim,
        observer: MotionObserver,
        asked: Token,
        ask: Asking,
        told: Callable[[MotionResult], object],
    ) -> MotionResult:
        """Run it.

        Args:
            claim: Ends it.
            observer: Is told of each step, its path and its motion.
            asked: When the program was asked for: a stop since then voids what is left of it.
            ask: Asks a person.
            told: Called with how each motion ended; raises what a person must know of it.

        Returns:
            How the last motion ended.

        Raises:
            HexwireError: As a verb of the arm.
        """
        result = motions.MotionResult(None)
        for number, does in self._steps:
            observer.step(number)
            if isinstance(does, Move):
                result = self._move(does, claim, observer, asked)
                told(result)
            elif isinstance(does, Wait):
                self._pause(does.seconds, claim, asked)
            else:
                ask(does.text)
            if not self._driver.epochs.holds(asked):
                raise StoppedError("the motion", _STOPPED, f"the arm was stopped; {what_helps(self._driver)}")
            if claim.ends() or result.cut:
                return replace(result, cut=True, ended=result.ended or claim.why)
        return result

    def _move(self, move: Move, claim: Claim, observer: MotionObserver, asked: Token) -> MotionResult:
        driver = self._driver
        if move.request.what == "grip":
            return motions.run_grip(
                driver, move.request.share, observer=observer, cancelled=claim.ends, asked=asked
            )
        path = self._path(move, read_start(driver))
        observer.planned(path)
        return motions.run_motion(
            driver, path, self._how, until=lambda _: claim.ends(), observer=observer, asked=asked, rest=True
        )

    def _pause(self, seconds: float, claim: Claim, asked: Token) -> None:
        clock, sleep = self._how.clock or self._driver.now, self._how.sleep
        until = clock() + seconds
        while (left := until - clock()) > 0 and not claim.ends() and self._driver.epochs.holds(asked):
            sleep(min(_LOOK, left))

    def _path(self, move: Move, here: Mapping[str, float]) -> CheckedPath:
        request = move.request
        if request.what == "play":
            edits = Edits(request.begin, request.end, smooth=request.smooth)
            return check_played(
                self._driver,
                self._plans.played(self._taught[move.file], edits),
                request.factor,
                here,
                self._how,
                speed=request.speed,
                fit=request.fit,
                advice="factor = {factor}, or fit = true",
            )
        return motions.check_path(self._driver, self._legs(move, dict(here)), self._how, start=here)

    def _legs(self, move: Move, here: dict[str, float]) -> Sequence[Trajectory]:
        request, plans = move.request, self._plans
        if request.what == "place" and request.place.straight:
            return [plans.line([request.place], here, TIP_SPEED * request.speed, 0.0)]
        point: Place | Mapping[str, float] = request.place
        if request.what == "pose":
            point = plans.pose(request.name)
        elif request.what == "joints":
            point = plans.angles(request.goals)
        return [plans.through([point], here, request.speed, None)]
