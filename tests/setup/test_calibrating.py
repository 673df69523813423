"""Calibration of an emulated arm: the whole way, and everything odd."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from tests.bus.bus_bench import lose_reads
from tests.control.so_bench import NAMES, SoBench
from tests.defaults import default
from tests.few import few
from tests.soak import rounds

from hexwire.drivers.base import StopMode
from hexwire.drivers.bus_arm import So101Arm
from hexwire.drivers.stored_calibration import not_calibrated, stored_calibration
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import NotSupportedError, ServoError, StoppedError, UsageError
from hexwire.model.arms import Go, Seek
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.setup.auto_calibration import COUNT, AutoCalibration
from hexwire.setup.calibrating import CalibrationBench, counting_arm, store
from hexwire.wire.servo_packet import Instruction, ServoPacket

TURN = 4096


def automatic(parts: SoBench, bench: CalibrationBench, watch: Callable[[AutoCalibration], object]) -> Calibration:
    return bench.automatic("now", watch=watch, clock=parts.link.clock, sleep=parts.link.clock.advance)


def calibrate(parts: SoBench) -> Calibration:
    with parts.attached() as bench:
        bench.release()
        calibration = automatic(parts, bench, lambda auto: None)
        store(bench.arm.bus, calibration)
        return calibration


def limp(parts: SoBench) -> bool:
    return not any(servo.torque_on for servo in parts.arm.servos)


def test_an_arm_that_counts_has_counts_for_angles_and_seven_turns_to_either_side() -> None:
    described = So101Arm.described()
    counting = counting_arm(described)
    assert (counting.model.names, counting.baud) == (described.model.names, described.baud)
    for joint in counting.model.joints:
        assert joint.count_limits == pytest.approx((-7 * TURN, 7 * TURN), abs=1)
        for counts in (-7 * TURN, -1, 0, 1, 7 * TURN):
            assert joint.counts_to_angle(counts) == pytest.approx(counts * COUNT)
            assert joint.angle_to_counts(counts * COUNT) == counts
            joint.check(counts * COUNT)


@pytest.mark.slow
@pytest.mark.soak
def test_an_arm_finds_its_stops_from_any_pose_to_within_two_counts() -> None:
    """Twenty runs in `make soak`: random poses of one arm, every third as a leader, every second with an echo."""
    found: dict[bool, list[list[int]]] = {False: [], True: []}
    for pose in range(rounds(1, 20)):
        leader = pose % 3 == 2
        parts = SoBench(7, pose, echo=pose % 2 == 0, leader=leader)
        calibration = calibrate(parts)
        check_arm(parts, calibration)
        ends = []
        for row in calibration.joints:
            if row.name != "wrist_roll":
                assert row.servo_offset is not None
                ends += [(row.low + row.servo_offset) % TURN, (row.high + row.servo_offset) % TURN]
        found[leader].append(ends)
    for runs in found.values():
        for column in zip(*runs, strict=True):
            assert max(column) - min(column) <= 2


def check_arm(parts: SoBench, calibration: Calibration) -> None:
    assert limp(parts)
    for row, one in zip(calibration.joints, parts.arm.servos, strict=True):
        get, stored = one.registers.get, one.registers.stored
        wanted = (row.servo_offset, row.low, row.high)
        names = ("position_offset", "min_position_limit", "max_position_limit")
        assert tuple(map(get, names)) == tuple(map(stored, names)) == wanted
        assert (get("torque_limit"), get("lock")) == (1000, 1)
        if row.name != "wrist_roll":
            low, high = parts.sensor(row.name)
            # Six counts inside the stops; the sensor may have counted whole turns since.
            assert row.servo_offset is not None
            assert (row.low + row.servo_offset - low) % TURN == pytest.approx(6, abs=1.5)
            assert (high - row.high - row.servo_offset) % TURN == pytest.approx(6, abs=1.5)
    # Its angles are those of the arm: it was put down folded.
    applied = calibration.apply(parts.described.model)
    for name, degrees in (("shoulder_lift", -92.0), ("elbow_flex", 88.0), ("wrist_flex", 40.0)):
        angle = applied.joint(name).counts_to_angle(servo(parts, name).present_position)
        assert math.degrees(angle) == pytest.approx(degrees, abs=3.0)


def odd(
    doing: str, act: Callable[[SoBench], object], *, after: float = 0.5
) -> Callable[[SoBench, AutoCalibration], None]:
    """Do something once a motion has lasted a while."""
    begun: list[float] = []
    done: list[bool] = []

    def watch(parts: SoBench, auto: AutoCalibration) -> None:
        if auto.doing == doing and not done:
            begun.append(parts.link.clock())
            if begun[-1] - begun[0] >= after:
                done.append(True)
                act(parts)

    return watch


def servo(parts: SoBench, name: str):  # type: ignore[no-untyped-def]  # the emulated servo
    return parts.arm.servos[NAMES.index(name)]


def silence(name: str) -> Callable[[SoBench], object]:
    return lambda parts: setattr(servo(parts, name), "receive", lambda packet, now: None)


def obstacle(name: str, low: float | None, high: float | None) -> Callable[[SoBench], object]:
    def put(parts: SoBench) -> None:
        here = servo(parts, name).motion
        bounds = (
            None if low is None else here.position + low,
            None if high is None else here.position + high,
        )
        here.obstacle = bounds

    return put


LIFT = "elbow_flex goes to 60 deg"
PAN = "shoulder_pan: looks for its lower stop"
SHORT = (
    Seek("shoulder_pan", -1),
    Seek("shoulder_pan", 1),
    Seek("elbow_flex", 1),
    Go({"elbow_flex": 60.0}),
)


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few motions of the plan: whatever is odd, it is found in any motion."""
    default(monkeypatch, AutoCalibration, plan=SHORT)


