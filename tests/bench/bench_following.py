"""How far an arm stays behind the one that leads it, in simulated time: `hexwire follow` beside goals as they come.

Goals as they come are what LeRobot's own arm gets: the leader's positions, 60 times a second, without a speed. The
servos are the same emulated ones, at 1 Mbaud; nothing depends on the machine.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

from hexwire.control.loop.owner import RobotOwner, release
from hexwire.control.motion.following import BriefReader, FollowController, following_rules
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.model.state import JointState

_JOINT = "shoulder_pan"
_LEROBOT_RATE = 60.0
_AMPLITUDE = 40.0
_SINES = (0.5, 1.0, 1.5)
_PERIODS = 4
_JUMPS, _BETWEEN = 24, 1.2
"""Jumps of the leader, and seconds from one to the next."""
_SMALLEST, _LARGEST = 9.0, 158.0
_SMALL = 0.35
"""Degrees of a small step: four counts."""
_THERE = 0.1
"""Degrees within which a goal is the leader's position."""
_LOOK = 0.001


class _Row(NamedTuple):
    """A moment.

    Attributes:
        time: Seconds since the beginning.
        leader: Degrees of the leader.
        asked: The same when the follower asked last.
        goal: Degrees to which the follower's servo is sent.
        arm: Degrees where it is.
    """

    time: float
    leader: float
    asked: float
    goal: float
    arm: float


class _Rig:
    """An emulated follower, and a leader whose only joint that moves is where a function of time says, degrees."""

    def __init__(self, angle: Callable[[float], float]) -> None:
        self.clock = FakeClock()
        self.began = self.clock()
        self._angle = angle
        made = make_bus_arm("so101", start=self.clock())
        self.servo = made.servos[0]
        device = BusDevice(made.servos, paced=True, host_baud=lambda: 1_000_000)
        self.arm = So101Arm(BoardLink(device, self.clock))
        self.arm.attach()
        self.arm.torque(True)
        self.rest = self.arm.read().positions
        self.joint = self.arm.model.joint(_JOINT)
        self._asked = 0.0
        self.rows: list[_Row] = []

    def asked(self) -> float:
        """Degrees of the leader now, for the next goal."""
        self._asked = self._angle(self.clock() - self.began)
        return self._asked

    def leader(self) -> JointState:
        """The leader's state now."""
        angles = self.rest | {_JOINT: math.radians(self.asked())}
        return JointState.of(angles, torque=False, stamp=self.clock())

    def note(self) -> None:
        """Keep where the leader is, and the goal and the position of the follower's servo."""
        self.servo.step(self.clock())
        goal = self.servo.registers.get("goal_position")
        degrees = [math.degrees(self.joint.counts_to_angle(one)) for one in (goal, self.servo.motion.position)]
        since = self.clock() - self.began
        self.rows.append(_Row(since, self._angle(since), self._asked, *degrees))

    def follow(self, rate: float, seconds: float) -> None:
        """As `hexwire follow` does, its sleep shortened: the servo is looked at every millisecond."""

        def sleep(seconds: float) -> None:
            end = self.clock() + seconds
            while self.clock() < end:
                self.note()
                self.clock.advance(min(_LOOK, end - self.clock()))

        rules = following_rules(self.arm, self.arm, PathCheck.of(self.arm, None))
        controller = FollowController(rules, self.leader, self.clock, 1.0 / rate)
        owner = RobotOwner(
            self.arm, borrowed=True, command_rate=rate, sleep=sleep, read=BriefReader(self.arm), clock=self.clock
        )
        owner.group.members = (controller,)
        owner.connect()
        while self.clock() - self.began < seconds:
            owner.turn()
        release(self.arm, owner)

    def send(self, rate: float, seconds: float) -> None:
        """Send each position of the leader as it is."""
        bus, joint = self.arm.bus, self.joint
        bus.write_raw(joint.servo_id, "acceleration", 254)
        bus.write_raw(joint.servo_id, "goal_speed", 0)
        due = self.clock()
        while self.clock() - self.began < seconds:
            self.arm.read_positions()
            counts = joint.angle_to_counts(math.radians(self.asked()))
            bus.sync_write_bytes(42, {joint.servo_id: counts.to_bytes(2, "little")})
            due += 1.0 / rate
            while self.clock() < due:
                self.note()
                self.clock.advance(min(_LOOK, due - self.clock()))


