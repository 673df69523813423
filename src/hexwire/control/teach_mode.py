"""Teaching by hand: an arm without torque, what is recorded meanwhile, and the torque given back.

Owns when an arm is in somebody's hands, and what was taught last. Must not know who wants the arm
otherwise: that is the owner's business, who asks here first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, UsageError

from .power import give_torque, switch_torque
from .teaching import Teacher, save, tolerance_of

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.motion.teach import Taught

    from .owner import RobotOwner

__all__ = ["TeachMode", "hand_guided"]

_TREMOR = 0.1
"""Seconds to either side over which taught positions are smoothed."""


@contextmanager
def hand_guided(robot: RobotDriver, *, limp: bool = False) -> Iterator[None]:
    """In this context the joints have no torque, so that a hand can lead the arm. Somebody must hold it.

    Args:
        robot: Attached, and nobody else's.
        limp: Leave the torque off at the end; else the joints hold where they are then.

    Raises:
        ServoError: A joint got no torque at the end.
    """
    robot.torque(False)
    try:
        yield
    finally:
        if not limp:
            give_torque(robot, robot.model.names, robot.read())


class TeachMode:
    """What hands teach an arm. Any thread may call these; `start` and `stop` one at a time.

    Args:
        owner: The robot.
        folder: Where to save what is taught; empty for nowhere.
        on_taught: Called with what was taught, in the thread that ended it.

    Attributes:
        taught: What was taught last, or None.
        power: Held by whoever switches torque and looks first whether that is right.
    """

    def __init__(self, owner: RobotOwner, folder: str, on_taught: Callable[[Taught], object]) -> None:
        self.taught: Taught | None = None
        self.power = threading.Lock()
        self._owner, self._folder, self._on_taught = owner, folder, on_taught
        self._teacher = Teacher()
        # The joints are, or are about to be, in somebody's hands. Set under the controllers' lock.
        self._active = False
        self._had_torque: tuple[str, ...] = ()
        owner.observers.append(self._teacher.take)

    def refuse(self) -> None:
        """Nothing may move, nor get torque, while somebody holds the arm.

        Raises:
            UsageError: Somebody does.
        """
        if self._active:
            raise UsageError("the arm is being taught; end that first")

    def start(self, names: Sequence[str]) -> None:
        """Take the torque of joints away and take down where a hand leads them.

        Raises:
            HexwireError: Something moves, or the arm is stopped or cannot be reached, or a joint kept its torque.
        """
        owner = self._owner
        with self.power:
            self.refuse()
            torque = owner.newest().torque_on
            with owner.locked():
                reason = owner.group.reason
                if reason is not None:
                    raise UsageError(f"the arm is stopped ({reason}); reset it first")
                if owner.group.busy:
                    raise UsageError("the arm is moving; wait, or cancel the goal first")
                # From here on nothing is accepted that would move it.
                self._active = True
            self._had_torque = tuple(name for name in names if name in torque)
            try:
                if self._had_torque:
                    switch_torque(owner, False, names)
                with owner.locked():
                    if not self._active:
                        raise UsageError("the arm was stopped meanwhile; it has no torque")
                    self._teacher.start(names, owner.now())
            except BaseException:
                self.abandon()
                if self._had_torque:
                    # Refused if a stop is why.
                    with suppress(HexwireError):
                        owner.torque(True, self._had_torque)
                raise

    def stop(self) -> str:
        """End the lesson; joints that had torque before hold where they are now.

        Returns:
            What was taught, for people.

        Raises:
            HexwireError: There was no lesson, nothing was recorded, a joint got no torque, or the file cannot be
                written. What was recorded is kept all the same.
        """
        faults: list[str] = []
        words = ""
        taught = self._end(faults)
        try:
            words = "" if taught is None else self._keep(taught)
        except HexwireError as error:
            faults.append(str(error))
        if faults:
            raise UsageError("; ".join(filter(None, (words, *faults))))
        return words

    def abandon(self) -> None:
        """As after a stop: the lesson is over, and the torque stays away."""
        with self._owner.locked():
            was, self._active = self._active, False
        if was:
            with suppress(UsageError):
                self._teacher.finish()

    def _end(self, faults: list[str]) -> Taught | None:
        taught = None
        with self.power:
            if not self._active:
                raise UsageError("nothing is being taught; start that first")
            try:
                taught = self._teacher.finish()
            except UsageError as error:
                faults.append(str(error))
            # Whatever was recorded: the arm must not go on hanging on somebody's hands.
            try:
                if self._had_torque:
                    switch_torque(self._owner, True, self._had_torque)
            except HexwireError as error:
                faults.append(str(error))
            self._active = False
        return taught

    def _keep(self, taught: Taught) -> str:
        # A hand trembles.
        taught = self.taught = taught.without_stillness().smoothed(_TREMOR)
        self._on_taught(taught)
        words = f"taught {taught.duration:.1f} s, {len(taught.times)} points"
        if self._folder:
            tolerance = tolerance_of(self._owner.robot.model)
            words += f", saved as {save(taught, Path(self._folder), datetime.now(), tolerance=tolerance)}"
        return words
