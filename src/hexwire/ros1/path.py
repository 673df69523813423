"""Where ROS 1 is installed, for an interpreter that does not see it by itself, as in a virtual environment.

Owns the folders in which Debian and ROS put their Python packages. Imports nothing of ROS.
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
"""What a person must do where `find_ros` finds nothing."""

_DEBIAN = Path("/usr/lib/python3/dist-packages")
_INSTALLATIONS: tuple[tuple[Path, ...], ...] = (
    # ROS's own packages need Debian's PyYAML and rospkg.
    (Path("/opt/ros/noetic/lib/python3/dist-packages"), _DEBIAN),
    (_DEBIAN,),
)
_NEEDED = ("rospy", "actionlib", "sensor_msgs", "trajectory_msgs", "diagnostic_msgs", "std_srvs", "yaml")


def find_ros(installations: Sequence[Sequence[Path]] = _INSTALLATIONS) -> bool:
    """Make ROS 1's Python packages importable, if they are somewhere.

    Where they are not found already, the folders of the first installation that holds rospy go to the end of
    `sys.path`: nothing there hides a package of the interpreter's own.

    Args:
        installations: Folders of each installation, that of rospy first.

    Returns:
        Whether all of them can be imported now; if not, `sys.path` is as it was.
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
