from __future__ import annotations

import math

import pytest

from hexwire.errors import LimitError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel
from hexwire.model.pose import Pose
from hexwire.motion.checks import InJoints, check_move, check_trajectory
from hexwire.motion.line import Line
from hexwire.motion.trajectory import Sample, Spline, Waypoint

A = Hex7BotModel()
NEUTRAL = {joint.name: joint.offset for joint in HEX7BOT.joints}


def through(*degrees: tuple[float, ...], seconds: float = 2.0) -> Spline:
    """Servo angles t0..t5 in degrees, evenly spaced in time."""
    points = [
        Waypoint(seconds * i, tuple(A.to_joints([math.radians(d) for d in row]).values()))
        for i, row in enumerate(degrees)
    ]
    return Spline(HEX7BOT.names[:6], points)


HOME = (90, 90, 90, 90, 90, 90)


def test_a_good_trajectory_passes() -> None:
    report = check_trajectory(through(HOME, (100, 110, 90, 90, 60, 90), HOME), HEX7BOT, A)
    assert report.findings == ()
    assert report.require() is report
    assert report.duration == 4.0
    assert report.peak_speed["J2"] == pytest.approx(math.radians(10))
    assert report.lowest == pytest.approx(0.19, abs=0.02)


def test_every_kind_is_found_with_its_time_before_anything_moves() -> None:
    report = check_trajectory(through(HOME, (180, 90, 90, 90, 90, 90), HOME, (90, 40, 60, 90, 90, 90)), HEX7BOT, A)
    texts = [str(f) for f in report.findings]
    assert any("J1=" in t and "outside its limits" in t and t.startswith("at 1.7") for t in texts)
    assert any("elbow open" in t for t in texts)
    with pytest.raises(LimitError, match=r"J1=.*elbow open.*nothing was sent"):
        report.require()


def test_a_coupling_limit_violated_in_the_middle_is_found() -> None:
    # Start and goal are good; the way between folds the arm. Both ends checked alone would let it pass.
    good = (90, 100, 130, 90, 90, 90)
    folded = check_trajectory(through(good, (90, 150, 130, 90, 90, 90), good), HEX7BOT, A)
    assert [f.text.split(" 0.")[0] for f in folded.findings] == ["elbow folded"]
    assert folded.findings[0].time == pytest.approx(1.2, abs=0.011)


def test_too_fast_is_found() -> None:
    report = check_trajectory(through(HOME, (160, 90, 90, 90, 90, 90), seconds=0.3), HEX7BOT, A)
    assert [f.text for f in report.findings] == ["J1 would turn at 233.3 deg/s, its limit is 149 deg/s"]


def test_table_is_found_and_can_be_moved() -> None:
    low = through(HOME, (90, 60, 155, 90, 90, 90))
    assert check_trajectory(low, HEX7BOT, A).lowest < 0.05
    report = check_trajectory(low, HEX7BOT, A, table=0.05)
    assert "the tool would be" in report.findings[0].text
    assert "below the table at 50 mm" in report.findings[0].text
    assert check_trajectory(low, HEX7BOT, A, table=None).findings == ()


def test_an_arm_below_the_table_may_leave_but_not_come_back() -> None:
    sunk, up = (90, 60, 155, 90, 90, 90), (90, 90, 110, 90, 90, 90)
    assert check_trajectory(through(sunk, up), HEX7BOT, A, table=0.05).findings == ()
    back = check_trajectory(through(sunk, up, sunk), HEX7BOT, A, table=0.05)
    assert [f.time > 2.0 for f in back.findings] == [True]
    deeper = check_trajectory(through(sunk, (90, 57, 157, 90, 90, 90)), HEX7BOT, A, table=0.05)
    assert [f.time < 0.1 for f in deeper.findings] == [True]


def test_a_motion_from_below_the_table_must_end_above_it_unless_it_goes_on() -> None:
    path = through((90, 60, 155, 90, 90, 90), (90, 90, 110, 90, 90, 90))
    (found,) = check_trajectory(path, HEX7BOT, A, table=0.9).findings
    assert found.time == path.duration
    assert found.text.startswith("the arm would still be ")
    assert found.text.endswith(" mm below the table at 900 mm")
    assert check_trajectory(path, HEX7BOT, A, table=0.9, goes_on=True).findings == ()
    there = through((90, 90, 110, 90, 90, 90), (90, 95, 105, 90, 90, 90))
    assert check_trajectory(there, HEX7BOT, A, table=0.05).findings == ()


