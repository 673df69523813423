"""Nothing that was called before a stop takes effect after it: any threads, and a signal at any line."""

from __future__ import annotations

import contextlib
import os
import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product
from types import FrameType
from typing import Any

import pytest
from tests.bus.bus_bench import make_bus
from tests.drivers.arms import Arm
from tests.few import few
from tests.property.stop_bench import PATIENCE, bench, move, run
from tests.property.stops import Judge, watch

from hexwire.drivers.base import RobotDriver
from hexwire.drivers.bus_arm import SevenBotArm, So101Arm
from hexwire.errors import HexwireError, PreemptedError, StoppedError
from hexwire.wire.registers import Series

RUNS = int(os.environ.get("STOP_RUNS", "3"))
POINTS = int(os.environ.get("STOP_POINTS", "25"))


# --- threads ----------------------------------------------------------------------------------------------------


BOTH = ("move", "torque", "resume")
RAW = ("raw_move", "sent_move", "raw_resume")


@pytest.mark.parametrize(
    ("dialect", "what"), [(d, w) for d in (1, 2) for w in BOTH] + [(2, w) for w in RAW], ids=lambda p: str(p)
)
def test_calls_that_wait_for_the_line_are_void_after_a_stop(dialect: int, what: str) -> None:
    with bench(dialect) as b:
        if "resume" in what:
            b.stop()
        if what == "torque":
            b.robot.torque(False)
        taken, called, stopping = threading.Event(), threading.Event(), threading.Event()
        # However late this thread gets a processor, the line is free only when the stop has been called.
        b.robot.session.epochs.on_stop(stopping.set)
        turn = b.robot.session._turn
        outcome: list[BaseException | None] = []

        def hold() -> None:
            with turn.taken():
                taken.set()
                assert stopping.wait(PATIENCE)
                time.sleep(0.05)

        def wait() -> None:
            assert taken.wait(PATIENCE)
            try:
                begin, mine = turn.begin, threading.get_ident()

                def seen(*args: Any) -> None:
                    if threading.get_ident() == mine:
                        called.set()
                    begin(*args)

                turn.begin = seen  # type: ignore[method-assign]  # tells when the line is waited for
                called.set() if (dialect, what) == (1, "resume") else None
                getattr(b, what)()
                outcome.append(None)
            except HexwireError as error:
                outcome.append(error)

        threads = [threading.Thread(target=hold), threading.Thread(target=wait)]
        for thread in threads:
            thread.start()
        assert called.wait(PATIENCE)
        b.stop()
        for thread in threads:
            thread.join(PATIENCE)
        if (dialect, what) != (1, "resume"):  # which waits for nothing
            assert isinstance(outcome[0], StoppedError), outcome
        time.sleep(0.05)
        assert b.judge.wrong() == []


@pytest.mark.parametrize("deed", ["write", "torque", "resume", "raw"])
def test_calls_that_wait_for_a_servo_bus_are_void_after_a_stop(deed: str) -> None:
    robot, judge, _, _ = fresh("bus")
    assert isinstance(robot, SevenBotArm)
    robot.torque(deed != "torque")
    if deed == "resume":
        robot.stop()
    held, called = threading.Event(), threading.Event()
    outcome: list[BaseException | None] = []
    deeds: dict[str, Callable[[], object]] = {
        "write": lambda: move(robot, 1500),
        "torque": lambda: robot.torque(True),
        "raw": lambda: robot.bus.sync_write_bytes(0x2A, {0: b"\x05\xdc\x03\xe8"}),
        "resume": robot.resume,
    }
    token = robot.epochs.token

    def waits(what: str, *, freeing: bool = False) -> Any:
        made = token(what, freeing=freeing)
        if threading.current_thread() is worker and not called.is_set():
            called.set()
            assert held.wait(PATIENCE)
        return made

    def work() -> None:
        try:
            deeds[deed]()
            outcome.append(None)
        except HexwireError as error:
            outcome.append(error)

    worker = threading.Thread(target=work)
    robot.epochs.token = waits  # type: ignore[method-assign]  # tells when it is called, and keeps it there
    worker.start()
    assert called.wait(PATIENCE)
    before = len(judge.effects)
    with judge.stop():
        robot.stop()
    held.set()
    worker.join(PATIENCE)
    assert isinstance(outcome[0], StoppedError), outcome
    assert robot.read().stopped
    assert all(effect.count != 1500 and effect.what != "torque" for effect in judge.effects[before:])


