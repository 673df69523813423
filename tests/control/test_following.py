"""Emulated leaders that are moved by hand, and their followers, in simulated time."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from tests.control.swing import Swing
from tests.drivers.arms import Arm as BoardArm
from tests.few import few
from tests.waits import PATIENCE, eventually

from hexwire.control.loop.owner import RobotOwner, release
from hexwire.control.motion.following import (
    BriefReader,
    FollowController,
    Pair,
    ReadAhead,
    ReplugReader,
    following_rules,
    run_following,
)
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.bus_arm import So101Arm
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.faults import FaultPlan
from hexwire.emulator.hand import HandOrder, Hands
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.errors import HexwireError, StoppedError, UsageError
from hexwire.model.state import JointState
from hexwire.motion.following import Following

PERIOD = 0.02
FOLDED = ("shoulder_lift", "elbow_flex", "wrist_flex")


class Arm:
    """An emulated SO-101 and its driver."""

    def __init__(self, clock: FakeClock, *, leader: bool = False, faults: tuple[str, ...] = ()) -> None:
        self.made = make_bus_arm("so101", leader=leader, start=clock())
        self.device = BusDevice(
            self.made.servos, paced=True, host_baud=lambda: 1_000_000, faults=FaultPlan(faults, seed=3)
        )
        self.link = BoardLink(self.device, clock)
        self.driver = So101Arm(self.link)

    @property
    def goals(self) -> list[int]:
        """Goal positions in the servos, counts."""
        return [servo.registers.get("goal_position") for servo in self.made.servos]

    def hand(self, joint: str, degrees: float, now: float) -> None:
        """A hand moves a joint while time passes, and keeps it there."""
        self.grip = Hands(self.made.servos, self.driver.model).take(HandOrder(joint, degrees, 0.3, 100.0, 0.9), now)


class Rig:
    """A leader and its follower, attached, and the loop that runs them."""

    def __init__(self, leader_faults: tuple[str, ...] = (), **options: object) -> None:
        self.clock = FakeClock()
        self.leader = Arm(self.clock, leader=True, faults=leader_faults)
        self.follower = Arm(self.clock)
        self.notes: list[object] = []
        self.rules = Following(self.leader.driver.model, self.follower.driver.model)
        for arm in (self.leader, self.follower):
            arm.driver.attach()
        self.follower.driver.torque(True)
        self.leader.driver.torque(False)
        self.controller = FollowController(
            self.rules, self.leader.driver.read_positions, self.leader.driver.now, PERIOD, self.notes.append
        )
        self.owner = RobotOwner(
            self.follower.driver, borrowed=True, command_rate=1 / PERIOD, sleep=self.clock.advance
        )
        self.owner.group.members = (self.controller,)
        self.owner.connect()

    def run(self, seconds: float) -> None:
        end = self.clock() + seconds
        while self.clock() < end:
            self.owner.turn()

    def apart(self, joint: str) -> float:
        """Degrees between follower and leader."""
        leader, follower = (arm.driver.read()[joint].position for arm in (self.leader, self.follower))
        return math.degrees(follower - leader)


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    release(made.follower.driver, made.owner)


def test_the_follower_goes_where_the_leader_is_moved(rig: Rig) -> None:
    rig.run(1.0)
    rig.leader.hand("shoulder_pan", 40.0, rig.clock())
    rig.run(3.0)
    assert abs(rig.apart("shoulder_pan")) < 2.0
    assert math.degrees(rig.leader.driver.read()["shoulder_pan"].position) > 35.0
    assert "the follower has met the leader" in rig.notes


@pytest.mark.slow
def test_lost_answers_of_the_leader_end_nothing_and_mislead_nobody() -> None:
    """Two in five of one joint, so that even repeated questions fail, and one in a hundred of another."""
    rig = Rig(("silent:1:0.4", "silent:2:0.01"))
    sent: list[float] = []
    write = rig.follower.driver.write
    rig.follower.driver.write = lambda target: sent.append(dict(target.positions)["shoulder_pan"]) or write(target)  # type: ignore[method-assign,func-returns-value]
    rig.run(1.0)
    rig.leader.hand("shoulder_pan", 40.0, rig.clock())
    rig.run(10.0)
    assert rig.controller.counters.unanswered > 3
    assert rig.controller.counters.pauses == 0
    assert abs(rig.apart("shoulder_pan")) < 2.0
    # It went there and stayed: no value of a lost answer in between.
    assert all(b - a > -math.radians(1.0) for a, b in itertools.pairwise(sent))
    release(rig.follower.driver, rig.owner)


def test_the_load_of_a_follower_is_read_fifty_times_a_second_and_its_positions_every_5_ms() -> None:
    clock = FakeClock()
    arm = Arm(clock)
    arm.driver.attach()
    wholes, loads = itertools.count(), itertools.count()
    whole, load = arm.driver.read, arm.driver.read_loads
    arm.driver.read = lambda: (next(wholes), whole())[1]  # type: ignore[method-assign]
    # Loads that tell which reading they are from.
    arm.driver.read_loads = lambda: replace(load(), load=(float(next(loads)),) * 6)  # type: ignore[method-assign]
    read = BriefReader(arm.driver)
    first, begin = read(), arm.link.clock()
    arm.hand("shoulder_pan", 20.0, begin)
    states = []
    for _ in range(400):
        clock.advance(0.001)
        states.append(read())
    seconds = arm.link.clock() - begin
    count = next(loads)
    assert count == pytest.approx(50 * seconds, rel=0.2)
    assert states[-1].load[0] == count - 1
    assert all(math.isfinite(state.load[0]) and state.voltage == first.voltage for state in states)
    assert 0.003 < max(max(state.age) for state in states) <= 0.005
    assert sum(state.age == first.age for state in states) == pytest.approx(seconds / 0.0055, rel=0.2)
    assert math.degrees(states[-1].position[0] - first.position[0]) > 5.0
    assert next(wholes) == 1
    clock.advance(1.0)
    read()
    assert next(wholes) == 3, "the rest is read once a second"


def test_a_leader_that_is_unplugged_ends_it_and_stops_the_follower(rig: Rig) -> None:
    rig.run(1.0)
    rig.leader.link.lost = True
    with pytest.raises(HexwireError, match="unplugged"):
        rig.run(1.0)
    goals = rig.follower.goals
    rig.clock.advance(1.0)
    rig.follower.driver.read()
    assert rig.follower.goals == goals


def test_a_leader_whose_servos_are_silent_holds_the_follower(rig: Rig) -> None:
    rig.run(1.0)
    rig.leader.hand("shoulder_pan", 60.0, rig.clock())
    rig.run(0.1)
    rig.leader.device.wire.faults = FaultPlan(("silent:1",))
    rig.run(1.0)
    assert "the leader is silent" in rig.notes
    assert rig.controller.counters.pauses == 1
    goals = rig.follower.goals
    rig.run(0.5)
    assert rig.follower.goals == goals


def fastest(rig: Rig, joint: str, seconds: float) -> float:
    """Highest speed of a joint of the follower meanwhile, degrees per second."""
    places = []
    end = rig.clock() + seconds
    while rig.clock() < end:
        places.append((rig.clock(), math.degrees(rig.follower.driver.read()[joint].position)))
        rig.run(0.05)
    return max(abs(b - a) / (after - before) for (before, a), (after, b) in itertools.pairwise(places))


def test_it_meets_the_leader_again_after_the_program_was_suspended(rig: Rig) -> None:
    rig.run(1.0)
    rig.clock.advance(5.0)
    rig.leader.hand("shoulder_pan", 40.0, rig.clock())
    rig.clock.advance(1.0)
    rig.leader.driver.read()
    rig.clock.advance(1.0)
    assert fastest(rig, "shoulder_pan", 1.5) < 50.0
    assert abs(rig.apart("shoulder_pan")) < 2.0


def test_a_follower_outside_its_limits_goes_back_slowly_also_when_it_holds(rig: Rig) -> None:
    model = rig.follower.driver.model
    joints = tuple(
        replace(joint, minimum=math.radians(30.0)) if joint.name == "shoulder_pan" else joint
        for joint in model.joints
    )
    rig.follower.driver.model = replace(model, joints=joints)
    rig.rules = Following(rig.leader.driver.model, rig.follower.driver.model)
    rig.controller._rules = rig.rules
    rig.run(0.1)
    rig.leader.device.wire.faults = FaultPlan(("silent:1",))
    assert fastest(rig, "shoulder_pan", 1.5) < 50.0
    assert "the leader is silent" in rig.notes
    assert math.degrees(rig.follower.driver.read()["shoulder_pan"].position) == pytest.approx(30.0, abs=1.0)


def test_a_stop_of_the_follower_ends_it(rig: Rig) -> None:
    rig.run(0.5)
    rig.follower.driver.stop()
    goals = rig.follower.goals
    rig.leader.hand("shoulder_pan", 40.0, rig.clock())
    rig.run(1.0)
    assert rig.follower.goals == goals


def test_a_leader_whose_network_is_silent_keeps_no_follower_from_its_cycle(rig: Rig) -> None:
    """Reading it blocks for a second and more; a follower with a watchdog would be stopped."""
    again, begun = threading.Event(), threading.Event()

    def read() -> JointState:
        if begun.is_set():
            again.wait(30.0)
        begun.set()
        return first

    first = rig.leader.driver.read()
    ahead = ReadAhead(read)
    rig.controller._leader = ahead
    rig.run(1.0)
    assert "the leader is silent" in rig.notes
    assert rig.controller.counters.cycles > 30
    again.set()
    ahead.end()


def test_a_fault_of_a_leader_that_is_read_ahead_is_raised_in_the_cycle(rig: Rig) -> None:
    ahead = ReadAhead(rig.leader.driver.read)
    rig.leader.link.lost = True
    ahead._thread.join(30)
    with pytest.raises(HexwireError, match="unplugged"):
        ahead()


# --- how fast it follows ------------------------------------------------------------------------------------


@few("hertz, most", [(0.5, None), (1.0, None), (1.5, None), (0.5, 60.0)], (1.0, None), (1.5, None), (0.5, 60.0))
def test_a_swing_is_followed_as_fast_as_the_servo_can(hertz: float, most: float | None) -> None:
    """126, 251 and 377 degrees per second at the most; the servo reaches 312."""
    swing, notes = Swing(hertz), list[object]()
    with swing.leader as leader, swing.follower as follower:
        rules = following_rules(
            leader,
            follower,
            PathCheck.of(follower, None),
            max_speed=None if most is None else math.radians(most),
        )
        one = Pair(leader, follower, rules, notes.append)
        with pytest.raises(KeyboardInterrupt):
            run_following(one, 100.0, sleep=swing.sleep)
    told = [str(note) for note in notes]
    fast = math.tau * hertz * 40.0 < (most or 312.0)
    assert told.count("shoulder_pan is led faster than it may move, and comes later") == int(not fast)
    assert swing.late < 0.1 if fast else 5.0 < swing.late < 60.0


# --- run_following ------------------------------------------------------------------------------------------


class EndError(Exception):
    pass


def pair(clock: FakeClock, notes: list[object], *, ahead: bool = False) -> tuple[Pair, Arm, Arm]:
    leader, follower = Arm(clock, leader=True), Arm(clock)
    leader.driver.attach()
    follower.driver.attach()
    rules = Following(leader.driver.model, follower.driver.model)
    return Pair(leader.driver, follower.driver, rules, notes.append, ahead), leader, follower


def test_a_leader_that_another_program_serves_is_read_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    _, leader, follower = pair(FakeClock(), [])
    how: dict[str, Any] = {"mirror": False, "meet": 0.2, "force": 0.35, "on_note": lambda said: None}
    assert not Pair.of(leader.driver, follower.driver, 0.0, **how).ahead
    monkeypatch.setattr(type(leader.driver), "url", "zenoh:lab/leader")
    made = Pair.of(leader.driver, follower.driver, 0.0, **how)
    assert made.ahead
    assert made.check is not None


def test_a_leader_on_a_network_is_read_in_a_thread_that_ends_with_the_motion() -> None:
    clock = FakeClock()
    one, leader, _ = pair(clock, [], ahead=True)
    readers: set[str] = set()
    read = leader.driver.read_positions

    def seen() -> JointState:
        readers.add(threading.current_thread().name)
        return read()

    leader.driver.read_positions = seen  # type: ignore[method-assign]

    def sleep(seconds: float) -> None:
        clock.advance(seconds)
        if "leader" in readers:
            raise EndError

    with pytest.raises(EndError):
        run_following(one, 1 / PERIOD, sleep=sleep)
    assert "leader" not in {thread.name for thread in threading.enumerate()}


def test_at_the_end_the_follower_holds_with_torque() -> None:
    clock = FakeClock()
    one, _, follower = pair(clock, [])
    ends = clock() + 2.0

    def sleep(seconds: float) -> None:
        clock.advance(seconds)
        if clock() > ends:
            raise EndError

    with pytest.raises(EndError):
        run_following(one, 1 / PERIOD, sleep=sleep)
    state = follower.driver.read()
    assert state.torque_on == state.names
    goals = follower.goals
    clock.advance(2.0)
    follower.driver.read()
    assert follower.goals == goals


def at_once(task: Callable[[], object]) -> Callable[[float], object]:
    """Opens a leader's line in the cycle, so that its time passes once."""
    task()
    return lambda seconds: None


