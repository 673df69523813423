"""A robot that keeps no stop itself: its driver sends nothing after a stop that was asked for before it."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest
from tests.waits import PATIENCE, eventually

from hexwire import ArmModel, JointState, JointTarget, PlainDriver, StopMode
from hexwire.errors import CommandRefusedError, HexwireError, LimitError, StoppedError, UsageError
from hexwire.model.state import JointFlag

MODEL = ArmModel.of("noted", {"J1": (-1.0, 1.0), "J2": (-1.0, 1.0)}, max_speed=1.0)


class Noted(PlainDriver):
    """Notes what its hooks are asked for; `during` is called in the middle of each."""

    model = MODEL

    def __init__(self) -> None:
        super().__init__()
        self.done = list[str]()
        self.power: bool | None = True
        self.during: Callable[[str], None] = lambda what: None

    def on_read(self) -> JointState:
        return JointState.of({"J1": 0.0, "J2": 0.5}, stamp=self.now(), torque=self.power)

    def _note(self, what: str) -> None:
        self.during(what)
        self.done.append(what)

    def on_target(self, target: JointTarget) -> None:
        self._note(f"go {dict(target.positions)['J1']:g} in {target.duration:g}")

    def on_torque(self, on: bool, joints: tuple[str, ...]) -> None:
        self._note(f"torque {'on' if on else 'off'} {' '.join(joints)}")

    def on_hold(self) -> None:
        self._note("hold")


@pytest.fixture
def robot() -> Noted:
    noted = Noted()
    noted.attach()
    return noted


def go(angle: float) -> JointTarget:
    return JointTarget.of({"J1": angle}, duration=0.1)


def in_thread(call: Callable[[], object]) -> tuple[threading.Thread, list[object]]:
    """A thread that has begun, and the list that gets its outcome."""
    outcome: list[object] = []

    def run() -> None:
        try:
            outcome.append(call())
        except HexwireError as error:
            outcome.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread, outcome


# --- targets -------------------------------------------------------------------------------------------


def test_a_hook_gets_a_checked_target(robot: Noted) -> None:
    sent = robot.write(go(0.5))
    assert (robot.done, sent.positions, sent.duration) == (["go 0.5 in 0.5"], (("J1", 0.5),), 0.5)
    with pytest.raises(LimitError):
        robot.write(go(1.5))
    assert robot.done == ["go 0.5 in 0.5"]


@pytest.mark.parametrize(("power", "refused"), [(True, False), (None, False), (False, True)])
def test_a_joint_known_to_have_no_torque_gets_no_target(robot: Noted, power: bool | None, refused: bool) -> None:
    robot.power = power
    if not refused:
        robot.write(go(0.1))
        return
    with pytest.raises(CommandRefusedError, match="J1 has no torque"):
        robot.write(go(0.1))
    assert robot.done == []


def test_nothing_is_asked_of_a_robot_that_is_not_attached() -> None:
    robot = Noted()
    for call in (robot.read, robot.probe, robot.stop, lambda: robot.write(go(0.1)), lambda: robot.torque(True)):
        with pytest.raises(UsageError, match="not attached"):
            call()  # type: ignore[operator]
    assert robot.done == []
    robot.detach(torque_off=True)
    assert robot.done == []
    robot.attach()
    robot.detach(torque_off=True)
    assert robot.done == ["torque off J1 J2"]


def test_torque_names_joints_of_the_arm(robot: Noted) -> None:
    robot.torque(True, ["j2"])
    assert robot.done == ["torque on J2"]
    with pytest.raises(UsageError, match="J1"):
        robot.torque(True, ["J3"])
    assert robot.done == ["torque on J2"]


def test_a_probe_follows_from_the_model_and_the_state(robot: Noted, monkeypatch: pytest.MonkeyPatch) -> None:
    flags = (0, int(JointFlag.SILENT))
    monkeypatch.setattr(robot, "on_read", lambda: JointState.of({"J1": 0.0, "J2": 0.0}, stamp=0.0, flags=flags))
    robot.stop()
    report = robot.probe()
    assert (report.robot, report.missing, report.stopped) == ("noted", ("J2",), True)
    assert [(joint.name, joint.servo_id) for joint in report.joints] == [("J1", 1), ("J2", 2)]


def test_an_address_makes_one_with_the_options_of_its_constructor() -> None:
    assert isinstance(Noted.from_url("anywhere"), Noted)
    with pytest.raises(UsageError, match="a Noted has no option speed"):
        Noted.from_url("anywhere", speed=1)


# --- stops ---------------------------------------------------------------------------------------------


def test_a_stop_holds_until_resume(robot: Noted) -> None:
    assert robot.stop() == MODEL.names
    assert robot.read().stopped
    for call in (lambda: robot.write(go(0.1)), lambda: robot.torque(True)):
        with pytest.raises(StoppedError):
            call()
    robot.torque(False)
    robot.detach()
    robot.attach()
    assert robot.read().stopped, "it holds as long as this program runs"
    assert robot.stop_kept_by == ""
    robot.resume()
    robot.write(go(0.1))
    assert robot.done == ["hold", "torque off J1 J2", "go 0.1 in 0.1"]


@pytest.mark.parametrize("what", ["write", "torque on", "torque off", "resume"])
def test_a_call_that_waits_behind_another_is_void_after_a_stop_but_for_torque_off(robot: Noted, what: str) -> None:
    if what == "resume":
        robot.stop()
        robot.done.clear()
    calls: dict[str, Callable[[], object]] = {
        "write": lambda: robot.write(go(0.2)),
        "torque on": lambda: robot.torque(True),
        "torque off": lambda: robot.torque(False),
        "resume": robot.resume,
    }
    stopping = threading.Event()
    robot.epochs.on_stop(stopping.set)
    running, asked = threading.Event(), threading.Event()
    token = robot.epochs.token

    def seen(*args: Any, **options: Any) -> Any:
        found = token(*args, **options)
        asked.set()
        return found

    def during(hook: str) -> None:
        if not running.is_set():
            running.set()
            assert stopping.wait(PATIENCE)

    robot.during = during
    first, first_outcome = in_thread(lambda: robot.torque(False))
    assert running.wait(PATIENCE)
    robot.epochs.token = seen  # type: ignore[method-assign]  # tells when the call has its time
    second, outcome = in_thread(calls[what])
    assert asked.wait(PATIENCE)
    stop, confirmed = in_thread(robot.stop)
    for thread in (first, second, stop):
        thread.join(PATIENCE)
        assert not thread.is_alive()
    # The hook that ran was left to run, and the stop came after it; torque off that met it is done once more.
    off = "torque off J1 J2"
    assert robot.done[:1] == [off]
    assert sorted(robot.done[1:]) == ["hold", *[off] * (3 if what == "torque off" else 1)]
    assert robot.done[-1] == off
    assert (first_outcome, confirmed) == ([MODEL.names], [MODEL.names])
    if what == "torque off":
        assert outcome == [MODEL.names]
    else:
        assert isinstance(outcome[0], StoppedError), outcome
    assert robot.read().stopped


@pytest.mark.parametrize("what", ["write", "torque on"])
def test_a_call_made_before_a_stop_is_void_though_the_stop_has_ended(robot: Noted, what: str) -> None:
    token = robot.epochs.token("a call")
    robot.stop()
    robot.resume()
    with robot.epochs.using(token), pytest.raises(StoppedError, match="a stop came after the call"):
        robot.write(go(0.2)) if what == "write" else robot.torque(True)
    assert robot.done == ["hold"]
    # Torque off is never void.
    with robot.epochs.using(token):
        assert robot.torque(False) == MODEL.names
    assert robot.done == ["hold", "torque off J1 J2"]


def stop_at(robot: Noted, line: int, mode: StopMode, call: Callable[[], object]) -> tuple[int, object]:
    """Stop the robot at a line of a call, as a signal handler does; returns the lines seen, and the outcome."""
    seen = 0

    def trace(frame: FrameType, event: str, arg: object) -> Any:
        nonlocal seen
        if event == "line":
            seen += 1
            if seen == line:
                sys.settrace(None)
                robot.stop(mode)
                sys.settrace(trace)
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        outcome: object = call()
    except HexwireError as error:
        outcome = error
    finally:
        sys.settrace(before)
    return seen, outcome


@pytest.mark.parametrize("what", ["write", "torque"])
@pytest.mark.parametrize("mode", list(StopMode))
def test_a_signal_at_any_line_of_a_call_stops_last(what: str, mode: StopMode) -> None:
    at_rest = "hold" if mode is StopMode.HOLD else "torque off J1 J2"
    sent_and_stopped = refused = 0
    for line in range(1, 2000):
        robot = Noted()
        robot.attach()
        call = (lambda: robot.write(go(0.2))) if what == "write" else (lambda: robot.torque(True))  # noqa: B023
        seen, outcome = stop_at(robot, line, mode, call)
        if seen < line:
            break
        assert robot.done[-1] == at_rest, (line, robot.done)
        assert robot.read().stopped, line
        acted = [done for done in robot.done if done != at_rest]
        sent_and_stopped += len(acted)
        refused += isinstance(outcome, StoppedError)
        # Who is told that it was sent knows that it was sent before the stop.
        assert isinstance(outcome, StoppedError) or robot.done[0] == acted[0], (line, robot.done)
    else:
        pytest.fail("the call does not end")
    assert sent_and_stopped > 3
    assert refused > 10


def test_a_hook_that_fails_after_a_signal_is_stopped_again(robot: Noted) -> None:
    def during(hook: str) -> None:
        if hook.startswith("go"):
            robot.stop()
            raise CommandRefusedError("a move", 8, "no power")

    robot.during = during
    with pytest.raises(CommandRefusedError, match="no power"):
        robot.write(go(0.2))
    assert robot.done == ["hold", "hold"]


def test_a_stop_that_fails_lets_nothing_through_until_resume(robot: Noted) -> None:
    def during(hook: str) -> None:
        if hook == "hold":
            raise CommandRefusedError("hold", 8, "no power")

    robot.during = during
    with pytest.raises(CommandRefusedError):
        robot.stop()
    for call in (lambda: robot.write(go(0.1)), lambda: robot.torque(True)):
        with pytest.raises(StoppedError, match="not confirmed"):
            call()
    robot.resume()
    robot.write(go(0.1))
    assert robot.done == ["go 0.1 in 0.1"]


def test_another_threads_stop_is_not_repeated(robot: Noted) -> None:
    """It comes after the hook anyway."""
    stops: list[threading.Thread] = []

    def during(hook: str) -> None:
        if hook.startswith("go"):
            stops.append(in_thread(robot.stop)[0])
            eventually(lambda: robot.epochs.stopped)

    robot.during = during
    assert robot.write(go(0.2)).positions == (("J1", 0.2),)
    stops[0].join(PATIENCE)
    assert robot.done == ["go 0.2 in 0.2", "hold"]