@pytest.mark.system
@few("dialect, kind", product((1, 2), ("emulator", "core")), (2, "emulator"))
def test_no_earlier_call_of_any_thread_acts_after_a_stop(dialect: int, kind: str) -> None:
    moved = seed = 0
    # A busy machine may let no move through for a while, and runs in which nothing moves prove nothing.
    while seed < RUNS or (not moved and seed < 10 * RUNS):
        with bench(dialect, kind) as b:
            run(b, seed)
            assert b.judge.wrong() == [], f"seed {seed}"
            assert b.judge.without_torque() == [], f"seed {seed}"
            moved += b.judge.moved()
        seed += 1
    assert moved > 0


@pytest.mark.system
@pytest.mark.parametrize("dialect", [1, 2])
def test_moves_that_wait_give_no_torque_back(dialect: int) -> None:
    """In dialect 1 a target switches the torque on: one that was judged before must not follow torque off."""
    with bench(dialect) as b:
        ended, begun = threading.Event(), threading.Event()

        def push() -> None:
            while not ended.is_set():
                with contextlib.suppress(HexwireError):
                    b.move()
                    begun.set()

        threads = [threading.Thread(target=push) for _ in range(2)]
        for thread in threads:
            thread.start()
        assert begun.wait(PATIENCE)
        assert len(b.robot.torque(False)) == 7
        time.sleep(0.3)
        ended.set()
        for thread in threads:
            thread.join(PATIENCE)
        assert not any(servo.torque_on for servo in b.wire.servos)
        assert b.judge.moved() > 0


def test_a_move_that_was_judged_gives_no_torque_back_on_a_servo_bus() -> None:
    robot, _, _, _ = fresh("bus")
    assert isinstance(robot, SevenBotArm)
    judged, make = threading.Event(), robot._goals.make_packets

    def later(*args: Any) -> Any:
        judged.set()
        time.sleep(0.3)
        return make(*args)

    robot._goals.make_packets = later  # type: ignore[method-assign]  # tells when a move has been judged

    def moving() -> None:
        # Torque off voids it; and whatever becomes of it, it gives no torque.
        with contextlib.suppress(StoppedError):
            move(robot, 1500)

    worker = threading.Thread(target=moving)
    worker.start()
    assert judged.wait(PATIENCE)
    assert len(robot.torque(False)) == 7
    worker.join(PATIENCE)
    assert robot.bus.read(0, "torque_enable").raw == 0


def test_the_judge_detects_requests_that_a_stop_should_have_voided() -> None:
    judge = Judge()
    with judge.call("torque"):
        judge.seen("torque")
    with judge.call("move", 1500), judge.stop():
        pass
    judge.seen("target", 1500)
    with judge.call("move", 1501):
        judge.seen("target", 1501)
    with judge.call("resume"):
        judge.seen("resume")
    with judge.call("move", 1502):
        judge.seen("target", 1502)
        judge.seen("limp target", 1502)
    judge.seen("torque")
    voided, held, torque = judge.wrong()
    assert "count=1500" in voided
    assert "count=1501" in held
    assert "nobody resumed" in held
    assert "'torque'" in torque
    limp, unasked = judge.without_torque()
    assert "count=1502" in limp
    assert "nobody asked for" in unasked


# --- a signal handler, at every line ---------------------------------------------------------------------------


class AtLine:
    """Calls something when the n-th line of hexwire (but the emulator) is about to run, as a signal handler may.

    Counted from where a call has its token: before that it is as if it had not been called.
    """

    def __init__(self, n: int, call: Callable[[], object]) -> None:
        self.lines = 0
        self._n, self._call = n, call
        self._inside, self._called = False, False

    def __call__(self, frame: FrameType, event: str, arg: object) -> Any:
        if event == "call" and not self._ours(frame):
            return None
        if event == "return" and frame.f_code.co_name == "token":
            self._called = True
        if event == "line" and self._called and not self._inside:
            self.lines += 1
            if self.lines == self._n:
                self._inside = True
                try:
                    self._call()
                finally:
                    self._inside = False
        return self

    @staticmethod
    def _ours(frame: FrameType) -> bool:
        """Code of the host's side, not what the emulated board runs in the same thread."""
        if "/src/hexwire/" not in frame.f_code.co_filename:
            return False
        at: FrameType | None = frame
        while at is not None:
            if "/emulator/board" in at.f_code.co_filename or "/emulator/bus_" in at.f_code.co_filename:
                return False
            at = at.f_back
        return "/emulator/" not in frame.f_code.co_filename

    @contextmanager
    def tracing(self) -> Iterator[None]:
        before = sys.gettrace()
        sys.settrace(self)
        try:
            yield
        finally:
            sys.settrace(before)


