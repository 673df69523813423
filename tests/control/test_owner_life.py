"""`RobotOwner` begins and ends: in simulated time, then with its thread over a real line."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
from tests.control.owner_bench import BoardBench, Served, Threaded, moving
from tests.waits import eventually

from hexwire.control.loop import owner as module
from hexwire.control.loop.known_state import KnownState
from hexwire.control.loop.owner import RobotOwner, claim
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    DeviceError,
    HexwireError,
    LinkLostError,
    LinkPermissionError,
    ReplyTimeoutError,
    UsageError,
)
from hexwire.model.state import JointState

# -- coming -------------------------------------------------------------------------------------------------------


def test_a_port_that_comes_in_time(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench = BoardBench()
    bench.link.lost = True
    begun = bench.clock.time

    def sleep(seconds: float) -> None:
        bench.clock.advance(seconds)
        bench.link.lost = bench.clock.time < begun + 3.0

    bench.owner._sleep = sleep
    bench.owner.connect(10.0)
    assert bench.owner.connected
    assert 3.0 <= bench.clock.time - begun < 4.5
    # Told once, however often it looked.
    assert caplog.text.count("waiting for it") == 1


@pytest.mark.parametrize("timeouts", [(), (10.0,)])
def test_a_port_that_does_not_come(timeouts: tuple[float, ...]) -> None:
    bench = BoardBench()
    bench.link.lost = True
    begun = bench.clock.time
    with pytest.raises(LinkLostError, match="is unplugged"):
        bench.owner.connect(*timeouts)
    timeout = sum(timeouts)
    assert timeout <= bench.clock.time - begun <= timeout + 0.5
    assert not bench.owner.connected
    bench.owner.shutdown()


def test_a_port_that_is_not_ours_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = BoardBench()
    begun = bench.clock.time

    def refuse() -> None:
        raise LinkPermissionError("not for you")

    monkeypatch.setattr(bench.link, "open", refuse)
    with pytest.raises(LinkPermissionError):
        bench.owner.connect(10.0)
    assert bench.clock.time == begun


def test_what_was_found_in_vain_is_not_held_against_what_is_found_next() -> None:
    bench = BoardBench()
    read, sleep = bench.robot.read, bench.owner._sleep
    bench.robot._only_dialect = 1

    def no_answer() -> None:
        raise ReplyTimeoutError("JOINT_STATE", attempts=1)

    def waited(seconds: float) -> None:
        bench.robot.read, bench.robot._only_dialect = read, None
        sleep(seconds)

    bench.robot.read, bench.owner._sleep = no_answer, waited
    bench.owner.connect(10.0)
    assert bench.owner.probe is not None
    assert bench.owner.probe.dialect == 2


def test_nobody_answers() -> None:
    bench = BoardBench(faults=("boot:1000",))
    bench.robot._boot_window = 2.0
    begun = bench.clock.time
    with pytest.raises(ReplyTimeoutError, match="IDENTIFY"):
        bench.owner.connect(10.0)
    assert 10.0 <= bench.clock.time - begun < 16.0
    assert not bench.link.is_open


def test_no_watchdog_runs_before_somebody_feeds_it() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.arm.wait(5.0)
    bench.turn(2.0)
    assert bench.board.state.watchdog_trips == 0
    assert bench.owner.watchdog == 1.0


def test_the_owner_waits_as_long_as_it_says_but_not_beyond_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr(module.time, "sleep", waited.append)
    owner = RobotOwner(BoardBench().robot, borrowed=True)
    monkeypatch.setattr(owner._ending, "wait", lambda seconds: waited.append(-seconds))
    for seconds in (0.005, 0.02, 5.0, 0.0):
        owner._sleep(seconds)
    assert waited == [0.005, -0.02, -5.0, 0.0], "a short wait is a plain sleep; the end interrupts a long one"


# -- going --------------------------------------------------------------------------------------------------------


def test_the_end_at_rest_leaves_the_board_as_it_was() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)
    bench.enable()
    bench.owner.shutdown()
    state = bench.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (False, 0.0, None)
    assert bench.arm.torques() == [True] * 7
    assert not bench.link.is_open
    assert not bench.owner.connected
    bench.owner.shutdown()
    with pytest.raises(LinkLostError, match="has ended"):
        bench.owner.call(lambda: None)


def test_an_arm_that_nobody_uses_is_read_rarely_and_as_before_once_somebody_does() -> None:
    bench = BoardBench(publish_rate=50.0)
    names = bench.robot.model.names
    seen: list[float] = []
    bench.owner.observe(lambda state: seen.append(bench.clock.time))

    def rate(seconds: float = 2.0) -> float:
        seen.clear()
        bench.turn(seconds)
        return len(seen) / seconds

    bench.owner.connect()
    bench.turn(3.0)
    assert rate() == pytest.approx(50.0, rel=0.1), "somebody may need it, whoever does not say so"
    bench.owner.needed = lambda: False
    bench.ask(lambda: bench.owner.torque(False, names))
    bench.turn(2.5)
    assert rate() == pytest.approx(5.0, rel=0.15)
    assert not bench.robot.read().stopped, "its watchdog is fed"
    bench.ask(lambda: bench.owner.torque(True, names[:1]))
    bench.turn(0.3)
    assert rate() == pytest.approx(50.0, rel=0.1), "a joint has torque"
    bench.ask(lambda: bench.owner.torque(False, names))
    bench.turn(2.5)
    bench.owner.needed = lambda: True
    bench.turn(0.3)
    assert rate() == pytest.approx(50.0, rel=0.1)
    bench.owner.shutdown()


def test_a_shutdown_during_a_motion_stops_the_arm() -> None:
    bench, told = moving()
    bench.owner.shutdown()
    assert told.words == "aborted: stopped: the program ends"
    state = bench.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (True, 0.0, None)
    assert bench.arm.torques() == [True] * 7


def test_the_end_with_torque_off() -> None:
    bench = BoardBench()
    bench.owner.connect()
    bench.turn(0.3)
    bench.enable()
    bench.owner.shutdown(torque_off=True)
    assert bench.arm.torques() == [False] * 7


def test_whatever_a_stop_raises_at_the_end_the_watchdog_is_disarmed_and_the_robot_detached() -> None:
    bench, told = moving()

    def stop(mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        raise RuntimeError("a defect of the driver")

    bench.robot.stop = stop
    with pytest.raises(RuntimeError, match="a defect"):
        bench.owner.shutdown()
    assert len(told.ends) == 1
    assert (bench.board.state.watchdog_timeout, bench.link.is_open) == (0.0, False)
    assert not bench.owner.connected
    claim(bench.robot, told)


def test_the_end_without_a_robot() -> None:
    bench, told = moving()
    bench.link.lost = True
    bench.turn(2.0)
    bench.owner.shutdown(torque_off=True)
    bench.owner.shutdown()
    assert len(told.ends) == 1
    RobotOwner(bench.robot).shutdown()


# -- with threads, over a real line -------------------------------------------------------------------------------


@pytest.fixture
def served() -> Iterator[Served]:
    with Served() as board:
        yield board


def test_a_life_with_its_own_thread(served: Served) -> None:
    node = Threaded(served)
    owner, names = node.owner, node.driver.model.names
    assert owner.torque(True, names) == names
    told = node.go("J1", 0.05, 1.0)
    eventually(lambda: told.ends)
    assert told.words.startswith("succeeded: ")
    told = node.go_slowly()
    assert owner.stop("a test") == names
    assert told.words == "aborted: stopped: a test"
    owner.reset()
    assert owner.group.reason is None
    assert owner.call(threading.current_thread) is not threading.current_thread()
    assert owner.call(lambda: owner.call(lambda: 7)) == 7
    told = node.go_slowly()
    owner.shutdown()
    assert not owner.alive
    assert told.words == "aborted: stopped: the program ends"
    state = served.board.state
    assert (state.stopped, state.watchdog_timeout, state.report_due) == (True, 0.0, None)


@pytest.mark.parametrize("publish_rate", [100.0, 4.0])
def test_stops_from_several_threads_while_the_owner_waits(served: Served, publish_rate: float) -> None:
    node = Threaded(served, publish_rate=publish_rate)
    owner, names = node.owner, node.driver.model.names
    assert owner._thread is not None
    assert owner._thread.daemon, "a program that does not shut it down ends all the same"
    answers: list[tuple[str, ...]] = []

    def keep_stopping() -> None:
        answers.extend(owner.stop("a test") for _ in range(30))

    threads = [threading.Thread(target=keep_stopping) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert answers == [names] * 90
    assert owner.connected
    assert owner.reconnects == 0
    # Reports go on, or soon again.
    before = owner.state
    eventually(lambda: owner.state is not before)
    owner.reset()
    assert owner.torque(True, names) == names
    owner.shutdown()
    assert served.board.state.report_due is None


@pytest.mark.slow
def test_a_stop_of_a_board_that_says_nothing_fails_in_time_and_all_is_stopped(served: Served) -> None:
    node = Threaded(served)
    node.owner.torque(True, node.driver.model.names)
    told = node.go("J1", 0.4, 20.0)
    served.muted.set()
    with pytest.raises(HexwireError):
        node.owner.stop("a test")
    assert told.words == "aborted: stopped: a test"
    eventually(lambda: not node.owner.connected)
    with pytest.raises(LinkLostError):
        node.owner.reset()
    node.owner.shutdown()
    assert not node.owner.alive


@pytest.mark.slow
def test_no_caller_waits_forever_for_a_board_that_falls_silent(served: Served) -> None:
    node = Threaded(served)
    served.muted.set()
    with pytest.raises(HexwireError):
        node.owner.torque(True, node.driver.model.names)
    node.owner.shutdown()
    assert not node.owner.alive


@pytest.mark.slow
def test_the_end_while_the_owner_looks_for_a_robot(served: Served) -> None:
    node = Threaded(served)
    node.driver._boot_window = 600.0
    served.muted.set()
    eventually(lambda: not node.owner.connected and node.driver.session.is_open)
    node.owner.shutdown(torque_off=True)
    assert not node.owner.alive
    assert node.owner.crash is None
    assert not node.driver.session.is_open


def test_a_programming_error_is_reported_and_stops_the_arm(served: Served) -> None:
    broken = threading.Event()

    def on_state(state: JointState, published: KnownState) -> None:
        if broken.is_set():
            raise RuntimeError("a fault of the program")

    node = Threaded(served, on_state=on_state)
    owner = node.owner
    owner.torque(True, node.driver.model.names)
    told = node.go("J1", 0.4, 20.0)
    broken.set()
    eventually(lambda: not owner.alive)
    assert isinstance(owner.crash, RuntimeError)
    assert told.words == "aborted: stopped: the program failed: a fault of the program"
    assert served.board.state.stopped
    for call in (owner.newest, owner.reset):
        with pytest.raises(DeviceError, match="the program failed: a fault"):
            call()
    owner.shutdown()
    state = served.board.state
    assert (state.watchdog_timeout, state.report_due) == (0.0, None)


def test_the_owners_own_thread_is_told_that_it_cannot_end_itself(served: Served) -> None:
    node = Threaded(served)
    with pytest.raises(UsageError, match="call shutdown in another thread"):
        node.owner.call(node.owner.shutdown)
    assert node.owner.call(lambda: node.owner.connected)
    node.owner.shutdown()
    assert not node.owner.alive


@pytest.mark.slow
def test_an_owner_who_does_not_come_back_keeps_nobody_from_ending(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexwire.control.loop.owner._PATIENCE", 1.0)
    stick, stuck, free = threading.Event(), threading.Event(), threading.Event()

    def on_state(state: JointState, published: KnownState) -> None:
        if stick.is_set():
            stuck.set()
            free.wait(60)

    node = Threaded(served, on_state=on_state)
    node.owner.torque(True, node.driver.model.names)
    told = node.go_slowly()
    stick.set()
    assert stuck.wait(30)
    node.owner.shutdown()
    assert told.words == "aborted: stopped: the program ends"
    # It was told before anybody waited for the thread.
    assert served.board.state.stopped
    assert node.owner.alive
    free.set()
    eventually(lambda: not node.owner.alive)
    assert not node.driver.session.is_open
