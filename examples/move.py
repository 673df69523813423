"""Move one joint by ten degrees and back, and say where it came to rest: python examples/move.py [PORT]."""

import math
import sys

import hexwire
from hexwire import deg

with hexwire.connect(sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot") as arm:
    name = arm.model.names[0]
    for angle in (deg(10), deg(-10)):
        # Checks the path, switches torque on, arms the watchdog, moves, and waits. Ctrl-C stops the arm.
        arm.move({name: angle}, relative=True)
        print(f"{name} is at {math.degrees(arm.read()[name].position):.1f} degrees")
    arm.torque(False)
