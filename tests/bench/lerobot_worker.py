"""hexwire's plug-in and LeRobot's own arm, in LeRobot's environment: `python lerobot_worker.py`. Prints lines.

Both run in this process, in turns, on the same emulated arms, whose lines are paced at 1 Mbaud.
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "integrations" / "lerobot" / "tests"))

from emulated import LOSS, bus, calibrated  # noqa: E402
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig  # noqa: E402
from lerobot_robot_hexwire import HexwireSO101, HexwireSO101Config  # noqa: E402

_ROUNDS = 4
_CALLS = 100
_LOST_CALLS = 600
_CONNECTIONS = 6
_LINE = (8 + 6 + 6 * 8) * 10 / 1_000_000
"""Seconds that a sync read of six positions takes on the line, 10 bits a byte."""
_NAMES = ("hexwire", "lerobot")
_FAULTS = (ConnectionError, RuntimeError, IndexError)
"""What either raises for a lost or late answer; the last one is of LeRobot's servo SDK."""


def main() -> None:
    """Print all figures."""
    logging.disable(logging.CRITICAL)
    with bus() as port:
        calibrated(port, "bench")
        for line in _speed(port):
            print(line, flush=True)
    with bus(*LOSS) as port:
        calibrated(port, "bench")
        for name in _NAMES:
            print(_lossy(port, name), flush=True)


def _make(port: str, name: str) -> Any:
    if name == "hexwire":
        return HexwireSO101(HexwireSO101Config(port=port, id="bench", disable_torque_on_disconnect=False))
    return SO101Follower(SO101FollowerConfig(port=port, id="bench", disable_torque_on_disconnect=False))


def _connected(port: str, name: str) -> Any:
    for _ in range(30):
        robot = _make(port, name)
        try:
            robot.connect(calibrate=False)
        except _FAULTS:
            with suppress(Exception):
                robot.bus.disconnect(disable_torque=False)
        else:
            return robot
    raise ConnectionError(f"{name} cannot connect")


def _speed(port: str) -> list[str]:
    waits: dict[tuple[str, str], list[float]] = {}
    costs: dict[tuple[str, str], list[float]] = {}
    for turn in range(_ROUNDS):
        for name in _NAMES if turn % 2 else _NAMES[::-1]:
            robot = _connected(port, name)
            here = _patiently(robot.get_observation)
            for what, call in (
                ("get_observation", robot.get_observation),
                ("send_action", lambda robot=robot, here=here: robot.send_action(here)),
            ):
                times, cpu = _timed(call)
                waits.setdefault((name, what), []).extend(times)
                costs.setdefault((name, what), []).append(cpu)
            robot.disconnect()
    lines = []
    for what in ("get_observation", "send_action"):
        cells = []
        for name in _NAMES:
            times = sorted(waits[name, what])
            p50, p99, cpu = times[len(times) // 2], times[int(0.99 * len(times))], median(costs[name, what])
            cells.append(f"{name} {1e3 * p50:.2f} / {1e3 * p99:.2f} ms, {1e6 * cpu:.0f} us of CPU")
        ours, theirs = (median(costs[name, what]) for name in _NAMES)
        tail = f"CPU ratio {ours / theirs:.2f} (aim 0.25)"
        if what == "get_observation":
            found = sorted(waits["hexwire", what])
            tail += f", p50 / the line's own {1e3 * _LINE:.2f} ms {found[len(found) // 2] / _LINE:.2f} (aim 1.15)"
        lines.append(f"{what}: {'; '.join(cells)}; {tail}")
    return lines


def _timed(call: Callable[[], object]) -> tuple[list[float], float]:
    times = []
    cpu = time.thread_time()
    for _ in range(_CALLS):
        start = time.perf_counter()
        _patiently(call)
        times.append(time.perf_counter() - start)
    return times, (time.thread_time() - cpu) / _CALLS


def _patiently(call: Callable[[], Any]) -> Any:
    for _ in range(20):
        with suppress(*_FAULTS):
            return call()
    return call()


def _lossy(port: str, name: str) -> str:
    refused = raised = wrong = 0
    for _ in range(_CONNECTIONS):
        robot = _make(port, name)
        try:
            robot.connect(calibrate=False)
            robot.disconnect()
        except _FAULTS:
            refused += 1
            with suppress(Exception):
                robot.bus.disconnect(disable_torque=False)
    robot = _connected(port, name)
    here = _patiently(robot.get_observation)
    for _ in range(_LOST_CALLS):
        try:
            seen = robot.get_observation()
        except _FAULTS:
            raised += 1
        else:
            wrong += any(abs(seen[key] - here[key]) > 5.0 for key in here)
    robot.disconnect()
    return (
        f"1 % of the answers lost, {name}: {raised / _LOST_CALLS:.1%} of the observations raise, {wrong} wrong, "
        f"{refused} of {_CONNECTIONS} connections fail"
    )


if __name__ == "__main__":
    main()
