"""The poses of an arm by name, as a mapping.

Owns nothing but this view of their file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING, NoReturn

from hexwire.arguments import FLAG, POSE, check, or_none
from hexwire.control.requests.pose_file import PoseFile, check_pose_name, no_pose, refuse_taken
from hexwire.errors import UsageError

from .plans import ANGLES, joint_angles

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = ["Poses"]

_ROUNDED = math.radians(0.01)


class _NoPoseError(UsageError, KeyError):
    """What a mapping raises, in words."""

    __str__ = Exception.__str__


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
        check("poses.save", "name", POSE, name)
        check("poses.save", "force", FLAG, force)
        check("poses.save", "angles", or_none(ANGLES), angles)
        wanted = None if angles is None else joint_angles(self._model, angles)
        refuse_taken(check_pose_name(name), () if force else self, "force=True replaces it")
        return self._file.save(name, self._read().positions if wanted is None else wanted, force=force)

    def __getitem__(self, name: str) -> Mapping[str, float]:
        known = self._file.known()
        if name not in known:
            raise _NoPoseError(no_pose(self._model, known, name))
        return known[name]

    def __setitem__(self, name: str, angles: Mapping[str, float]) -> None:
        check("a pose", "name", POSE, name)
        check("a pose", "angles", ANGLES, angles)
        name, wanted = check_pose_name(name), joint_angles(self._model, angles)
        # A program that sets its poses may be run again.
        if name in self and _same(self[name], wanted):
            return
        refuse_taken(name, self, f"poses.save({name!r}, angles, force=True) replaces it")
        self._file.save(name, wanted, force=True)

    def __delitem__(self, name: str) -> None:
        saved = self._file.load()
        if name not in saved:
            raise _NoPoseError(no_pose(self._model, saved, name))
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