_Way = Callable[[_Rig, float], None]
_WAYS: dict[str, _Way] = {
    "`hexwire follow --rate 60`": lambda rig, end: rig.follow(_LEROBOT_RATE, end),
    "`hexwire follow`": lambda rig, end: rig.follow(100.0, end),
    "goals as they come, 60 a second": lambda rig, end: rig.send(_LEROBOT_RATE, end),
}


def run() -> list[str]:
    """Measure; returns the lines of a table."""
    lines = ["| leader | behind | " + " | ".join(_WAYS) + " |", "|---|---|" + "---|" * len(_WAYS)]
    for hertz in _SINES:
        swings = [_sine(way, hertz) for way in _WAYS.values()]
        for place, what in enumerate(("goal", "arm")):
            cells = " | ".join(f"{one[place]:.1f} deg" for one in swings)
            lines.append(f"| {_AMPLITUDE:g} degrees to and fro at {hertz:g} Hz | {what}, at most | {cells} |")
    for name, places, near in (("jumps of 9 to 158 degrees", _large(), 1.5), ("steps of 4 counts", _small(), 0.2)):
        found = [_jumps(way, places, near) for way in _WAYS.values()]
        for place, what in enumerate(("its first goal", "the goal", "arm")):
            cells = " | ".join(f"{1000 * one[place]:.0f} ms" for one in found)
            lines.append(f"| {name} | {what}, p50 | {cells} |")
    return lines


def _sine(way: _Way, hertz: float) -> tuple[float, float]:
    """Most degrees by which goal and arm are behind, once it swings."""
    rig = _Rig(lambda t: _AMPLITUDE * math.sin(math.tau * hertz * max(0.0, t - 1.0)))
    way(rig, 1.0 + _PERIODS / hertz)
    late = [row for row in rig.rows if row.time > 1.0 + 2.0 / hertz]
    return max(abs(row.asked - row.goal) for row in late), max(abs(row.leader - row.arm) for row in late)


def _large() -> list[float]:
    """Places of a leader that jumps, degrees."""
    draw, place, found = random.Random(1), 0.0, list[float]()
    while len(found) < _JUMPS:
        there = draw.uniform(-85.0, 85.0)
        if _SMALLEST <= abs(there - place) <= _LARGEST:
            found.append(there)
            place = there
    return found


def _small() -> list[float]:
    return [_SMALL * (1 + number % 12) for number in range(_JUMPS)]


def _jumps(way: _Way, places: list[float], near: float) -> tuple[float, float, float]:
    """Median seconds from a jump to the next goal, to the one that is its place, and to the arm there."""
    between = _BETWEEN + 1.0 / 333.0
    rig = _Rig(lambda t: places[min(int((t - 1.0) / between), len(places) - 1)] if t > 1.0 else 0.0)
    way(rig, 1.0 + between * len(places))
    first, goal, arm = list[float](), list[float](), list[float]()
    for number, place in enumerate(places):
        since = 1.0 + number * between
        rows = [row for row in rig.rows if since <= row.time < since + between]
        before = next(row.goal for row in reversed(rig.rows) if row.time < since)
        first.append(next((row.time - since for row in rows if row.goal != before), math.inf))
        goal.append(next((row.time - since for row in rows if abs(row.goal - place) < _THERE), math.inf))
        arm.append(next((row.time - since for row in rows if abs(row.arm - place) < near), math.inf))
    return median(first), median(goal), median(arm)
