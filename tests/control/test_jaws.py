"""A gripper that opens or closes while the arm moves; in simulated time."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from tests.control.test_motions import Bench, Watched
from tests.control.test_timed_motion import Timed
from tests.defaults import default

from hexwire.control.loop.owner import RobotOwner
from hexwire.control.loop.reader import StateReader
from hexwire.control.motion.motions import MotionOptions, MotionResult, check_path, run_grip, run_motion
from hexwire.drivers.tools import Gripper
from hexwire.errors import PreemptedError, StoppedError, UsageError
from hexwire.model.state import JointState, JointTarget

BENCHES = {"the board's time": Timed, "target by target": Bench, "dialect 1": lambda: Bench(dialect=1)}


@pytest.fixture(params=[*list(BENCHES)[:2], pytest.param("dialect 1", marks=pytest.mark.slow)])
def bench(request: pytest.FixtureRequest) -> Any:
    return BENCHES[request.param]()


def run(bench: Any, grip: float, do: Any = lambda state: None, until: Any = None, **way: Any) -> MotionResult:
    options = bench.options(grace=9.0)
    path = check_path(bench.robot, bench.way(**{"seconds": 2.0, **way}), options, grip=grip)
    return run_motion(bench.robot, path, options, observer=Watched(do), until=until)


def alone(bench: Any, grip: float, do: Any = lambda state: None) -> tuple[MotionResult, Watched]:
    """The gripper moves, and nothing else."""
    watched = Watched(do)
    with pytest.MonkeyPatch.context() as patch:
        default(patch, MotionOptions, clock=bench.arm.clock, sleep=bench.arm.wait)
        return run_grip(bench.robot, grip, observer=watched), watched


def share(bench: Any) -> float:
    return Gripper(bench.robot).share(bench.robot.read())


def test_both_arrive_and_move_at_the_same_time(bench: Any) -> None:
    assert run(bench, 0.0).arrived
    rows = []
    result = run(bench, 1.0, lambda state: rows.append((state["J4"].position, state["J7"].position)), seconds=4.0)
    assert (result.arrived, result.holds, result.why) == (True, False, "")
    assert result.opening == pytest.approx(1.0, abs=0.12)
    assert share(bench) == pytest.approx(1.0, abs=0.05)
    moved = [abs(b[0] - a[0]) > 0.002 and abs(b[1] - a[1]) > 0.002 for a, b in pairwise(rows)]
    assert any(moved), rows


def test_jaws_that_meet_an_object_hold_it_and_the_arm_goes_on(bench: Any) -> None:
    run(bench, 1.0)
    shaft = bench.arm.board.wire.servos[6].motion
    shaft.obstacle = (None, shaft.position + 500)
    begin = bench.robot.read()["J4"].position
    result = run(bench, 0.0, by=-0.5, seconds=4.0)
    assert (result.arrived, result.holds, result.why) == (True, True, "")
    assert result.opening == pytest.approx(0.5, abs=0.05)
    assert bench.robot.read()["J4"].position == pytest.approx(begin - 0.5, abs=0.02)
    assert not bench.robot.read().stopped
    if bench.robot.dialect == 1:
        # Its states come so slowly that the servo protects itself before.
        return
    # Three degrees further than it got: little pressure.
    assert shaft.target - shaft.position == pytest.approx(34, abs=3)


@pytest.mark.parametrize("kind", list(BENCHES)[:2])
def test_jaws_alone_hold_what_they_meet_in_the_same_way(kind: str) -> None:
    bench: Any = BENCHES[kind]()
    alone(bench, 1.0)
    shaft = bench.arm.board.wire.servos[6].motion
    shaft.obstacle = (None, shaft.position + 500)
    before = len(bench.targets)
    result, watched = alone(bench, 0.0)
    assert (result.arrived, result.cut, result.holds, result.stopped) == (False, True, True, None)
    assert result.opening == pytest.approx(0.5, abs=0.05)
    assert [row for row in watched.said if row[0] == "sent"] == [("sent", ["J7"])], "what was asked for"
    relief = bench.targets[-1][1]
    assert (relief.duration, len(bench.targets) > before + 1) == (0.2, True)
    assert shaft.target - shaft.position == pytest.approx(34, abs=3)


def met(runs: Any, stop_at: int) -> tuple[Bench, MotionResult, list[float]]:
    """Jaws that meet an object, stopped at one of the states meanwhile; and when these were seen."""
    bench, seen = Bench(), list[float]()
    alone(bench, 1.0)
    shaft = bench.arm.board.wire.servos[6].motion
    shaft.obstacle = (None, shaft.position + 500)

    def stop(state: Any) -> None:
        seen.append(bench.arm.clock.time)
        if len(seen) == stop_at:
            bench.robot.stop()

    found = runs(bench, 0.0, stop)
    return bench, found[0] if isinstance(found, tuple) else found, seen


@pytest.mark.parametrize("runs", [run, alone])
def test_a_stop_near_the_moment_at_which_they_meet_an_object_is_the_last_word(runs: Any) -> None:
    bench, result, seen = met(runs, 0)
    assert result.holds
    relieved = max(t for t, sent in bench.targets if "J7" in dict(sent.positions))
    # It takes some steps.
    last = sum(t <= relieved for t in seen)
    for stop_at in range(last - 7, min(last + 2, len(seen))):
        bench, result, seen = met(runs, stop_at)
        assert result.stopped is not None
        assert bench.targets[-1][0] <= seen[stop_at - 1]


def test_it_has_arrived_when_both_have(bench: Any) -> None:
    run(bench, 1.0)
    result = run(bench, 0.0, by=0.02, seconds=0.3)
    assert result.arrived
    assert share(bench) == pytest.approx(0.0, abs=0.05)


def test_jaws_that_do_not_arrive_are_named(bench: Any) -> None:
    run(bench, 0.0)
    shaft = bench.arm.board.wire.servos[6].motion
    shaft.obstacle = (shaft.position - 300, None)
    # Opening, they hold nothing.
    result = run(bench, 1.0)
    assert not result.holds
    assert not result.arrived
    assert "J7 is" in result.why


def test_what_is_ended_holds_with_its_jaws(bench: Any) -> None:
    run(bench, 1.0)
    opened = bench.robot.read()["J7"].position
    result = run(bench, 0.0, until=lambda state: state["J7"].position > opened + 0.1, by=-0.5, seconds=8.0)
    assert result.cut
    before = bench.robot.read().positions
    bench.arm.wait(2.0)
    after = bench.robot.read().positions
    assert after["J4"] == pytest.approx(before["J4"], abs=0.03)
    # Where the last state of jaws that close fast was.
    assert after["J7"] == pytest.approx(before["J7"], abs=0.15)
    if bench.robot.dialect != 1:
        assert after["J7"] < opened + 1.0, "they were on their way to 1.57"


def test_a_stop_ends_both(bench: Any) -> None:
    run(bench, 1.0)
    begun = bench.arm.clock.time

    def stop(state: Any) -> None:
        if bench.arm.clock.time > begun + 3.0 and not state.stopped:
            bench.robot.stop()

    result = run(bench, 0.0, stop, by=-0.5, seconds=8.0)
    assert result.stopped is not None
    with pytest.raises(StoppedError, match="stopped"):
        run(bench, 0.5)


@pytest.mark.parametrize(
    ("grip", "joint", "says"),
    [
        (1.5, "J4", "opening is from 0"),
        (0.5, "J7", "J7 is the gripper: give its angle, or how far it opens, not both"),
    ],
)
def test_what_is_not_possible_is_refused_before_anything_moves(grip: float, joint: str, says: str) -> None:
    bench = Bench()
    with pytest.raises(UsageError, match=says):
        check_path(bench.robot, bench.way(joint, -0.1), bench.options(), grip=grip)
    assert not bench.targets


def test_a_program_that_is_late_before_its_motion_begins_asks_where_the_arm_is(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever that is: a slow computer plans for longer than a state is new."""
    newest, calls = RobotOwner.newest, 0

    def late(owner: RobotOwner) -> JointState:
        nonlocal calls
        calls += 1
        if calls == when:
            bench.arm.wait(2.8)
        return newest(owner)

    monkeypatch.setattr(RobotOwner, "newest", late)
    options = bench.options(grace=9.0, watchdog=30.0)
    by, when, stalls = 0.1, 0, 0
    while calls >= when:
        stalls += bool(when)
        calls, when, by = 0, when + 1, -by
        path = check_path(bench.robot, bench.way(seconds=1.0, by=by), options, grip=0.5 + 3 * by)
        result = run_motion(bench.robot, path, options)
        assert (result.arrived, result.why) == (True, ""), when
        result = run_motion(bench.robot, check_path(bench.robot, bench.way(seconds=1.0, by=by), options), options)
        assert (result.arrived, result.why) == (True, ""), when
        target = JointTarget.of({"J4": bench.robot.read()["J4"].position - 2 * by}, 1.0)
        result = run_motion(bench.robot, target, options)
        assert (result.arrived, result.why) == (True, ""), when
    assert stalls > 2


def test_a_motion_that_is_stopped_before_its_first_state_asks_for_no_other(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = bench.options(grace=9.0)
    here = bench.robot.read()["J4"].position
    motions = [
        check_path(bench.robot, bench.way(seconds=1.0), options),
        check_path(bench.robot, bench.way(seconds=1.0), options, grip=0.5),
        JointTarget.of({"J4": here + 0.1}, 1.0),
    ]
    for motion in motions:
        with monkeypatch.context() as patch:
            asked = 0

            def preempted(reader: StateReader) -> JointState:
                nonlocal asked
                asked += 1
                raise PreemptedError("a stop came first")

            patch.setattr(StateReader, "next", preempted)
            result = run_motion(bench.robot, motion, options)
        assert (result.arrived, asked) == (False, 1)
        assert result.stopped is not None
