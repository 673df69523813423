"""Pick something up here and put it down there: python examples/pick_and_place.py [PORT]. For a Hex7Bot."""

import sys

import hexwire
from hexwire import mm

HERE, THERE = (mm(-80), mm(200)), (mm(80), mm(200))
ABOVE, AT = mm(140), mm(100)

with hexwire.connect(sys.argv[1] if len(sys.argv) > 1 else "sim://hex7bot") as arm:
    for place, before, after in ((HERE, 0.8, 0.2), (THERE, 0.2, 0.8)):
        arm.goto((*place, ABOVE), down=True, grip=before)
        arm.line(z=AT, down=True)
        arm.grip(after)
        arm.line(z=ABOVE, down=True)
        x, y, z = arm.tip.position
        print(f"tip at {1e3 * x:.0f} {1e3 * y:.0f} {1e3 * z:.0f} mm, gripper {after:.0%} open")
    arm.torque(False)
