"""Conditions that stop a moving arm automatically: following error, load, faults, old states.

Owns the thresholds and their check in each cycle; time comes in as an argument.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Self

from hexwire.errors import UsageError
from hexwire.model.state import JointFlag, JointState

__all__ = ["STOP_COMMAND", "TORQUE_OFF", "SafetyGuard", "SafetyLimits", "StopReason", "board_stop", "silence"]


_SILENT = int(JointFlag.SILENT)
_STOPPED = "stopped: "


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Thresholds. A condition must last for its time to count. Times are in seconds.

    Attributes:
        following_error: Distance of a joint from its command, radians.
        following_time: Its time.
        lag: Permitted delay of a servo; a joint that is only late by less has no following error.
        load: Effort that counts as an overload, fraction of full.
        load_time: Its time.
        collision_load: Effort that, together with `collision_error`, means a collision.
        collision_error: Distance from the command, radians.
        collision_time: Their time.
        max_age: A joint without a new position for this long is lost.
        faults: Servo faults that stop the arm at once.
    """

    following_error: float = math.radians(12.0)
    following_time: float = 0.4
    lag: float = 0.3
    load: float = 0.9
    load_time: float = 0.6
    collision_load: float = 0.5
    collision_error: float = math.radians(4.0)
    collision_time: float = 0.15
    max_age: float = 0.5
    faults: JointFlag = (
        JointFlag.OVERLOAD | JointFlag.TEMPERATURE | JointFlag.CURRENT | JointFlag.ENCODER | JointFlag.VOLTAGE
    )

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not isinstance(value, JointFlag) and not value > 0:
                raise UsageError(f"safety limit {name} = {value} must be above 0")

    @classmethod
    def at_period(cls, period: float, **chosen: Any) -> Self:
        """Thresholds for a line that carries one state and one target per period.

        On a slow line states are old and commands late, although nothing is wrong.

        Args:
            period: Seconds between two cycles.
            **chosen: Thresholds set explicitly; the period does not change them.

        Raises:
            UsageError: The period or a threshold is not above 0.
        """
        if not 0 < period < math.inf:
            raise UsageError(f"a period must be finite and above 0 s, not {period:g}")
        usual = cls()
        widened = {"lag": max(usual.lag, 2.5 * period), "max_age": max(usual.max_age, 3 * period)}
        return cls(**(widened | chosen))


@dataclass(frozen=True, slots=True)
class StopReason:
    """Why the arm was stopped.

    Attributes:
        kind: asked, following, overload, collision, fence, fault, lost or board.
        text: Description.
        joint: Name of the joint; empty if no particular joint is the reason.
    """

    kind: str
    text: str
    joint: str = ""

    def __str__(self) -> str:
        return self.text

    @property
    def outcome(self) -> str:
        """How what was going on has ended, in words."""
        return f"{_STOPPED}{self.text}"

    @classmethod
    def of_outcome(cls, kind: str, outcome: str) -> Self:
        """The reason of which another program has said the `outcome`, or the reason itself."""
        return cls(kind, outcome.removeprefix(_STOPPED))


STOP_COMMAND = "a stop command has stopped the arm"
"""Text of a stop that was ordered, by this program or from elsewhere."""
TORQUE_OFF = "torque was switched off"
"""Text of a motion that ended because of that."""


def board_stop(state: JointState) -> StopReason | None:
    """What has stopped the arm, according to its state; None if nothing has.

    An arm on a servo bus has no board: only a stop command stops it.
    """
    if not state.stopped:
        return None
    if state.watchdog_tripped:
        return StopReason(
            "board", f"the board has stopped the arm: its watchdog tripped, because {state.trip_reason}"
        )
    return StopReason("board", STOP_COMMAND)


def silence(state: JointState, names: Collection[str]) -> StopReason:
    """Why the arm was stopped if one of these joints was silent: the one of which the state says so."""
    silent = [name for name in names if name in state.silent]
    if not silent:
        return StopReason("lost", "a joint did not answer for a moment")
    name = max(silent, key=lambda name: state[name].age)
    return StopReason("lost", f"{name} has not answered for {state[name].age:.2f} s", name)


