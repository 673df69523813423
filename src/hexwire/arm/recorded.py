"""A recording as a motion that an arm can play, and such a motion as a recording.

Owns which of its states count, and how many it may have. Must not know arms.
"""

from __future__ import annotations

import time
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.model.state import JointState
from hexwire.motion.teach import Taught
from hexwire.trace.recording import RecordingWriter, read_joint_states, topic_of

__all__ = ["read_taught", "write_taught"]

_MOST_STATES = 500_000
"""Most joint states of a recording to play: several hours."""
_MOST_ANGLES = 16 * _MOST_STATES
"""Most angles in all of them: enough for 16 joints."""
_MOST_SETS = 1000
"""Most different sets of joints in the states; seven joints have 127."""


def read_taught(file: str, arm: str | None = None) -> Taught:
    """Read the motion of the joints that a recording has most states of.

    Args:
        file: A recording (.mcap).
        arm: Name of the arm, if the recording has several.

    Raises:
        UsageError: The file cannot be read, or it has no joint states, too many, or those of several arms.
    """
    # A row may lack joints, for example of a silent servo. Rows are kept by their set of joints, with times and
    # positions only: whole states take many times the memory.
    by_names: dict[tuple[str, ...], list[tuple[float, tuple[float, ...]]]] = {}
    angles = 0
    topic = None if arm is None else topic_of(arm)
    for count, row in enumerate(read_joint_states(file, whole=True, topic=topic)):
        if count == _MOST_STATES:
            raise UsageError(f"{file} has more than {_MOST_STATES} joint states: too many for one motion")
        angles += len(row.position)
        if angles > _MOST_ANGLES:
            raise UsageError(f"{file} has more than {_MOST_ANGLES} angles: too many for one motion")
        by_names.setdefault(row.names, []).append((row.time, row.position))
        if len(by_names) > _MOST_SETS:
            raise UsageError(f"{file} has joint states of more than {_MOST_SETS} different sets of joints")
    if not by_names:
        raise UsageError(f"{file} has no joint states" + (f" of {arm}" if arm is not None else ""))
    names = max(by_names, key=len)
    try:
        return Taught.of(names, by_names[names])
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from None


def write_taught(taught: Taught, file: str | Path, *, force: bool = False) -> int:
    """Write a motion as a recording that begins now; returns the number of its states.

    Args:
        taught: The motion.
        file: The recording (.mcap).
        force: Replace a file of that name.

    Raises:
        HexwireError: The file exists, or cannot be written.
    """
    begin = time.time()
    with RecordingWriter(file, force=force) as recording:
        for t, row in zip(taught.times, taught.rows, strict=True):
            positions = dict(zip(taught.names, row, strict=True))
            recording.joint_state(JointState.of(positions, stamp=0.0, torque=False), begin + t)
    return recording.count
