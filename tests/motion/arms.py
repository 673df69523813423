"""What the tests of motion share: states, and a robot that follows in simulated time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hexwire.drivers.arm_file import load_profile
from hexwire.model.arm import ArmModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.puma260.kinematics import PUMA260
from hexwire.model.state import JointFlag, JointState, JointTarget
from hexwire.motion.trajectory import Spline, Waypoint

NAMES = HEX7BOT.names
ARMS = (HEX7BOT, PUMA260, *(load_profile(name).model for name in ("so100", "so101")))
EXCESS, PERIOD = 1.001, 1e-3
"""The most of any limit that counts as kept, and seconds between two samples that show it."""
HOME = {joint.name: joint.offset for joint in HEX7BOT.joints}


def rest_to_rest(names: Sequence[str], start: Sequence[float], goal: Sequence[float], seconds: float) -> Spline:
    """From standing to standing, all joints together."""
    rest = (0.0,) * len(start)
    return Spline(names, [Waypoint(0.0, tuple(start), rest, rest), Waypoint(seconds, tuple(goal), rest, rest)])


def state(
    positions: Mapping[str, float] | None = None,
    *,
    load: Mapping[str, float] | None = None,
    flags: Mapping[str, JointFlag] | None = None,
    age: Mapping[str, float] | None = None,
    stamp: float = 0.0,
    stopped: bool = False,
    watchdog_tripped: bool = False,
) -> JointState:
    """A state of the 7Bot at home, but for what is given."""

    def column(given: Mapping[str, float] | None, usual: float) -> tuple[float, ...]:
        return tuple((given or {}).get(name, usual) for name in NAMES)

    where = {**HOME, **(positions or {})}
    return JointState(
        names=NAMES,
        position=tuple(where[name] for name in NAMES),
        velocity=column(None, 0.0),
        load=column(load, 0.0),
        current=column(None, 0.1),
        voltage=column(None, 6.0),
        temperature=column(None, 30.0),
        flags=tuple((flags or {}).get(name, JointFlag.TORQUE_ON) for name in NAMES),
        age=column(age, 0.0),
        stamp=stamp,
        stopped=stopped,
        watchdog_tripped=watchdog_tripped,
    )


def at_rest(arm: ArmModel, positions: Sequence[float]) -> JointState:
    """A state of any arm that holds, in the order of its joints."""
    count = len(arm.names)
    zero = (0.0,) * count
    return JointState(
        names=arm.names, position=tuple(positions), velocity=zero, load=zero, current=zero, voltage=zero,
        temperature=zero, flags=(JointFlag.TORQUE_ON,) * count, age=zero, stamp=0.0,
    )  # fmt: skip


class FakeTime:
    """A clock that only sleeping moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class FakeRobot:
    """Goes to each target at an even speed in the target's duration, as servos do."""

    def __init__(self, time: FakeTime) -> None:
        self.time = time
        self.where = dict(HOME)
        self.targets: list[tuple[float, JointTarget]] = []
        self.stops = 0
        self.jammed: dict[str, float] = {}
        self._ways: dict[str, tuple[float, float, float, float]] = {}

    def read(self) -> JointState:
        self._move()
        load = dict.fromkeys(self.jammed, 0.7)
        return state({**self.where, **self.jammed}, load=load, stamp=self.time.now, stopped=self.stops > 0)

    def write(self, target: JointTarget) -> None:
        self._move()
        self.targets.append((self.time.now, target))
        for name, angle in target.positions:
            self._ways[name] = (self.where[name], angle, self.time.now, target.duration)

    def stop(self) -> None:
        self.stops += 1

    def _move(self) -> None:
        for name, (start, goal, since, duration) in self._ways.items():
            share = min(1.0, (self.time.now - since) / duration) if duration else 1.0
            self.where[name] = start + share * (goal - start)


def cubic_at(p: float, q: float, v: float, w: float, h: float, u: float) -> tuple[float, float, float, float]:
    """Position, velocity, acceleration and jerk of a cubic from p at v to q at w in h seconds, after u of them."""
    c2 = (3.0 * (q - p) - h * (2.0 * v + w)) / h**2
    c3 = (h * (v + w) - 2.0 * (q - p)) / h**3
    return p + u * (v + u * (c2 + u * c3)), v + u * (2.0 * c2 + 3.0 * u * c3), 2.0 * c2 + 6.0 * u * c3, 6.0 * c3