ODD: list[tuple[str, Callable[[SoBench], object], str]] = [
    (PAN, silence("elbow_flex"), "elbow_flex fell silent: check cable and power"),
    (PAN, silence("shoulder_pan"), "shoulder_pan fell silent"),
    # A cable, or an emulated arm in another program that does not run: which of them, nobody here can know.
    (PAN, lambda p: [silence(name)(p) for name in NAMES], "no servo answers any more: .*emulated arm was"),
    (PAN, lambda p: servo(p, "gripper").protection.__setattr__("forced", 32), "gripper reports overload"),
    (PAN, lambda p: setattr(servo(p, "shoulder_pan").protection, "temperature", 66.0), "66 deg C hot"),
    (
        PAN,
        lambda p: setattr(servo(p, "elbow_flex").motion, "external_torque", -2.0),
        "elbow_flex (moved although it holds|jumped)",
    ),
    (PAN, lambda p: setattr(servo(p, "shoulder_pan").motion, "external_torque", 0.5), "moves the wrong way"),
    (
        PAN,
        lambda p: servo(p, "shoulder_pan").power_cycle(p.link.clock()),
        "pan was without supply for a moment",
    ),
    (PAN, lambda p: setattr(servo(p, "shoulder_pan").motion, "stops", None), "without meeting a stop"),
    (PAN, obstacle("shoulder_pan", -30.0, None), "it met something before its stop"),
    (LIFT, obstacle("elbow_flex", -50.0, None), "something is in its way"),
    (LIFT, lambda p: setattr(servo(p, "wrist_flex").motion, "position", 0.0), "jumped|moved although"),
]


@few("doing, act, said", ODD, ODD[0], ODD[9])
@pytest.mark.usefixtures("short")
def test_anything_odd_ends_it_without_torque_and_changes_nothing(
    doing: str, act: Callable[[SoBench], object], said: str
) -> None:
    parts = SoBench()
    watch = odd(doing, act, after=0.1 if doing == LIFT else 0.5)
    with parts.attached() as bench:
        bench.release()
        with pytest.raises(ServoError, match=said):
            automatic(parts, bench, lambda auto: watch(parts, auto))
    for one in parts.arm.servos:
        # A silent servo heard nothing.
        if one.receive.__name__ != "<lambda>":
            assert not one.torque_on, one.servo_id
            assert (one.registers.get("torque_limit"), one.registers.get("max_position_limit")) == (1000, 4095)
        assert one.registers.stored("max_position_limit") == 4095
        assert one.registers.stored("position_offset") == 0