def test_an_arm_beyond_the_coupling_limit_may_leave_but_not_come_back() -> None:
    folded, good = (90, 150, 120, 90, 90, 90), (90, 100, 120, 90, 90, 90)
    assert check_trajectory(through(folded, good), HEX7BOT, A).findings == ()
    back = check_trajectory(through(folded, good, folded), HEX7BOT, A)
    assert [f.text.split(" deg")[0].startswith("elbow folded") for f in back.findings] == [True]
    assert back.findings[0].time > 2.0


def test_a_joint_outside_its_limits_at_the_start_is_to_be_brought_back() -> None:
    report = check_trajectory(through((180, 90, 90, 90, 90, 90), HOME), HEX7BOT, A)
    assert "bring it back first: hexwire move J1=" in report.findings[0].text


def test_joints_that_stay_count_for_the_coupling_limits() -> None:
    spline = Spline(("J2",), [Waypoint(0.0, (NEUTRAL["J2"],)), Waypoint(1.0, (NEUTRAL["J2"] - math.radians(50),))])
    still = check_trajectory(spline, HEX7BOT, A, others=NEUTRAL)
    assert still.findings == ()
    low = {**NEUTRAL, "J3": NEUTRAL["J3"] - math.radians(30)}
    assert "elbow open" in check_trajectory(spline, HEX7BOT, A, others=low).findings[0].text


def test_without_a_model_limits_and_speeds_only() -> None:
    report = check_trajectory(through(HOME, (90, 50, 50, 90, 90, 90)), HEX7BOT)
    assert report.findings == ()
    assert report.lowest == math.inf


def test_line_in_joints_of_the_driver() -> None:
    start = tuple(math.radians(d) for d in (90, 100, 90, 90, 45, 90))
    here = A.forward(start)
    line = Line(A, start, Pose((0.05, here.position[1], here.position[2]), here.rotation))
    joints = InJoints(line, A)
    assert joints.names == HEX7BOT.names[:6]
    for t in (0.0, 0.2, 0.4):
        angles = A.from_joints(dict(zip(joints.names, joints.at(t).position, strict=True)))
        assert angles == pytest.approx(line.at(t).position)
        assert joints.at(t).velocity == pytest.approx(line.at(t).velocity)
    assert check_trajectory(joints, HEX7BOT, A).findings == ()


def one(joint: str, degrees: float, seconds: float) -> Spline:
    """A joint from its neutral angle on."""
    here = NEUTRAL[joint]
    return Spline((joint,), [Waypoint(0.0, (here,)), Waypoint(seconds, (here + math.radians(degrees),))])


def test_other_controllers_motions_count_for_the_coupling_limits() -> None:
    upper, fore = one("J2", 60, 2.0), one("J3", 40, 4.0)
    for way in (upper, fore):
        assert check_trajectory(way, HEX7BOT, A, others=NEUTRAL, table=None).findings == ()
    report = check_trajectory(fore, HEX7BOT, A, others=NEUTRAL, meanwhile=[upper], table=None)
    assert [f.text.split(" 0.")[0].split(" deg")[0].startswith("elbow folded") for f in report.findings] == [True]
    # The upper arm is there first and rests; the forearm folds onto it after that.
    late = check_trajectory(upper, HEX7BOT, A, others=NEUTRAL, meanwhile=[fore], table=None)
    assert late.findings[0].time == pytest.approx(report.findings[0].time)
    assert late.findings[0].time > upper.duration
    assert late.duration == upper.duration


def test_joints_that_the_model_does_not_know_have_no_coupling_limits() -> None:
    spline = Spline(("J7",), [Waypoint(0.0, (NEUTRAL["J7"],)), Waypoint(1.0, (NEUTRAL["J7"] + 0.1,))])
    unknown = {**NEUTRAL, "J2": math.nan}
    assert check_trajectory(spline, HEX7BOT, A, others=unknown).findings == ()
    with pytest.raises(UsageError, match="the position of J2 is unknown"):
        check_trajectory(one("J3", 5, 1.0), HEX7BOT, A, others=unknown)


