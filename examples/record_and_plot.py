"""Record a motion, and draw where each joint was.

    python examples/record_and_plot.py [PORT]

Writes motion.mcap, which `hexwire play` and Foxglove can open, and motion.svg. Needs `hexwire[record,plots]`.
"""

import math
import sys

import matplotlib.pyplot as plt

import hexwire

with hexwire.connect(sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot") as arm:
    names = arm.model.names[:2]
    with arm.record("motion.mcap", force=True) as recording:
        arm.move(dict.fromkeys(names, 0.3), relative=True, duration=1.0)
    arm.torque(False)

states = recording.states
for name in names:
    times = [state.stamp - states[0].stamp for state in states]
    plt.plot(times, [math.degrees(state[name].position) for state in states], label=name)
plt.xlabel("seconds")
plt.ylabel("degrees")
plt.legend()
plt.savefig("motion.svg")
print(f"{len(states)} states in motion.mcap and motion.svg")
