"""What the owner of a robot sends to it: targets once per period, stops, torque, resets.

Owns the reaction to a refused target, the rule that a target decided before a stop is not sent, and until when the
joints move to what was sent. Must not know connections or threads: one thread makes all calls, except `begin` and
`send`.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext, suppress
from typing import TYPE_CHECKING

from hexwire.drivers.abilities import RefilledPaths
from hexwire.errors import (
    CommandRefusedError,
    HexwireError,
    LeaseError,
    PreemptedError,
    StoppedError,
    UsageError,
)
from hexwire.model.state import JointFlag, JointTarget, SentTarget
from hexwire.motion.safety import STOP_COMMAND, TORQUE_OFF, StopReason, board_stop

from ..motion.onboard_execution import OnboardExecution
from .rate import Periodic

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.drivers.timed_path import PathStart
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

    from .group import ControllerGroup

__all__ = ["SETTLING", "Output"]

_log = logging.getLogger(__name__)

SETTLING = 0.2
"""Seconds after a target's duration in which its servos may still move."""


class Output:
    """Sends the decisions of the controllers to an attached robot.

    Args:
        robot: The robot.
        group: Its controllers.
        borrowed: As in `RobotOwner`: a target is sent after every state, and errors are raised to the caller.
        on_sent: Called with every target as sent.
        look_again: Reads a new state after a change and drops earlier ones.
        arm_watchdog: Called before every target: arms the watchdog, if it is wanted and not armed yet.
        asked: As in `RobotOwner`.
        clock: As in `RobotOwner`.
        sleep: As in `RobotOwner`.
        timed: As in `RobotOwner`.

    Attributes:
        before: Called before targets are decided; may end motions.
        refusal: Returns the error with which a target of the controllers is refused right before it is sent.
    """

    def __init__(
        self,
        robot: RobotDriver,
        group: ControllerGroup,
        *,
        borrowed: bool,
        on_sent: Callable[[SentTarget], object],
        look_again: Callable[[], object],
        arm_watchdog: Callable[[], object],
        asked: Token | None = None,
        clock: Callable[[], float] | None = None,
        sleep: Callable[[float], object] = time.sleep,
        timed: bool = False,
    ) -> None:
        self._robot, self._group, self._borrowed = robot, group, borrowed
        self._on_sent, self._look_again, self._arm_watchdog = on_sent, look_again, arm_watchdog
        self._clock = clock or robot.now
        self._onboard: OnboardExecution | None = None
        if timed:
            self._onboard = OnboardExecution(
                robot, group, clock=self._clock, sleep=sleep, arm_watchdog=arm_watchdog
            )
        self.before: Callable[[], object] = lambda: None
        self.refusal: Callable[[], HexwireError | None] | None = None
        # When each joint has reached its last target, owner's clock; infinite if only a special command knows.
        self._ends: dict[str, float] = {}
        self._periodic = Periodic()
        self._clamped = frozenset[str]()
        # The last stop that the controllers know of. Targets decided before a newer one must not be sent.
        self._known_stop = asked or robot.epochs.mark()
        self.deciding = threading.RLock()
        """Lock held from the decision on a target until it was sent. A stop does not wait for it."""

    def hurry(self) -> None:
        """Send a target after the next state, if none was sent for a period."""
        self._periodic.hurry()

    def begin(self, state: JointState, period: float, lead: float) -> None:
        """Send the first target of a motion that has begun, if none was sent for a period; in any thread.

        Args:
            state: The newest one; the controllers have judged it.
            period: As in `update`.
            lead: As in `update`.

        Raises:
            HexwireError: As `RobotDriver.write`.
        """
        with self.deciding:
            self._periodic.hurry()
            self._update(state, None, self._clock(), period, lead)

    def update(self, state: JointState, speeds: Sequence[float], now: float, period: float, lead: float) -> None:
        """Pass a state to the controllers; once per period, write their target.

        Args:
            state: Just read.
            speeds: Velocities of its joints, radians per second; NaN if unknown.
            now: Seconds.
            period: Seconds between two targets.
            lead: Duration of a target, seconds.
        """
        with self.deciding:
            self._update(state, speeds, now, period, lead)

    def running(self) -> tuple[str, ...]:
        """Joints that are moving to their last target or on a path of the robot, or may be."""
        now = self._clock()
        moving = {name for name, ends in self._ends.items() if now < ends}
        if self._onboard is not None:
            moving.update(self._onboard.joints)
        return tuple([name for name in self._robot.model.names if name in moving])

    def time_left(self) -> float:
        """Seconds until the last joint has reached its last target; 0 if none moves to one."""
        known = [ends for ends in self._ends.values() if ends < math.inf]
        left = max(0.0, max(known, default=0.0) - self._clock())
        return left if self._onboard is None else max(left, self._onboard.feeder.time_left())

    @property
    def path_start(self) -> PathStart | None:
        """When the path that the robot follows, or waits to follow, starts; None if there is none."""
        return None if self._onboard is None else self._onboard.feeder.start.given

    def brake(self) -> tuple[str, ...]:
        """Bring joints on a path of the robot to rest on it; returns them. Raises as `RobotOwner.brake`."""
        with self.deciding:
            return () if self._onboard is None else self._onboard.brake()

    def forget_path(self) -> None:
        """Forget a path of the robot, which was lost."""
        if self._onboard is not None:
            self._onboard.drop()

    def set_free(self) -> None:
        """Count all joints as moving until each gets a target, holds, or was stopped."""
        self._ends = dict.fromkeys(self._robot.model.names, math.inf)

    def _note(self, sent: SentTarget | JointTarget) -> None:
        ends = self._clock() + sent.duration + SETTLING
        for name, _ in sent.positions:
            self._ends[name] = ends

    def _update(
        self, state: JointState, speeds: Sequence[float] | None, now: float, period: float, lead: float
    ) -> None:
        self.before()
        # Before anything is decided: a stop from here on voids the target, even if it is resumed.
        asked = self._robot.epochs.mark()
        stopped = asked.epoch is not self._known_stop.epoch
        # The one motion of a borrowed robot would give the joints torque again; `torque` releases other motions.
        limp = self._borrowed and asked.limp is not self._known_stop.limp
        if stopped or limp:
            self._known_stop = asked
            # A borrowed robot runs one motion: a stop ends it even if nothing of it was sent yet.
            if (self._group.moving or self._borrowed) and self._group.reason is None:
                if not stopped:
                    # A state from after it says which joints have lost it.
                    self._group.cycle(self._robot.read(), speeds, now, lead, due=False)
                self._group.stop(StopReason("board", STOP_COMMAND if stopped else TORQUE_OFF))
                # Which voids what was asked for before; nothing has been decided yet.
                asked = self._robot.epochs.mark()
        # The states of a borrowed robot are read once per period.
        due = self._periodic.due(now, period) or self._borrowed
        order = self._group.cycle(state, speeds, now, lead, due=due)
        if isinstance(order, StopReason):
            self.stop(order)
            return
        if order is not None:
            self._periodic.done(now)
        if self._onboard is not None:
            # What was decided for joints whose path ends in this turn is void.
            kept = self._onboard.joints
            # A change must reach the robot sooner than the next target is due.
            if due or self._onboard.changed:
                self._execute_onboard(self._onboard, state, period, asked)
            order = order if order is None else self._without(order, {*kept, *self._onboard.joints})
        if order is not None:
            self._write(order, asked, now + lead)

    def _execute_onboard(self, onboard: OnboardExecution, state: JointState, period: float, asked: Token) -> None:
        if RefilledPaths.find(self._robot) is None:
            return
        epochs = self._robot.epochs
        try:
            epochs.check(asked, "a path")
            with epochs.using(asked._replace(refusal=self.refusal)):
                found = onboard.turn(state, period)
        except StoppedError:
            onboard.drop()
            self._group.see_stop(board_stop(self._robot.read()) or StopReason("board", STOP_COMMAND))
            return
        except LeaseError as error:
            # The robot is not lost: it goes on along its path until it is told to come to rest.
            if not self._ended_with_lease(error):
                raise
            return
        if found is None:
            return
        if found.joint:
            self.stop(found)
        else:
            if self._group.reason is None:
                self.tell(logging.WARNING, "stopped: %s", found)
            self._group.see_stop(found)

    def _refusal(self, ends: float) -> Callable[[], HexwireError | None] | None:
        """Why a target that should end at a time must not leave. That of a brake may, until the joints rest."""
        refusal = self.refusal
        if refusal is None or self._group.moving:
            return refusal
        return lambda: refusal() if self._clock() > ends else None

    def _ended_with_lease(self, error: HexwireError) -> bool:
        """End the motions if the right to move has ended since `before` was asked; else the robot refused."""
        if not isinstance(error, LeaseError) or self.refusal is None or self.refusal() is None:
            return False
        self.before()
        return True

    def _without(self, order: JointTarget, joints: Collection[str]) -> JointTarget | None:
        """What of a target must be sent, since the robot does not know it yet."""
        kept = tuple([pair for pair in order.positions if pair[0] in joints])
        if not kept:
            return order
        ends = self._clock() + order.duration + SETTLING
        self._ends.update(dict.fromkeys([name for name, _ in kept], ends))
        self._on_sent(SentTarget(kept, order.duration))
        return order.part([name for name, _ in order.positions if name not in joints])

    def _write(self, target: JointTarget, asked: Token, ends: float) -> None:
        epochs = self._robot.epochs
        try:
            epochs.check(asked, "a target")
            with epochs.using(asked):
                self._arm_watchdog()
            with epochs.using(asked if self.refusal is None else asked._replace(refusal=self._refusal(ends))):
                sent = self._robot.write(target)
        except (CommandRefusedError, UsageError) as error:
            # A robot may say first that a joint has no torque.
            limp = epochs.limp_since(asked)
            if isinstance(error, StoppedError) or (limp and self._borrowed):
                # States that are waiting may be older, for example after a stall in which the watchdog tripped.
                why = TORQUE_OFF if limp else STOP_COMMAND
                self._group.see_stop(board_stop(self._robot.read()) or StopReason("board", why))
                return
            if self._borrowed:
                raise
            # For example after another program switched torque off: the motion is over, its set-points are void.
            if not self._ended_with_lease(error):
                _log.error("%s", error)
            self._group.release(str(error))
        else:
            clamped = frozenset(sent.clamped)
            if not clamped <= self._clamped:
                text = "the board's own limits are tighter: it clamped %s"
                self.tell(logging.WARNING, text, ", ".join(clamped))
            self._clamped = clamped
            self._note(sent)
            self._on_sent(sent)

    def send(self, target: JointTarget, asked: Token, *, holds: bool = False) -> SentTarget:
        """Send a target that no controller has decided; the controllers of its joints end their motions.

        Args:
            target: Checked by the caller.
            asked: When it was asked for; a stop since then cancels it.
            holds: It ends the motion of its joints where they are: from then on they count as at rest.

        Raises:
            StoppedError: The arm is stopped, or was stopped since.
            HexwireError: As `RobotDriver.write`.
        """
        with self.deciding:
            epochs = self._robot.epochs
            if self._group.reason is not None:
                raise StoppedError.unsent("a target", 0, f"the arm is stopped ({self._group.reason}); resume first")
            epochs.check(asked, "a target")
            # Also those at rest: what they were told before is not where their joints will be.
            self._group.release("another motion was asked for", [name for name, _ in target.positions])
            if self._onboard is not None and self._onboard.joints:
                with epochs.using(asked):
                    self._onboard.brake([name for name, _ in target.positions])
            try:
                with epochs.using(asked):
                    sent = self._robot.write(target)
            except (CommandRefusedError, UsageError):
                raise
            except HexwireError:
                # No answer: the robot may have received the target nevertheless.
                self._note(target)
                raise
            if holds and not sent.silent:
                for name, _ in sent.positions:
                    self._ends.pop(name, None)
            else:
                self._note(sent)
            self._on_sent(sent)
            return sent

    def reset(self, asked: Token) -> None:
        """Clear a stop, unless its cause persists or there was another stop.

        Args:
            asked: The time of the request, a mark of the robot's stops.

        Raises:
            UsageError: The stop was not cleared.
        """
        if self._group.reason is not None:
            # The stop has ended it, perhaps after the last turn.
            self.forget_path()
        state = self._robot.read()
        suspects = [joint for joint in state if joint.name in self._group.blamed]
        faults = [(joint.name, JointFlag(joint.flags).faults) for joint in suspects]
        if blamed := [f"{name} still reports {fault}" for name, fault in faults if fault]:
            # A servo reports an overload until its next command. This one holds; the next reset sees the result.
            self._robot.stop()
            raise UsageError(f"{', '.join(blamed)}; remove the cause, and reset again")
        if state.stopped and not self._robot.epochs.failed:
            # The stop has ended all motions.
            self._ends = {}
        try:
            self._robot.resume()
        except StoppedError as error:
            raise UsageError("the arm was stopped again; reset it again") from error
        if not self._group.reset(asked):
            # The latest stop must stay in effect.
            self._robot.stop()
            raise UsageError("the arm was stopped again; reset it again")
        self._known_stop = self._robot.epochs.mark()
        self._look_again()

    def torque(self, on: bool, names: Sequence[str]) -> tuple[str, ...]:
        """Switch torque on, at the present position, or off; returns the joints that confirmed it."""
        if on and self._group.reason is not None:
            raise UsageError(f"the arm is stopped ({self._group.reason}); reset it first")
        wanted = list(names)
        if on and (self._group.busy or (self._onboard is not None and self._onboard.joints)):
            # Torque on means to hold the present position: it must not stop joints that are moving.
            have = set(self._robot.read().torque_on)
            wanted = [name for name in names if name not in have]
        if on and self._onboard is not None:
            # A robot refuses it for joints that leave a path.
            self._onboard.brake(wanted)
        why = "one of its joints had no torque" if on else "torque was switched off"
        if not on:
            self._group.release(why, wanted)
        whom = None if len(wanted) == len(self._robot.model.names) else wanted
        confirmed = self._robot.torque(on, whom) if wanted else ()
        # Once more, for goals accepted meanwhile: set-points are void where a hand may move the joint.
        self._group.release(why, wanted)
        # The next goal must see the new torque. After a stop, which may interrupt this, a reset looks again.
        with nullcontext() if on else suppress(StoppedError, PreemptedError):
            self._look_again()
        return tuple(name for name in names if name in confirmed or name not in wanted)

    def stop(self, reason: StopReason) -> None:
        """Stop the controllers and the robot."""
        self._group.announce(reason)
        try:
            self.tell(logging.ERROR, "stopped: %s", reason)
            confirmed = self._robot.stop()
        finally:
            self._group.settle()
        if missing := [name for name in self._robot.model.names if name not in confirmed]:
            self.tell(logging.ERROR, "%s did not confirm the stop", ", ".join(missing))

    def tell(self, level: int, text: str, *values: object) -> None:
        """Log; only at debug level with a borrowed robot, whose caller gets the error."""
        _log.log(logging.DEBUG if self._borrowed else level, text, *values)
