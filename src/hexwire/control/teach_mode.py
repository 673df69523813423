"""Teach mode: switches torque off, records the motion of the arm by hand, and switches torque on again.

Owns when an arm is guided by hand, the recording of that motion, and the last result. Must not know what else moves
the arm: that belongs to its owner, which asks here first.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.model.state import JointFlag

from .owner import RobotOwner
from .power import switch_torque
from .teaching import Teacher, save, tolerance_of

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught

__all__ = ["HandGuiding", "Recorder", "TeachMode", "record_by_hand"]

_log = logging.getLogger(__name__)

_MAY_HAVE_TORQUE = JointFlag.TORQUE_ON | JointFlag.TORQUE_UNKNOWN
_PATIENCE = 0.5
"""Seconds for which a stop waits until nobody begins or ends teach mode at this moment."""
_TREMOR = 0.1
"""Seconds on either side over which taught positions are smoothed."""


class Recorder(Protocol):
    """Records the states of an arm that is guided by hand."""

    def start(self, names: Sequence[str], now: float) -> None:
        """Start recording these joints; `now` is the clock of the states' `stamp`."""

    def take(self, state: JointState) -> None:
        """Take a state; harmless when not recording."""


class HandGuiding:
    """Joints guided by hand: without torque and recorded meanwhile, held afterwards.

    Any thread may call these; `start` and `stop` one at a time.

    Args:
        owner: Owner of the robot.
        recorder: Takes the robot's states.

    Attributes:
        active: The joints are guided by hand, or are about to be. Set under the controllers' lock.
        power: Held while torque is switched and while it is checked that this is allowed.
    """

    def __init__(self, owner: RobotOwner, recorder: Recorder) -> None:
        self.active = False
        self.power = threading.Lock()
        self._owner, self._recorder = owner, recorder
        self._names: tuple[str, ...] = ()
        owner.observers.append(recorder.take)

    def refuse(self) -> None:
        """Refuse motion and torque while the arm is in teach mode.

        Raises:
            UsageError: The arm is in teach mode.
        """
        if self.active:
            raise UsageError("the arm is in teach mode; end teach mode first")

    def start(self, names: Sequence[str]) -> None:
        """Switch the torque of joints off and record their motion by hand.

        Raises:
            HexwireError: The arm moves, is stopped or cannot be reached, or a joint kept its torque.
        """
        owner = self._owner
        with self.power:
            self.refuse()
            state = owner.newest()
            with owner.locked():
                reason = owner.group.reason
                if reason is not None:
                    raise UsageError(f"the arm is stopped ({reason}); reset it first")
                if owner.group.busy:
                    raise UsageError("the arm is moving; wait, or cancel the goal first")
                # From here on, motions are refused.
                self.active = True
            self._names = tuple(names)
            # A joint whose torque is unknown may have torque.
            had_torque = tuple(name for name in names if state[name].flags & _MAY_HAVE_TORQUE)
            try:
                if had_torque:
                    switch_torque(owner, False, names)
                with owner.locked():
                    if not self.active:
                        raise UsageError("the arm was stopped meanwhile; it has no torque")
                    self._recorder.start(names, owner.now())
            except BaseException:
                self.abandon()
                if had_torque:
                    # Refused if a stop is the cause.
                    with suppress(HexwireError):
                        owner.torque(True, had_torque)
                raise

    def stop(self, end: Callable[[], object], *, hold: bool = True) -> None:
        """End hand guiding: its joints hold their present position, whatever was recorded or had torque before.

        Args:
            end: Ends the recording.
            hold: False leaves the torque off.

        Raises:
            HexwireError: The arm is not in teach mode, or a joint got no torque.
        """
        with self.power:
            if not self.active:
                raise UsageError("the arm is not in teach mode; start teach mode first")
            end()
            try:
                if hold:
                    # In any case: no person should have to keep holding the arm.
                    switch_torque(self._owner, True, self._names)
            finally:
                self.active = False

    def abandon(self) -> bool:
        """End hand guiding because of a stop: torque stays off. Returns whether it was active."""
        # A stop waits for nobody for ever.
        lock = self._owner.locked()
        held = lock.acquire(timeout=_PATIENCE)
        try:
            was, self.active = self.active, False
        finally:
            if held:
                lock.release()
        return was


class _Passing:
    """Passes every state on between `start` and `stop`."""

    def __init__(self, record: Callable[[JointState], object]) -> None:
        self._record, self._active = record, False

    def start(self, names: Sequence[str], now: float) -> None:
        self._active = True

    def take(self, state: JointState) -> None:
        if self._active:
            self._record(state)

    def stop(self) -> None:
        self._active = False


