"""`python -m lerobot_robot_hexwire PROGRAM ...`: run a program of LeRobot that does not look for plug-ins itself.

Owns nothing but the order: import the plug-in, then run the program with the arguments that follow.
"""

import sys
from importlib.metadata import distribution

import lerobot_robot_hexwire as _plug_in  # noqa: F401  # registers the configurations


def main() -> str | int | None:
    """Run the program that the first argument names, such as ``lerobot-find-joint-limits``."""
    points = {
        point.name: point for point in distribution("lerobot").entry_points if point.group == "console_scripts"
    }
    if len(sys.argv) < 2 or sys.argv[1] not in points:
        return (
            f"usage: python -m lerobot_robot_hexwire PROGRAM [ARGUMENT]...; programs: {', '.join(sorted(points))}"
        )
    sys.argv = sys.argv[1:]
    status = points[sys.argv[0]].load()()
    return status if isinstance(status, str | int) else None


if __name__ == "__main__":
    sys.exit(main())
