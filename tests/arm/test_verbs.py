"""The verbs of an arm: the same promises on every kind of it."""

from __future__ import annotations

import logging
import math
import re
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from tests.arm.arms import KINDS, connected, marked
from tests.control.swing import Swing
from tests.defaults import default
from tests.few import few
from tests.motion.arms import HOME, at_rest, rest_to_rest
from tests.waits import eventually

import hexwire
from hexwire import Arm, connect, deg, mm
from hexwire.arm import verbs
from hexwire.arm.blocks import Lesson
from hexwire.arm.handle import MotionHandle
from hexwire.control.loop.reader import read_start
from hexwire.control.motion.following import run_following
from hexwire.control.motion.motion_options import MotionOptions
from hexwire.control.motion.motions import MotionResult, check_path, run_motion
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.registry import make_driver
from hexwire.drivers.timed_path import TimedPoint
from hexwire.errors import HexwireError, LeaseError, LimitError, StoppedError, UsageError
from hexwire.model.state import JointTarget
from hexwire.motion.through import arm_path
from hexwire.trace.recording import read_joint_states


@pytest.fixture(scope="module", params=marked(KINDS, ("bus",)))
def kept(request: pytest.FixtureRequest) -> Iterator[Arm]:
    """An arm of each kind, for tests that leave it as they found it."""
    # Short, since the path of a socket must be.
    with tempfile.TemporaryDirectory(prefix="hw") as folder, connected(request.param, Path(folder)) as arm:
        arm.home()
        yield arm


@pytest.fixture
def arm(kept: Arm) -> Iterator[Arm]:
    yield kept
    for handle in kept._handles:
        handle.abandon()
    kept.resume()
    kept.home()


def joint_of(arm: Arm) -> str:
    return arm.model.names[0]


def angle(arm: Arm) -> float:
    return arm.read()[joint_of(arm)].position


def sent_away(arm: Arm) -> MotionHandle[MotionResult]:
    """A motion of some seconds, under way."""
    motion = arm.move({joint_of(arm): deg(40)}, relative=True, duration=20.0, wait=False)
    before = angle(arm)
    eventually(lambda: abs(angle(arm) - before) > deg(0.5) or motion.done)
    assert not motion.done
    return motion


# -- going there --------------------------------------------------------------------------------------------------


def test_each_verb_says_how_far_off_its_goal_the_arm_came_to_rest(arm: Arm) -> None:
    joint = joint_of(arm)
    before = angle(arm)
    result = arm.move({joint: deg(8)}, relative=True)
    assert result.arrived
    assert result.rest is not None
    assert result.rest.off < deg(1.5)
    assert angle(arm) - before == pytest.approx(deg(8), abs=deg(2))
    x, y, z = arm.tip.position
    drop = (x, y, z - mm(15))
    assert arm.goto(drop).rest is not None
    assert math.dist(arm.tip.position, drop) < mm(6)
    # The other coordinates stay.
    assert arm.line(z=z, tip_speed=0.2).rest is not None
    assert math.dist(arm.tip.position, (x, y, z)) < mm(8)
    assert arm.line((0, 0, -mm(10)), relative=True, tip_speed=0.2).arrived
    assert arm.tip.position[2] == pytest.approx(z - mm(10), abs=mm(6))
    assert arm.home().arrived


def test_a_target_is_sent_and_waited_for_or_left(arm: Arm) -> None:
    joint = joint_of(arm)
    there = angle(arm) + deg(6)
    result = arm.send({joint: there}, duration=0.5)
    assert (result.arrived, result.rest is not None) == (True, True)
    assert angle(arm) == pytest.approx(there, abs=deg(2))
    result = arm.send({joint: there - deg(6)}, duration=0.5, wait=False)
    assert (result.arrived, result.sent is not None) == (None, True)
    eventually(lambda: abs(angle(arm) - there + deg(6)) < deg(2))


def test_a_motion_beyond_a_limit_names_the_angle_that_was_asked_for(arm: Arm) -> None:
    joint = arm.limits[joint_of(arm)]
    beyond = joint.maximum + 0.2
    said = rf"{joint.name}=\S+ deg is outside its limits \S+ to \S+ deg; nothing was sent"
    for call in (
        partial(arm.move, {joint.name: beyond}),
        partial(arm.move, {joint.name: beyond - angle(arm)}, relative=True),
        partial(arm.goto, "home", {joint.name: beyond}),
    ):
        with pytest.raises(LimitError, match=f"^{said}$"):
            call()
    with pytest.raises(LimitError, match=r"limit|table|reach|singularity"):
        arm.line((0, 0, -mm(900)), relative=True)


