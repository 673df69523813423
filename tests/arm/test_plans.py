"""What a person names as a goal, as trajectories: without an arm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.motion.arms import HOME, rest_to_rest
from tests.recorded import make_positions

from hexwire.arm.plans import Plans, is_number, joint_angles, length
from hexwire.control.motion.via import Place
from hexwire.errors import LimitError, UsageError
from hexwire.model.aim import Aim
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.geometry import kinematics_for
from hexwire.motion.teach import Edits, Taught
from hexwire.trace.recording import RecordingWriter

GEOMETRY = kinematics_for(HEX7BOT)
assert GEOMETRY is not None
HERE = dict(zip(HEX7BOT.names, (0.0,) * 7, strict=True)) | HOME
AHEAD, ASIDE = (0.0, 0.22, 0.2), (0.06, 0.18, 0.12)
POSES = {"home": HERE, "low": HERE | {"J1": 0.3, "J7": 0.2}}
NOWHERE = (None, None, None)


def tip(angles: Mapping[str, float]) -> tuple[float, ...]:
    assert GEOMETRY is not None
    return GEOMETRY.forward(GEOMETRY.from_joints(dict(angles))).position


def plans(geometry: object = GEOMETRY) -> Plans:
    driver: Any = SimpleNamespace(model=HEX7BOT, kinematics=geometry)
    return Plans(driver, POSES)


# -- numbers ------------------------------------------------------------------------------------------------------


def test_only_finite_numbers_are_numbers() -> None:
    assert all(map(is_number, (0, -1.5, 10**30)))
    assert not any(map(is_number, (True, "1", None, math.nan, math.inf, 10**400, 1j)))


def test_metres_beyond_any_arm_are_taken_for_millimetres() -> None:
    assert (length("it", 3), length("it", -3.0)) == (3.0, -3.0)
    for metres in (3.01, -3.01):
        with pytest.raises(UsageError, match=r"it cannot be .* m; for millimetres write"):
            length("it", metres)


def test_radians_beyond_a_turn_are_taken_for_degrees() -> None:
    turn = 2 * math.pi
    assert joint_angles(HEX7BOT, {"j1": turn, "J2": -turn}) == {"J1": turn, "J2": -turn}
    with pytest.raises(UsageError, match=r"J1 cannot turn 6\.3 radians; .*; J2 cannot turn -7 radians"):
        joint_angles(HEX7BOT, {"J1": 6.3, "J2": -7})


def test_angles_may_be_asked_to_be_within_their_limits_and_all_faults_are_told() -> None:
    beyond = HEX7BOT.joint("J1").maximum + 0.1
    assert joint_angles(HEX7BOT, [("J1", beyond)]) == {"J1": beyond}
    with pytest.raises(
        UsageError, match=r"J1=.*outside its limits.*; .*J99.*; J2 is named twice; nothing was sent$"
    ):
        joint_angles(HEX7BOT, [("J1", beyond), ("J99", 0.0), ("J2", 0.0), ("j2", 0.0)], within=True)


# -- points -------------------------------------------------------------------------------------------------------


def test_points_are_places_with_the_aim_of_the_call_poses_and_angles() -> None:
    aim, own = Aim(down=True), Place(AHEAD, Aim(pitch=0.1))
    at = plans().points("goto", [ASIDE, "low", {"j4": 0.1}, own], NOWHERE, aim, True)
    assert at(HERE) == [Place(ASIDE, aim, relative=True), POSES["low"], {"J4": 0.1}, own]
    (pose,) = plans().points("goto", ["low"], NOWHERE, Aim(), False, gripper=False)(HERE)
    assert pose == {name: angle for name, angle in POSES["low"].items() if name != "J7"}


def test_coordinates_that_are_not_given_stay() -> None:
    x, _, z = tip(HERE)
    assert plans().points("goto", [], (None, 0.1, None), Aim(), False)(HERE) == [Place((x, 0.1, z), Aim())]
    relative = plans().points("line", [], (None, None, 0.0), Aim(), True)(HERE)
    assert relative == [Place((0.0, 0.0, 0.0), Aim(), relative=True)]


def test_what_has_no_place_can_neither_be_aimed_nor_counted_from() -> None:
    for aim, relative in ((Aim(down=True), False), (Aim(), True)):
        with pytest.raises(UsageError, match="at places, not at poses"):
            plans().points("goto", ["home", {"J1": 0.1}], NOWHERE, aim, relative)
        assert plans().points("goto", ["home", AHEAD], NOWHERE, aim, relative)
        assert plans().points("goto", [], (0.1, None, None), aim, relative)


def test_an_arm_without_a_geometry_has_no_places() -> None:
    assert plans(None).moved == HEX7BOT.names
    assert plans().moved == HEX7BOT.names[:6]
    at = plans(None).points("goto", [], (0.1, None, None), Aim(), False)
    with pytest.raises(UsageError, match="no geometry is known for hex7bot"):
        at(HERE)
    with pytest.raises(UsageError, match="no geometry is known"):
        plans(None).aim(True, None, None, None)
    assert not plans(None).aim(False, None, None, None).given


def test_an_aim_has_the_angles_that_were_given_in_their_order() -> None:
    aim = plans().aim(False, (0.1, 0.2, 0.3), None, None, fixed=True)
    assert (aim.down, aim.rpy, aim.fixed) == (False, (0.1, 0.2, 0.3), True)
    assert plans().aim(True, None, None, None) == Aim(down=True)


# -- trajectories -------------------------------------------------------------------------------------------------


def test_a_duration_stretches_the_fastest_path_and_a_speed_is_a_share_of_it() -> None:
    goal = [{"J1": HERE["J1"] + 0.5}]
    fastest = plans().through(goal, HERE, 1.0, None)
    assert plans().through(goal, HERE, 0.25, None).duration > 1.3 * fastest.duration
    # Whatever its speed would be.
    for seconds in (fastest.duration, 3.0):
        path = plans().through(goal, HERE, 0.1, seconds)
        assert path.duration == pytest.approx(seconds)
        assert dict(zip(path.names, path.goal, strict=True))["J1"] == pytest.approx(HERE["J1"] + 0.5)
    with pytest.raises(UsageError, match=r"is too short: the joints' limits need .* s for this"):
        plans().through(goal, HERE, 1.0, 0.99 * fastest.duration)
    assert plans().through([{"J1": HERE["J1"]}], HERE, 1.0, 2.0).duration == 0.0


def test_an_angle_beyond_a_limit_is_told_before_a_place_out_of_reach() -> None:
    beyond = {"J2": HEX7BOT.joint("J2").maximum + 0.1}
    with pytest.raises(LimitError, match="J2="):
        plans().through([Place((2.0, 0.0, 0.0)), beyond], HERE, 1.0, None)


def test_lines_keep_their_speed_and_round_their_corners() -> None:
    x, y, z = tip(HERE)
    corner = [Place((x, y, z - 0.02)), Place((x + 0.02, y, z - 0.02))]
    round, slow, sharp = (plans().line(corner, HERE, *how) for how in ((0.05, 0.01), (0.025, 0.01), (0.05, 0.0)))
    assert slow.duration == pytest.approx(2 * round.duration, rel=0.2)
    # Whoever stops at the corner needs longer.
    assert sharp.duration > round.duration + 0.1
    for speed, rounding in ((0.0, 0.01), (-0.1, 0.01), (0.1, -0.01)):
        with pytest.raises(UsageError, match="must be"):
            plans().line(corner, HERE, speed, rounding)


# -- recordings ---------------------------------------------------------------------------------------------------

MOVED = Taught(("J1",), (0.0, 0.5, 1.0, 1.5, 2.0), ((0.0,), (0.0,), (0.1,), (0.2,), (0.2,)))


def test_a_recording_is_cut_and_its_pauses_are_taken_out() -> None:
    assert MOVED.edited(Edits()) == MOVED
    assert MOVED.edited(Edits(begin=0.5)).duration == 1.5
    assert MOVED.edited(Edits(end=1.5)).duration == 1.5
    assert MOVED.edited(Edits(trim=True)).duration < 1.9


def test_a_file_a_lesson_and_a_trajectory_are_played_alike(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    with RecordingWriter(file) as writer:
        for t, row in zip(MOVED.times, MOVED.rows, strict=True):
            writer.joint_state(make_positions(MOVED.names, row), 1.7e9 + t)
    way = rest_to_rest(("J1",), (0.0,), (0.2,), 2.0)
    for motion in (file, str(file), MOVED, way):
        played = plans().played(motion, Edits())(2.0)
        assert played.names == ("J1",)
        assert played.duration == pytest.approx(1.0)
        assert played.goal == pytest.approx((0.2,))
