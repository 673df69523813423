"""The one judge of arrival: whether joints stand where a motion was to end, not yet, or not in time, and why.

Owns tolerances and that verdict. Pure: time, states and targets come in as arguments. Must not know robots, what is
followed, nor who waits for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.motion.waypoints import Sample

__all__ = ["Arrival", "Deviation", "Tolerance", "Verdict", "deviations", "in_words"]

_SHOWN = 5
"""Deviations that a text lists at most."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far one joint may be off; 0 is not checked.

    Attributes:
        position: Radians.
        velocity: Radians per second.
        acceleration: Radians per second squared; kept, but never judged, since no arm here measures it.
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
        allowed: Likewise.
        of_speed: It is the speed that is off, not the position.
    """

    joint: str
    by: float
    allowed: float
    of_speed: bool = False

    def words(self, aim: str) -> str:
        """A sentence for people; `aim` is what it is off, as in ``goal``."""
        if self.by == math.inf:
            return f"it is not known where {self.joint} is"
        unit = "/s" if self.of_speed else ""
        who = f"the speed of {self.joint}" if self.of_speed else self.joint
        return f"{who} is {_angle(self.by, unit)} off its {aim}, {_angle(self.allowed, unit)} are allowed"


class Verdict(Enum):
    """What `Arrival` says of a state."""

    NOT_YET = "not yet"
    ARRIVED = "arrived"
    MISSED = "missed"


class Arrival:
    """Judges, state by state, whether a motion has arrived.

    Args:
        tolerances: By joint; every joint that is judged has a row.
        ends: When the motion ends, seconds; may be moved while it is under way.
        grace: Seconds in which the goal must be reached, from the first state after the end; 0 waits for ever.
        early: A state within the tolerances counts before the end as well.

    Attributes:
        ends: As above.
        off: What is not within its tolerance, worst first, as of the last state.
    """

    def __init__(
        self, tolerances: Mapping[str, Tolerance], ends: float, grace: float = 0.0, *, early: bool = False
    ) -> None:
        self.ends = ends
        self.off: tuple[Deviation, ...] = ()
        self._tolerances, self._grace, self._early = tolerances, grace, early
        # When a state after the end was first found wanting; time in which nobody looked does not count.
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
        """Judge a state.

        Args:
            now: Seconds.
            names: Joints, in the order of all that follows.
            desired: Where they are to be.
            position: Radians; NaN is in no tolerance.
            velocity: Radians per second; NaN is not judged.
            sampled: When the oldest of these values was measured, seconds; before the end it says nothing of it.
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
        """What was missing in the last state, for people; empty if nothing was."""
        if self._stale and not self.off:
            return "not every joint has been heard of since the end"
        return in_words(self.off, "goal")


def deviations(
    tolerances: Mapping[str, Tolerance],
    names: Sequence[str],
    desired: Sample,
    position: Sequence[float],
    velocity: Sequence[float],
) -> list[Deviation]:
    """What is not within its tolerance, worst first; arguments as in `Arrival.judge`."""
    found: list[Deviation] = []
    columns = zip(names, desired.position, position, desired.velocity, velocity, strict=True)
    for name, want, have, speed, actual_speed in columns:
        allowed = tolerances[name]
        off = abs(have - want)
        # Not "off > allowed": an unknown position is in no tolerance.
        if allowed.position > 0.0 and not off <= allowed.position:
            found.append(Deviation(name, math.inf if math.isnan(off) else off, allowed.position))
        off = abs(actual_speed - speed)
        if allowed.velocity > 0.0 and off > allowed.velocity:
            found.append(Deviation(name, off, allowed.velocity, of_speed=True))
    # Stable, so that of two equally bad the first joint comes first.
    found.sort(key=lambda row: -row.by / row.allowed)
    return found


def in_words(found: Sequence[Deviation], aim: str) -> str:
    """Deviations for people, the worst of them; empty if there is none."""
    texts = [row.words(aim) for row in found[:_SHOWN]]
    if len(found) > _SHOWN:
        texts.append(f"{len(found) - _SHOWN} more")
    return "; ".join(texts)


def _angle(value: float, per: str = "") -> str:
    return f"{value:.3g} rad{per} ({math.degrees(value):.3g} deg{per})"
