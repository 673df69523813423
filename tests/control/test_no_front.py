"""Neither the room nor its errors know any of the fronts that use it."""

from __future__ import annotations

import re
from pathlib import Path

import hexwire.control
import hexwire.errors

_WORDS = re.compile(r"\bROS\b|rospy|roslaunch|actionlib|\w+_msgs|\bREP-\d|hexwire\.(?:ros1|cli)\b")


def test_no_module_says_a_word_of_ros() -> None:
    room = Path(hexwire.control.__file__).parent.glob("**/*.py")
    found = [
        f"{path.name}:{number}: {line.strip()}"
        for path in sorted([*room, Path(hexwire.errors.__file__)])
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if _WORDS.search(line)
    ]
    assert not found, "\n".join(["control/ is for every front; say it without ROS, or move it to ros1:", *found])
