"""`sim://hex7bot`, `sim://so101`: an emulated arm inside the program."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from tests.waits import PATIENCE

from hexwire.bus.servo_bus import ServoBus
from hexwire.control.requests.diagnostics import RobotFacts, _stop_reason
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.checkup import judge_state
from hexwire.drivers.registry import connect
from hexwire.emulator import serve_sim, stalls
from hexwire.emulator.hand import HandOrder, HandResult, Hands
from hexwire.emulator.serve_hand import move_by_hand
from hexwire.emulator.serve_sim import SimBusLink, SimLink
from hexwire.emulator.servo import EmulatedServo
from hexwire.emulator.servo_motion import Motion
from hexwire.errors import LinkBusyError, LinkClosedError, LinkNotFoundError, StoppedError, UsageError
from hexwire.link.impair import ImpairedLink
from hexwire.link.open import make_link
from hexwire.link.tap import TapLink
from hexwire.model.state import JointState, JointTarget
from hexwire.motion.safety import board_stop
from hexwire.wire.registers import Series


class Echo:
    """A device that sends back what it receives, and something of its own at a time."""

    def __init__(self, due: float | None = None) -> None:
        self.due, self.out = due, b""
        self.seen: list[str] = []

    def receive(self, data: bytes, now: float) -> None:
        self.seen.append("receive")
        self.out += data

    def step(self, now: float) -> None:
        self.seen.append("step")
        if self.due is not None and now >= self.due:
            self.due, self.out = None, self.out + b"due"

    def data_to_send(self) -> bytes:
        out, self.out = self.out, b""
        return out

    def next_event_time(self) -> float | None:
        return self.due

    def reset(self, now: float) -> None:
        raise NotImplementedError


def test_it_answers_and_sends_by_itself_when_something_is_due() -> None:
    device = Echo()
    with SimLink("sim://hex7bot", device) as link:
        link.write(b"hello")
        assert link.read(time.monotonic() + PATIENCE) == b"hello"
        assert link.read(time.monotonic()) == b""
        device.due = time.monotonic() + 0.02
        assert link.read(time.monotonic() + PATIENCE) == b"due"


def test_what_was_due_before_a_write_is_done_before_it() -> None:
    # Otherwise the write would feed a watchdog that has expired.
    device = Echo()
    with SimLink("sim://hex7bot", device) as link:
        device.seen.clear()
        link.write(b"x")
        assert device.seen == ["step", "receive"]


def test_it_opens_once_and_forgets_what_was_sent_while_it_was_closed() -> None:
    link = SimLink("sim://hex7bot", Echo())
    with pytest.raises(LinkClosedError, match="closed"):
        link.read(0.0)
    link.open()
    with pytest.raises(LinkBusyError):
        link.open()
    link.write(b"old")
    link.close()
    with pytest.raises(LinkClosedError):
        link.write(b"x")
    with link:
        assert link.read(time.monotonic()) == b""
        link.write(b"new")
        assert link.flush_input() == 3


@pytest.mark.parametrize("end", ["wake", "close"])
def test_another_thread_ends_a_wait(end: str) -> None:
    link = SimLink("sim://hex7bot", Echo())
    link.open()
    result: list[object] = []

    def wait() -> None:
        try:
            result.append(link.read(None))
        except LinkClosedError as error:
            result.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    getattr(link, end)()
    thread.join(PATIENCE)
    assert not thread.is_alive()
    assert isinstance(result[0], LinkClosedError) if end == "close" else result == [b""]


@pytest.mark.parametrize(
    "url",
    [
        "sim://puma260",
        "sim://",
        "sim://hex7bot/x",
        "sim://hex7bot?speed=2",
        "sim://hex7bot?dialect=3",
        "sim://hex7bot?leader=1",
        "sim://so101?dialect=1",
        "sim://so101?leader=2",
        "sim://so101?physics=x",
        "sim://so101?name=",
        "sim://so101?name=a-b",
        "sim://so102",
    ],
)
def test_what_is_not_emulated_is_refused(url: str) -> None:
    with pytest.raises(UsageError):
        make_link(url)


def test_a_driver_moves_it_and_finds_it_where_it_left_it() -> None:
    with connect("sim://hex7bot") as robot:
        robot.torque(True)
        robot.write(JointTarget.of({"J1": 0.3}, 0.1))
        deadline = time.monotonic() + PATIENCE
        while abs(robot.read().positions["J1"] - 0.3) > 0.02:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        robot.detach()
        robot.attach()
        assert robot.read().positions["J1"] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("robot", ["so100", "so101"])
def test_an_so_arm_is_one_line_of_python(robot: str) -> None:
    # Fresh from its makers: not calibrated, so that angles are off by less than a tooth of a horn.
    with connect(f"sim://{robot}") as arm:
        assert arm.model.name == robot
        state = arm.read()
        assert state.positions["elbow_flex"] == pytest.approx(1.54, abs=0.15)
        assert not state.torque_on
        report = arm.probe()
        assert [row.present for row in report.joints] == [True] * 6
        assert {row.model for row in report.joints} == {"sts3215 3.10"}


def test_an_arm_file_may_stand_for_an_emulated_arm(tmp_path: Path) -> None:
    (tmp_path / "left.toml").write_text('name = "left"\nbase = "so101"\n')
    with connect("sim://so101", str(tmp_path / "left.toml")) as arm:
        assert arm.model.name == "left"


def test_a_hand_moves_an_arm_while_a_program_reads_it() -> None:
    hand: list[HandResult] = []
    order = HandOrder("shoulder_pan", 10.0, 0.3)
    with connect("sim://so101?name=here&seed=1") as arm:
        before = arm.read().positions["shoulder_pan"]
        thread = threading.Thread(target=lambda: hand.append(move_by_hand("sim://so101?name=here", order)))
        thread.start()
        while thread.is_alive():
            after = arm.read().positions["shoulder_pan"]
        after = arm.read().positions["shoulder_pan"]
        assert math.degrees(after - before) == pytest.approx(10.0, abs=0.5)
        arm.detach()
        with pytest.raises(LinkNotFoundError):
            move_by_hand("sim://so101?name=here", order)
    assert hand[0].joint == "shoulder_pan"


def test_a_hand_is_noticed_while_nothing_else_happens() -> None:
    link = SimLink("sim://hex7bot", Echo(), hands=Hands([EmulatedServo(Series.STS_SMS, 3)]), robot="still")
    results: list[HandResult] = []
    with link:
        thread = threading.Thread(target=lambda: link.read(None))
        thread.start()
        results.append(move_by_hand("sim://still", HandOrder("3", 5.0, 0.2)))
        link.wake()
        thread.join(PATIENCE)
    assert results[0].moved == pytest.approx(5.0, abs=0.3)


@pytest.mark.parametrize("robot", ["so101", "hex7bot"])
def test_it_may_have_a_body(robot: str) -> None:
    link = make_link(f"sim://{robot}?physics=1")
    assert isinstance(link, SimLink)
    servos = link.device.wire.servos  # type: ignore[attr-defined]
    assert all(type(servo.motion) is not Motion for servo in servos)


def test_a_servo_bus_has_a_line_rate_and_a_board_has_none() -> None:
    link = make_link("sim://so101?name=rates")
    assert isinstance(link, SimBusLink)
    with ServoBus(link) as bus:
        assert not bus.ping(1).error
        bus.set_baud(115_200)
        assert bus.ping(1).error, "it is at another rate"
        bus.set_baud(1_000_000)
        assert not bus.ping(1).error
    assert not hasattr(make_link("sim://hex7bot?name=norates"), "set_baud")


class Later:
    """The clock of modules of this package, which tests set forward: the computer did not run this program."""

    def __init__(self, patch: pytest.MonkeyPatch, *modules: ModuleType) -> None:
        self.by = 0.0
        clock = SimpleNamespace(monotonic=lambda: time.monotonic() + self.by, sleep=time.sleep)
        for module in modules:
            patch.setattr(module, "time", clock)
        if stalls in modules:
            # What this clock makes of them is in the future for the tests that follow.
            patch.setattr(serve_sim, "STALLS", stalls.Stalls())


def said_of(robot: RobotDriver, state: JointState) -> dict[str, str]:
    """What all places say of an arm that its watchdog has stopped."""
    with pytest.raises(StoppedError) as moved:
        robot.write(JointTarget.of({"J1": state.positions["J1"]}, 1.0))
    robot.watchdog(0.0)
    with pytest.raises(StoppedError) as watched, robot.watched():
        pass
    facts = RobotFacts("", "", True, "", 0, None, state, 0.0, 0.0, 0.0, "", {}, {}, 0.5)
    return {
        "an order": str(moved.value),
        "a motion": str(watched.value),
        "a controller": str(board_stop(state)),
        "doctor": str(judge_state(state, ())),
        "state": str(state.remarks),
        "diagnostics": _stop_reason(facts),
    }


@pytest.mark.parametrize("after", [0.0, 60.0])
def test_a_trip_of_an_emulated_arm_on_a_slow_computer_says_so_in_every_place(
    after: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = Later(monkeypatch, serve_sim, stalls)
    with connect("sim://hex7bot?name=stalled") as robot:
        robot.torque(True)
        robot.watchdog(0.5)
        later.by += 0.8
        # However late somebody looks.
        monkeypatch.setattr(robot.session, "now", lambda now=robot.session.now: now() + later.by + after)
        state = robot.read()
        assert state.watchdog_tripped
        assert state.stalled >= 0.7
        why = f"this computer or program was too slow: nothing ran the emulated arm for {state.stalled:.1f} s"
        for place, text in said_of(robot, state).items():
            assert why in text, (place, text)
            assert "host fell silent" not in text, (place, text)
        robot.resume()
        assert robot.read().stalled == 0.0


def test_a_program_that_only_slept_is_told_from_a_slow_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not for the thread that looks for stalls: the program was asleep, that was not.
    later = Later(monkeypatch, serve_sim)
    with connect("sim://hex7bot?name=asleep") as robot:
        robot.torque(True)
        robot.watchdog(30.0)
        later.by += 31.0
        state = robot.read()
        assert state.watchdog_tripped
        for place, text in said_of(robot, state).items():
            assert "the host fell silent" in text, (place, text)


def test_every_link_around_an_emulated_arm_knows_the_stalls(monkeypatch: pytest.MonkeyPatch) -> None:
    later = Later(monkeypatch, serve_sim, stalls)
    with SimLink("sim://hex7bot", Echo()) as link:
        later.by += 75.0
        for outer in (link, TapLink(link, lambda *_: None), ImpairedLink(link)):
            assert outer.stalled(60.0) == pytest.approx(60.0, abs=1.0)


def test_an_emulated_servo_is_never_silent_because_the_computer_stalls(monkeypatch: pytest.MonkeyPatch) -> None:
    with ServoBus.from_url("sim://so101?name=slow") as bus:
        bus.retries = 0
        later = Later(monkeypatch, serve_sim)
        step = SimBusLink._run

        def stalling(link: SimBusLink) -> None:
            later.by += 0.3
            step(link)

        monkeypatch.setattr(SimBusLink, "_run", stalling)
        for servo_id in range(1, 7):
            assert bus.ping(servo_id).ok
            assert not bus.read(servo_id, "present_position").error
        assert all(raw is not None for raw in bus.sync_read("present_position", range(1, 7)).raw)
