"""Whether an arm is at rest, and how far off its goal it came to rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import pytest
from tests.motion.arms import HOME

from hexwire.control.motion.rest import Rest, come_to_rest, rest_in_words
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for
from hexwire.model.state import JointFlag

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.kinematics import KinematicModel


class Settling:
    """A robot whose joint comes to rest after some reads; its clock runs while somebody waits.

    Its states are sampled when they are read, or else at these times.
    """

    def __init__(
        self, *positions: float, others: dict[str, float] | None = None, sampled: Sequence[float] = ()
    ) -> None:
        self.left, self.others, self.sampled = list(positions), others or {}, sampled
        self.reads, self.time = 0, 0.0
        self.kinematics: KinematicModel | None = None

    def read(self) -> Any:
        self.reads += 1
        angle = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        positions = self.others | {"J1": angle}
        age = self.time - self.sampled[self.reads - 1] if self.sampled else 0.0
        return SimpleNamespace(
            names=tuple(positions),
            positions=positions,
            position=tuple(positions.values()),
            age=(age,) * len(positions),
            stamp=self.time,
            flags=(0,) * len(positions),
        )

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def rest(self, goal: dict[str, float], **how: Any) -> Rest:
        return come_to_rest(cast("RobotDriver", self), goal, clock=lambda: self.time, sleep=self.sleep, **how)


def test_how_far_off_it_is_counts_when_the_arm_is_at_rest() -> None:
    robot = Settling(0.0, 0.02, 0.03, 0.0301)
    assert robot.rest({"J1": 0.0}) == Rest("J1", 0.0301, None, (("J1", 0.0301),))
    assert robot.reads == 4


def test_states_of_the_same_time_do_not_say_that_it_is_at_rest() -> None:
    """A server that stalled sends several at once; of a servo that is silent only the old position is known."""
    robot = Settling(0.0, 0.02, 0.02, 0.0201, 0.03, 0.03, sampled=[0.0, 0.05, 0.05, 0.06, 0.20, 0.25])
    assert robot.rest({"J1": 0.0}) == Rest("J1", 0.03, None, (("J1", 0.03),))
    assert robot.reads == 6


@pytest.mark.parametrize(
    ("age", "flag", "where"),
    [
        pytest.param(math.nan, 0, 0.0, id="a robot that does not know ages"),
        pytest.param(math.inf, JointFlag.SILENT, math.nan, id="a servo that never answered"),
        pytest.param(None, JointFlag.SILENT, 0.0, id="a servo that has fallen silent"),
    ],
)
def test_what_will_not_be_known_is_not_waited_for(age: float | None, flag: int, where: float) -> None:
    class Partly(Settling):
        def read(self) -> Any:
            state = super().read()
            # Since the beginning, if it has fallen silent.
            ages = (self.time if age is None else age, 0.0)
            return SimpleNamespace(**vars(state) | {"age": ages, "flags": (int(flag), 0)})

    robot = Partly(0.0, 0.1, 0.1, others={"J2": where})
    robot.rest({"J1": 0.1})
    assert robot.reads == 3


def test_a_joint_that_never_rests_is_not_waited_for_long() -> None:
    robot = Settling(*[0.01 * i for i in range(1000)])
    robot.rest({"J1": 0.0})
    assert robot.reads == 13
    assert robot.time == pytest.approx(0.6)


def test_the_worst_joint_is_named_and_the_tip_measured() -> None:
    model = kinematics_for(HEX7BOT)
    assert model is not None
    where = HOME | {"J2": HOME["J2"] - 0.014, "J7": 0.1}
    robot = Settling(HOME["J1"], others=where)
    robot.kinematics = model
    rest = robot.rest({"J1": HOME["J1"], "J2": HOME["J2"]})
    assert (rest.joint, rest.off) == ("J2", pytest.approx(0.014))
    tips = [model.forward(model.from_joints(angles)).position for angles in (where, HOME)]
    assert rest.tip == pytest.approx(math.dist(*tips))
    assert rest.tip > 0.001


def test_an_unknown_position_is_the_worst() -> None:
    model = kinematics_for(HEX7BOT)
    robot = Settling(HOME["J1"] + 0.5, others=HOME | {"J4": math.nan})
    robot.kinematics = model
    rest = robot.rest({"J1": HOME["J1"], "J4": 0.0})
    assert rest.joint == "J4"
    assert math.isnan(rest.off)
    assert rest.tip is None
    assert Settling(0.0).rest({"J1": 0.0, "J9": 0.0}).joint == "J9"


@pytest.mark.parametrize(
    ("angles", "others", "words", "seconds"),
    [
        ((0.0, 0.2, 0.2001), {}, "at rest", 0.1),
        (tuple(0.1 * i for i in range(20)), {}, "J1 still moves after 0.3 s", 0.3),
        (tuple(0.1 * i for i in range(20)), {"J2": math.nan}, "J2, J1 still move after 0.3 s", 0.3),
    ],
)
def test_after_a_stop_it_says_whether_the_joints_are_at_rest(
    angles: tuple[float, ...], others: dict[str, float], words: str, seconds: float
) -> None:
    robot = Settling(*angles, others=others)
    assert rest_in_words(robot.read, 0.3, clock=lambda: robot.time, sleep=robot.sleep) == words
    assert robot.time == pytest.approx(seconds)


def test_without_new_states_nobody_knows_whether_the_joints_are_at_rest() -> None:
    robot = Settling(0.0)
    old = robot.read()
    said = rest_in_words(lambda: old, 0.3, clock=lambda: robot.time, sleep=robot.sleep)
    assert said == "no news of where they are for 0.3 s"
