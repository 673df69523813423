from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.bus.bus_bench import BusLink, make_bus

from hexwire.bus.machine import ADAPTER_TIME
from hexwire.drivers.abilities import Leased, OnboardPaths, ServoTables, StateReports, Watchdog
from hexwire.drivers.base import Signal, StopMode
from hexwire.drivers.bus_arm import BusArm, ChainArm, SevenBotArm, So100Arm, So101Arm, arm_class
from hexwire.drivers.registry import load_driver, robot_names
from hexwire.emulator.bus_device import BusDevice
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import (
    CommandRefusedError,
    ConfigError,
    LeaseError,
    LimitError,
    NotSupportedError,
    ReplyTimeoutError,
    StoppedError,
    UsageError,
)
from hexwire.link import open as ipc_open
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.model.state import JointFlag, JointTarget
from hexwire.wire.command_frame import Command
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_read, make_status, make_write

_KINDS: dict[type[BusArm], tuple[Series, ...]] = {
    So101Arm: (Series.STS_SMS,) * 6,
    So100Arm: (Series.STS_SMS,) * 6,
    ChainArm: (Series.STS_SMS,) * 6,
    SevenBotArm: (Series.SEVEN_BOT,) * 4 + (Series.HLS,) * 3,
}


def _make(
    kind: type[BusArm], monkeypatch: pytest.MonkeyPatch, *faults: str, **options: object
) -> tuple[BusArm, BusDevice]:
    series = _KINDS[kind]
    ids = range(7) if kind is SevenBotArm else range(1, 7)
    baud = 115200 if kind is SevenBotArm else 1_000_000
    bus, device = make_bus(tuple(ids), series, faults=FaultPlan(faults) if faults else None, baud=baud)
    bus.close()
    monkeypatch.setattr(ipc_open, "make_link", lambda url: bus.link)
    arm = kind.from_url("/dev/ttyTEST", **options)
    arm.attach()
    return arm, device


