"""One process, one to fifty arms at 50 Hz each: how its CPU time grows.

Every arm is an emulated board with seven servos and a driver of its own; a cycle reads all joints, and every fifth
sends a set-point. Both sides of the line are in the process, and most of the time is the emulator's.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.system.fleet import run_fleet

_COUNTS = (1, 5, 10, 25, 50)
_SECONDS = 3.0
_RATE = 50.0


def run() -> list[str]:
    """Measure; returns the lines to print."""
    lines = [f"arms at {_RATE:g} Hz each, {_SECONDS:g} s a row; CPU of this process, both sides of the line:"]
    shares: dict[int, float] = {}
    for count in _COUNTS:
        _, cpu, achieved = run_fleet(count, _SECONDS, rate=_RATE)
        cycles = count * _SECONDS * _RATE
        # Of a core at the full rate, whatever rate this machine had room for.
        shares[count] = cpu / cycles * count * _RATE
        lines.append(
            f"  {count:2} arms: {100 * shares[count]:5.1f} % of a core, {1e6 * cpu / cycles:4.0f} us a cycle, "
            f"achieved {achieved:.1f} Hz"
        )
    # The first arms pay for caches that are cold; growth from there on is what tells.
    slope = (shares[50] - shares[10]) / 40
    ratio = slope / ((shares[10] - shares[1]) / 9)
    lines.append(
        f"  an arm more costs {100 * slope:.2f} % of a core; from 10 to 50 arms {ratio:.2f} times what it costs "
        "from 1 to 10: linear is 1"
    )
    return lines


if __name__ == "__main__":
    print("\n".join(run()))