def test_a_result_says_how_long_the_motion_took(arm: Arm) -> None:
    begin = time.monotonic()
    result = arm.move({joint_of(arm): deg(5)}, relative=True, duration=1.0)
    assert 0.5 < result.seconds < time.monotonic() - begin


def test_points_are_passed_without_a_stop_between_them(arm: Arm) -> None:
    joint, here = joint_of(arm), angle(arm)
    motion = arm.goto({joint: here + deg(15)}, {joint: here + deg(30)}, "home", wait=False)
    speeds = []
    for state in arm.states(50.0):
        speeds.append((state[joint].position - here, state[joint].velocity))
        if motion.done:
            break
    assert motion.wait().arrived
    # Halfway up, where the first point is, it moves.
    near = [abs(speed) for off, speed in speeds if abs(off - deg(15)) < deg(6) and math.isfinite(speed)]
    assert not near or max(near) > deg(1)
    assert angle(arm) == pytest.approx(here, abs=deg(2))


def test_a_duration_stands_for_a_speed_and_the_limits_hold(arm: Arm) -> None:
    joint = joint_of(arm)
    with arm.move({joint: deg(5)}, relative=True, duration=1.5, wait=False) as motion:
        assert motion.duration == pytest.approx(1.5)
    slow = arm.move({joint: deg(30)}, relative=True, speed=0.1, wait=False)
    assert slow.duration > 2 * arm_path(arm.model, [joint], [[0.0], [deg(30)]]).duration
    slow.cancel()


