"""What recording costs: 1000 joint states of seven joints a second, and the traffic they came in."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from tests.frames import frame_bytes
from tests.recorded import make_positions

from hexwire.link.tap import Direction, Passed
from hexwire.trace.capture import Capture
from hexwire.trace.recording import RecordingWriter
from hexwire.wire.command_frame import Command

SECONDS = 5
RATE = 1000
NAMES = tuple(f"J{i}" for i in range(1, 8))


def run() -> list[str]:
    """Processor time of a second's recording, as a share of that second."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.mcap"
        states = [make_positions(NAMES, tuple(0.001 * i + j for j in range(7))) for i in range(RATE)]
        start = time.process_time()
        with RecordingWriter(path) as writer:
            for i in range(SECONDS * RATE):
                writer.joint_state(states[i % RATE], 1.7e9 + i / RATE)
        share = (time.process_time() - start) / SECONDS
        lines.append(f"1000 joint states a second: {share:.1%} of a core (below 10 % wanted)")
        lines.append(f"  {path.stat().st_size / SECONDS / RATE:.0f} bytes a state")
        start = time.process_time()
        with Capture(path, offset=0.0, force=True) as capture:
            for i in range(SECONDS * RATE):
                capture.passed(_reply(i))
        share = (time.process_time() - start) / SECONDS
        lines.append(f"1000 replies a second, bytes and words: {share:.1%} of a core")
    return lines


def _reply(i: int) -> Passed:
    rows = b"".join((2047 + i % 100 + j).to_bytes(2, "little") + b"\x40" for j in range(7))
    body = i.to_bytes(4, "little") + bytes([0, 0, 7, 0]) + rows
    data = frame_bytes(Command.JOINT_STATE, body, cmd_ext=0x80, seq=i, src=8, dst=7, type=8)
    return Passed(Direction.RECEIVED, data, i / RATE, "serial:///dev/x")
