"""Move one joint by ten degrees and back, and say whether it arrived.

python examples/move.py [PORT]
"""

import math
import sys

import hexwire
from hexwire.control import run_motion

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"

with hexwire.connect(port) as arm:
    name = arm.model.names[0]
    here = arm.read().positions[name]
    for angle in (here + math.radians(10), here):
        # Checks the path, switches torque on, arms the watchdog, moves, and waits. Ctrl-C stops the arm.
        result = run_motion(arm, hexwire.JointTarget.of({name: angle}, duration=1.0))
        print(f"{name} to {math.degrees(angle):.1f} degrees:", result.why or "there")
    arm.torque(False)
