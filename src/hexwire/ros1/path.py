"""Finds ROS 1 for an interpreter that does not find it automatically, as in a virtual environment.

Owns the list of folders in which Debian and ROS install their Python packages. Imports nothing from ROS.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

__all__ = ["ROS_MISSING", "find_ros"]

ROS_MISSING = (
    "ROS 1 is not installed: sudo apt-get install python3-rospy python3-actionlib python3-sensor-msgs "
    "python3-trajectory-msgs python3-diagnostic-msgs python3-std-srvs"
)
"""What the user must do if `find_ros` finds nothing."""

_DEBIAN = Path("/usr/lib/python3/dist-packages")
_INSTALLATIONS: tuple[tuple[Path, ...], ...] = (
    # The packages in /opt/ros need Debian's PyYAML and rospkg.
    (Path("/opt/ros/noetic/lib/python3/dist-packages"), _DEBIAN),
    (_DEBIAN,),
)
_NEEDED = ("rospy", "actionlib", "sensor_msgs", "trajectory_msgs", "diagnostic_msgs", "std_srvs", "yaml")


def find_ros(installations: Sequence[Sequence[Path]] = _INSTALLATIONS) -> bool:
    """Make ROS 1's Python packages importable, if they are installed.

    If they cannot be imported yet, the folders of the first installation that has rospy are appended to `sys.path`,
    so that they hide no package of the interpreter's environment.

    Args:
        installations: Folders of each installation, the one with rospy first.

    Returns:
        Whether all of them can be imported now; if not, `sys.path` is unchanged.
    """
    if _complete():
        return True
    before = list(sys.path)
    for folders in installations:
        if (folders[0] / "rospy").is_dir():
            sys.path.extend(str(folder) for folder in folders if str(folder) not in sys.path)
            break
    importlib.invalidate_caches()
    if _complete():
        return True
    sys.path[:] = before
    return False


def _complete() -> bool:
    return all(find_spec(name) is not None for name in _NEEDED)
