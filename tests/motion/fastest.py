"""Random motions that run at the limits of an arm, and whether a motion keeps these."""

from __future__ import annotations

import math
import random

from hexwire.model.arm import ArmModel
from hexwire.motion.speed_profile import JointLimits
from hexwire.motion.through import Through, arm_path
from hexwire.motion.trajectory import Sample, Trajectory

MOST = 1.001
STEP = 0.001


def fastest(draw: random.Random, arm: ArmModel) -> Through:
    """The fastest motion through some points."""
    joints = draw.sample(arm.joints, min(len(arm.joints), draw.choice((1, 2, 4, 7))))
    apart, rows = draw.choice((1.0, 0.3, 0.1)), [[draw.uniform(joint.minimum, joint.maximum) for joint in joints]]
    for _ in range(draw.choice((1, 2, 4))):
        row = []
        for angle, joint in zip(rows[-1], joints, strict=True):
            way = apart * draw.uniform(-1.0, 1.0) * (joint.maximum - joint.minimum)
            row.append(min(max(angle + way, joint.minimum), joint.maximum))
        rows.append(row)
    return arm_path(arm, [joint.name for joint in joints], rows)


def keeps(path: Trajectory, limits: list[JointLimits], before: Sample) -> bool:
    """Whether a trajectory keeps all limits at 1 kHz, and begins with the acceleration that there is."""
    for i in range(1, math.ceil(path.duration / STEP) + 2):
        sample = path.sample(i * STEP)
        for v, a, b, limit in zip(sample.velocity, sample.acceleration, before.acceleration, limits, strict=True):
            if abs(v) > MOST * limit.speed or abs(a) > MOST * limit.acceleration:
                return False
            if abs(a - b) > MOST * limit.jerk * STEP + 1e-6:
                return False
        before = sample
    return True