def test_a_single_move_is_checked_along_its_straight_path() -> None:
    fold = {"J2": NEUTRAL["J2"] + math.radians(60)}
    raised = {**NEUTRAL, "J3": NEUTRAL["J3"] + math.radians(40)}
    check_move(NEUTRAL, fold, A)
    with pytest.raises(LimitError, match=r"^elbow .*, after 6\d % of the path; nothing was sent$"):
        check_move(raised, fold, A)
    low = A.to_joints([math.radians(d) for d in (90, 60, 155, 90, 90, 90)])
    with pytest.raises(LimitError, match=r"^the tool .* below the table at 12 mm, after 98 % of the path; nothing"):
        check_move(NEUTRAL, low, A, 0.012)
    check_move(NEUTRAL, low, A, None)
    check_move({**NEUTRAL, **low}, {"J3": NEUTRAL["J3"]}, A, 0.05)
    with pytest.raises(UsageError, match="the position of J1 is unknown"):
        check_move({**NEUTRAL, "J1": math.nan}, fold, A)
    check_move({**NEUTRAL, "J7": math.nan}, {"J1": 0.1, "J7": 0.2}, A)
    check_move({**NEUTRAL, "J7": math.nan}, {"J7": 0.2}, A)


@pytest.mark.parametrize("beyond", [5, 15, 30, 60])
def test_a_folded_arm_may_unfold_but_not_fold_further(beyond: float) -> None:
    folded = {**NEUTRAL, "J2": NEUTRAL["J2"] + math.radians(50), "J3": NEUTRAL["J3"] + math.radians(30 + beyond)}
    check_move(folded, {"J3": NEUTRAL["J3"]}, A, None)
    for further in (0.4, 2.0):
        with pytest.raises(LimitError, match="elbow folded"):
            check_move(folded, {"J3": folded["J3"] + math.radians(further)}, A, None)


@pytest.mark.parametrize("duration", [1e-300, 1e-9, 1e-3])
@pytest.mark.parametrize("rest", [None, (0.0,)])
def test_a_path_that_takes_no_time_is_too_fast(duration: float, rest: tuple[float, ...] | None) -> None:
    points = [Waypoint(0.0, (0.0,), rest), Waypoint(duration, (0.2,), rest)]
    report = check_trajectory(Spline(("J1",), points), HEX7BOT)
    with pytest.raises(LimitError, match="J1 would turn at"):
        report.require()


def test_a_driver_joint_may_be_turned_and_shifted_against_the_models() -> None:
    spline = Spline(
        [r.name for r in A.ranges],
        [Waypoint(0.0, (0.5,) * 6, (0.25,) * 6, (0.0,) * 6), Waypoint(1.0, (1.0,) * 6, (0.0,) * 6, (0.5,) * 6)],
    )
    joints, t, h = InJoints(spline, A), 0.4, 1e-5
    for at in (0.0, t, 1.0):
        assert joints.at(at).position == pytest.approx(tuple(A.to_joints(spline.at(at).position).values()))
    before, here, after = joints.at(t - h), joints.at(t), joints.at(t + h)
    for i in range(6):
        assert here.velocity[i] == pytest.approx((after.position[i] - before.position[i]) / (2 * h), abs=1e-6)
        assert here.acceleration[i] == pytest.approx((after.velocity[i] - before.velocity[i]) / (2 * h), abs=1e-6)
    assert joints.duration == 1.0


def test_peaks_are_those_of_the_whole_trajectory_and_both_directions() -> None:
    there = Spline(("J1", "J2"), [Waypoint(0, (0.0, 0.5)), Waypoint(1, (1.0, 0.5)), Waypoint(1.5, (0.25, 0.5))])
    report = check_trajectory(there, HEX7BOT)
    assert report.peak_speed == {"J1": pytest.approx(1.5), "J2": 0.0}
    assert list(report.peak_speed) == ["J1", "J2"]
    assert report.findings == ()


