"""What the arm is told in each cycle: a trajectory, set-points from outside, or to hold.

Owns the choice: the latest set-point wins, a new trajectory blends in, lost set-points mean hold, a stop is
latched. Time comes in as an argument. Must not know robots, clocks or threads.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointState, JointTarget
from hexwire.units import decimal

from .safety import Guard, SafetyLimits, StopReason
from .trajectory import PEAK_SPEED
from .waypoints import Blend, Sample, Spline, Tail, Trajectory, Waypoint

__all__ = ["Follower", "FollowerCounters", "Mode"]

_STALL = 1.0
"""Leads behind the last command from which the loop has stalled."""
_LOOK = 0.01
"""Seconds between two looks at a blend."""
_INSTANT = 0.05
"""Seconds that even a step is granted: a trajectory without duration may begin a little off."""


class Mode(Enum):
    """What the follower does."""

    HOLD = "hold"
    TRAJECTORY = "trajectory"
    STREAM = "stream"
    STOPPED = "stopped"


@dataclass(slots=True)
class FollowerCounters:
    """What happened.

    Attributes:
        cycles: Cycles run.
        set_points: Set-points that came.
        replaced: Set-points that a newer one overtook before they were sent.
        lost: Times that set-points stayed away and the arm held.
        blends: Trajectories that replaced a motion.
        stops: Stops.
        slips: Stalls of the loop after which a trajectory went on where it was, and did not make up for them.
    """

    cycles: int = 0
    set_points: int = 0
    replaced: int = 0
    lost: int = 0
    blends: int = 0
    stops: int = 0
    slips: int = 0


class Follower:
    """Decides cycle by cycle where the joints go.

    Args:
        arm: Limits and speeds.
        limits: When to stop by itself.
        blend: Seconds in which a new trajectory takes over from a motion.
        lost_after: Seconds without a set-point after which the arm holds.
        jump: Share of a joint's speed limit that the start of a trajectory may ask for while blending in.

    Attributes:
        mode: What it does.
        reason: Why it is stopped, or None.
        counters: What happened.
    """

    def __init__(
        self,
        arm: ArmModel,
        limits: SafetyLimits | None = None,
        *,
        blend: float = 0.3,
        lost_after: float = 0.25,
        jump: float = 1.0,
    ) -> None:
        for value in (blend, lost_after, jump):
            if not 0 < value < math.inf:
                raise UsageError(f"{value:g} makes no sense; it must be above 0")
        self.arm = arm
        self.guard = Guard(limits or SafetyLimits())
        self.mode = Mode.HOLD
        self.reason: StopReason | None = None
        self.counters = FollowerCounters()
        self._blend, self._lost_after, self._jump = blend, lost_after, jump
        self._trajectory: Trajectory | None = None
        self._started = 0.0
        # What it took over from, and when that had begun.
        self._earlier: tuple[Trajectory, float] | None = None
        self._set_point: dict[str, float] = {}
        self._set_point_time = -math.inf
        self._fresh = False
        # Where the joints were told to be last, and when.
        self._command: dict[str, float] = {}
        self._command_due = -math.inf
        self._state: JointState | None = None

    # -- what others ask --------------------------------------------------------------------------

    def follow(self, trajectory: Trajectory, now: float) -> None:
        """Follow a trajectory from now on; a motion under way blends into it.

        Raises:
            UsageError: No state is known yet, or a joint does not exist.
            LimitError: Stopped, or it starts too far from where the arm is.
        """
        running = self._running(trajectory.names)
        blend = self._blended(trajectory, now)
        self.counters.blends += running is not None
        self._earlier = None if running is None else (running, self._started)
        self._trajectory, self._started = blend, max(now, self._command_due)
        self.mode = Mode.TRAJECTORY
        self._set_point = {}

    def takeover(self, trajectory: Trajectory, now: float) -> Iterator[tuple[float, dict[str, float]]]:
        """Where a motion under way would take the joints until a trajectory has taken over; changes nothing.

        Yields:
            Seconds from its start, and radians by joint; nothing if the joints are at rest.

        Raises:
            UsageError, LimitError: As `follow`.
        """
        blend = self._blended(trajectory, now)
        if self._running(trajectory.names) is None:
            return
        seconds = min(self._blend, trajectory.duration)
        steps = max(1, math.ceil(seconds / _LOOK))
        for i in range(steps + 1):
            t = seconds * i / steps
            yield t, self._within_limits(dict(zip(blend.names, blend.sample(t).position, strict=True)))

    def _running(self, names: tuple[str, ...]) -> Trajectory | None:
        """The motion under way of just these joints."""
        running = self._trajectory
        return running if self.mode is Mode.TRAJECTORY and running is not None and running.names == names else None

    def _blended(self, trajectory: Trajectory, now: float) -> Blend:
        self._refuse_if_stopped()
        names = trajectory.names
        for name in names:
            self.arm.joint(name)
        here = self._present(names)
        old: Trajectory = Spline(names, [Waypoint(0.0, here)])
        switch = 0.0
        running = self._running(names)
        if running is not None:
            # What was told last may be ahead of now; going back behind it would be a jump.
            old, switch = running, max(now, self._command_due) - self._started
        seconds = min(self._blend, trajectory.duration)
        here = old.sample(switch).position
        for name, a, b in zip(names, here, trajectory.start, strict=True):
            # The blend closes the gap as a quintic does, whose peak speed is above its mean.
            if not PEAK_SPEED * abs(b - a) <= self._jump * self.arm.joint(name).max_speed * max(seconds, _INSTANT):
                gap = math.degrees(abs(b - a))
                raise LimitError(
                    f"the trajectory begins {decimal(gap, 3)} deg from where {name} is; move there first"
                )
        return Blend(old, switch, trajectory, seconds)

    def set_point(self, positions: Mapping[str, float], now: float) -> None:
        """Go to a set-point; it replaces one that waits, and any trajectory.

        Raises:
            LimitError: Outside limits, or stopped; the set-point before stays in force.
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
        self._set_point, self._set_point_time, self._fresh = checked, now, True
        self._trajectory = None
        self.mode = Mode.STREAM

    def hold(self) -> None:
        """Stay where the last command was."""
        if self.mode is not Mode.STOPPED:
            self._trajectory, self._set_point, self._fresh = None, {}, False
            self.mode = Mode.HOLD

    def stop(self, reason: StopReason | str) -> None:
        """Latch a stop; the first reason stays."""
        if self.mode is Mode.STOPPED:
            return
        self.hold()
        self.mode = Mode.STOPPED
        self.reason = StopReason("asked", reason) if isinstance(reason, str) else reason
        self.counters.stops += 1

    def reset(self) -> None:
        """End a stop. Nothing moves by it; what is followed next starts where the arm is then."""
        if self.mode is Mode.STOPPED:
            self.mode, self.reason = Mode.HOLD, None
            self.forget()

    def forget(self) -> None:
        """What was commanded no longer holds, as when a hand moves the arm: the next motion starts where it is."""
        self.hold()
        self._command, self._command_due, self._state = {}, -math.inf, None
        self.guard.forget()

    @property
    def done(self) -> bool:
        """No trajectory is under way, and no set-point is pursued."""
        return self.mode in {Mode.HOLD, Mode.STOPPED}

    def remaining(self, now: float) -> float:
        """Seconds until the trajectory ends; 0 if there is none."""
        if self._trajectory is None:
            return 0.0
        return max(0.0, self._started + self._trajectory.duration - now)

    def ahead(self, when: float) -> Trajectory | None:
        """What is left at a time of the trajectory under way, or None."""
        return None if self._trajectory is None else Tail(self._trajectory, when - self._started)

    def observe(self, state: JointState) -> None:
        """Take note of a state between cycles, so that what begins now begins where the arm is."""
        self._state = state

    def next_start(self, now: float) -> float:
        """When a trajectory given now would begin: not before what was sent already is due."""
        return max(now, self._command_due)

    def desired(self, names: tuple[str, ...], now: float) -> Sample:
        """Where joints are meant to be at a time; at rest unless a trajectory of just these joints is under way.

        Raises:
            UsageError: It is not known yet where they are.
        """
        running = self._running(names)
        if running is not None:
            if now < self._started and self._earlier is not None:
                # What was sent before goes on until then.
                earlier, began = self._earlier
                return earlier.sample(now - began)
            return running.sample(now - self._started)
        rest = (0.0,) * len(names)
        return Sample(self._present(names), rest, rest)

    # -- the cycle ----------------------------------------------------------------------------------

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | StopReason | None:
        """One cycle: what to send now.

        Args:
            state: Just read.
            now: Seconds, same clock as everywhere here.
            lead: Seconds ahead for which a target is sent; the servos take that long to get there.

        Returns:
            A target to write; a reason to stop the arm, once; None to leave it alone.
        """
        self.counters.cycles += 1
        self._state = state
        if self.mode is Mode.STOPPED:
            return None
        found = self.guard.judge(state, now)
        if found is not None:
            self.stop(found)
            return found
        if self.mode is Mode.TRAJECTORY and self._trajectory is not None:
            self._slip(now, lead)
            trajectory, t = self._trajectory, now + lead - self._started
            if t >= trajectory.duration:
                self._trajectory, self.mode = None, Mode.HOLD
            positions = dict(zip(trajectory.names, trajectory.sample(t).position, strict=True))
            if self._earlier is not None and t < self._blend:
                positions = self._within_limits(positions)
            return self._send(positions, now, lead)
        if self.mode is Mode.STREAM:
            self._fresh = False
            if now - self._set_point_time > self._lost_after:
                self.counters.lost += 1
                self.hold()
                return None
            return self._send(self._towards(self._set_point, now, lead), now, lead)
        return None

    def _within_limits(self, positions: Mapping[str, float]) -> dict[str, float]:
        """While it turns round, a motion may swing out beyond both that it joins."""
        joints = {name: self.arm.joint(name) for name in positions}
        return {n: min(max(angle, joints[n].minimum), joints[n].maximum) for n, angle in positions.items()}

    def _slip(self, now: float, lead: float) -> None:
        """After a stall go on from the last command: to make up for it would be a leap."""
        stall = now - max(self._command_due, self._started)
        if stall > _STALL * lead:
            self._started += stall
            self.counters.slips += 1

    def _towards(self, goal: Mapping[str, float], now: float, lead: float) -> dict[str, float]:
        """As far towards a goal as speed limits allow since the last command."""
        seconds = min(lead, now + lead - self._command_due) if math.isfinite(self._command_due) else lead
        here = dict(zip(goal, self._present(tuple(goal)), strict=True))
        steps = {}
        for name, angle in goal.items():
            most = self.arm.joint(name).max_speed * max(0.0, seconds)
            steps[name] = here[name] + max(-most, min(most, angle - here[name]))
        return steps

    def _send(self, positions: dict[str, float], now: float, lead: float) -> JointTarget:
        self._command.update(positions)
        self._command_due = now + lead
        self.guard.commanded(positions, now + lead)
        return JointTarget.of(positions, lead)

    def _present(self, names: tuple[str, ...]) -> tuple[float, ...]:
        """Where joints were told to be last; where they are, if they were told nothing."""
        state = self._state
        values = []
        for name in names:
            if name in self._command:
                values.append(self._command[name])
            elif state is not None and name in state.names and math.isfinite(state[name].position):
                values.append(state[name].position)
            else:
                raise UsageError(f"it is not known yet where {name} is: nothing has been heard of it")
        return tuple(values)

    def _refuse_if_stopped(self) -> None:
        if self.mode is Mode.STOPPED:
            raise LimitError(f"the arm is stopped ({self.reason}); reset first")