@few("step", range(4), 2)
@pytest.mark.usefixtures("short")
def test_ctrl_c_at_any_step_leaves_it_without_torque(step: int) -> None:
    parts = SoBench()

    def watch(auto: AutoCalibration) -> None:
        if auto.step == step and auto.doing:
            raise KeyboardInterrupt

    with parts.attached() as bench:
        bench.release()
        with pytest.raises(KeyboardInterrupt):
            automatic(parts, bench, watch)
        assert limp(parts)
        assert [one.registers.get("torque_limit") for one in parts.arm.servos] == [1000] * 6
        assert [one.registers.get("max_position_limit") for one in parts.arm.servos] == [4095] * 6


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.usefixtures("short")
def test_a_cable_that_is_unplugged_is_said_with_what_to_do(interrupted: bool) -> None:
    def unplug(parts: SoBench) -> None:
        parts.link.close()
        if interrupted:
            raise KeyboardInterrupt

    parts = SoBench()
    watch = odd(PAN, unplug)
    said = "is closed; the arm may hold with low torque: switch its supply off"
    with parts.attached() as bench:
        bench.release()
        with pytest.raises(ServoError, match=said):
            automatic(parts, bench, lambda auto: watch(parts, auto))


@pytest.mark.usefixtures("short")
def test_a_stop_from_elsewhere_ends_it_and_the_arm_holds() -> None:
    parts = SoBench()
    watch = odd(PAN, lambda p: p.driver.stop(StopMode.HOLD))
    with parts.attached() as bench:
        bench.release()
        with pytest.raises(StoppedError, match="stopped"):
            automatic(parts, bench, lambda auto: watch(parts, auto))
        assert all(one.torque_on for one in parts.arm.servos)
        assert max(one.registers.get("torque_limit") for one in parts.arm.servos) == 750
        parts.driver.resume()


@pytest.mark.usefixtures("short")
def test_if_the_host_dies_a_joint_goes_a_few_degrees_and_holds_with_low_torque() -> None:
    class Killed(BaseException):
        pass

    for doing, after in ((PAN, 1.0), (LIFT, 0.1)):
        parts = SoBench()

        def die(parts: SoBench) -> None:
            raise Killed

        watch = odd(doing, die, after=after)
        with parts.attached() as bench:
            bench.release()
            # Nothing of the end of a program runs when it is killed.
            bench._end = lambda before, why: None  # type: ignore[method-assign]
            with pytest.raises(Killed):
                automatic(parts, bench, lambda auto, watch=watch, parts=parts: watch(parts, auto))  # type: ignore[misc]
            before = [one.motion.position for one in parts.arm.servos]
            parts.link.clock.advance(20.0)
            parts.device.step(parts.link.clock())
            after = [one.motion.position for one in parts.arm.servos]
        assert max(abs(a - b) for a, b in zip(before, after, strict=True)) < 70
        assert all(one.registers.get("torque_limit") <= 750 for one in parts.arm.servos)
        assert all(abs(one.motion.torque) <= 0.751 for one in parts.arm.servos)
    # The next program leaves nothing of this behind.
    with parts.attached() as bench, pytest.raises(KeyboardInterrupt):
        automatic(parts, bench, interrupt)
    assert limp(parts)
    assert [one.registers.get("torque_limit") for one in parts.arm.servos] == [1000] * 6
    assert [one.registers.get("max_position_limit") for one in parts.arm.servos] == [4095] * 6


def interrupt(auto: AutoCalibration) -> None:
    raise KeyboardInterrupt


def test_servos_that_do_not_answer_or_share_an_id_are_refused_before_anything_moves() -> None:
    parts = SoBench(faults=("silent:4",))
    with parts.driver, pytest.raises(ServoError, match=r"wrist_flex \(servo 4\) does not answer"):
        CalibrationBench(parts.driver, parts.described).examine()
    parts = SoBench()
    parts.arm.servos[5].registers.put("id", 1)
    with parts.driver, pytest.raises(ServoError, match="several servos seem to have id 1"):
        CalibrationBench(parts.driver, parts.described).examine()


