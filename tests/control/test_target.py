from __future__ import annotations

import math
from typing import Any

import pytest
from tests.motion.arms import HOME, NAMES, state

from hexwire.control.loop.target import TargetController
from hexwire.control.motion.arrival import Tolerance
from hexwire.model.state import JointFlag, JointTarget, SentTarget
from hexwire.motion.quintic import quintic_share
from hexwire.motion.safety import StopReason

GOAL = {"J1": HOME["J1"] + 0.3}
STILL = (0.0,) * len(NAMES)


def make(seconds: float = 1.0, **options: Any) -> TargetController:
    given: dict[str, Any] = {"grace": 0.5} | options
    here = given.pop("here", HOME)
    return TargetController(JointTarget.of(GOAL, seconds), here, {"J1": Tolerance(0.02)}, **given)


def write(controller: TargetController, now: float, **what: Any) -> JointTarget | None:
    """A cycle, and what a board makes of its target."""
    target = controller.cycle(state(stamp=now), now, 0.075)
    if target is not None:
        controller.was_sent(SentTarget(target.positions, target.duration, **what))
    return target


def see(controller: TargetController, now: float, j1: float, **what: Any) -> bool:
    controller.judge(state({"J1": j1}, stamp=now, **what), STILL, now)
    return controller.over


def test_it_is_written_once_and_judged_from_then_on() -> None:
    controller = make()
    assert not controller.moving
    assert write(controller, 10.0) == JointTarget.of(GOAL, 1.0)
    assert write(controller, 10.05) is None
    assert controller.moving
    assert not see(controller, 10.5, HOME["J1"] + 0.1)
    assert see(controller, 10.6, HOME["J1"] + 0.29), "as early as it is there"
    assert controller.arrived
    assert not controller.moving


def test_without_early_it_must_be_there_when_its_time_is_over() -> None:
    controller = make(early=False)
    write(controller, 10.0)
    assert not see(controller, 10.9, GOAL["J1"])
    assert see(controller, 11.0, GOAL["J1"])
    assert controller.arrived


def test_joints_that_did_not_arrive_are_named_after_the_grace_time() -> None:
    controller = make()
    write(controller, 10.0)
    assert not see(controller, 11.0, HOME["J1"])
    assert not see(controller, 11.5, HOME["J1"])
    assert see(controller, 11.6, HOME["J1"])
    assert not controller.arrived
    assert [(row.joint, row.by) for row in controller.off] == [("J1", pytest.approx(0.3))]


def test_an_arm_that_does_not_say_where_it_is_has_not_arrived() -> None:
    controller = make()
    write(controller, 10.0)
    assert not see(controller, 11.0, math.nan)
    assert see(controller, 11.6, math.nan)
    assert not controller.arrived
    assert controller.off[0].by == math.inf


def test_steps_lead_there_on_a_straight_line() -> None:
    controller = make(step=0.25)
    places = []
    for i in range(6):
        target = write(controller, 10.0 + 0.25 * i, silent=("J1",) if i == 1 else ())
        if target is not None:
            places.append((target.positions[0][1] - HOME["J1"], target.duration))
    # Slowly at both ends: a share of 10 u^3 - 15 u^4 + 6 u^5 after a share u of the time.
    assert places == [
        (pytest.approx(0.3 * (10 / 4**3 - 15 / 4**4 + 6 / 4**5)), 0.375),
        (pytest.approx(0.15), 0.375),
        (pytest.approx(0.3 * (1.0 - (10 / 4**3 - 15 / 4**4 + 6 / 4**5))), 0.375),
        (pytest.approx(0.3), 0.375),
        (pytest.approx(0.3), 0.25),
    ]
    assert controller.sent is not None
    assert (controller.sent.duration, controller.sent.silent) == (1.0, ("J1",))


def test_steps_of_a_long_target_are_as_much_slower() -> None:
    controller = make(2.0, step=0.25)
    targets = [write(controller, 10.0 + 0.25 * i) for i in range(8)]
    places = [target.positions[0][1] - HOME["J1"] for target in targets if target is not None]
    assert places == pytest.approx([0.3 * quintic_share((i + 1) / 8) for i in range(8)])


def test_a_joint_of_unknown_position_is_sent_to_its_end() -> None:
    controller = make(step=0.25, here={**HOME, "J1": math.nan})
    target = write(controller, 10.0)
    assert target is not None
    assert target.positions == (("J1", GOAL["J1"]),)