@pytest.fixture(params=list(_KINDS), ids=lambda kind: kind.profile)
def arm(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[BusArm]:
    made, _ = _make(request.param, monkeypatch)
    yield made
    made.detach()


def _settle(arm: BusArm, seconds: float) -> None:
    arm.bus.pause(seconds)


def test_attach_moves_nothing_and_switches_nothing(arm: BusArm) -> None:
    before = arm.read()
    _settle(arm, 1.0)
    after = arm.read()
    assert after.torque_on == ()
    assert after.silent == ()
    for one, other in zip(before.position, after.position, strict=True):
        assert one == pytest.approx(other, abs=0.005)
    assert len(after) == len(arm.model.joints)


@pytest.mark.parametrize(
    "old",
    [make_status(1), make_status(1, 0, b"\x34\x12"), make_status(2, 0, b"\x01"), make_status(6, 0, b"\x34")[:5]],
    ids=["acknowledgement", "position", "torque", "piece"],
)
def test_what_an_adapter_still_holds_at_first_is_no_value(monkeypatch: pytest.MonkeyPatch, old: bytes) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    before = arm.read().positions
    arm.detach()
    link = arm.servo_link
    assert isinstance(link, BusLink)
    flush = link.flush_input

    def flush_and_forward() -> int:
        count = flush()
        link._to_host.put(old, link.clock.time)
        return count

    monkeypatch.setattr(link, "flush_input", flush_and_forward)
    began = link.clock.time
    arm.attach()
    assert link.clock.time - began < ADAPTER_TIME, "waits for the adapter"
    assert arm.read().positions == before
    assert arm.read().torque_on == ()
    device.wire.servos.pop(0)
    arm.detach()
    arm.attach()
    assert arm.read().silent == ("shoulder_pan",)


def test_a_move_takes_the_time_that_was_asked_for(arm: BusArm) -> None:
    names = arm.model.names
    assert arm.torque(True) == names
    start = arm.read().positions
    goal = {name: start[name] + (0.2 if name != names[-1] else 0.1) for name in names}
    sent = arm.write(JointTarget.of(goal, duration=2.0))
    assert sent.duration >= 2.0
    assert dict(sent.positions) == pytest.approx(goal, abs=0.005)
    _settle(arm, 0.8)
    half = arm.read().positions
    assert any(abs(half[name] - goal[name]) > 0.02 for name in names)
    _settle(arm, 2.5)
    assert arm.read().positions == pytest.approx(goal, abs=0.04)
    assert arm.read().torque_on == names


def test_a_joint_without_torque_is_not_moved_and_not_switched_on(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    with pytest.raises(CommandRefusedError, match="shoulder_pan has no torque"):
        arm.write(JointTarget.of({"shoulder_pan": 0.3}))
    _settle(arm, 0.5)
    assert device.wire[1].registers.get("torque_enable") == 0
    arm.torque(True, ["gripper"])
    assert arm.read().torque_on == ("gripper",)


def test_limits_are_refused_and_speed_is_stretched(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, _ = _make(So101Arm, monkeypatch)
    arm.torque(True)
    with pytest.raises(LimitError):
        arm.write(JointTarget.of({"shoulder_pan": math.radians(120)}))
    sent = arm.write(JointTarget.of({"shoulder_pan": math.radians(90)}, duration=0.01))
    assert sent.duration == pytest.approx(0.5, rel=0.05)
    # A guided target may be as fast as the servo is.
    sent = arm.write(JointTarget.of({"shoulder_pan": 0.0}, duration=0.01, guided=True))
    assert sent.duration == pytest.approx(90.0 / 312.0, rel=0.05)


@pytest.mark.parametrize("kind", [So101Arm, SevenBotArm])
def test_a_set_point_is_what_a_guided_target_is(monkeypatch: pytest.MonkeyPatch, kind: type[BusArm]) -> None:
    arms = [_make(kind, monkeypatch)[0] for _ in range(2)]
    packets: list[list[bytes]] = [[], []]

    def count(arm: BusArm, sent: list[bytes]) -> None:
        post = arm.bus.post

        def posted(packet: bytes) -> None:
            sent.append(packet)
            post(packet)

        monkeypatch.setattr(arm.bus, "post", posted)

    for arm, sent in zip(arms, packets, strict=True):
        arm.torque(True)
        count(arm, sent)
    arm, twin = arms
    name, joint = arm.model.names[0], arm.model.joints[0]
    here = arm.read().positions
    assert twin.read().positions == here
    for goal in ({name: here[name] + 0.01}, {one: angle + 0.004 for one, angle in here.items()}):
        assert arm.guide(goal, 0.02) == twin.write(JointTarget.of(goal, 0.02, guided=True)).positions
    assert packets[0] == packets[1] != []
    packets[0].clear()
    wrong: list[tuple[object, float, type[Exception]]] = [
        ({name: joint.maximum + 0.1}, 0.02, LimitError),
        *(({name: angle}, 0.02, UsageError) for angle in (math.nan, math.inf, "0", True, None)),
        *(({name: here[name]}, seconds, UsageError) for seconds in (math.nan, -1.0, 1e9)),
        ({}, 0.02, UsageError),
        ({"no such joint": 0.0}, 0.02, UsageError),
    ]
    for positions, seconds, error in wrong:
        with pytest.raises(error):
            arm.guide(positions, seconds)  # type: ignore[arg-type]  # on purpose
    arm.torque(False, [name])
    with pytest.raises(CommandRefusedError, match="no torque"):
        arm.guide({name: here[name]}, 0.02)
    assert not packets[0]
    arm.stop()
    packets[0].clear()
    with pytest.raises(StoppedError):
        arm.guide({arm.model.names[1]: here[arm.model.names[1]]}, 0.02)
    assert not packets[0]


@pytest.mark.parametrize("lost", ["goal", "torque"])
def test_a_servo_that_misses_what_all_are_sent_is_sent_it_alone(monkeypatch: pytest.MonkeyPatch, lost: str) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.write(JointTarget.of({"shoulder_pan": 0.5}, duration=0.5))
    _settle(arm, 1.0)
    arm.torque(False)
    device.wire[1].motion.position = 1800.0
    name = "sync_write_raw" if lost == "torque" else "sync_write_bytes"
    plain = getattr(arm.bus, name)
    monkeypatch.setattr(
        arm.bus, name, lambda what, rows: plain(what, {i: row for i, row in rows.items() if i != 1})
    )
    assert arm.torque(True) == arm.model.names
    _settle(arm, 1.0)
    assert device.wire[1].motion.position == pytest.approx(1800, abs=3)
    assert arm.read().torque_on == arm.model.names


def test_a_joint_whose_goal_is_not_confirmed_gets_no_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    monkeypatch.setattr(arm.bus, "sync_write_bytes", lambda what, rows: None)
    monkeypatch.setattr(arm, "_hold", lambda joint: joint.name != "elbow_flex")
    assert arm.torque(True) == tuple(name for name in arm.model.names if name != "elbow_flex")
    assert device.wire[3].registers.get("torque_enable") == 0


def test_torque_on_holds_where_the_joint_is(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.write(JointTarget.of({"shoulder_pan": 0.5}, duration=0.5))
    _settle(arm, 1.0)
    assert arm.torque(False) == arm.model.names
    device.wire[1].motion.position = 1800.0
    arm.torque(True)
    _settle(arm, 1.0)
    assert device.wire[1].motion.position == pytest.approx(1800, abs=3)


def test_a_stop_that_another_program_left_holds_after_attach(
    arm: BusArm, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    arm.detach()
    kept = {"stop"}

    class Kept:
        """What programs of this user remember of the port."""

        kept_by = "user"
        stopped = property(lambda self: bool(kept))
        remember = staticmethod(lambda: kept.add("stop"))
        forget = staticmethod(kept.clear)

    monkeypatch.setattr(arm, "_memory", Kept())
    arm.attach()
    assert arm.read().stopped
    arm.resume()
    assert not kept
    assert not arm.read().stopped
    arm.detach()
    arm.attach()
    assert not arm.read().stopped


def test_stop_holds_latches_and_resumes(arm: BusArm) -> None:
    names = arm.model.names
    arm.torque(True)
    start = arm.read().positions
    arm.write(JointTarget.of({names[0]: start[names[0]] + 0.5}, duration=2.0))
    _settle(arm, 0.5)
    assert arm.stop() == names
    held = arm.read()
    assert held.stopped
    _settle(arm, 2.0)
    assert arm.read().positions[names[0]] == pytest.approx(held.positions[names[0]], abs=0.05)
    with pytest.raises(StoppedError):
        arm.write(JointTarget.of({names[0]: 0.0}))
    with pytest.raises(StoppedError):
        arm.torque(True)
    arm.resume()
    arm.write(JointTarget.of({names[0]: start[names[0]]}))
    arm.signal(Signal.STOP_TORQUE_OFF)
    assert arm.read().torque_on == ()
    assert arm.stop(StopMode.HOLD) == names
    _settle(arm, 0.2)
    assert arm.read().torque_on == ()


def test_a_silent_servo_is_a_flag_with_an_age(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    first = arm.read()
    device.wire.servos = [servo for servo in device.wire.servos if servo.servo_id != 3]
    _settle(arm, 0.5)
    state = arm.read()
    assert state.silent == ("elbow_flex",)
    assert state["elbow_flex"].position == first["elbow_flex"].position
    assert state["elbow_flex"].age > 0.4
    assert state["gripper"].age < 0.1
    assert math.isnan(state["elbow_flex"].voltage)


def test_a_fault_is_a_flag(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, _ = _make(So101Arm, monkeypatch, "overload:2")
    _settle(arm, 3.0)
    assert arm.read()["shoulder_lift"].flags & JointFlag.OVERLOAD


def test_units_of_a_state(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.write(JointTarget.of({"shoulder_pan": 1.5}, duration=1.5))
    _settle(arm, 0.7)
    joint = arm.read()["shoulder_pan"]
    assert 0.5 < joint.velocity < 2.0
    assert joint.voltage == pytest.approx(device.wire[1].registers.get("present_voltage") / 10)
    assert 15 < joint.temperature < 60
    assert abs(joint.load) <= 1.0


def test_probe_names_who_is_missing_or_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    device.wire.servos.pop()
    report = arm.probe()
    assert report.missing == ("gripper",)
    assert report.joints[0].series == "sts_sms"
    first = report.joints[0]
    assert (first.note, first.model, first.remarks) == ("", "sts3215 3.10", "sts3215 3.10")
    assert (first.supply, first.max_temperature) == ((4.0, 8.0), 70.0)
    assert report.dialect == 0
    assert report.counters["requests"] > 0


def test_what_an_arm_on_a_bus_says_of_itself(arm: BusArm) -> None:
    ids = [joint.servo_id for joint in arm.model.joints]
    assert [arm.ping(servo_id) for servo_id in (*ids, 99)] == [0] * len(ids) + [None]
    assert not any(arm.can(kind) for kind in (Watchdog, StateReports, OnboardPaths, Leased, ServoTables))
    with pytest.raises(NotSupportedError, match="has no watchdog to stop it when this program falls silent"):
        Watchdog.of(arm)
    assert arm.host_counters()["requests"] > len(ids)
    assert arm.probe().unprotected == "no watchdog, no limits: servos without a board"
    assert arm.read().stamp <= arm.now()
    assert arm.round_trips[-1] >= 0.0


def test_an_arm_without_a_board_has_no_pump(arm: BusArm) -> None:
    with pytest.raises(NotSupportedError, match="no outputs for a pump or a valve"):
        arm.ioctl(Command.IO, bytes((1, 1)))


def test_a_calibration_replaces_middles_and_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    row = JointCalibration("shoulder_pan", 1, 2000, 1500, 2600, -1, 0)
    other = JointCalibration("shoulder_lift", 2, 2000, 1500, 2600, 1, 77)
    arm, _ = _make(So101Arm, monkeypatch, calibration=Calibration("so101", "", (row, other)))
    joint = arm.model.joint("shoulder_pan")
    assert joint.counts_to_angle(2000) == 0.0
    assert joint.count_limits == (1500, 2600)
    assert arm.read().positions["shoulder_pan"] == pytest.approx(-48 * joint.scale, abs=0.01)
    notes = [joint.note for joint in arm.probe().joints]
    assert "calibrate again" not in notes[0]
    assert "its offset is 0 but was 77 at calibration" in notes[1]


def test_nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, device = make_bus((1,))
    bus.close()
    device.wire.servos = []
    monkeypatch.setattr(ipc_open, "make_link", lambda url: bus.link)
    arm = ChainArm.from_url("/dev/ttyTEST")
    with pytest.raises(ReplyTimeoutError, match=r"pings of servos 1, 2, 3.*; nothing arrived"):
        arm.attach()
    device._echo = True
    with pytest.raises(ReplyTimeoutError, match=r"pings of servos 1, 2, 3.*; instead: only the echo"):
        arm.attach()
    assert not bus.link.is_open
    with pytest.raises(UsageError, match="not attached"):
        arm.read()
    with pytest.raises(UsageError, match="no option dialect"):
        ChainArm.from_url("/dev/ttyTEST", dialect=2)


def test_detach_with_torque_off(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.detach(torque_off=True)
    assert device.wire[1].registers.get("torque_enable") == 0
    arm.detach()


def test_raw_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, _ = _make(So101Arm, monkeypatch)
    assert arm.ioctl(Command.TRANSACT, bytes((7, 0)) + make_read(4, 5, 1)) == b"\x04"
    with pytest.raises(NotSupportedError):
        arm.ioctl(Command.PING)
    assert not arm.may_move(Command.TRANSACT, bytes((7, 0)) + make_read(4, 5, 1))
    assert arm.may_move(Command.TRANSACT, bytes((0, 0)) + make_write(4, 0x2A, b"\0\10"))


def test_a_target_that_waited_too_long_for_the_bus_is_not_sent(arm: BusArm) -> None:
    arm.torque(True)
    here = arm.read()
    old = arm.epochs.mark()._replace(late=lambda: LeaseError("too old"))
    name, angle = here.names[0], here.position[0]
    with arm.epochs.using(old):
        arm.read()
        with pytest.raises(LeaseError, match="too old"):
            arm.write(JointTarget.of({name: angle + 0.2}))
    _settle(arm, 1.0)
    assert arm.read().position[0] == pytest.approx(angle, abs=0.01)


def test_arms_are_robots_by_name_and_by_file(tmp_path: Path) -> None:
    assert {"so100", "so101", "sevenbot", "chain"} <= set(robot_names())
    assert load_driver("so101") is So101Arm
    file = tmp_path / "mine.toml"
    file.write_text(
        'name = "mine"\nbaud = 500000\n[[joints]]\nname = "A"\nservo_id = 9\nseries = "hls"\n'
        "minimum_deg = -10.0\nmaximum_deg = 10.0\n"
    )
    made = load_driver(str(file)).from_url("/dev/ttyTEST")
    assert made.model.names == ("A",)
    with pytest.raises(ConfigError):
        arm_class(tmp_path / "none.toml")


def _requests(arm: BusArm) -> int:
    return arm.bus.counters.requests


def test_positions_that_are_recent_enough_are_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    for read in (arm.read, arm.read_positions):
        first, asked = read(), _requests(arm)
        arm.bus.link.clock.advance(0.003)
        again = arm.read_positions(within=0.005)
        assert _requests(arm) == asked
        assert (again.position, again.flags) == (first.position, first.flags)
        assert again.stamp == pytest.approx(first.stamp + 0.003)
        assert again.age == pytest.approx((0.003,) * 6)
        arm.bus.link.clock.advance(0.003)
        device.wire[1].motion.position += 100
        assert arm.read_positions(within=0.005).position[0] != first.position[0]
        assert _requests(arm) == asked + 1
    asked = _requests(arm)
    arm.epochs.assume_stopped()
    assert arm.read_positions(within=0.005).stopped
    assert _requests(arm) == asked


def test_a_state_from_before_a_silence_or_a_switch_of_torque_is_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.read_positions()
    arm.torque(False)
    assert arm.read_positions(within=100.0).torque_on == ()
    servos, device.wire.servos = device.wire.servos, [s for s in device.wire.servos if s.servo_id != 3]
    assert arm.read_positions().silent == ("elbow_flex",)
    device.wire.servos = servos
    assert arm.read_positions(within=100.0).silent == ()


def test_a_goal_after_recent_positions_begins_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the last goal, its speed would be that of the way from goal to goal: the joint would never catch up."""
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    start = arm.read_positions().position[0]
    speeds = []
    for _ in range(2):
        arm.read_positions(within=0.005)
        arm.write(JointTarget.of({"shoulder_pan": start + 0.05}, duration=0.1))
        speeds.append(device.wire[1].registers.get("goal_speed"))
    assert speeds[0] == speeds[1] > 1


@pytest.mark.parametrize("detaching", [False, True])
def test_torque_off_leaves_no_speed_behind(monkeypatch: pytest.MonkeyPatch, detaching: bool) -> None:
    """Programs that give goals without a speed, as LeRobot does, would crawl at that of the last goal."""
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    assert all(servo.registers.get("goal_speed") for servo in device.wire.servos)
    arm.detach(torque_off=True) if detaching else arm.torque(False)
    assert [servo.registers.get("torque_enable") for servo in device.wire.servos] == [0] * 6
    assert [servo.registers.get("goal_speed") for servo in device.wire.servos] == [0] * 6


def test_a_joint_that_rests_at_its_goal_can_be_left_without_a_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One on its way keeps its speed: it would go on as fast as its servo can."""
    arm, device = _make(So101Arm, monkeypatch)
    arm.torque(True)
    arm.write(JointTarget.of({"shoulder_pan": arm.read()["shoulder_pan"].position + 0.5}, 2.0))
    arm.unbind()
    speeds = [servo.registers.get("goal_speed") for servo in device.wire.servos]
    assert speeds[0] > 0
    assert speeds[1:] == [0] * 5
    assert [servo.registers.get("torque_enable") for servo in device.wire.servos] == [1] * 6
    arm.torque(False, ["shoulder_pan"])
    arm.unbind()


def test_recent_positions_do_not_let_goals_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes half a millisecond of the line; to read is to wait for them."""
    arm, _ = _make(So101Arm, monkeypatch)
    arm.torque(True)
    here = JointTarget.of(arm.read_positions().positions)
    asked = _requests(arm)
    arm.write(here)
    assert 0.0005 < arm.bus.backlog() < 0.0006
    arm.read_positions(within=0.005)
    assert _requests(arm) == asked
    arm.write(here)
    arm.read_positions(within=0.005)
    assert _requests(arm) == asked + 1
    assert arm.bus.backlog() == 0.0
