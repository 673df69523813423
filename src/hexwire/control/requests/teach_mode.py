"""Teach mode: switches torque off, records the motion of the arm by hand, and switches torque on again.

Owns when an arm is guided by hand, the recording of that motion, its simplification to a trajectory small enough to
send, its file, and the last result. Must not know messages, nor what else moves the arm: that belongs to its owner,
which asks here first.
"""

from __future__ import annotations

import json
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.folders import make_folder
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.teach import Taught
from hexwire.new_file import OutputFile

from ..loop.known_state import SampleClock
from ..loop.owner import RobotOwner
from ..loop.power import switch_torque
from ..motion.goals import Point

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

__all__ = [
    "TOLERANCE",
    "HandGuiding",
    "Recorder",
    "TeachMode",
    "Teacher",
    "record_by_hand",
    "save",
    "to_points",
    "tolerance_of",
]

TOLERANCE = math.radians(0.2)
"""Radians by which a simplified trajectory may miss a sample: two counts of a servo with 4096 per turn."""

_RATE = 50
"""Samples per second: the motion of a hand has no components above 10 Hz."""
_DIGITS = 6
"""Decimals of seconds and radians that are sent and written: finer than a hundredth of a servo's count."""


class Teacher:
    """Records the states of an arm that is guided by hand, at most 50 per second.

    One thread may pass states while others start and finish the recording.

    Args:
        limit: Longest recording, seconds.

    Attributes:
        limit: As above.
        active: It is recording.
        full: The limit has been reached; what was recorded until then is kept.
    """

    def __init__(self, limit: float = 600.0) -> None:
        self.limit = limit
        self.active = False
        self.full = False
        self._names: tuple[str, ...] = ()
        self._start = 0.0
        self._clock = SampleClock()
        self._slot = -math.inf
        self._samples: list[tuple[float, tuple[float, ...]]] = []
        self._lock = threading.Lock()

    def start(self, names: Sequence[str], now: float) -> None:
        """Start a recording; the previous one is dropped.

        Args:
            names: Joints to record.
            now: The clock of the states' `stamp`; samples from before do not count.

        Raises:
            UsageError: No joint is named, or one twice.
        """
        if not names or len(set(names)) != len(names):
            raise UsageError(f"joints to teach must be named once each, not {', '.join(names) or 'none at all'}")
        with self._lock:
            self.active, self.full = True, False
            self._names = tuple(names)
            self._start = now
            self._clock, self._slot, self._samples = SampleClock(), -math.inf, []

    def take(self, state: JointState) -> None:
        """Take a state; harmless when not recording. A state that lacks one of the joints is skipped.

        Its time is that of its newest sample. Of several states within a fiftieth of a second the first is kept.
        """
        # Another thread may start or finish the recording meanwhile.
        with self._lock:
            if self.active and not self.full:
                self._take(state)

    def _take(self, state: JointState) -> None:
        when = self._clock.time(state)
        if state.stamp - self._start > self.limit:
            self.full = True
            return
        try:
            places = [state.names.index(name) for name in self._names]
        except ValueError:
            return
        row = tuple([state.position[i] for i in places])
        ages = [state.age[i] for i in places]
        if any(state.flags[i] & JointFlag.SILENT for i in places) or not all(map(math.isfinite, (*row, *ages))):
            return
        age = min(ages)
        if state.stamp - age < self._start:
            return
        slot = math.floor((when - age) * _RATE)
        if slot > self._slot:
            self._slot = slot
            self._samples.append((when - age, row))

    def finish(self) -> Taught:
        """End the recording.

        Returns:
            The unchanged recording: smooth it, play it, or simplify it with `to_points`.

        Raises:
            UsageError: Fewer than two samples.
        """
        with self._lock:
            samples, self._samples = self._samples, []
            self.active = False
        if len(samples) < 2:
            raise UsageError(
                "nothing was recorded: start teaching, move the arm, stop teaching; every joint's servo must answer"
            )
        return Taught.of(self._names, samples)


def tolerance_of(model: ArmModel) -> float:
    """Tolerance for an arm, radians: more for servos with coarse counts, whose noise would otherwise be kept."""
    return max(TOLERANCE, 1.2 * max((joint.scale for joint in model.joints), default=0.0))


