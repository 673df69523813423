"""Poses by name: home, which every arm has, and those of this user's file for each kind of arm.

Owns the format of that file, its place, and what a name may be. The file is TOML with angles in degrees, so that a
person can read and change it. Must not know robots.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import UsageError
from hexwire.folders import make_folder, open_folder
from hexwire.inputs import parse_toml, read_text
from hexwire.model.gripper import jaws_of
from hexwire.new_file import OutputFile
from hexwire.system import lock_file
from hexwire.units import decimal

from ..loop.reader import position_unknown

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = [
    "HOME",
    "MOST_POSES",
    "PoseFile",
    "check_pose_name",
    "find_pose",
    "home_pose",
    "no_pose",
    "pose_folder",
    "refuse_taken",
    "toml_key",
    "without_gripper",
]

HOME = "home"
"""Name of the pose that every arm has, unless its user has saved another one of this name."""

MOST_POSES = 200
"""Most poses of one kind of arm."""
_LONGEST_NAME = 40
_MOST_DOTS = 8
"""Most dots in a name: the reader of the file refuses lines with many."""
_DIGITS = 8
"""Digits that are kept of an angle in degrees: much finer than a count of any servo."""
_MOST_DEGREES = 36_000.0


def pose_folder() -> Path:
    """Folder of the files: ``hexwire/poses`` in XDG_CONFIG_HOME, which is ~/.config if it is not set."""
    config = os.environ.get("XDG_CONFIG_HOME")
    return (
        (Path(config) if config and Path(config).is_absolute() else Path.home() / ".config") / "hexwire" / "poses"
    )


def check_pose_name(name: str) -> str:
    """Check the name of a pose; surrounding spaces are dropped.

    Returns:
        The name.

    Raises:
        UsageError: It is empty, too long, or has a character that a name cannot have.
    """
    name = name.strip()
    if not name:
        raise UsageError("give the pose a name")
    if len(name) > _LONGEST_NAME:
        raise UsageError(f"the name of a pose has at most {_LONGEST_NAME} characters, not {len(name)}")
    if not name.isprintable() or any(c in '"\\' for c in name) or name.count(".") > _MOST_DOTS:
        raise UsageError(f"the name {name!a} has a character that a name cannot have")
    return name


def refuse_taken(name: str, poses: Container[str], instead: str) -> None:
    """Refuse a name that a pose has already.

    Args:
        name: As `check_pose_name` returns it.
        poses: Those that there are.
        instead: What to do, for the error.

    Raises:
        UsageError: A pose has it.
    """
    if name in poses:
        raise UsageError(f"there is a pose {name!r} already; {instead}")


def home_pose(model: ArmModel) -> dict[str, float]:
    """The middle pose, to which the chapter's board drives its arm: every servo in the middle of its turn.

    The gripper is left as it is: it may hold something.

    Returns:
        Radians by joint.
    """
    middle = {joint.name: min(max(joint.offset, joint.minimum), joint.maximum) for joint in model.joints}
    return without_gripper(model, middle)


def without_gripper(model: ArmModel, angles: Mapping[str, float]) -> dict[str, float]:
    """Angles by joint, but for the gripper, which stays where it is."""
    jaws = jaws_of(model)
    return {name: angle for name, angle in angles.items() if jaws is None or name != jaws.joint}


def find_pose(
    arm: ArmModel, poses: Mapping[str, Mapping[str, float]], name: str, instead: str = ""
) -> Mapping[str, float]:
    """The pose of this name: radians by joint.

    Args:
        arm: Whose poses these are.
        poses: Those that there are.
        name: As somebody gave it.
        instead: What else it could have been, for the error.

    Raises:
        UsageError: There is no such pose.
    """
    if name in poses:
        return poses[name]
    if instead:
        known = ", ".join(poses) or "none"
        raise UsageError(f"{name!r} is neither {instead} nor a pose of {arm.name}; there are {known}")
    raise UsageError(no_pose(arm, poses, name))


def no_pose(arm: ArmModel, poses: Iterable[str], name: str) -> str:
    """That there is no pose of this name, and which there are."""
    return f"no pose {name!r} of {arm.name}; there are {', '.join(poses) or 'none'}"


class PoseFile:
    """The poses of one kind of arm. Any thread and any program of this user may use them at the same time.

    Args:
        model: The arm; its name decides which file it is.
        folder: Folder of the files; `pose_folder` if None.

    Attributes:
        path: The file; it need not exist.
    """

    def __init__(self, model: ArmModel, folder: Path | None = None) -> None:
        self._model = model
        # An arm of a user's own file may be called anything.
        plain = re.sub(r"[^A-Za-z0-9_-]", "_", model.name)[:80] or "arm"
        self.path = (folder or pose_folder()) / f"{plain}.toml"

    def load(self) -> dict[str, dict[str, float]]:
        """All poses by name, in the order of the file: radians by joint.

        Raises:
            ConfigError: The file is damaged; the text names the place.
        """
        return self._parse(read_text(self.path)) if self.path.exists() else {}

    def known(self) -> dict[str, dict[str, float]]:
        """Home and the saved poses, which may have one of that name, by name: radians by joint.

        Raises:
            ConfigError: The file is damaged; the text names the place.
        """
        return {HOME: home_pose(self._model)} | self.load()

    def save(self, name: str, angles: Mapping[str, float], *, force: bool = False) -> str:
        """Save a pose.

        Args:
            name: Its name.
            angles: Radians by joint.
            force: Replace a pose of that name.

        Returns:
            The name as it was saved.

        Raises:
            UsageError: The name is wrong or taken, there are too many poses, or the file cannot be written.
            LimitError: An angle is unknown or outside the limits of its joint.
        """
        name = check_pose_name(name)
        if not angles:
            raise UsageError("a pose names at least one joint")
        for joint, angle in angles.items():
            if not math.isfinite(angle):
                raise UsageError(position_unknown([joint]))
            self._model.joint(joint).check(angle)
        with self._changing() as poses:
            refuse_taken(name, () if force else poses, "choose another name, or replace it")
            if name not in poses and len(poses) >= MOST_POSES:
                raise UsageError(f"there are {MOST_POSES} poses already; remove one first")
            poses[name] = dict(angles)
        return name

    def remove(self, name: str) -> None:
        """Remove a pose.

        Raises:
            UsageError: There is no such pose, or the file cannot be written.
        """
        with self._changing() as poses:
            if poses.pop(name, None) is None:
                raise UsageError(f"there is no pose {name[:_LONGEST_NAME]!r}")

    def rename(self, name: str, new: str) -> str:
        """Give a pose another name; its place in the list stays.

        Returns:
            The new name as it was saved.

        Raises:
            UsageError: There is no such pose, the new name is wrong or taken, or the file cannot be written.
        """
        new = check_pose_name(new)
        with self._changing() as poses:
            if name not in poses:
                raise UsageError(f"there is no pose {name[:_LONGEST_NAME]!r}")
            refuse_taken(new, poses.keys() - {name}, "choose another name")
            rows = [(new if known == name else known, angles) for known, angles in poses.items()]
            poses.clear()
            poses.update(rows)
        return new

    def _parse(self, text: str) -> dict[str, dict[str, float]]:
        root = parse_toml(text, str(self.path)).table((), ("poses",))
        if "poses" not in root:
            return {}
        found: dict[str, dict[str, float]] = {}
        for name, row in root["poses"].table().items():
            if len(found) == MOST_POSES:
                raise root["poses"].fault(f"has more than {MOST_POSES} poses")
            try:
                check_pose_name(name)
            except UsageError as error:
                raise row.fault(str(error)) from None
            angles = row.table()
            if unknown := [joint for joint in angles if joint not in self._model.names]:
                raise row.fault(f"no joint {unknown[0]!r}; there are {', '.join(self._model.names)}")
            if not angles:
                raise row.fault("names no joint")
            found[name] = {
                joint: math.radians(angle.number(-_MOST_DEGREES, _MOST_DEGREES, "deg"))
                for joint, angle in angles.items()
            }
        return found

    @contextmanager
    def _changing(self) -> Iterator[dict[str, dict[str, float]]]:
        """The poses, to be changed; the file is written at the end, and no other program changes it meanwhile."""
        make_folder(self.path.parent)
        with open_folder(self.path.parent) as folder:
            lock = folder.open_lock()
        try:
            lock_file(lock, wait=True)
            poses = self.load()
            yield poses
            text = _serialize(poses)
            if self._parse(text).keys() != poses.keys():
                raise UsageError("this name cannot be written; choose another one")
            with OutputFile(self.path, force=True) as out:
                out.file.write(text.encode())
        except OSError as error:
            raise UsageError(f"{self.path} cannot be written: {error.strerror or error}") from None
        finally:
            os.close(lock)


def _serialize(poses: Mapping[str, Mapping[str, float]]) -> str:
    lines = ["# Poses saved with hexwire; angles in degrees."]
    for name, angles in poses.items():
        lines += ["", f"[poses.{toml_key(name)}]"]
        lines += [f"{toml_key(joint)} = {decimal(math.degrees(angle), _DIGITS)}" for joint, angle in angles.items()]
    return "\n".join(lines) + "\n"


def toml_key(name: str) -> str:
    """A key of TOML; a quoted one is written as a string of JSON, which it also is."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
