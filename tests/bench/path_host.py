"""One motion of a host program, for the benchmark: `python -m tests.bench.path_host MOTION WAY PORT...`.

Owns the motions that are measured, and running one of them. MOTION is swing, line or together; WAY is board or
host: who executes it. It prints a line when it is ready and goes on when it gets one. It prints another when it
moves, and one at the end, all as JSON.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import pairwise

from hexwire.control.loop.loop import RateLoop
from hexwire.control.loop.power import give_torque
from hexwire.control.loop.reader import read_state
from hexwire.control.motion.motion_options import MotionObserver, MotionOptions
from hexwire.control.motion.motions import run_motion
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.drivers.timed_path import TimedPoint
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for
from hexwire.model.kinematics import KinematicModel
from hexwire.model.pose import Pose
from hexwire.motion.checks import InJoints
from hexwire.motion.joined import Joined
from hexwire.motion.line import Line
from hexwire.motion.optimal import Trapezoid
from hexwire.motion.trajectory import Trajectory

LINE = ((-0.1, 0.2, 0.1), (0.1, 0.2, 0.1))
"""Ends of the straight line, metres."""
STARTS = 5
"""Times that two boards start together."""

_LEGS = 8
_REACH = math.radians(42.0)
_SPEED, _ACCELERATION = 2.0, 12.0
_TIP_SPEED, _TIP_ACCELERATION = 0.15, 0.6
_DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
_AHEAD = 0.5
_WATCHDOG = 3.0
"""Longer than a host is stopped here: a stop by the watchdog is right, and not what is measured."""


def kinematics() -> KinematicModel:
    """Of the arm."""
    model = kinematics_for(HEX7BOT)
    assert model is not None
    return model


def swing(start: Sequence[float], legs: int = _LEGS) -> Trajectory:
    """All joints to and fro about their middles, mostly at an even speed."""
    ends = [[joint.offset + way * _REACH for joint in HEX7BOT.joints] for way in (-1.0, 1.0)]
    corners = [list(start), *(ends[i % 2] for i in range(legs))]
    return Joined([Trapezoid(HEX7BOT.names, a, b, [_SPEED] * 7, [_ACCELERATION] * 7) for a, b in pairwise(corners)])


def straight() -> Trajectory:
    """The tip along `LINE`, tool down."""
    model = kinematics()
    begin = model.inverse(Pose(LINE[0], _DOWN))[0].angles
    line = Line(model, begin, Pose(LINE[1], _DOWN), speed=_TIP_SPEED, acceleration=_TIP_ACCELERATION)
    return InJoints(line, model)


class _Told(MotionObserver):
    def __init__(self, start: Sequence[float]) -> None:
        self._start = list(start)

    def started(self, timing: RateLoop) -> None:
        _say({"start": self._start})


def _say(what: dict[str, object]) -> None:
    print(json.dumps(what), flush=True)


def _move(robot: Hex7BotDriver, motion: str, way: str) -> None:
    options = MotionOptions(host_timed=way == "host", watchdog=_WATCHDOG)
    if motion == "line":
        path = straight()
        here = read_state(robot).positions
        first = Trapezoid(path.names, [here[name] for name in path.names], path.start, [1.0] * 6, [4.0] * 6)
        run_motion(robot, first, options)
        time.sleep(0.3)
    else:
        path = swing(list(read_state(robot).positions.values()))
    _say({})
    sys.stdin.readline()
    result = run_motion(robot, path, options, observer=_Told(path.start))
    _say({"timed": result.timed, "why": result.why})


def _together(robots: Sequence[Hex7BotDriver]) -> None:
    """Start a path of every robot at one time, again and again."""
    for robot in robots:
        give_torque(robot, ("J1",), read_state(robot))
    _say({})
    sys.stdin.readline()
    doubts = []
    for _ in range(STARTS):
        paths = []
        for robot in robots:
            here = read_state(robot).positions["J1"]
            path = robot.path(["J1"])
            points = [TimedPoint(0.1 * i, (here + 0.02 * i * (3 - i),), (0.2 * (3 - 2 * i),)) for i in range(4)]
            path.send(points, last=True)
            for _ in range(4):
                path.report()
            paths.append(path)
        at = robots[0].now() + _AHEAD
        doubts.append([path.start(at).uncertainty for path in paths])
        while not all(path.report().state.over for path in paths):
            time.sleep(0.02)
        time.sleep(0.2)
    _say({"doubt": max(map(max, doubts)), "why": ""})


def main(motion: str, way: str, *ports: str) -> None:
    """Run one motion."""
    with ExitStack() as stack:
        robots = [stack.enter_context(Hex7BotDriver.from_url(port)) for port in ports]
        if motion == "together":
            _together(robots)
        else:
            _move(robots[0], motion, way)


if __name__ == "__main__":
    main(*sys.argv[1:])
