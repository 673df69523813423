from __future__ import annotations

import math

import pytest
from tests.motion.arms import HOME

from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.motion.fence import Fence

A = Hex7BotModel()
SLACK = math.radians(0.5)


def posture(t1: float, t2: float) -> dict[str, float]:
    """Home but for servo angles of upper arm and forearm, degrees: from 150 and 120 on the elbow is folded."""
    return {**HOME, **A.to_joints([math.radians(d) for d in (90, t1, t2, 90, 90, 90)])}


def lowest(where: dict[str, float]) -> float:
    fence = Fence(A)
    fence.begin(where)
    fence.check(where)
    return fence.lowest


GOOD, FOLDED, DEEPER = posture(100, 120), posture(148, 120), posture(150, 120)
UP, LOW = posture(90, 110), posture(60, 155)


def test_each_kind_is_described_in_words() -> None:
    fence = Fence(A, lowest(LOW) + 0.01)
    fence.begin(UP)
    assert fence.check(GOOD) == {}
    assert fence.check(FOLDED)["coupling"].startswith("elbow folded")
    assert fence.check(LOW) == {
        "table": f"the tool would be 10.0 mm below the table at {1e3 * lowest(LOW) + 10:.0f} mm"
    }
    assert fence.check(UP) == {}


def test_where_an_arm_stays_it_may_not_be_further_in_than_it_is_now() -> None:
    fence, table = Fence(A, None), Fence(A, lowest(LOW) + 0.01)
    for here in (GOOD, FOLDED, DEEPER):
        assert fence.check_end(here, GOOD) == {}
    for here, there, wrong in ((GOOD, FOLDED, True), (FOLDED, FOLDED, False), (FOLDED, DEEPER, True)):
        assert bool(fence.check_end(here, there)) is wrong, (here, there)
    for here, there, wrong in ((UP, UP, False), (UP, LOW, True), (LOW, LOW, False), (LOW, UP, False)):
        assert bool(table.check_end(here, there)) is wrong, (here, there)
    with pytest.raises(UsageError, match="the position of J3 is unknown"):
        fence.check_end({**GOOD, "J3": math.nan}, GOOD)


def test_without_a_table_there_is_no_table_check() -> None:
    fence = Fence(A, None)
    fence.begin(UP)
    assert fence.check(LOW) == {}
    assert fence.lowest == lowest(LOW)


def test_an_arm_that_begins_outside_may_leave_but_not_go_deeper_or_come_back() -> None:
    fence = Fence(A)
    fence.begin(FOLDED)
    assert fence.check(FOLDED) == {}
    assert "coupling" in fence.check(DEEPER)
    assert fence.check(FOLDED) == {}, "what was refused does not count"
    assert fence.check(GOOD) == {}
    assert "coupling" in fence.check(FOLDED)
    table = lowest(LOW) + 0.05
    fence = Fence(A, table)
    fence.begin(LOW)
    assert fence.check(LOW) == {}
    assert fence.below.startswith("the arm would still be 50.0 mm below the table at ")
    assert fence.check(UP) == {}
    assert fence.below == ""
    assert "table" in fence.check(LOW)


@pytest.mark.parametrize(("depth", "plan", "moving"), [(0.001, False, True), (0.003, False, False)])
def test_an_arm_in_motion_has_a_little_more_room_than_a_plan(depth: float, plan: bool, moving: bool) -> None:
    for fence, good in (
        (Fence(A, lowest(LOW) + depth), plan),
        (Fence(A, lowest(LOW) + depth, moving=True), moving),
    ):
        fence.begin(UP)
        assert (fence.check(LOW) == {}) is good


def test_a_joint_without_a_position_disables_no_check() -> None:
    unknown = {**UP, "J2": math.nan}
    with pytest.raises(UsageError, match=r"^the position of J2 is unknown, so the path cannot be checked$"):
        Fence(A).begin(unknown)
    fence = Fence(A, lowest(LOW) + 0.01, moving=True)
    fence.begin(unknown)
    assert fence.check(unknown) == {}
    assert "coupling" in fence.check(FOLDED)
    assert "table" in fence.check(LOW)


def test_a_motion_is_watched_from_rest_to_rest() -> None:
    fence = Fence(A)
    assert fence.follow(GOOD, {}) == ""
    assert fence.follow(GOOD, {"J3": GOOD["J3"]}) == ""
    assert fence.follow(GOOD, {"J2": FOLDED["J2"]}).startswith("elbow folded")
    # Whoever has got there all the same may leave.
    fence.forget()
    assert fence.follow(FOLDED, {"J2": FOLDED["J2"] - 0.01}) == ""
    assert fence.follow(FOLDED, {"J2": GOOD["J2"]}) == ""
    assert fence.follow(FOLDED, {"J2": FOLDED["J2"]}).startswith("elbow folded")


