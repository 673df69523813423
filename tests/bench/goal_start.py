"""How soon after the acceptance of a goal its first byte goes to the line.

A served board in a process of its own behind a pseudo-terminal; arm and goals in this process, with their threads,
as in the nodes of ROS.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from tests.bench.board import board
from tests.motion.arms import HOME

from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.requests.client_goals import ClientGoals, ClientRequest
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.wire.command_frame import Command, parse_frame

__all__ = ["goal_starts"]

_PATIENCE = 30.0
_FIRST = (Command.JOINT_MOVE, Command.TRAJECTORY_BEGIN)


class _Client:
    """Waits for the end of its goal."""

    def __init__(self) -> None:
        self.over, self.why = threading.Event(), ""

    def accepted(self) -> None:
        """Nothing to do."""

    def refused(self, reason: Reason, text: str) -> None:
        self.why = text
        self.over.set()

    def ended(self, ended: Ended) -> None:
        self.why = "" if ended.outcome is Outcome.SUCCEEDED else ended.text
        self.over.set()


def goal_starts(count: int, *, at_once: bool = True, **settings: Any) -> list[float]:
    """Seconds from the acceptance of each goal to its first byte on the line.

    Args:
        count: Goals.
        at_once: As it is; else the first byte waits for the next state, for comparison.
        **settings: Of the arm.
    """
    with board() as (path, _):
        given = {"port": path, "check_table": False, "allow_partial_joints_goal": True, **settings}
        read, robot = read_settings(given, Faults())
        arm = ControlledArm(robot, read)
        arm.connect()
        arm.start()
        goals: ClientGoals[_Client] = ClientGoals(arm, answer_after=0.0, end_after=0.0)
        goals.start()
        try:
            arm.enable(True)
            if not at_once:
                arm.owner.begin_at_once = arm.owner.hurry  # type: ignore[method-assign]
            return _measure(arm, goals, count)
        finally:
            arm.shutdown()
            goals.close()


def _measure(arm: ControlledArm, goals: ClientGoals[_Client], count: int) -> list[float]:
    (controller,) = arm.controllers.values()
    accept, accepted, left = controller.accept, list[float](), list[tuple[float, int]]()

    def accept_noted(*args: Any, **named: Any) -> None:
        accept(*args, **named)
        accepted.append(time.monotonic())

    controller.accept = accept_noted  # type: ignore[method-assign]
    link = arm.owner.robot.session.ipc.link  # type: ignore[attr-defined]  # a board has a session
    for name in ("write", "exchange"):
        _note_calls(link, name, left)
    for i in range(count):
        client = _Client()
        goal = TrajectoryGoal(("J1",), (Point(0.3, (HOME["J1"] + 0.05 * (i % 2),)),))
        # Anywhere between two states, not always just after one.
        time.sleep(0.05 + 0.0013 * (i % 8))
        goals.send("", str(i), client, lambda goal=goal: ClientRequest(goal))  # type: ignore[misc]
        if not client.over.wait(_PATIENCE) or client.why:
            raise RuntimeError(f"goal {i}: {client.why or 'it does not end'}")
    return [next(when for when, cmd in left if when >= at and cmd in _FIRST) - at for at in accepted]


def _note_calls(link: Any, name: str, left: list[tuple[float, int]]) -> None:
    call = getattr(link, name)

    def noted(data: bytes, *args: Any) -> Any:
        left.append((time.monotonic(), parse_frame(data).cmd))
        return call(data, *args)

    setattr(link, name, noted)
