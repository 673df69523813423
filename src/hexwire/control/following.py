"""An arm that follows another one, the leader, which somebody moves by hand.

Owns the controller, the reading of the leader, and the end: the follower holds. Must not know devices, nor the
rules by which a follower follows.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.model.gripper import jaws_of
from hexwire.model.state import JointTarget
from hexwire.motion.following import Following, GripForce
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.teleop import Action

from .guided import OVERLAP, GuidedController
from .owner import RobotOwner
from .target import holding
from .teleop import hold_at_end

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState

    from .path_check import PathCheck


__all__ = [
    "BriefReader",
    "FollowController",
    "FollowCounters",
    "Pair",
    "ReadAhead",
    "following_rules",
    "run_following",
]

_FACING = ("shoulder_pan", "wrist_roll", "J1", "J4", "J6")
"""Joints that turn the other way when two arms face each other."""
_STALL = 0.5
"""Seconds without a cycle, as when the program was suspended, after which the follower meets the leader again."""
_LOADS_EVERY = 0.019
"""Seconds between readings of a follower's loads: jaws hold something after a tenth of a second."""
_REST_EVERY = 1.0
"""Seconds between readings of its voltages and the like, which take its line three times as long as a goal."""
_POSITIONS_EVERY = 0.005
"""Seconds between readings of a follower's positions, where cycles are shorter: a goal with them takes its line
twice as long. At 180 degrees per second that is 0.9 degrees."""
_LAST_READING = 0.5
"""Seconds for which the end waits for a leader that is being read."""


@dataclass(slots=True)
class FollowCounters:
    """What happened while an arm followed.

    Attributes:
        cycles: Set-points decided.
        unanswered: Cycles in which a joint of the leader had no new position.
        pauses: How often the follower held because its leader was silent.
    """

    cycles: int = 0
    unanswered: int = 0
    pauses: int = 0


class FollowController(GuidedController):
    """Moves all joints of a follower.

    It reads the leader in its own cycle, right before the set-point, so that no position waits for the next cycle.

    Args:
        rules: How the follower follows.
        leader: Reads the leader; a fault of its line is an error of the cycle.
        now: Clock of the leader's states, seconds.
        period: Least seconds between two cycles.
        on_note: Called with a new note for the operator, or with the reason for a stop.
    """

    def __init__(
        self,
        rules: Following,
        leader: Callable[[], JointState],
        now: Callable[[], float],
        period: float,
        on_note: Callable[[str | StopReason], object] = lambda said: None,
    ) -> None:
        super().__init__(rules.arm, period, on_note)
        self._rules, self._leader, self._now = rules, leader, now
        self._met = False
        self.counters = FollowCounters()

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target for the leader's present position."""
        period = self._period(now)
        if period > max(_STALL, 3.0 * self._least):
            # Nobody knows where the leader was moved meanwhile.
            self._rules.pause()
        leader = self._leader()
        age = self._now() - leader.stamp + max(leader.age, default=math.inf)
        self.counters.cycles += 1
        self.counters.unanswered += any(one > 0.0 for one in leader.age)
        if state.stopped or self._stopped:
            self._stopped = False
            self._rules.pause()
            self.moving = False
            if found := board_stop(state):
                self._say(found)
            return None
        loads = dict(zip(state.names, state.load, strict=True))
        step = self._rules.update(leader.positions, age, state.positions, loads, now)
        self.counters.pauses += step.action is Action.HOLD
        met, self._met = step.met and not self._met, step.met
        self._say(step.note or ("the follower has met the leader" if met else ""))
        self.moving = step.action is Action.MOVE
        if step.action is Action.HOLD:
            return holding(self._rules.arm, state)
        return JointTarget.of(step.positions, max(OVERLAP * period, step.least)) if step.positions else None


class BriefReader:
    """Reads a follower: its positions every 5 ms at most, its loads and the rest less often: they take longer.

    Args:
        robot: The follower.
    """

    def __init__(self, robot: RobotDriver) -> None:
        self._robot = robot
        self._whole: JointState | None = None
        self._whole_at = self._loads_at = -math.inf

    def __call__(self) -> JointState:
        """The state, with load, current, voltage and temperature of the last reading that had them."""
        robot, whole = self._robot, self._whole
        now = robot.now()
        if whole is None or now - self._whole_at >= _REST_EVERY:
            self._whole_at = self._loads_at = now
            self._whole = whole = robot.read()
            return whole
        if now - self._loads_at >= _LOADS_EVERY:
            self._loads_at = now
            state = robot.read_loads()
            self._whole = whole = replace(
                state,
                current=_filled(state.current, whole.current),
                voltage=_filled(state.voltage, whole.voltage),
                temperature=_filled(state.temperature, whole.temperature),
            )
            return whole
        return replace(
            robot.read_positions(_POSITIONS_EVERY),
            load=whole.load,
            current=whole.current,
            voltage=whole.voltage,
            temperature=whole.temperature,
        )


def _filled(values: Sequence[float], before: Sequence[float]) -> tuple[float, ...]:
    """The values, and those from before where they are not known."""
    return tuple([old if math.isnan(new) else new for new, old in zip(values, before, strict=True)])


