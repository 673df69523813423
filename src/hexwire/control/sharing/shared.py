"""An arm that several programs use: all read it, the holder of its lease commands it, everybody stops it.

Owns what joins lease and arm: an order is checked and sent in one step, a lost lease holds the arm, and silence of
the holder's program stops it. Must not know how orders arrive: networks, messages, certificates.

Locks, in this order: `RobotOwner.deciding`, then the lease's. A stop takes neither. The lease is checked when an
order is admitted, when the owner decides on targets, and right before the bytes of a target leave, since this
program may have been halted in between.
"""

from __future__ import annotations

import logging
import math
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from hexwire.drivers.abilities import Counters, ServoPing, ServoTables
from hexwire.drivers.values import StopMode
from hexwire.errors import GoalError, LeaseError, NotSupportedError, StoppedError, UsageError

from ..loop.holding import hold_moving, stop_or_log
from ..loop.outcomes import Reason
from ..motion.path_check import PathCheck
from .lease import Lease
from .shared_steps import SteppedTargets

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from hexwire.drivers.base import ProbeReport
    from hexwire.epochs import Token
    from hexwire.model.state import JointTarget, SentTarget

    from ..loop.outcomes import GoalListener
    from ..motion.goals import TrajectoryGoal
    from ..requests.controlled_arm import ControlledArm
    from .lease import Grant, Rank

__all__ = ["Order", "OrderCheck", "SharedArm"]


class Order:
    """What the check of an order needs: its sender, and when it was made and arrived.

    Args:
        key: Key of the sender's lease.
        sequence: Number of the order; each is greater than the last.
        arrived: Token of the robot's epochs at its arrival; a later stop cancels the order.
        made: When it was made, seconds of the owner's clock as the sender estimates it; None for an order that may
            wait.
        doubt: Uncertainty of that time, seconds.
    """

    __slots__ = ("arrived", "doubt", "key", "made", "sequence")

    def __init__(
        self, key: int, sequence: int, arrived: Token, made: float | None = None, doubt: float = 0.0
    ) -> None:
        self.key, self.sequence, self.arrived, self.made, self.doubt = key, sequence, arrived, made, doubt


class OrderCheck:
    """Checks orders against the rules of a lease. Any thread may call its methods.

    Args:
        lease: The rules.
        lock: Guards the rules; it is never held while waiting for the line of the arm.
        clock: The clock of the lease, seconds.
        now: The owner's clock, seconds.
    """

    def __init__(
        self,
        lease: Lease,
        lock: AbstractContextManager[object],
        clock: Callable[[], float],
        now: Callable[[], float],
    ) -> None:
        self._lease, self._lock, self._clock, self._now = lease, lock, clock, now

    def admit(self, order: Order, *, frees: bool = False) -> Grant:
        """Accept an order of the holder; raises `LeaseError`, as `Lease.admit`, which see for `frees`."""
        with self._lock:
            # Not earlier: waiting for the locks makes a set-point older.
            age = None if order.made is None else self._now() - order.made
            return self._lease.admit(order.key, order.sequence, self._clock(), age, order.doubt, frees=frees)

    def refusal(self, key: int) -> LeaseError:
        """Count an order from somebody who does not hold the lease; returns the error for it."""
        with self._lock:
            self._lease.counters.without_lease += 1
            try:
                self._lease.check(key, self._clock())
            except LeaseError as error:
                return error
        return LeaseError("the lease has just changed hands; nothing was done", lost=False)

    def of_targets(self) -> LeaseError | None:
        """Why no controller may send a target now; None if controllers may."""
        if self._lease.is_alive(self._clock()):
            return None
        return LeaseError(self._lease.ended or "nobody holds the lease")

    def token(self, order: Order) -> Token:
        """Token that cancels an admitted order after a stop, the end of the lease, or too long a wait."""

        def refusal() -> LeaseError | None:
            try:
                self._lease.check(order.key, self._clock())
            except LeaseError as error:
                return error
            return None

        return order.arrived._replace(refusal=refusal, late=self._lateness(order))

    def _lateness(self, order: Order) -> Callable[[], LeaseError | None] | None:
        """Check for the age of a set-point until its first bytes leave."""
        made, leaving = order.made, False
        if made is None:
            return None

        def late() -> LeaseError | None:
            nonlocal leaving
            try:
                if not leaving:
                    with self._lock:
                        self._lease.check_age(self._now() - made, order.doubt)
            except LeaseError as error:
                return error
            # Some robots need several packets for a target; half a target is worse than a late one.
            leaving = True
            return None

        return late