class Unplugged:
    """A pair of which one arm's cable is pulled out after a second, while a hand moves the leader by 40 degrees."""

    def __init__(self, which: str, seconds: float) -> None:
        self.clock = clock = FakeClock()
        self.notes: list[object] = []
        self.pair, self.leader, self.follower = pair(clock, self.notes)
        self._out, self._in = clock() + 1.0, clock() + 1.0 + seconds
        self._arm = self.leader if which == "leader" else self.follower
        # Time and degrees of the follower's base once the cable is plugged in again.
        self.places: list[tuple[float, float]] = []
        self.held: set[tuple[int, ...]] = set()

    def sleep(self, seconds: float) -> None:
        clock = self.clock
        if self._out <= clock() < self._in and not self._arm.link.lost:
            self._arm.link.lost = True
            self.leader.hand("shoulder_pan", 40.0, clock())
        elif clock() >= self._in:
            self._arm.link.lost = False
        if self._arm.link.lost and clock() > self._out + 0.5:
            self.held.add(tuple(self.follower.goals))
        if clock() > self._in:
            servo = self.follower.made.servos[0]
            servo.step(clock())
            self.places.append((clock(), servo.motion.position * 360 / 4096))
        if clock() > self._in + 4.0:
            raise EndError
        clock.advance(seconds)

    def run(self) -> None:
        run_following(self.pair, 1 / PERIOD, sleep=self.sleep, beside=at_once)


