"""An arm that several programs use: all read it, the holder of its lease commands it, everybody stops it.

Owns what joins lease and arm: an order is checked and sent in one step, a lost lease holds the arm, and silence of
the holder's program stops it. Must not know how orders arrive: networks, messages, certificates.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, TypeVar

from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, LeaseError, StoppedError
from hexwire.model.state import JointTarget

from .lease import Lease
from .path_check import PathCheck
from .target import holding

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hexwire.drivers.base import ProbeReport
    from hexwire.epochs import Token
    from hexwire.model.state import SentTarget

    from .arm import Arm
    from .goals import TrajectoryGoal
    from .lease import Grant, Rank
    from .outcomes import GoalListener

__all__ = ["Order", "SharedArm"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_LONG = 0.25
"""Seconds; of a longer target the whole path is checked, since it may lead far. Shorter ones are a stream's."""
_LOOK = 0.5
"""Longest wait of the supervising thread, seconds."""
_SETTLING = 0.2
"""Seconds after a motion's duration in which its servos may still move."""
_PATIENCE = 5.0
"""Seconds in which the supervising thread ends."""
_PATIENCE_SENDING = 1.0
"""Seconds for which a shutdown waits for an order that is being sent."""


class Order:
    """Proof that an order may be done: who sends it, and when it arrived.

    Args:
        key: Key of the sender's lease.
        sequence: Number of the order; each is greater than the last.
        arrived: Token of the robot's epochs at its arrival; a later stop cancels the order.
        age: Least age that it can have, seconds; None for an order that does not become wrong by waiting.
    """

    __slots__ = ("age", "arrived", "key", "sequence")

    def __init__(self, key: int, sequence: int, arrived: Token, age: float | None = None) -> None:
        self.key, self.sequence, self.arrived, self.age = key, sequence, arrived, age


