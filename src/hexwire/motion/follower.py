"""The target of the arm in each cycle: from a trajectory, from streamed set-points, or hold.

Owns the choice: the latest set-point wins, a new trajectory blends in, lost set-points mean hold, a stop is
latched. Time comes in as an argument. Must not know robots, clocks or threads.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointState, JointTarget
from hexwire.units import decimal

from .safety import Guard, SafetyLimits, StopReason
from .trajectory import PEAK_SPEED
from .waypoints import Blend, Braked, Sample, Spline, Tail, Trajectory, Waypoint

__all__ = ["BRAKE", "Follower", "FollowerCounters", "Mode"]

BRAKE = 0.15
"""Seconds in which a robot that has the trajectory itself comes to rest on it."""

_STALL = 1.0
"""Delay behind the last command, in leads, from which the loop counts as stalled."""
_BLEND_STEP = 0.01
"""Seconds between two samples of a blend."""
_GAP, _LONGEST_GAP = 0.02, 2.0
"""Seconds between two positions that are recorded for a stall, and the part of a stall for which they are."""
_INSTANT = 0.05
"""Minimum blend time in seconds for the start check: a trajectory without duration may start slightly off."""


class Mode(Enum):
    """Mode of the follower."""

    HOLD = "hold"
    TRAJECTORY = "trajectory"
    STREAM = "stream"
    STOPPED = "stopped"


@dataclass(slots=True)
class FollowerCounters:
    """Event counters.

    Attributes:
        cycles: Cycles run.
        set_points: Set-points received.
        replaced: Set-points replaced by a newer one before they were sent.
        lost: Times that set-points stopped coming and the arm held.
        blends: Trajectories that replaced a motion.
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