def record_by_hand(
    robot: RobotDriver,
    record: Callable[[JointState], object],
    *,
    rate: float = 0.0,
    duration: float = math.inf,
    torque_off_at_end: bool = False,
    on_start: Callable[[], object] = lambda: None,
    ended: Callable[[], bool] = lambda: False,
    sleep: Callable[[float], object] = time.sleep,
) -> None:
    """Switch an arm's torque off, record its states for a time or until Ctrl-C, then hold the arm.

    Torque is switched on again however the recording ends. Somebody must hold the arm meanwhile.

    Args:
        robot: Attached, without another owner.
        record: Called with every state.
        rate: States per second; 0 for the robot's command rate.
        duration: Seconds.
        torque_off_at_end: Leave the torque off at the end. Otherwise all joints hold their position then, also
            those that had no torque before, unless torque was switched off once more meanwhile.
        on_start: Called once the arm has no torque.
        ended: Called after each state: whether the recording ends.
        sleep: Waits for so many seconds.

    Raises:
        HexwireError: A joint kept its torque, got it from elsewhere meanwhile, or got none at the end; or the robot
            failed.
    """
    names = robot.model.names
    # A failure must not latch a stop, which would refuse the torque. Nor must a watchdog.
    owner = RobotOwner(robot, borrowed=True, command_rate=rate, watchdog=0.0, stop_on_failure=False, sleep=sleep)
    passing = _Passing(record)
    guiding = HandGuiding(owner, passing)
    with owner:
        # An invalid rate is refused while the arm still has its torque.
        owner.turn()
        guiding.start(names)
        begun = robot.epochs.mark()
        try:
            on_start()
            with suppress(KeyboardInterrupt):
                _turn_for(owner, duration, ended)
        finally:
            # A robot that failed may answer again.
            owner.connect()
            guiding.stop(passing.stop, hold=not (torque_off_at_end or robot.epochs.limp_since(begun)))


def _turn_for(owner: RobotOwner, duration: float, ended: Callable[[], bool]) -> None:
    """Run the owner's loop for so many seconds or until it is ended, at least one turn."""
    timing = owner.timing
    _turn_guided(owner)
    # Slightly less, so that 0.3 s of 0.1 s periods are three states and not four.
    end = timing.due + duration - (1.0 + 1e-6) * timing.period
    while timing.due < end and not ended():
        _turn_guided(owner)


def _turn_guided(owner: RobotOwner) -> None:
    owner.turn()
    # A person holds the arm and must know that another program is about to move it.
    state = owner.state
    if state is not None and (on := state.torque_on):
        raise ServoError(f"torque of {', '.join(on)} was switched on from elsewhere; the recording ends")


class TeachMode:
    """Teach mode of an arm. Any thread may call these; `start` and `stop` one at a time.

    Args:
        owner: Owner of the robot.
        folder: Folder for recordings; empty to save none.
        on_taught: Called with each recording, in the thread that ended it.

    Attributes:
        taught: The last recording, or None.
        hand: The hand guiding, which has the lock for torque.
    """

    def __init__(self, owner: RobotOwner, folder: str, on_taught: Callable[[Taught], object]) -> None:
        self.taught: Taught | None = None
        self._owner, self._folder, self._on_taught = owner, folder, on_taught
        self._teacher = Teacher()
        self.hand = HandGuiding(owner, self._teacher)

    def start(self, names: Sequence[str]) -> None:
        """As `HandGuiding.start`."""
        self.hand.start(names)

    def stop(self) -> str:
        """End teach mode; its joints hold their present position, also those that had no torque before.

        Returns:
            A description of the recording, for people.

        Raises:
            HexwireError: Not in teach mode; nothing was recorded, and the recording before is kept; a joint has no
                torque, or the file cannot be written, and the recording is kept nevertheless.
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
        """End teach mode because of a stop: the recording ends, and torque stays off."""
        if self.hand.abandon():
            with suppress(UsageError):
                self._teacher.finish()

    def shutdown(self, *, hold: bool) -> None:
        """End teach mode because the program ends; what was recorded is dropped. Harmless outside teach mode.

        Args:
            hold: The joints hold their present position.
        """
        try:
            if self.hand.active:
                self.hand.stop(lambda: None, hold=hold)
        except HexwireError as error:
            _log.error("the arm has no torque after teach mode: %s", error)

    def _end(self, faults: list[str]) -> Taught | None:
        taught: list[Taught] = []

        def finish() -> None:
            try:
                recording = self._teacher.finish()
                if not recording.moves:
                    raise UsageError(
                        "nothing was recorded: no joint moved; start teaching, move the arm, stop teaching"
                    )
                taught.append(recording)
            except UsageError as error:
                faults.append(str(error))

        try:
            self.hand.stop(finish)
        except HexwireError as error:
            faults.append(str(error))
        return taught[0] if taught else None

    def _keep(self, taught: Taught) -> str:
        # Remove the tremor of the hand.
        taught = self.taught = taught.without_stillness().smoothed(_TREMOR)
        self._on_taught(taught)
        words = f"taught {taught.duration:.1f} s, {len(taught.times)} points"
        if self._folder:
            tolerance = tolerance_of(self._owner.model)
            words += f", saved as {save(taught, Path(self._folder), datetime.now(), tolerance=tolerance)}"
        return words
