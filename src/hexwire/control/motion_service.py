"""Motions that people ask for: previewed, begun, and watched; poses by name; a taught motion.

Owns what each request means for this arm, and which of its motions was begun last. Must not know pages, nor how a
person keeps a motion alive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.model.gripper import Jaws, jaws_of
from hexwire.units import decimal

from .hold_to_run import SILENCE
from .motion_request import read_motion
from .motion_run import MotionRun, begin_motion
from .pose_file import HOME, PoseFile, find_pose, home_pose, without_gripper
from .preview import Planner

if TYPE_CHECKING:
    from hexwire.motion.teach import Taught

    from .motion_request import MotionRequest
    from .motion_run import Progress
    from .preview import Preview
    from .shared import Order, SharedArm

__all__ = ["MotionService", "PoseRow"]

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
        self._planner = Planner(shared.arm)
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
    def progress(self) -> Progress | None:
        """Of the motion that was begun last; None before the first."""
        run = self._run
        return None if run is None else run.progress()

    def preview(self, args: Mapping[str, object], *, taught: Taught | None = None) -> Preview:
        """Plan a motion without moving.

        Args:
            args: As in `hexwire.control.motion_request`.
            taught: What is played; the last taught motion if None.

        Raises:
            UsageError: The request is malformed, or there is no such joint, pose or taught motion.
            HexwireError: The arm cannot be reached.
        """
        return self._plan(read_motion(args), taught)

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
        """Begin a motion; a running one is replaced.

        Args:
            orders: As for `begin_motion`.
            args: As for `preview`.
            wanted: As for `begin_motion`.
            age: As for `begin_motion`.
            silence: As for `begin_motion`.
            on_end: As for `begin_motion`.
            taught: As for `preview`.

        Raises:
            LeaseError: Whoever asks does not hold the lease.
            GoalError: The motion may not begin; the text says why.
            HexwireError: As `preview`.
        """
        request = read_motion(args)
        self._run = run = begin_motion(
            self._shared,
            orders,
            self._title(request) if taught is None else "a recording",
            lambda: self._plan(request, taught),
            grip=request.share if request.what == "grip" else None,
            wanted=wanted,
            age=age,
            silence=silence,
            on_end=on_end,
        )
        return run

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

    def _plan(self, request: MotionRequest, taught: Taught | None) -> Preview:
        planner, speed = self._planner, request.speed
        if request.what == "joints":
            return planner.to_joints(request.goals, speed=speed)
        if request.what == "place":
            return planner.to_place(request.place, speed=speed)
        if request.what == "pose":
            return planner.to_joints(self._pose(request.name), speed=speed)
        if request.what == "grip":
            if self.jaws is None:
                raise UsageError(f"no gripper of {self._arm.settings.model.name} is known")
            return planner.to_joints({self.jaws.joint: self.jaws.angle(request.share)}, speed=speed)
        taught = taught or self.taught
        if taught is None:
            raise UsageError("nothing was taught since this arm was opened")
        return planner.along(taught, begin=request.begin, end=request.end, factor=request.factor, speed=speed)

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
        if len(request.goals) > _NAMED:
            return "a motion to joint angles"
        degrees = (f"{name} {decimal(math.degrees(angle))}" for name, angle in request.goals.items())
        return f"a motion to {', '.join(degrees)} deg"
