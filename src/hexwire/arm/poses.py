"""The poses of an arm by name, as a mapping.

Owns nothing but this view of their file. Must not know how an arm gets to a pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING, NoReturn

from hexwire.arguments import FLAG, NAME, check, or_none
from hexwire.control.pose_file import PoseFile, check_pose_name
from hexwire.errors import UsageError

from .plans import ANGLES, joint_angles

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = ["Poses"]

_ROUNDED = math.radians(0.01)


class Poses(MutableMapping[str, Mapping[str, float]]):
    """Radians by joint of each pose by name: home, and those of this user for this kind of arm.

    What is set, saved, or deleted here is changed in the user's file, for the command line and the studio, too. So
    only `save` with `force` replaces a known pose, and no single word deletes all of them.

    Args:
        model: The arm.
        read: Reads its joints.
    """

    def __init__(self, model: ArmModel, read: Callable[[], JointState]) -> None:
        self._model, self._file, self._read = model, PoseFile(model), read

    def save(self, name: str, angles: Mapping[str, float] | None = None, *, force: bool = False) -> str:
        """Save where the arm is now, or other angles.

        Args:
            name: Of the pose; with home, `Arm.home` goes there until it is deleted.
            angles: Radians by joint; where the arm is if None.
            force: Replace a pose of that name.

        Returns:
            The name as it was saved.

        Raises:
            UsageError: The name is wrong or taken, or the position of a joint is unknown.
        """
        check("poses.save", "name", NAME, name)
        check("poses.save", "force", FLAG, force)
        check("poses.save", "angles", or_none(ANGLES), angles)
        wanted = None if angles is None else joint_angles(self._model, angles)
        if not force and check_pose_name(name) in self:
            raise UsageError(f"there is a pose {check_pose_name(name)!r} already; force=True replaces it")
        return self._file.save(name, self._read().positions if wanted is None else wanted, force=force)

    def __getitem__(self, name: str) -> Mapping[str, float]:
        return self._file.known()[name]

    def __setitem__(self, name: str, angles: Mapping[str, float]) -> None:
        check("a pose", "name", NAME, name)
        check("a pose", "angles", ANGLES, angles)
        wanted, known = joint_angles(self._model, angles), self._file.known().get(check_pose_name(name))
        # A program that sets its poses may be run again.
        if known is not None and not _same(known, wanted):
            raise UsageError(
                f"there is a pose {name!r} already; poses.save({name!r}, angles, force=True) replaces it"
            )
        if known is None:
            self._file.save(name, wanted, force=True)

    def __delitem__(self, name: str) -> None:
        if name not in self._file.load():
            raise KeyError(name)
        self._file.remove(name)

    def clear(self) -> NoReturn:
        """Refused: poses are deleted one by one. Raises `UsageError`."""
        raise UsageError("poses are deleted by their names, as in: del arm.poses['rest']")

    def popitem(self) -> NoReturn:
        """Refused, as `clear`. Raises `UsageError`."""
        self.clear()

    def __iter__(self) -> Iterator[str]:
        return iter(self._file.known())

    def __len__(self) -> int:
        return len(self._file.known())

    def __repr__(self) -> str:
        return f"<Poses {', '.join(self)}>"


def _same(known: Mapping[str, float], wanted: Mapping[str, float]) -> bool:
    """Whether a file, which rounds, has these angles."""
    return known.keys() == wanted.keys() and all(abs(known[name] - wanted[name]) < _ROUNDED for name in known)
