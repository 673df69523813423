"""What is decided when several arms are to move together, with arms of the test's own and in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from tests.motion.arms import HOME, at_rest

from hexwire.errors import DeviceError, HexwireError, LeaseError, LinkLostError, ServoError, UsageError
from hexwire.fleet import messages as m
from hexwire.fleet import player as module
from hexwire.fleet.player import FleetMotionError, PlayedArm, PlayReport, SilentError, play_together
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.trajectory import Spline, Waypoint

NAMES = ("lab/arm1", "lab/arm2")
APPROACH, MOTION = 1, 2
"""Numbers of what an arm follows first and then."""


class HangsError(Exception):
    """A call that does not return."""


class Stage:
    """The arms and the time in which they are asked one after the other.

    Attributes:
        events: What was called, in order: arm and call.
        told: What was said.
        shielded: Arms were stopped behind the shield.
        over: Those that watch arms have been told that it is over.
        given_up: When an arm that does not answer is given up, by what it is asked first.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        self.events: list[tuple[str, str]] = []
        self.told: list[str] = []
        self.shielded = self.over = False
        self.given_up: dict[str, float] = {}
        self.arms = {name: FakeRobot(self, name) for name in NAMES}
        monkeypatch.setattr(module, "time", self)
        monkeypatch.setattr(module, "threading", SimpleNamespace(Event=lambda: self))
        monkeypatch.setattr(module, "each_of", self.each_of)

    # As a clock and as an event that does not come.

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def wait(self, seconds: float) -> bool:
        self.now += seconds
        return False

    def set(self) -> None:
        self.over = True

    def each_of(
        self, arms: Mapping[str, Any], call: Callable[[Any], Any], patience: float, *, together: bool = False
    ) -> tuple[dict[str, Any], dict[str, HexwireError]]:
        done: dict[str, Any] = {}
        failed: dict[str, HexwireError] = {}
        until, before = self.now + patience, len(self.events)
        for name, arm in arms.items():
            try:
                done[name] = call(arm)
            except HexwireError as error:
                failed[name] = error
                if together:
                    break
            except HangsError:
                failed[name] = SilentError(f"no answer in {patience:.1f} s")
        if len(self.events) > before:
            self.given_up[self.events[before][1]] = until
        return done, failed

    def play(self, *, path: Spline | None = None, **options: Any) -> PlayReport:
        path = path or way()
        return play_together(
            [PlayedArm(robot, path) for robot in self.arms.values()],  # type: ignore[arg-type]  # drivers
            tell=self.told.append,
            shield=self.shield,
            **options,
        )

    @contextmanager
    def shield(self) -> Iterator[None]:
        self.shielded = True
        yield

    def called(self, what: str) -> list[str]:
        """The arms of which this was asked."""
        return [name for name, call in self.events if call == what]


class FakeRobot:
    """An arm that is at home, has no torque, and does what it is told at once.

    Attributes:
        errors: What its calls raise.
        row: What is known of what it follows.
    """

    model = HEX7BOT

    def __init__(self, stage: Stage, name: str) -> None:
        self.address, self.url = SimpleNamespace(name=name), f"zenoh:{name}"
        self._stage, self._name = stage, name
        self.errors: dict[str, BaseException] = {}
        self.offsets: list[tuple[float, float]] = [(0.5, 0.001)]
        self.states: list[JointState] = [self.state(0)]
        self.followed: list[tuple[Spline, float, dict[str, bool]]] = []
        self.confirmed: set[int] = set()
        self.row: Callable[[int], m.Goal] = self.obedient

    def state(self, flag: int) -> JointState:
        state = at_rest(HEX7BOT, tuple(HOME.values()))
        return replace(state, flags=(flag,) * len(state.names))

    def obedient(self, number: int) -> m.Goal:
        start = self.followed[number - 1][1] + 0.5
        if number not in self.confirmed:
            return m.Goal(number, start, ready="board", doubt=0.0002)
        return m.Goal(number, start, "succeeded", moved=start + 0.01, ready="board", doubt=0.0002)

    def _call(self, what: str) -> None:
        self._stage.events.append((self._name, what))
        if what in self.errors:
            raise self.errors[what]

    @property
    def clock_offset(self) -> tuple[float, float]:
        return self.offsets.pop(0) if len(self.offsets) > 1 else self.offsets[0]

    def now(self) -> float:
        return self._stage.now

    def read(self) -> JointState:
        return self.states.pop(0) if len(self.states) > 1 else self.states[0]

    def take(self, *, force: bool) -> None:
        self._call("take by force" if force else "take")

    def release(self) -> None:
        self._call("release")

    def check_path(self, path: Spline) -> None:
        self._call("check")

    def watchdog(self, timeout: float) -> None:
        self._call(f"watchdog {timeout:g}")

    def torque(self, on: bool, names: list[str]) -> tuple[str, ...]:
        self._call("torque")
        return tuple(names)

    def follow(self, path: Spline, start: float, **options: bool) -> int:
        self.followed.append((path, start, options))
        self._call(f"follow {len(self.followed)}")
        return len(self.followed)

    def goal(self, number: int) -> m.Goal:
        self._call(f"goal {number}")
        return self.row(number)

    def confirm(self, number: int) -> None:
        self._call(f"confirm {number}")
        self.confirmed.add(number)

    def cancel(self, number: int) -> None:
        self._call(f"cancel {number}")

    def stop(self) -> None:
        self._call("stop")

    def stop_own(self) -> None:
        self._call("stop own")


