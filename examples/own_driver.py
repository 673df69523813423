"""A driver of one's own: a pan-tilt head, which is here only a pair of numbers that move.

    python examples/own_driver.py

Everything above a driver then works with it: path check, motions, `hexwire serve`, ROS, the studio. An entry point
in the package of the driver gives it a name for `--robot` (docs/adding-a-robot.md).
"""

import math
import time
from collections.abc import Sequence
from typing import Any, Self

import hexwire
from hexwire.control import run_motion
from hexwire.drivers.base import JointProbe, ProbeReport
from hexwire.errors import NotSupportedError, StoppedError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointFlag
from hexwire.motion.limits import check_target
from hexwire.wire.command_frame import Status

MODEL = ArmModel(
    "pantilt",
    tuple(
        JointModel(
            name=name, servo_id=servo, series="hobby", neutral=1500, sign=1, offset=0.0,
            scale=math.radians(0.1), minimum=-1.2, maximum=1.2, max_speed=2.0,
        )
        for servo, name in enumerate(("pan", "tilt"))
    ),
)  # fmt: skip


class PanTilt(hexwire.RobotDriver):
    """Two joints that move evenly to each target."""

    model = MODEL

    def __init__(self) -> None:
        super().__init__()
        self._open = self._power = False
        # From where, to where, from when, to when.
        self._way = dict.fromkeys(MODEL.names, (0.0, 0.0, 0.0, 0.0))

    @classmethod
    def from_url(cls, url: str, **options: Any) -> Self:
        """A real one would remember the URL; `attach` opens it."""
        return cls()

    @property
    def is_attached(self) -> bool:
        """Whether it is open."""
        return self._open

    def attach(self) -> None:
        """Open it."""
        self._open = True

    def detach(self, *, torque_off: bool = False) -> None:
        """Close it."""
        self._power = self._power and not torque_off
        self._open = False

    def probe(self) -> ProbeReport:
        """Say what it is."""
        return ProbeReport(
            robot=MODEL.name, link="", dialect=0, firmware="", boot_id=None, capabilities=(),
            stopped=self.epochs.stopped, counters=self.host_counters(),
            joints=tuple(JointProbe(j.name, j.servo_id, j.series, present=True) for j in MODEL.joints),
        )  # fmt: skip

    def _positions(self) -> dict[str, float]:
        def at(start: float, goal: float, begins: float, ends: float) -> float:
            share = (time.monotonic() - begins) / max(ends - begins, 1e-9)
            return start + (goal - start) * min(1.0, max(0.0, share))

        return {name: at(*way) for name, way in self._way.items()}

    def read(self) -> hexwire.JointState:
        """Where the joints are."""
        unknown = (math.nan,) * 2
        return hexwire.JointState(
            names=MODEL.names, position=tuple(self._positions().values()), velocity=unknown, load=unknown,
            current=unknown, voltage=unknown, temperature=unknown,
            flags=(int(JointFlag.TORQUE_ON) if self._power else 0,) * 2, age=(0.0, 0.0),
            stamp=self.now(), stopped=self.epochs.stopped,
        )  # fmt: skip

    def write(self, target: hexwire.JointTarget) -> hexwire.SentTarget:
        """Move; the target was asked for before any stop that came since."""
        here = self._positions()
        checked = check_target(MODEL, target, here)
        if self.epochs.stopped:
            raise StoppedError.unsent("a move", Status.STOPPED, "the arm is stopped; `resume()` ends that")
        now = time.monotonic()
        for name, angle in checked.positions:
            self._way[name] = (here[name], angle, now, now + checked.duration)
        return hexwire.SentTarget(checked.positions, checked.duration)

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        """Switch power; it has one switch for both joints."""
        self._power = on
        return MODEL.names

    def stop(self, mode: hexwire.StopMode = hexwire.StopMode.HOLD) -> tuple[str, ...]:
        """Hold where it is, and void everything asked before."""
        with self.epochs.stopping():
            self._way = {name: (angle, angle, 0.0, 0.0) for name, angle in self._positions().items()}
            self._power = self._power and mode is hexwire.StopMode.HOLD
        return MODEL.names

    def resume(self) -> None:
        """End the stop."""
        self.epochs.resumed(self.epochs.token("resume", freeing=True))

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        """There are no special commands."""
        raise NotSupportedError("a pan-tilt head has no special commands")


if __name__ == "__main__":
    with PanTilt() as head:
        result = run_motion(head, hexwire.JointTarget.of({"pan": 0.5, "tilt": -0.2}, duration=0.5))
        print(result.why or "there", {name: round(angle, 2) for name, angle in head.read().positions.items()})
        try:
            run_motion(head, hexwire.JointTarget.of({"pan": 2.0}))
        except hexwire.HexwireError as error:
            print("refused:", error)
