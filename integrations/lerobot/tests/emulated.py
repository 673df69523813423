"""Emulated SO-101 arms on pseudo-terminals, calibrated, with LeRobot's files in a folder of the test run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
HOME = Path(tempfile.mkdtemp(prefix="hexwire-lerobot-"))
# LeRobot reads these when it is imported.
os.environ.update(
    HF_HOME=str(HOME / "hf"),
    HF_LEROBOT_HOME=str(HOME / "lerobot"),
    HF_HUB_OFFLINE="1",
    XDG_RUNTIME_DIR=str(HOME / "run"),
)
(HOME / "run").mkdir(mode=0o700)

import pytest  # noqa: E402
from lerobot.motors.feetech import FeetechMotorsBus  # noqa: E402

from hexwire.bus import timing  # noqa: E402
from hexwire.drivers.arm_file import load_calibration  # noqa: E402
from hexwire.drivers.bus_arm import So101Arm  # noqa: E402
from hexwire.emulator.bus_arms import make_bus_arm  # noqa: E402
from hexwire.setup.calibrating import store  # noqa: E402

CALIBRATION = HOME / "lerobot" / "calibration"
BUS = (sys.executable, "-m", "hexwire.cli", "sim", "bus", "--arm", "so101", "--until-eof")
LOSS = tuple(word for servo in range(1, 7) for word in ("--fault", f"silent:{servo}:0.01"))
"""Each answer of a servo is lost with a probability of 1 %."""


@contextmanager
def bus(*options: str) -> Iterator[str]:
    """The port of an emulated SO-101 that was never calibrated.

    The emulator is a program that gets no processor for a while where the machine is busy: this process waits for
    its answers for longer than for those of real servos, unless some of them are to be lost.
    """
    with ExitStack() as stack:
        if "--fault" not in options:
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            for allowance in ("_FIRST_ALLOWANCE", "_LEAST_ALLOWANCE", "_MOST_ALLOWANCE"):
                patch.setattr(timing, allowance, 1.0)
        process = stack.enter_context(
            subprocess.Popen((*BUS, *options), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        )
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.stdin.close()
            process.wait(timeout=30.0)


def calibration_text(*, leader: bool = False) -> str:
    """LeRobot's file for such an arm, with the middles and ends that it was assembled with."""
    rows = {}
    for joint in make_bus_arm("so101", leader=leader, seed=1).model.joints:
        offset = (joint.neutral - 2047 + 2048) % 4096 - 2048
        low, high = joint.count_limits
        half = 2047 if joint.name == "wrist_roll" else (high - low) // 2 - 6
        middle = 2047 + (0 if joint.name == "wrist_roll" else (high + low) // 2 - joint.neutral)
        rows[joint.name] = {
            "id": joint.servo_id,
            "drive_mode": 0,
            "homing_offset": offset,
            "range_min": middle - half,
            "range_max": middle + half + (joint.name == "wrist_roll"),
        }
    return json.dumps(rows, indent=4)


def calibration_file(name: str, *, leader: bool = False) -> Path:
    """Write LeRobot's file for a name."""
    folder = CALIBRATION / ("teleoperators/so_leader" if leader else "robots/so_follower")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.json"
    file.write_text(calibration_text(leader=leader))
    return file


def calibrated(port: str, name: str, *, leader: bool = False) -> Path:
    """Write LeRobot's file for a name, and store it in the servos."""
    file = calibration_file(name, leader=leader)
    with So101Arm.from_url(port) as arm:
        store(arm.bus, load_calibration(file))
    return file


def patiently(call: Callable[[], T]) -> T:
    """Ask LeRobot's own arm until it answers: it gives up after 50 ms, which the emulator may be late by."""
    for _ in range(30):
        with suppress(ConnectionError, RuntimeError):
            return call()
        time.sleep(0.1)
    return call()


def reach(bus: FeetechMotorsBus) -> None:
    """Open the bus of LeRobot's own arm; it leaves the port open when the first answer comes too late."""

    def connect() -> None:
        try:
            bus.connect()
        except ConnectionError:
            with suppress(ConnectionError, RuntimeError):
                bus.disconnect(disable_torque=False)
            raise

    patiently(connect)