def way(by: float = 0.2, seconds: float = 1.0, joint: str = "J1") -> Spline:
    """There and back from home."""
    start = HOME.get(joint, 0.0)
    points = [(0.0, start), (0.5 * seconds, start + by), (seconds, start)]
    return Spline((joint,), [Waypoint(t, (angle,), (0.0,)) for t, angle in points])


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Stage:
    return Stage(monkeypatch)


# -- what goes well ------------------------------------------------------------------------------------------------


def test_nothing_begins_before_all_are_ready_and_the_leases_are_given_back(stage: Stage) -> None:
    began = stage.now
    report = stage.play()
    calls = [call for _, call in stage.events]
    assert calls[:6] == ["take"] * 2 + ["check"] * 4
    assert calls[6:10] == ["watchdog 1"] * 2 + ["torque"] * 2
    for number in (APPROACH, MOTION):
        follow, confirm = f"follow {number}", f"confirm {number}"
        assert stage.called(follow) == stage.called(confirm) == list(NAMES)
        ready = max(
            i for i, call in enumerate(calls) if call in (follow, f"goal {number}") and i < calls.index(confirm)
        )
        assert calls[ready + 1 :][:2] == [confirm] * 2
    assert calls[-2:] == ["release"] * 2
    assert not {"stop", "stop own", "cancel 1", "cancel 2"} & set(calls)
    for robot in stage.arms.values():
        (lead, start, options), (path, at, more) = robot.followed
        assert (options, more) == ({"anywhere": True, "confirm": True}, {"anywhere": False, "confirm": True})
        # At the same time for all, and far enough ahead for a refusal to reach the others.
        assert start == at == began + 1.4
        assert lead.names == path.names == HEX7BOT.names, "joints without a motion of their own rest"
        assert all(
            position == pytest.approx(HOME[name])
            for point in path.waypoints
            for name, position in zip(path.names, point.position, strict=True)
            if name != "J1"
        )
    (row, _) = report.arms.values()
    assert row.moved == pytest.approx(0.01), "on this program's clock, after the common start"
    assert (row.kept_by, row.late, row.doubt, row.off) == ("board", 0.0002, 0.001, "")
    assert (report.duration, report.skew) == (1.0, 0.0)
    assert [line.partition(":")[0] for line in stage.told] == [*NAMES, "approach", "motion"]


def test_an_arm_that_is_elsewhere_is_led_to_the_start_in_one_sweep(stage: Stage) -> None:
    """Its speed is given at each point, so that it need not be guessed in between."""
    away = way()
    path = Spline(away.names, [replace(point, position=(point.position[0] + 0.5,)) for point in away.waypoints])
    stage.play(path=path)
    (lead, _, _) = stage.arms[NAMES[0]].followed[0]
    joint = lead.names.index("J1")
    speeds = [point.velocity[joint] for point in lead.waypoints if point.velocity]
    assert len(speeds) == len(lead.waypoints) > 3
    assert (speeds[0], speeds[-1]) == pytest.approx((0.0, 0.0))
    assert min(speeds[1:-1]) > 0.0
    (before, here, after) = lead.waypoints[1:4]
    mean = (after.position[joint] - before.position[joint]) / (after.time - before.time)
    assert here.velocity is not None
    assert here.velocity[joint] == pytest.approx(mean, rel=0.2)