@pytest.mark.parametrize("which", ["leader", "follower"])
def test_a_cable_that_is_plugged_in_again_goes_on_and_the_arms_meet_slowly(which: str) -> None:
    out = Unplugged(which, 5.0)
    with pytest.raises(EndError):
        out.run()
    assert len(out.held) == 1, "it holds meanwhile"
    assert any("unplugged" in str(note) for note in out.notes)
    assert f"the {which} is there again" in out.notes
    speeds = [abs(b - a) / (after - before) for (before, a), (after, b) in itertools.pairwise(out.places)]
    # A fifth of 180 degrees a second.
    assert 30.0 < max(speeds) < 50.0
    leader, follower = (arm.driver.read()["shoulder_pan"].position for arm in (out.leader, out.follower))
    assert math.degrees(leader) > 35.0
    assert math.degrees(follower - leader) == pytest.approx(0.0, abs=2.0)
    state = out.follower.driver.read()
    assert (state.torque_on, state.stopped) == (state.names, False)


def board_pair(dialect: int, notes: list[object]) -> tuple[Pair, BoardArm, BoardArm]:
    leader, follower = (BoardArm(dialect, attach=False) for _ in range(2))
    follower.clock = follower.link.clock = leader.clock
    leader.driver.attach()
    follower.driver.attach()
    how: dict[str, Any] = {"mirror": False, "meet": 0.2, "force": 0.35}
    return Pair.of(leader.driver, follower.driver, None, on_note=notes.append, **how), leader, follower


