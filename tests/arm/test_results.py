"""What a person is told of a motion that was cancelled, stopped, slowed down, or has arrived."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.arm.arms import KINDS, TIMED, connected, marked
from tests.arm.test_torque_off import GRIPS, VERBS, a_program, a_way, insisted, other_opening
from tests.waits import PATIENCE, eventually

from hexwire import Arm, MotionResult, deg, mm
from hexwire.arm import verbs
from hexwire.arm.front import Front
from hexwire.arm.handle import MotionHandle
from hexwire.control.loop.power import NOT_LATCHED, STOP_LATCHED, what_helps
from hexwire.control.motion.motion_options import MotionObserver
from hexwire.control.motion.path_check import CheckedPath
from hexwire.control.requests.pose_file import home_pose
from hexwire.errors import StoppedError, UsageError

SLOW: dict[str, Callable[[Arm], Callable[[], MotionHandle[Any]]]] = {
    "move": lambda arm: partial(arm.move, {arm.model.names[0]: deg(4)}, relative=True, duration=30.0, wait=False),
    "goto": lambda arm: partial(arm.goto, (0, 0, -mm(8)), relative=True, duration=30.0, wait=False),
    "line": lambda arm: partial(arm.line, (0, 0, -mm(8)), relative=True, tip_speed=0.0005, wait=False),
    "home": lambda arm: partial(arm.home, duration=30.0, wait=False),
    "play": lambda arm: partial(arm.play, a_way(arm), factor=0.01, wait=False),
    "program": lambda arm: partial(arm.play, a_program(arm, 40.0, speed=0.01), wait=False),
    "grip": lambda arm: partial(arm.grip, other_opening(arm), duration=30.0, wait=False),
    "move and grip": lambda arm: partial(
        arm.move, {arm.model.names[0]: -deg(4)}, relative=True, grip=other_opening(arm), duration=30.0, wait=False
    ),
}
each_kind = pytest.mark.parametrize("arm", marked(KINDS | TIMED, ("bus",)), indirect=True)
"""What is said depends on how it ended: one kind of arm in `make test`, the others in `make test-all`."""


def begun(arm: Arm, verb: str) -> MotionHandle[MotionResult]:
    """A motion that lasts, and moves by now."""
    if arm.model.name == "puma260" and verb in GRIPS:
        pytest.fail("a PUMA has no gripper")
    motion = SLOW[verb](arm)()
    eventually(lambda: motion.state is not None or motion.done)
    assert not motion.done
    return motion


def verbs_of(arm: Arm) -> list[str]:
    return [verb for verb in SLOW if arm.model.name != "puma260" or verb not in GRIPS]


def test_the_slow_verbs_are_all_verbs() -> None:
    assert set(SLOW) | {"open", "close"} == set(VERBS | GRIPS)


@each_kind
def test_a_cancelled_motion_says_why_it_ended_and_how_far_off_each_joint_is(arm: Arm) -> None:
    for verb in verbs_of(arm):
        if verb == "home":
            arm.move({arm.model.names[0]: deg(4)}, relative=True)
        result = begun(arm, verb).cancel()
        assert (result.cut, result.stopped) == (True, None), verb
        assert result.why == result.ended == "cancelled by the program"
        assert result.require() is result
        assert result.rest is not None, verb
        joint, off = result.rest.joints[0]
        assert (joint, off) == (result.rest.joint, result.rest.off)
        assert off > deg(0.1), (verb, result.rest)
        assert [off for _, off in result.rest.joints] == sorted(
            [off for _, off in result.rest.joints], reverse=True
        )
        assert arm.model.names[-1 if verb == "grip" else 0] in dict(result.rest.joints)
        assert "cancelled by the program" in repr(result)
    arm.home()


def test_a_grip_says_how_far_off_the_jaws_came_to_rest(arm: Arm) -> None:
    if arm.model.name == "puma260":
        return
    result = arm.grip(other_opening(arm))
    assert result.rest is not None
    assert result.rest.joint == arm.model.names[-1]
    assert result.rest.off < deg(20)


@each_kind
@pytest.mark.parametrize("how", ["a stop", "a stop that is over", "torque off"])
def test_whatever_ends_a_motion_says_once_what_helps(arm: Arm, how: str) -> None:
    for verb in verbs_of(arm):
        motion = begun(arm, verb)
        if how == "torque off":
            insisted(partial(arm.torque, False))
        else:
            insisted(arm.stop)
            if how == "a stop that is over":
                arm.resume()
        with pytest.raises(StoppedError) as raised:
            motion.wait(PATIENCE)
        text = str(raised.value)
        # A stop that is over may still have lasted when its motion ended.
        latched = how == "a stop" or (how != "torque off" and "resume()" in text)
        assert arm.read().stopped == (how == "a stop")
        assert text.count("stopped: ") <= 1, text
        assert "hexwire resume" not in text
        # A request that was not sent says it in its own words.
        assert ("resume()" in text) == latched, (verb, text)
        assert what_helps(arm.driver) == (STOP_LATCHED if how == "a stop" else NOT_LATCHED)
        # What was interrupted before it was sent says to call it again.
        assert latched or "nothing is latched" in text or "again" in text, (verb, text)
        arm.resume()
    assert arm.home().arrived


def test_a_line_that_is_slowed_near_a_singularity_says_so_before_it_moves(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned: list[CheckedPath] = []

    class Told(MotionObserver):
        def planned(self, path: CheckedPath) -> None:
            planned.append(path)

    with connected("board", tmp_path) as arm:
        arm.home()
        here = home_pose(arm.model) | {"J4": deg(3), "J6": deg(3)}
        arm.move(here)
        monkeypatch.setattr(verbs, "read_start", lambda robot: here)  # the measured angles are a count off
        caplog.clear()
        with caplog.at_level(logging.WARNING), arm.line((0, mm(30), 0), relative=True, wait=False) as motion:
            said = [record.getMessage() for record in caplog.records if "singularity" in record.getMessage()]
            result = motion.cancel()
        assert len(said) == 1
        assert f"this takes {motion.duration:.1f} s, " in said[0]
        assert re.search(r"since J[46] cannot follow faster near a singularity \(wrist\)", said[0])
        assert motion.duration > 20.0
        assert result.slowed == said[0]
        Arm(arm.driver, front=Front(Told(), dry_run=True)).line((0, mm(30), 0), relative=True)
        assert planned[0].slowed == said[0]
        # An ordinary one says nothing.
        monkeypatch.undo()
        arm.home()
        caplog.clear()
        assert not arm.line((0, 0, -mm(20)), relative=True).slowed
        assert not [record for record in caplog.records if "singularity" in record.getMessage()]


def test_a_result_is_shown_in_a_line() -> None:
    result = MotionResult(True, seconds=1.5)
    assert repr(result) == "<MotionResult: arrived; 1.50 s>"
    assert repr(MotionResult(None, seconds=1.0)) == "<MotionResult: sent; 1.00 s>"
    assert repr(MotionResult(False, cut=True, opening=0.25, holds=True)) == (
        "<MotionResult: ended before the goal; 0.00 s, gripper 25 % open with an object>"
    )


def test_the_result_of_a_motion_is_shown_in_a_line(arm: Arm) -> None:
    shown = repr(arm.home())
    assert shown.startswith("<MotionResult: arrived; ")
    assert "deg off" in shown
    assert len(shown) < 120


# -- what is no motion --------------------------------------------------------------------------------------------


def test_a_lesson_and_a_recording_are_played(tmp_path: Path) -> None:
    with connected("bus", tmp_path) as arm:
        arm.home()
        with arm.teach() as lesson:
            eventually(lambda: len(lesson._states) > 5)
        assert arm.play(lesson).arrived
        with arm.record(tmp_path / "a.mcap") as recording:
            arm.move({arm.model.names[0]: deg(3)}, relative=True)
            with pytest.raises(UsageError, match=r"end\(\) it before it is played"):
                arm.play(recording)
        assert arm.play(recording).arrived
        with pytest.raises(UsageError, match="a file, a lesson, a recording or a trajectory, not 3"):
            arm.play(3)  # type: ignore[call-overload]
        arm.detach()
        with pytest.raises(UsageError, match="this arm is detached"):
            arm.record(tmp_path / "b.mcap")
        assert not (tmp_path / "b.mcap").exists()


def test_an_arm_follows_no_leader_that_is_stopped_and_holds_when_its_leader_is(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with connected("bus", tmp_path / "a") as leader, connected("bus", tmp_path / "a") as arm:
        insisted(leader.stop)
        with pytest.raises(StoppedError, match=r"^the leader is stopped; resume\(\) ends the stop, and"):
            arm.follow(leader)
        leader.resume()
        following = arm.follow(leader, wait=False)
        eventually(lambda: set(arm.read().torque_on) == set(arm.model.names) or following.done)
        insisted(leader.stop)
        with pytest.raises(StoppedError, match="the leader was stopped, so the follower holds"):
            following.wait(PATIENCE)
        assert not arm.read().stopped
        assert arm.read().torque_on
        leader.resume()
        with suppress(StoppedError):
            arm.home()


def test_a_known_pose_is_replaced_only_by_force_and_no_word_deletes_them_all(tmp_path: Path) -> None:
    with connected("bus", tmp_path) as arm:
        joint = arm.model.names[0]
        home = dict(arm.poses["home"])
        for name in ("home", "mine"):
            if name == "mine":
                arm.poses["mine"] = {joint: 0.1}
                arm.poses["mine"] = {joint: 0.1}
            before = dict(arm.poses[name])
            with pytest.raises(UsageError, match=rf"poses.save\('{name}', angles, force=True\) replaces it"):
                arm.poses[name] = {joint: 0.2}
            with pytest.raises(UsageError, match="force=True replaces it"):
                arm.poses.save(name, {joint: 0.2})
            assert dict(arm.poses[name]) == before
            arm.poses.save(name, {joint: 0.2}, force=True)
            assert arm.poses[name][joint] == pytest.approx(0.2)
        for wipe in (arm.poses.clear, arm.poses.popitem):
            with pytest.raises(UsageError, match="deleted by their names"):
                wipe()
        del arm.poses["home"]
        assert arm.poses.pop("mine")[joint] == pytest.approx(0.2)
        assert {name: dict(pose) for name, pose in arm.poses.items()} == {"home": home}
        assert math.isfinite(home[joint])
