"""Motions that people ask for: read, previewed, begun, and watched; poses by name; a taught motion.

Owns what may be asked for, the check of every value, what each request means for this arm, and which of its motions
was begun last. Must not know pages.

A request is a table with the key ``what``:

- ``joints``: ``goals``, radians by joint.
- ``place``: ``position``, three numbers in metres; ``relative``, ``straight``; ``branch``; ``aim``, one of ``arm``
  (the tool keeps its direction relative to the arm), ``space``, ``down``, ``rpy`` and ``pitch``; with ``rpy`` three
  angles, with ``pitch`` a pitch and maybe a ``roll``, in radians.
- ``pose``: ``name``.
- ``step``: ``joint`` and ``by``, radians; or ``move``, three numbers in metres along the axes of the base; or
  ``turn``, three angles in radians about them, with the tip in its place. It begins where the arm was last sent, so
  that steps add up exactly.
- ``grip``: ``share``, 0 is closed, 1 fully open.
- ``play``: ``begin``, ``end`` and ``smooth`` in seconds of the taught motion, ``factor`` of its speed; with
  ``fit``, one that is too fast is played at the largest factor that keeps the limits.

All have ``speed``, a share of the joints' speed limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from hexwire.drivers.tools import Gripper
from hexwire.errors import GoalError, UsageError
from hexwire.inputs import Item
from hexwire.model.aim import Aim
from hexwire.model.gripper import Jaws, jaws_of
from hexwire.motion.teach import Edits
from hexwire.units import decimal

from ..loop.outcomes import Reason
from ..motion.hold_to_run import SILENCE
from ..motion.jaws import Closing, relieved
from ..motion.motion_run import MotionRun, RunProgress
from ..motion.via import Place
from .pose_file import HOME, PoseFile, find_pose, home_pose, without_gripper

if TYPE_CHECKING:
    from hexwire.model.pose import Vector
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught

    from ..sharing.shared import Order, SharedArm
    from .preview import Preview

__all__ = [
    "NOTHING_TAUGHT",
    "SMOOTHEST",
    "MotionRequest",
    "MotionService",
    "PoseRow",
    "read_goals",
    "read_motion",
    "read_vector",
]

NOTHING_TAUGHT = "nothing was taught since this arm was opened"

_SPEED = 0.3
_MOST = 1000.0
"""Greatest length in metres and angle in radians; a greater one is in a wrong unit."""
_MOST_JOINTS = 253
_LONGEST_TEXT = 100
SMOOTHEST = 2.0
"""Seconds: what is longer is no tremor."""
_KEYS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "joints": (("goals",), ()),
    "place": (("position",), ("relative", "straight", "aim", "rpy", "pitch", "roll", "branch")),
    "pose": (("name",), ()),
    "step": ((), ("joint", "by", "move", "turn")),
    "grip": (("share",), ()),
    "play": ((), ("begin", "end", "smooth", "factor", "fit")),
}
"""What each kind must have, and what it may have."""
_NUMBERS = ("speed", "share", "begin", "end", "factor")
_AIMS = ("arm", "space", "down", "rpy", "pitch")


@dataclass(frozen=True, slots=True)
class MotionRequest:
    """What is asked for; only what belongs to `what` has a meaning.

    Attributes:
        what: ``joints``, ``place``, ``pose``, ``step``, ``grip`` or ``play``.
        speed: Share of the joints' speed limits.
        goals: Radians by joint.
        place: Where the tip is to go.
        name: Name of a pose, or of the joint that makes a step.
        by: How far that joint turns, radians.
        move: How far the tip moves along the axes of the base, metres; None for no such step.
        turn: How far the tool turns about them, radians; None for no such step.
        share: Opening of the gripper: 0 is closed, 1 fully open.
        begin: First second of the taught motion to play.
        end: Last second of it to play.
        smooth: Take away its tremor that is shorter than this, seconds.
        factor: 2 plays it twice as fast.
        fit: Play it more slowly if it is too fast, at the largest factor that keeps the limits.
    """

    what: str
    speed: float = _SPEED
    goals: Mapping[str, float] = field(default_factory=dict)
    place: Place = field(default_factory=lambda: Place((0.0, 0.0, 0.0)))
    name: str = ""
    by: float = 0.0
    move: Vector | None = None
    turn: Vector | None = None
    share: float = 0.0
    begin: float = 0.0
    end: float = math.inf
    smooth: float = 0.0
    factor: float = 1.0
    fit: bool = False


def read_motion(args: Mapping[str, object]) -> MotionRequest:
    """Check a request from outside; that joints and poses exist is checked when it is planned.

    Raises:
        UsageError: It is malformed; the text names the value.
    """
    item = Item(args)
    what = item.table(("what",))["what"].choice(_KEYS)
    needed, optional = _KEYS[what]
    row = item.table(("what", *needed), ("speed", *optional))
    if "end" in row and row["end"].value is None:
        del row["end"]
    values: dict[str, Any] = {key: row[key].number() for key in _NUMBERS if key in row}
    if what == "joints":
        values["goals"] = read_goals(row["goals"], _MOST, "rad")
    if what == "place":
        values["place"] = _place(item)
    if what == "step":
        values |= _step(item, row)
    if what == "pose":
        values["name"] = row["name"].text(_LONGEST_TEXT)
    if "smooth" in row:
        values["smooth"] = row["smooth"].number(0.0, SMOOTHEST, "s")
    if "fit" in row:
        values["fit"] = row["fit"].flag()
    return MotionRequest(what, **values)


def _step(item: Item, row: Mapping[str, Item]) -> dict[str, Any]:
    kinds = [key for key in ("joint", "move", "turn") if key in row]
    if len(kinds) != 1 or ("by" in row) != (kinds == ["joint"]):
        raise item.fault("a step has a joint and by how far, or a move, or a turn")
    if kinds == ["joint"]:
        return {"name": row["joint"].text(_LONGEST_TEXT), "by": row["by"].number(-_MOST, _MOST, "rad")}
    return {kinds[0]: read_vector(row[kinds[0]], _MOST, "m" if kinds == ["move"] else "rad")}


def _place(item: Item) -> Place:
    row = item.table()
    aim = row["aim"].choice(_AIMS) if "aim" in row else "arm"
    row = item.table((aim,) if aim in ("rpy", "pitch") else ())
    rolled = aim == "pitch" and "roll" in row and row["roll"].value is not None
    return Place(
        read_vector(row["position"], _MOST, "m"),
        Aim(
            down=aim == "down",
            rpy=read_vector(row["rpy"], _MOST, "rad") if aim == "rpy" else None,
            pitch=row["pitch"].number(-_MOST, _MOST, "rad") if aim == "pitch" else None,
            roll=row["roll"].number(-_MOST, _MOST, "rad") if rolled else None,
            fixed=aim == "space",
        ),
        relative="relative" in row and row["relative"].flag(),
        straight="straight" in row and row["straight"].flag(),
        branch=row["branch"].text(_LONGEST_TEXT) if "branch" in row else "",
    )


def read_goals(item: Item, most: float, unit: str) -> dict[str, float]:
    """Angles by joint, of up to `most` in either direction; raises `ConfigError`."""
    goals = {name: each.number(-most, most, unit) for name, each in item.table().items()}
    if not 0 < len(goals) <= _MOST_JOINTS:
        raise item.fault(f"must name 1 to {_MOST_JOINTS} joints")
    return goals


def read_vector(item: Item, most: float, unit: str) -> Vector:
    """Three numbers of up to `most` in either direction; raises `ConfigError`."""
    x, y, z = item.numbers(3, -most, most, unit)
    return x, y, z


def _step_words(request: MotionRequest) -> str:
    if request.move is not None:
        return f"of the tip by {' '.join(decimal(1e3 * part) for part in request.move)} mm"
    if request.turn is not None:
        return f"of the tool by {' '.join(decimal(math.degrees(part)) for part in request.turn)} deg"
    return f"of {request.name} by {decimal(math.degrees(request.by))} deg"


_NAMED = 2
"""Most joints that the title of a motion names."""


@dataclass(frozen=True, slots=True)
class PoseRow:
    """A pose.

    Attributes:
        name: Its name.
        angles: Radians by joint.
        saved: It is in the user's file, so that it can be replaced, renamed and removed; others are settings.
    """

    name: str
    angles: Mapping[str, float]
    saved: bool


class MotionService:
    """Plans and begins motions of one arm. Any thread may call its methods; planning may take long.

    Args:
        shared: The arm; connected.
        poses: The user's poses.

    Attributes:
        poses: The user's poses.
        jaws: The gripper; None if the arm has none that is known.
    """

    def __init__(self, shared: SharedArm, poses: PoseFile) -> None:
        self.poses = poses
        self._shared, self._arm = shared, shared.arm
        self.jaws: Jaws | None = jaws_of(shared.arm.settings.model)
        self._run: MotionRun | None = None

    @property
    def taught(self) -> Taught | None:
        """The last taught motion."""
        return self._arm.teach_mode.taught

    @property
    def teaching(self) -> bool:
        """Whether the arm is in teach mode."""
        return self._arm.teach_mode.hand.active

    @property
    def progress(self) -> RunProgress | None:
        """Of the motion that was begun last; None before the first."""
        run = self._run
        return None if run is None else run.progress()

    def preview(self, args: Mapping[str, object], *, taught: Taught | None = None) -> Preview:
        """Plan a motion without moving.

        Args:
            args: As in `hexwire.control.requests.motion_service`.
            taught: What is played; the last taught motion if None.

        Raises:
            UsageError: The request is malformed, or there is no such joint, pose or taught motion.
            HexwireError: The arm cannot be reached.
        """
        return self.plan(read_motion(args), taught)

    def begin(
        self,
        orders: Callable[[], Order],
        args: Mapping[str, object],
        *,
        wanted: Callable[[], bool] = lambda: True,
        age: Callable[[], float] = lambda: 0.0,
        silence: float = SILENCE,
        on_end: Callable[[MotionRun], object] = lambda run: None,
        taught: Taught | None = None,
    ) -> MotionRun:
        """Plan a motion from where the arm is now, and begin it; a running one is replaced.

        Args:
            orders: Makes an order of whoever begins it; called for the beginning itself, and for each controller.
            args: As for `preview`.
            wanted: Asked right before it begins, since planning takes time.
            age: As for `MotionRun`.
            silence: As for `MotionRun`.
            on_end: As for `MotionRun`.
            taught: As for `preview`.

        Raises:
            LeaseError: Whoever asks does not hold the lease.
            GoalError: The motion may not begin; the text says why.
            HexwireError: As `preview`.
        """
        request = read_motion(args)
        title = self._title(request) if taught is None else "a recording"
        arm, owner = self._arm, self._arm.owner
        self._shared.admit(orders())
        for name in arm.controllers:
            arm.hold(name, f"replaced by {title}")
        plan = self.plan(request, taught)
        moving = plan.goals(arm.controllers)
        if not wanted():
            raise GoalError("released before it began", reason=Reason.CANCELLED)
        grips = moving and request.what == "grip"

        def begin() -> None:
            for name, goal in moving.items():
                self._shared.follow(orders(), name, goal, run)

        run = MotionRun(
            owner,
            arm.controllers.values(),
            RunProgress(title, duration=plan.duration, lead_in=plan.lead_in),
            closing=Closing(Gripper(owner.robot), request.share, owner.newest()) if grips else None,
            relieve=partial(self._relieve, orders),
            age=age,
            silence=silence,
            on_end=on_end,
        )
        run.begin(len(moving), begin)
        self._run = run
        return run

    def _relieve(self, orders: Callable[[], Order], gripper: Gripper, state: JointState) -> None:
        owner = self._arm.owner
        for name, controller in self._arm.controllers.items():
            if gripper.joint.name in controller.joints:
                with owner.locked():
                    relief = relieved(gripper, controller, state, owner.now())
                self._shared.follow(orders(), name, relief, None)

    # -- poses and teaching -----------------------------------------------------------------------------

    def pose_rows(self) -> list[PoseRow]:
        """All poses: home, those of the settings, then those of the user's file; a later one wins over its name.

        Raises:
            ConfigError: The file is damaged.
        """
        saved = self.poses.load()
        given = {HOME: home_pose(self._arm.settings.model)} | dict(self._arm.settings.poses)
        rows = [PoseRow(name, angles, False) for name, angles in given.items() if name not in saved]
        return rows + [PoseRow(name, angles, True) for name, angles in saved.items()]

    def save_pose(self, name: str, *, gripper: bool = True, force: bool = False) -> str:
        """Save where the joints are as a pose.

        Args:
            name: Its name.
            gripper: The gripper belongs to the pose.
            force: Replace a pose of that name.

        Returns:
            The name as it was saved.

        Raises:
            HexwireError: As `PoseFile.save`, or the arm cannot be reached.
        """
        here = self._arm.owner.newest().positions
        kept = here if gripper else without_gripper(self._arm.settings.model, here)
        return self.poses.save(name, kept, force=force)

    def teach(self, order: Order, on: bool) -> str:
        """Start or end teach mode; see `ControlledArm.teach_start` and `ControlledArm.teach_stop`.

        Returns:
            What came of it, for people.

        Raises:
            LeaseError: Whoever asks does not hold the lease.
            HexwireError: As those.
        """
        self._shared.admit(order)
        return self._arm.teach_start() if on else self._arm.teach_stop()

    # -- helpers ----------------------------------------------------------------------------------------

    def plan(
        self, request: MotionRequest, taught: Taught | None = None, start: Mapping[str, float] | None = None
    ) -> Preview:
        """Plan a motion without moving.

        Args:
            request: What is asked for; no step of a jog if `start` is given.
            taught: As for `preview`.
            start: As for `Planner.to_joints`.

        Raises:
            HexwireError: As `preview`.
        """
        planner, speed = self._arm.planner, request.speed
        if request.what == "joints":
            return planner.to_joints(request.goals, speed=speed, start=start)
        if request.what == "place":
            return planner.to_place(request.place, speed=speed, start=start)
        if request.what == "pose":
            return planner.to_joints(self._pose(request.name), speed=speed, start=start)
        if request.what == "step":
            if request.move is not None:
                return planner.by_move(request.move, speed=speed)
            if request.turn is not None:
                return planner.by_turn(request.turn, speed=speed)
            return planner.by_joint(request.name, request.by, speed=speed)
        if request.what == "grip":
            if self.jaws is None:
                raise UsageError(f"no gripper of {self._arm.settings.model.name} is known")
            goals = {self.jaws.joint: self.jaws.angle(request.share)}
            return planner.to_joints(goals, speed=speed, start=start)
        taught = taught or self.taught
        if taught is None:
            raise UsageError(NOTHING_TAUGHT)
        edits = Edits(request.begin, request.end, smooth=request.smooth)
        return planner.along(taught, edits, factor=request.factor, fit=request.fit, speed=speed, start=start)

    def _pose(self, name: str) -> Mapping[str, float]:
        return find_pose(self._arm.settings.model, {row.name: row.angles for row in self.pose_rows()}, name)

    def _title(self, request: MotionRequest) -> str:
        if request.what == "place":
            where = " ".join(decimal(1e3 * value) for value in request.place.position)
            return f"a motion {'by' if request.place.relative else 'to'} {where} mm"
        if request.what == "pose":
            return f"a motion to {request.name}"
        if request.what == "grip":
            return f"the gripper to {decimal(100 * request.share, 3)} % open"
        if request.what == "play":
            return "the taught motion"
        if request.what == "step":
            return "a step " + _step_words(request)
        if len(request.goals) > _NAMED:
            return "a motion to joint angles"
        degrees = (f"{name} {decimal(math.degrees(angle))}" for name, angle in request.goals.items())
        return f"a motion to {', '.join(degrees)} deg"
