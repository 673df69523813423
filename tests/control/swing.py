"""A leader that swings one joint to and fro, and its follower, for every front that lets one follow: simulated."""

from __future__ import annotations

import math
from dataclasses import replace

from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.model.state import JointState

AMPLITUDE, MET = 40.0, 1.0
"""Degrees, and seconds until it swings."""


class Swing:
    """Two arms; `sleep` lets time pass for whoever runs the loop, and ends it.

    Args:
        hertz: Of the leader.
        periods: After which it ends.

    Attributes:
        late: Most degrees by which the follower's goal was behind what its leader was asked for last.
    """

    def __init__(self, hertz: float, periods: float = 3.0) -> None:
        self.hertz, self.late = hertz, 0.0
        self.clock = FakeClock()
        self._ends = self.clock() + MET + periods / hertz
        self._begins = self.clock() + MET
        self.leader, _ = self._arm("serial:///leader", leader=True)
        self.follower, self._servo = self._arm("serial:///follower")
        self._read = self.leader.read_positions
        self.leader.read_positions = self._swung  # type: ignore[method-assign]
        self._joint = self.follower.model.joint("shoulder_pan")
        self._asked = 0.0

    def _arm(self, url: str, *, leader: bool = False) -> tuple[So101Arm, object]:
        made = make_bus_arm("so101", leader=leader, start=self.clock())
        link = BoardLink(BusDevice(made.servos, paced=True, host_baud=lambda: 1_000_000), self.clock)
        link.url = url
        return So101Arm(link), made.servos[0]

    def _swung(self, within: float = 0.0) -> JointState:
        state = self._read()
        self._asked = AMPLITUDE * math.sin(math.tau * self.hertz * max(0.0, state.stamp - self._begins))
        return replace(state, position=(math.radians(self._asked), *state.position[1:]))

    def sleep(self, seconds: float) -> None:
        """Let time pass; raises KeyboardInterrupt at the end."""
        if self.clock() > self._begins:
            counts = self._servo.registers.get("goal_position")  # type: ignore[attr-defined]
            self.late = max(self.late, abs(math.degrees(self._joint.counts_to_angle(counts)) - self._asked))
        if self.clock() > self._ends:
            raise KeyboardInterrupt
        self.clock.advance(seconds)
