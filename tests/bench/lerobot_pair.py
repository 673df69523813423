"""`hexwire follow` and `lerobot-teleoperate`, in turns on one pair of emulated arms: `busemu pair`.

Owns the two programs, and what the goals that the emulator has recorded say. The programs run in processes of
their own; the emulator moves the leader and records the follower's goals, so that no program measures itself.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
_MIDDLE = 2048
_NEAR = 1
"""Counts by which a goal may be off: LeRobot cuts off what it computes, hexwire rounds it."""
_OLDEST = 1.0
"""Seconds: a goal between where the leader was since then is right, however late: a machine may stall."""
_LAST = 0.3
"""Seconds at the end of a recording in which a step may still be on its way."""
_SILENT = 0.5
"""Seconds without a goal after which a program follows no more."""
_FOLLOWS = 0.1
"""Seconds of a recording in which the follower may still be where the recording before left it."""
_PATIENCE = 90.0
"""Seconds until a program follows; the first start of LeRobot takes half a minute."""


@dataclass(frozen=True)
class Recording:
    """Goals that the follower got.

    Attributes:
        began: Time of the beginning, monotonic seconds.
        origin: Time of step 0.
        period: Seconds between steps.
        step: Counts.
        steps: From the lowest count to the highest.
        goals: Time and counts of each goal.
    """

    began: float
    origin: float
    period: float
    step: int
    steps: int
    goals: list[tuple[float, list[int]]]

    def level(self, number: int) -> int:
        """Count of the leader after a step."""
        at = number % (2 * self.steps)
        return _MIDDLE + self.step * (min(at, 2 * self.steps - at) - self.steps // 2)

    def number(self, when: float) -> int:
        """The last step before a time."""
        return int((when - self.origin) / self.period)

    def delays(self, end: float) -> list[float]:
        """Seconds from each step of the leader to the follower's first goal after it; infinite without one."""
        found, at = [], 0
        for number in range(self.number(self.began) + 2, self.number(end - _LAST)):
            if (number + 4) % self.steps < 8:
                continue  # near the ends, where a count is passed twice
            up = self.level(number) > self.level(number - 1)
            when = self.origin + number * self.period
            while at < len(self.goals) and self.goals[at][0] < when:
                at += 1
            # Further than half of a step: the new count, or one after it.
            border = (self.level(number) + self.level(number - 1)) / 2
            arrived = next(
                (time for time, counts in self.goals[at:] if all((one > border) is up for one in counts)),
                float("inf"),
            )
            found.append(arrived - when)
        return found

    def wrong(self) -> int:
        """Goals at a count where the leader was at no time in `_OLDEST` seconds before."""
        count = 0
        for when, counts in self.goals:
            levels = [self.level(i) for i in range(self.number(when - _OLDEST), self.number(when) + 1)]
            count += min(counts) < min(levels) - _NEAR or max(counts) > max(levels) + _NEAR
        return count


