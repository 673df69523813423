"""What a motion would do, found out before it begins: joint angles, path, duration, and why it would be refused.

Owns the plans of motions that a person asks for: to joint angles, to a place of the tip, along a taught motion. A
motion is planned again by the same rules when it begins. Nothing moves here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.errors import GoalError, HexwireError, LimitError, UsageError
from hexwire.model.aim import Aim, Tip, aimed_pose, rpy_of
from hexwire.model.pose import multiply, rotation_about
from hexwire.model.state import finite
from hexwire.motion.checks import SLOWEST, speed_that_fits
from hexwire.motion.joined import WithResting, sampled
from hexwire.motion.teach import Edits, approach
from hexwire.motion.trajectory import Spline, Waypoint

from ..loop.outcomes import Reason
from ..loop.reader import position_unknown
from ..motion.goals import MAX_POINTS, Point, TrajectoryGoal
from ..motion.path_check import PathCheck
from ..motion.played import fits_words
from ..motion.via import Place, approached, chosen_solution, straight

if TYPE_CHECKING:
    from hexwire.model.kinematics import KinematicModel
    from hexwire.model.pose import Vector
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught
    from hexwire.motion.trajectory import Trajectory

    from ..loop.controller import TrajectoryController
    from ..loop.owner import RobotOwner
    from .settings import Settings

__all__ = ["TIP_SPEED", "Branch", "Planner", "Preview", "check_factor", "goal_of"]

_MARGIN = 0.98
"""Share of the wanted speed that is planned: between the points that are sent, a joint may be slightly faster."""
TIP_SPEED = 0.2
"""Metres per second of the tip on a straight line at full speed."""
_STEP = 0.02
"""Least seconds between two points that are sent."""
_MOST_POINTS = MAX_POINTS - 1
_SLOWEST = 0.01
_ALL_DIRECTIONS = 6
"""Joints with which a tool can be turned in every direction."""
_SLOWED, _FASTEST = SLOWEST, 4.0
"""Slowest and fastest factor at which a taught motion is played."""


@dataclass(frozen=True, slots=True)
class Branch:
    """One solution of the inverse kinematics.

    Attributes:
        name: For example ``front, elbow up, wrist 1``.
        turn: Largest turn of a joint to get there, radians.
        why: Limits that it violates, in words; empty if it is allowed.
    """

    name: str
    turn: float
    why: str


@dataclass(frozen=True, slots=True)
class Preview:
    """The plan of a motion, and whether it may begin.

    Attributes:
        goal: Angles at its end, radians by joint; of a refused one as near as is known, empty if nothing is.
        path: Of all joints of all controllers; None if there is none.
        lead_in: Seconds at its start in which the arm moves to where a taught motion begins.
        fits: Of a taught motion that is refused for its speed, the largest factor that keeps the limits; None if
            another limit is in the way, too.
        tip: Pose of the tip at the end; None for an arm without kinematics.
        branch: The solution that was chosen; empty if there was no choice.
        branches: All solutions, the allowed ones first.
        refusal: Why the path is not allowed; empty if it is.
        unready: Why no motion can begin now: torque, a stop, teach mode; empty if one can.
    """

    goal: Mapping[str, float]
    path: Trajectory | None = None
    lead_in: float = 0.0
    fits: float | None = None
    tip: Tip | None = None
    branch: str = ""
    branches: tuple[Branch, ...] = ()
    refusal: str = ""
    unready: str = ""

    @property
    def duration(self) -> float:
        """Seconds; 0 without a path."""
        return 0.0 if self.path is None else self.path.duration

    def rows(self, most: int) -> list[tuple[float, ...]]:
        """Positions along the path, evenly spaced in time, both ends among them; radians, in the path's order."""
        path = self.path
        if path is None:
            return []
        return [
            path.start,
            *(sample.position for _, sample in sampled(path, path.duration / most or 1.0, most - 1)),
        ]

    def require(self) -> Trajectory:
        """The path of a motion that may begin.

        Raises:
            GoalError: It may not; the text says why.
        """
        if self.refusal or self.path is None:
            raise GoalError(self.refusal or "there is no path", reason=Reason.PATH_NOT_ALLOWED)
        if self.unready:
            raise GoalError(self.unready, reason=Reason.NOT_READY)
        return self.path

    def goals(self, controllers: Mapping[str, TrajectoryController]) -> dict[str, TrajectoryGoal]:
        """The goals with which controllers follow the path, for those that it moves; raises as `require`."""
        path = self.require()
        goals = {name: goal_of(path, controller.joints) for name, controller in controllers.items()}
        return {name: goal for name, goal in goals.items() if _moves(goal, path)}


