"""Wave with the wrist, without a pause between the points: python examples/wave.py [PORT]."""

import sys

import hexwire

with hexwire.connect(sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot") as arm:
    wrist = arm.model.names[4]  # J5 of a Hex7Bot, wrist_roll of an SO-101
    here = arm.read().positions[wrist]
    result = arm.goto(*({wrist: here + angle} for angle in (0.4, -0.4, 0.4, -0.4, 0.0)))
    print("waved" if result.arrived else result.why)
    arm.torque(False)
