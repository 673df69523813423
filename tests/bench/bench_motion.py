"""The motion loop beside a bare sleep loop: how late cycles start, and what a cycle costs.

Both loops run in the same process in turns, so that a stall of the machine hits both. The robot is a table: what
is measured is the loop, the follower and its guard, not a link.
"""

from __future__ import annotations

import statistics
import time

from hexwire.control.loop import MotionLoop
from hexwire.model.hex7bot import HEX7BOT
from hexwire.model.state import JointFlag, JointState, JointTarget
from hexwire.motion.follower import Follower
from hexwire.motion.optimal import Trapezoid

_RATE = 100.0
_SECONDS = 1.0
_ROUNDS = 3
_CYCLES = 5000


class _Table:
    """A robot that is where it was told to be."""

    def __init__(self) -> None:
        self.where = [joint.offset for joint in HEX7BOT.joints]

    def read(self) -> JointState:
        n = len(self.where)
        zeros = (0.0,) * n
        flags = (int(JointFlag.TORQUE_ON),) * n
        return JointState(
            names=HEX7BOT.names,
            position=tuple(self.where),
            velocity=zeros,
            load=zeros,
            current=zeros,
            voltage=zeros,
            temperature=zeros,
            flags=flags,
            age=zeros,
            stamp=0.0,
        )

    def write(self, target: JointTarget) -> None:
        for name, angle in target.positions:
            self.where[HEX7BOT.index(name)] = angle

    def stop(self) -> None:
        """Never asked for."""


def _trajectory(seconds: float) -> Trapezoid:
    start = [joint.offset for joint in HEX7BOT.joints]
    speeds = [joint.max_speed for joint in HEX7BOT.joints]
    return Trapezoid(HEX7BOT.names, start, [a + 0.5 for a in start], speeds, [8.0] * 7, duration=seconds)


def _bare() -> list[float]:
    """Seconds behind each deadline of a loop that does nothing but sleep."""
    start = time.monotonic()
    late = []
    for i in range(int(_RATE * _SECONDS)):
        due = start + i / _RATE
        left = due - time.monotonic()
        if left > 0:
            time.sleep(left)
        late.append(time.monotonic() - due)
    return late


def _ours() -> tuple[list[float], MotionLoop]:
    loop = MotionLoop(_Table(), Follower(HEX7BOT), _RATE)
    loop.cycle()
    loop.follow(_trajectory(2 * _SECONDS))
    late = []
    start = time.monotonic()
    for due in loop.timing.ticks(_SECONDS):
        late.append(time.monotonic() - start - due)
        loop.cycle()
    return late, loop


def _cpu_per_cycle() -> float:
    clock = [0.0]
    loop = MotionLoop(_Table(), Follower(HEX7BOT), _RATE, clock=lambda: clock[0])
    loop.cycle()
    loop.follow(_trajectory(_CYCLES / _RATE))
    begin = time.process_time()
    for _ in range(_CYCLES):
        clock[0] += 1.0 / _RATE
        loop.cycle()
    return (time.process_time() - begin) / _CYCLES


def run() -> list[str]:
    """Measure; returns the lines to print."""
    bare: list[float] = []
    ours: list[float] = []
    counted = 0
    for _ in range(_ROUNDS):
        bare += _bare()
        late, loop = _ours()
        ours += late
        counted += loop.timing.counters.late
    cpu = _cpu_per_cycle()

    def row(name: str, values: list[float]) -> str:
        worst = sorted(values)[int(0.99 * len(values))]
        return (
            f"{name:24} median {1e6 * statistics.median(values):7.0f} us late   p99 {1e6 * worst:7.0f} us   "
            f"worst {1e6 * max(values):7.0f} us"
        )

    share = f"{100 * cpu * _RATE:.1f} % of a core at {_RATE:g} Hz"
    ratio = statistics.median(ours) / max(statistics.median(bare), 1e-9)
    return [
        f"motion loop, {_RATE:g} Hz, 7 joints on a trajectory, {len(ours)} cycles each",
        row("  bare sleep loop", bare),
        row("  read-update-write", ours) + f"   ({ratio:.2f} x the bare median)",
        f"  counted late by the loop {counted} of {len(ours)}; CPU per cycle {1e6 * cpu:.0f} us ({share})",
    ]