@pytest.mark.parametrize("beyond", [0.0, 1e-7, 1e-3])
def test_no_knots_of_the_way_to_the_start_coincide(beyond: float) -> None:
    whole = way(seconds=1.0 + beyond)
    *knots, end = [point.time for point in module._as_spline(whole).waypoints]
    assert end == whole.duration
    assert knots == pytest.approx([0.05 * i for i in range(len(knots))])
    assert end - knots[-1] > 1e-6


def test_an_arm_that_does_not_answer_is_given_up_before_the_start_and_long_after_the_end(stage: Stage) -> None:
    stage.play(path=way(seconds=2.0))
    (_, start, _) = stage.arms[NAMES[0]].followed[1]
    assert stage.given_up["confirm 2"] == pytest.approx(start - 0.1), "in time to cancel the others"
    assert stage.given_up["goal 2"] == pytest.approx(start + 2.0 + 5.0 + 30.0), "after the arm's own time"


def test_the_time_that_servers_need_to_check_is_added_to_the_start(stage: Stage) -> None:
    for robot in stage.arms.values():
        robot.check_path = lambda path: stage.sleep(0.1)  # type: ignore[method-assign,assignment,misc]
    stage.play()
    (_, start, _) = stage.arms[NAMES[0]].followed[0]
    assert start == pytest.approx(1000.4 + 1.4 + 2 * 0.4)


def test_a_dry_run_checks_and_moves_nothing(stage: Stage) -> None:
    report = stage.play(dry_run=True, take=True)
    assert {call for _, call in stage.events} == {"take", "check", "release"}, "nor is a holder pre-empted"
    assert (report.duration, report.arms) == (1.0, {})


def test_a_missed_answer_before_a_motion_is_asked_for_again(stage: Stage) -> None:
    """As of a server whose computer was busy for a moment."""
    robot = stage.arms[NAMES[1]]
    robot.states = [robot.state(int(JointFlag.SILENT)), robot.state(0)]
    assert stage.play().duration == 1.0


def test_a_server_that_keeps_the_time_itself_is_told_of(stage: Stage) -> None:
    robot = stage.arms[NAMES[1]]
    robot.row = lambda number: replace_row(robot.obedient(number), ready="host", doubt=0.05)
    report = stage.play()
    assert stage.told[-1] == "lab/arm2: its server sends the targets: it may begin 50 ms late"
    assert (report.arms[NAMES[1]].kept_by, report.arms[NAMES[1]].late) == ("host", 0.05)


def replace_row(row: m.Goal, **changes: Any) -> m.Goal:
    for name, value in changes.items():
        setattr(row, name, value)
    return row


# -- clocks --------------------------------------------------------------------------------------------------------


def test_a_clock_that_is_known_better_a_moment_later_is_waited_for(stage: Stage) -> None:
    stage.arms[NAMES[1]].offsets = [(0.0, 0.2)] * 100 + [(0.0, 0.001)]
    assert stage.play(dry_run=True).duration == 1.0
    assert 1001.9 < stage.now < 1003.0


def test_arms_whose_clocks_stay_unknown_are_refused(stage: Stage) -> None:
    stage.arms[NAMES[1]].offsets = [(0.0, 0.0123)]
    with pytest.raises(
        FleetMotionError, match=r"no arm moved: lab/arm2: its clock is known to 12\.3 ms only, and 10"
    ):
        stage.play()
    assert not stage.events
    assert stage.now == pytest.approx(1003.0, abs=0.03)
    assert stage.play(most_doubt=0.0123, dry_run=True).duration == 1.0


def test_an_arm_whose_start_is_not_known_well_enough_is_refused(stage: Stage) -> None:
    robot = stage.arms[NAMES[0]]
    robot.row = lambda number: replace_row(robot.obedient(number), doubt=0.05)
    with pytest.raises(
        FleetMotionError, match=r"no arm began: lab/arm1: its start is known to 51\.0 ms only, and 40\.0 ms"
    ) as error:
        stage.play(most_doubt=0.04)
    assert list(error.value.why) == [NAMES[0]]
    # The approach need not begin together.
    assert stage.called("confirm 1") == list(NAMES)
    assert not stage.called("confirm 2")