class Follower:
    """Computes the target of the joints in each cycle.

    Args:
        arm: Limits and speeds.
        limits: Thresholds for an automatic stop.
        blend: Seconds in which a new trajectory takes over from a motion.
        lost_after: Seconds without a set-point after which the arm holds.
        jump: Share of a joint's speed limit that the start of a trajectory may require while blending in.

    Attributes:
        mode: Present mode.
        reason: Reason of the stop, or None.
        counters: Event counters.
        waits: After a stall of the loop the trajectory continues where it was, instead of catching up. False for a
            robot that keeps the time itself.
        settled: Seconds before which a robot that keeps the time itself must know of a change; 0 for one that does
            not.
        sent_ahead: Such a robot has the trajectory: it goes on through a stall, and a hold brakes on it.
        changes: How often a trajectory, a hold or a set-point has replaced what was planned.
        changed_from: From when on it was replaced since `take_change`; infinite if it was not.
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
                raise UsageError(f"blend, lost_after and jump must be above 0 and finite, not {value:g}")
        self.arm = arm
        self.guard = Guard(limits or SafetyLimits())
        self.mode = Mode.HOLD
        self.reason: StopReason | None = None
        self.counters = FollowerCounters()
        self.waits = True
        self.settled, self.sent_ahead = 0.0, False
        self.changes, self.changed_from = 0, math.inf
        self._blend, self._lost_after, self._jump = blend, lost_after, jump
        # After a hold it is the rest of it, on which the robot brakes.
        self._trajectory: Trajectory | None = None
        self._started = 0.0
        # The trajectory before it, and when that one started.
        self._earlier: tuple[Trajectory, float] | None = None
        # Both, also when they are over.
        self._planned: tuple[tuple[Trajectory, float], ...] = ()
        self._set_point: dict[str, float] = {}
        self._set_point_time = -math.inf
        self._fresh = False
        # The last commanded positions, and when they are due.
        self._command: dict[str, float] = {}
        self._command_due = -math.inf
        # Until then the robot is busy with what it has.
        self._busy_until = -math.inf
        self._now = -math.inf
        self._state: JointState | None = None

    # -- requests ---------------------------------------------------------------------------------

    def follow(self, trajectory: Trajectory, now: float, begins: float = -math.inf) -> None:
        """Follow a trajectory from now on; a running motion blends into it.

        Args:
            trajectory: The trajectory.
            now: Seconds.
            begins: Not earlier than this.

        Raises:
            UsageError: No state is known yet, or a joint does not exist.
            LimitError: Stopped, or the trajectory starts too far from the present position.
        """
        begins = max(begins, self.next_start(now))
        running = self._running(trajectory.names, begins)
        blend = self._blended(trajectory, begins)
        self.counters.blends += running is not None and self.mode is Mode.TRAJECTORY
        self._earlier = running
        self._trajectory, self._started = blend, begins
        self.mode = Mode.TRAJECTORY
        self._set_point = {}
        self._changed(begins)

    def takeover(
        self, trajectory: Trajectory, now: float, begins: float = -math.inf
    ) -> Iterator[tuple[float, dict[str, float]]]:
        """The joint positions while a trajectory takes over from a running motion; changes nothing.

        Args:
            trajectory: As for `follow`.
            now: Likewise.
            begins: Likewise.

        Yields:
            Seconds from its start, and radians by joint; nothing if the joints are at rest.

        Raises:
            UsageError, LimitError: As `follow`.
        """
        begins = max(begins, self.next_start(now))
        blend = self._blended(trajectory, begins)
        if self._running(trajectory.names, begins) is None:
            return
        seconds = min(self._blend, trajectory.duration)
        steps = max(1, math.ceil(seconds / _BLEND_STEP))
        for i in range(steps + 1):
            t = seconds * i / steps
            yield t, self._within_limits(dict(zip(blend.names, blend.sample(t).position, strict=True)))

    def _running(self, names: tuple[str, ...], when: float) -> tuple[Trajectory, float] | None:
        """What moves exactly these joints at a time, and when it started."""
        running = self._trajectory
        if running is None or running.names != names:
            return None
        if when < self._started and self._earlier is not None:
            return self._earlier
        return running, self._started

    def _changed(self, when: float) -> None:
        self.changes += 1
        self.changed_from = min(when, self.changed_from)
        now = () if self._trajectory is None else ((self._trajectory, self._started),)
        self._planned = now if self._earlier is None else (self._earlier, *now)

    def _blended(self, trajectory: Trajectory, begins: float) -> Blend:
        self._refuse_if_stopped()
        names = trajectory.names
        for name in names:
            self.arm.joint(name)
        here = self._present(names)
        old: Trajectory = Spline(names, [Waypoint(0.0, here)])
        switch = 0.0
        running = self._running(names, begins)
        if running is not None:
            # The last command may be ahead of now; going back behind it would be a jump.
            old, switch = running[0], begins - running[1]
        seconds = min(self._blend, trajectory.duration)
        here = old.sample(switch).position
        for name, a, b in zip(names, here, trajectory.start, strict=True):
            # The blend closes the gap as a quintic, whose peak speed is above its mean.
            if not PEAK_SPEED * abs(b - a) <= self._jump * self.arm.joint(name).max_speed * max(seconds, _INSTANT):
                gap = math.degrees(abs(b - a))
                raise LimitError(
                    f"the trajectory starts {decimal(gap, 3)} deg from the position of {name}; move there first"
                )
        return Blend(old, switch, trajectory, seconds)

    def set_point(self, positions: Mapping[str, float], now: float) -> None:
        """Move to a set-point; it replaces a waiting set-point and any trajectory.

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
        self.hold()
        self._set_point, self._set_point_time, self._fresh = checked, now, True
        self.mode = Mode.STREAM

    def hold(self) -> None:
        """Hold the last commanded position. A robot that has the trajectory itself brakes on it from there on."""
        if self.mode is Mode.STOPPED:
            return
        self._set_point, self._fresh = {}, False
        if self.mode is Mode.TRAJECTORY:
            self._leave()
        self.mode = Mode.HOLD

    def _leave(self) -> None:
        """End the trajectory: as soon as the robot can learn it, if it was sent ahead."""
        running = self._trajectory
        due = self._now + self.settled if self.sent_ahead else self._command_due
        self._trajectory, earlier, self._earlier = None, self._earlier, None
        if running is not None and self.sent_ahead:
            whole, began = earlier if due < self._started and earlier is not None else (running, self._started)
            if self._now >= began:
                self._trajectory, self._started = Braked(whole, due - began, BRAKE), began
        self._changed(due)

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
        self._trajectory, self._earlier, self._set_point, self._fresh = None, None, {}, False
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
        """Whether no trajectory is running and no set-point is followed."""
        return self.mode in {Mode.HOLD, Mode.STOPPED}

    def remaining(self, now: float) -> float:
        """Seconds until the trajectory ends; 0 if there is none."""
        if self._trajectory is None or self.mode is not Mode.TRAJECTORY:
            return 0.0
        return max(0.0, self._started + self._trajectory.duration - now)

    def keep_start(self, earliest: float, latest: float) -> None:
        """Move the start of the running trajectory between two times: a robot that keeps the time is there."""
        if self.mode is Mode.TRAJECTORY:
            self._started = max(earliest, min(latest, self._started))

    def shift(self, seconds: float) -> None:
        """Move everything planned in time: the robot's clock drifts, or it started later."""
        self._started += seconds
        if self._earlier is not None:
            self._earlier = self._earlier[0], self._earlier[1] + seconds
        self._planned = tuple([(path, began + seconds) for path, began in self._planned])

    def take_change(self) -> float:
        """From when on the plan was replaced since the last call."""
        when, self.changed_from = self.changed_from, math.inf
        return when

    @property
    def planned(self) -> tuple[tuple[Trajectory, float], ...]:
        """What was planned last, and when it starts; each counts until the next one starts. Empty after a drop."""
        return self._planned

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
        trajectory, began, mode = self._trajectory, self._started, self.mode
        if trajectory is None and mode is Mode.HOLD and wanted and self._planned:
            last, start = self._planned[-1]
            if left < start + last.duration and not isinstance(last, Braked):
                trajectory, began, mode = last, start, Mode.TRAJECTORY
        self._trajectory = self._earlier = None
        self._command.update({name: rest[name] for name in rest if name in self._command})
        self._command_due = now
        self._busy_until = -math.inf
        self._changed(now)
        if trajectory is None or mode is not Mode.TRAJECTORY:
            return
        self.mode = Mode.HOLD
        self.counters.slips += 1
        self.follow(Tail(trajectory, max(0.0, left - began)), now)

    def ahead(self, when: float) -> Trajectory | None:
        """The rest of the running trajectory at a time, or None."""
        return None if self._trajectory is None else Tail(self._trajectory, when - self._started)

    def observe(self, state: JointState, now: float = -math.inf) -> None:
        """Store a state between cycles, so that a motion that starts now starts at the arm's position.

        Args:
            state: The state.
            now: Seconds; a hold counts from then on.
        """
        self._state = state
        self._now = max(now, self._now)

    def next_start(self, now: float) -> float:
        """When a trajectory given now would start: not before the last command is due, and not while braking."""
        braking = self._trajectory if self.mode is not Mode.TRAJECTORY else None
        rest = -math.inf if braking is None else self._started + braking.duration
        return max(now + self.settled, self._command_due, rest)

    @property
    def due(self) -> float:
        """When the last command is due."""
        return self._command_due

    def desired(self, names: tuple[str, ...], now: float) -> Sample:
        """Desired state of joints at a time; at rest unless a trajectory of exactly these joints is running.

        Raises:
            UsageError: Their position is still unknown.
        """
        if (running := self._running(names, now)) is not None:
            return running[0].sample(now - running[1])
        rest = (0.0,) * len(names)
        return Sample(self._present(names), rest, rest)

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
        if self.sent_ahead or not self.waits:
            self._fill_in(now)
        if (found := self.guard.judge(state, now)) is not None:
            self.stop(found)
            return found
        if self._trajectory is not None:
            return self._advance(self._trajectory, now, max(lead, self.settled))
        if self.mode is Mode.STREAM:
            self._fresh = False
            if now - self._set_point_time > self._lost_after:
                self.counters.lost += 1
                self.hold()
                return None
            if now < self._busy_until:
                return None
            return self._send(self._towards(self._set_point, now, lead), now, lead)
        return None

    def _advance(self, trajectory: Trajectory, now: float, lead: float) -> JointTarget:
        if self.waits and not self.sent_ahead:
            self._slip(now, lead)
        t = now + lead - self._started
        running = self._running(trajectory.names, now + lead)
        whole, began = running if running is not None else (trajectory, self._started)
        if t >= trajectory.duration:
            self._trajectory = self._earlier = None
            if self.mode is Mode.TRAJECTORY:
                self.mode = Mode.HOLD
            if self.sent_ahead:
                self._busy_until = self._started + trajectory.duration
        positions = dict(zip(trajectory.names, whole.sample(now + lead - began).position, strict=True))
        if t < self._blend:
            positions = self._within_limits(positions)
        return self._send(positions, now, lead)

    def _within_limits(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Clamp to the limits: a blend may overshoot both trajectories, or begin at a joint that rests outside."""
        joints = {name: self.arm.joint(name) for name in positions}
        return {n: min(max(angle, joints[n].minimum), joints[n].maximum) for n, angle in positions.items()}

    def _fill_in(self, now: float) -> None:
        """Record where a robot that keeps the time itself was sent during a stall of this loop."""
        trajectory = self._trajectory
        if trajectory is None or not math.isfinite(self._command_due):
            return
        due = max(self._command_due, now - _LONGEST_GAP)
        while (due := due + _GAP) < now:
            position = trajectory.sample(due - self._started).position
            self.guard.commanded(dict(zip(trajectory.names, position, strict=True)), due)

    def _slip(self, now: float, lead: float) -> None:
        """After a stall, continue from the last command: catching up would be a jump."""
        stall = now - max(self._command_due, self._started)
        if stall > _STALL * lead:
            self.shift(stall)
            self.counters.slips += 1

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
        self._command.update(positions)
        self._command_due = now + lead
        self.guard.commanded(positions, now + lead)
        return JointTarget.of(positions, lead)

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
