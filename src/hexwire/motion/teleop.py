"""Teleoperation: from the state of a joystick to set-points of an arm, one cycle at a time.

Owns the rules that make it safe (the dead-man button, a lost channel, which axes count) and joint and Cartesian
jog. Time comes in as `now`. Knows no devices, channels or boards; axes and buttons are plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from hexwire.errors import LimitError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.gripper import jaws_of
from hexwire.model.kinematics import KinematicModel

from .moving import Pieces, State, brake, change, joint_limits, rest_range
from .operator_tool import OperatorTool
from .trajectory import Sample

__all__ = ["Action", "Jog", "JogMode", "StickMap", "Teleop", "within_limits"]

_LONGEST_STEP = 0.1
"""Longest time in seconds that one cycle integrates: a program that stalled must not catch up."""
_LOOK = 0.05
"""Seconds between two places of a brake that are checked before a step from which it would begin."""
_NO_LEAD, _GOOD_LEAD, _MOST_LEAD = (math.radians(angle) for angle in (1.0, 7.0, 10.0))
"""How far a set-point is ahead of its joint when that says nothing, when its speed is right, and at most: a blocked
joint must not jump when it is released."""
_CREEP = 0.1
"""Share of the wanted speed with which it goes on where nothing moves."""
_SHARES = (1.0, 0.5, 0.25, 0.0)
"""Shares of the wanted speed that are tried before the joints brake."""
_RESTS = 0.1
"""Seconds after the end of the last set-point in which the joints come to rest, if no other one comes."""
_HALVINGS = 20
_Speeds = tuple[tuple[float, float], ...]
_NO_SPEEDS: _Speeds = ((0.0, 0.0),) * 6
_NOTHING = (0.0,) * 6


class JogMode(Enum):
    """Meaning of the axes."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


class Action(Enum):
    """What to do in this cycle."""

    IDLE = "idle"
    """Nothing: the arm holds already."""
    MOVE = "move"
    """Send the set-point."""
    HOLD = "hold"
    """Hold the present position, at once: where joints do not follow, or may not go on while they brake."""


@dataclass(frozen=True, slots=True)
class StickMap:
    """Assignment of axes and buttons; the defaults fit a common game pad.

    Attributes:
        axes: For each joint in joint jog, and for x, y, z and the turns about them in Cartesian jog, the axis that
            moves it; -1-n for axis n reversed; None for no axis.
        dead_man: Button that must be held for anything to move.
        mode: Button that switches between joint and Cartesian jog.
        close: Button that closes the gripper (the joint after those of the kinematics, if there is one).
        open: Button that opens it.
        dead_zone: Deflection that counts as zero.
    """

    axes: tuple[int | None, ...] = (0, -2, -5, 3, 6, 7)
    dead_man: int = 4
    mode: int = 7
    close: int = 0
    open: int = 1
    dead_zone: float = 0.12

    def __post_init__(self) -> None:
        if not 0.0 <= self.dead_zone < 1.0:
            raise UsageError(f"a dead zone must be from 0 to below 1, not {self.dead_zone:g}")


@dataclass(frozen=True, slots=True)
class Jog:
    """The outcome of one cycle.

    Attributes:
        action: What to do.
        positions: With MOVE the set-point, radians by joint name.
        note: Message for the user; may be empty.
    """

    action: Action
    positions: Mapping[str, float]
    note: str = ""