def test_a_start_that_becomes_known_better_is_waited_for(stage: Stage) -> None:
    robot = stage.arms[NAMES[0]]
    robot.row = lambda number: replace_row(robot.obedient(number), doubt=0.05 if stage.now < 1000.5 else 0.001)
    stage.play()
    assert stage.now > 1000.5


# -- what goes wrong before the start ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ("take", "no arm moved: lab/arm2: not now"),
        ("check", "no arm moved: lab/arm2: not now"),
        ("watchdog 1", "no arm moved: lab/arm2: not now"),
        ("torque", "no arm moved: lab/arm2: not now"),
        ("follow 1", "no arm began: lab/arm2: not now"),
        ("follow 2", "no arm began: lab/arm2: not now"),
        ("confirm 2", "no arm began: lab/arm2: not now"),
    ],
)
def test_if_one_refuses_none_begins(stage: Stage, call: str, text: str) -> None:
    stage.arms[NAMES[1]].errors[call] = HexwireError("not now")
    with pytest.raises(FleetMotionError, match=text):
        stage.play()
    assert set(stage.called("release")) == set(NAMES), "whoever has a lease gives it back"
    assert not stage.called("stop")
    assert not stage.called("stop own")
    if call == "confirm 2":
        # All were ready, and what was prepared is called off.
        assert stage.called("follow 2") == stage.called("cancel 2") == list(NAMES)
    elif call.startswith("follow"):
        assert stage.called(call) == list(NAMES)
        assert stage.called(f"cancel {call[-1]}") == [NAMES[0]]
        assert not stage.called(f"confirm {call[-1]}")


def test_an_arm_that_says_that_its_motion_has_ended_already_is_refused(stage: Stage) -> None:
    robot = stage.arms[NAMES[1]]
    robot.row = lambda number: m.Goal(number, 0.0, "aborted", "path_tolerance", "J1 does not follow")
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: J1 does not follow"):
        stage.play()
    robot.row = lambda number: m.Goal(number, 0.0, "rejected", "too_late")
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: too_late"):
        stage.play()


def test_an_arm_that_is_not_ready_in_time_is_refused(stage: Stage) -> None:
    robot = stage.arms[NAMES[1]]
    robot.row = lambda number: m.Goal(number, 0.0)
    began = stage.now
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: it is not ready in time"):
        stage.play()
    # Early enough for the others to learn of it.
    assert stage.now - began == pytest.approx(1.4 - 0.55, abs=0.03)


def test_an_arm_that_does_not_answer_in_time_is_stopped_and_none_begins(stage: Stage) -> None:
    stage.arms[NAMES[1]].errors["goal 1"] = HangsError()
    with pytest.raises(FleetMotionError, match=r"no arm began: lab/arm2: no answer in 0\.9 s"):
        stage.play()
    # It is not known whether it starts; the other one is only called off.
    assert stage.called("stop") == [NAMES[1]]
    assert set(stage.called("cancel 1")) == set(NAMES)
    assert not stage.called("confirm 1")


def test_an_arm_that_cannot_be_called_off_is_stopped(stage: Stage) -> None:
    stage.arms[NAMES[1]].errors["follow 1"] = HexwireError("not now")
    stage.arms[NAMES[0]].errors["cancel 1"] = LinkLostError("gone", url="")
    with pytest.raises(FleetMotionError, match="no arm began: lab/arm2: not now"):
        stage.play()
    assert stage.called("stop") == [NAMES[0]]


def test_an_arm_that_is_stopped_or_has_no_such_joint_is_refused(stage: Stage) -> None:
    robot = stage.arms[NAMES[1]]
    robot.states = [replace(robot.state(0), stopped=True)]
    with pytest.raises(
        FleetMotionError, match="lab/arm2: it is stopped; 'hexwire --port zenoh:lab/arm2 resume' ends"
    ):
        stage.play()
    robot.states = [robot.state(0)]
    with pytest.raises(FleetMotionError, match="lab/arm1: it has no X1, but J1"):
        stage.play(path=way(joint="X1"))
    assert not stage.called("follow 1")


