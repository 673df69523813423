"""The poses of an arm by name, as a mapping.

Owns nothing but this view of their file. Must not know how an arm gets to a pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING

from hexwire.control.pose_file import PoseFile

from .plans import joint_angles

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

__all__ = ["Poses"]


class Poses(MutableMapping[str, Mapping[str, float]]):
    """Radians by joint of each pose by name: home, and those of this user for this kind of arm.

    What is set, saved, or deleted here is changed in the user's file, for the command line and the studio, too.

    Args:
        model: The arm.
        read: Reads its joints.
    """

    def __init__(self, model: ArmModel, read: Callable[[], JointState]) -> None:
        self._model, self._file, self._read = model, PoseFile(model), read

    def save(self, name: str, *, force: bool = False) -> str:
        """Save where the arm is now.

        Args:
            name: Of the pose.
            force: Replace a pose of that name.

        Returns:
            The name as it was saved.

        Raises:
            UsageError: The name is wrong or taken, or the position of a joint is unknown.
        """
        return self._file.save(name, self._read().positions, force=force)

    def __getitem__(self, name: str) -> Mapping[str, float]:
        return self._file.known()[name]

    def __setitem__(self, name: str, angles: Mapping[str, float]) -> None:
        self._file.save(name, joint_angles(self._model, angles), force=True)

    def __delitem__(self, name: str) -> None:
        if name not in self._file.load():
            raise KeyError(name)
        self._file.remove(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._file.known())

    def __len__(self) -> int:
        return len(self._file.known())

    def __repr__(self) -> str:
        return f"<Poses {', '.join(self)}>"
