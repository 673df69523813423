"""Samples which links of an arm touch, with Pinocchio and coal.

`python -m tests.ros2.package.sample_collisions` writes `collisions.toml`.

The geometry is read from the URDF, as MoveIt reads it. Joints are sampled within their limits, often at a limit.
Whether a posture is allowed by the joint coupling limit or the table is not asked: MoveIt knows neither.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
import pinocchio

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from hexwire.model.arms.hex7bot.links import LINK_SETS
from hexwire.model.urdf import make_urdf
from hexwire.ros2.package.arms import PackageArm, make_arm
from hexwire.ros2.package.collisions import SAMPLED, adjacent_pairs, table_key

FILE = Path(__file__).resolve().parents[3] / "src/hexwire/ros2/package/collisions.toml"
ARMS = (*(("hex7bot", links) for links in LINK_SETS), ("puma260", ""), ("so100", ""), ("so101", ""))
SAMPLES = 100_000
_AT_A_LIMIT = 0.2
Pair = tuple[str, str]


class Solids:
    """The solids of a URDF.

    Args:
        arm: Whose drives turn the joints, also those that follow others.
        text: The URDF.
    """

    def __init__(self, arm: PackageArm, text: str) -> None:
        self.model = pinocchio.buildModelFromXML(text)
        self.data = self.model.createData()
        self.geometry = pinocchio.buildGeomFromUrdfString(self.model, text, pinocchio.GeometryType.COLLISION)
        self.geometry.addAllCollisionPairs()
        self._drives = {joint.name: joint.drive for joint in arm.shapes.joints if joint.drive is not None}
        self.pairs: dict[Pair, list[int]] = {}
        for i, pair in enumerate(self.geometry.collisionPairs):
            one, other = sorted((self._link(pair.first), self._link(pair.second)))
            if one != other:
                self.pairs.setdefault((one, other), []).append(i)
        self._looked = self.geometry.createData()

    def only(self, pairs: Iterable[Pair]) -> None:
        """Look at these pairs from now on."""
        kept = set(pairs)
        self._looked = self.geometry.createData()
        for i in range(len(self.geometry.collisionPairs)):
            self._looked.deactivateCollisionPair(i)
        self.pairs = {pair: numbers for pair, numbers in self.pairs.items() if pair in kept}
        for numbers in self.pairs.values():
            for i in numbers:
                self._looked.activateCollisionPair(i)

    def touching(self, positions: Mapping[str, float]) -> set[Pair]:
        """The pairs that touch with the driver's joints at `positions`, radians; 0 for those that are not in it."""
        q = pinocchio.neutral(self.model)
        for name, drive in self._drives.items():
            angle = drive.multiplier * positions.get(drive.joint, 0.0) + drive.offset
            q[self.model.joints[self.model.getJointId(name)].idx_q] = angle
        if not pinocchio.computeCollisions(self.model, self.data, self.geometry, self._looked, q, False):
            return set()
        results = self._looked.collisionResults
        active = self._looked.activeCollisionPairs
        return {
            pair for pair, rows in self.pairs.items() if any(active[i] and results[i].isCollision() for i in rows)
        }

    def _link(self, number: int) -> str:
        return self.model.frames[self.geometry.geometryObjects[number].parentFrame].name


def postures(arm: PackageArm, count: int, seed: int) -> Iterable[dict[str, float]]:
    """Postures within the limits of the URDF."""
    random = np.random.default_rng(seed)
    rows = [(j.name, j.limits) for j in arm.shapes.joints if j.drive is not None and not j.follows]
    low, high = np.array([row[1][0] for row in rows]), np.array([row[1][1] for row in rows])
    for _ in range(count):
        share = random.uniform(size=len(rows))
        ends = random.uniform(size=len(rows))
        share = np.where(ends < _AT_A_LIMIT, np.round(share), share)
        yield {row[0]: float(q) for row, q in zip(rows, low + share * (high - low), strict=True)}


def home_of(arm: PackageArm) -> dict[str, float]:
    """The arm's home, with its gripper half open."""
    home = dict(next(pose for pose in arm.poses if pose.name == "home").positions)
    if arm.jaws is not None:
        home[arm.jaws.joint] = arm.jaws.angle(0.5)
    return home


def sampled(arm: PackageArm, count: int, seed: int) -> dict[str, list[Pair]]:
    """Pairs by reason, as in the file."""
    solids = Solids(arm, make_urdf(arm.kinematics))
    near = adjacent_pairs(arm.shapes)
    at_home = solids.touching(home_of(arm))
    always = set(solids.pairs) - near
    never = set(solids.pairs) - near
    solids.only(never)
    looked = set(never)
    for posture in postures(arm, count, seed):
        found = solids.touching(posture)
        always &= found
        never -= found
        if looked - always - never:
            # Pairs that sometimes touch are decided.
            looked = always | never
            solids.only(looked)
    default = {pair for pair in at_home - near if pair not in always}
    return {reason: sorted(pairs) for reason, pairs in zip(SAMPLED, (always, default, never), strict=True) if pairs}


def main() -> None:
    """Write the file."""
    rows = [
        f"# Pairs of links by reason, from {SAMPLES} random postures of each arm and link set. Written by",
        "# tests/ros2/package/sample_collisions.py; do not edit.",
    ]
    for robot, links in ARMS:
        rows += ["", f'["{table_key(robot, links)}"]']
        for reason, pairs in sampled(make_arm(robot, links or "A"), SAMPLES, seed=17).items():
            rows += [f"{reason} = [", *(f'    ["{one}", "{other}"],' for one, other in pairs), "]"]
    FILE.write_text("\n".join([*rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