@pytest.mark.parametrize(("share", "good"), [(1.0009, True), (1.0011, False), (-1.0009, True), (-1.0011, False)])
def test_a_speed_limit_has_a_tolerance_of_a_thousandth(share: float, good: bool) -> None:
    speed = share * HEX7BOT.joint("J1").max_speed
    line = Spline(("J1",), [Waypoint(0.0, (0.0,)), Waypoint(0.1, (0.1 * speed,))])
    assert (check_trajectory(line, HEX7BOT).findings == ()) is good


def test_a_jump_between_two_samples_is_a_speed() -> None:
    class Jump(Spline):
        def at(self, t: float) -> Sample:
            return Sample((0.0 if t < 0.505 else 0.5,), (0.0,), (0.0,))

    jump = Jump(("J1",), [Waypoint(0.0, (0.0,)), Waypoint(1.0, (0.5,))])
    report = check_trajectory(jump, HEX7BOT)
    assert [(f.time, f.text.partition(" would")[0]) for f in report.findings] == [(pytest.approx(0.51), "J1")]
    assert report.peak_speed["J1"] == pytest.approx(50.0)
    assert check_trajectory(jump, HEX7BOT, step=0.5).peak_speed["J1"] == pytest.approx(1.0)


def test_each_kind_is_reported_once_when_it_first_occurs() -> None:
    beyond = HEX7BOT.joint("J1").maximum + 0.2
    spline = Spline(("J1", "J2"), [Waypoint(t, (beyond * (t % 2), 3.0 * (t > 3))) for t in range(6)])
    report = check_trajectory(spline, HEX7BOT)
    times = [f.time for f in report.findings]
    assert times == sorted(times)
    assert [f.text.split("=")[0].split(" ")[0] for f in report.findings] == ["J1", "J2", "J2"]
    assert times[0] < 1.0
    assert "bring it back" not in report.findings[0].text


def test_other_trajectories_are_sampled_to_their_end_and_no_further() -> None:
    seen: list[float] = []

    class Other(Spline):
        def sample(self, t: float) -> Sample:
            seen.append(t)
            return super().sample(t)

    here = NEUTRAL["J3"]
    other = Other(("J3",), [Waypoint(0.0, (here,)), Waypoint(0.25, (here,))])
    still = Spline(("J2",), [Waypoint(0.0, (NEUTRAL["J2"],)), Waypoint(0.125, (NEUTRAL["J2"],))])
    report = check_trajectory(still, HEX7BOT, A, others=NEUTRAL, meanwhile=[other], step=0.0625)
    assert seen == [0.0, 0.0625, 0.125, 0.1875, 0.25]
    assert report.duration == 0.125
    seen.clear()
    check_trajectory(still, HEX7BOT, A, others=NEUTRAL, meanwhile=[other], step=0.05)
    assert seen == pytest.approx([0.0, 0.05, 0.1, 0.125, 0.175, 0.225, 0.275])


def test_the_lowest_point_is_that_of_the_whole_trajectory() -> None:
    low = (90, 60, 155, 90, 90, 90)
    there_and_back = check_trajectory(through(HOME, low, HOME), HEX7BOT, A)
    assert there_and_back.lowest == pytest.approx(check_trajectory(through(low), HEX7BOT, A).lowest, abs=1e-6)
    below = check_trajectory(through(HOME, (90, 50, 160, 90, 90, 90)), HEX7BOT, A)
    assert below.lowest < 0
    assert [f.text.partition(" below")[2] for f in below.findings] == [" the table at 0 mm"]


def test_a_move_is_checked_at_its_goal_too() -> None:
    low = A.to_joints([math.radians(d) for d in (90, 60, 155, 90, 90, 90)])
    height = check_trajectory(through((90, 60, 155, 90, 90, 90)), HEX7BOT, A).lowest
    check_move(NEUTRAL, low, A, height)
    with pytest.raises(LimitError, match=r"below the table at \d+ mm, at the goal; nothing was sent$"):
        check_move(NEUTRAL, low, A, height + 1e-5)
    deep = A.to_joints([math.radians(d) for d in (90, 50, 160, 90, 90, 90)])
    with pytest.raises(LimitError, match="below the table at 0 mm"):
        check_move(NEUTRAL, deep, A)
    check_move(NEUTRAL, {}, A)
    check_move(NEUTRAL, {"J1": NEUTRAL["J1"]}, A)