class Planner:
    """Plans motions of one arm. Any thread may call its methods; a long path takes long.

    Args:
        owner: Of the arm; connected.
        settings: Of the arm.
        controllers: Of the arm.
        refuse: Raises the reason why no motion may begin, such as teach mode.
    """

    def __init__(
        self,
        owner: RobotOwner,
        settings: Settings,
        controllers: Mapping[str, TrajectoryController],
        refuse: Callable[[], object],
    ) -> None:
        self._owner, self._settings, self._controllers, self._refuse = owner, settings, controllers, refuse
        self._model = settings.model
        self._kinematics: KinematicModel | None = settings.kinematics
        # Not that of the arm's controllers, which keeps what it has seen of the running motion.
        self._check = PathCheck(settings.model, settings.kinematics, settings.table)

    def to_joints(
        self, goals: Mapping[str, float], *, speed: float = 0.3, start: Mapping[str, float] | None = None
    ) -> Preview:
        """Plan a motion to joint angles; joints that are not named stay.

        Args:
            goals: Radians by joint.
            speed: Share of the joints' speed limits.
            start: Where all joints will be then, radians; where they are now, or were last sent, if None.

        Raises:
            UsageError: No joint is named, one is unknown, or a number is out of range.
            HexwireError: The arm cannot be reached.
        """
        if not goals:
            raise UsageError("name at least one joint")
        wanted = {
            self._model.joint(name).name: finite(angle, f"the goal of {name}") for name, angle in goals.items()
        }
        state, here = self._here(start)
        return self._to(wanted, here, state, _share(speed))

    def to_place(self, place: Place, *, speed: float = 0.3, start: Mapping[str, float] | None = None) -> Preview:
        """Plan a motion of the tip to a place.

        Args:
            place: Where.
            speed: Share of the joints' speed limits, and of 0.2 m/s on a straight line.
            start: As for `to_joints`.

        Raises:
            UsageError: The arm's geometry is unknown, its tool cannot be aimed so, or a number is out of range.
            HexwireError: The arm cannot be reached.
        """
        model, speed = self._kinematics, _share(speed)
        if model is None:
            raise UsageError(f"no geometry is known for {self._model.name}, so its tip cannot be sent to a place")
        x, y, z = (finite(value, name) for value, name in zip(place.position, "xyz", strict=True))
        state, here = self._here(start)
        if unknown := [name for name in model.joint_names if not math.isfinite(here[name])]:
            return Preview({}, refusal=position_unknown(unknown), unready=self._unready(state))
        angles = model.from_joints(here)
        pose = aimed_pose(model, angles, (x, y, z), place.aim, relative=place.relative)
        solutions = sorted(model.inverse(pose), key=lambda s: (not s.allowed, s.distance(angles)))
        branches = tuple(Branch(s.branch, s.distance(angles), "; ".join(s.violations)) for s in solutions)
        try:
            if place.straight:
                along = straight(self._model, model, here, [place], speed=TIP_SPEED * speed, rounding=0.0)
                return self._checked(along, here, state)
            chosen = chosen_solution(model, pose, place.branch, angles, solutions)
        except LimitError as error:
            # Of a line, the end may be allowed.
            near = model.to_joints(solutions[0].angles) if solutions else {}
            tip = Tip.of(model, solutions[0].angles) if solutions else None
            found = Preview(near, tip=tip, refusal=_plain(error), unready=self._unready(state))
        else:
            found = self._to(model.to_joints(chosen.angles), here, state, speed)
            found = replace(found, branch=chosen.branch)
        return found if place.straight else replace(found, branches=branches)

    def by_joint(self, name: str, by: float, *, speed: float = 0.3) -> Preview:
        """Plan a step of one joint, from where it was last sent, so that many steps add up exactly.

        Args:
            name: The joint.
            by: How far, radians.
            speed: Share of the joints' speed limits.

        Raises:
            UsageError: There is no such joint, or a number is out of range.
            HexwireError: The arm cannot be reached.
        """
        joint, by = self._model.joint(name).name, finite(by, f"the step of {name}")
        state, here = self._here()
        return self._to({joint: here[joint] + by}, here, state, _share(speed))

    def by_move(self, by: Vector, *, speed: float = 0.3) -> Preview:
        """Plan a step of the tip on a straight line; the tool keeps its direction as far as the arm can.

        Args:
            by: How far along the axes of the base, metres.
            speed: As for `to_place`.

        Raises:
            HexwireError: As `to_place`.
        """
        whole = self._kinematics is not None and len(self._kinematics.ranges) >= _ALL_DIRECTIONS
        return self.to_place(Place(by, Aim(fixed=whole), relative=True, straight=True), speed=speed)

    def by_turn(self, by: Vector, *, speed: float = 0.3) -> Preview:
        """Plan a turn of the tool about the tip.

        Args:
            by: The axis of the base about which it turns, as long as the angle in radians.
            speed: As for `to_place`.

        Raises:
            UsageError: An arm of five joints cannot turn its tool about any axis; else as `to_place`.
            HexwireError: The arm cannot be reached.
        """
        model = self._kinematics
        if model is None or len(model.ranges) < _ALL_DIRECTIONS:
            raise UsageError(f"the tool of {self._model.name} turns by its joints only")
        here = model.from_joints(self._here()[1])
        angle = math.hypot(*by)
        rotation = model.forward(here).rotation
        if angle > 0.0:
            x, y, z = (part / angle for part in by)
            rotation = multiply(rotation_about((x, y, z), angle), rotation)
        return self.to_place(Place((0.0, 0.0, 0.0), Aim(rpy=rpy_of(rotation)), relative=True), speed=speed)

    def along(
        self,
        taught: Taught,
        edits: Edits | None = None,
        *,
        factor: float = 1.0,
        fit: bool = False,
        speed: float = 0.3,
        start: Mapping[str, float] | None = None,
    ) -> Preview:
        """Plan to move to where a taught motion, or a part of it, begins, and then along it.

        Args:
            taught: The motion.
            edits: Which part of it, and how smooth; all of it as it is if None.
            factor: 2 plays it twice as fast.
            fit: Plan it at the largest factor up to this that keeps the limits.
            speed: Share of the joints' speed limits on the way to its start.
            start: As for `to_joints`.

        Raises:
            UsageError: The arm lacks one of its joints, nothing is left of it, or a number is out of range.
            HexwireError: The arm cannot be reached.
        """
        check_factor(factor)
        for name in taught.names:
            self._model.joint(name)
        make = taught.played(self._model, edits or Edits())
        state, here = self._here(start)
        if unknown := [name for name in taught.names if not math.isfinite(here[name])]:
            return Preview({}, refusal=position_unknown(unknown), unready=self._unready(state))
        share = _MARGIN * _share(speed)

        def legs(factor: float) -> list[Trajectory]:
            return approached(self._model, make(factor), here, speed=share)

        def planned(factor: float) -> Preview:
            parts = legs(factor)
            found = self._checked(_as_sent(parts), here, state)
            return replace(found, lead_in=sum(part.duration for part in parts[:-1]))

        found = planned(factor)
        if not found.refusal:
            return found
        fits = speed_that_fits(lambda factor: _as_sent(legs(factor)), self._model, factor)
        if fits is None or (slower := planned(fits)).refusal:
            return found
        return slower if fit else replace(found, refusal=f"{found.refusal}; {fits_words(fits)}", fits=fits)

    # -- helpers --------------------------------------------------------------------------------------

    def _to(
        self, goals: Mapping[str, float], here: Mapping[str, float], state: JointState, speed: float
    ) -> Preview:
        names = tuple(goals)
        if unknown := [name for name in names if not math.isfinite(here[name])]:
            return Preview(goals, refusal=position_unknown(unknown), unready=self._unready(state))
        start = [here[name] for name in names]
        path = approach(self._model, names, start, [goals[name] for name in names], speed=_MARGIN * speed)
        return self._checked(path, here, state)

    def _checked(self, path: Trajectory, here: Mapping[str, float], state: JointState) -> Preview:
        """The preview of a path of some joints, after the checks that it will meet."""
        goal = dict(zip(path.names, path.goal, strict=True))
        names = [name for controller in self._controllers.values() for name in controller.joints]
        refusal = ""
        try:
            whole: Trajectory = WithResting(path, names, here)
            if isinstance(path, Spline):
                # It keeps its points, which are sent.
                rows = [(point.time, whole.at(point.time)) for point in path.waypoints]
                whole = Spline(names, [Waypoint(t, row.position, row.velocity) for t, row in rows])
            self._check.trajectory(path, here)
        except HexwireError as error:
            refusal, whole = _plain(error), path
        return Preview(
            goal, path=whole, tip=self._tip({**here, **goal}), refusal=refusal, unready=self._unready(state)
        )

    def _tip(self, positions: Mapping[str, float]) -> Tip | None:
        model = self._kinematics
        if model is None or not all(math.isfinite(positions[name]) for name in model.joint_names):
            return None
        return Tip.of(model, model.from_joints(positions))

    def _here(self, start: Mapping[str, float] | None = None) -> tuple[JointState, dict[str, float]]:
        """The newest state, and where each joint comes to rest, or is or was last sent; NaN if unknown."""
        owner = self._owner
        state = owner.newest()
        if start is not None:
            return state, {**state.positions, **start}
        here = state.positions
        with owner.locked():
            now = owner.now()
            for controller in self._controllers.values():
                try:
                    begin = controller.rest(state, now)
                except GoalError:
                    # Stopped, or a position is unknown: then the motion begins where the joints are.
                    continue
                here.update(zip(controller.joints, begin.position, strict=True))
        return state, here

    def _unready(self, state: JointState) -> str:
        owner, check = self._owner, self._check
        names = [name for controller in self._controllers.values() for name in controller.joints]
        try:
            self._refuse()
            check.stop_latch(owner.group.reason)
            check.ready(names, state, self._settings.safety_at(1.0 / owner.command_period).max_age)
        except HexwireError as error:
            return _plain(error)
        return "the arm is stopped; reset first" if state.stopped else ""