@few("dialect", [1, 2], 2)
def test_nobody_waits_for_the_cable_of_a_leaders_board_in_the_followers_cycle(dialect: int) -> None:
    """The follower's watchdog would trip meanwhile, and nothing would go on when the leader is there again."""
    notes: list[object] = []
    one, leader, follower = board_pair(dialect, notes)
    clock = leader.clock
    out, back = clock() + 1.0, clock() + 6.0

    def sleep(seconds: float) -> None:
        if out <= clock() < back and not leader.link.lost:
            leader.link.lost = True
            leader.board.wire[0].motion.position += 200.0
        elif clock() >= back:
            leader.link.lost = False
        if clock() > back + 5.0:
            raise EndError
        clock.advance(seconds)

    with pytest.raises(EndError):
        run_following(one, 1 / PERIOD, sleep=sleep, beside=at_once)
    assert notes[-2:] == ["the leader is there again", "the follower has met the leader"]
    leads, follows = (arm.driver.read()["J1"].position for arm in (leader, follower))
    assert math.degrees(follows - leads) == pytest.approx(0.0, abs=2.0)
    state = follower.driver.read()
    assert (state.torque_on, state.stopped) == (state.names, False)


def test_a_leader_that_boots_for_long_keeps_no_follower_from_its_cycle() -> None:
    """Its follower's watchdog stays quiet, although the leader's line takes two seconds to open."""
    notes: list[object] = []
    one, leader, follower = board_pair(2, notes)
    clock, tasks = leader.clock, list[Callable[[], object]]()
    times, booted = [clock()], math.inf

    def beside(task: Callable[[], object]) -> Callable[[float], object]:
        nonlocal booted
        tasks.append(task)
        booted = clock() + 2.0
        return lambda seconds: None

    def sleep(seconds: float) -> None:
        leader.link.lost = times[0] + 1.0 <= clock() < times[0] + 2.0
        if clock() >= booted and tasks:
            tasks.pop()()
        if "the leader is there again" in notes:
            raise EndError
        clock.advance(seconds)
        times.append(clock())

    with pytest.raises(EndError):
        run_following(one, 1 / PERIOD, sleep=sleep, beside=beside)
    assert times[-1] - times[0] > 3.0
    assert max(after - before for before, after in itertools.pairwise(times)) < 0.2
    state = follower.driver.read()
    assert (state.torque_on, state.stopped) == (state.names, False)