def test_the_first_target_is_judged_like_any_other() -> None:
    fence = Fence(A)
    assert fence.follow(GOOD, {"J2": FOLDED["J2"]}).startswith("elbow folded")


def test_a_joint_that_holds_is_where_it_was_told_to_be() -> None:
    table = lowest(LOW) - 0.001
    fence = Fence(A, table, moving=True)
    up = {name: UP[name] for name in ("J2", "J3")}
    assert fence.follow(UP, up) == ""
    assert fence.follow(UP, {name: LOW[name] for name in up}) == ""
    # It has arrived and droops by 6 mm, while another joint goes on, and the gripper.
    droops = posture(60, 158)
    assert lowest(droops) < table - 0.003
    assert fence.follow(droops, {"J1": droops["J1"] + 0.01}) == ""
    assert fence.follow(droops, {"J7": 0.1}) == ""
    # Where nothing is told any more, where it is counts.
    fence.forget()
    assert fence.follow(UP, {"J1": UP["J1"]}) == ""
    assert "below the table" in fence.follow(droops, {"J1": UP["J1"]})


def test_an_arm_that_leans_on_the_table_sets_out_from_where_it_was_told_to_be() -> None:
    table = lowest(LOW) + 0.003
    fence = Fence(A, table, moving=True)
    low = {name: LOW[name] for name in ("J2", "J3")}
    assert fence.follow(LOW, low) == "", "it begins there"
    assert fence.follow(LOW, {}) == ""
    here = posture(60, 150)
    assert lowest(here) > table
    assert fence.follow(here, low) == ""
    assert fence.follow(here, {name: UP[name] for name in low}) == ""
    assert "below the table" in fence.follow(here, low)


def test_an_arm_beyond_a_limit_may_not_stay_deeper_than_before() -> None:
    here, deeper = FOLDED, posture(148.3, 120)
    fence = Fence(A)
    fence.begin(here)
    assert fence.check(deeper) == {}, "on its way out it may"
    assert "coupling" in fence.check_end(here, deeper), "but not to stay"
    assert fence.check_end(here, here) == {}
    assert fence.check_end(here, posture(147, 120)) == {}


def bent(degrees: float) -> dict[str, float]:
    """Folded beyond the joint coupling limit by some degrees."""
    return posture(140 + degrees, 120)


@pytest.mark.parametrize(("moving", "slack"), [(False, 0.0), (True, 0.5)])
def test_tolerances_at_the_joint_coupling_limit(moving: bool, slack: float) -> None:
    fence = Fence(A, None, moving=moving)
    fence.begin(GOOD)
    assert fence.check(bent(slack - 0.01)) == {}
    assert "coupling" in fence.check(bent(slack + 0.01))
    # Who begins outside may go half a degree further in, and the tolerance of a motion comes on top.
    for more, good in ((-0.01, True), (0.01, False)):
        fence.begin(bent(3.0))
        assert (fence.check(bent(3.5 + slack + more)) == {}) is good
    # What was once reached on the way out is the new limit.
    assert fence.check(bent(2.0)) == {}
    assert "coupling" in fence.check(bent(2.0 + slack + 0.01))
    assert fence.check(bent(2.0)) == {}


@pytest.mark.parametrize(
    ("moving", "slack", "two_higher", "too_high"), [(False, 0.0, 154.1, 154.0), (True, 0.002, 153.2, 153.1)]
)
def test_tolerances_at_the_table(moving: bool, slack: float, two_higher: float, too_high: float) -> None:
    for depth, good in ((slack - 0.0001, True), (slack + 0.0001, False)):
        fence = Fence(A, lowest(LOW) + depth, moving=moving)
        fence.begin(UP)
        assert (fence.check(LOW) == {}) is good
    # Who begins below it may go 2 mm deeper.
    for begin, good in ((two_higher, True), (too_high, False)):
        fence = Fence(A, 0.05, moving=moving)
        fence.begin(posture(60, begin))
        assert (fence.check(LOW) == {}) is good


def test_without_a_height_the_table_is_at_the_base() -> None:
    deep = posture(50, 160)
    assert lowest(deep) < 0 < lowest(LOW)
    fence = Fence(A)
    fence.begin(UP)
    assert fence.check(LOW) == {}
    assert fence.check(deep)["table"].endswith("below the table at 0 mm")