MISTAKES: dict[str, tuple[Callable[[Arm], object], str]] = {
    "millimetres": (lambda arm: arm.goto((80, 200, 100)), r"for millimetres write mm\(200\)"),
    "degrees": (lambda arm: arm.move({joint_of(arm): 30}), r"for degrees write deg\(30\)"),
    "degrees of a point": (lambda arm: arm.goto({joint_of(arm): 30}), r"for degrees write deg\(30\)"),
    "out of reach": (lambda arm: arm.goto((3, 0, 0)), "out of reach"),
    "a line out of reach": (lambda arm: arm.line((3, 0, 0)), "out of reach|singularity|limit|reaches"),
    "below the floor": (lambda arm: arm.goto(z=-2), "out of reach"),
    "no joint": (lambda arm: arm.move(J99=0.1), "no joint 'J99'"),
    "no pose": (lambda arm: arm.move("nowhere"), "no pose 'nowhere' of .*; there are home"),
    "no pose among points": (lambda arm: arm.goto("nowhere"), "no pose 'nowhere'"),
    "too short": (lambda arm: arm.move({joint_of(arm): deg(5)}, relative=True, duration=0.01), "too short"),
    "no duration": (
        lambda arm: arm.move({joint_of(arm): deg(5)}, relative=True, duration=math.nan),
        "a number of seconds above 0",
    ),
    "both": (lambda arm: arm.move({joint_of(arm): 0.1}, duration=1.0, speed=0.5), "not both"),
    "too fast": (lambda arm: arm.move({joint_of(arm): 0.1}, speed=1.5), "a share of the speed limits"),
    "no speed": (lambda arm: arm.move({joint_of(arm): 0.1}, speed=0.0), "a share of the speed limits"),
    "a few degrees": (lambda arm: arm.move({joint_of(arm): 10}), r"for degrees write deg\(10\)"),
    "degrees of the tool": (lambda arm: arm.goto((0.1, 0.2, 0.1), pitch=90), r"for degrees write deg\(90\)"),
    "degrees of rpy": (lambda arm: arm.line((0.1, 0.2, 0.1), rpy=(180, 0, 0)), r"for degrees write deg\(180\)"),
    "two of rpy": (lambda arm: arm.goto((0.1, 0.2, 0.1), rpy=(1, 0)), "roll, pitch and yaw"),  # type: ignore[arg-type]
    "two ways to aim": (
        lambda arm: arm.goto((0.1, 0.2, 0.1), down=True, pitch=1.0),
        "down and pitch contradict",
    ),
    "a roll alone": (lambda arm: arm.goto((0.1, 0.2, 0.1), roll=1.0), "roll needs pitch"),
    "an aim of a pose": (lambda arm: arm.goto("home", down=True), "at places, not at poses"),
    "a pose from here": (lambda arm: arm.move("home", relative=True), "of a pose"),
    "named twice": (lambda arm: arm.move({joint_of(arm): 0.1}, **{joint_of(arm): 0.2}), "is named twice"),
    "a list": (lambda arm: arm.move([0.1] * 6), "takes angles by joint"),  # type: ignore[call-overload]
    "no brackets": (lambda arm: arm.goto(0.1, 0.2, 0.1), r"as in goto\(\(0, "),  # type: ignore[arg-type]
    "millimetres from here": (lambda arm: arm.line(z=-10, relative=True), r"for millimetres write mm\(-10\)"),
    "millimetres per second": (lambda arm: arm.line("home", tip_speed=50), r"for millimetres write mm\(50\)"),
    "millimetres at corners": (lambda arm: arm.line("home", "home", rounding=10), r"millimetres write mm\(10\)"),
    "a text of seconds": (
        lambda arm: arm.move({joint_of(arm): 0.1}, duration="2"),  # type: ignore[call-overload]
        "a number of seconds",
    ),
    "nothing to play": (lambda arm: arm.play(None), "play.. takes a file, a lesson"),  # type: ignore[call-overload]
    "half a time": (lambda arm: arm.play("none.mcap", repeat=1.5), "a whole number"),  # type: ignore[call-overload]
    "nobody": (lambda arm: arm.follow(None), "takes another arm"),  # type: ignore[call-overload]
    "a negative rate": (lambda arm: arm.states(-1), "a rate is"),
    "a pose in degrees": (lambda arm: arm.poses.update(nod={joint_of(arm): 30}), r"for degrees write deg\(30\)"),
    "a joint to free": (lambda arm: arm.torque(False, "J99"), "no joint 'J99'"),
    "nothing": (lambda arm: arm.move(), "takes angles by joint"),
    "nowhere": (lambda arm: arm.goto(), "takes points"),
    "a point and an axis": (lambda arm: arm.line("home", z=0.1), "takes points"),
    "two numbers": (lambda arm: arm.goto((0.1, 0.2)), "is x, y, z in metres"),
    "no number": (lambda arm: arm.goto((0.1, 0.2, math.nan)), "is x, y, z in metres"),
    "text": (lambda arm: arm.move({joint_of(arm): "30"}), "is a number of radians"),  # type: ignore[dict-item]
    "past a limit": (lambda arm: arm.move({joint_of(arm): arm.limits[joint_of(arm)].maximum + 0.2}), "limits"),
    "no recording": (lambda arm: arm.play("none.mcap"), "none.mcap"),
    "played never": (lambda arm: arm.play("none.mcap", repeat=0), "a whole number, 1 or more"),
    "itself": (lambda arm: arm.follow(arm), "cannot follow itself"),
    "no MCAP": (lambda arm: arm.record("states.txt"), "must end in .mcap"),
    "a lesson without MCAP": (lambda arm: arm.teach("states.txt"), "must end in .mcap"),
    "wide open": (lambda arm: arm.grip(50), "gripper"),
    "force in percent": (lambda arm: arm.close(force=25), "a share of full effort"),
    "half": (lambda arm: arm.grip("half"), "'open', 'close' or an opening"),  # type: ignore[call-overload]
    "wide meanwhile": (lambda arm: arm.move({joint_of(arm): 0}, grip=50), "gripper"),
}


def refusal(call: Callable[[Arm], object], arm: Arm) -> str:
    """What a person is told of a call; empty if it was done."""
    try:
        call(arm)
    except UsageError as error:
        return str(error)
    return ""


def test_a_mistake_moves_nothing_and_says_what_to_do(arm: Arm, caplog: pytest.LogCaptureFixture) -> None:
    before = arm.read()
    for what, (call, text) in MISTAKES.items():
        said = refusal(call, arm)
        assert said, f"{what} is no mistake"
        assert re.search(text, said), (what, said)
        assert "\n" not in said, what
    after = arm.read()
    assert after.position == pytest.approx(before.position, abs=deg(0.5))
    # What was refused does not keep the arm.
    assert arm.move({joint_of(arm): deg(1)}, relative=True).arrived