def test_a_leaders_line_is_opened_in_a_thread_and_closed_if_it_is_over_by_then() -> None:
    clock = FakeClock()
    _, leader, _ = pair(clock, [])
    attach, booting, booted = leader.driver.attach, threading.Event(), threading.Event()

    def boot() -> None:
        booting.set()
        assert booted.wait(PATIENCE)
        attach()

    leader.driver.attach = boot  # type: ignore[method-assign]  # takes its time
    read = ReplugReader(leader.driver, lambda said: None)
    before = read()
    leader.link.lost = True
    assert read() is before
    leader.link.lost = False
    assert booting.wait(PATIENCE)
    assert read() is before
    ending = threading.Thread(target=read.end)
    ending.start()
    eventually(lambda: read._ended)
    booted.set()
    ending.join()
    eventually(lambda: not any(thread.name == "leader's line" for thread in threading.enumerate()))
    assert not leader.driver.is_attached


def test_a_follower_that_its_watchdog_stopped_meanwhile_stays_stopped() -> None:
    one, _, follower = board_pair(2, [])
    clock = follower.clock
    out = clock() + 1.0

    def sleep(seconds: float) -> None:
        follower.link.lost = out <= clock() < out + 5.0
        clock.advance(seconds)

    with pytest.raises(StoppedError, match=r"watchdog tripped, because the host fell silent; .*resume"):
        run_following(one, 1 / PERIOD, sleep=sleep)
    assert follower.driver.read().stopped


