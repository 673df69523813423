"""The verbs of an arm: the same promises on every kind of it."""

from __future__ import annotations

import logging
import math
import re
import tempfile
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from tests.arm.arms import KINDS, connected
from tests.waits import eventually

import hexwire
from hexwire import Arm, deg, mm
from hexwire.arm import verbs
from hexwire.arm.handle import MotionHandle
from hexwire.control.motions import MotionResult
from hexwire.control.reader import read_start
from hexwire.drivers.base import RobotDriver
from hexwire.errors import HexwireError, StoppedError, UsageError
from hexwire.motion.through import arm_path
from hexwire.trace.recording import read_joint_states

QUICK = ("board", "bus")


@pytest.fixture(
    scope="module", params=[kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS]
)
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


def test_points_are_passed_without_a_stop_between_them(arm: Arm) -> None:
    joint, here = joint_of(arm), angle(arm)
    motion = arm.goto({joint: here + deg(15)}, {joint: here + deg(30)}, "home", wait=False)
    speeds = []
    while not motion.done:
        state = arm.read()
        speeds.append((state[joint].position - here, state[joint].velocity))
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
    "no pose": (lambda arm: arm.move("nowhere"), "no pose 'nowhere' of .*; known are: home"),
    "no pose among points": (lambda arm: arm.goto("nowhere"), "no pose 'nowhere'"),
    "too short": (lambda arm: arm.move({joint_of(arm): deg(5)}, relative=True, duration=0.01), "too short"),
    "no duration": (lambda arm: arm.move({joint_of(arm): deg(5)}, relative=True, duration=math.nan), "too short"),
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
    "nothing to play": (lambda arm: arm.play(None), "play.. takes a file, lesson.taught"),  # type: ignore[call-overload]
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
    "played never": (lambda arm: arm.play("none.mcap", repeat=0), "at least once"),
    "itself": (lambda arm: arm.follow(arm), "cannot follow itself"),
    "no MCAP": (lambda arm: arm.record("states.txt"), "must end in .mcap"),
    "a lesson without MCAP": (lambda arm: arm.teach("states.txt"), "must end in .mcap"),
    "wide open": (lambda arm: arm.grip(50), "gripper"),
    "force in percent": (lambda arm: arm.close(force=25), "a share of full effort"),
    "half": (lambda arm: arm.grip("half"), "'open', 'close' or an opening"),  # type: ignore[call-overload]
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
    with arm.close(wait=False) as motion:
        assert isinstance(motion, MotionHandle)
    assert motion.wait().opening == pytest.approx(0.0, abs=0.12)


# -- poses, by hand, and recordings -------------------------------------------------------------------------------


def test_poses_are_those_of_the_command_line(arm: Arm) -> None:
    from hexwire.control.pose_file import PoseFile

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
    with pytest.raises(UsageError, match=r"lesson\.taught"):
        arm.play(lesson)  # type: ignore[call-overload]
    assert arm.play(lesson.taught).arrived


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


# -- connecting and leaving ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{"speed": 0}, {"speed": 2}, {"table": math.nan}, {"rest": "nowhere"}])
def test_wrong_options_leave_no_arm_behind(options: dict[str, object]) -> None:
    with pytest.raises(HexwireError):
        hexwire.connect("sim://hex7bot", **options)  # type: ignore[arg-type]


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


def test_one_arm_follows_another_until_the_block_ends(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with connected("bus", tmp_path / "a") as leader, connected("bus", tmp_path / "a") as follower:
        started = threading.Event()
        with follower.follow(leader, wait=False) as following:
            eventually(lambda: not leader.read().torque_on)
            eventually(lambda: set(follower.read().torque_on) == set(follower.model.names))
            started.set()
            with pytest.raises(UsageError, match=r"follows another: end\(\) that"):
                follower.home()
        assert following.done
        assert set(follower.read().torque_on) == set(follower.model.names)
        assert not follower.read().stopped
        assert follower.home().arrived