# -- one motion at a time, which can be ended ---------------------------------------------------------------------


def test_a_handle_has_the_progress_and_a_second_motion_is_refused(arm: Arm) -> None:
    motion = sent_away(arm)
    for another in (
        lambda: arm.home(),
        lambda: arm.line(z=0.1),
        lambda: arm.teach(),
        lambda: arm.move({joint_of(arm): 0.1}, wait=False),
    ):
        with pytest.raises(UsageError, match="in motion"):
            another()
    shares = [eventually(lambda: motion.progress) for _ in range(3)]
    assert shares == sorted(shares)
    assert 0 < shares[-1] < 1
    with pytest.raises(TimeoutError):
        motion.wait(0.01)
    result = motion.cancel()
    assert (result.cut, result.arrived, result.stopped) == (True, False, None)
    assert motion.done
    assert motion.progress == 1.0
    # Nothing is latched.
    assert not arm.read().stopped
    assert arm.home().arrived


def test_a_stop_ends_a_motion_whatever_waits_for_it_and_resume_moves_nothing(arm: Arm) -> None:
    motion = sent_away(arm)
    arm.stop()
    with pytest.raises(StoppedError, match=r"resume\(\)"):
        motion.wait()
    for verb in (
        lambda: arm.home(),
        lambda: arm.move({joint_of(arm): 0.1}, wait=False).wait(),
        lambda: arm.goto("home"),
    ):
        with pytest.raises(StoppedError, match=r"resume\(\)"):
            verb()
    before = angle(arm)
    arm.resume()
    assert angle(arm) == pytest.approx(before, abs=deg(1))
    assert arm.home().arrived


def test_whatever_a_stop_refuses_names_what_ends_it_in_a_program(arm: Arm) -> None:
    arm.stop()
    for call in (arm.home, arm.teach, lambda: arm.move({joint_of(arm): 0.1}, wait=False).wait()):
        with pytest.raises(StoppedError, match="resume") as refused:
            call()
        assert "hexwire resume" not in str(refused.value)
    arm.resume()
    assert arm.home().arrived


def test_every_motion_of_a_program_is_refused_alike_while_the_arm_is_stopped(arm: Arm) -> None:
    robot, joint = arm.driver, joint_of(arm)
    here = angle(arm)
    way = rest_to_rest((joint,), (here,), (here + 0.1,), 1.0)
    targets = [JointTarget.of({joint: here + by}, 1.0) for by in (0.1, 0.3)]
    arm.torque(True)
    checked = check_path(robot, [way], MotionOptions())
    arm.stop()
    for host_timed in (False, True):
        options = MotionOptions(host_timed=host_timed)
        calls: list[Callable[[], MotionResult]] = [
            *(partial(run_motion, robot, motion, options) for motion in (way, checked, *targets)),
            *(partial(run_motion, robot, target, options, wait=False) for target in targets),
            *(partial(run_motion, robot, motion, options, until=lambda state: None) for motion in (way, *targets)),
        ]
        for call in calls:
            with pytest.raises(StoppedError, match=r"stopped.*resume"):
                call()
    assert angle(arm) == pytest.approx(here, abs=0.01)
    assert arm.read().stopped


