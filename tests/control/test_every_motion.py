"""A motion through the table is refused, or ends above it: every robot, and every way to move one."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import cycle, product
from types import SimpleNamespace
from typing import Any

import pytest
from tests.few import few
from tests.motion.arms import FakeTime, rest_to_rest

from hexwire.control.loop.owner import RobotOwner
from hexwire.control.motion.following import Pair, run_following
from hexwire.control.motion.goals import Point, TrajectoryGoal
from hexwire.control.motion.motions import MotionOptions, check_path, run_motion
from hexwire.control.motion.path_check import PathCheck
from hexwire.control.motion.teleop import TeleopController, run_teleop
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order, SharedArm
from hexwire.drivers import registry
from hexwire.drivers.abilities import OnboardPaths
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.registry import load_driver
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, UsageError
from hexwire.model.arm import ArmModel
from hexwire.model.arms import arms_with_geometry
from hexwire.model.kinematics import KinematicModel
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.motion.following import Following
from hexwire.motion.safety import StopReason
from hexwire.motion.teleop import StickMap, Teleop

SLACK = 0.0021
"""Metres that an arm in motion may come below the table: see `hexwire.motion.fence`."""


class Ideal(RobotDriver):
    """An arm that is where it was sent at once; it notes how low that was."""

    def __init__(self, model: ArmModel, time: FakeTime) -> None:
        super().__init__()
        self.model, self.time, self.stops = model, time, 0
        self.where: dict[str, float] = {}
        self.lowest = math.inf
        geometry = self.kinematics
        assert geometry is not None
        self.geometry = geometry
        self.put(posture(geometry, 0.06, 0.12))

    def put(self, where: Mapping[str, float]) -> None:
        self.where = {name: self.where.get(name, self.model.joint(name).offset) for name in self.model.names}
        self.where |= where
        points = self.geometry.points(self.geometry.from_joints(self.where))
        self.lowest = min(self.lowest, *[place[2] for place in points.values()])

    @property
    def is_attached(self) -> bool:
        return True

    def now(self) -> float:
        return self.time.now

    def attach(self) -> None: ...

    def detach(self, *, torque_off: bool = False) -> None: ...

    def read(self) -> JointState:
        self.time.now += 0.002
        zeros = (0.0,) * len(self.model.names)
        return JointState.of(
            {name: self.where[name] for name in self.model.names},
            velocity=zeros,
            torque=True,
            stamp=self.time.now,
            stopped=self.stops > 0,
        )

    def write(self, target: JointTarget) -> SentTarget:
        self.put(dict(target.positions))
        return SentTarget(target.positions, target.duration)

    def torque(self, on: bool, joints: object = None) -> tuple[str, ...]:
        return self.model.names

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        self.stops += 1
        return self.model.names

    def resume(self) -> None:
        self.stops = 0


def posture(geometry: KinematicModel, low: float, high: float) -> dict[str, float]:
    """Some posture within all limits whose lowest point is between two heights."""
    chance = random.Random(3)
    while True:
        angles = [chance.uniform(limit.minimum, limit.maximum) for limit in geometry.ranges]
        heights = [place[2] for place in geometry.points(angles).values()]
        if low < min(heights) < high and not geometry.violations(angles):
            return geometry.to_joints(angles)


class Case:
    """A robot above its table, and a goal below it."""

    def __init__(self, model: ArmModel) -> None:
        self.time = FakeTime()
        self.robot = Ideal(model, self.time)
        self.goal = posture(self.robot.geometry, -0.09, -0.04)
        self.target = JointTarget.of(self.goal, 5.0)
        self.options = MotionOptions(clock=lambda: self.time.now, sleep=self.time.sleep)

    def way(self) -> Any:
        names = tuple(self.goal)
        return rest_to_rest(names, [self.robot.where[n] for n in names], [self.goal[n] for n in names], 60.0)

    def steps(self) -> Callable[[], JointTarget]:
        """The way to the goal for something that checks nothing: a little more of it at each call."""
        begin, share = dict(self.robot.where), 0.0

        def step() -> JointTarget:
            nonlocal share
            share = min(1.0, share + 0.01)
            return JointTarget.of({n: begin[n] + share * (to - begin[n]) for n, to in self.goal.items()}, 0.05)

        return step

    def owned(self, owner: RobotOwner) -> None:
        owner.group.members = (Blind(self.robot.model.names, self.steps()),)  # type: ignore[assignment]
        with owner:
            while owner.group.reason is None:
                owner.turn()
            raise HexwireError(str(owner.group.reason))

    def arm(self, **settings: Any) -> ControlledArm:
        read, _ = read_settings({"port": "/dev/null", "robot": self.robot.model.name, **settings}, Faults())
        arm = ControlledArm(self.robot, read, clock=lambda: self.time.now, sleep=self.time.sleep)
        arm.connect()
        arm.owner.group.members = tuple(arm.controllers.values())
        for _ in range(20):
            arm.owner.turn()
        return arm


class Blind:
    """A controller that sends what it is given."""

    busy = moving = True

    def __init__(self, joints: tuple[str, ...], step: Callable[[], JointTarget]) -> None:
        self.joints, self.step = joints, step
        self.reason: StopReason | None = None

    def judge(self, *given: object) -> None: ...

    def cycle(self, *given: object) -> JointTarget:
        return self.step()

    def stop(self, reason: StopReason) -> None:
        self.reason = reason

    def take_ended(self) -> list[Any]:
        return []


def after(states: int, end: JointTarget) -> Callable[[JointState], JointTarget | None]:
    seen: list[JointState] = []

    def until(state: JointState) -> JointTarget | None:
        seen.append(state)
        return end if len(seen) > states else None

    return until


def up(case: Case) -> JointTarget:
    """A small motion that is allowed."""
    name = case.robot.geometry.joint_names[0]
    return JointTarget.of({name: case.robot.where[name] + 0.01}, 2.0)


def by_owner(case: Case) -> None:
    case.owned(RobotOwner(case.robot, borrowed=True, command_rate=20.0, sleep=case.time.sleep))


def by_goal(case: Case) -> None:
    arm, names = case.arm(), case.robot.model.names
    rows = tuple({**case.robot.where, **case.goal}[name] for name in names)
    arm.command("", TrajectoryGoal(names, (Point(60.0, rows),)))


def by_set_points(case: Case) -> None:
    arm, step = case.arm(), case.steps()
    for _ in range(300):
        arm.set_points(dict(step().positions))
        arm.owner.turn()
        if arm.owner.group.reason is not None:
            raise HexwireError(str(arm.owner.group.reason))


def by_pose(case: Case) -> None:
    arm = case.arm(poses={"low": {name: float(angle) for name, angle in case.goal.items()}})
    arm.go_to("low")


def by_client(case: Case) -> None:
    """A program at the other end of a shared arm."""
    arm = case.arm()
    shared = SharedArm(arm, Lease(), clock=lambda: case.time.now)
    order = Order(shared.take("Ann", 1).key, 1, case.robot.epochs.mark(), None, 0.0)
    shared.write(order, case.target)


def by_stick(case: Case) -> None:
    rules = Teleop(case.robot.model, None, StickMap())
    controller: Any = TeleopController(rules, lambda: ((), 0, 0.0), 0.05)
    step = case.steps()
    controller.cycle = lambda *given: step()
    run_teleop(case.robot, controller, 20.0, on_ready=lambda: ended_by(case), sleep=case.time.sleep)


def by_leader(case: Case) -> None:
    leader, step = Ideal(case.robot.model, case.time), case.steps()
    leader.read_positions = lambda within=0.0: (leader.put(dict(step().positions)), leader.read())[1]  # type: ignore[method-assign]
    leader.torque = lambda on, joints=None: leader.model.names  # type: ignore[method-assign]
    rules = Following(leader.model, case.robot.model)
    run_following(Pair(leader, case.robot, rules), 20.0, on_ready=lambda: ended_by(case), sleep=case.time.sleep)


def ended_by(case: Case) -> None:
    """Raise in the loop of a program that would go on for ever, once its arm is stopped or has gone far."""
    read, until = case.robot.read, case.time.now + 120.0

    def seen() -> JointState:
        if case.robot.stops or case.time.now > until:
            raise HexwireError("stopped" if case.robot.stops else "it went on")
        return read()

    case.robot.read = seen  # type: ignore[method-assign]


FRONTS: dict[str, Callable[[Case], object]] = {
    "target": lambda case: run_motion(case.robot, case.target, case.options),
    "target, not waited for": lambda case: run_motion(case.robot, case.target, case.options, wait=False),
    "trajectory": lambda case: run_motion(case.robot, case.way(), case.options),
    "check_path": lambda case: check_path(case.robot, case.way()),
    "what replaces a motion": lambda case: run_motion(
        case.robot, up(case), case.options, until=after(3, case.target)
    ),
    "owner": by_owner,
    "goal": by_goal,
    "set-points": by_set_points,
    "pose": by_pose,
    "shared arm": by_client,
    "teleop": by_stick,
    "follow": by_leader,
}


@few("robot", arms_with_geometry(), "hex7bot", "so101")
def test_every_front_refuses_a_motion_through_the_table(robot: str) -> None:
    model = load_driver(robot).from_url("tcp://127.0.0.1:1" if robot == "puma260" else "/dev/null").model
    for front, move in FRONTS.items():
        case = Case(model)
        with pytest.raises(HexwireError) as refused:
            move(case)
        assert case.robot.lowest > -SLACK, front
        # Their loops end with the stop of the arm, not with its reason.
        wanted = "stopped" if front in ("teleop", "follow") else "below the table"
        assert wanted in str(refused.value), (front, refused.value)


WAYS = ("target", "target, not waited for", "trajectory", "check_path", "what replaces a motion")


@few("robot, front", product(arms_with_geometry(), WAYS), *zip(cycle(arms_with_geometry()), WAYS, strict=False))
def test_answers_that_are_missed_before_a_motion_switch_no_check_off(robot: str, front: str) -> None:
    """A position that is unknown for a moment, as of an arm behind a busy computer."""
    case = Case(load_driver(robot).from_url("tcp://127.0.0.1:1" if robot == "puma260" else "/dev/null").model)
    move, read, left = partial(FRONTS[front], case), case.robot.read, 3

    def missed() -> JointState:
        nonlocal left
        state, left = read(), left - 1
        if left < 0:
            return state
        n = len(state.names)
        return replace(state, flags=(int(JointFlag.SILENT),) * n, position=(math.nan,) * n)

    case.robot.read = missed  # type: ignore[method-assign]
    with pytest.raises(HexwireError, match="below the table"):
        move()
    assert case.robot.lowest > -SLACK


@pytest.mark.parametrize("robot", arms_with_geometry())
def test_the_check_is_switched_off_by_name_only(robot: str) -> None:
    model = load_driver(robot).from_url("tcp://127.0.0.1:1" if robot == "puma260" else "/dev/null").model
    for options in ({"check_geometry": False}, {"table": None}):
        case = Case(model)
        how = MotionOptions(clock=lambda: case.time.now, sleep=case.time.sleep, **options)  # noqa: B023
        run_motion(case.robot, case.target, how)
        assert case.robot.lowest < -0.03, options
    case = Case(model)
    with pytest.raises(HexwireError, match="below the table"):
        by_owner(case)
    free = PathCheck.limits_only(model)
    owner = RobotOwner(case.robot, borrowed=True, check=free, command_rate=20.0, sleep=case.time.sleep)
    owner.group.members = (Blind(model.names, case.steps()),)  # type: ignore[assignment]
    with owner:
        for _ in range(110):
            owner.turn()
    assert case.robot.lowest < -0.03


def test_a_driver_knows_its_geometry_and_takes_another() -> None:
    from hexwire.model.geometry import kinematics_for

    driver = load_driver("hex7bot").from_url("/dev/null")
    other = kinematics_for(driver.model, "B")
    assert driver.kinematics is driver.kinematics
    assert other is not None
    driver.kinematics = other
    assert driver.kinematics is other
    nobody = SimpleNamespace(model=ArmModel("nobody", driver.model.joints), _kinematics=None)
    assert RobotDriver.kinematics.fget(nobody) is None  # type: ignore[attr-defined]


WRONG: dict[str, tuple[Callable[[Any], object], str]] = {
    "write a dict": (lambda robot: robot.write({"J1": 0.1}), r"takes a JointTarget, .*'J1': 0.1"),
    "write by name": (lambda robot: robot.write(target={"J1": 0.1}), "takes a JointTarget"),
    "torque of a text": (lambda robot: robot.torque(True, "J1"), r"several names, as in \['J1'\]; this is 'J1'"),
    "torque by text": (lambda robot: robot.torque("off"), "takes True or False"),
    "torque of a number": (lambda robot: robot.torque(True, 1), "several names"),
    "path of a text": (lambda robot: robot.path("J1"), "several names"),
    "ioctl of a text": (lambda robot: robot.ioctl("STATS"), "a whole number"),
    "run a dict": (lambda robot: run_motion(robot, {"J1": 0.1}), "a motion is a trajectory"),  # type: ignore[arg-type]
    "run nothing": (lambda robot: run_motion(robot, None), "a motion is a trajectory"),  # type: ignore[arg-type]
    "run names": (lambda robot: run_motion(robot, ["J1"]), "a motion is a trajectory"),  # type: ignore[list-item]
    "check a dict": (lambda robot: check_path(robot, {"J1": 0.1}), "a motion is a trajectory"),  # type: ignore[arg-type]
    "options": (
        lambda robot: run_motion(robot, JointTarget.of({"J1": 0.1}), {"table": None}),  # type: ignore[arg-type]
        "options are MotionOptions",
    ),
    "target of a dict": (lambda robot: JointTarget({"J1": 0.1}), "takes a mapping"),  # type: ignore[arg-type]
    "target of names": (lambda robot: JointTarget(("J1", "J2")), "takes a mapping"),  # type: ignore[arg-type]
    "connect": (lambda robot: registry.connect(7), "a port is text"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("robot", [*arms_with_geometry(), "own"])
def test_what_a_program_passes_by_mistake_is_told_what_is_wanted(robot: str) -> None:
    """Before anything is sent, so that it needs no robot that is attached."""
    if robot == "own":
        driver: RobotDriver = Ideal(load_driver("so101").from_url("/dev/null").model, FakeTime())
    else:
        driver = load_driver(robot).from_url("tcp://127.0.0.1:1" if robot == "puma260" else "/dev/null")
    for what, (call, text) in WRONG.items():
        if what.startswith("path") and not isinstance(driver, OnboardPaths):
            continue
        with pytest.raises(UsageError) as told:
            call(driver)
        assert re.search(text, str(told.value)), (what, told.value)
        assert "\n" not in str(told.value), what
