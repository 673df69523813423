"""The first run of an arm: from its cable to its first motion, one step at a time.

Owns the steps, what each needs before the next, what a person reads there, and how small the first motion is. Asks
no servo and moves nothing: what was found comes in, and the motion goes out as a request. Must not know pages.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from hexwire.drivers.stored_calibration import not_calibrated
from hexwire.errors import UsageError

from .hand_calibration import JointProgress

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.calibration import Calibration

__all__ = ["FirstRun", "FoundJoint", "Stage", "Told"]

STEP = math.radians(5.0)
"""How far a joint goes in one step of the first jog, at most."""
SPEED = 0.05
"""Share of the joints' speed limits in the first jog."""
_MOVED = math.radians(1.0)
"""A joint that went so far has moved."""
_LEAST = math.radians(5.0)
"""A joint that a hand moved so far was seen to move."""


class Stage(Enum):
    """The steps after the arm was connected."""

    WHAT = "What it is"
    CALIBRATED = "Calibrated?"
    RANGES = "Range of each joint"
    JOG = "First jog"
    DONE = "Done"


_STAGES = tuple(Stage)


@dataclass(frozen=True, slots=True)
class FoundJoint:
    """What answers for a joint.

    Attributes:
        name: The joint.
        servo_id: Id of its servo.
        told: What the servo is, in words.
        fault: What must be mended before going on; empty if nothing.
        remarks: What is good to know.
    """

    name: str
    servo_id: int
    told: str = ""
    fault: str = ""
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Told:
    """What a person is told at a step.

    Attributes:
        stage: The step.
        text: What it is about, and what to do, in sentences.
        next: What going on does, in words; empty at the end.
        missing: Why one cannot go on yet; empty if one can.
        joint: The joint to look at; empty for none.
        rows: Name, value and level (``ok``, ``warn``, ``error``, or empty) of what was found.
    """

    stage: Stage
    text: str
    next: str = ""
    missing: str = ""
    joint: str = ""
    rows: Sequence[tuple[str, str, str]] = ()


