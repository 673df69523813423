"""What the page Move asks of the server: what the arm is, previews, poses, teach mode.

Owns these calls, and their answers as values for JSON. Motion itself is held over the live socket, not asked for
here. Must not know sockets, nor decide about motion.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hexwire.arm.recorded import write_taught
from hexwire.control.requests.motion_service import NOTHING_TAUGHT, read_motion
from hexwire.control.requests.preview import check_factor
from hexwire.errors import LeaseError, UsageError
from hexwire.motion.teach import Edits

from .access import WATCHING_ONLY, Right
from .calls import Arguments, Asked, CallLane, Named, Switched, call
from .geometry import make_geometry, make_turns

if TYPE_CHECKING:
    from hexwire.control.requests.motion_service import MotionRequest
    from hexwire.control.requests.preview import Preview
    from hexwire.motion.teach import Taught

    from .source import ArmSource

__all__ = ["arm_values", "plan_values", "taught_values"]

_ROWS = 60
"""Most postures of a path that a browser is sent."""
_TAUGHT_ROWS = 400
"""Most rows of a taught motion that a browser is sent."""
_DIGITS = 5


class _Motion(Arguments, frozen=True):
    motion: dict[str, Any]


class _SavedMotion(Arguments, frozen=True):
    name: str
    motion: dict[str, Any]
    force: bool = False


class _SavedPose(Arguments, frozen=True):
    name: str
    gripper: bool = True
    force: bool = False


class _NewName(Arguments, frozen=True):
    name: str
    new: str


@call("arm.values", Arguments)
def _values(asked: Asked, args: Arguments) -> dict[str, object]:
    urdf = asked.studio.urdf
    look = None if urdf is None else urdf.geometry(asked.arm.settings.model)
    return {**arm_values(asked.arm), "look": look, "emulated": asked.studio.emulated(asked.arm)}


@call("arm.preview", _Motion, lane=CallLane.COMPUTES)
def _preview(asked: Asked, args: _Motion) -> dict[str, object]:
    motion, taught = _motion_of(asked, args.motion)
    return plan_values(asked.arm.motions.preview(motion, taught=taught), asked.arm)


@call("arm.poses", Arguments)
def _poses(asked: Asked, args: Arguments) -> object:
    return [asdict(row) for row in asked.arm.motions.pose_rows()]


@call("arm.save_pose", _SavedPose, control=True)
def _save(asked: Asked, args: _SavedPose) -> object:
    asked.arm.motions.save_pose(args.name, gripper=args.gripper, force=args.force)
    return _poses(asked, args)


@call("arm.rename_pose", _NewName, control=True)
def _rename(asked: Asked, args: _NewName) -> object:
    asked.arm.motions.poses.rename(args.name, args.new)
    return _poses(asked, args)


@call("arm.remove_pose", Named, control=True)
def _remove(asked: Asked, args: Named) -> object:
    asked.arm.motions.poses.remove(args.name)
    return _poses(asked, args)


@call("arm.teach", Switched, control=True)
def _teach(asked: Asked, args: Switched) -> str:
    return asked.arm.motions.teach(asked.arm.order(asked.tab, asked.arrived), args.on)


@call("arm.taught", Arguments)
def _taught(asked: Asked, args: Arguments) -> dict[str, object]:
    return taught_values(asked.arm)


@call("arm.recordings", Arguments, right=Right.OPERATE)
def _recordings(asked: Asked, args: Arguments) -> list[str]:
    return asked.studio.recordings.library.names(".mcap")


@call("arm.timeline", _Motion, lane=CallLane.COMPUTES)
def _timeline(asked: Asked, args: _Motion) -> dict[str, object]:
    """What is played, as smooth as it is asked for, and all of it."""
    taught, request = _played(asked, args.motion)
    return _curves(taught.smoothed(request.smooth))


@call("arm.save_taught", _SavedMotion, right=Right.OPERATE)
def _save_taught(asked: Asked, args: _SavedMotion) -> list[str]:
    """Keep what would be played as a recording, never over another one without being asked."""
    taught, request = _played(asked, args.motion)
    library = asked.studio.recordings.library
    name = f"{args.name}.mcap"
    if name == asked.studio.recordings.recorder.state.name:
        raise UsageError(f"{name} is being recorded; choose another name")
    part = taught.edited(Edits(request.begin, request.end, smooth=request.smooth)).faster(
        check_factor(request.factor)
    )
    library.make_folder()
    write_taught(part, library.path(name), force=args.force)
    return library.names(".mcap")


def _played(asked: Asked, motion: dict[str, Any]) -> tuple[Taught, MotionRequest]:
    """The taught motion, or the recording, that a page asks for, and how it is played."""
    args, taught = _motion_of(asked, motion)
    request = read_motion({**args, "what": "play"})
    taught = taught or asked.arm.motions.taught
    if taught is None:
        raise UsageError(NOTHING_TAUGHT)
    return taught, request


def _motion_of(asked: Asked, motion: dict[str, Any]) -> tuple[dict[str, object], Taught | None]:
    """As `Recordings.asked`, for those who may play it: what is to move waits for nobody who only watches."""
    if motion.get("recording") and asked.tab.right < Right.OPERATE:
        raise LeaseError(WATCHING_ONLY)
    return asked.studio.recordings.asked(motion, asked.arm.settings.model.names)


def arm_values(arm: ArmSource) -> dict[str, object]:
    """What the page needs to know of an arm before its first frame: radians, metres."""
    kinematics, model, jaws = arm.settings.kinematics, arm.settings.model, arm.motions.jaws
    return {
        "geometry": make_geometry(model, arm.settings.links),
        "joints": [{"name": joint.name, "min": joint.minimum, "max": joint.maximum} for joint in model.joints],
        "table": arm.settings.table,
        "jaws": None if jaws is None else {"joint": jaws.joint, "closed": jaws.closed, "opened": jaws.opened},
        "space": None if kinematics is None else len(kinematics.ranges),
        "turns": None if kinematics is None else make_turns(model, kinematics),
    }


def plan_values(plan: Preview, arm: ArmSource) -> dict[str, object]:
    """A preview for the browser: angles in radians, lengths in metres.

    ``goal`` has all joints whose position at the end is known; ``trace`` are places of the tip along the path.
    """
    path, kinematics = plan.path, arm.settings.kinematics
    names = list(path.names) if path is not None else list(plan.goal)
    ends = dict(zip(path.names, path.goal, strict=True)) if path is not None else {}
    state = arm.arm.owner.state
    here = {} if state is None else state.positions
    goal = {**here, **ends, **plan.goal}
    rows = plan.rows(_ROWS)
    trace: list[list[float]] = []
    if kinematics is not None and rows and set(kinematics.joint_names) <= set(names):
        for row in rows:
            angles = kinematics.from_joints(dict(zip(names, row, strict=True)))
            if all(map(math.isfinite, angles)):
                trace.append(_rounded(kinematics.forward(angles).position))
    return {
        "goal": {name: round(angle, _DIGITS) for name, angle in goal.items() if math.isfinite(angle)},
        "known": bool(plan.goal),
        "duration": plan.duration,
        "lead_in": plan.lead_in,
        "fits": plan.fits,
        "tip": None if plan.tip is None else asdict(plan.tip),
        "branch": plan.branch,
        "branches": [asdict(branch) for branch in plan.branches],
        "refusal": plan.refusal,
        "unready": plan.unready,
        "trace": trace,
    }


def taught_values(arm: ArmSource) -> dict[str, object]:
    """Teach mode and the taught motion for the browser; a long one with fewer rows."""
    taught = arm.motions.taught
    return {"teaching": arm.motions.teaching, "taught": None if taught is None else _curves(taught)}


def _curves(taught: Taught) -> dict[str, object]:
    n = len(taught.times)
    step = max(1, math.ceil(n / _TAUGHT_ROWS))
    places = [*range(0, n - 1, step), n - 1]
    return {
        "names": list(taught.names),
        "duration": taught.duration,
        "times": [round(taught.times[i], 3) for i in places],
        "rows": [_rounded(taught.rows[i]) for i in places],
    }


def _rounded(values: Any) -> list[float]:
    return [round(value, _DIGITS) for value in values]