def test_a_stop_voids_a_motion_that_was_asked_for_before_it_and_is_still_planned(
    arm: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever another thread does between the call and the first set-point."""
    before = angle(arm)

    def meanwhile(robot: RobotDriver) -> dict[str, float]:
        arm.stop()
        arm.resume()
        monkeypatch.undo()
        return read_start(robot)

    monkeypatch.setattr(verbs, "read_start", meanwhile)
    with pytest.raises(StoppedError):
        arm.move({joint_of(arm): deg(10)}, relative=True)
    assert angle(arm) == pytest.approx(before, abs=deg(1))


def test_a_motion_that_ends_voids_nothing_that_others_have_asked_for(arm: Arm) -> None:
    asked = arm.driver.epochs.mark()
    arm.move({joint_of(arm): deg(3)}, relative=True)
    sent_away(arm).cancel()
    assert arm.driver.epochs.holds(asked)
    arm.stop()
    assert not arm.driver.epochs.holds(asked)


def test_a_block_that_raises_cancels_its_motion_and_another_waits_for_it(arm: Arm) -> None:
    with pytest.raises(ZeroDivisionError), sent_away(arm) as motion:
        raise ZeroDivisionError
    assert motion.done
    assert not arm.read().stopped
    with arm.move({joint_of(arm): deg(3)}, relative=True, wait=False) as motion:
        pass
    assert motion.wait().arrived


def test_ctrl_c_while_the_program_waits_stops_the_arm(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = sent_away(arm)

    def pressed(timeout: float | None = None) -> bool:
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(motion._over, "wait", pressed)
    with pytest.raises(KeyboardInterrupt):
        motion.wait()
    assert arm.read().stopped
    with pytest.raises(StoppedError):
        motion.wait()


# -- the gripper --------------------------------------------------------------------------------------------------


def test_the_gripper_opens_and_closes(arm: Arm) -> None:
    if arm.model.name == "puma260":
        with pytest.raises(UsageError, match="no gripper"):
            arm.open()
        return
    assert arm.open().opening == pytest.approx(1.0, abs=0.12)
    half = arm.grip(0.5)
    assert (half.holds, half.opening) == (False, pytest.approx(0.5, abs=0.12))
    assert arm.opening == pytest.approx(half.opening, abs=0.05)
    for measured in (1.00001, -0.00001, arm.opening):
        assert not arm.grip(measured).holds
    with arm.close(wait=False) as motion:
        assert isinstance(motion, MotionHandle)
    assert motion.wait().opening == pytest.approx(0.0, abs=0.12)


def test_the_gripper_moves_together_with_the_arm(arm: Arm) -> None:
    joint = joint_of(arm)
    if arm.model.name == "puma260":
        with pytest.raises(UsageError, match="no gripper"):
            arm.move({joint: deg(5)}, relative=True, grip="open")
        return
    before = angle(arm)
    moved = arm.move({joint: deg(10)}, relative=True, grip="open")
    assert (moved.arrived, moved.holds, moved.opening) == (True, False, pytest.approx(1.0, abs=0.12))
    assert angle(arm) - before == pytest.approx(deg(10), abs=deg(2))
    # The pose has a place for the gripper, too.
    arm.poses.save("there", force=True)
    try:
        assert arm.goto("home", "there", grip=0.5).opening == pytest.approx(0.5, abs=0.12)
    finally:
        del arm.poses["there"]
    with arm.line((0, 0, -mm(10)), relative=True, tip_speed=0.2, grip="close", wait=False) as motion:
        assert motion.duration >= 0.8
    assert motion.wait().opening == pytest.approx(0.0, abs=0.12)
    with pytest.raises(UsageError, match="is the gripper: give its angle, or how far it opens, not both"):
        arm.move({arm.model.names[-1]: 0.0}, grip=0.5)


# -- poses, by hand, and recordings -------------------------------------------------------------------------------


def test_poses_are_those_of_the_command_line(arm: Arm) -> None:
    from hexwire.control.requests.pose_file import PoseFile

    joint = joint_of(arm)
    arm.move({joint: deg(5)}, relative=True)
    assert arm.poses.save("here") == "here"
    assert set(arm.poses) == {"home", "here"} == set(PoseFile(arm.model).known())
    with pytest.raises(UsageError, match="already"):
        arm.poses.save("here")
    arm.home()
    arm.move("here")
    assert angle(arm) == pytest.approx(arm.poses["here"][joint], abs=deg(2))
    arm.poses["there"] = {joint: 0.1}
    assert dict(arm.poses["there"]) == {joint: pytest.approx(0.1)}
    del arm.poses["here"], arm.poses["there"]
    assert len(arm.poses) == 1
    with pytest.raises(KeyError):
        del arm.poses["home"]


def test_what_is_recorded_while_it_moves_is_played(arm: Arm, tmp_path: Path) -> None:
    joint, file = joint_of(arm), tmp_path / "states.mcap"
    with arm.record(file) as recording:
        arm.move({joint: deg(10)}, relative=True)
        arm.home()
    count = recording.wait()
    states = list(read_joint_states(str(file), whole=True))
    assert len(states) == count > 2
    rows = [state.position[state.names.index(joint)] for state in states]
    assert max(rows) - min(rows) > deg(2)
    with pytest.raises(UsageError, match="exists; force=True overwrites"):
        arm.record(file)
    result = arm.play(file, factor=0.5, trim=True, smooth=0.1)
    assert result.arrived
    assert result.rest is not None


def test_a_path_that_an_earlier_program_left_goes_on_beside_a_motion_of_other_joints(tmp_path: Path) -> None:
    with connected("board", tmp_path) as arm:
        arm.home()
        path = arm.driver.path(["J1", "J2"], outlives=True)  # type: ignore[attr-defined]  # a board has paths
        here = arm.read()
        start, rest = tuple(here[name].position for name in path.joints), (0.0, 0.0)
        path.send([TimedPoint(6.0 * i, start, rest) for i in range(10)], last=True)
        path.start()
        assert arm.move({"J4": deg(2)}, relative=True).arrived
        with pytest.raises(UsageError, match="still moving: J2"):
            arm.move({"J1": deg(2)}, relative=True)
        assert arm.driver.left_path() == ("J1", "J2")  # type: ignore[attr-defined]
        assert arm.move({"J1": deg(2), "J2": deg(2)}, relative=True).arrived
        assert arm.driver.left_path() == ()  # type: ignore[attr-defined]


def test_states_come_at_their_rate_while_the_arm_moves(arm: Arm) -> None:
    motion = sent_away(arm)
    stamps = [state.stamp for state in arm.states(20.0, seconds=1.0)]
    assert len(stamps) <= 21
    assert all(a <= b for a, b in pairwise(stamps))
    motion.cancel()


def test_a_lesson_has_no_torque_and_ends_holding(arm: Arm) -> None:
    with arm.teach() as lesson:
        eventually(lambda: not arm.read().torque_on)
        with pytest.raises(UsageError, match=r"is being taught: end\(\) the lesson"):
            arm.home()
        eventually(lambda: len(lesson._states) > 3)
    assert set(arm.read().torque_on) == set(arm.model.names)
    assert lesson.taught.names == arm.model.names
    assert arm.play(lesson).arrived
    assert arm.play(lesson.taught).arrived


def test_a_lesson_is_recorded_at_its_rate(arm: Arm) -> None:
    with arm.teach(rate=5.0, seconds=1.0) as lesson:
        lesson.wait()
    assert len(lesson._states) <= 7


def test_a_lesson_that_cannot_begin_leaves_the_arm_free(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(arm.driver, "torque", lambda on, joints=None: ())
    with pytest.raises(HexwireError):
        arm.teach()
    monkeypatch.undo()
    assert arm.home().arrived


# -- torque -------------------------------------------------------------------------------------------------------


def test_torque_is_switched_for_all_or_some_and_a_motion_switches_it_on(arm: Arm) -> None:
    arm.torque(False)
    assert not arm.read().torque_on
    result = arm.move({joint_of(arm): deg(2)}, relative=True)
    assert joint_of(arm) in result.powered
    arm.torque()
    assert set(arm.read().torque_on) == set(arm.model.names)
    with pytest.raises(UsageError, match="no joint"):
        arm.torque(True, "J99")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["shared bus", "shared board"])
def test_a_lease_that_was_lost_is_taken_again_unless_another_program_holds_it(kind: str, tmp_path: Path) -> None:
    with connected(kind, tmp_path) as arm:
        arm.torque()
        other = Arm(make_driver("zenoh:lab/a"), speed=1.0)
        other.driver.attach()
        with other:
            verbs: list[Callable[[], object]] = [
                partial(arm.move, {joint_of(arm): deg(2)}, relative=True),
                partial(arm.goto, "home"),
                partial(arm.line, (0, 0, -mm(3)), relative=True, tip_speed=0.2),
                arm.home,
                partial(arm.grip, 0.5),
                arm.torque,
                arm.teach,
                partial(arm.torque, False),
            ]
            for verb in verbs:
                other.driver.take(force=True)
                with pytest.raises(
                    LeaseError, match=r"holds the lease.*take it with arm\.driver\.take\(force=True\)"
                ):
                    verb()
                other.driver.release()
                done = verb()
                if isinstance(done, Lesson):
                    done.end()


# -- connecting and leaving ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{"speed": 0}, {"speed": 2}, {"table": math.nan}, {"rest": "nowhere"}])
def test_wrong_options_leave_no_arm_behind(options: dict[str, object]) -> None:
    with pytest.raises(HexwireError):
        hexwire.connect("sim://hex7bot", **options)  # type: ignore[arg-type]


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> RobotDriver:
    """The driver of an arm that is not connected, whose joints are at home."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    driver = make_driver("sim://hex7bot")
    driver.read = lambda: at_rest(driver.model, tuple(HOME.values()))  # type: ignore[method-assign]
    return driver


@pytest.mark.parametrize("error", [None, ZeroDivisionError])
def test_without_a_pose_to_rest_in_the_end_switches_no_torque_off(
    idle: RobotDriver, error: type[BaseException] | None
) -> None:
    ends: list[bool] = []
    idle.detach = lambda *, torque_off=False: ends.append(torque_off)  # type: ignore[method-assign]
    with nullcontext() if error is None else pytest.raises(error), Arm(idle):
        if error is not None:
            raise error
    assert ends == [False]


def test_an_arm_rests_in_the_pose_that_is_named(idle: RobotDriver) -> None:
    arm = Arm(idle)
    arm.poses["low"] = {"J1": 0.1}
    assert Arm(idle, rest="low")._rest == {"J1": pytest.approx(0.1)}
    assert arm._rest is None


def test_a_pose_is_saved_where_the_arm_is_and_replaced_only_by_force(idle: RobotDriver) -> None:
    poses = Arm(idle).poses
    assert poses.save("here") == "here"
    assert poses["here"]["J1"] == pytest.approx(HOME["J1"])
    idle.read = lambda: at_rest(idle.model, (0.2, *tuple(HOME.values())[1:]))  # type: ignore[method-assign]
    with pytest.raises(UsageError, match="already"):
        poses.save("here")
    poses.save("here", force=True)
    assert poses["here"]["J1"] == pytest.approx(0.2)


def test_an_arm_is_drawn_where_it_is_or_in_a_state(idle: RobotDriver) -> None:
    arm = Arm(idle)
    assert arm.picture() == arm.picture(idle.read())
    assert arm.picture() != arm.picture(at_rest(idle.model, (0.2, *tuple(HOME.values())[1:])))


@pytest.mark.parametrize("limp", [("gripper",), ()])
def test_at_the_end_what_was_made_limp_stays_so(tmp_path: Path, limp: tuple[str, ...]) -> None:
    gave: list[tuple[str, ...]] = []
    with connected("bus", tmp_path) as arm:
        arm._rest = arm.poses["home"]
        arm.move({joint_of(arm): deg(10)})
        arm.torque(False, *limp)
        there, torque = angle(arm), arm.driver.torque
        arm.driver.torque = lambda on, joints=None: (gave.append((on, joints)), torque(on, joints))[1]  # type: ignore
        last: list[float] = []
        detach = arm.driver.detach
        arm.driver.detach = lambda *, torque_off=False: (  # type: ignore[method-assign]
            last.append(angle(arm) if arm.driver.is_attached else last[-1]),
            detach(torque_off=torque_off),
        )[1]
    assert not gave
    assert last[0] == pytest.approx(0.0 if limp else there, abs=deg(2))


def test_at_the_end_the_arm_rests_without_torque_if_it_is_told_to(tmp_path: Path) -> None:
    with connected("board", tmp_path) as arm:
        arm._rest = arm.poses["home"]
        arm.move(J1=deg(10))
        seen: list[bool] = []
        detach = arm.driver.detach
        arm.driver.detach = lambda *, torque_off=False: (  # type: ignore[method-assign]
            seen.append(torque_off and abs(angle(arm) - arm.poses["home"]["J1"]) < deg(2)),
            detach(torque_off=torque_off),
        )[1]
    assert seen == [True]
    assert not arm.driver.is_attached
    for call in (arm.read, arm.home):
        with pytest.raises(UsageError, match=r"connect\(\) again"):
            call()


@pytest.mark.parametrize(("kind", "stops"), [(ZeroDivisionError, False), (KeyboardInterrupt, True)])
def test_an_exception_in_the_block_cancels_what_goes_on_and_ctrl_c_stops_it(
    tmp_path: Path, kind: type[BaseException], stops: bool
) -> None:
    found: list[tuple[bool, bool]] = []

    def work(arm: Arm) -> None:
        detach = arm.driver.detach

        def seen(*, torque_off: bool = False) -> None:
            if arm.driver.is_attached:
                found.append((motion.done, arm.read().stopped))
            detach(torque_off=torque_off)

        arm.driver.detach = seen  # type: ignore[method-assign]
        motion = sent_away(arm)
        raise kind

    with connected("board", tmp_path) as arm, pytest.raises(kind), arm:
        work(arm)
    assert found == [(True, stops)]


def test_a_failure_that_nobody_waited_for_is_raised_at_the_end(tmp_path: Path) -> None:
    def work(arm: Arm) -> None:
        motion = sent_away(arm)
        arm.stop()
        eventually(lambda: motion.done)

    with connected("board", tmp_path) as arm, pytest.raises(StoppedError), arm:
        work(arm)


def test_a_failure_that_the_program_has_handled_is_not_raised_again_at_the_end(tmp_path: Path) -> None:
    with connected("board", tmp_path) as arm, arm:
        motion = sent_away(arm)
        arm.stop()
        with pytest.raises(StoppedError):
            motion.wait()


def test_ctrl_c_while_the_end_of_the_block_waits_is_what_comes_out(tmp_path: Path) -> None:
    stopped: list[bool] = []

    def work(arm: Arm) -> None:
        motion, detach = sent_away(arm), arm.driver.detach

        def seen(*, torque_off: bool = False) -> None:
            if arm.driver.is_attached:
                stopped.append(arm.read().stopped)
            detach(torque_off=torque_off)

        def pressed(timeout: float | None = None) -> bool:
            del motion._over.wait  # type: ignore[method-assign]
            raise KeyboardInterrupt

        arm.driver.detach = seen  # type: ignore[method-assign]
        motion._over.wait = pressed  # type: ignore[method-assign]

    with connected("board", tmp_path) as arm, pytest.raises(KeyboardInterrupt), arm:
        work(arm)
    assert stopped == [True]


def test_a_failure_that_nobody_waited_for_is_logged_by_the_next_motion(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with connected("bus", tmp_path) as arm:
        motion = sent_away(arm)
        arm.stop()
        eventually(lambda: motion.done)
        arm.resume()
        assert "nobody had waited for it" not in caplog.text
        arm.home()
    assert caplog.text.count("nobody had waited for it") == 1


def test_an_arm_without_a_watchdog_warns_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire.arm")
    with connected("bus", tmp_path) as arm:
        for _ in range(2):
            arm.move({joint_of(arm): deg(2)}, relative=True)
    assert caplog.text.count("has no watchdog") == 1


@few(
    "most, late",
    [(None, 0.1), (deg(180), 14.0), ({"shoulder_pan": deg(180)}, 14.0)],
    ({"shoulder_pan": deg(180)}, 14.0),
)
def test_an_arm_follows_as_fast_as_its_servos_can_or_may(
    monkeypatch: pytest.MonkeyPatch, most: float | dict[str, float] | None, late: float
) -> None:
    swing = Swing(1.0)
    default(monkeypatch, run_following, sleep=swing.sleep)
    with swing.leader, swing.follower:
        Arm(swing.follower, table=None).follow(Arm(swing.leader), max_speed=most)
    assert 0.8 * late - 0.1 < swing.late < late


def test_two_emulated_arms_of_one_address_are_two_arms() -> None:
    with connect("sim://so101") as leader, connect("sim://so101") as follower:
        with follower.follow(leader, wait=False) as following:
            eventually(lambda: set(follower.read().torque_on) == set(follower.model.names))
            assert not following.done
        assert not leader.read().torque_on


def test_one_arm_follows_another_until_the_block_ends(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with connected("bus", tmp_path / "a") as leader, connected("bus", tmp_path / "a") as follower:
        started = threading.Event()
        with follower.follow(leader, wait=False) as following:
            assert following.progress == 0
            eventually(lambda: not leader.read().torque_on)
            eventually(lambda: set(follower.read().torque_on) == set(follower.model.names))
            started.set()
            with pytest.raises(UsageError, match=r"follows another: end\(\) that"):
                follower.home()
        assert following.progress == 1
        following.cancel()
        assert following.done
        assert set(follower.read().torque_on) == set(follower.model.names)
        assert not follower.read().stopped
        assert follower.home().arrived
