"""An arm that follows another one, the leader, which somebody moves by hand.

Owns the controller, the reading of the leader, and the end: the follower holds. Must not know devices, nor the
rules by which a follower follows.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

from hexwire.drivers.abilities import Reconnects
from hexwire.drivers.registry import is_address
from hexwire.errors import HexwireError, LeaseError, LinkError, StoppedError, UsageError
from hexwire.model.gripper import jaws_of
from hexwire.model.state import JointTarget
from hexwire.motion.following import Behind, Following, GripForce
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.teleop import Action
from hexwire.wire.command_frame import Status

from ..loop.owner import RobotOwner
from ..loop.power import NOT_LATCHED, what_helps
from ..loop.target import holding
from .operator_control import OVERLAP, OperatorController
from .path_check import PathCheck
from .teleop import hold_at_end

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = [
    "LEADER_STOPPED",
    "BehindCounter",
    "BriefReader",
    "FollowController",
    "FollowCounters",
    "Limit",
    "Pair",
    "ReadAhead",
    "ReplugReader",
    "following_rules",
    "reopened",
    "run_following",
]

Limit = float | Mapping[str, float] | None
"""Of all joints or by name; None for none but that of the servos."""
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
twice as long. At 312 degrees per second that is 1.6 degrees."""
_REPLUG, _AGAIN = 30.0, 0.2
"""Seconds for which a cable that was pulled out is waited for, and between two tries to open its line again."""
_LAST_READING = 0.5
"""Seconds for which the end waits for a leader that is being read, or whose line is being opened."""
LEADER_STOPPED = "the leader was stopped, so the follower holds"
"""Why following ends when a state of the leader, or this program, says that it is stopped."""
_STOPPED, _LIMP = "the follower was stopped", "the follower's torque was switched off"


class BehindCounter(Counter[str]):
    """How often a joint was not sent where it was led, and why, as in ``elbow_flex speed``."""

    def see(self, behind: Mapping[str, Behind]) -> str:
        """Count what a cycle says; returns a note for the operator on what is new, or an empty one."""
        if not behind:
            return ""
        found = {f"{name} {why.name.lower()}": f"{name} {why.value}" for name, why in behind.items()}
        new = [text for key, text in found.items() if key not in self]
        self.update(found.keys())
        return "; ".join(new)


@dataclass(slots=True)
class FollowCounters:
    """What happened while an arm followed.

    Attributes:
        cycles: Set-points decided.
        unanswered: Cycles in which a joint of the leader had no new position.
        pauses: How often the follower held because its leader was silent.
        behind: Cycles in which joints were not sent where they were led.
    """

    cycles: int = 0
    unanswered: int = 0
    pauses: int = 0
    behind: BehindCounter = field(default_factory=BehindCounter)


