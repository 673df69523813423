"""A single target that the board interpolates itself, or that is sent in short steps where nothing would stop it.

Owns what of it is sent when, and what became of it. Time comes in as an argument. Must not know robots or threads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hexwire.model.state import JointTarget, SentTarget
from hexwire.motion.safety import StopReason, board_stop
from hexwire.motion.waypoints import Sample

from .arrival import Arrival, Deviation, Tolerance, Verdict

if TYPE_CHECKING:
    from hexwire.model.state import JointState

    from .outcomes import Ended, GoalListener

__all__ = ["TargetController"]

_AHEAD = 1.5
"""Steps that a target is sent ahead, so that a late one is no pause."""


class TargetController:
    """Leads joints to one target, once.

    Args:
        target: Where to, and in which time; no speed limit forbids it.
        here: Where the joints are, radians by name; NaN if unknown.
        tolerances: By joint of the target.
        grace: Seconds beyond its duration in which the joints must arrive.
        step: Seconds between two steps on the straight line; None to send the whole target at once.
        early: They may arrive before the time is over.

    Attributes:
        sent: What was really sent, once all of it was; or None.
        over: Nothing more will be done, for whatever reason.
        arrived: The joints are there.
        off: Which of them are not, as of the last state.
        limp: Which of them have lost their torque.
    """

    def __init__(
        self,
        target: JointTarget,
        here: Mapping[str, float],
        tolerances: Mapping[str, Tolerance],
        *,
        grace: float,
        step: float | None = None,
        early: bool = True,
    ) -> None:
        self.sent: SentTarget | None = None
        self.over = self.arrived = False
        self.off: tuple[Deviation, ...] = ()
        self.limp: tuple[str, ...] = ()
        self._target, self._tolerances, self._grace, self._early = target, tolerances, grace, early
        self._step = step
        goal = dict(target.positions)
        # No joint can be led from an unknown position: it is sent to its end.
        self._start = {name: here[name] if math.isfinite(here[name]) else goal[name] for name in goal}
        self._begun = self._now = -math.inf
        self._last = False
        self._silent: dict[str, None] = {}
        self._arrival: Arrival | None = None
        self._reason: StopReason | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Names."""
        return tuple(self._start)

    @property
    def busy(self) -> bool:
        """It is not over."""
        return not self.over

    @property
    def moving(self) -> bool:
        """Something was sent, and it is not over."""
        return self._begun > -math.inf and not self.over

    @property
    def reason(self) -> StopReason | None:
        """Why it was stopped, or None."""
        return self._reason

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Whether the joints are there."""
        if self.over or self._arrival is None or self.sent is None:
            return
        names = tuple(name for name, _ in self.sent.positions)
        goal = tuple(angle for _, angle in self.sent.positions)
        rest = (0.0,) * len(names)
        places = [state.names.index(name) for name in names]
        verdict = self._arrival.judge(
            now,
            names,
            Sample(goal, rest, rest),
            [state.position[i] for i in places],
            [velocity[i] for i in places],
            state.stamp - max(state.age[i] for i in places),
        )
        self.off = self._arrival.off
        self.arrived = verdict is Verdict.ARRIVED
        if not self.arrived:
            self._reason = board_stop(state)
            self.limp = tuple(name for name in names if name not in state.torque_on)
        self.over = self.arrived or verdict is Verdict.MISSED or self._reason is not None or bool(self.limp)

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """What to send now."""
        if self.over or self._last:
            return None
        self._now, self._begun = now, now if self._begun == -math.inf else self._begun
        if self._step is None:
            self._last = True
            return self._target
        goal, duration, since = dict(self._target.positions), self._target.duration, now - self._begun
        if since >= duration:
            self._last = True
            return JointTarget.of(goal, self._step)
        share = min(1.0, (since + self._step) / duration)
        place = {name: start + share * (goal[name] - start) for name, start in self._start.items()}
        return JointTarget.of(place, _AHEAD * self._step)

    def was_sent(self, sent: SentTarget) -> None:
        """Take note of what became of the last thing to send."""
        self._silent |= dict.fromkeys(sent.silent)
        if self._last:
            duration = sent.duration if self._step is None else self._target.duration
            self.sent = SentTarget(sent.positions, duration, sent.clamped, tuple(self._silent))
            ends = self._now + (duration if self._step is None else 0.0)
            self._arrival = Arrival(self._tolerances, ends, self._grace, early=self._early)

    def stop(self, reason: StopReason) -> None:
        """It is over."""
        if not self.over:
            self._reason, self.over = reason, True

    def reset(self) -> None:
        """Nothing goes on by it."""

    def release(self, why: str) -> None:
        """It is over."""
        self.over = True

    def take_ended(self) -> list[tuple[GoalListener, Ended]]:
        """Nobody is told: whoever runs it looks."""
        return []
