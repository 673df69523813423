"""The one check of arrival: whether joints have reached their goal, not yet, or not in time, and why.

Owns tolerances and the verdict. Pure: time, states and targets come in as arguments. Must not know robots or
trajectories.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.motion.trajectory import Sample

__all__ = ["Arrival", "Deviation", "Tolerance", "Verdict", "deviations", "in_words", "off_goal"]

_SHOWN = 5
"""Most deviations listed in a text."""
_EXACT = math.radians(0.1)
"""A little more than a count: a smaller distance from the goal is not worth a word."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Greatest deviations of one joint; 0 means not checked.

    Attributes:
        position: Radians.
        velocity: Radians per second.
        acceleration: Radians per second squared; stored, but never checked, since no supported arm measures it.
    """

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True)
class Deviation:
    """A joint that is not within its tolerance.

    Attributes:
        joint: Its name.
        by: Radians, or radians per second; infinite if its position is unknown.
        allowed: Tolerance; likewise.
        of_speed: The velocity is off, not the position.
    """

    joint: str
    by: float
    allowed: float
    of_speed: bool = False

    def words(self, aim: str) -> str:
        """A sentence; `aim` is the reference, for example ``goal``."""
        if self.by == math.inf:
            return f"the position of {self.joint} is unknown"
        unit = "/s" if self.of_speed else ""
        who = f"the velocity of {self.joint}" if self.of_speed else self.joint
        return f"{who} is {_angle(self.by, unit)} off its {aim}, tolerance {_angle(self.allowed, unit)}"


class Verdict(Enum):
    """The result of `Arrival.judge`."""

    NOT_YET = "not yet"
    ARRIVED = "arrived"
    MISSED = "missed"


class Arrival:
    """Checks, state by state, whether a motion has arrived.

    Args:
        tolerances: By joint; every checked joint has a row.
        ends: When the motion ends, seconds; may change during the motion.
        grace: Seconds in which the goal must be reached, from the first state after the end; 0 waits forever.
        early: A state within the tolerances counts before the end too.

    Attributes:
        ends: As above.
        off: Joints out of tolerance in the last state, worst first.
    """

    def __init__(
        self, tolerances: Mapping[str, Tolerance], ends: float, grace: float = 0.0, *, early: bool = False
    ) -> None:
        self.ends = ends
        self.off: tuple[Deviation, ...] = ()
        self._tolerances, self._grace, self._early = tolerances, grace, early
        # Time of the first state after the end that was out of tolerance.
        self._missed = math.inf
        self._stale = False

    def judge(
        self,
        now: float,
        names: Sequence[str],
        desired: Sample,
        position: Sequence[float],
        velocity: Sequence[float],
        sampled: float = math.inf,
    ) -> Verdict:
        """Check a state.

        Args:
            now: Seconds.
            names: Joints, in the order of the other arguments.
            desired: Desired state.
            position: Radians; NaN is never within a tolerance.
            velocity: Radians per second; NaN is not checked.
            sampled: When the oldest of these values was measured, seconds; values from before the end do not count.
        """
        over = now >= self.ends
        if not over and not self._early:
            return Verdict.NOT_YET
        self.off = tuple(deviations(self._tolerances, names, desired, position, velocity))
        self._stale = sampled < self.ends and not self._early
        if not self.off and not self._stale:
            return Verdict.ARRIVED
        if not over:
            return Verdict.NOT_YET
        self._missed = min(self._missed, now)
        return Verdict.MISSED if self._grace and now > self._missed + self._grace else Verdict.NOT_YET

    @property
    def why(self) -> str:
        """Why the last state did not count as arrival; empty if it did."""
        if self._stale and not self.off:
            return "some joints have not reported since the end"
        return in_words(self.off, "goal")


def deviations(
    tolerances: Mapping[str, Tolerance],
    names: Sequence[str],
    desired: Sample,
    position: Sequence[float],
    velocity: Sequence[float],
) -> list[Deviation]:
    """Deviations beyond the tolerances, worst first; arguments as in `Arrival.judge`."""
    found: list[Deviation] = []
    columns = zip(names, desired.position, position, desired.velocity, velocity, strict=True)
    for name, want, have, speed, actual_speed in columns:
        allowed = tolerances[name]
        off = abs(have - want)
        # Not "off > allowed", since an unknown position (NaN) is a deviation.
        if allowed.position > 0.0 and not off <= allowed.position:
            found.append(Deviation(name, math.inf if math.isnan(off) else off, allowed.position))
        off = abs(actual_speed - speed)
        if allowed.velocity > 0.0 and off > allowed.velocity:
            found.append(Deviation(name, off, allowed.velocity, of_speed=True))
    # The sort is stable: equal deviations stay in joint order.
    found.sort(key=lambda row: -row.by / row.allowed)
    return found


def off_goal(names: Sequence[str], goal: Sequence[float], position: Sequence[float]) -> str:
    """How far off its goal the worst joint is, such as ``J2 0.6 deg off``; empty if it is less than 0.1 degree.

    Args:
        names: Joints, in the order of the other arguments.
        goal: Radians.
        position: Radians; NaN if unknown.
    """
    off, name = max(
        ((abs(have - want), name) for name, want, have in zip(names, goal, position, strict=True)),
        default=(0.0, ""),
    )
    return f"{name} {math.degrees(off):.1f} deg off" if _EXACT <= off < math.inf else ""


def in_words(found: Sequence[Deviation], aim: str) -> str:
    """The worst deviations in words; empty if there are none."""
    texts = [row.words(aim) for row in found[:_SHOWN]]
    if len(found) > _SHOWN:
        texts.append(f"{len(found) - _SHOWN} more")
    return "; ".join(texts)


def _angle(value: float, per: str = "") -> str:
    return f"{value:.3g} rad{per} ({math.degrees(value):.3g} deg{per})"
