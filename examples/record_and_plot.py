"""Record a motion, and draw where each joint was and where it should have been.

    python examples/record_and_plot.py [PORT]

Writes motion.mcap, which `hexwire play` and Foxglove can open, and motion.svg. Needs `hexwire[record,plots]`.
"""

import math
import sys
import time

import matplotlib.pyplot as plt

import hexwire
from hexwire.control import MotionObserver, run_motion
from hexwire.trace.recording import RecordingWriter

port = sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot"


class Recorder(MotionObserver):
    """Gets every state of a motion."""

    def __init__(self, recording: RecordingWriter) -> None:
        self.recording = recording
        self.states: list[hexwire.JointState] = []

    def seen(self, state: hexwire.JointState) -> None:
        self.states.append(state)
        # `stamp` is on the monotonic clock; a recording has the time of day.
        self.recording.joint_state(state, state.stamp - time.monotonic() + time.time())


with hexwire.connect(port) as arm, RecordingWriter("motion.mcap", force=True) as recording:
    recorder = Recorder(recording)
    here = arm.read().positions
    goal = {name: here[name] + 0.3 for name in arm.model.names[:2]}
    run_motion(arm, hexwire.JointTarget.of(goal, duration=1.0), observer=recorder).require()
    arm.torque(False)

begin = recorder.states[0].stamp
for name, angle in goal.items():
    times = [state.stamp - begin for state in recorder.states]
    (line,) = plt.plot(times, [math.degrees(state.positions[name]) for state in recorder.states], label=name)
    plt.axhline(math.degrees(angle), color=line.get_color(), linestyle=":")
plt.xlabel("seconds")
plt.ylabel("degrees")
plt.legend()
plt.savefig("motion.svg")
print(f"{len(recorder.states)} states in motion.mcap and motion.svg")