class SharedArm:
    """Any thread may call its methods. Call `start` when the arm was started; finally `shutdown`.

    Args:
        arm: Connected and started by the caller, who also shuts it down.
        lease: The rules of its lease.
        on_change: Called when holder, hold or stop have changed, in the thread that changed them.

    Attributes:
        arm: As given.
        held: Why the arm holds, in words: a lost lease; empty if it does not.
        tripped: The holder's program fell silent, so that the arm was stopped.
    """

    def __init__(
        self, arm: Arm, lease: Lease | None = None, *, on_change: Callable[[], object] = lambda: None
    ) -> None:
        self.arm = arm
        self.tripped = False
        self._owner, self._robot = arm.owner, arm.owner.robot
        self._lease = lease or Lease()
        self._on_change = on_change
        settings = arm.settings
        self._check = PathCheck(settings.model, settings.kinematics, settings.table)
        # Guards the lease. Taken inside `deciding`, never the other way round.
        self._changed = threading.Condition(threading.RLock())
        self._moves_until = -math.inf
        self._moved: set[str] = set()
        self._ending = False
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
        decided = self._owner.deciding().acquire(timeout=_PATIENCE_SENDING)
        try:
            with self._changed:
                self._ending = True
                self._lease.holder = None
                self._changed.notify_all()
            moving = not decided or self._moving()
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

    def refusal(self, order: Order) -> LeaseError:
        """Count an order whose sender does not hold the lease; returns the error for it."""
        with self._changed:
            try:
                self._lease.admit(order.key, order.sequence, self.now())
            except LeaseError as error:
                return error
            return LeaseError("the lease has just changed; nothing was done")

    def take(
        self,
        client: str,
        rank: Rank,
        *,
        force: bool = False,
        watchdog: float = 0.0,
        watchdog_mode: StopMode = StopMode.HOLD,
    ) -> Grant:
        """Grant the lease. A holder that loses it by this leaves the arm holding.

        Args:
            client: Who asks, for display.
            rank: Its rank.
            force: Pre-empt another holder, if the rank permits it.
            watchdog: Seconds without a call of the client's program after which the arm is stopped; 0 for never.
            watchdog_mode: How it is stopped then.

        Raises:
            LeaseError: Another client holds it.
        """
        with self._owner.deciding():
            with self._changed:
                if self._ending:
                    raise LeaseError("the arm is no longer shared: its program ends")
                before = self._lease.holder
                grant = self._lease.take(client, rank, self.now(), force=force)
                grant.watchdog, grant.watchdog_mode = watchdog, watchdog_mode
                self._changed.notify_all()
            if before is not None and before.ends == math.inf:
                _log.warning("%s took the lease from %s", client, before.client)
                self._hold(f"{client} took the lease from {before.client}")
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
            return self._lease.beat(key, self.now(), idle)

    def leave(self, key: int, *, finish: bool) -> None:
        """Give the lease back.

        Args:
            key: The holder's.
            finish: A motion that the holder began runs to its end; otherwise the arm holds.
        """
        with self._owner.deciding():
            with self._changed:
                holder = self._lease.holder
                if holder is None or holder.key != key:
                    return
                moving = self._moving()
                self._lease.leave(key, self.now(), self._moves_until if finish else -math.inf)
                self._changed.notify_all()
            if moving and not finish:
                self._hold(f"{holder.client} gave the lease back")
        self._on_change()

    # -- orders of the holder ---------------------------------------------------------------------------

    def write(self, order: Order, target: JointTarget) -> SentTarget:
        """Send a target.

        Raises:
            LeaseError: The sender does not hold the lease, or the target came too late.
            LimitError: It is outside the limits, or leads the arm into its table or its own limits.
            HexwireError: As `RobotOwner.send`.
        """
        owner = self._owner
        names = [name for name, _ in target.positions]
        with owner.deciding():
            # Before the check, so that an order without a lease costs little; and nothing comes between it and
            # the sending, since a loss of the lease waits for `deciding`.
            self._admit(order)
            self._check_path(target)
            sent = owner.send(target, order.arrived)
            if set(names) - self._moved and self._moving():
                self._moved.update(names)
            else:
                self._moved = set(names)
            self._moves_until = max(self._moves_until, self.now() + sent.duration)
            return sent

    def torque(self, order: Order, on: bool, joints: Sequence[str] | None) -> tuple[str, ...]:
        """Switch torque on or off; arguments and result as in `RobotDriver.torque`."""
        self._admit(order)
        model = self._robot.model
        wanted = set(model.names) if joints is None else {model.joint(name).name for name in joints}
        names = tuple(name for name in model.names if name in wanted)
        return self._called(order, lambda: self._owner.torque(on, names))

    def resume(self, order: Order) -> None:
        """End a stop. Nothing moves."""
        self._admit(order)
        self._called(order, self._owner.reset)
        with self._changed:
            self.tripped = False
        self._on_change()

    def watchdog(self, order: Order, timeout: float, mode: StopMode = StopMode.HOLD) -> None:
        """Stop the arm when the holder's program makes no call for `timeout` seconds; 0 for never."""
        grant = self._admit(order)
        with self._changed:
            grant.watchdog, grant.watchdog_mode = timeout, mode
            self._changed.notify_all()

    def ioctl(self, order: Order, sub_cmd: int, data: bytes) -> bytes:
        """Send a special command; see `RobotDriver.ioctl`."""
        self._admit(order)
        return self._called(order, lambda: self._owner.call(lambda: self._robot.ioctl(sub_cmd, data)))

    def follow(self, order: Order, controller: str, goal: TrajectoryGoal, listener: GoalListener | None) -> None:
        """Follow a trajectory; see `Arm.command`. The lease must last as long as it does."""
        self._admit(order)
        with self._robot.epochs.using(order.arrived):
            self.arm.command(controller, goal, listener=listener)
        self._moved.update(goal.names)
        if goal.points:
            self._moves_until = max(self._moves_until, self.now() + max(0.0, goal.delay) + goal.points[-1].time)

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
        """Ping a servo; see `RobotDriver.ping`."""
        return self._owner.call(lambda: self._robot.ping(servo_id))

    def board_counters(self) -> dict[str, int]:
        """Read the board's counters; see `RobotDriver.board_counters`."""
        return self._owner.call(self._robot.board_counters)

    # -- supervision ------------------------------------------------------------------------------------

    def check(self) -> float:
        """End a lease whose time is over, and stop the arm if the holder's program is silent.

        Returns:
            Seconds until the next check is due, at most half a second.
        """
        now = self.now()
        if now >= self._due():
            # In the order of the locks; meanwhile the lease may have been renewed.
            with self._owner.deciding():
                with self._changed:
                    lost = self._lease.expire(self.now())
                    silent = self._silent(self.now())
                if lost is not None:
                    _log.warning("%s; the arm holds", self._lease.ended)
                    self._hold(self._lease.ended)
            if silent is not None:
                self._trip(silent)
            self._on_change()
            now = self.now()
        return min(max(self._due() - now, 0.0), _LOOK)

    def _supervise(self) -> None:
        while True:
            wait = self.check()
            with self._changed:
                if self._ending:
                    return
                self._changed.wait(max(wait, 0.001))

    def _due(self) -> float:
        with self._changed:
            holder, due = self._lease.holder, self._lease.due
            if holder is None or not holder.watchdog or self.tripped:
                return due
            return min(due, holder.active + holder.watchdog)

    def _silent(self, now: float) -> Grant | None:
        holder = self._lease.holder
        if holder is None or self.tripped or holder.ends < math.inf:
            return None
        return holder if holder.watchdog and now >= holder.active + holder.watchdog else None

    def _trip(self, holder: Grant) -> None:
        with self._changed:
            self.tripped = True
        why = f"the program of {holder.client} made no call for {holder.watchdog:g} s"
        _log.warning("stopped: %s", why)
        try:
            self._owner.stop(why, holder.watchdog_mode)
        except HexwireError as error:
            _log.error("the stop was not confirmed: %s", error)

    def _admit(self, order: Order) -> Grant:
        with self._changed:
            return self._lease.admit(order.key, order.sequence, self.now(), order.age)

    def _called(self, order: Order, call: Callable[[], _T]) -> _T:
        """Make a call of the owner; a stop after the arrival of the order cancels it."""
        with self._robot.epochs.using(order.arrived):
            return call()

    def _check_path(self, target: JointTarget) -> None:
        goal = dict(target.positions)
        if target.duration <= _LONG:
            self._check.posture(self._owner.newest().positions, goal)
        else:
            self._check.target(self._owner.newest().positions, goal)

    def _moving(self) -> bool:
        return self._owner.group.busy or self.now() < self._moves_until + _SETTLING

    def _hold(self, why: str) -> None:
        """Hold the joints where they are, if they move; if that fails, stop the arm."""
        owner = self._owner
        moving = self._moving()
        owner.group.release(why)
        self._moves_until = -math.inf
        moved, self._moved = self._moved, set()
        if not moving:
            return
        try:
            state = self._robot.read()
            if state.stopped:
                return
            joints = [name for name in state.torque_on if name in moved]
            target = holding(self._robot.model, state, joints)
            if joints and target is not None:
                owner.send(target, self._robot.epochs.mark())
        except StoppedError:
            return
        except HexwireError as error:
            _log.error("the arm cannot hold: %s; it is stopped", error)
            try:
                owner.stop(why)
            except HexwireError as unconfirmed:
                _log.error("the stop was not confirmed: %s", unconfirmed)
