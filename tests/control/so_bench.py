"""An emulated SO-101, anywhere in its range and in simulated time, on a bench for calibration."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.bus_arms import EmulatedArm, make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.serve import BoardLink
from hexwire.setup.calibrating import CalibrationBench, counting_arm

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


class SoBench:
    """The parts, by name.

    Args:
        seed: Of the horns, which are mounted anywhere.
        pose: Seed of the pose; folded if None.
        faults: Of the bus.
        echo: The adapter echoes.
        leader: A leader arm.
        any_horns: The horns are mounted anywhere; otherwise as in `hexwire sim bus --arm so101`.
    """

    def __init__(
        self,
        seed: int = 7,
        pose: int | None = None,
        *,
        faults: tuple[str, ...] = (),
        echo: bool = False,
        leader: bool = False,
        any_horns: bool = True,
    ) -> None:
        self.arm: EmulatedArm = make_bus_arm("so101", any_horns=any_horns, seed=seed, leader=leader)
        if pose is not None:
            draw = random.Random(pose)
            for servo in self.arm.servos:
                servo.motion.position = draw.uniform(*(servo.motion.stops or (0, 4095)))
        self.device = BusDevice(
            self.arm.servos, paced=True, host_baud=lambda: 1_000_000, faults=FaultPlan(faults), echo=echo
        )
        self.link = BoardLink(self.device)
        self.described = So101Arm.described()
        self.driver = So101Arm(self.link, arm=counting_arm(self.described))

    @contextmanager
    def attached(self) -> Iterator[CalibrationBench]:
        """The bench of an attached arm, its servos examined."""
        with self.driver:
            bench = CalibrationBench(self.driver, self.described)
            bench.examine()
            yield bench

    def sensor(self, name: str) -> tuple[float, float]:
        """The mechanical stops of a joint, counts of its sensor."""
        stops = self.arm.servos[NAMES.index(name)].motion.stops
        assert stops is not None
        return stops
