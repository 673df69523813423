"""Print where the joints are, ten times a second for two seconds. Nothing moves.

python examples/read.py [PORT]
"""

import math
import sys
import time

import hexwire

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"

with hexwire.connect(port) as arm:
    print("  ".join(f"{name:>7}" for name in arm.model.names))
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        state = arm.read()
        # A servo that does not answer is not an error: the state says so, and the position is the last one known.
        angles = [
            "   none" if joint.name in state.silent else f"{math.degrees(joint.position):7.1f}" for joint in state
        ]
        print("  ".join(angles), "degrees")
        time.sleep(0.1)