def fresh(kind: str) -> tuple[RobotDriver, Judge, Callable[[], int], Callable[[float], None]]:
    """An arm in simulated time: driver, judge, the goal of J1's servo in counts, and a way to wait."""
    judge = Judge()
    if kind == "bus":
        series = (Series.SEVEN_BOT,) * 4 + (Series.HLS,) * 3
        bus, device = make_bus(tuple(range(7)), series, baud=115200)
        bus.close()
        robot = SevenBotArm(bus.link)
        robot.attach()
        robot.torque(True)
        robot.read()
        first = device.wire[0]
        watch(judge, device.wire, first)
        return robot, judge, lambda: first.registers.get("target_position"), robot.bus.pause
    arm = Arm(int(kind))
    arm.driver.torque(True)
    arm.driver.read()
    servo = arm.board.wire[0]
    watch(judge, arm.board.wire, servo)
    return arm.driver, judge, lambda: servo.registers.get("target_position"), arm.wait


@few(
    "kind, what",
    product(("1", "2", "bus"), ("move", "torque", "resume")),
    ("1", "torque"),
    ("2", "move"),
    ("bus", "resume"),
)
def test_a_signal_handler_that_stops_voids_what_it_interrupts(kind: str, what: str) -> None:
    robot, judge, goal, _ = fresh(kind)
    count = AtLine(-1, lambda: None)
    with count.tracing():
        act(robot, judge, what)
    lines = range(1, count.lines + 1)
    for line in random.Random(f"{kind} {what}").sample(lines, min(POINTS, len(lines))):
        robot, judge, goal, wait = fresh(kind)
        if what == "resume":
            robot.stop()
        if what == "torque":
            robot.torque(False)

        def stop(robot: RobotDriver = robot, judge: Judge = judge) -> None:
            with judge.stop():
                robot.stop()

        handler = AtLine(line, stop)
        with handler.tracing(), contextlib.suppress(StoppedError, PreemptedError):
            act(robot, judge, what)
        if not judge.stops:
            continue
        wait(0.5)
        call = judge.calls[0]
        assert call.outcome == "done" or "Stopped" in call.outcome or "Preempted" in call.outcome
        if kind == "2":
            assert judge.wrong() == [], line
        assert robot.read().stopped, line
        # Toward a board that latches no stop, what had left as the signal came is made up for at once.
        assert goal() != call.count, line
        with pytest.raises(StoppedError):
            move(robot, 2000)


def test_a_signal_handler_that_stops_comes_last_in_a_stream_of_set_points() -> None:
    bus, device = make_bus(tuple(range(1, 7)), (Series.STS_SMS,) * 6, baud=1_000_000)
    bus.close()
    robot = So101Arm(bus.link)
    robot.attach()
    robot.torque(True)
    sent = stopped = 0
    for line in range(1, 500):
        robot.resume()
        goal = {name: angle + 0.1 for name, angle in robot.read().positions.items()}
        counts = {joint.servo_id: joint.angle_to_counts(goal[joint.name]) for joint in robot.model.joints}
        handler = AtLine(line, robot.stop)
        with handler.tracing():
            try:
                robot.guide(goal, 0.02)
            except (StoppedError, PreemptedError):
                stopped += 1
            else:
                sent += 1
        if handler.lines < line:
            break
        assert robot.read().stopped, line
        for servo in device.wire.servos:
            assert servo.registers.get("goal_position") != counts[servo.servo_id], (line, servo.servo_id)
    else:
        pytest.fail("the call does not end")
    assert min(sent, stopped) > 5


def act(robot: RobotDriver, judge: Judge, what: str) -> None:
    count = judge.target() if what == "move" else -1
    with judge.call(what, count):
        if what == "move":
            move(robot, count)
        elif what == "torque":
            robot.torque(True)
        else:
            robot.resume()
