"""What the owner of a robot sends to it: targets at their time, stops, torque, resets.

Owns what becomes of a target that is refused, and that none is sent which was decided before a stop. Must not know
connections or threads: one thread calls all of it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from hexwire.errors import CommandRefusedError, StoppedError, UsageError
from hexwire.model.state import JointFlag, JointTarget
from hexwire.motion.safety import StopReason, board_stop

from .rate import Periodic

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState, SentTarget

    from .group import ControllerGroup

__all__ = ["Output"]

_log = logging.getLogger(__name__)


class Output:
    """Sends to an attached robot what its controllers decide.

    Args:
        robot: The robot.
        group: Its controllers.
        borrowed: As in `RobotOwner`: a target goes with every state, and whoever runs this hears of errors itself.
        on_sent: Called with what was really sent.
        look_again: Reads a state after something was done; states from before must not be believed.
    """

    def __init__(
        self,
        robot: RobotDriver,
        group: ControllerGroup,
        *,
        borrowed: bool,
        on_sent: Callable[[SentTarget], object],
        look_again: Callable[[], object],
    ) -> None:
        self._robot, self._group, self._borrowed = robot, group, borrowed
        self._on_sent, self._look_again = on_sent, look_again
        self._periodic = Periodic()
        self._clamped = frozenset[str]()
        # The last stop that the controllers know of. What they were told before a newer one must not be sent.
        self._known_stop = robot.epochs.mark()

    def hurry(self) -> None:
        """Let the next state lead to a target, if there was none for a period."""
        self._periodic.hurry()

    def update(self, state: JointState, speeds: Sequence[float], now: float, period: float, lead: float) -> None:
        """Judge a state; decide and write at the period of targets.

        Args:
            state: Just read.
            speeds: Of its joints, radians per second; NaN where it is not known.
            now: Seconds.
            period: Seconds between two targets.
            lead: Seconds ahead for which a target is sent.
        """
        # Right before anything is decided: a stop that comes from here on voids the target, resumed or not.
        asked = self._robot.epochs.mark()
        if asked.epoch is not self._known_stop.epoch:
            self._known_stop = asked
            if self._group.moving and self._group.reason is None:
                self._group.stop(StopReason("board", "a stop came from elsewhere"))
        # A borrowed robot is asked for its states at that period.
        due = self._periodic.due(now, period) or self._borrowed
        order = self._group.cycle(state, speeds, now, lead, due=due)
        if isinstance(order, StopReason):
            self.stop(order)
        elif order is not None:
            self._periodic.done(now)
            with self._robot.epochs.using(asked):
                self._write(order)

    def _write(self, target: JointTarget) -> None:
        try:
            sent = self._robot.write(target)
        except StoppedError:
            # States that wait to be read may be of a time before, as after a stall in which the watchdog tripped.
            self._group.stop(board_stop(self._robot.read()) or StopReason("board", "the board has stopped the arm"))
        except (CommandRefusedError, UsageError) as error:
            if self._borrowed:
                raise
            # As when somebody else took the torque: this motion is over, and what was commanded means nothing now.
            _log.error("%s", error)
            self._group.release(str(error))
        else:
            clamped = frozenset(sent.clamped)
            if not clamped <= self._clamped:
                text = "the board's own limits are tighter: it kept %s within them"
                self.tell(logging.WARNING, text, ", ".join(clamped))
            self._clamped = clamped
            self._on_sent(sent)

    def reset(self, stops: int) -> None:
        """End a stop, unless its cause is still there or another one came.

        Args:
            stops: What `ControllerGroup.stops` was when it was asked for.

        Raises:
            UsageError: It was not ended.
        """
        suspects = [joint for joint in self._robot.read() if joint.name in self._group.blamed]
        faults = [(joint.name, JointFlag(joint.flags).faults) for joint in suspects]
        if blamed := [f"{name} still reports {fault}" for name, fault in faults if fault]:
            # A servo keeps an overload until its next command. This one holds; the next try shows what is true.
            self._robot.stop()
            raise UsageError(f"{', '.join(blamed)}; see to it, and reset again")
        try:
            self._robot.resume()
        except StoppedError as error:
            raise UsageError("the arm was stopped again meanwhile; reset it again") from error
        if not self._group.reset(stops):
            # Whoever stopped it last must not find it ready to move.
            self._robot.stop()
            raise UsageError("the arm was stopped again meanwhile; reset it again")
        self._known_stop = self._robot.epochs.mark()
        self._look_again()

    def torque(self, on: bool, names: Sequence[str]) -> tuple[str, ...]:
        """Torque on, where the joints are, or off; returns the names of those that confirmed it."""
        if on and self._group.reason is not None:
            raise UsageError(f"the arm is stopped ({self._group.reason}); reset it first")
        wanted = list(names)
        if on and self._group.busy:
            # Torque on is "hold where you are": what has it already and is on its way must not be braked.
            have = set(self._robot.read().torque_on)
            wanted = [name for name in names if name not in have]
        why = "a joint of it had no torque" if on else "the torque was taken away"
        if not on:
            self._group.release(why, wanted)
        whom = None if len(wanted) == len(self._robot.model.names) else wanted
        confirmed = self._robot.torque(on, whom) if wanted else ()
        # What was commanded means nothing where a hand moves the joint; nor does what was accepted in between.
        self._group.release(why, wanted)
        # The next goal must see it.
        self._look_again()
        return tuple(name for name in names if name in confirmed or name not in wanted)

    def stop(self, reason: StopReason) -> None:
        """Stop the robot, and the controllers for this reason."""
        self.tell(logging.ERROR, "stopped: %s", reason)
        self._group.stop(reason)
        confirmed = self._robot.stop()
        if missing := [name for name in self._robot.model.names if name not in confirmed]:
            self.tell(logging.ERROR, "%s did not confirm the stop", ", ".join(missing))

    def tell(self, level: int, text: str, *values: object) -> None:
        """Log, unless the caller hears of it anyway."""
        _log.log(logging.DEBUG if self._borrowed else level, text, *values)
