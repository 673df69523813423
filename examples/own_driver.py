"""A driver of your own: a pan-tilt head, which is here only a pair of numbers that move.

    python examples/own_driver.py

Everything above a driver then works with it: path check, motions, `hexwire serve`, ROS, the studio. An entry point
in the package of the driver gives it a name for `--robot` (docs/adding-a-robot.md).
"""

import hexwire


class PanTilt(hexwire.PlainDriver):
    """Two joints that move evenly to each target."""

    model = hexwire.ArmModel.of("pantilt", {"pan": (-1.2, 1.2), "tilt": (-0.6, 0.9)}, max_speed=2.0)

    def __init__(self) -> None:
        super().__init__()
        self._power = False
        # From where, to where, from when, to when.
        self._ways = dict.fromkeys(self.model.names, (0.0, 0.0, 0.0, 0.0))

    def on_read(self) -> hexwire.JointState:
        """Where the joints are now."""
        now = self.now()
        angles = {}
        for name, (start, goal, begins, ends) in self._ways.items():
            share = 1.0 if now >= ends else (now - begins) / (ends - begins)
            angles[name] = start + share * (goal - start)
        return hexwire.JointState.of(angles, stamp=now, torque=self._power)

    def on_target(self, target: hexwire.JointTarget) -> None:
        """Go there; the target is inside the limits, and its duration is long enough."""
        here = self.on_read()
        for name, goal in target.positions:
            self._ways[name] = (here.positions[name], goal, here.stamp, here.stamp + target.duration)

    def on_torque(self, on: bool, joints: tuple[str, ...]) -> None:
        """Switch power; one switch serves both joints."""
        self.on_hold()
        self._power = on

    def on_hold(self) -> None:
        """Stay where it is."""
        self._ways = {name: (angle, angle, 0.0, 0.0) for name, angle in self.on_read().positions.items()}


if __name__ == "__main__":
    with PanTilt() as driver:
        head = hexwire.Arm(driver)
        head.move(pan=0.5, tilt=-0.2)
        print("there", {name: round(angle, 2) for name, angle in head.read().positions.items()})
        try:
            head.move(pan=2.0)
        except hexwire.HexwireError as error:
            print("refused:", error)