@pytest.mark.parametrize(
    ("what", "limp", "reason"),
    [
        ({"flags": {"J1": JointFlag(0)}}, ("J1",), None),
        ({"stopped": True}, (), "a stop command has stopped the arm"),
    ],
)
def test_lost_torque_and_a_stop_end_it(what: dict[str, Any], limp: tuple[str, ...], reason: str | None) -> None:
    controller = make()
    write(controller, 10.0)
    assert see(controller, 10.2, HOME["J1"], **what)
    assert controller.without_torque == limp
    assert (str(controller.reason) if controller.reason else None) == reason
    assert not controller.arrived


def test_a_stop_keeps_the_rest_from_being_sent() -> None:
    controller = make(step=0.25)
    write(controller, 10.0)
    controller.stop(StopReason("asked", "enough"))
    controller.stop(StopReason("asked", "again"))
    controller.reset()
    assert write(controller, 10.25) is None
    assert str(controller.reason) == "enough"
    assert (controller.busy, controller.moving, controller.take_ended()) == (False, False, [])


def test_a_target_that_is_over_sends_and_judges_nothing() -> None:
    controller = make()
    write(controller, 10.0)
    assert see(controller, 10.5, GOAL["J1"])
    assert controller.arrived
    controller.stop(StopReason("asked", "too late"))
    assert controller.reason is None
    assert write(controller, 10.6) is None
    see(controller, 99.0, HOME["J1"])
    assert controller.arrived
    assert controller.off == ()
    released = make()
    write(released, 10.0)
    released.release("a hand")
    assert (released.over, released.arrived, released.reason) == (True, False, None)
    assert write(released, 10.1) is None


def test_its_time_is_what_the_board_makes_of_it() -> None:
    controller = make(early=False)
    assert controller.joints == ("J1",)
    assert (controller.busy, controller.moving, controller.sent) == (True, False, None)
    assert not see(controller, 10.0, GOAL["J1"]), "nothing was sent yet"
    target = controller.cycle(state(stamp=10.0), 10.0, 0.075)
    assert target is not None
    controller.was_sent(SentTarget(target.positions, 3.0, clamped=("J1",)))
    assert not see(controller, 12.9, GOAL["J1"])
    assert see(controller, 13.0, GOAL["J1"])
    assert controller.sent == SentTarget(target.positions, 3.0, ("J1",), ())


def test_the_last_step_is_judged_from_when_it_is_sent() -> None:
    controller = make(step=0.25, early=False)
    for i in range(4):
        write(controller, 10.0 + 0.25 * i)
        assert not see(controller, 10.0 + 0.25 * i, GOAL["J1"])
        assert controller.sent is None
    write(controller, 11.0)
    assert controller.sent is not None
    assert see(controller, 11.0, GOAL["J1"])


def test_an_old_sample_is_no_arrival() -> None:
    controller = make(early=False)
    write(controller, 10.0)
    assert not see(controller, 11.1, GOAL["J1"], age={"J1": 0.2})
    assert see(controller, 11.2, GOAL["J1"], age={"J1": 0.1, "J2": 9.0})
    assert controller.arrived


def test_it_waits_until_it_may_go() -> None:
    controller = make(waits=True)
    assert write(controller, 10.0) is None
    assert not controller.moving
    controller.go()
    assert write(controller, 10.1) == JointTarget.of(GOAL, 1.0)


def test_on_a_path_of_the_robot_nothing_is_written_and_the_arrival_is_judged() -> None:
    controller = make(waits=True, early=False)
    controller.on_path(SentTarget(tuple(GOAL.items()), 1.0), 10.2)
    assert controller.moving
    assert write(controller, 10.5) is None
    assert not see(controller, 11.1, GOAL["J1"])
    assert see(controller, 11.2, GOAL["J1"])
    assert (controller.arrived, controller.ended) == (True, "")


def test_a_path_that_is_cut_short_leaves_time_for_a_last_look() -> None:
    controller = make(waits=True)
    controller.on_path(SentTarget(tuple(GOAL.items()), 9.0), 10.0)
    assert not see(controller, 12.0, HOME["J1"] + 0.1)
    controller.cut("the board was reset", 12.0)
    controller.cut("something else", 12.1)
    assert not see(controller, 12.1, HOME["J1"] + 0.1)
    assert see(controller, 12.5, HOME["J1"] + 0.1)
    assert (controller.arrived, controller.ended, controller.reason) == (False, "the board was reset", None)
    assert [row.joint for row in controller.off] == ["J1"]
    controller = make(waits=True)
    controller.on_path(SentTarget(tuple(GOAL.items()), 9.0), 10.0)
    controller.cut("a joint lost its torque", 12.0)
    assert see(controller, 12.1, HOME["J1"], flags={"J1": JointFlag(0)})
    assert controller.without_torque == ("J1",)