def _as_sent(legs: Sequence[Trajectory]) -> Spline:
    """A motion through the points that are sent of it: those of a recording, unless they are too many."""
    names, rest = legs[0].names, (0.0,) * len(legs[0].names)
    points = [Waypoint(0.0, legs[0].start, rest)]
    for leg in legs:
        begin, left = points[-1].time, MAX_POINTS - len(points)
        if isinstance(leg, Spline) and len(leg.waypoints) <= left:
            points += [replace(point, time=begin + point.time) for point in leg.waypoints[1:]]
        elif leg.duration:
            points += [Waypoint(begin + t, s.position, s.velocity) for t, s in sampled(leg, _STEP, left)]
    return Spline(names, points)


def check_factor(factor: float) -> float:
    """The factor of the speed of a taught motion, if it may be played so.

    Raises:
        UsageError: It may not.
    """
    if not _SLOWED <= finite(factor, "the factor of the speed") <= _FASTEST:
        text = f"a taught motion is played at {_SLOWED:g} to {_FASTEST:g} times its speed, not {factor:g}"
        raise UsageError(text)
    return factor


def goal_of(path: Trajectory, joints: Sequence[str]) -> TrajectoryGoal:
    """The goal that lets a controller follow a path.

    Args:
        path: Of all its joints and maybe others; it begins where they are.
        joints: The controller's.

    Returns:
        The goal; without points if the path has no duration.
    """
    places = [path.names.index(name) for name in joints]
    if path.duration <= 0.0:
        return TrajectoryGoal(tuple(joints), ())
    if isinstance(path, Spline):
        rows = iter([(point.time, path.at(point.time)) for point in path.waypoints[1:]])
    else:
        rows = sampled(path, _STEP, _MOST_POINTS)
    points = [Point(t, tuple(s.position[i] for i in places), tuple(s.velocity[i] for i in places)) for t, s in rows]
    # A single point is reached from anywhere; the first of many may be too near for that.
    start = tuple([path.start[i] for i in places]) if len(points) > 1 else ()
    return TrajectoryGoal(tuple(joints), tuple(points), start=start)


def _share(speed: float) -> float:
    if not _SLOWEST <= finite(speed, "the speed") <= 1.0:
        raise UsageError(f"a speed is {_SLOWEST:g} to 1 of the joints' limits, not {speed:g}")
    return speed


def _plain(error: HexwireError) -> str:
    return str(error).removesuffix("; nothing was sent")


def _moves(goal: TrajectoryGoal, path: Trajectory) -> bool:
    """Whether a goal leads anywhere but to where its joints are at the start of the path."""
    start = dict(zip(path.names, path.start, strict=True))
    return any(
        value != start[name]
        for point in goal.points
        for name, value in zip(goal.names, point.positions, strict=True)
    )
