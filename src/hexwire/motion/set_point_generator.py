"""The target of the arm in each cycle: from a trajectory, from streamed set-points, or hold.

Owns the choice: the latest set-point wins, a new trajectory takes over from the running one within all limits, a
hold brakes within them, lost set-points mean hold, a stop is latched. Time comes in as an argument. Must not know
robots, clocks or threads.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointState, JointTarget
from hexwire.units import decimal

from .eased import ease_out
from .limits import resting_inside
from .moving import Pieces, brake, joint_limits
from .quintic import PEAK_SPEED
from .safety import SafetyGuard, SafetyLimits, StopReason
from .slowed import slow_down, start_on
from .takeover import Takeover, take_over
from .together import Together
from .trajectory import Sample, Tail, Trajectory, Values

if TYPE_CHECKING:
    from hexwire.model.control_law import ControlLaw, Laws

__all__ = ["GeneratorCounters", "Mode", "SetPointGenerator", "Ways"]

_ROUNDING = 1e-9
_LATE, _STALL = 0.1, 1.0
"""Delays behind the last command, in leads: up to the first the joints catch up, beyond the second they rest."""
_ASIDE = 0.3
"""Seconds in which a trajectory that starts elsewhere must be within reach."""
_LATER, _PLACES = 0.1, 10
"""Seconds between two places of the path from which to brake, where braking at once would leave what is allowed;
and their number, since each costs a check of the brake."""
_PAST = 1.0
"""Seconds for which a plan that was replaced is still known: states come with a delay."""
_GAP, _LONGEST_GAP = 0.02, 2.0
"""Seconds between two positions that are recorded for a stall, and the part of a stall for which they are."""
_RECENT, _STANDS, _STILL = 0.1, 0.06, 1e-3
"""Seconds of commands towards set-points that give their speed, seconds without a change after which there is none,
and radians per second that count as none."""
_INSTANT = 0.05
"""The same for a trajectory without duration, which may start slightly off."""


Ways = tuple[tuple[Trajectory, float], ...]
"""How a trajectory begins: what is followed first and after that, each with the seconds after which it starts."""


class Mode(Enum):
    """Mode of the generator."""

    HOLD = "hold"
    TRAJECTORY = "trajectory"
    STREAM = "stream"
    STOPPED = "stopped"


@dataclass(slots=True)
class GeneratorCounters:
    """Event counters.

    Attributes:
        cycles: Cycles run.
        set_points: Set-points received.
        replaced: Set-points replaced by a newer one before they were sent.
        lost: Times that set-points stopped coming and the arm held.
        blends: Trajectories that took over from a motion.
        stops: Stops.
        slips: Stalls of the loop after which a trajectory continued where it was instead of catching up.
    """

    cycles: int = 0
    set_points: int = 0
    replaced: int = 0
    lost: int = 0
    blends: int = 0
    stops: int = 0
    slips: int = 0


class SetPointGenerator:
    """Computes the target of the joints in each cycle.

    Args:
        arm: Limits and speeds.
        limits: Thresholds for an automatic stop.
        lost_after: Seconds without a set-point after which the arm holds.
        jump: Share of a joint's speed limit that the start of a trajectory may require while joints join it.
        allowed: What is wrong with motion that no check has seen, given the positions of all joints; empty if
            nothing is. Its joint limits are checked here.

    Attributes:
        mode: Present mode.
        reason: Reason of the stop, or None.
        counters: Event counters.
        waits: After a stall of the loop the trajectory continues where it was, instead of catching up. False for a
            robot that executes trajectories itself.
        settled: Seconds before which a robot that executes trajectories itself must know of a change; 0 for any
            other.
        onboard: Such a robot has the trajectory: it goes on through a stall, and a hold brakes on it.
        changes: How often a trajectory, a hold or a set-point has replaced what was planned.
        changed_from: From when on it was replaced since `take_change`; infinite if it was not.
    """

    def __init__(
        self,
        arm: ArmModel,
        limits: SafetyLimits | None = None,
        *,
        lost_after: float = 0.25,
        jump: float = 1.0,
        allowed: Callable[[Trajectory, Mapping[str, float]], str] = lambda trajectory, positions: "",
    ) -> None:
        for value in (lost_after, jump):
            if not 0 < value < math.inf:
                raise UsageError(f"lost_after and jump must be above 0 and finite, not {value:g}")
        self.arm = arm
        self.guard = SafetyGuard(limits or SafetyLimits())
        self.mode = Mode.HOLD
        self.reason: StopReason | None = None
        self.counters = GeneratorCounters()
        self.waits = True
        self.settled, self.onboard = 0.0, False
        self.changes, self.changed_from = 0, math.inf
        self._lost_after, self._jump, self._allowed = lost_after, jump, allowed
        # What was planned, each with its start, in the order of these; each counts until the next one starts.
        self._chain: tuple[tuple[Trajectory, float], ...] = ()
        # It is not over; its last part is a brake.
        self._running = self._braking = False
        self._set_point: dict[str, float] = {}
        self._set_point_time = -math.inf
        self._fresh = False
        self._laws: dict[str, ControlLaw] = {}
        # Joints that the robot follows with gains; they are given back to its own loop.
        self._with_gains: set[str] = set()
        # The last commands towards set-points, with the times when they were due.
        self._told: deque[tuple[float, dict[str, float]]] = deque()
        # The last commanded positions, and when they are due.
        self._command: dict[str, float] = {}
        self._command_due = -math.inf
        # Until then the robot is busy with what it has.
        self._busy_until = -math.inf
        self._now = -math.inf
        self._state: JointState | None = None

    # -- requests ---------------------------------------------------------------------------------

    def follow(
        self,
        trajectory: Trajectory,
        now: float,
        begins: float = -math.inf,
        *,
        passes: bool = False,
        at_once: bool = False,
        ways: Ways | None = None,
    ) -> None:
        """Follow a trajectory from now on. A running motion goes over into it within all limits.

        Where the way into it is not allowed, the running motion is braked first.

        Args:
            trajectory: The trajectory.
            now: Seconds.
            begins: Not earlier than this.
            passes: As in `take_over`.
            at_once: It begins with the state that is planned for then, for joints that stand because they press on
                something: what moves is the plan alone, and its limits do not count.
            ways: From `ways` for that time, if the joints then move as was assumed.

        Raises:
            UsageError: No state is known yet, or a joint does not exist.
            LimitError: Stopped, the trajectory starts too far from the present position, or there is no allowed way
                into it.
        """
        self._refuse_if_stopped()
        begins = max(begins, self.next_start(now))
        if ways is None:
            here = self.here(trajectory.names, begins)
            ways = self.ways(trajectory, here, passes=passes, at_once=at_once)
        plans = [(path, begins + later) for path, later in ways]
        moving = self._counts(trajectory.names, now)
        self.counters.blends += moving and self.mode is Mode.TRAJECTORY
        self._chain = (*(self._before(begins) if moving else ()), *plans)
        self._running, self._braking = True, False
        self.mode = Mode.TRAJECTORY
        self._set_point, self._laws = {}, {}
        self._changed(begins)

    def join(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory as `follow` would follow it now if nothing moves; raises as `follow`."""
        self._refuse_if_stopped()
        ((plan, _),) = self.ways(trajectory, self.here(trajectory.names, self._now))
        return plan

    def ways(
        self,
        trajectory: Trajectory,
        here: Sample,
        *,
        passes: bool = False,
        at_once: bool = False,
        allowed: Callable[[Trajectory, Mapping[str, float]], str] | None = None,
    ) -> Ways:
        """A trajectory as it takes over from what moves then, with what must come before it, and when each starts.

        This takes long. It changes nothing and reads only the newest state: it may run beside a cycle.

        Args:
            trajectory: The trajectory.
            here: How the joints move when it begins, from `here`.
            passes: As in `follow`.
            at_once: As in `follow`.
            allowed: As of the generator; its own if None.

        Raises:
            LimitError: As `follow`.
        """

        def fault(plan: Trajectory) -> str:
            return self._wrong(plan, allowed)

        limits = joint_limits(self.arm, trajectory.names)
        self._refuse_far(trajectory, here)
        if at_once or not self.waits:
            return ((trajectory, 0.0),)  # also where a robot that executes trajectories has it already
        plan = take_over(here, trajectory, limits, passes=passes)
        if plan is trajectory or not (wrong := fault(plan)):
            return ((plan, 0.0),)
        if passes and not fault(stopping := take_over(here, trajectory, limits)):
            # There is no room to brake beyond its end.
            return ((stopping, 0.0),)
        braked = brake(trajectory.names, here, limits)
        rest = braked.sample(braked.duration)
        plan = take_over(rest, trajectory, limits, passes=False)
        if not braked.duration or fault(braked) or (plan is not trajectory and fault(plan)):
            raise LimitError(f"{wrong}; wait for the end of the running motion, or move elsewhere first")
        return ((braked, 0.0), (plan, braked.duration))

    def rest(self, names: tuple[str, ...], when: float) -> Sample:
        """Where joints that brake come to rest; for others as `desired`, which see."""
        if self.braking and self._chain[-1][0].names == names:
            still = (0.0,) * len(names)
            return Sample(self._chain[-1][0].goal, still, still)
        return self.desired(names, when)

    def here(self, names: tuple[str, ...], when: float) -> Sample:
        """How joints move at a time; at rest on their stops they begin at their limits. Raises as `desired`."""
        here = self.desired(names, when)
        inside = resting_inside(self.arm, dict(zip(names, here.position, strict=True)))
        return here._replace(position=tuple([inside[name] for name in names]))

    def _refuse_far(self, trajectory: Trajectory, here: Sample) -> None:
        far = self._far(trajectory, here.position)
        if far and any(here.velocity):
            # It may have been planned from where the joints come to rest.
            limits = joint_limits(self.arm, trajectory.names)
            far = self._far(trajectory, brake(trajectory.names, here, limits).goal) and far
        if far:
            name, gap = far[0]
            raise LimitError(
                f"the trajectory starts {decimal(math.degrees(gap), 3)} deg from the position of {name}; "
                "move there first"
            )

    def _far(self, trajectory: Trajectory, positions: Values) -> list[tuple[str, float]]:
        """Joints that are too far from the start of a trajectory, and how far, radians."""
        seconds = max(min(_ASIDE, trajectory.duration), _INSTANT)
        gaps = [abs(b - a) for a, b in zip(positions, trajectory.start, strict=True)]
        most = [self._jump * self.arm.joint(name).max_speed * seconds for name in trajectory.names]
        rows = zip(trajectory.names, gaps, most, strict=True)
        return [(name, gap) for name, gap, least in rows if not PEAK_SPEED * gap <= least]

    def _wrong(
        self, plan: Trajectory, allowed: Callable[[Trajectory, Mapping[str, float]], str] | None = None
    ) -> str:
        """What is wrong with the parts of a plan that are on no checked path; empty if nothing is."""
        if isinstance(plan, Takeover):
            parts = [part for part in (plan.head, plan.tail) if part]
            return next(filter(None, (self._wrong(part, allowed) for part in parts)), "")
        if not isinstance(plan, Pieces):
            return ""
        for name, (low, high), *ends in zip(plan.names, plan.ranges(), plan.start, plan.goal, strict=True):
            joint = self.arm.joint(name)
            # The way may end half a count outside, as a goal may: see `JointModel.check`.
            ends = [end for end in ends if joint.inside(end) in (joint.minimum, joint.maximum)]
            least = min([joint.minimum, *ends]) - _ROUNDING
            most = max([joint.maximum, *ends]) + _ROUNDING
            if not least <= low <= high <= most:
                far = math.degrees(low if low < least else high)
                return f"{joint.name} would swing to {decimal(far, 3)} deg, beyond its limit"
        return (allowed or self._allowed)(plan, {} if self._state is None else self._state.positions)

    def _counts(self, names: tuple[str, ...], when: float) -> bool:
        """Whether a plan for exactly these joints is not over at a time, or still has a command to give."""
        chain = self._chain
        return bool(chain) and chain[-1][0].names == names and (self._running or when < self.ends)

    @property
    def ends(self) -> float:
        """When the plan ends, seconds; there must be one."""
        last, started = self._chain[-1]
        return started + last.duration

    def _planned_at(self, when: float) -> tuple[Trajectory, float]:
        """What is planned for a time, and when that starts."""
        return next((row for row in reversed(self._chain) if row[1] <= when), self._chain[0])

    def _before(self, when: float) -> tuple[tuple[Trajectory, float], ...]:
        """What of the plan still counts if it is replaced from a time on."""
        rows = [row for row in self._chain if row[1] < when]
        old = sum(later[1] < self._now - _PAST for later in rows[1:])
        return tuple(rows[old:])

    def _changed(self, when: float) -> None:
        self.changes += 1
        self.changed_from = min(when, self.changed_from)

    def set_point(self, positions: Mapping[str, float], now: float, laws: Laws = None) -> None:
        """Move to a set-point; it replaces a waiting set-point and any trajectory.

        Args:
            positions: Radians by joint.
            now: Seconds.
            laws: With what gains the robot shall follow them, for some of these joints.

        Raises:
            LimitError: Outside limits, or stopped; the previous set-point stays in force.
            UsageError: A joint does not exist, or no state is known yet.
        """
        self._refuse_if_stopped()
        checked = {}
        for name, angle in positions.items():
            joint = self.arm.joint(name)
            if not math.isfinite(angle):
                raise UsageError(f"set-point of {joint.name} is {angle}, not a number")
            joint.check(angle)
            checked[joint.name] = angle
        self._present(tuple(checked))
        self.counters.set_points += 1
        self.counters.replaced += self._fresh
        if self.mode is not Mode.STREAM:
            self.hold()
            self._told.clear()
        self._set_point, self._set_point_time, self._fresh = checked, now, True
        self._laws = {name: law for name, law in (laws or {}).items() if name in checked}
        self.mode = Mode.STREAM

    def hold(self) -> None:
        """Brake within all limits: from the last command on, or as soon as a robot with the plan can know it."""
        if self.mode is Mode.STOPPED:
            return
        if self.mode is Mode.TRAJECTORY:
            self._leave()
        elif self.mode is Mode.STREAM:
            self._leave_stream()
        self._set_point, self._laws, self._fresh = {}, {}, False
        self.mode = Mode.HOLD

    def _leave(self) -> None:
        """End the trajectory: brake, or come to rest on it."""
        due = self._now + self.settled if self.onboard else max(self._command_due, self._now)
        names = self._chain[-1][0].names
        first, starts = self._chain[0]
        kept = self._before(due)
        if self.onboard and self._now < starts:
            # A robot that has it ends it at once: nothing has moved.
            kept = ()
            self._command.update(zip(names, first.start, strict=True))
        self._chain = kept
        if kept:
            found = self._way_out(names, due)
            self._chain = kept if found is None else (*kept, found)
        self._running = self._braking = bool(self._chain)
        self._changed(due)

    def _way_out(self, names: tuple[str, ...], due: float) -> tuple[Trajectory, float] | None:
        """How joints leave what is planned, and when; None if that is over as soon.

        A brake is the shortest way. Where it leads beyond what is allowed, they come to rest on their path, which
        was checked, within the limits if that is possible soon, and in any case within a bounded time.
        """
        limits = joint_limits(self.arm, names)
        for i in range(_PLACES):
            begins = due + i * _LATER
            if begins >= self.ends:
                return None
            stop = brake(names, self.here(names, begins), limits)
            if not self._wrong(stop):
                return stop, begins
            if i == 0 and (slowed := ease_out(_rest_of(self._chain, due), limits)) is not None:
                return slowed, due
        return slow_down(_rest_of(self._chain, due), limits), due

    def _leave_stream(self) -> None:
        """Brake from the speed of the set-points, unless that leads where nothing may go."""
        names = tuple(self._set_point)
        here = self.desired(names, self._command_due)
        if not any(here.velocity):
            return
        path = brake(names, here, joint_limits(self.arm, names))
        if not self._wrong(path):
            self._chain = ((path, self._command_due),)
            self._running = self._braking = True
            self._changed(self._command_due)

    def stop(self, reason: StopReason | str) -> None:
        """Latch a stop; the first reason stays."""
        if self.mode is Mode.STOPPED:
            return
        self._drop()
        self.mode = Mode.STOPPED
        self.reason = StopReason("asked", reason) if isinstance(reason, str) else reason
        self.counters.stops += 1

    def reset(self) -> None:
        """End a stop without moving; the next motion starts at the arm's position at that time."""
        if self.mode is Mode.STOPPED:
            self.mode, self.reason = Mode.HOLD, None
            self.forget()

    def forget(self) -> None:
        """Forget the last command, for example before motion by hand: the next motion starts where the arm is."""
        self._drop()
        self._command, self._command_due, self._state = {}, -math.inf, None
        self.guard.forget()

    def _drop(self) -> None:
        """Forget everything planned."""
        self._chain, self._running, self._braking = (), False, False
        self._set_point, self._laws, self._fresh = {}, {}, False
        self._with_gains.clear()
        self._busy_until = -math.inf
        self._changed(-math.inf)
        if self.mode is not Mode.STOPPED:
            self.mode = Mode.HOLD

    @property
    def streaming(self) -> Collection[str]:
        """Joints that follow set-points."""
        return self._set_point if self.mode is Mode.STREAM else ()

    @property
    def done(self) -> bool:
        """Whether no trajectory is running, no set-point is followed, and no joint has gains."""
        return self.mode in {Mode.HOLD, Mode.STOPPED} and not self._with_gains

    @property
    def braking(self) -> bool:
        """The joints brake, and nothing else is to follow."""
        return self._running and self.mode is Mode.HOLD

    def remaining(self, now: float) -> float:
        """Seconds until the trajectory ends; 0 if there is none."""
        if not self._running or self.mode is not Mode.TRAJECTORY:
            return 0.0
        return max(0.0, self.ends - now)

    def shift(self, seconds: float) -> None:
        """Move everything planned in time: the robot's clock drifts, or it started later."""
        self._chain = tuple([(path, began + seconds) for path, began in self._chain])

    def take_change(self) -> float:
        """From when on the plan was replaced since the last call."""
        when, self.changed_from = self.changed_from, math.inf
        return when

    @property
    def planned(self) -> tuple[tuple[Trajectory, float], ...]:
        """What is planned, and when it starts; each counts until the next one starts. Empty after a drop."""
        return self._chain

    def rejoin(self, rest: Mapping[str, float], left: float, now: float, *, wanted: bool = True) -> None:
        """Go on after a robot has come to rest, although it should not have.

        Args:
            rest: Where its joints rest, radians.
            left: The time that the trajectory had at that place, if the robot was on it.
            now: Seconds.
            wanted: Go on also with a trajectory that has been over since, by its times.

        Raises:
            LimitError: It is too far from there to the trajectory.
        """
        chain, goes_on = self._chain, self._running and self.mode is Mode.TRAJECTORY
        if wanted and chain and self.mode is Mode.HOLD and not self._running and not self._braking:
            goes_on = left < self.ends
        self._chain, self._running, self._braking = (), False, False
        self._command.update({name: rest[name] for name in rest if name in self._command})
        self._command_due = now
        self._busy_until = -math.inf
        self._changed(now)
        if not goes_on:
            return
        self.mode = Mode.HOLD
        self.counters.slips += 1
        self.follow(_rest_of(chain, max(left, chain[0][1])), now)

    def ahead(self, when: float) -> Trajectory | None:
        """The rest of the running trajectory at a time, or None."""
        return _rest_of(self._chain, when) if self._running else None

    def observe(self, state: JointState, now: float = -math.inf) -> None:
        """Store a state between cycles, so that a motion that starts now starts at the arm's position.

        Args:
            state: The state.
            now: Seconds; a hold counts from then on.
        """
        self._state = state
        self._now = max(now, self._now)

    def next_start(self, now: float) -> float:
        """When a trajectory given now would start: not before the last command is due.

        A robot that executes trajectories itself begins at once what begins at rest.
        """
        ahead = self.settled if self._running or self.onboard else 0.0
        return max(now + ahead, self._command_due)

    @property
    def due(self) -> float:
        """When the last command is due."""
        return self._command_due

    def desired(self, names: tuple[str, ...], now: float) -> Sample:
        """Desired state of joints at a time; at rest unless a trajectory of exactly these joints is running.

        Raises:
            UsageError: Their position is still unknown.
        """
        if self._counts(names, now):
            path, began = self._planned_at(now)
            return path.sample(now - began)
        rest = (0.0,) * len(names)
        # After the last command, joints that follow set-points rest where it was for.
        streams = self.mode is Mode.STREAM and now <= self._command_due
        speeds = tuple([self._speed(name) for name in names]) if streams else rest
        return Sample(self._present(names), speeds, rest)

    def _speed(self, name: str) -> float:
        """The speed at which a joint has been told to follow set-points, radians per second; 0 with weak gains."""
        if name in self._laws:
            return 0.0
        rows = [(due, where[name]) for due, where in self._told if name in where]
        if len(rows) < 2 or self._command_due - rows[-1][0] > _RECENT:
            return 0.0
        (since, first), (until, last) = rows[0], rows[-1]
        if all(where == last for due, where in rows if due >= until - _STANDS):
            return 0.0
        most = self.arm.joint(name).max_speed
        speed = (last - first) / max(until - since, _INSTANT)
        return max(-most, min(most, speed)) if abs(speed) > _STILL else 0.0

    # -- the cycle ----------------------------------------------------------------------------------

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """Run one cycle.

        Args:
            state: The state just read.
            now: Seconds, on the same clock as all other times here.
            lead: Seconds ahead for which a target is sent; the servos take that long to reach it.

        Returns:
            A target to write; a reason to stop the arm, once; None if nothing is to be sent.
        """
        self.counters.cycles += 1
        self.observe(state, now)
        if self.mode is Mode.STOPPED:
            return None
        if self.onboard or not self.waits:
            self._fill_in(now)
        if (found := self.guard.judge(state, now)) is not None:
            self.stop(found)
            return found
        if self.mode is Mode.STREAM and not self._running:
            self._fresh = False
            if now - self._set_point_time > self._lost_after:
                self.counters.lost += 1
                self.hold()
            elif now < self._busy_until:
                return None
            else:
                return self._follow_set_point(now, lead)
        if self._running and self.waits and not self.onboard:
            self._slip(now, lead)
        # A loss may have begun a brake.
        if self._running:
            return self._advance(now, max(lead, self.settled))
        return self._send({}, now, lead) if self._with_gains else None

    def _follow_set_point(self, now: float, lead: float) -> JointTarget:
        target = self._towards(self._set_point, now, lead)
        self._told.append((now + lead, dict(target)))
        while self._told[0][0] < now + lead - _RECENT:
            self._told.popleft()
        return self._send(target, now, lead)

    def _advance(self, now: float, lead: float) -> JointTarget:
        path, began = self._planned_at(now + lead)
        positions = dict(zip(path.names, path.sample(now + lead - began).position, strict=True))
        last, started = self._chain[-1]
        # The same difference as for the sample, so that the last one is exactly the goal.
        if now + lead - started >= last.duration:
            self._running = False
            if self.mode is Mode.TRAJECTORY:
                self.mode = Mode.HOLD
            if self.onboard:
                self._busy_until = self.ends
        return self._send(positions, now, lead)

    def _fill_in(self, now: float) -> None:
        """Record where a robot that executes trajectories itself was sent during a stall of this loop."""
        if not self._running or not math.isfinite(self._command_due):
            return
        due = max(self._command_due, now - _LONGEST_GAP)
        while (due := due + _GAP) < now:
            path, began = self._planned_at(due)
            self.guard.commanded(dict(zip(path.names, path.sample(due - began).position, strict=True)), due)

    def _slip(self, now: float, lead: float) -> None:
        """A late plan goes on where the last command led: after a stall from rest, and a brake is over."""
        begins = self._chain[0][1]
        due = max(self._command_due, begins)
        late = now - due
        if late <= (_LATE if begins < due else _STALL) * lead:
            return
        self.counters.slips += 1
        if late <= _STALL * lead:
            # To catch up, joints that move would have to be faster than planned.
            self.shift(late)
            return
        if self.braking:
            self._chain, self._running, self._braking = (), False, False
            return
        rest = _rest_of(self._chain, due)
        self._chain = ((start_on(rest, joint_limits(self.arm, rest.names)), now),)
        self._changed(now)

    def _towards(self, goal: Mapping[str, float], now: float, lead: float) -> dict[str, float]:
        """The position as close to a goal as the speed limits allow since the last command."""
        seconds = min(lead, now + lead - self._command_due) if math.isfinite(self._command_due) else lead
        here = dict(zip(goal, self._present(tuple(goal)), strict=True))
        steps = {}
        for name, angle in goal.items():
            most = self.arm.joint(name).max_speed * max(0.0, seconds)
            steps[name] = here[name] + max(-most, min(most, angle - here[name]))
        return steps

    def _send(self, positions: dict[str, float], now: float, lead: float) -> JointTarget:
        if self._with_gains:
            positions |= self._where_they_are(self._with_gains - positions.keys())
        self._with_gains = set(self._laws)
        self._command.update(positions)
        self._command_due = now + lead
        self.guard.commanded(positions, now + lead)
        return JointTarget(tuple(positions.items()), lead, tuple(self._laws.items()))

    def _where_they_are(self, names: Collection[str]) -> dict[str, float]:
        """Where joints are held whose gains end: with weak ones they are not where they were told to be."""
        known: Mapping[str, float] = {} if self._state is None else self._state.positions
        found = {name: known.get(name, math.nan) for name in sorted(names)}
        inside = {name: at if math.isfinite(at) else self._command[name] for name, at in found.items()}
        return {
            name: max(self.arm.joint(name).minimum, min(self.arm.joint(name).maximum, at))
            for name, at in inside.items()
        }

    def _present(self, names: tuple[str, ...]) -> tuple[float, ...]:
        """Last commanded positions of joints, or their present positions if there was no command."""
        command, state = self._command, self._state
        # Asked for with every state: the state is looked up once, and only for joints without a command.
        known: Mapping[str, float] = {} if state is None or command.keys() >= set(names) else state.positions
        values = []
        for name in names:
            if (value := command.get(name)) is None:
                value = known.get(name, math.nan)
                if not math.isfinite(value):
                    raise UsageError(f"the position of {name} is still unknown: it has not answered yet")
            values.append(value)
        return tuple(values)

    def _refuse_if_stopped(self) -> None:
        if self.mode is Mode.STOPPED:
            raise LimitError(f"the arm is stopped ({self.reason}); reset first")


def _rest_of(chain: tuple[tuple[Trajectory, float], ...], when: float) -> Trajectory:
    """What is left of a plan at a time."""
    if len(chain) == 1:
        return Tail(chain[0][0], when - chain[0][1])
    names = chain[0][0].names
    return Tail(Together(names, {names: [(path, began - when) for path, began in chain]}), 0.0)