@pytest.mark.parametrize("which", ["leader", "follower"])
def test_a_cable_that_stays_out_for_half_a_minute_ends_it(which: str) -> None:
    out = Unplugged(which, 60.0)
    began = out.clock()
    with pytest.raises(HexwireError, match="unplugged"):
        out.run()
    assert out.clock() - began == pytest.approx(31.0, abs=1.0)
    assert len(out.held) == 1
    if which == "leader":
        assert out.follower.driver.read().stopped


def test_a_leader_that_comes_back_with_torque_ends_it() -> None:
    out = Unplugged("leader", 5.0)
    release = out.leader.driver.torque

    def switched(on: bool, joints: object = None) -> tuple[str, ...]:
        return () if out.notes else release(on)

    out.leader.driver.torque = switched  # type: ignore[method-assign]
    with pytest.raises(UsageError, match="does not confirm that shoulder_pan"):
        out.run()
    assert out.follower.driver.read().stopped


def test_a_leader_that_keeps_its_torque_is_refused() -> None:
    clock = FakeClock()
    one, leader, follower = pair(clock, [])
    leader.driver.torque(True)
    leader.device.wire.faults = FaultPlan(("silent:3",))
    goals = follower.goals
    with pytest.raises(UsageError, match="does not confirm that elbow_flex has no torque"):
        run_following(one, 1 / PERIOD, sleep=clock.advance)
    assert follower.goals == goals


@pytest.mark.parametrize("how", ["by this program", "by another program"])
def test_a_stop_of_the_leader_ends_it_and_the_follower_holds(how: str) -> None:
    clock = FakeClock()
    one, leader, follower = pair(clock, [])
    begins, read = clock() + 1.0, leader.driver.read_positions

    def stopped(within: float = 0.0) -> JointState:
        state = read(within)
        if clock() < begins:
            return state
        if how == "by this program":
            leader.driver.stop()
        leader.hand("shoulder_pan", 40.0, clock())
        return replace(state, stopped=how == "by another program")

    leader.driver.read_positions = stopped  # type: ignore[method-assign]
    before = follower.driver.read().position[0]
    with pytest.raises(StoppedError, match=r"^the leader was stopped, so the follower holds$"):
        run_following(one, 1 / PERIOD, sleep=clock.advance)
    assert clock() - begins < 0.2
    goals = follower.goals
    clock.advance(2.0)
    state = follower.driver.read()
    assert (state.torque_on, state.stopped, follower.goals) == (state.names, False, goals)
    assert math.degrees(state.position[0] - before) == pytest.approx(0.0, abs=2.0)


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("stop", "^the follower was stopped; `hexwire resume` ends that$"),
        ("stop by another program", "^a stop command has stopped the arm; `hexwire resume` ends that$"),
        ("stop that is over", "^the follower was stopped; nothing is latched: ask for it again$"),
        ("torque off", "^the follower's torque was switched off; nothing is latched: ask for it again$"),
    ],
)
def test_a_stop_of_the_follower_or_torque_off_ends_it_and_says_why(how: str, words: str) -> None:
    clock = FakeClock()
    one, _, follower = pair(clock, [])
    ends = clock() + 1.0

    def elsewhere(read: Callable[..., JointState]) -> Callable[..., JointState]:
        return lambda *given: replace(read(*given), stopped=clock() > ends)

    for name in ("read", "read_positions", "read_loads") if how == "stop by another program" else ():
        setattr(follower.driver, name, elsewhere(getattr(follower.driver, name)))

    def sleep(seconds: float) -> None:
        clock.advance(seconds)
        assert clock() < ends + 1.0
        if clock() > ends and how != "stop by another program":
            if how == "torque off":
                follower.driver.torque(False)
            else:
                follower.driver.stop()
            if how == "stop that is over":
                follower.driver.resume()

    with pytest.raises(StoppedError, match=words):
        run_following(one, 1 / PERIOD, sleep=sleep)
    assert bool(follower.driver.read().torque_on) == (how != "torque off")