def test_another_holder_is_named_and_can_be_preempted(stage: Stage) -> None:
    stage.arms[NAMES[1]].errors["take"] = LeaseError("Eve holds the lease")
    with pytest.raises(FleetMotionError, match=r"no arm moved: lab/arm2: .*Eve holds the lease"):
        stage.play()
    assert set(stage.called("release")) == set(NAMES)
    assert stage.play(take=True).duration == 1.0
    assert stage.called("take by force") == list(NAMES)


def test_a_motion_needs_arms_each_once(stage: Stage) -> None:
    twice = [PlayedArm(stage.arms[NAMES[0]], way())] * 2  # type: ignore[arg-type]  # a driver
    for arms in ([], twice):
        with pytest.raises(UsageError, match="each once"):
            play_together(arms)


# -- what goes wrong during the motion -----------------------------------------------------------------------------


def fails(stage: Stage, name: str = NAMES[0]) -> None:
    """Its motion ends early."""
    robot = stage.arms[name]

    def row(number: int) -> m.Goal:
        if number == MOTION and number in robot.confirmed:
            return m.Goal(number, 0.0, "aborted", "stopped", "somebody stopped it")
        return robot.obedient(number)

    robot.row = row


def test_the_stop_of_one_arm_stops_all(stage: Stage) -> None:
    fails(stage)
    with pytest.raises(FleetMotionError, match=r"all arms are stopped: lab/arm1: somebody stopped it"):
        stage.play()
    assert stage.called("stop own") == list(NAMES)
    assert stage.shielded
    assert stage.over
    assert set(stage.called("release")) == set(NAMES)


def test_an_arm_that_another_program_has_taken_is_left_to_it(stage: Stage) -> None:
    fails(stage)
    stage.arms[NAMES[0]].errors["stop own"] = LeaseError("Eve took the lease")
    with pytest.raises(FleetMotionError, match="the arms that nobody else has taken are stopped: lab/arm1"):
        stage.play()
    assert stage.called("stop own") == list(NAMES)
    assert not stage.called("stop")
    assert stage.told[-1] == "lab/arm1: not stopped, since not done: Eve took the lease"


def test_a_stop_that_is_not_confirmed_is_told(stage: Stage) -> None:
    fails(stage)
    stage.arms[NAMES[1]].errors["stop own"] = DeviceError("no answer")
    with pytest.raises(FleetMotionError, match="all arms are stopped"):
        stage.play()
    assert stage.told[-1] == "lab/arm2: THE STOP IS NOT CONFIRMED: no answer"


def test_an_arm_that_does_not_arrive_stops_all(stage: Stage) -> None:
    robot = stage.arms[NAMES[0]]
    obedient = robot.obedient
    robot.row = lambda number: obedient(number) if number == APPROACH else m.Goal(number, 0.0, ready="board")
    with pytest.raises(FleetMotionError, match=r"lab/arm1: has not arrived 5 s after the end of its motion"):
        stage.play()
    _, start, _ = robot.followed[-1]
    assert stage.now - start == pytest.approx(1.0 + 5.0, abs=0.2)
    assert stage.called("stop own") == list(NAMES)


def test_an_interruption_stops_all(stage: Stage) -> None:
    """Also what another program has taken: whoever interrupts means all arms."""

    def interrupted(number: int) -> m.Goal:
        raise KeyboardInterrupt

    robot = stage.arms[NAMES[0]]
    confirm = robot.confirm

    def then(number: int) -> None:
        confirm(number)
        robot.row = interrupted if number == MOTION else robot.row

    robot.confirm = then  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        stage.play()
    assert stage.called("stop") == list(NAMES)
    assert stage.shielded
    assert set(stage.called("release")) == set(NAMES)


def test_a_servo_that_does_not_answer_is_named_before_anything_moves(stage: Stage) -> None:
    stage.arms[NAMES[1]].torque = lambda on, names: tuple(names[1:])  # type: ignore[method-assign,assignment,misc]
    with pytest.raises(FleetMotionError, match=r"no arm moved: lab/arm2: servo 0 \(J1\) does not answer") as error:
        stage.play()
    assert isinstance(error.value, DeviceError)
    assert not isinstance(error.value, ServoError)
    assert not stage.called("follow 1")
