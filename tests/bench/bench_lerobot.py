"""The plug-in for LeRobot beside LeRobot's own arm, and `hexwire follow` beside `lerobot-teleoperate`.

Needs LeRobot's environment: that of `make test-lerobot`, or the Python that HEXWIRE_BENCH_LEROBOT names.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_USUAL = _HERE.parents[1] / "build" / "lerobot" / "bin" / "python"
_WORKERS = ("lerobot_worker.py", "lerobot_teleop.py")


def run() -> list[str]:
    """Measure; returns the lines to print."""
    python = os.environ.get("HEXWIRE_BENCH_LEROBOT", str(_USUAL))
    if not Path(python).exists():
        return ["LeRobot is not installed here: make test-lerobot, or set HEXWIRE_BENCH_LEROBOT=/path/python"]
    lines = []
    for worker in _WORKERS:
        done = subprocess.run(
            [python, str(_HERE / worker)], capture_output=True, text=True, timeout=900, check=False
        )
        lines += [line for line in done.stdout.splitlines() if line]
        if done.returncode:
            lines.append(f"{worker} failed: {done.stderr.strip().splitlines()[-1:]}")
    return lines


if __name__ == "__main__":
    print("\n".join(run()))
