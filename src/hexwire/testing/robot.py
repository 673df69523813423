"""What every robot must do, whatever is behind it.

Owns the questions that `RobotDriver` answers in its documentation. A robot inherits all of them with a few lines::

    class TestSwing(RobotConformance):
        def make_robot(self, tmp_path):
            return SwingDriver(...)

`make_robot` builds a driver that is not attached, of a robot without hardware: one that is emulated, or pretends.
Must not know any particular robot.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hexwire.drivers.abilities import (
    Counters,
    Leased,
    OnboardPaths,
    OwnWatchdog,
    ServoPing,
    ServoTables,
    StateReports,
    Watchdog,
)
from hexwire.drivers.base import ProbeReport, RobotDriver, Signal, StopMode
from hexwire.errors import HexwireError, LimitError, NotSupportedError, StoppedError, UsageError
from hexwire.model.state import JointFlag, JointState, JointTarget

from .link import PATIENCE, descriptors

__all__ = ["RobotConformance"]


class RobotConformance:
    """Inherit, give `make_robot`, and say what the robot cannot do."""

    step = 0.05
    """How far a test moves the joint, radians."""
    tolerance = 0.02
    """How near it must come, and how far it may drift where nothing should move, radians."""

    def make_robot(self, tmp_path: Path) -> RobotDriver:
        """A driver that is not attached. Every call makes a new robot."""
        raise NotImplementedError

    def wait(self, robot: RobotDriver, seconds: float) -> None:
        """Let time pass for the robot; override it for one in simulated time."""
        time.sleep(seconds)

    def choose(self, state: JointState) -> str:
        """The joint that the tests move: the first one with a known position and room on both sides."""
        for name, position in state.positions.items():
            joint = self._model.joint(name)
            if joint.minimum + 2 * self.step < position < joint.maximum - 2 * self.step:
                return name
        raise AssertionError("no joint has room to move: begin in another pose, or make `step` smaller")

    @pytest.fixture(autouse=True)
    def nothing_left(self) -> Iterator[None]:
        """No descriptor and no thread is left when the test is over."""
        before, threads = descriptors(), set(threading.enumerate())
        yield
        assert threads.issuperset(threading.enumerate()), "a thread was left running"
        assert descriptors() <= before, "a descriptor was left open"

    @pytest.fixture
    def detached(self, nothing_left: None, tmp_path: Path) -> Iterator[RobotDriver]:
        """A robot as it is made."""
        robot = self.make_robot(tmp_path)
        self._model = robot.model
        yield robot
        robot.detach()

    @pytest.fixture
    def robot(self, detached: RobotDriver) -> RobotDriver:
        """An attached robot that is not stopped."""
        detached.attach()
        if detached.read().stopped:
            detached.resume()
        return detached

    @pytest.fixture
    def ready(self, robot: RobotDriver) -> RobotDriver:
        """An attached robot with torque."""
        robot.torque(True)
        return robot

    def arrives(self, robot: RobotDriver, name: str, angle: float) -> bool:
        """Whether a joint gets to an angle."""
        for _ in range(100):
            if abs(robot.read()[name].position - angle) <= self.tolerance:
                return True
            self.wait(robot, 0.05)
        return False

    def stays(self, before: JointState, after: JointState) -> bool:
        """Whether no joint has moved."""
        return all(
            math.isnan(old) or abs(old - new) <= self.tolerance
            for old, new in zip(before.position, after.position, strict=True)
        )

    # --- the arm's description ----------------------------------------------------------------------

    def test_the_model_is_sound(self, detached: RobotDriver) -> None:
        """Names are unique, and limits and speeds are numbers in order."""
        model = detached.model
        assert model.names
        assert len(set(model.names)) == len(model.names)
        for joint in model.joints:
            assert -math.inf < joint.minimum < joint.maximum < math.inf, joint.name
            assert 0 < joint.max_speed < math.inf, joint.name

    # --- attaching ----------------------------------------------------------------------------------

    def test_nothing_is_open_before_attach(self, detached: RobotDriver) -> None:
        """The constructor does no I/O, and a call that needs the robot says so."""
        assert not detached.is_attached
        detached.detach()
        with pytest.raises(HexwireError):
            detached.read()
        assert not detached.is_attached

    def test_it_is_a_context_manager(self, detached: RobotDriver) -> None:
        """A `with` block attaches and detaches."""
        with detached as robot:
            assert robot is detached
            assert robot.is_attached
            assert isinstance(robot.url, str)
        assert not detached.is_attached

    def test_it_attaches_again(self, detached: RobotDriver) -> None:
        """`detach` may be called twice, and `attach` after it."""
        for _ in range(3):
            detached.attach()
            assert detached.read().names == detached.model.names
            detached.detach()
            detached.detach()
            assert not detached.is_attached

    def test_attaching_moves_nothing(self, robot: RobotDriver) -> None:
        """Neither `attach` nor reading sets a joint in motion."""
        before = robot.read()
        robot.detach()
        robot.attach()
        self.wait(robot, 0.2)
        assert self.stays(before, robot.read())

    def test_abort_closes_it(self, robot: RobotDriver) -> None:
        """`abort` closes the connection; the robot can be attached again."""
        robot.abort()
        assert not robot.is_attached
        robot.attach()
        assert robot.read().names == robot.model.names

    # --- states -------------------------------------------------------------------------------------

    def test_a_state_has_one_value_for_each_joint(self, robot: RobotDriver) -> None:
        """All tuples of a state are as long as `names`, and the state is frozen."""
        state = robot.read()
        assert state.names == robot.model.names
        for field in ("position", "velocity", "load", "current", "voltage", "temperature", "flags", "age"):
            assert len(getattr(state, field)) == len(state.names), field
        for reading in state:
            assert isinstance(reading.position, float)
            assert isinstance(reading.flags, JointFlag)
            assert reading.age >= 0.0
        with pytest.raises(dataclasses.FrozenInstanceError):
            state.stamp = 0.0  # type: ignore[misc]  # to see that it cannot be done

    def test_stamps_are_on_the_robots_clock(self, robot: RobotDriver) -> None:
        """A stamp is not in the future, and none goes back."""
        first = robot.read()
        self.wait(robot, 0.02)
        second = robot.read()
        assert first.stamp <= second.stamp <= robot.now()

    def test_the_newest_state_has_an_age(self, robot: RobotDriver) -> None:
        """`newest` gives a state of all joints, not older than the last one that was read."""
        before = robot.read()
        state, age = robot.newest()
        assert state.names == robot.model.names
        assert before.stamp <= state.stamp
        assert 0.0 <= age <= robot.now() - state.stamp

    def test_positions_alone_are_those_of_a_state(self, robot: RobotDriver) -> None:
        """`read_positions` agrees with `read`."""
        state, positions = robot.read(), robot.read_positions()
        assert positions.names == state.names
        assert self.stays(state, positions)

    def test_states_that_it_reports_on_its_own(self, robot: RobotDriver) -> None:
        """`stream` yields states, if it reports any."""
        reports = StateReports.find(robot)
        if reports is None:
            return
        for number, state in enumerate(reports.stream(0.05)):
            assert state.names == robot.model.names
            if number == 2:
                break
        reports.discard_reports()

    def test_probe_names_every_joint(self, robot: RobotDriver) -> None:
        """A report has a row for each joint, and counters are whole numbers."""
        report = robot.probe()
        assert isinstance(report, ProbeReport)
        assert [row.name for row in report.joints] == list(robot.model.names)
        assert isinstance(report.missing, tuple)
        counted = [report.counters]
        if (counters := Counters.find(robot)) is not None:
            counted += [counters.host_counters(), counters.board_counters()]
        for values in counted:
            assert all(type(value) is int for value in values.values()), values
        robot.examine()

    # --- torque and motion --------------------------------------------------------------------------

    def test_torque_moves_nothing(self, robot: RobotDriver) -> None:
        """Switching torque on and off names joints of the arm, and moves none."""
        before = robot.read()
        assert set(robot.torque(True)) <= set(robot.model.names)
        self.wait(robot, 0.2)
        assert self.stays(before, robot.read())
        assert not any(reading.flags & JointFlag.SILENT for reading in robot.read())
        assert set(robot.torque(False)) <= set(robot.model.names)
        assert not any(reading.flags & JointFlag.TORQUE_ON for reading in robot.read())

    def test_a_target_is_reached(self, ready: RobotDriver) -> None:
        """`write` says what it sent, and the joint gets there; the others stay."""
        before = ready.read()
        name = self.choose(before)
        goal = before[name].position + self.step
        sent = ready.write(JointTarget.of({name: goal}, duration=0.3))
        assert dict(sent.positions)[name] == pytest.approx(goal, abs=self.tolerance)
        assert sent.duration >= 0.0
        assert self.arrives(ready, name, goal), f"{name} did not get to {goal:.3f} rad"
        after = ready.read()
        others = [other for other in before.names if other != name and not math.isnan(before[other].position)]
        assert all(abs(before[o].position - after[o].position) <= self.tolerance for o in others)

    def test_a_target_outside_the_limits_is_refused_whole(self, ready: RobotDriver) -> None:
        """One bad joint refuses all: nothing is sent."""
        before = ready.read()
        name = self.choose(before)
        others = [other for other in ready.model.names if other != name]
        bad = ready.model.joint(others[0] if others else name)
        for angle in (bad.maximum + 0.2, bad.minimum - 0.2):
            target = {name: before[name].position + self.step, bad.name: angle}
            with pytest.raises(LimitError):
                ready.write(JointTarget.of(target, duration=0.3))
        self.wait(ready, 0.5)
        assert self.stays(before, ready.read())

    def test_a_joint_that_the_arm_does_not_have_is_refused(self, ready: RobotDriver) -> None:
        """An unknown name is an error of the caller."""
        with pytest.raises(HexwireError):
            ready.write(JointTarget.of({"no such joint": 0.0}))

    # --- stop ---------------------------------------------------------------------------------------

    def test_a_stop_holds_until_resume(self, ready: RobotDriver) -> None:
        """After `stop` every target is refused; `resume` ends that and moves nothing."""
        before = ready.read()
        name = self.choose(before)
        target = JointTarget.of({name: before[name].position + self.step}, duration=0.3)
        ready.stop()
        ready.stop()
        assert ready.read().stopped
        assert ready.stop_latch().stopped
        with pytest.raises(StoppedError):
            ready.write(target)
        self.wait(ready, 0.5)
        assert self.stays(before, ready.read())
        ready.resume()
        self.wait(ready, 0.2)
        state = ready.read()
        assert not state.stopped
        assert not ready.stop_latch().stopped
        assert self.stays(before, state)
        ready.torque(True)
        ready.write(target)
        assert self.arrives(ready, name, dict(target.positions)[name])

    def test_a_stop_in_motion_ends_the_motion(self, ready: RobotDriver) -> None:
        """The joint is at rest after a stop, and stays there."""
        state = ready.read()
        name = self.choose(state)
        ready.write(JointTarget.of({name: state[name].position + self.step}, duration=2.0))
        ready.stop()
        self.wait(ready, 0.3)
        at_rest = ready.read()
        self.wait(ready, 0.3)
        assert self.stays(at_rest, ready.read())

    def test_a_stop_takes_the_torque_away_if_it_is_asked_to(self, ready: RobotDriver) -> None:
        """`StopMode.TORQUE_OFF` leaves no joint with torque."""
        ready.stop(StopMode.TORQUE_OFF)
        assert not any(reading.flags & JointFlag.TORQUE_ON for reading in ready.read())

    def test_another_thread_may_stop_it(self, ready: RobotDriver) -> None:
        """`stop` may be called from any thread."""
        thread = threading.Thread(target=ready.stop, daemon=True)
        thread.start()
        thread.join(PATIENCE)
        assert not thread.is_alive()
        assert ready.read().stopped

    def test_a_stop_outlasts_the_connection(self, ready: RobotDriver) -> None:
        """A stop is kept where `stop_kept_by` says, if anywhere."""
        if ready.stop_kept_by == "":
            return
        ready.stop()
        ready.detach()
        ready.attach()
        assert ready.stop_latch().stopped
        ready.resume()
        assert not ready.stop_latch().stopped

    def test_signals_are_the_same_by_number(self, ready: RobotDriver) -> None:
        """The chapter's `signal` reaches stop and resume, and refuses other numbers."""
        ready.signal(Signal.STOP.value)
        assert ready.read().stopped
        ready.signal(Signal.RESUME.value)
        assert not ready.read().stopped
        with pytest.raises(UsageError):
            ready.signal(9999)

    # --- what it has, or says that it has not ---------------------------------------------------------

    def test_the_watchdog(self, robot: RobotDriver) -> None:
        """`watched` protects its block, or says that nothing does."""
        with robot.watched(1.0) as covered:
            dog = Watchdog.find(robot)
            assert covered == (dog is not None)
            assert covered or not robot.can(OwnWatchdog)
            assert dog is None or dog.watchdog_armed
        assert dog is None or not dog.watchdog_armed

    def test_what_it_has_not_it_says(self, robot: RobotDriver) -> None:
        """An ability that it has not is refused in words that name the arm."""
        for kind in (Watchdog, StateReports, OnboardPaths, ServoPing, ServoTables, Leased):
            if not robot.can(kind):
                assert kind.find(robot) is None, kind
                with pytest.raises(NotSupportedError, match=re.escape(robot.model.name)):
                    kind.of(robot)
        # A driver that knows it only when it is attached.
        if isinstance(robot, Watchdog) and not robot.can(Watchdog):
            with pytest.raises(NotSupportedError):
                robot.watchdog(1.0)
        if isinstance(robot, StateReports) and not robot.can(StateReports):
            with pytest.raises(NotSupportedError):
                next(iter(robot.stream(0.05)))
        if isinstance(robot, OnboardPaths) and not robot.can(OnboardPaths):
            with pytest.raises(NotSupportedError):
                robot.path()

    def test_what_it_cannot_do_is_an_error_of_hexwire(self, robot: RobotDriver) -> None:
        """An unknown special command raises no other kind of error."""
        with pytest.raises(HexwireError):
            robot.ioctl(0x7FFF_FFFF)
        with contextlib.suppress(HexwireError):
            assert ServoPing.of(robot).ping(1) in (None, *range(256))
        assert isinstance(robot.may_move(0), bool)
        assert robot.command_rate > 0