class FirstRun:
    """Where somebody is on that way. Not for several threads at a time.

    Args:
        model: The arm as it usually is.
        bare: Its servos are on this computer's line, so that they can be calibrated here; else a board, or another
            program, is before them.

    Attributes:
        model: The arm as it usually is.
        bare: Its servos are on this computer's line.
        stage: The present step.
        measured: A calibration that is measured, and not stored yet; None if there is none.
        former: What the servos had stored before the last change here; None if nothing can be taken back.
    """

    def __init__(self, model: ArmModel, *, bare: bool) -> None:
        self.model, self.bare = model, bare
        self.stage = Stage.WHAT
        self.measured: Calibration | None = None
        self.former: Calibration | None = None
        self._found: tuple[FoundJoint, ...] = ()
        self._what = ""
        self._stored: Calibration | None = None
        self._faults: dict[str, str] = {}
        self._seen: dict[str, tuple[float, float, float]] = {}
        self._jogged: dict[str, float] = {}

    # -- what was found -----------------------------------------------------------------------------------

    def identified(self, found: Collection[FoundJoint], what: str) -> None:
        """Take what answers: a row for each joint, and the arm as a whole in words."""
        self._found, self._what = tuple(found), what

    def examined(self, stored: Calibration) -> None:
        """Take what the servos have stored."""
        self._stored, self._faults = stored, not_calibrated(stored, self.model)

    def was_stored(self, former: Calibration) -> None:
        """A calibration was stored in the servos; call `examined` then.

        Args:
            former: What they had before; without a range of every joint it cannot be written again.
        """
        whole = len(former.joints) == len(self.model.joints)
        self.former, self.measured = former if whole else None, None

    def may_be_changed(self) -> None:
        """Storing has failed: nothing is known of the servos until they are `examined` again."""
        self._stored, self._faults = None, {}

    def was_undone(self) -> None:
        """The servos have what they had before; call `examined` then."""
        self.former = None

    def seen(self, positions: Mapping[str, float]) -> None:
        """Take joint angles in radians, while a hand moves joints without torque."""
        for name, angle in positions.items():
            if math.isfinite(angle):
                low, _, high = self._seen.get(name, (angle, angle, angle))
                self._seen[name] = (min(low, angle), angle, max(high, angle))

    def forget_seen(self) -> None:
        """Begin anew with what a hand moves."""
        self._seen.clear()

    @property
    def progress(self) -> tuple[JointProgress, ...]:
        """How far a hand has moved each joint, of an arm whose angles are known: radians, as its model has them."""
        found = []
        for joint in self.model.joints:
            low, now, high = self._seen.get(joint.name, (math.nan, math.nan, math.nan))
            missing = "" if high - low >= _LEAST else "not moved yet"
            found.append(JointProgress(joint.name, low, now, high, joint.maximum - joint.minimum, missing))
        return tuple(found)

    @property
    def calibrated(self) -> bool:
        """Whether the angles of the arm can be trusted; always, where a board has them."""
        return not self.bare or (self._stored is not None and not self._faults)

    # -- the steps ----------------------------------------------------------------------------------------

    def forward(self) -> None:
        """Go on.

        Raises:
            UsageError: Something is missing for it; the text says what.
        """
        told = self.told
        if not told.next:
            raise UsageError("the first run is over")
        if told.missing:
            raise UsageError(f"not yet: {told.missing}")
        self.stage = _STAGES[_STAGES.index(self.stage) + 1]

    def back(self) -> None:
        """Go back a step.

        Raises:
            UsageError: It is the first one.
        """
        at = _STAGES.index(self.stage)
        if not at:
            raise UsageError("this is the first step; leave it to choose another arm")
        self.stage, self.measured = _STAGES[at - 1], None

    def may_measure(self) -> None:
        """Check that joints may be measured by hand now, and a calibration stored.

        Raises:
            UsageError: It is another step, or not the servos of this computer's line.
        """
        if self.stage is not Stage.RANGES or not self.bare:
            raise UsageError("this arm is not calibrated at this step")

    def jog(self, joint: str, way: int, *, torque: bool) -> dict[str, object]:
        """The request of one step of the first jog, for `MotionService`.

        Args:
            joint: Name of the joint.
            way: 1 or -1.
            torque: Whether that joint has torque.

        Raises:
            UsageError: It is not the time for it, there is no such joint, or the joint is limp.
        """
        if self.stage is not Stage.JOG:
            raise UsageError("the first jog comes after the other steps")
        if way not in (1, -1):
            raise UsageError("a step goes one way (1) or the other (-1)")
        name = self.model.joint(joint).name
        if not torque:
            raise UsageError(f"{name} has no torque: press Torque on, then it holds where it is")
        return {"what": "step", "joint": name, "by": way * STEP, "speed": SPEED}

    def jogged(self, joint: str, moved: float) -> None:
        """A step has ended; the joint has moved so far, radians."""
        if math.isfinite(moved) and abs(moved) >= _MOVED:
            self._jogged[joint] = moved

    # -- in words -----------------------------------------------------------------------------------------

    @property
    def told(self) -> Told:
        """What a person is told now."""
        tell = {
            Stage.WHAT: self._told_what,
            Stage.CALIBRATED: self._told_calibrated,
            Stage.RANGES: self._told_ranges,
            Stage.JOG: self._told_jog,
            Stage.DONE: self._told_done,
        }
        return tell[self.stage]()

    def _told_what(self) -> Told:
        rows = [
            (
                f"{row.name}, servo {row.servo_id}",
                "; ".join(filter(None, (row.fault or row.told, *row.remarks))),
                "error" if row.fault else "warn" if row.remarks else "ok",
            )
            for row in self._found
        ]
        bad = [row for row in self._found if row.fault]
        silent = next((row.name for row in bad), "")
        if not bad:
            text = f"{self._what} Every joint answers. Nothing was written, and nothing moved."
            return Told(self.stage, text, "Is it calibrated?", "" if rows else "look what answers", rows=rows)
        text = (
            f"{self._what} The picture shows {silent}: check its cable, its supply and the cable before it, then "
            "press Look again."
        )
        if self.bare:
            text += " New servos all have id 1: set them up one at a time first."
        names = ", ".join(row.name for row in bad)
        return Told(self.stage, text, "Is it calibrated?", f"{names}: not ready", silent, rows)

    def _told_calibrated(self) -> Told:
        if not self.bare:
            text = (
                f"The angles of this {self.model.name} come ready from its board, or from the program that shares "
                "it: nothing is calibrated from here. The next step shows whether the picture follows the arm; if "
                "a joint stands elsewhere than in the picture, its horn sits on another tooth."
            )
            return Told(self.stage, text, "Move each joint by hand")
        rows = [
            (joint.name, self._faults.get(joint.name) or self._range_of(joint.name), self._level(joint.name))
            for joint in self.model.joints
        ]
        if self.calibrated:
            text = (
                "Calibrated: its servos have the range of each joint stored. Go on to see them; they can be "
                "measured anew there."
            )
            return Told(self.stage, text, "See the range of each joint", rows=rows)
        text = (
            "Not calibrated: its servos do not know the ranges of the joints, so every angle may be wrong by far. "
            "The next step measures them while you move the arm by hand, without torque. Nothing is stored before "
            "you have seen what."
        )
        return Told(self.stage, text, "Calibrate it by hand", joint=next(iter(self._faults), ""), rows=rows)

    def _range_of(self, name: str) -> str:
        row = next((row for row in self._stored.joints if row.name == name), None) if self._stored else None
        if row is None:
            return "no range stored"
        degrees = math.degrees((row.high - row.low) * self.model.joint(name).scale)
        return f"range of {degrees:.0f} deg"

    def _level(self, name: str) -> str:
        return "error" if name in self._faults else "ok"

    def _told_ranges(self) -> Told:
        if not self.bare:
            text = (
                "Hold the arm and switch its torque off: it sinks. Then move each joint a little by hand, and see "
                "whether the picture does the same. The ghost shows how far a joint may go. Nothing is stored."
            )
            return Told(self.stage, text, "To the first jog")
        if self.measured is not None:
            text = (
                "Measured, and not stored yet: the table shows what would be written to each servo, and what is "
                "there now. Each value is read back; if one fails, all servos get their old values."
            )
            return Told(self.stage, text, "To the first jog", "store the ranges first", rows=self._changes())
        rows = [
            (name, self._faults.get(name) or self._range_of(name), self._level(name)) for name in self.model.names
        ]
        if self.calibrated:
            text = "These ranges are stored in the servos. Nothing has torque that had none before."
            return Told(self.stage, text, "To the first jog: open the arm", rows=rows)
        text = (
            "Hold the arm: its torque is switched off, and it sinks. Then move each joint to both of its ends, in "
            "any order. The picture shows the joint that comes next, and the ghost how it moves."
        )
        return Told(self.stage, text, "To the first jog", "measure the ranges first", rows=rows)

    def _changes(self) -> list[tuple[str, str, str]]:
        """What would be written, by joint."""
        now = {row.name: row for row in self._stored.joints} if self._stored else {}
        rows = []
        for row in self.measured.joints if self.measured else ():
            before = now.get(row.name)
            old = (
                ("none", "none") if before is None else (str(before.servo_offset), f"{before.low} to {before.high}")
            )
            new = (str(row.servo_offset), f"{row.low} to {row.high}")
            parts = zip(("offset", "range"), old, new, strict=True)
            told = [f"{what} {was} → {becomes}" for what, was, becomes in parts if was != becomes]
            rows.append((f"{row.name}, servo {row.servo_id}", ", ".join(told) or "stays as it is", ""))
        return rows

    def _told_jog(self) -> Told:
        text = (
            "Clear the reach of the arm, and keep a hand at the switch of its supply. Press Torque on: it holds "
            f"where it is. Then hold a button: the joint goes {math.degrees(STEP):.0f} degrees at most, slowly, "
            "and holds as soon as you let go. See that it goes the way of the picture."
        )
        rows = [
            (name, f"moved {math.degrees(self._jogged[name]):+.1f} deg".replace("-", "−"), "ok")
            if name in self._jogged
            else (name, "not moved yet", "")
            for name in self.model.names
        ]
        left = next((name for name in self.model.names if name not in self._jogged), "")
        return Told(self.stage, text, "Done", "" if self._jogged else "move one joint first", left, rows)

    def _told_done(self) -> Told:
        names = ", ".join(self._jogged)
        text = (
            f"This arm is ready: {names} moved as asked, and it holds. Go to Move for poses, places and programs. "
            "Torque stays as it is; hold the arm before you switch it off."
        )
        return Told(self.stage, text)