class FollowController(OperatorController):
    """Moves all joints of a follower.

    It reads the leader in its own cycle, right before the set-point, so that no position waits for the next cycle.

    Args:
        rules: How the follower follows.
        leader: Reads the leader; a fault of its line is an error of the cycle.
        now: Clock of the leader's states, seconds.
        period: Least seconds between two cycles.
        on_note: Called with a new note for the operator, or with the reason for a stop.

    Attributes:
        counters: What has happened so far.
        leader_stopped: A state of the leader says that it is stopped, perhaps by another program.
        stopped: Why the follower is stopped, according to its state, perhaps by another program; None if it is not.
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
        self._met = self.leader_stopped = False
        self.stopped: StopReason | None = None
        self.counters = FollowCounters()

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target for the leader's present position."""
        period = self._period(now)
        if period > max(_STALL, 3.0 * self._least):
            # Nobody knows where the leader was moved meanwhile.
            self._rules.pause()
        leader = self._leader()
        self.leader_stopped = self.leader_stopped or leader.stopped
        age = self._now() - leader.stamp + max(leader.age, default=math.inf)
        self.counters.cycles += 1
        self.counters.unanswered += any(one > 0.0 for one in leader.age)
        if state.stopped or self._stopped or self.leader_stopped:
            self._stopped = False
            self._rules.pause()
            self.moving = False
            self.stopped = board_stop(state)
            return None
        loads = dict(zip(state.names, state.load, strict=True))
        step = self._rules.update(leader.positions, age, state.positions, loads, now)
        self.counters.pauses += step.action is Action.HOLD
        met, self._met = step.met and not self._met, step.met
        behind = self.counters.behind.see(step.behind)
        self._say(step.note or behind or ("the follower has met the leader" if met else ""))
        self.moving = step.action is Action.MOVE
        if step.action is Action.HOLD:
            return holding(self._rules.arm, state)
        if not step.positions:
            return None
        return JointTarget.of(step.positions, max(OVERLAP * period, step.least), guided=True)


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

    Attributes:
        fault: What ended the reading.
    """

    def __init__(self, read: Callable[[], JointState]) -> None:
        self._read, self._state = read, read()
        self.fault: BaseException | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="leader", daemon=True)
        self._thread.start()

    def __call__(self) -> JointState:
        """The newest state, however old; raises what ended the reading."""
        if self.fault is not None:
            raise self.fault
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
            self.fault = error


def _in_a_thread(task: Callable[[], object]) -> Callable[[float], object]:
    thread = threading.Thread(target=task, name="leader's line", daemon=True)
    thread.start()
    return thread.join


class ReplugReader:
    """Reads a leader. While its cable is pulled out its last state grows old, so that its follower holds.

    Its line is opened beside the follower's cycle: a board may take two seconds to boot.

    Args:
        leader: The leader.
        on_note: As in `FollowController`.
        beside: Begins a task and returns; that returns what waits for its end, for so many seconds at most.

    Attributes:
        gave_up: What its line said when it had been lost for half a minute; None before that.
    """

    def __init__(
        self,
        leader: RobotDriver,
        on_note: Callable[[str | StopReason], object],
        beside: Callable[[Callable[[], object]], Callable[[float], object]] = _in_a_thread,
    ) -> None:
        self._leader, self._on_note, self._beside = leader, on_note, beside
        self._state: JointState | None = None
        self._lost: LinkError | None = None
        self._ends = self._next = -math.inf
        self.gave_up: LinkError | None = None
        self._opening = self._opened = self._ended = False
        self._fault: BaseException | None = None
        self._wait: Callable[[float], object] = lambda seconds: None

    def __call__(self) -> JointState:
        """The newest state.

        Raises:
            LinkError: The line was lost for half a minute, or before it was ever read.
            UsageError: A joint does not confirm that it has no torque after that.
        """
        leader = self._leader
        if self._lost is None:
            try:
                self._state = leader.read_positions()
            except LinkError as error:
                self._on_note(f"{error}; the follower holds until the leader is there again")
                self._lost, self._next = error, leader.now()
                self._ends = self._next + _REPLUG
            else:
                return self._state
        now = leader.now()
        if self._fault is not None:
            raise self._fault
        # In this order: it has been opened before it is no longer being opened.
        lost, state, opening = self._lost, self._state, self._opening
        if state is None or (now >= self._ends and not opening and not self._opened):
            self.gave_up = lost
            raise lost
        if self._opened:
            self._opened, self._lost = False, None
            self._on_note("the leader is there again")
        elif now >= self._next and not opening:
            self._next, self._opening = now + _AGAIN, True
            self._wait = self._beside(self._open)
        return state

    def end(self) -> None:
        """Open no line any more; one that is opened later is closed again."""
        self._ended = True
        self._wait(_LAST_READING)

    def _open(self) -> None:
        leader = self._leader
        try:
            if reopened(leader):
                _release(leader)
                self._opened = True
        except BaseException as error:  # noqa: BLE001  # raised in the follower's cycle
            self._fault = error
        self._opening = False
        if self._ended:
            leader.detach()


class Pair:
    """A leader and its follower, both attached.

    Args:
        leader: Moved by hand; it gets no torque.
        follower: Follows.
        rules: How it follows.
        on_note: As in `FollowController`.
        ahead: The leader is read in a thread, since reading it may block, as on a network.
        check: Of the follower, as in `RobotOwner`.
        asked: When following was asked for: a stop of the follower since then ends it, and so does torque off. If
            None, now.
    """

    def __init__(
        self,
        leader: RobotDriver,
        follower: RobotDriver,
        rules: Following,
        on_note: Callable[[str | StopReason], object] = lambda said: None,
        ahead: bool = False,
        check: PathCheck | None = None,
        asked: Token | None = None,
    ) -> None:
        self.leader, self.follower, self.rules = leader, follower, rules
        self.on_note, self.ahead, self.check = on_note, ahead, check
        self.asked = follower.epochs.mark() if asked is None else asked
        self._led = leader.epochs.mark()

    @classmethod
    def of(
        cls,
        leader: RobotDriver,
        follower: RobotDriver,
        table: float | None,
        *,
        mirror: bool,
        meet: float,
        force: float,
        on_note: Callable[[str | StopReason], object],
        max_speed: Limit = None,
        max_acceleration: Limit = None,
        asked: Token | None = None,
    ) -> Self:
        """A pair that follows by `following_rules`; a leader that another program serves is read ahead.

        Args are those of `following_rules`, and the height of the table above the follower's base, metres, or None;
        for `asked` see the class.
        """
        check = PathCheck.of(follower, table)
        rules = following_rules(
            leader,
            follower,
            check,
            mirror=mirror,
            meet=meet,
            force=force,
            max_speed=max_speed,
            max_acceleration=max_acceleration,
        )
        return cls(leader, follower, rules, on_note, is_address(leader.url), check, asked)

    @property
    def wanted(self) -> bool:
        """Nobody has stopped the follower or switched its torque off since following was asked for."""
        return self.follower.epochs.holds(self.asked)

    @property
    def leader_stopped(self) -> bool:
        """This program has stopped the leader since then."""
        return self.leader.epochs.stopped_since(self._led)


def following_rules(
    leader: RobotDriver,
    follower: RobotDriver,
    check: PathCheck,
    *,
    mirror: bool = False,
    meet: float = 0.2,
    force: float = 0.35,
    max_speed: Limit = None,
    max_acceleration: Limit = None,
) -> Following:
    """How an arm follows another one.

    Args:
        leader: The arm that a hand moves.
        follower: The arm that follows it.
        check: Checks the follower's postures.
        mirror: The arms face each other: base and wrist turn the other way.
        meet: Share of the speed limits until it has met the leader.
        force: Load, as a fraction of full scale, at which its gripper stops closing; 1 for no limit.
        max_speed: Most radians per second once it has met the leader, of all joints or by name; None for what the
            servos reach without a load.
        max_acceleration: Most radians per second squared, likewise.

    Raises:
        UsageError: The arms have different joints, a joint does not exist, or its servo is not that fast.
    """
    model = follower.model
    jaws = jaws_of(model)
    return Following(
        leader.model,
        model,
        mirror=frozenset(name for name in _FACING if name in model.names) if mirror else frozenset(),
        share=meet,
        speeds=_by_name(model, max_speed),
        accelerations=_by_name(model, max_acceleration),
        grip=None if jaws is None or force >= 1.0 else GripForce(jaws, force),
        check=check.guided(),
    )


def _by_name(model: ArmModel, limit: Limit) -> Mapping[str, float] | None:
    if limit is None or isinstance(limit, Mapping):
        return limit
    return dict.fromkeys(model.names, limit)


def run_following(
    pair: Pair,
    rate: float,
    *,
    on_ready: Callable[[], object] = lambda: None,
    ended: threading.Event | None = None,
    sleep: Callable[[float], object] | None = None,
    beside: Callable[[Callable[[], object]], Callable[[float], object]] = _in_a_thread,
) -> None:
    """Let a follower follow until an exception, such as KeyboardInterrupt, or an event ends it; then it holds.

    Args:
        pair: The leader and its follower.
        rate: Cycles per second.
        on_ready: Called once, when the follower has torque and before anything can move.
        ended: Ends it, too, when it is set.
        sleep: As in `RobotOwner`.
        beside: As in `ReplugReader`.

    Raises:
        StoppedError: The follower or the leader was stopped, or the follower's torque switched off.
        HexwireError: A robot failed or refused.
    """
    follower = pair.follower
    ended = threading.Event() if ended is None else ended
    _release(pair.leader)
    with follower.epochs.using(pair.asked):
        on = follower.torque(True)
    if missing := [name for name in pair.rules.arm.names if name not in on]:
        raise UsageError(f"the follower {follower.url} does not confirm torque of {', '.join(missing)}")
    on_ready()

    def own(controller: FollowController) -> None:
        with RobotOwner(
            follower,
            borrowed=True,
            check=pair.check,
            asked=pair.asked,
            command_rate=rate,
            sleep=sleep,
            read=BriefReader(follower),
            # A stop would outlast a cable that is soon plugged in again: the end stops it otherwise.
            stop_on_failure=False,
        ) as owner:
            owner.group.members = (controller,)
            try:
                while not ended.is_set():
                    if not pair.wanted:
                        limp = follower.epochs.limp_since(pair.asked)
                        why = f"{_LIMP}; {NOT_LATCHED}" if limp else f"{_STOPPED}; {what_helps(follower)}"
                        raise StoppedError("following", Status.STOPPED, why)
                    if controller.stopped is not None:
                        why = f"{controller.stopped}; {what_helps(follower)}"
                        raise StoppedError("following", Status.STOPPED, why)
                    if pair.leader_stopped or controller.leader_stopped:
                        raise StoppedError("following", Status.STOPPED, LEADER_STOPPED)
                    owner.turn()
            finally:
                controller.release("it is over")

    def wait_for_follower(lost: LinkError) -> None:
        if is_address(follower.url):
            # Its server keeps the arm safe, and has its own way to come back.
            raise lost
        pair.on_note(f"{lost}; its servos hold until it is there again")
        ends = follower.now() + _REPLUG
        while not reopened(follower):
            if ended.is_set() or follower.now() >= ends:
                raise lost
            (sleep or ended.wait)(_AGAIN)
        if found := board_stop(follower.read()):
            # Which nobody can end while this program has its port.
            raise StoppedError("following", Status.STOPPED, f"{found}; {what_helps(follower)}")
        pair.on_note("the follower is there again")

    with ExitStack() as steps:
        for arm in (pair.leader, follower):
            # A call that waits for one arm's cable would keep the other one from its cycle, and trip its watchdog.
            if (line := Reconnects.find(arm)) is not None:
                line.auto_reconnect(on=False)
                steps.callback(line.auto_reconnect, on=True)
        ahead = ReadAhead(pair.leader.read_positions) if pair.ahead else None
        if ahead is not None:
            steps.callback(ahead.end)
        read = ReplugReader(pair.leader, pair.on_note, beside)
        steps.callback(read.end)
        controller = FollowController(pair.rules, ahead or read, pair.leader.now, 1.0 / rate, pair.on_note)
        try:
            while True:
                try:
                    return own(controller)
                except LinkError as lost:
                    if read.gave_up is lost or (ahead is not None and ahead.fault is lost):
                        raise
                    wait_for_follower(lost)
        except (LeaseError, StoppedError):
            # It holds, or moves for another program, which must not be stopped by this one.
            raise
        except HexwireError:
            if pair.wanted:
                with suppress(HexwireError):
                    follower.stop()
            raise
        finally:
            if follower.is_attached and pair.wanted:
                hold_at_end(follower)


def reopened(robot: RobotDriver) -> bool:
    """Try to open the connection of a robot again; torque is as its servos have it. Returns whether it is open."""
    try:
        robot.detach()
        robot.attach()
    except HexwireError:
        return False
    return True


def _release(leader: RobotDriver) -> None:
    """Switch the torque of a leader off, so that a hand can move it.

    Raises:
        UsageError: A joint does not confirm it: it would work against the hand.
    """
    off = leader.torque(False)
    if missing := [name for name in leader.model.names if name not in off]:
        raise UsageError(f"the leader {leader.url} does not confirm that {', '.join(missing)} has no torque")