def to_points(taught: Taught, tolerance: float = TOLERANCE) -> tuple[Point, ...]:
    """Points of a trajectory that is linear between them and misses no sample by more than `tolerance`.

    Ten minutes of samples are 30,000 points: more than a viewer or a controller's goal should have to carry, and
    most of them lie on the line between their neighbours. The points to keep are found in one pass: from the last
    point kept, each sample leaves a cone of slopes that pass it closely enough, and a sample outside a joint's cone
    means that the one before it must be kept. This takes the same time for every sample, whereas the algorithm of
    Ramer, Douglas and Peucker takes the square of their number for some motions; it keeps the same tolerance with
    slightly more points.

    The points have no velocities: through points so far apart, a cubic would swing beyond the tolerance.

    Args:
        taught: What was recorded.
        tolerance: Radians, for each joint by itself.

    Returns:
        Points with times from 0, the first and last sample among them; one for a recording of one sample.
    """
    times, rows = taught.times, taught.rows
    kept = [0]
    low, high = _open_cone(taught)
    for i in range(1, len(times)):
        # A sample right after the kept one is inside the cone, which is still open.
        anchor, start = times[kept[-1]], rows[kept[-1]]
        long = times[i] - anchor
        slopes = [(b - a) / long for a, b in zip(start, rows[i], strict=True)]
        if not all(a <= slope <= b for a, slope, b in zip(low, slopes, high, strict=True)):
            kept.append(i - 1)
            low, high = _open_cone(taught)
            long = times[i] - times[i - 1]
            slopes = [(b - a) / long for a, b in zip(rows[i - 1], rows[i], strict=True)]
        width = tolerance / long
        low = [max(a, slope - width) for a, slope in zip(low, slopes, strict=True)]
        high = [min(b, slope + width) for b, slope in zip(high, slopes, strict=True)]
    if len(times) > 1:
        kept.append(len(times) - 1)
    return tuple(
        Point(round(times[i], _DIGITS), tuple([round(value, _DIGITS) + 0.0 for value in rows[i]])) for i in kept
    )


def _open_cone(taught: Taught) -> tuple[list[float], list[float]]:
    return [-math.inf] * len(taught.names), [math.inf] * len(taught.names)


def save(taught: Taught, folder: Path, when: datetime, *, tolerance: float = TOLERANCE) -> Path:
    """Write a file that `hexwire play` takes: the points of `to_points` in the form of a joint trajectory.

    A write that fails leaves nothing behind, and no other file is overwritten.

    Args:
        taught: What was recorded.
        folder: Where to write it; created if missing.
        when: Gives the file its name, ``taught-20240131-235959.json``.
        tolerance: Of `to_points`.

    Returns:
        The file's path.

    Raises:
        HexwireError: It cannot be written.
    """
    points = [{"time_from_start": p.time, "positions": p.positions} for p in to_points(taught, tolerance)]
    text = json.dumps({"joint_names": taught.names, "points": points}, separators=(",", ":"), allow_nan=False)
    # One line per point, for readers and diff.
    text = text.replace('{"time_from_start"', '\n{"time_from_start"') + "\n"
    try:
        make_folder(folder)
        with _reserve(folder, f"taught-{when:%Y%m%d-%H%M%S}") as out:
            out.file.write(text.encode())
    except (OSError, UsageError) as error:
        raise HexwireError(
            f"what was taught cannot be saved in {folder} ({getattr(error, 'strerror', None) or error}); "
            "name a folder that this user may write to, on a disk with room"
        ) from error
    return out.path


def _reserve(folder: Path, stem: str) -> OutputFile:
    """Create a file with an unused name."""
    for i in count(1):
        path = folder / (f"{stem}.json" if i == 1 else f"{stem}-{i}.json")
        if os.path.lexists(path):
            continue
        try:
            return OutputFile(path)
        except UsageError:
            # Another program may have created it first.
            if not os.path.lexists(path):
                raise
    raise AssertionError("unreachable")


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
        owner.observe(recorder.take)

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
    """Teach mode of an arm. Any thread may call these; `hand.start` and `stop` one at a time.

    Args:
        owner: Owner of the robot.
        folder: Folder for recordings; empty to save none.
        on_taught: Called with each recording, in the thread that ended it.

    Attributes:
        taught: The last recording, or None.
        hand: The hand guiding, which begins it, and has the lock for torque.
    """

    def __init__(self, owner: RobotOwner, folder: str, on_taught: Callable[[Taught], object]) -> None:
        self.taught: Taught | None = None
        self._owner, self._folder, self._on_taught = owner, folder, on_taught
        self._teacher = Teacher()
        self.hand = HandGuiding(owner, self._teacher)

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
