"""Kinematics of one pose in pure Python, and of many through numpy; the inverse gives all eight branches."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable

from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.arms.puma260.kinematics import Puma260Model
from hexwire.model.kinematics import KinematicModel

_ONE = 2000
_MANY = 50_000


def _seconds(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def _measure(model: KinematicModel) -> list[str]:
    rng = random.Random(1)
    angles = [[rng.uniform(-math.pi, math.pi) for _ in range(6)] for _ in range(_MANY)]
    few = angles[:_ONE]
    poses = [model.forward(q) for q in few]
    one = _seconds(lambda: [model.forward(q) for q in few]) / _ONE
    back = _seconds(lambda: [model.inverse(p) for p in poses]) / _ONE
    positions, rotations = model.forward_many(angles)
    many = _seconds(lambda: model.forward_many(angles)) / _MANY
    many_back = _seconds(lambda: model.inverse_many(positions, rotations)) / _MANY
    rows = (("forward", one, many), ("inverse", back, many_back))
    return [
        f"{model.name:8} {name} {1e6 * single:6.1f} us a pose, {1e6 * each:5.2f} us of many ({single / each:.0f} x)"
        for name, single, each in rows
    ]


def run() -> list[str]:
    """Measure; returns the lines to print."""
    return [*_measure(Hex7BotModel()), *_measure(Puma260Model())]
