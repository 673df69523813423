"""Robots and their owner for the tests of `RobotOwner`: in simulated time, and with threads over a real line."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from tests.control.arm_bench import Told
from tests.drivers.arms import Arm
from tests.waits import eventually, turn_while_it_waits

from hexwire.control.loop.controller import TrajectoryController
from hexwire.control.loop.known_state import KnownState
from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.arrival import Tolerance
from hexwire.control.motion.goals import Point, Tolerances, TrajectoryGoal
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.settings import ControllerSettings
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve import FakeClock
from hexwire.emulator.serve_pty import PtyServer
from hexwire.errors import (
    HexwireError,
)
from hexwire.model.arm import ArmModel
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.safety import SafetyLimits

_T = TypeVar("_T")


def make_controller(model: ArmModel, joints: tuple[str, ...] = (), period: float = 0.05) -> TrajectoryController:
    joints = joints or model.names
    none = {name: Tolerance() for name in joints}
    goal = {name: Tolerance(velocity=0.1) for name in joints}
    settings = ControllerSettings("", joints, True, Tolerances(none, goal, 0.0))
    return TrajectoryController(settings, model, SafetyLimits.at_period(period), check=PathCheck.limits_only(model))


class Bench:
    """A robot, its owner, one controller of all joints, and what was published."""

    def __init__(self, robot: Any, clock: FakeClock, *, period: float = 0.05, split: bool = False, **options: Any):
        self.robot, self.clock = robot, clock
        self.published: list[tuple[float, KnownState]] = []
        self.writes: list[float] = []
        self.owner = RobotOwner(robot, on_state=self.note, clock=clock, sleep=clock.sleep, **options)
        names = robot.model.names
        shares = (names[:3], names[3:]) if split else (names,)
        self.controllers = tuple(make_controller(robot.model, share, period) for share in shares)
        self.controller = self.controllers[0]
        self.owner.group.members = self.controllers
        write = robot.write

        def watched(target: JointTarget) -> Any:
            self.writes.append(clock.time)
            return write(target)

        robot.write = watched

    def note(self, state: JointState, published: KnownState) -> None:
        self.published.append((self.clock.time, published))

    def turn(self, seconds: float) -> None:
        end = self.clock.time + seconds
        while self.clock.time < end:
            self.owner.turn()

    def until(self, condition: Callable[[], object], seconds: float = 20.0) -> None:
        end = self.clock.time + seconds
        while not condition():
            assert self.clock.time < end
            self.owner.turn()

    def ask(self, call: Callable[[], _T]) -> _T:
        """What another thread asks the owner for, who turns meanwhile."""
        answer: list[_T] = []
        failed: list[HexwireError] = []

        def run() -> None:
            try:
                answer.append(call())
            except HexwireError as error:
                failed.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        turn_while_it_waits(thread, self.owner.turn)
        if failed:
            raise failed[0]
        return answer[0]

    def enable(self) -> None:
        names = self.robot.model.names
        assert self.ask(lambda: self.owner.torque(True, names)) == names

    def go(self, joint: str, by: float, seconds: float, controller: TrajectoryController | None = None) -> Told:
        """Have one joint go somewhere; it is on its way when this returns."""
        told, owner = Told(), self.owner
        state = owner.newest()
        order = TrajectoryGoal((joint,), (Point(seconds, (state[joint].position + by,)),))
        chosen = controller or self.controller
        with owner.locked():
            plan = chosen.plan(order, owner.now())
            chosen.check_path(plan.trajectory(chosen.start(0.0, state, owner.now()), owner.now()), state)
            chosen.accept(plan, state, owner.now(), listener=told)
        owner.hurry()
        owner.group.deliver()
        return told


class BoardBench(Bench):
    """With a board of a Hex7Bot."""

    def __init__(self, dialect: int = 2, baud: int = 0, faults: tuple[str, ...] = (), **options: Any) -> None:
        self.arm = Arm(dialect, baud, faults, attach=False)
        self.board, self.link = self.arm.board, self.arm.link
        super().__init__(self.arm.driver, self.arm.clock, period=0.05 if dialect == 2 else 0.667, **options)


def moving(joint: str = "J1", **options: Any) -> tuple[BoardBench, Told]:
    """A bench with an arm on its way for five seconds."""
    bench = BoardBench(**options)
    bench.owner.connect()
    bench.turn(0.2)
    bench.enable()
    told = bench.go(joint, 0.5, 5.0)
    bench.turn(1.0)
    assert bench.writes
    assert not told.ends
    return bench, told


def mute(bench: BoardBench, servo_id: int) -> None:
    """From now on a servo does not answer."""
    answer = bench.board.faults.bus_answer

    def silent(who: int, said: bytes | None) -> tuple[bytes, float]:
        return (b"", 0.0) if who == servo_id else answer(who, said)

    bench.board.faults.bus_answer = silent  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run


class Served:
    """A board behind a pseudo-terminal, served by a thread; `mute` has it hear everything and say nothing."""

    def __init__(self, baud: int = 0, dialect: int = 2) -> None:
        self.board = make_hex7bot_board(dialect=dialect, baud=baud, start=time.monotonic())
        out = self.board.faults.host_out
        self.muted = threading.Event()
        self.board.faults.host_out = (  # type: ignore[method-assign]  # a fault that begins in mid-run
            lambda data, now: b"" if self.muted.is_set() else out(data, now)
        )
        self._server = PtyServer(self.board)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)

    def _serve(self) -> None:
        while not self._end.is_set():
            self._server.run_once(0.02)

    def __enter__(self) -> Served:
        self.url = self._server.open()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join(30)
        self._server.close()


class Threaded:
    """A node's owner with its thread, on a served board. Its watchdog is long: these machines stall."""

    def __init__(self, served: Served, **options: Any) -> None:
        self.driver = Hex7BotDriver.from_url(served.url)
        self.owner = RobotOwner(self.driver, **({"watchdog": 20.0} | options))
        self.owner.connect(10.0)
        self.controller = make_controller(self.driver.model, period=0.5)
        self.owner.start((self.controller,))

    def newest(self) -> JointState:
        """The next state: those before may be too old if this machine stalls."""
        before = self.owner.state
        eventually(lambda: self.owner.state is not before)
        state = self.owner.state
        assert state is not None
        return state

    def go(self, joint: str, by: float, seconds: float) -> Told:
        """As `Bench.go`."""
        told, owner = Told(), self.owner
        state = self.newest()
        order = TrajectoryGoal((joint,), (Point(seconds, (state[joint].position + by,)),))
        with owner.locked():
            plan = self.controller.plan(order, owner.now())
            self.controller.accept(plan, state, owner.now(), listener=told)
        owner.hurry()
        return told

    def go_slowly(self) -> Told:
        """Have a joint go so slowly that it is on its way for long; it moves when this returns."""
        start = self.newest()["J1"].position
        told = self.go("J1", 0.4, 20.0)
        eventually(lambda: self.newest()["J1"].position > start + 0.002)
        return told
