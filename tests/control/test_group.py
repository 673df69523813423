from __future__ import annotations

import math
import threading

import pytest
from tests.motion.arms import NAMES, state

from hexwire.control.loop.controller import TrajectoryController
from hexwire.control.loop.group import ControllerGroup
from hexwire.control.loop.outcomes import Ended, Outcome
from hexwire.control.motion.arrival import Tolerance
from hexwire.control.motion.goals import Point, Tolerances, TrajectoryGoal
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.settings import ControllerSettings
from hexwire.errors import GoalError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.state import JointFlag, JointTarget
from hexwire.motion.safety import SafetyLimits, StopReason

STILL = [0.0] * 7


class Told:
    """A goal that looks whether the lock is free when it is told."""

    def __init__(self, group: ControllerGroup) -> None:
        self.group = group
        self.ends: list[Ended] = []
        self.was_free: list[bool] = []

    def ended(self, ended: Ended) -> None:
        self.ends.append(ended)

        def look() -> None:
            free = self.group.lock.acquire(blocking=False)
            self.was_free.append(free)
            if free:
                self.group.lock.release()

        thread = threading.Thread(target=look)
        thread.start()
        thread.join(30)


def make_group() -> ControllerGroup:
    members = []
    for name, joints in (("arm", NAMES[:4]), ("wrist", NAMES[4:])):
        none = {joint: Tolerance() for joint in joints}
        settings = ControllerSettings(name, joints, True, Tolerances(none, none, 0.0))
        members.append(
            TrajectoryController(settings, HEX7BOT, SafetyLimits(), check=PathCheck.limits_only(HEX7BOT))
        )
    return ControllerGroup(tuple(members))


def go(group: ControllerGroup, which: int, joint: str, by: float, now: float = 0.0) -> Told:
    told = Told(group)
    here = state(stamp=now)
    order = TrajectoryGoal((joint,), (Point(2.0, (here[joint].position + by,)),))
    controller = group.members[which]
    controller.accept(controller.plan(order, now), here, now, listener=told)
    return told


def test_no_controllers_do_nothing() -> None:
    group = ControllerGroup()
    assert group.cycle(state(), STILL, 0.0, 0.1, due=True) is None
    assert (group.busy, group.moving, group.reason, group.blamed) == (False, False, None, frozenset())
    group.stop(StopReason("asked", "a test"))
    group.release("a test")
    assert group.reset(group.epochs.mark())


def test_targets_of_all_controllers_are_one() -> None:
    group = make_group()
    go(group, 0, "J1", 0.1)
    go(group, 1, "J5", 0.1)
    assert (group.busy, group.moving) == (True, True)
    order = group.cycle(state(), STILL, 0.0, 0.1, due=True)
    assert isinstance(order, JointTarget)
    assert [name for name, _ in order.positions] == list(NAMES)
    assert order.duration == 0.1


def test_states_are_judged_even_if_no_target_is_due() -> None:
    group = make_group()
    go(group, 0, "J1", 0.1)
    assert group.cycle(state(stamp=0.01), STILL, 0.01, 0.1, due=False) is None
    assert group.members[0].progress is not None


def test_a_goal_is_told_of_its_end_outside_the_lock() -> None:
    group = make_group()
    told = go(group, 0, "J1", 0.0)
    for i in range(60):
        group.cycle(state(stamp=0.05 * i), STILL, 0.05 * i, 0.1, due=True)
    assert [end.outcome for end in told.ends] == [Outcome.SUCCEEDED]
    assert told.was_free == [True]


def test_a_listener_that_fails_keeps_nobody_from_the_end(caplog: pytest.LogCaptureFixture) -> None:
    group = make_group()
    failing, other = go(group, 0, "J1", 0.3), go(group, 1, "J5", 0.3)

    def fail(ended: object) -> None:
        raise RuntimeError("a client failed")

    failing.ended = fail  # type: ignore[method-assign]  # what a front gives may do anything
    group.stop(StopReason("asked", "a test"))
    assert other.ends
    assert "a client failed" in caplog.text


