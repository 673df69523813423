"""Print where the joints are, ten times a second for two seconds: python examples/read.py [PORT]. Nothing moves."""

import math
import sys

import hexwire

with hexwire.connect(sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot") as arm:
    print("  ".join(f"{name:>7}" for name in arm.model.names))
    for state in arm.states(10.0, seconds=2.0):
        # A servo that does not answer is not an error: the state says so, and the position is the last one known.
        angles = [
            "   none" if joint.name in state.silent else f"{math.degrees(joint.position):7.1f}" for joint in state
        ]
        print("  ".join(angles), "degrees")
