"""A motion that a person asks for, as values that came from outside: a page, a message.

Owns what may be asked for, and the check of every value. Pure. Must not know how values arrive, nor how a motion is
planned.

A request is a table with the key ``what``:

- ``joints``: ``goals``, radians by joint.
- ``place``: ``position``, three numbers in metres; ``relative``, ``straight``; ``branch``; ``aim``, one of ``arm``
  (the tool keeps its direction relative to the arm), ``space``, ``down``, ``rpy`` and ``pitch``; with ``rpy`` three
  angles, with ``pitch`` a pitch and maybe a ``roll``, in radians.
- ``pose``: ``name``.
- ``grip``: ``share``, 0 is closed, 1 fully open.
- ``play``: ``begin`` and ``end`` in seconds of the taught motion, and ``factor`` of its speed.

All have ``speed``, a share of the joints' speed limits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hexwire.errors import UsageError
from hexwire.model.aim import Aim
from hexwire.model.state import finite

from .via import Place

__all__ = ["MotionRequest", "read_motion"]

_SPEED = 0.3
_MOST = 1000.0
"""Greatest length in metres and angle in radians; a greater one is in a wrong unit."""
_MOST_JOINTS = 253
_LONGEST_TEXT = 100
_KEYS = {
    "joints": ("goals",),
    "place": ("position", "relative", "straight", "aim", "rpy", "pitch", "roll", "branch"),
    "pose": ("name",),
    "grip": ("share",),
    "play": ("begin", "end", "factor"),
}
_AIMS = ("arm", "space", "down", "rpy", "pitch")


@dataclass(frozen=True, slots=True)
class MotionRequest:
    """What is asked for; only what belongs to `what` has a meaning.

    Attributes:
        what: ``joints``, ``place``, ``pose``, ``grip`` or ``play``.
        speed: Share of the joints' speed limits.
        goals: Radians by joint.
        place: Where the tip is to go.
        name: Name of a pose.
        share: Opening of the gripper: 0 is closed, 1 fully open.
        begin: First second of the taught motion to play.
        end: Last second of it to play.
        factor: 2 plays it twice as fast.
    """

    what: str
    speed: float = _SPEED
    goals: Mapping[str, float] = field(default_factory=dict)
    place: Place = field(default_factory=lambda: Place((0.0, 0.0, 0.0)))
    name: str = ""
    share: float = 0.0
    begin: float = 0.0
    end: float = math.inf
    factor: float = 1.0


def read_motion(args: Mapping[str, object]) -> MotionRequest:
    """Check a request from outside; that joints and poses exist is checked when it is planned.

    Raises:
        UsageError: It is malformed; the text names the value.
    """
    what = args.get("what")
    if not isinstance(what, str) or what not in _KEYS:
        raise UsageError(f"there is no motion {str(what)[:20]!r}; there are {', '.join(_KEYS)}")
    for key in args:
        if key not in ("what", "speed", *_KEYS[what]):
            raise UsageError(f"a motion of kind {what} has no value {str(key)[:20]!r}")
    speed = finite(args.get("speed", _SPEED), "speed")
    if what == "joints":
        return MotionRequest(what, speed, goals=_goals(args.get("goals")))
    if what == "place":
        return MotionRequest(what, speed, place=_place(args))
    if what == "pose":
        return MotionRequest(what, speed, name=_text(args, "name"))
    if what == "grip":
        return MotionRequest(what, speed, share=finite(args.get("share"), "share"))
    end = args.get("end")
    return MotionRequest(
        what,
        speed,
        begin=finite(args.get("begin", 0.0), "begin"),
        end=math.inf if end is None else finite(end, "end"),
        factor=finite(args.get("factor", 1.0), "factor"),
    )


def _goals(value: object) -> dict[str, float]:
    if not isinstance(value, Mapping) or not 0 < len(value) <= _MOST_JOINTS:
        raise UsageError("goals must name at least one joint")
    return {str(name): _bounded(angle, f"goal of {str(name)[:20]}") for name, angle in value.items()}


def _place(args: Mapping[str, object]) -> Place:
    aim = args.get("aim", "arm")
    if aim not in _AIMS:
        raise UsageError(f"there is no aim {str(aim)[:20]!r}; there are {', '.join(_AIMS)}")
    roll = args.get("roll")
    return Place(
        _three(args.get("position"), "position"),
        Aim(
            down=aim == "down",
            rpy=_three(args.get("rpy"), "rpy") if aim == "rpy" else None,
            pitch=_bounded(args.get("pitch"), "pitch") if aim == "pitch" else None,
            roll=_bounded(roll, "roll") if aim == "pitch" and roll is not None else None,
            fixed=aim == "space",
        ),
        relative=_flag(args, "relative"),
        straight=_flag(args, "straight"),
        branch=_text(args, "branch") if "branch" in args else "",
    )


def _three(value: object, name: str) -> tuple[float, float, float]:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise UsageError(f"{name} must be three numbers")
    a, b, c = (_bounded(part, name) for part in value)
    return a, b, c


def _bounded(value: object, name: str) -> float:
    number = finite(value, name)
    if not abs(number) <= _MOST:
        raise UsageError(f"{name} has {number:g}, which no arm reaches; give metres and radians")
    return number


def _flag(args: Mapping[str, object], name: str) -> bool:
    value = args.get(name, False)
    if not isinstance(value, bool):
        raise UsageError(f"{name} must be true or false")
    return value


def _text(args: Mapping[str, object], name: str) -> str:
    value = args.get(name)
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
        raise UsageError(f"{name} must be a short text")
    return value
