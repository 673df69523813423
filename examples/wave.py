"""Wave with the wrist: a path through points that the arm follows without a pause.

python examples/wave.py [PORT]
"""

import sys

import hexwire
from hexwire.control import run_motion
from hexwire.motion.teach import approach
from hexwire.motion.waypoints import Spline, Waypoint

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"

with hexwire.connect(port) as arm:
    wrist = arm.model.names[4]  # J5 of a Hex7Bot, wrist_roll of an SO-101
    here = arm.read().positions[wrist]
    rest = (0.0,)
    angles = [0.0, 0.4, -0.4, 0.4, -0.4, 0.0]
    path = Spline((wrist,), [Waypoint(0.5 * i, (angle,), rest) for i, angle in enumerate(angles)])

    # Slowly to where the path begins, then the path itself.
    result = run_motion(arm, [approach(arm.model, (wrist,), (here,), path.start), path])
    print(result.why or "waved")
    arm.torque(False)