def test_a_servo_lost_before_the_motion_gets_no_torque() -> None:
    parts = SoBench()
    with parts.attached() as bench:
        bench.release()
        silence("wrist_flex")(parts)
        with pytest.raises(ServoError, match="wrist_flex does not answer"):
            automatic(parts, bench, lambda auto: None)
        assert limp(parts)


def test_by_hand_across_the_end_of_a_turn() -> None:
    parts = SoBench(seed=7, pose=4)
    with parts.attached() as bench:
        bench.release()
        hand = bench.by_hand()
        hand.receive(bench.positions(), 0.0)
        hand.mark_middle()
        shown = servo(parts, "wrist_roll").motion.position
        now = 0.0
        for part in [*range(101), *range(100, -101, -1)]:
            now += 0.02
            for name in NAMES:
                low, high = parts.sensor(name) if name != "wrist_roll" else (-9000.0, 9000.0)
                motion = servo(parts, name).motion
                wanted = (low + high) / 2 + part / 100 * (high - low) / 2
                motion.position += max(-700.0, min(700.0, wanted - motion.position))
            hand.receive(bench.positions(), now)
        assert hand.missing == ()
        calibration = hand.finish("now")
        assert store(bench.arm.bus, calibration) == NAMES
    for row in calibration.joints:
        assert row.servo_offset is not None
        if row.name == "wrist_roll":
            assert (shown - row.servo_offset) % TURN == pytest.approx(2047, abs=1.5)
            continue
        low, high = parts.sensor(row.name)
        assert (row.low + row.servo_offset - low) % TURN == pytest.approx(0, abs=1.5) or (
            row.low + row.servo_offset - low
        ) % TURN == pytest.approx(TURN, abs=1.5)
        assert row.high - row.low == pytest.approx(high - low, abs=2)


# --- storing ---------------------------------------------------------------------------------------------------


def rows(**changed: int) -> Calibration:
    return Calibration(
        "so101",
        "now",
        tuple(
            JointCalibration(name, i, 2047.5, 1000, 3095, servo_offset=changed.get(name, 100 + i))
            for i, name in enumerate(NAMES, 1)
        ),
    )


def test_nothing_is_stored_while_a_servo_has_torque_or_is_silent() -> None:
    parts = SoBench()
    with parts.attached() as bench:
        bus = bench.arm.bus
        bus.write_raw(3, "torque_enable", 1)
        with pytest.raises(ServoError, match="elbow_flex has torque: it would jump; nothing was changed"):
            store(bus, rows())
        bus.write_raw(3, "torque_enable", 0)
        silence("gripper")(parts)
        with pytest.raises(ServoError, match=r"gripper .* does not answer"):
            store(bus, rows())
    assert [one.registers.stored("position_offset") for one in parts.arm.servos] == [0] * 6


def meanwhile(parts: SoBench, act: Callable[[EmulatedServo], object]) -> None:
    """Do something to the third servo as soon as the first one is given its offset."""
    one, _, three, *_ = parts.arm.servos
    receive = one.receive

    def receive_and_act(packet: ServoPacket, now: float) -> bytes | None:
        if packet.instruction == Instruction.WRITE and packet.params[0] == 31:
            act(three)
        return receive(packet, now)

    one.receive = receive_and_act  # type: ignore[method-assign]


def test_nothing_is_stored_in_a_servo_that_does_not_say_whether_it_has_torque() -> None:
    parts = SoBench()
    meanwhile(parts, lambda three: lose_reads(three, "torque_enable"))
    said = "servo 3 does not answer; all servos have their old values again"
    with parts.attached() as bench, pytest.raises(ServoError, match=said):
        store(bench.arm.bus, rows())
    assert [one.registers.stored("position_offset") for one in parts.arm.servos] == [0] * 6


