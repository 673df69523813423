"""A calibrated SO-101 in simulated time, for devices of the plug-in: nothing depends on the machine."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from emulated import calibration_file
from lerobot_robot_hexwire import (
    HexwireSO101,
    HexwireSO101Config,
    HexwireSO101Leader,
    HexwireSO101LeaderConfig,
    connection,
    guides,
    robots,
)

from hexwire.drivers.arm_file import load_calibration
from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.emulator.servo import EmulatedServo
from hexwire.setup.calibrating import store

PERIOD = 1 / 60


class Sim:
    """A calibrated arm on a line in simulated time, for devices of the plug-in."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, leader: bool = False) -> None:
        self.leader = leader
        made = make_bus_arm("so101", leader=leader, seed=1)
        self.servos: list[EmulatedServo] = list(made.servos)
        self.link = BoardLink(BusDevice(self.servos, host_baud=lambda: 1_000_000), FakeClock())
        self.clock: FakeClock = self.link.clock
        self.on_sleep: Callable[[], object] = lambda: None
        time = SimpleNamespace(monotonic=self.clock, sleep=self.sleep)
        for module in (connection, guides, robots):
            monkeypatch.setattr(module, "time", time)
        file = calibration_file("simulated", leader=leader)
        with So101Arm(self.link) as arm:
            store(arm.bus, load_calibration(file))

    def sleep(self, seconds: float) -> None:
        self.clock.advance(seconds)
        self.on_sleep()

    def mute(self, *ids: int) -> None:
        """Let only these servos say nothing."""
        self.link.device.wire.servos = [servo for servo in self.servos if servo.servo_id not in ids]

    def device(self, **options: object) -> Any:
        if self.leader:
            device: Any = HexwireSO101Leader(HexwireSO101LeaderConfig(port="none", id="simulated", **options))
        else:
            device = HexwireSO101(HexwireSO101Config(port="none", id="simulated", **options))
        device._arm._link = self.link
        return device

    def read(self, device: Any) -> dict[str, float]:
        return device.get_action() if self.leader else device.get_observation()


def go(sim: Sim, robot: HexwireSO101, action: dict[str, float], seconds: float) -> dict[str, float]:
    """Send an action at 60 a second; returns what was sent last."""
    sent: dict[str, float] = {}
    for _ in range(round(seconds / PERIOD)):
        robot.get_observation()
        sent = robot.send_action(action)
        sim.clock.advance(PERIOD)
    return sent