def test_a_stop_of_one_is_a_stop_of_all() -> None:
    group = make_group()
    first, second = go(group, 0, "J1", 0.1), go(group, 1, "J5", 0.1)
    group.cycle(state(), STILL, 0.0, 0.1, due=True)
    bad = state(flags={"J6": JointFlag.TORQUE_ON | JointFlag.OVERLOAD}, stamp=0.05)
    reason = group.cycle(bad, STILL, 0.05, 0.1, due=True)
    assert isinstance(reason, StopReason)
    assert (reason.kind, reason.joint) == ("fault", "J6")
    assert group.reason == reason
    assert group.blamed == {"J6"}
    for told in (first, second):
        assert [end.text for end in told.ends] == ["stopped: J6 reports overload"]
        assert told.was_free == [True]
    assert not group.moving
    # It is told once.
    assert group.cycle(bad, STILL, 0.1, 0.1, due=True) is None
    with pytest.raises(GoalError, match="J6 reports overload"):
        go(group, 0, "J1", 0.1)
    assert group.reset(group.epochs.mark())
    assert not group.blamed
    go(group, 0, "J1", 0.1)


def test_a_reset_ends_no_stop_but_those_it_was_asked_for() -> None:
    group = make_group()
    group.stop(StopReason("asked", "first"))
    asked = group.epochs.mark()
    group.stop(StopReason("asked", "second"))
    assert not group.reset(asked)
    assert group.reason is not None
    assert group.reset(group.epochs.mark())
    assert group.reason is None


def test_a_release_of_some_joints_leaves_other_controllers_alone() -> None:
    group = make_group()
    first, second = go(group, 0, "J1", 0.1), go(group, 1, "J5", 0.1)
    group.release("no torque", ["J6"])
    assert [end.text for end in second.ends] == ["no torque"]
    assert second.was_free == [True]
    assert not first.ends
    group.release("nothing holds")
    assert [end.text for end in first.ends] == ["nothing holds"]
    assert not group.busy


def test_joints_of_two_that_fold_the_arm_together_stop_it() -> None:
    members = []
    for name, joints in (("upper", ("J1", "J2")), ("fore", NAMES[2:])):
        none = {joint: Tolerance() for joint in joints}
        settings = ControllerSettings(name, joints, True, Tolerances(none, none, 0.0))
        members.append(
            TrajectoryController(settings, HEX7BOT, SafetyLimits(), check=PathCheck.limits_only(HEX7BOT))
        )
    group = ControllerGroup(tuple(members))
    group.check = PathCheck(HEX7BOT, Hex7BotModel(), None)
    told = [go(group, 0, "J2", math.radians(60)), go(group, 1, "J3", math.radians(40))]
    where: dict[str, float] = {}
    now, order = 0.0, group.cycle(state(), STILL, 0.0, 0.1, due=True)
    while isinstance(order, JointTarget):
        where.update(order.positions)
        now += 0.05
        assert group.cycle(state(where, stamp=now - 0.025), STILL, now - 0.025, 0.1, due=False) is None
        order = group.cycle(state(where, stamp=now), STILL, now, 0.1, due=True)
    assert isinstance(order, StopReason)
    assert order.kind == "fence"
    assert order.text.startswith("elbow folded")
    assert 1.0 < now < 2.0
    assert [t.ends[0].outcome for t in told] == [Outcome.ABORTED] * 2
    assert group.reason == order
    assert group.cycle(state(where, stamp=now), STILL, now, 0.1, due=True) is None


def test_every_stop_is_counted() -> None:
    group = make_group()
    for count in range(3):
        assert group.epochs.number == count
        group.stop(StopReason("asked", "enough"))
    assert str(group.reason) == "enough"


def test_the_longest_duration_is_that_of_all() -> None:
    class Fixed:
        joints: tuple[str, ...]
        busy = moving = False
        reason = None

        def __init__(self, name: str, duration: float) -> None:
            self.joints, self.duration = (name,), duration
            self.heard: list[object] = []

        def judge(self, *values: object) -> None:
            self.heard.append(values)

        def cycle(self, *_: object) -> JointTarget:
            return JointTarget.of({self.joints[0]: 0.1}, self.duration)

        def take_ended(self) -> list[object]:
            return []

    first, second = Fixed("J1", 0.3), Fixed("J2", 0.1)
    group = ControllerGroup((first, second))  # type: ignore[arg-type]  # as much of a controller as is asked
    here = state()
    order = group.cycle(here, STILL, 1.0, 0.1, due=True)
    assert order == JointTarget((("J1", 0.1), ("J2", 0.1)), 0.3)
    assert group.cycle(here, STILL, 1.1, 0.1, due=False) is None
    assert first.heard == second.heard == [(here, STILL, 1.0), (here, STILL, 1.1)]