def test_a_servo_that_fails_gives_all_their_old_values_back() -> None:
    parts = SoBench()
    four = parts.arm.servos[3]
    receive = four.receive

    def deaf(packet: ServoPacket, now: float) -> bytes | None:
        # It acknowledges a new offset, but does not take it.
        return receive(packet._replace(params=b"\x37\0") if packet.params[:1] == b"\x1f" else packet, now)

    four.receive = lambda packet, now: (  # type: ignore[method-assign]
        deaf(packet, now) if packet.instruction == Instruction.WRITE else receive(packet, now)
    )
    said = r"position_offset .*all servos have their old values again"
    with parts.attached() as bench, pytest.raises(ServoError, match=said):
        store(bench.arm.bus, rows())
    assert [one.registers.stored("position_offset") for one in parts.arm.servos] == [0] * 6
    assert [one.registers.stored("max_position_limit") for one in parts.arm.servos] == [4095] * 6


def test_killed_while_it_stores_the_arm_counts_as_not_calibrated() -> None:
    class Killed(BaseException):
        pass

    former = Calibration(
        "so101", "", tuple(replace(row, low=900, high=2900, servo_offset=9) for row in rows().joints)
    )
    writes = 0

    def dying(packet: ServoPacket, now: float, one: Any, receive: Any, last: int) -> bytes | None:
        nonlocal writes
        if packet.instruction == Instruction.WRITE and packet.params[0] in (9, 11, 31):
            writes += 1
            if writes > last:
                raise Killed
        return receive(packet, now)  # type: ignore[no-any-return]

    for last in (1, 6, 7, 11, 17):
        parts = SoBench()
        with parts.attached() as bench:
            store(bench.arm.bus, former)
            writes = 0
            kept = [one.receive for one in parts.arm.servos]
            for one in parts.arm.servos:
                one.receive = partial(dying, one=one, receive=one.receive, last=last)  # type: ignore[method-assign]
            with pytest.raises(Killed):
                store(bench.arm.bus, rows())
            for one, receive in zip(parts.arm.servos, kept, strict=True):
                one.receive = receive  # type: ignore[method-assign]
            found = stored_calibration(bench.arm.bus, bench.model)
            assert not_calibrated(found, bench.model), f"killed after {last} writes"


def test_torque_that_another_program_switches_on_meanwhile_keeps_a_servo_as_it_was() -> None:
    parts = SoBench()
    meanwhile(parts, lambda three: three.registers.put("torque_enable", 1))
    said = "elbow_flex has torque now: it would jump; all servos have their old values again"
    with parts.attached() as bench, pytest.raises(ServoError, match=said):
        store(bench.arm.bus, rows())
    assert [one.registers.stored("position_offset") for one in parts.arm.servos] == [0] * 6


def test_a_second_time_there_is_nothing_to_store() -> None:
    parts = SoBench()
    with parts.attached() as bench:
        assert store(bench.arm.bus, rows()) == NAMES
        assert store(bench.arm.bus, rows()) == ()
        assert store(bench.arm.bus, rows(gripper=7)) == ("gripper",)
        with pytest.raises(UsageError, match="shoulder_pan: the range -1 to 5"):
            store(
                bench.arm.bus,
                Calibration("x", "", (JointCalibration("shoulder_pan", 1, 0, -1, 5, servo_offset=0),)),
            )


def test_a_servo_that_counts_turns_is_brought_back_into_its_turn() -> None:
    parts = SoBench()
    one = parts.arm.servos[0]
    # Like the firmware of those who see "Magnitude 2114 exceeds 2047": it goes on counting until it is told not to.
    one._turns = lambda shaft: 0  # type: ignore[method-assign]
    one.motion.position += 3 * TURN
    with parts.attached() as bench:
        place = bench.positions()["shoulder_pan"]
        assert place is not None
        assert place > TURN
        store(bench.arm.bus, rows())
        assert 0 <= one.present_position < TURN


def test_only_so_arms_have_an_order_of_motions() -> None:
    parts = SoBench()
    with parts.attached() as bench:
        bench.model = type(bench.model)("mine", bench.model.joints)
        with pytest.raises(NotSupportedError, match="known only for SO arms, not for mine"):
            automatic(parts, bench, lambda auto: None)