class ReadAhead:
    """Reads a leader in a thread of its own, so that one whose network is silent keeps no follower from its cycle.

    Args:
        read: Reads the leader.
    """

    def __init__(self, read: Callable[[], JointState]) -> None:
        self._read, self._state = read, read()
        self._fault: BaseException | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="leader", daemon=True)
        self._thread.start()

    def __call__(self) -> JointState:
        """The newest state, however old; raises what ended the reading."""
        if self._fault is not None:
            raise self._fault
        return self._state

    def end(self) -> None:
        """Read no more. The last reading may still be under way: its leader may be silent."""
        self._ended = True
        self._thread.join(_LAST_READING)

    def _run(self) -> None:
        try:
            while not self._ended:
                self._state = self._read()
        except BaseException as error:  # noqa: BLE001  # raised in the follower's cycle
            self._fault = error


@dataclass(frozen=True, slots=True)
class Pair:
    """A leader and its follower, both attached.

    Attributes:
        leader: Moved by hand; it gets no torque.
        follower: Follows.
        rules: How it follows.
        on_note: As in `FollowController`.
        ahead: The leader is read in a thread, since reading it may block, as on a network.
        check: Of the follower, as in `RobotOwner`.
    """

    leader: RobotDriver
    follower: RobotDriver
    rules: Following
    on_note: Callable[[str | StopReason], object] = lambda said: None
    ahead: bool = False
    check: PathCheck | None = None


def following_rules(
    leader: RobotDriver,
    follower: RobotDriver,
    check: PathCheck,
    *,
    mirror: bool = False,
    meet: float = 0.2,
    force: float = 0.35,
) -> Following:
    """How an arm follows another one.

    Args:
        leader: The arm that a hand moves.
        follower: The arm that follows it.
        check: Checks the follower's postures.
        mirror: The arms face each other: base and wrist turn the other way.
        meet: Share of the speed limits until it has met the leader.
        force: Load, as a fraction of full scale, at which its gripper stops closing; 1 for no limit.
    """
    model = follower.model
    jaws = jaws_of(model)
    return Following(
        leader.model,
        model,
        mirror=frozenset(name for name in _FACING if name in model.names) if mirror else frozenset(),
        share=meet,
        grip=None if jaws is None or force >= 1.0 else GripForce(jaws, force),
        check=check.posture,
    )


def run_following(
    pairs: Sequence[Pair],
    rate: float,
    *,
    on_ready: Callable[[], object] = lambda: None,
    shield: Callable[[], AbstractContextManager[object]] = nullcontext,
    ended: threading.Event | None = None,
    sleep: Callable[[float], object] | None = None,
) -> None:
    """Let followers follow until an exception, such as KeyboardInterrupt, ends it; then all of them hold.

    The first pair runs in the caller's thread, each other one in its own. A fault of one pair ends all.

    Args:
        pairs: At least one; no robot is in two of them.
        rate: Cycles per second.
        on_ready: Called once, when the followers have torque and before anything can move.
        shield: Put around the hold at the end; keeps signals from interrupting it.
        ended: Ends it, too, when it is set.
        sleep: As in `RobotOwner`.

    Raises:
        HexwireError: A robot failed or refused.
    """
    for pair in pairs:
        _release(pair.leader)
    for pair in pairs:
        on = pair.follower.torque(True)
        if missing := [name for name in pair.rules.arm.names if name not in on]:
            raise UsageError(f"the follower {pair.follower.url} does not confirm torque of {', '.join(missing)}")
    on_ready()
    ended = threading.Event() if ended is None else ended
    faults: list[BaseException] = []

    def follow(pair: Pair, shielded: Callable[[], AbstractContextManager[object]]) -> None:
        read = pair.leader.read_positions
        ahead = ReadAhead(read) if pair.ahead else None
        controller = FollowController(pair.rules, ahead or read, pair.leader.now, 1.0 / rate, pair.on_note)
        owner = RobotOwner(
            pair.follower,
            borrowed=True,
            check=pair.check,
            command_rate=rate,
            sleep=sleep,
            read=BriefReader(pair.follower),
        )
        with ExitStack() as steps:
            if ahead is not None:
                steps.callback(ahead.end)
            steps.enter_context(owner)
            owner.group.members = (controller,)
            try:
                while not ended.is_set():
                    owner.turn()
            finally:
                with shielded():
                    controller.release("it is over")
                    hold_at_end(pair.follower)

    def run(pair: Pair) -> None:
        try:
            follow(pair, nullcontext)
        except BaseException as error:  # noqa: BLE001  # raised in the caller's thread
            faults.append(error)
        finally:
            ended.set()

    threads = [threading.Thread(target=run, args=(pair,), name="follower") for pair in pairs[1:]]
    try:
        for thread in threads:
            thread.start()
        follow(pairs[0], shield)
    finally:
        ended.set()
        with shield():
            for thread in threads:
                # One that Ctrl-C kept from starting has no end either.
                if thread.ident is not None:
                    thread.join()
    if faults:
        raise faults[0]


def _release(leader: RobotDriver) -> None:
    """Switch the torque of a leader off, so that a hand can move it.

    Raises:
        UsageError: A joint does not confirm it: it would work against the hand.
    """
    off = leader.torque(False)
    if missing := [name for name in leader.model.names if name not in off]:
        raise UsageError(f"the leader {leader.url} does not confirm that {', '.join(missing)} has no torque")
