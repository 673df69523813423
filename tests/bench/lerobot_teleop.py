"""`hexwire follow` beside `lerobot-teleoperate` on one emulated pair: `python lerobot_teleop.py`. Prints lines.

The servos of both arms are in this process, so that it sees when a leader's count changes and when the follower's
goal does; the two programs run in processes of their own, on pseudo-terminals paced at 1 Mbaud.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "integrations" / "lerobot" / "tests"))

from emulated import CALIBRATION, calibrated  # noqa: E402

from hexwire.emulator.faults import FaultPlan  # noqa: E402
from hexwire.emulator.serve_bus import serve_bus  # noqa: E402
from hexwire.emulator.servo import EmulatedServo  # noqa: E402
from hexwire.emulator.so_arms import make_so_arm  # noqa: E402
from hexwire.wire.servo_packet import Instruction, ServoPacket  # noqa: E402

_STEPS = 150
_STEP = 6
"""Counts: half a degree, which a follower passes on at once."""


class Bus:
    """An emulated arm that a thread of this process serves."""

    def __init__(self, *, leader: bool, faults: tuple[str, ...] = ()) -> None:
        self.servos = make_so_arm("so101", leader=leader, seed=1, start=time.monotonic()).servos
        self.goals = 0
        first = self.servos[0]
        receive = first.receive

        def count(packet: ServoPacket, now: float) -> bytes | None:
            self.goals += packet.instruction == Instruction.SYNC_WRITE
            return receive(packet, now)

        first.receive = count  # type: ignore[method-assign]
        self._end = threading.Event()
        ready = threading.Event()
        self.path = ""

        def announce(path: str) -> None:
            self.path = path
            ready.set()

        plan = FaultPlan(faults, seed=1)
        self._thread = threading.Thread(
            target=serve_bus,
            args=(self.servos,),
            kwargs={"baud": 1_000_000, "stop": self._end.is_set, "announce": announce, "faults": plan},
        )
        self._thread.start()
        ready.wait()

    def close(self) -> None:
        self._end.set()
        self._thread.join()


def main(names: list[str]) -> None:
    """Measure both, without and with lost answers."""
    for loss in (False, True):
        faults = tuple(f"silent:{i}:0.01" for i in range(1, 7)) if loss else ()
        for name in names or ("hexwire", "lerobot"):
            print(_run(name, faults), flush=True)


def _run(name: str, faults: tuple[str, ...]) -> str:
    leader, follower = Bus(leader=True, faults=faults), Bus(leader=False, faults=faults)
    try:
        calibrated(leader.path, "bench", leader=True)
        calibrated(follower.path, "bench")
        for _ in range(5):
            line = _follow(name, leader, follower, "1 % of the answers lost" if faults else "no loss")
            if line:
                return line
        return f"follow, {name}: cannot connect in 5 attempts"
    finally:
        leader.close()
        follower.close()


def _follow(name: str, leader: Bus, follower: Bus, what: str) -> str:
    program = subprocess.Popen(
        _command(name, leader.path, follower.path), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        pan, goal = leader.servos[0], follower.servos[0].registers
        # Until the follower has met the leader: its goal changes with the leader.
        end = time.monotonic() + 60.0
        while goal.get("torque_enable") != 1:
            if program.poll() is not None or time.monotonic() > end:
                return ""
            time.sleep(0.02)
        time.sleep(4.0)
        if program.poll() is not None:
            return f"follow, {name}, {what}: ended within 4 s" if what != "no loss" else ""
        delays, began, cpu, goals = [], time.monotonic(), _cpu(program.pid), follower.goals
        for i in range(_STEPS):
            before = goal.get("goal_position")
            _shift(pan, _STEP if i % 2 == 0 else -_STEP)
            start = time.perf_counter()
            while goal.get("goal_position") == before and time.perf_counter() - start < 0.5:
                time.sleep(0.0001)
            delays.append(time.perf_counter() - start)
            time.sleep(0.02 + 0.013 * (i % 3))
            if program.poll() is not None:
                return f"follow, {name}, {what}: ended after {time.monotonic() - began:.1f} s"
        spent, seconds, goals = _cpu(program.pid) - cpu, time.monotonic() - began, follower.goals - goals
        delays.sort()
        return (
            f"follow, {name}, {what}: leader's count to follower's goal p50 {1e3 * delays[len(delays) // 2]:.1f}, "
            f"p99 {1e3 * delays[int(0.99 * len(delays))]:.1f} ms; "
            f"{goals / seconds:.0f} cycles a second, {1e3 * spent / max(goals, 1):.2f} ms of CPU each"
        )
    finally:
        program.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            program.wait(10.0)
        program.kill()
        program.wait()


def _command(name: str, leader: str, follower: str) -> list[str]:
    if name == "lerobot":
        words = [f"--robot.port={follower}", "--robot.id=bench", "--robot.type=so101_follower"]
        words += [f"--teleop.port={leader}", "--teleop.id=bench", "--teleop.type=so101_leader"]
        return [sys.executable, "-m", "lerobot.scripts.lerobot_teleoperate", *words]
    files = []
    for folder, port in (("teleoperators/so_leader", leader), ("robots/so_follower", follower)):
        file = CALIBRATION / folder / "bench.toml"
        file.write_text(f'name = "bench"\nbase = "so101"\ncalibration = "{file.with_suffix(".json")}"\n')
        files.append(f"{file}@{port}")
    return [sys.executable, "-m", "hexwire.cli", "follow", "--rate", "300", *files]


def _shift(servo: EmulatedServo, counts: int) -> None:
    """Move the shaft at once, as no hand can: the time of the change is exact."""
    servo.motion.position += counts


def _cpu(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main(sys.argv[1:])