_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_LONG = 0.25
"""Seconds; of a target that takes longer the whole path is checked, since it leads far."""
_LOOK = 0.5
"""Longest wait of the supervising thread, seconds."""
_BUSY = 1.0
"""Seconds that a hold or a shutdown waits for an order that is being sent; then it stops, and waits for nothing."""
_PATIENCE = 5.0
"""Time-out for the end of the supervising thread, seconds."""
_WATCHDOG = (0.05, 60.0)
"""Shortest and longest watchdog of a lease, seconds."""


_time: Callable[[], float] = time.monotonic
"""Monotonic seconds; they also pass while the computer is suspended, where the system has such a clock."""
if sys.platform == "linux":
    _time = partial(time.clock_gettime, time.CLOCK_BOOTTIME)


class SharedArm:
    """Any thread may call its methods. Call `start` when the arm was started; finally `shutdown`.

    Args:
        arm: Connected and started by the caller, who also shuts it down.
        lease: The rules of its lease.
        on_change: Called when holder, hold or stop have changed, in the thread that changed them.
        clock: Counts the lease, seconds; by default a clock that also runs while the computer is suspended.

    Attributes:
        arm: The arm that is shared.
        path_check: The checks of a path.
        tripped: The holder's program fell silent, so that the arm was stopped.
        looks: Called by the supervising thread, besides `check`; each returns the seconds until it is due again.
            They must not wait.
    """

    def __init__(
        self,
        arm: ControlledArm,
        lease: Lease | None = None,
        *,
        on_change: Callable[[], object] = lambda: None,
        clock: Callable[[], float] = _time,
    ) -> None:
        self.arm = arm
        self.tripped = False
        self.looks: list[Callable[[], float]] = []
        self._owner, self._robot = arm.owner, arm.owner.robot
        self._lease = lease or Lease()
        self._on_change, self._clock = on_change, clock
        settings = arm.settings
        self.path_check = PathCheck(settings.model, settings.kinematics, settings.table)
        # One stream of set-points, in whatever threads: under `deciding`.
        self._posture = self.path_check.guided()
        # Guards the lease. Taken inside `deciding`, never the other way round.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        # When the last trajectory ends, owner's clock.
        self._followed_until = -math.inf
        self._ending = False
        self._steps = SteppedTargets(self._owner)
        self._orders = OrderCheck(self._lease, self._lock, clock, self._owner.now)
        self._owner.guard(self._expire, self._orders.of_targets)
        self._supervisor = threading.Thread(target=self._supervise, name="lease", daemon=True)

    def start(self) -> None:
        """Start to supervise the lease."""
        self._supervisor.start()

    def shutdown(self) -> None:
        """End the lease and the supervision, and stop the arm if it moves: it holds, with torque.

        Raises:
            HexwireError: The robot did not confirm the stop.
        """
        # An order that is being sent counts as well. If that takes long, the stop does not wait for it.
        decided = self._owner.deciding().acquire(timeout=_BUSY)
        try:
            with self._changed:
                self._ending = True
                self._lease.holder = None
                self._changed.notify_all()
            moving = not decided or self._owner.group.busy or bool(self._owner.running())
        finally:
            if decided:
                self._owner.deciding().release()
        try:
            if moving and self._owner.connected:
                self._owner.stop("the program that shares it ends")
        finally:
            self._end_supervision()

    def _end_supervision(self) -> None:
        if self._supervisor.ident is not None:
            self._supervisor.join(_PATIENCE)

    def now(self) -> float:
        """Time of the owner's clock, seconds."""
        return self._owner.now()

    # -- the lease ------------------------------------------------------------------------------------

    @property
    def holder(self) -> Grant | None:
        """The holder of the lease, or None."""
        return self._lease.holder

    @property
    def holder_name(self) -> str:
        """Who has the lease, or is about to get it while the arm is made to hold; empty if nobody."""
        with self._changed:
            holder = self._lease.holder
            return holder.client if holder is not None else self._lease.heir

    @property
    def held(self) -> str:
        """Why the arm holds, in words: a lost lease; empty if it does not."""
        return self._lease.ended

    @property
    def rules(self) -> Lease:
        """The lease: its times and counters."""
        return self._lease

    def refusals(self) -> dict[str, int]:
        """Numbers of refused orders and ended leases, by name."""
        return {f"lease_{name}": value for name, value in asdict(self._lease.counters).items()}

    def refusal(self, key: int) -> LeaseError:
        """Count an order from somebody who does not hold the lease; returns the error for it."""
        return self._orders.refusal(key)

    def admit(self, order: Order) -> None:
        """Check that an order that moves nothing may be done; raises `LeaseError` if it may not."""
        self._orders.admit(order)

    def is_wanted(self, order: Order) -> bool:
        """Whether an order that was admitted may still be done: the lease lasts, and no stop has come since."""
        return self._robot.epochs.holds(self._orders.token(order))

    @contextmanager
    def explaining(self, order: Order, latest: float = math.inf) -> Iterator[None]:
        """Say why an order was given up in a `with` block: by a stop, the end of the lease, or the time, too late.

        Args:
            order: The order.
            latest: When it must have been checked, seconds of the owner's clock.

        Raises:
            LeaseError: The lease has ended.
            StoppedError: The arm was stopped since.
            GoalError: Of the block; TOO_LATE if `latest` has come.
        """
        try:
            yield
        except GoalError as error:
            if error.reason != Reason.CANCELLED:
                raise
            self._robot.epochs.check(self._orders.token(order), "a trajectory")
            if self.now() < latest:
                raise
            text = "its path could not be checked before it was to begin; nothing was sent"
            raise GoalError(text, reason=Reason.TOO_LATE) from None

    def take(
        self,
        client: str,
        rank: Rank,
        *,
        key: int = 0,
        force: bool = False,
        watchdog: float = 0.0,
        watchdog_mode: StopMode = StopMode.HOLD,
    ) -> Grant:
        """Grant the lease. If another client loses it, the arm holds first. A client that holds the lease keeps it.

        Args:
            client: Name of the client, for display.
            rank: Its rank.
            key: Key of the lease that the client holds; 0 if it has none.
            force: Pre-empt another holder, if the rank permits it.
            watchdog: Seconds without a call of the client's program after which the arm is stopped; 0 for never.
            watchdog_mode: How it is stopped then.

        Raises:
            LeaseError: Another client holds it.
            UsageError: The watchdog is outside 0.05..60 s.
        """
        _check_watchdog(watchdog)
        with self._owner.deciding():
            self._expire()
            with self._changed:
                self._refuse_at_end()
                if (kept := self._lease.keep(key, self._clock())) is not None:
                    kept.watchdog, kept.watchdog_mode = watchdog, watchdog_mode
                    self._changed.notify_all()
                    return kept
                self._lease.check_take(rank, force=force)
                former = self._lease.holder
                why = f"{client} took the lease from {former.client}" if former else ""
                former = self._lease.revoke(why, client)
            if former is not None:
                _log.warning("%s", why)
                self._hold(why)
            with self._changed:
                self._refuse_at_end()
                grant = self._lease.take(client, rank, self._clock())
                grant.watchdog, grant.watchdog_mode = watchdog, watchdog_mode
                self._changed.notify_all()
        self._on_change()
        return grant

    def beat(self, key: int, idle: float) -> Grant:
        """Renew the lease.

        Args:
            key: The holder's.
            idle: Seconds since its program last used the arm.

        Raises:
            LeaseError: The client does not hold it.
        """
        with self._changed:
            return self._lease.beat(key, self._clock(), idle)

    def leave(self, key: int, *, finish: bool) -> None:
        """Give the lease back. Without effect for a former holder.

        Args:
            key: The holder's.
            finish: A motion that the holder began runs to its end; otherwise the arm holds.
        """
        with self._owner.deciding():
            self._expire()
            with self._changed:
                holder = self._lease.holder
                if holder is None or holder.key != key:
                    return
                now = self._clock()
                self._lease.leave(key, now, now + self._remaining() if finish else -math.inf)
                self._changed.notify_all()
            if not finish:
                self._hold(f"{holder.client} gave the lease back")
        self._on_change()

    # -- orders of the holder ---------------------------------------------------------------------------

    def write(self, order: Order, target: JointTarget) -> SentTarget:
        """Send a target; a far one in steps, if the robot has no watchdog.

        Raises:
            LeaseError: The sender does not hold the lease, or the target came too late.
            LimitError: It is outside the limits, or leads the arm into its table or its own limits.
            HexwireError: As `RobotOwner.send`.
        """
        owner = self._owner
        with owner.deciding():
            # Before the check, so that an order without a lease costs little; and nothing comes between it and
            # the sending, since a loss of the lease waits for `deciding`.
            self._orders.admit(order)
            here = owner.newest().positions
            self._check_path(target, here)
            return self._steps.send(target, here, self._orders.token(order))

    def torque(self, order: Order, on: bool, joints: Sequence[str] | None) -> tuple[str, ...]:
        """Switch torque on or off; arguments and result as in `RobotDriver.torque`."""
        self._orders.admit(order, frees=not on)
        model = self._robot.model
        wanted = set(model.names) if joints is None else {model.joint(name).name for name in joints}
        names = tuple(name for name in model.names if name in wanted)
        try:
            return self._called(order, lambda: self._owner.torque(on, names))
        except UsageError:
            # Not asked before, or a stop could come between the two.
            if on and (reason := self._owner.group.reason) is not None:
                raise StoppedError.unsent("torque", 0, f"the arm is stopped ({reason}); resume first") from None
            raise

    def resume(self, order: Order) -> None:
        """End a stop. Nothing moves."""
        self._orders.admit(order)
        self._called(order, self._owner.reset)
        with self._changed:
            self.tripped = False
            self._changed.notify_all()
        self._on_change()

    def watchdog(self, order: Order, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Stop the arm when the holder's program makes no call for `timeout` seconds; 0 for never.

        Raises:
            UsageError: The timeout is outside 0.05..60 s.
        """
        _check_watchdog(timeout)
        grant = self._orders.admit(order)
        with self._changed:
            grant.watchdog, grant.watchdog_mode = timeout, mode
            self._changed.notify_all()

    def ioctl(self, order: Order, sub_cmd: int, data: bytes) -> bytes:
        """Send a special command, whose path is not checked; see `RobotDriver.ioctl`."""
        self._orders.admit(order)
        return self._called(order, lambda: self._owner.command(sub_cmd, data))

    def write_registers(self, order: Order, joint: str, parts: Sequence[tuple[int, bytes]]) -> None:
        """Write registers of a joint's servo one part after the other, in maintenance, in which nothing moves.

        The last part is written whatever becomes of the others, such as a lock after stored settings.

        Args:
            order: As everywhere.
            joint: Its name.
            parts: First registers and their raw values.

        Raises:
            NotSupportedError: The robot has no such request.
            CommandRefusedError: A joint has torque, or a register may not be written.
            HexwireError: As for every order. Maintenance has ended then, too.
        """
        tables = ServoTables.find(self._robot)
        if tables is None:
            raise NotSupportedError(
                f"{self._robot.model.name} writes no registers; use an adapter on its servo bus"
            )

        def write() -> None:
            tables.maintenance(True)
            try:
                try:
                    for first, data in parts[:-1]:
                        tables.write_table(joint, first, data)
                finally:
                    tables.write_table(joint, *parts[-1])
            finally:
                tables.maintenance(False)

        self._orders.admit(order)
        self._called(order, lambda: self._owner.call(write))

    def follow(
        self,
        order: Order,
        controller: str,
        goal: TrajectoryGoal,
        listener: GoalListener | None,
        *,
        received: float | None = None,
        latest: float = math.inf,
    ) -> None:
        """Follow a trajectory; see `ControlledArm.command`. The lease must last as long as it does.

        Args:
            order: Proof that it may be done.
            controller: Name of the controller.
            goal: The trajectory.
            listener: As in `TrajectoryController.accept`.
            received: As in `ControlledArm.command`.
            latest: When it must have been checked, seconds of the owner's clock; later it is refused.

        Raises:
            LeaseError: The sender does not hold the lease.
            StoppedError: The arm was stopped since.
            GoalError: The goal is refused; TOO_LATE if its check took until `latest`.
        """
        self._orders.admit(order)
        joints = self.arm.controllers[controller].joints
        with self.explaining(order, latest), self._robot.epochs.using(self._orders.token(order)):
            self.arm.command(
                controller,
                goal,
                listener=listener,
                # The path check takes time, in which the lease may be lost or the arm stopped.
                wanted=lambda: self.now() < latest and self.is_wanted(order),
                # So that no joint obeys two controllers.
                accepting=lambda: self._steps.release(joints),
                received=received,
            )
        if goal.points:
            ends = self.now() + max(0.0, goal.delay) + goal.points[-1].time
            self._followed_until = max(self._followed_until, ends)

    # -- for everybody ----------------------------------------------------------------------------------

    def stop(self, why: str, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        """Stop the arm, without a lease; see `RobotOwner.stop`."""
        try:
            return self._owner.stop(why, mode)
        finally:
            self._on_change()

    def probe(self) -> ProbeReport:
        """Probe the robot; see `RobotDriver.probe`."""
        return self._owner.probe_again()

    def ping(self, servo_id: int) -> int | None:
        """Ping a servo; see `ServoPing.ping`."""
        return self._owner.call(lambda: ServoPing.of(self._robot).ping(servo_id))

    def read_registers(self, joint: str) -> bytes:
        """Read the register table of a joint's servo; see `ServoTables.read_table`."""
        return self._owner.call(lambda: ServoTables.of(self._robot).read_table(joint))

    def board_counters(self) -> dict[str, int]:
        """Read the board's counters; see `Counters.board_counters`."""
        counters = Counters.find(self._robot)
        return {} if counters is None else self._owner.call(counters.board_counters)

    # -- supervision ------------------------------------------------------------------------------------

    def check(self) -> float:
        """End a lease whose time is over, and stop the arm if the holder's program is silent.

        Returns:
            Seconds until the next check is due, at most half a second.
        """
        changed = False
        with self._changed:
            silent = self._silent(self._clock())
        if silent is not None:
            changed = True
            self._trip(silent)
        if self._clock() >= self._lease.due:
            changed = True
            self._expire_in_time()
        if changed:
            self._on_change()
        return min(max(self._due() - self._clock(), 0.0), _LOOK)

    def _supervise(self) -> None:
        while True:
            try:
                wait = min([self.check(), *(look() for look in self.looks)])
            except Exception:  # noqa: BLE001  # logged; nobody else would notice
                # The lease is then unsupervised: nothing may move.
                _log.exception("the supervision of the lease failed")
                wait = _LOOK
                with self._changed:
                    self._lease.revoke("the supervision of the lease failed")
                stop_or_log(self._owner, "the supervision of the lease failed")
            with self._changed:
                if self._ending:
                    return
                self._changed.wait(max(wait, 0.001))

    def _due(self) -> float:
        with self._changed:
            holder, due = self._lease.holder, self._lease.due
            if holder is None or holder.finishing or not holder.watchdog or self.tripped:
                return due
            return min(due, holder.active + holder.watchdog)

    def _silent(self, now: float) -> Grant | None:
        holder = self._lease.holder
        if holder is None or self.tripped or holder.finishing:
            return None
        return holder if holder.watchdog and now >= holder.active + holder.watchdog else None

    def _trip(self, holder: Grant) -> None:
        with self._changed:
            self.tripped = True
        why = f"the program of {holder.client} made no call for {holder.watchdog:g} s"
        _log.warning("stopped: %s", why)
        stop_or_log(self._owner, why, holder.watchdog_mode)

    def _expire_in_time(self) -> None:
        """End the lease although a target may hang on the line, which has the lock."""
        deciding = self._owner.deciding()
        if deciding.acquire(timeout=_BUSY):
            try:
                self._expire()
            finally:
                deciding.release()
            return
        with self._changed:
            lost = self._lease.expire(self._clock())
        if lost is not None:
            _log.error("%s, and the line is busy; the arm is stopped", self._lease.ended)
            stop_or_log(self._owner, self._lease.ended)

    def _expire(self) -> None:
        """End a lease whose time is over; then the arm holds. The caller has `deciding`."""
        # Without the lock, since the owner asks in every cycle.
        if self._clock() < self._lease.due:
            return
        with self._changed:
            lost = self._lease.expire(self._clock())
        if lost is not None:
            _log.warning("%s; the arm holds", self._lease.ended)
            self._hold(self._lease.ended)

    # -- checks -------------------------------------------------------------------------------------------

    def _hold(self, why: str) -> None:
        self._followed_until = -math.inf
        hold_moving(self._owner, why)

    def _refuse_at_end(self) -> None:
        if self._ending:
            raise LeaseError("the arm is no longer shared: its program ends")

    def _called(self, order: Order, call: Callable[[], _T]) -> _T:
        """Make a call of the owner, unless it is cancelled until then."""
        with self._robot.epochs.using(self._orders.token(order)):
            return call()

    def _check_path(self, target: JointTarget, here: Mapping[str, float]) -> None:
        goal = dict(target.positions)
        # However short it is meant to be: the robot takes the time that its speed limits require.
        joint = self._robot.model.joint
        turns = [abs(angle - here.get(name, angle)) / joint(name).max_speed for name, angle in goal.items()]
        if max(target.duration, *turns) <= _LONG:
            self.path_check.limits(goal)
            self._posture(here, goal)
        else:
            self.path_check.target(here, goal)

    def _remaining(self) -> float:
        """Seconds until the present motion ends."""
        running, followed = self._owner.time_left(), self._followed_until - self.now()
        return max(running, self._steps.time_left(), followed if self._owner.group.busy else 0.0)


def _check_watchdog(timeout: float) -> None:
    low, high = _WATCHDOG
    if timeout != 0.0 and not low <= timeout <= high:
        raise UsageError(f"a watchdog of {timeout:g} s is outside {low:g}..{high:g} s")