class Emulator:
    """A running `busemu pair`.

    Args:
        process: The program.

    Attributes:
        leader: Path of the leader's terminal.
        follower: That of the follower.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.leader, self.follower = self._line().split()
        self._began = 0.0

    def begin(self, *, faults: bool = False) -> None:
        """Begin a recording, with faults or without."""
        self._began = float(self._ask("faults" if faults else "begin"))

    def end(self) -> Recording:
        """End it."""
        count, origin, period, step, steps = self._ask("end").split()
        rows = [self._line().split() for _ in range(int(count))]
        goals = [(float(row[0]), [int(one) for one in row[1:]]) for row in rows]
        return Recording(self._began, float(origin), float(period), int(step), int(steps), goals)

    def _ask(self, word: str) -> str:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()
        return self._line()

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline()


@contextmanager
def emulated(busemu: str) -> Iterator[Emulator]:
    """Run the emulator, with a 1 Mbaud line to each arm; with faults 1 % of the answers are lost."""
    command = [busemu, "pair", "--baud", "1000000", "--fault", "drop:0.01"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Emulator(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            process.wait(timeout=5.0)


def write_calibrations(home: Path) -> None:
    """Write LeRobot's calibration files of both arms, as the emulated servos have it, and hexwire's arm files."""
    rows = {}
    for i, name in enumerate(JOINTS, 1):
        middle = _MIDDLE + (512 if i == 2 else 0)
        ends = {"range_min": middle - 1000, "range_max": middle + 1000}
        rows[name] = {"id": i, "drive_mode": 0, "homing_offset": 0, **ends}
    text = json.dumps(rows)
    for kind in ("robots/so_follower", "teleoperators/so_leader"):
        folder = home / "lerobot" / "calibration" / kind
        folder.mkdir(parents=True)
        (folder / "bench.json").write_text(text)
        arm = f'name = "bench"\nbase = "so101"\ncalibration = "{folder / "bench.json"}"\n'
        (folder / "bench.toml").write_text(arm)


def environment(home: Path) -> dict[str, str]:
    """Environment of the programs: folders of their own, nothing from the network."""
    return {
        **os.environ,
        "HF_HOME": str(home / "hf"),
        "HF_LEROBOT_HOME": str(home / "lerobot"),
        "HF_HUB_OFFLINE": "1",
        "XDG_RUNTIME_DIR": str(home),
    }


def command_of(name: str, python: str, emulator: Emulator, home: Path, rate: float) -> list[str]:
    """The command line of a program."""
    if name == "lerobot":
        words = [f"--robot.port={emulator.follower}", "--robot.id=bench", "--robot.type=so101_follower"]
        words += [f"--teleop.port={emulator.leader}", "--teleop.id=bench", "--teleop.type=so101_leader"]
        return [python, "-m", "lerobot.scripts.lerobot_teleoperate", *words]
    calibration = home / "lerobot" / "calibration"
    leader = f"{calibration}/teleoperators/so_leader/bench.toml@{emulator.leader}"
    follower = f"{calibration}/robots/so_follower/bench.toml@{emulator.follower}"
    return [sys.executable, "-m", "hexwire.cli", "follow", "--rate", f"{rate:g}", leader, follower]


def measure(command: list[str], emulator: Emulator, home: Path, seconds: float, *, faults: bool) -> dict[str, Any]:
    """Run a program until it follows, then record.

    Returns:
        Delays in seconds, goals a second, seconds of CPU a goal, goals and wrong ones, and after how many seconds
        it followed no more, or None; ``{}`` if it did not begin to follow.
    """
    with open(home / "log", "ab") as log:  # noqa: PTH123  # a file for two streams
        program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log, env=environment(home))
    try:
        if not _follows(program, emulator):
            return {}
        emulator.begin(faults=faults)
        began, used = time.monotonic(), _cpu(program.pid)
        with suppress(subprocess.TimeoutExpired):
            program.wait(seconds)
        end = time.monotonic()
        used = _cpu(program.pid) - used
        found = emulator.end()
    finally:
        program.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            program.wait(15.0)
        program.kill()
        program.wait()
    # Its loop may have ended long before the program does.
    last = found.goals[-1][0] if found.goals else began
    ended = last < end - _SILENT
    return {
        "delays": [] if ended else found.delays(end),
        "rate": len(found.goals) / (end - began),
        "cpu": used / max(1, len(found.goals)),
        "wrong": found.wrong(),
        "goals": len(found.goals),
        "ended": last - began if ended else None,
    }


def _follows(program: subprocess.Popen[bytes], emulator: Emulator) -> bool:
    """Wait until the follower's goals are where the leader is."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end and program.poll() is None:
        emulator.begin()
        time.sleep(0.3)
        found = emulator.end()
        late = [time for time, _ in found.goals if time > found.began + _FOLLOWS]
        if len(late) > 5 and not found.wrong():
            time.sleep(1.0)
            return program.poll() is None
    return False


def _cpu(pid: int) -> float:
    """Seconds of CPU that all threads of a process have used."""
    total = 0
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            total += int((task / "schedstat").read_text().split()[0])
    return total * 1e-9
