"""Arms for the tests of controllers: an ideal one under a controller alone, an emulated one under everything."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Generic, TypeVar

from tests.drivers.arms import Arm as EmulatedArm
from tests.motion.arms import HOME, NAMES, FakeRobot, FakeTime
from tests.waits import turn_while_it_waits

from hexwire.control.loop.controller import TrajectoryController
from hexwire.control.loop.outcomes import Ended, Outcome, Reason
from hexwire.control.motion.arrival import Tolerance
from hexwire.control.motion.goals import Point, Tolerances, TrajectoryGoal
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings import ControllerSettings
from hexwire.control.requests.settings_reader import read_settings
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointFlag, JointState, JointTarget
from hexwire.motion.safety import SafetyLimits, StopReason
from hexwire.motion.teach import Taught

_T = TypeVar("_T")

STEP = 0.01
PERIOD = 0.05
LEAD = 0.075


class Told:
    """A goal, and what it was told."""

    def __init__(self) -> None:
        self.ends: list[Ended] = []

    def ended(self, ended: Ended) -> None:
        self.ends.append(ended)

    @property
    def outcome(self) -> tuple[Outcome, Reason]:
        (end,) = self.ends
        return end.outcome, end.reason

    @property
    def text(self) -> str:
        (end,) = self.ends
        return end.text

    @property
    def words(self) -> str:
        """Outcome and text."""
        (end,) = self.ends
        return f"{end.outcome.value}: {end.text}"


SUCCEEDED = (Outcome.SUCCEEDED, Reason.REACHED)
PREEMPTED = (Outcome.PREEMPTED, Reason.REPLACED)
CANCELLED = (Outcome.PREEMPTED, Reason.CANCELLED)
ABORTED_PATH = (Outcome.ABORTED, Reason.PATH_TOLERANCE)
ABORTED_GOAL = (Outcome.ABORTED, Reason.GOAL_TOLERANCE)
ABORTED_LATE = (Outcome.ABORTED, Reason.TOO_LATE)
STOPPED = (Outcome.ABORTED, Reason.STOPPED)
NOT_READY = (Outcome.ABORTED, Reason.NOT_READY)


def tolerances(
    names: tuple[str, ...] = NAMES,
    *,
    path: Mapping[str, Tolerance] | None = None,
    goal: float = 0.0,
    goal_time: float = 0.0,
) -> Tolerances:
    """Tolerances that check nothing but what is given, and that the arm is at rest in the end."""
    return Tolerances(
        {name: (path or {}).get(name, Tolerance()) for name in names},
        {name: Tolerance(goal, 0.01) for name in names},
        goal_time,
    )


def order(*points: tuple[float, Mapping[str, float]], delay: float = 0.0, still: bool = False) -> TrajectoryGoal:
    """Points of all joints: home but for what is given; `still` gives them velocity 0."""
    rows = [
        Point(time, tuple({**HOME, **where}[n] for n in NAMES), (0.0,) * len(NAMES) if still else ())
        for time, where in points
    ]
    return TrajectoryGoal(NAMES, tuple(rows), delay)


def limp(what: JointState) -> JointState:
    """The same without torque."""
    return replace(what, flags=tuple(flag & ~JointFlag.TORQUE_ON for flag in what.flags))


class Loop:
    """A controller alone, with states at 100 Hz, cycles at 20 Hz, and an arm that does as it is told."""

    def __init__(self, *, monitored: bool = True, **settings: Any) -> None:
        self.time = FakeTime()
        self.robot = FakeRobot(self.time)
        self.controller = TrajectoryController(
            ControllerSettings(
                "", **({"joints": NAMES, "allow_partial": True, "tolerances": tolerances()} | settings)
            ),
            HEX7BOT,
            SafetyLimits.at_period(PERIOD),
            check=PathCheck.limits_only(HEX7BOT),
            monitored=monitored,
        )
        self.track: list[tuple[float, dict[str, float]]] = []
        self.reason: StopReason | None = None
        self.change: Callable[[JointState], JointState] = lambda state: state
        self._due = -1.0
        self.run(0.1)

    @property
    def now(self) -> float:
        return self.time.now

    @property
    def state(self) -> JointState:
        return self.change(self.robot.read())

    def where(self, joint: str) -> float:
        return self.state[joint].position

    def send(self, sent: TrajectoryGoal, **options: Any) -> Told:
        """As a node does it; time does not pass."""
        told, controller = Told(), self.controller
        plan = controller.plan(sent, self.now)
        start = controller.start(sent.delay, self.state, self.now)
        controller.check_path(plan.trajectory(start, self.now), self.state)
        controller.accept(plan, self.state, self.now, listener=told, **options)
        self.deliver()
        return told

    def stream(self, positions: Mapping[str, float], state: JointState | None = None) -> None:
        """Set-points, as a node follows them."""
        self.controller.check_set_points(positions, state or self.state)
        self.controller.follow_set_points(positions, self.now)

    def deliver(self) -> None:
        for goal, ended in self.controller.take_ended():
            goal.ended(ended)

    def turn(self) -> None:
        """A state and what follows from it."""
        state = self.state
        last = self.track[-1] if self.track else (self.now - STEP, state.positions)
        step = max(self.now - last[0], 1e-9)
        speeds = [(angle - last[1][name]) / step for name, angle in state.positions.items()]
        self.track.append((self.now, state.positions))
        self.controller.judge(state, speeds, self.now)
        if self.now >= self._due:
            self._due = self.now + PERIOD - 1e-6
            told = self.controller.cycle(state, self.now, LEAD)
            if isinstance(told, JointTarget):
                self.robot.write(told)
            elif told is not None:
                self.reason = told
        self.deliver()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP)):
            self.turn()
            self.time.sleep(STEP)

    def speeds(self, joint: str) -> list[float]:
        """Between states."""
        return [
            (b[1][joint] - a[1][joint]) / (b[0] - a[0])
            for a, b in zip(self.track, self.track[1:], strict=False)
            if b[0] > a[0]
        ]


class Service(Generic[_T]):
    """A call in a thread of its own, and what came of it."""

    def __init__(self, call: Callable[[], _T]) -> None:
        self._call = call
        self._answers: list[_T] = []
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        try:
            self._answers.append(self._call())
        except BaseException as error:  # noqa: BLE001  # judged by the test
            self.error = error

    def answer(self) -> _T:
        self.thread.join(30.0)
        assert not self.thread.is_alive()
        if self.error is not None:
            raise self.error
        return self._answers[0]


class Bench:
    """All of the node but ROS, around an emulated board in simulated time."""

    def __init__(self, *, dialect: int = 2, faults: tuple[str, ...] = (), **params: Any) -> None:
        self.emulated = EmulatedArm(dialect, 0, faults, attach=False)
        self.clock, self.board, self.link = self.emulated.clock, self.emulated.board, self.emulated.link
        settings, _ = read_settings({"port": "/dev/null", **params}, Faults())
        self.taught: list[Taught] = []
        self.arm = ControlledArm(
            self.emulated.driver, settings, on_taught=self.taught.append, clock=self.clock, sleep=self.clock.sleep
        )
        self.owner = self.arm.owner
        self.track: list[tuple[float, list[float]]] = []
        self.jammed: dict[int, float] = {}
        self.arm.connect()
        self.owner.group.members = tuple(self.arm.controllers.values())
        self.turn(0.2)

    @property
    def controller(self) -> TrajectoryController:
        return next(iter(self.arm.controllers.values()))

    def where(self, joint: str) -> float:
        """Where a shaft really is, radians."""
        model = HEX7BOT.joint(joint)
        return model.counts_to_angle(self.emulated.shaft(model.servo_id))

    def torques(self) -> list[bool]:
        return self.emulated.torques()

    def _step(self) -> None:
        for i, position in self.jammed.items():
            self.board.wire[i].motion.position, self.board.wire[i].motion.velocity = position, 0.0
        self.owner.turn()
        self.track.append((self.clock.time, self.emulated.shafts()))

    def jam(self, joint: str) -> None:
        i = HEX7BOT.joint(joint).servo_id
        self.jammed[i] = self.emulated.shaft(i)

    def silence(self, joint: str) -> None:
        """From now on its servo does not answer."""
        i, faults = HEX7BOT.joint(joint).servo_id, self.board.faults
        answer = faults.bus_answer

        def bus_answer(who: int, said: bytes | None) -> tuple[bytes, float]:
            return answer(who, None if who == i else said)

        faults.bus_answer = bus_answer  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run

    def turn(self, seconds: float) -> None:
        end = self.clock.time + seconds
        while self.clock.time < end:
            self._step()

    def until(self, condition: Callable[[], object], seconds: float = 30.0) -> None:
        end = self.clock.time + seconds
        while not condition():
            assert self.clock.time < end
            self._step()

    def begin(self, call: Callable[[], _T]) -> Service[_T]:
        """What a service's thread asks for, without turning meanwhile."""
        return Service(call)

    def ask(self, call: Callable[[], _T]) -> _T:
        """The same, turning until it is answered. Time passes while it waits, not while it is slow."""
        service = self.begin(call)
        self.settle(service)
        return service.answer()

    def settle(self, service: Service[Any]) -> None:
        end = self.clock.time + 600.0

        def turn() -> None:
            assert self.clock.time < end
            self._step()

        turn_while_it_waits(service.thread, turn)

    def command(self, sent: TrajectoryGoal, name: str = "", **options: Any) -> Told:
        told = Told()
        self.arm.command(name, sent, listener=told, **options)
        return told


POSES = {"side": {"J1": HOME["J1"] + 0.5, "J4": 0.4}, "home": dict(HOME), "grip": {"J7": 0.3}}
SPLIT = {"arm": {"joints": list(NAMES[:6])}, "hand": {"joints": ["J7"]}}


def make_bench(*, on: bool = True, **options: Any) -> Bench:
    bench = Bench(**({"poses": POSES, "check_table": False} | options))
    if on:
        assert bench.ask(lambda: bench.arm.enable(True)) == "torque is on"
    return bench


def free(bench: Bench) -> bool:
    """Nobody has the arm for longer."""
    return not bench.arm._busy.locked() and not bench.arm.teach_mode.hand.power.locked()


def guide(bench: Bench, joint: str, by: float, seconds: float = 1.0) -> None:
    """A hand moves a limp joint."""
    model = HEX7BOT.joint(joint)
    servo = bench.board.wire[model.servo_id]
    assert not servo.torque_on
    start, begin = bench.emulated.shaft(model.servo_id), bench.clock.time
    while bench.clock.time < begin + seconds:
        servo.motion.position = start + by / model.scale * min(1.0, (bench.clock.time - begin) / seconds)
        bench._step()