class Teleop:
    """The rules, and the set-point.

    The dead-man button counts only after it was released once: a stuck button, or one held while the channel comes
    back, moves nothing. An axis counts only after it was at rest while the button was held, so that a stick that is
    already deflected, or a trigger that rests at one end, moves nothing either.

    What the stick asks for is a velocity. The set-point comes to it within the limits of acceleration and jerk, and
    goes only where the joints can come to rest within these limits, their ranges and what `check` allows: so they
    slow down before a limit, and brake when the button is released or the channel lost.

    Args:
        arm: Joints and limits.
        kinematics: For Cartesian jog; with None only joint jog is possible.
        stick: Assignment of axes and buttons.
        mode: Initial mode.
        share: Share of each joint's speed limit at full deflection.
        linear: Speed of the tool at full deflection, m/s.
        angular: The same for turns, rad/s.
        stale: Age of the joystick state in seconds from which the channel counts as lost.
        check: Called with the set-point before and a new one, radians by name; the new one has the joints within
            their limits. Raises LimitError where the arm must not go.
    """

    def __init__(
        self,
        arm: ArmModel,
        kinematics: KinematicModel | None = None,
        stick: StickMap | None = None,
        *,
        mode: JogMode = JogMode.JOINT,
        share: float = 0.3,
        linear: float = 0.05,
        angular: float = 0.4,
        stale: float = 0.25,
        check: Callable[[Mapping[str, float], Mapping[str, float]], object] = lambda before, goal: None,
    ) -> None:
        if not 0.0 < share <= 1.0:
            raise UsageError(f"the share of the speed limits must be above 0 and at most 1, not {share:g}")
        if mode is JogMode.CARTESIAN and kinematics is None:
            raise UsageError(f"no Cartesian jog for {arm.name}: its kinematics are unknown")
        self.arm = arm
        self.kinematics = kinematics
        self.stick = stick or StickMap()
        self.mode = mode
        jaws = jaws_of(arm)
        # The direction in which the gripper closes.
        self._closes = -1.0 if jaws is not None and jaws.closed < jaws.opened else 1.0
        self._tool = None if kinematics is None else OperatorTool(arm, kinematics)
        self._limits = dict(zip(arm.names, joint_limits(arm, arm.names), strict=True))
        self._share = share
        self._linear = linear
        self._angular = angular
        self._stale = stale
        self._check = check
        self._free = False
        self._active = False
        self._alive: set[int] = set()
        self._before = 0
        self._last, self._lead = 0.0, math.inf
        self._follows = True
        self._states: dict[str, State] = {}
        self._speeds = _NO_SPEEDS
        # How the joints come to rest from where they are, and how much of it is over; None if they are at rest.
        self._brake: Pieces | None = None
        self._braked = 0.0
        # They brake, whatever the stick says.
        self._ends = False
        self._noted = ""

    def update(
        self,
        axes: Sequence[float],
        buttons: int,
        age: float,
        positions: Mapping[str, float],
        now: float,
        *,
        lead: float = math.inf,
        ends: Mapping[str, float] | None = None,
    ) -> Jog:
        """One cycle.

        Args:
            axes: Last received values, -1..1 each.
            buttons: Bit i is button i.
            age: Seconds since they were received; infinite if never.
            positions: Present joint positions, radians by name.
            now: Seconds, monotonic.
            lead: Seconds that the arm takes for this set-point: if the next one comes much later, it rests.
            ends: Where joints come to rest although the stick goes on, radians by name.
        """
        step = min(max(now - self._last, 0.0), _LONGEST_STEP)
        if now - self._last > self._lead + _RESTS:
            self._rest()
        self._last, self._lead = now, lead
        if not age < self._stale:
            self._free = False
            return self._let_go("no joystick" if math.isinf(age) else "the joystick's channel is silent", step)
        held = bool(buttons >> self.stick.dead_man & 1)
        pressed, self._before = buttons & ~self._before, buttons
        if not held:
            self._free = True
            self._change_mode(pressed)
            return self._let_go("", step)
        if not self._free:
            return self._let_go("release the dead-man button first", step)
        if self._ends and not self._active:
            return self._let_go("", step)
        if not all(math.isfinite(positions.get(name, math.nan)) for name in self.arm.names):
            return self._hold("the joint positions are unknown")
        if not self._active:
            self._active, step = True, 0.0
            self._alive.clear()
            self._states = {name: (positions[name], 0.0, 0.0) for name in self.arm.names}
            self._rest()
            self._follows = True
        note = self._go_on(axes, buttons, positions, step, ends or {})
        return Jog(Action.MOVE, self._goal, note)

    def drop(self) -> None:
        """Forget the motion, without a brake: the arm was stopped."""
        self._active = False
        self._rest()

    @property
    def _goal(self) -> dict[str, float]:
        return {name: state[0] for name, state in self._states.items()}

    def _rest(self) -> None:
        """The joints are at rest where the set-point is."""
        self._states = {name: (state[0], 0.0, 0.0) for name, state in self._states.items()}
        self._speeds, self._brake, self._ends = _NO_SPEEDS, None, False

    def _let_go(self, note: str, step: float) -> Jog:
        """The button is released, or nobody knows: the joints brake."""
        if self._brake is None or (self._active and not self._follows):
            return self._hold(note)
        self._active, self._ends = False, True
        self._go_on_braking(step)
        return Jog(Action.MOVE, self._goal, note)

    def _hold(self, note: str) -> Jog:
        action = Action.HOLD if self._active else Action.IDLE
        self.drop()
        return Jog(action, {}, note)

    def _change_mode(self, pressed: int) -> None:
        # Only while nothing moves, because the meaning of the axes changes.
        if pressed >> self.stick.mode & 1 and self.kinematics is not None:
            self.mode = JogMode.JOINT if self.mode is JogMode.CARTESIAN else JogMode.CARTESIAN

    def _wanted(self, axes: Sequence[float]) -> list[float]:
        """Deflection for each direction, -1..1; axes that do not count give 0."""
        wanted = []
        zone = self.stick.dead_zone
        for source in self.stick.axes:
            axis = 0 if source is None else source if source >= 0 else -1 - source
            if source is None or axis >= len(axes) or not abs(axes[axis]) <= 1.0:
                wanted.append(0.0)
                continue
            value = axes[axis]
            if abs(value) <= zone:
                self._alive.add(axis)
                value = 0.0
            elif axis not in self._alive:
                value = 0.0
            else:
                # Zero at the edge of the dead zone, so that there is no jump.
                value = math.copysign((abs(value) - zone) / (1.0 - zone), value)
            wanted.append(value if source >= 0 else -value)
        return wanted

    # -- one step ------------------------------------------------------------------------------------

    def _go_on(
        self,
        axes: Sequence[float],
        buttons: int,
        positions: Mapping[str, float],
        step: float,
        ends: Mapping[str, float],
    ) -> str:
        """Follow the stick as far as that is allowed; return a note."""
        wanted, before, in_space = self._wanted(axes), self._states, self.mode is JogMode.CARTESIAN
        note = self._noted = ""
        if not step:
            return note
        for share in () if self._ends else _SHARES if in_space else _SHARES[:-1]:
            try:
                states, speeds = self._step(
                    [share * deflection for deflection in wanted], buttons, positions, step, ends
                )
                brakes = self._allowed_brake(states)
            except LimitError as error:
                note = note or str(error)
                continue
            self._states, self._speeds, self._brake, self._braked = states, speeds, brakes, 0.0
            break
        else:
            # There is one that is allowed from the state before. In space it leaves the line of the tool.
            self._ends = in_space and self._brake is not None
            self._go_on_braking(step)
        self._follows = self._keep_near(before, positions)
        return note or self._noted or ("" if self._follows else "the arm does not follow")

    def _step(
        self,
        wanted: Sequence[float],
        buttons: int,
        positions: Mapping[str, float],
        step: float,
        ends: Mapping[str, float],
    ) -> tuple[dict[str, State], _Speeds]:
        """The states after a step with these deflections."""
        speeds, states = _NO_SPEEDS, dict[str, State]()
        deflections = dict(zip(self.arm.names, wanted, strict=False))
        if self._tool is not None and self.mode is JogMode.CARTESIAN:
            growth = min(self._growth(name, positions) for name in self._tool.names)
            fastest = (self._linear,) * 3 + (self._angular,) * 3
            speeds_wanted = [
                _eased(most * deflection, v, growth)
                for most, deflection, (v, _) in zip(fastest, [*wanted, *_NOTHING], self._speeds, strict=False)
            ]
            states, speeds = self._tool.step(self._states, self._speeds, speeds_wanted, step)
            deflections = {}
        first = len(self.stick.axes) if self.kinematics is None else len(self.kinematics.ranges)
        for name in self.arm.names[first : first + 1]:
            pressed = self._closes * ((buttons >> self.stick.close & 1) - (buttons >> self.stick.open & 1))
            deflections[name] = max(-1.0, min(1.0, deflections.get(name, 0.0) + pressed))
        stopped = []
        for joint in self.arm.joints:
            name = joint.name
            if name in states:
                continue
            speed = deflections.get(name, 0.0) * self._share * joint.max_speed
            speed = _eased(speed, self._states[name][1], self._growth(name, positions))
            states[name], inside = self._ramped(joint, speed, step, ends.get(name))
            if not inside:
                stopped.append(name)
        if stopped:
            self._noted = f"{', '.join(stopped)} at the limit"
        return {name: states[name] for name in self.arm.names}, speeds

    def _ramped(self, joint: JointModel, speed: float, step: float, end: float | None) -> tuple[State, bool]:
        """A joint that comes towards a speed, and whether it can do so without regard to its range."""
        state, limits = self._states[joint.name], self._limits[joint.name]
        here = state[0]
        if not speed and not any(state[1:]):
            return state, True
        # A joint outside its limits may move back, but not further out.
        low, high = min(joint.minimum, here), max(joint.maximum, here)

        def after(share: float) -> State:
            way, v, a = change(state[1:], share * speed, limits, step)
            return here + way, v, a

        def fits(share: float) -> bool:
            least, most = rest_range(after(share), limits)
            return low <= least and most <= high

        inside, whole = fits(1.0), (low, high)
        if end is not None:
            low, high = (low, max(here, min(high, end))) if speed > 0.0 else (min(here, max(low, end)), high)
            if not fits(0.0):
                # It is too fast to rest there, since the end was changed: it goes past, and comes back.
                low, high = whole
        share = 1.0
        if not fits(share):
            # With none it brakes, as it was allowed to before.
            share, too_fast = 0.0, 1.0
            for _ in range(_HALVINGS):
                middle = 0.5 * (share + too_fast)
                share, too_fast = (middle, too_fast) if fits(middle) else (share, middle)
        place, v, a = after(share)
        return (max(low, min(high, place)), v, a), inside or not speed

    def _growth(self, name: str, positions: Mapping[str, float]) -> float:
        """The factor by which a joint may be faster without falling behind too far; below 1 it must be slower."""
        here, v, a = self._states[name]
        lead = math.copysign(1.0, v) * (here - positions[name])
        if not v or lead <= _NO_LEAD:
            return math.inf
        # A joint is behind by a time: the set-point was where it is when it had less speed, or more.
        late = 2.0 * lead / (abs(v) + math.sqrt(max(0.0, v * v - 2.0 * math.copysign(a, a * v) * lead)))
        # What is gained until the acceleration has ended comes to its speed.
        gained = max(0.0, math.copysign(0.5 * a * a / self._limits[name].jerk, a * v))
        return _GOOD_LEAD / (late * (abs(v) + 2.0 * gained))

    def _allowed_brake(self, states: Mapping[str, State]) -> Pieces | None:
        """How the joints come to rest from these states; None if they are at rest.

        Raises:
            LimitError: They must not go there, or where they would come to rest.
        """
        names = self.arm.names
        before, goal = self._goal, {name: state[0] for name, state in states.items()}
        if goal != before:
            self._check(before, within_limits(self.arm, goal))
        if not any(v or a for _, v, a in states.values()):
            return None
        begin = Sample(*zip(*(states[name] for name in names), strict=True))
        together = self.mode is JogMode.CARTESIAN
        path = brake(names, begin, list(self._limits.values()), together=together)
        for joint, (low, high) in zip(self.arm.joints, path.ranges() if together else (), strict=False):
            at = goal[joint.name]
            if low < min(joint.minimum, at) or high > max(joint.maximum, at):
                raise LimitError(f"{joint.name} at the limit")
        for _, sample in path.samples(_LOOK):
            before, goal = goal, dict(zip(names, sample.position, strict=True))
            if goal != before:
                self._check(before, within_limits(self.arm, goal))
        return path

    def _go_on_braking(self, step: float) -> None:
        if (path := self._brake) is None:
            return
        self._braked += step
        states = zip(*path.sample(self._braked), strict=True)
        self._states = dict(zip(path.names, states, strict=True))
        if self._braked >= path.duration:
            self._rest()

    def _keep_near(self, before: Mapping[str, State], positions: Mapping[str, float]) -> bool:
        """Undo a step that runs too far ahead of the joints; return whether there was none."""
        ahead = [
            name
            for name, goal in self._goal.items()
            if not abs(goal - positions[name]) <= max(_MOST_LEAD, abs(before[name][0] - positions[name]))
        ]
        if not ahead:
            return True
        if self.mode is JogMode.CARTESIAN:
            # The whole step: the tool must not leave its line because one joint lags.
            self._states = dict(before)
            self._rest()
            return False
        for name in ahead:
            self._states[name] = (before[name][0], 0.0, 0.0)
        try:
            self._brake, self._braked = self._allowed_brake(self._states), 0.0
        except LimitError:
            self._rest()
        return False


def _eased(wanted: float, present: float, growth: float) -> float:
    """A speed with which a set-point does not run away from a joint that lags."""
    most = max(abs(present), _CREEP * abs(wanted)) * growth
    return max(-most, min(most, wanted)) if wanted else 0.0


def within_limits(arm: ArmModel, positions: Mapping[str, float]) -> dict[str, float]:
    """Those of these positions that are within their joint's limits, radians by name."""
    joints = {name: arm.joint(name) for name in positions}
    return {
        name: angle for name, angle in positions.items() if joints[name].minimum <= angle <= joints[name].maximum
    }
