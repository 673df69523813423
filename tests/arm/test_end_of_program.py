"""What becomes of a motion when the program that began it ends without a ``with`` block."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.few import few
from tests.waits import PATIENCE

PROGRAM = """
import os, signal, sys, time
import hexwire
from hexwire import deg

arm = hexwire.connect(sys.argv[1], speed=1.0)
joint = arm.model.names[0]
before = arm.read()[joint].position
motion = arm.move({joint: deg(40)}, relative=True, duration=60.0, wait=False)
detach = arm.driver.detach


def seen(*, torque_off=False):
    if arm.driver.is_attached:
        print("left", motion.done, arm.read().stopped, flush=True)
    detach(torque_off=torque_off)


arm.driver.detach = seen
while not motion.done:
    # The arm's line belongs to the motion.
    time.sleep(0.05)
    if abs(arm.read()[joint].position - before) > deg(0.3):
        if sys.argv[2] == "end":
            break
        os.kill(os.getpid(), signal.SIGINT)
"""


@few(
    "address, how, stopped",
    [(arm, how, how == "ctrl-c") for arm in ("sim://hex7bot", "sim://so101") for how in ("end", "ctrl-c")],
    ("sim://hex7bot", "ctrl-c", True),
    ("sim://so101", "end", False),
)
def test_at_the_end_of_the_program_the_arm_is_at_rest_and_stopped_after_ctrl_c(
    address: str, how: str, stopped: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(variable, str(tmp_path))
    words = [sys.executable, "-P", "-c", PROGRAM, address, how]
    done = subprocess.run(words, capture_output=True, text=True, timeout=4 * PATIENCE, check=False)
    assert done.stdout == f"left True {stopped}\n", done.stderr
    assert ("KeyboardInterrupt" in done.stderr) == stopped
