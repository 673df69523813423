"""Jog while somebody holds a button or drags a slider: one target per cycle, at a limited speed.

Owns the controller, and that its joints hold when the hold ends, for whatever reason. The rules of a step (limits,
coupling limits, table, singular poses, a blocked joint) are those of teleoperation. Must not know pages, sockets or
threads; the age of the hold comes in by a call.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.inputs import Item
from hexwire.model.state import JointTarget
from hexwire.motion.safety import StopReason
from hexwire.motion.teleop import Action, JogMode, StickMap, Teleop, within_limits

from ..loop.group import Goalless
from ..loop.target import holding
from .hold_to_run import SILENCE

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.state import JointState

    from .path_check import PathCheck

__all__ = ["JogController", "JogRequest", "read_request"]

_MAX_AGE = 1.0
"""Seconds of silence of a servo after which its joint does not begin to move."""
_HELD, _NOT_HELD = 1, 0
_SLOWEST, _FASTEST = 0.01, 1.0
_THERE = 1e-6
"""Radians from the goal of a drag that count as none."""


@dataclass(frozen=True, slots=True)
class JogRequest:
    """What is held.

    Attributes:
        directions: Joint jog: deflection -1..1 by joint.
        tool: Jog in space: deflections -1..1 along x, y, z and about them, in the frame of the arm's base.
        goals: Drag: radians by joint.
        speed: Share of the speed limits of the joints, or of the jog speeds in space.
    """

    directions: Mapping[str, float] = field(default_factory=dict)
    tool: tuple[float, ...] = ()
    goals: Mapping[str, float] = field(default_factory=dict)
    speed: float = 0.3


def read_request(kind: str, args: Mapping[str, object], arm: ArmModel) -> JogRequest:
    """Check a request from outside.

    Args:
        kind: ``joint``, ``space`` or ``drag``.
        args: Values by name: ``directions`` (joint), ``tool`` (space) or ``goals`` (drag), and ``speed``.
        arm: Its joints.

    Raises:
        UsageError: It is malformed.
        LimitError: A goal is outside the limits of its joint.
    """
    wanted = {"joint": "directions", "space": "tool", "drag": "goals"}.get(kind)
    if wanted is None:
        raise UsageError(f"there is no jog {kind!r}")
    row = Item(args).table((wanted,), ("speed",))
    speed = row["speed"].number(_SLOWEST, _FASTEST) if "speed" in row else 0.3
    if kind == "space":
        return JogRequest(tool=row[wanted].numbers(6, -1.0, 1.0), speed=speed)
    named = {arm.joint(name).name: each for name, each in row[wanted].table().items()}
    if not named:
        raise row[wanted].fault("must name at least one joint")
    if kind == "joint":
        return JogRequest(directions={name: each.number(-1.0, 1.0) for name, each in named.items()}, speed=speed)
    goals = {name: each.number() for name, each in named.items()}
    for name, goal in goals.items():
        arm.joint(name).check(goal)
    return JogRequest(goals=goals, speed=speed)


class JogController(Goalless):
    """Moves the joints of an arm while a hold lasts. The owner's lock guards it, as every controller.

    Args:
        arm: Joints and limits.
        kinematics: For jog in space; None if unknown.
        check: The checks of the arm.
        silence: Seconds without a sign of life after which the joints hold.

    Attributes:
        joints: Names of all joints of the arm.
        silence: Seconds without a sign of life after which the joints hold; may be changed.
        note: Message for the operator, such as a joint that is at its limit; empty if there is none.
    """

    def __init__(
        self, arm: ArmModel, kinematics: KinematicModel | None, check: PathCheck, *, silence: float = SILENCE
    ) -> None:
        self.joints = arm.names
        self.note = ""
        self._arm, self._kinematics, self._check, self.silence = arm, kinematics, check, silence
        self._rules: Teleop | None = None
        self._request = JogRequest()
        self._age: Callable[[], float] = lambda: math.inf
        self._aim: dict[str, float] = {}
        self._moved: set[str] = set()
        self._last, self._ends = math.nan, False

    @property
    def busy(self) -> bool:
        """A hold lasts."""
        return self._rules is not None

    @property
    def moving(self) -> bool:
        """A hold lasts, and its end has not been asked for."""
        return self.busy and not self._ends

    def begin(self, request: JogRequest, age: Callable[[], float], state: JointState) -> None:
        """Begin a hold; the caller has checked that the arm is not stopped, and released other controllers.

        Args:
            request: What is held.
            age: Returns the seconds since the last sign of life; infinite when the hold has ended. Must not wait.
            state: The newest state.

        Raises:
            UsageError: There is no jog in space for this arm.
            GoalError: A joint has no torque, or does not answer.
        """
        self._check.ready(self._names(request), state, _MAX_AGE)
        mode = JogMode.CARTESIAN if request.tool else JogMode.JOINT
        axes = tuple(range(6 if request.tool else len(self.joints)))
        # Buttons: 0 is the hold, the others are never pressed.
        stick = StickMap(axes, dead_man=0, mode=1, close=2, open=3, dead_zone=0.0)
        speed = request.speed
        rules = Teleop(
            self._arm,
            self._kinematics,
            stick,
            mode=mode,
            share=speed,
            linear=0.15 * speed,
            angular=1.2 * speed,
            stale=self.silence,
            check=self._check.posture,
        )
        self._rules, self._request, self._age, self._ends = rules, request, age, False
        self._aim, self._moved, self._last, self.note = {}, set(self._names(request)), math.nan, ""

    def update(self, request: JogRequest) -> None:
        """Change what is held; without effect when the hold has ended.

        Raises:
            UsageError: The kind of hold would change.
        """
        if bool(request.tool) != bool(self._request.tool) or bool(request.goals) != bool(self._request.goals):
            raise UsageError("release first, to hold something else")
        if not set(self._names(request)) <= self._moved:
            raise UsageError("release first, to move other joints")
        self._request = request

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The target of this cycle; when the hold has ended, the joints brake."""
        rules = self._rules
        if rules is None:
            return None
        positions, age = state.positions, math.inf if self._ends else self._age()
        if math.isnan(self._last):
            # The rules want to see a released button, and an axis at rest, before either counts.
            rest = (0.0,) * max(6, len(self.joints))
            rules.update(rest, _NOT_HELD, 0.0, positions, now)
            rules.update(rest, _HELD, 0.0, positions, now)
            self._aim, self._last = dict(positions), now
        if age >= self.silence and now - self._last > lead:
            # After a stall the joints rest where the last target has led.
            self._rules = None
            return None
        self._last = now
        buttons = _HELD if age < self.silence else _NOT_HELD
        jog = rules.update(self._axes(), buttons, age, positions, now, lead=lead, ends=self._request.goals)
        self.note = jog.note
        if jog.action is not Action.MOVE or state.stopped:
            self._rules = None
            return (
                holding(self._arm, state, self._moved) if jog.action is Action.HOLD and not state.stopped else None
            )
        self._aim = dict(jog.positions)
        aim = {name: angle for name, angle in jog.positions.items() if name in self._moved}
        # A joint outside its limits stays where it is.
        inside = within_limits(self._arm, aim)
        return JointTarget.of(inside, lead) if inside else None

    def stop(self, reason: StopReason) -> None:
        """End the hold; it does not continue after a reset."""
        self._rules = None

    def brake(self, why: str) -> bool:
        """End the hold as if the button were released; whether there is one."""
        self._ends = True
        return self.busy

    def release(self, why: str) -> None:
        """End the hold, without a target."""
        self._rules = None

    def _axes(self) -> tuple[float, ...]:
        request = self._request
        if request.tool:
            return request.tool
        if not request.goals:
            return tuple(request.directions.get(name, 0.0) for name in self.joints)
        # Towards the goal, where the rules let a joint come to rest.
        ways = (request.goals.get(name, here) - here for name, here in self._aim.items())
        return tuple(0.0 if abs(way) < _THERE else math.copysign(1.0, way) for way in ways)

    def _names(self, request: JogRequest) -> tuple[str, ...]:
        if not request.tool:
            return tuple(request.goals or request.directions)
        if self._kinematics is None:
            raise UsageError(f"no jog in space for {self._arm.name}: its kinematics are unknown")
        return tuple(self._kinematics.joint_names)
