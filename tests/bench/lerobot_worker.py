"""One robot class in LeRobot's environment: `python lerobot_worker.py hexwire|lerobot|bare PORT`.

Owns the calls and their times. Each line on standard input is a request as JSON, each line on standard output its
result: "speed" connects, measures a number of cycles, and disconnects; "connections" tries to connect a number of
times; "observe" counts what goes wrong in a number of observations. "bare" is no robot, but the system calls alone.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from typing import Any

_FAULTS = (ConnectionError, RuntimeError, IndexError)
"""What either raises for a lost or late answer; the last one is of LeRobot's servo SDK."""
_SWING = 5.0
"""Units of an action: it changes in every cycle, as a leader's does."""
_NEAR = 0.5


class Robot:
    """A follower of one of the two classes.

    Args:
        name: hexwire or lerobot.
        port: Its port.
    """

    def __init__(self, name: str, port: str) -> None:
        if name == "hexwire":
            from lerobot_robot_hexwire import HexwireSO101, HexwireSO101Config

            self._make: Callable[[], Any] = lambda: HexwireSO101(HexwireSO101Config(port=port, **options))
        else:
            from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig

            self._make = lambda: SO101Follower(SO101FollowerConfig(port=port, **options))
        options: dict[str, Any] = {"id": "bench", "disable_torque_on_disconnect": False}

    def connect(self) -> Any:
        """A connected robot; `_FAULTS` if it cannot connect."""
        robot = self._make()
        try:
            robot.connect(calibrate=False)
        except _FAULTS:
            with suppress(Exception):
                robot.bus.disconnect(disable_torque=False)
            raise
        return robot

    def patiently(self) -> Any:
        """Connect, however often it takes."""
        return _patiently(self.connect)

    def speed(self, cycles: int, rate: float) -> dict[str, list[float]]:
        """Times of observations and actions in turns; of observations alone before, as `alone`.

        Args:
            cycles: How many.
            rate: Cycles a second; 0 for as many as the line takes.
        """
        robot = self.patiently()
        here = _patiently(robot.get_observation)
        rows: dict[str, list[float]] = {key: [] for key in ("alone", "observe", "act", "observe_cpu", "act_cpu")}
        clock, cpu = time.perf_counter, time.thread_time
        for _ in range(0 if rate else cycles):
            begin = clock()
            _patiently(robot.get_observation)
            rows["alone"].append(clock() - begin)
        due = clock()
        for i in range(cycles):
            action = {key: value + _SWING * math.sin(0.05 * i) for key, value in here.items()}
            if rate:
                due += 1.0 / rate
                time.sleep(max(0.0, due - clock()))
            begin, used = clock(), cpu()
            _patiently(robot.get_observation)
            middle, half = clock(), cpu()
            robot.send_action(action)
            rows["act_cpu"].append(cpu() - half)
            rows["act"].append(clock() - middle)
            rows["observe"].append(middle - begin)
            rows["observe_cpu"].append(half - used)
        robot.disconnect()
        return rows

    def connections(self, count: int) -> dict[str, list[float]]:
        """Seconds and processor time of those of a number of connections that do not fail."""
        rows: dict[str, list[float]] = {"connect": [], "connect_cpu": []}
        for _ in range(count):
            begin, used = time.perf_counter(), time.process_time()
            try:
                robot = self.connect()
            except _FAULTS:
                continue
            rows["connect"].append(time.perf_counter() - begin)
            rows["connect_cpu"].append(time.process_time() - used)
            with suppress(*_FAULTS):
                robot.disconnect()
        return rows

    def observe(self, count: int) -> dict[str, int]:
        """How many of a number of observations raise, and how many are wrong. The arm is at rest."""
        robot = self.patiently()
        while True:
            with suppress(*_FAULTS):
                here = robot.get_observation()
                break
        raised = wrong = 0
        for _ in range(count):
            try:
                seen = robot.get_observation()
            except _FAULTS:
                raised += 1
            else:
                wrong += any(abs(seen[key] - here[key]) > _NEAR for key in here)
        for _ in range(5):
            with suppress(*_FAULTS):
                robot.disconnect()
                break
        return {"raised": raised, "wrong": wrong}


class Bare:
    """The system calls of a cycle: what no program can do without.

    Args:
        name: Not used.
        port: The port.
    """

    def __init__(self, name: str, port: str) -> None:
        self._port = port
        rows = b"".join(bytes((i, 0, 0, 8, 0, 0, 1, 0)) for i in range(1, 7))
        self._goals = _packet(0x83, bytes((41, 7)) + rows)
        self._question = _packet(0x82, bytes((56, 2, 1, 2, 3, 4, 5, 6)))

    def speed(self, cycles: int, rate: float) -> dict[str, list[float]]:
        """As `Robot.speed`, CPU only."""
        fd = os.open(self._port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(fd)
        rows: dict[str, list[float]] = {"observe_cpu": [], "act_cpu": []}
        cpu = time.thread_time
        for _ in range(cycles):
            time.sleep(1.0 / rate if rate else 0.0)
            used, count = cpu(), 0
            os.write(fd, self._question)
            while count < 6 * 8:
                count += len(os.read(fd, 256))
            half = cpu()
            os.write(fd, self._goals)
            rows["act_cpu"].append(cpu() - half)
            rows["observe_cpu"].append(half - used)
        os.close(fd)
        return rows


def _packet(instruction: int, params: bytes) -> bytes:
    body = bytes((0xFE, len(params) + 2, instruction)) + params
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def _patiently(call: Callable[[], Any]) -> Any:
    """Call again after a fault: LeRobot gives an answer 50 ms, and the machine may stall."""
    for _ in range(30):
        with suppress(*_FAULTS):
            return call()
    return call()


def main() -> None:
    """Answer requests until the input ends."""
    logging.disable(logging.CRITICAL)
    robot = (Bare if sys.argv[1] == "bare" else Robot)(*sys.argv[1:3])
    print("{}", flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        found = getattr(robot, request.pop("what"))(**request)
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
