"""The motion loop beside a bare sleep loop: how late cycles start, and what a cycle costs; planning beside others.

Both loops run in the same process in turns, so that a stall of the machine hits both. The robot is a table: what
is measured is the loop, the follower and its guard, not a link.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

from tests.bench.motion_peers import compare

from hexwire.control.loop.controller import TrajectoryController
from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.arrival import Tolerance
from hexwire.control.motion.goals import Tolerances
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.settings import ControllerSettings
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.values import StopMode
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.pose import Pose
from hexwire.model.state import JointState, JointTarget, SentTarget
from hexwire.motion.line import Line
from hexwire.motion.optimal import Trapezoid
from hexwire.motion.safety import SafetyLimits

_RATE = 100.0
_SECONDS = 1.0
_ROUNDS = 3
_CYCLES = 5000
_POINTS = 500


class _Table(RobotDriver):
    """A robot that is where it was told to be."""

    model = HEX7BOT
    is_attached = True

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.where = [joint.offset for joint in HEX7BOT.joints]
        self._clock = clock

    def now(self) -> float:
        return self._clock()

    def read(self) -> JointState:
        positions = dict(zip(HEX7BOT.names, self.where, strict=True))
        return JointState.of(positions, velocity=(0.0,) * len(positions), torque=True, stamp=self._clock())

    def write(self, target: JointTarget) -> SentTarget:
        for name, angle in target.positions:
            self.where[HEX7BOT.index(name)] = angle
        return SentTarget(target.positions, target.duration)

    def attach(self) -> None:
        """There is nothing to open."""

    def detach(self, *, torque_off: bool = False) -> None:
        """There is nothing to close."""

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        return HEX7BOT.names

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        return HEX7BOT.names

    def resume(self) -> None:
        """It is never stopped."""


def _owner(seconds: float, **options: Any) -> RobotOwner:
    """Its robot is on a trajectory of so many seconds."""
    names = HEX7BOT.names
    none = {name: Tolerance() for name in names}
    controller = TrajectoryController(
        ControllerSettings("", names, True, Tolerances(none, none)),
        HEX7BOT,
        SafetyLimits.at_period(1.0 / _RATE),
        check=PathCheck.limits_only(HEX7BOT),
    )
    owner = RobotOwner(_Table(options.get("clock", time.monotonic)), borrowed=True, command_rate=_RATE, **options)
    owner.group.members = (controller,)
    owner.connect()
    owner.turn()
    controller.follow(_trajectory(seconds), owner.newest(), owner.now())
    return owner


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


def _ours() -> tuple[list[float], RobotOwner]:
    late: list[float] = []
    with _owner(2 * _SECONDS) as owner:
        timing = owner.timing
        owner.observe(lambda state: late.append((time.monotonic() - timing._started) % timing.period))
        while len(late) < _RATE * _SECONDS:
            owner.turn()
    return late, owner


def _cpu_per_cycle() -> float:
    clock = [0.0]

    def sleep(seconds: float) -> None:
        clock[0] += seconds

    with _owner(_CYCLES / _RATE, clock=lambda: clock[0], sleep=sleep) as owner:
        begin = time.process_time()
        for _ in range(_CYCLES):
            owner.turn()
        return (time.process_time() - begin) / _CYCLES


def _line() -> tuple[float, float]:
    """Seconds a point of a straight line, and of the four inverse solutions that exact differences take."""
    model = Hex7BotModel()
    start = tuple(math.radians(d) for d in (90, 100, 90, 90, 45, 90))
    here = model.forward(start)
    x, y, z = here.position
    line = Line(model, start, Pose((x + 0.08, y + 0.02, z - 0.06), here.rotation))
    times = [line.duration * i / _POINTS for i in range(_POINTS)]
    begin = time.process_time()
    for t in times:
        line.at(t)
    middle = time.process_time()
    for t in times:
        for _ in range(4):
            model.inverse(line.pose(t / line.duration))
    return (middle - begin) / _POINTS, (time.process_time() - middle) / _POINTS


def run() -> list[str]:
    """Measure; returns the lines to print."""
    point, exact = _line()
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
        f"a point of a straight line: {1e6 * point:.0f} us, {point / exact:.3f} x the four solutions it would take",
        *compare(),
    ]