class SafetyGuard:
    """Checks states against the commands.

    Args:
        limits: Thresholds.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        # As a plain number: enums take long in every cycle.
        self._faults = int(limits.faults)
        self._commands: dict[str, deque[tuple[float, float]]] = {}
        self._since: dict[tuple[str, str], float] = {}
        self._seen: dict[str, float] = {}
        self._judged = math.inf

    def forget(self) -> None:
        """Restart, for example after a stop."""
        self._commands.clear()
        self._since.clear()
        self._seen.clear()
        self._judged = math.inf

    def commanded(self, positions: Mapping[str, float], due: float) -> None:
        """Record the commanded positions of joints at a time."""
        begin = due - self.limits.lag - 2 * self.limits.max_age
        for name, angle in positions.items():
            history = self._commands.setdefault(name, deque())
            history.append((due, angle))
            # The command in force at the start of the window counts too.
            while len(history) > 1 and history[1][0] < begin:
                history.popleft()

    def judge(self, state: JointState, now: float) -> StopReason | None:
        """The reason why the arm must stop; None if there is none."""
        limits = self.limits
        self._pass_over_stalls(now)
        stopped = board_stop(state)
        if stopped is not None:
            return stopped
        seen, commands, max_age = self._seen, self._commands, limits.max_age
        columns = zip(state.names, state.position, state.load, state.flags, state.age, strict=True)
        for name, position, effort, flags, age in columns:
            # A joint that does not report its position counts as silent, whatever else it reports.
            if not flags & _SILENT and age <= max_age and math.isfinite(position):
                seen[name] = now - age
            if name not in commands:
                continue
            heard = seen.setdefault(name, now)
            if now - heard > max_age:
                return StopReason("lost", f"{name} has not answered for {now - heard:.2f} s", name)
            if flags & self._faults:
                return StopReason("fault", f"{name} reports {JointFlag(flags) & limits.faults}", name)
            error = self._error(name, position, now - age)
            load = abs(effort) if math.isfinite(effort) else 0.0
            hits = load > limits.collision_load and error > limits.collision_error
            if self._lasts("collision", name, now, limits.collision_time, hits):
                text = f"{name} hit something: load {load:.0%}, {math.degrees(error):.1f} deg off its path"
                return StopReason("collision", text, name)
            if self._lasts("following", name, now, limits.following_time, error > limits.following_error):
                return StopReason("following", f"{name} is {math.degrees(error):.1f} deg off its path", name)
            if self._lasts("overload", name, now, limits.load_time, load > limits.load):
                return StopReason("overload", f"{name} is overloaded: load {load:.0%}", name)
        return None

    def _error(self, name: str, position: float, when: float) -> float:
        """Distance from everything that was commanded within the lag before `when`, radians."""
        begin = when - self.limits.lag
        low, high = math.inf, -math.inf
        for due, angle in reversed(self._commands[name]):
            if due <= when:
                # Not by min and max, whose calls take most of a cycle.
                if angle < low:
                    low = angle
                if angle > high:
                    high = angle
                # This command was in force at the start of the window; older ones do not count.
                if due <= begin:
                    break
        if high < low:
            # Nothing is due yet: the joint is moving to the oldest command.
            low = high = self._commands[name][0][1]
        return max(0.0, low - position, position - high)

    def _pass_over_stalls(self, now: float) -> None:
        """Time without checks does not prove that a condition lasted: it counts as one cycle."""
        stall = now - self._judged - 0.4 * self.limits.lag
        if stall > 0:
            for key in self._since:
                self._since[key] += stall
        self._judged = now

    def _lasts(self, kind: str, name: str, now: float, seconds: float, is_so: bool) -> bool:
        if not is_so:
            if self._since:
                self._since.pop((kind, name), None)
            return False
        return now - self._since.setdefault((kind, name), now) >= seconds
