from __future__ import annotations

import math
import random
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.drivers.arms import Arm, check_old_board_survives

from hexwire.drivers.base import StopMode
from hexwire.drivers.board1 import Board1, make_hls_block, make_legacy_move
from hexwire.emulator.faults import FaultPlan
from hexwire.errors import (
    CommandRefusedError,
    LimitError,
    LinkLostError,
    NotSupportedError,
    PreemptedError,
    StoppedError,
    UsageError,
)
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command, parse_frame
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import parse_packet, parse_sync_write

PRINTED = {"J1": -4.47257, "J2": 54.6484, "J3": -3.55452, "J4": -0.703134, "J5": 3.1641, "J6": -0.0878917}
BAUDS = pytest.mark.parametrize("baud", [0, 115200])


@BAUDS
def test_states_are_the_angles_the_chapter_prints(baud: int) -> None:
    arm = Arm(1, baud)
    state = arm.driver.read()
    for name, degrees in PRINTED.items():
        assert float(f"{math.degrees(state[name].position):.6g}") == degrees
    assert all(map(math.isnan, state.velocity + state.current + state.voltage + state.temperature))
    assert all(map(math.isnan, state.load[:4]))
    for _ in range(2):
        state = arm.driver.read()
    assert state.load[4:] == pytest.approx((0, 0, 0.052))
    assert math.isnan(state.board_time)
    assert not state.stopped


def test_a_paced_read_ages_and_takes_what_the_sketch_takes() -> None:
    arm = Arm(1, 115200)
    begun = arm.clock.time
    state = arm.driver.read()
    assert arm.clock.time - begun == pytest.approx(8 * 0.0358, abs=0.01)
    assert state.stamp == arm.clock.time
    assert state.age[0] == pytest.approx(7 * 0.0358, abs=0.01)
    assert sorted(state.age, reverse=True) == list(state.age)


def test_a_silent_servo_keeps_position_and_age_and_is_flagged() -> None:
    arm = Arm(1, 115200)
    before = arm.driver.read()
    arm.board.wire.servos[5].registers.put("id", 99)
    arm.wait(3)
    state = arm.driver.read()
    assert state.silent == ("J6",)
    assert state["J6"].position == before["J6"].position
    assert state["J6"].age > 3
    never = Arm(1, 0, ("silent:2",)).driver.read()
    assert math.isnan(never["J3"].position)
    assert never["J3"].age == math.inf
    assert never.silent == ("J3",)


@BAUDS
def test_a_move_sends_each_series_its_own_and_says_what(baud: int) -> None:
    arm = Arm(1, baud)
    start = arm.shafts()
    assert arm.driver.torque(True) == HEX7BOT.names
    arm.wait(0.3)
    assert arm.shafts() == pytest.approx(start, abs=1)
    ceiling = arm.board.wire[4].registers.get("protection_current")
    arm.link.written.clear()
    sent = arm.driver.write(JointTarget.of({"J1": 0.2, "J5": 0.3, "J7": -0.2}, 1.0))
    assert sent.duration == 1.0
    assert (sent.clamped, sent.silent) == ((), ())
    arm.wait(1.6)
    state = arm.driver.read()
    for name, angle in sent.positions:
        joint = HEX7BOT.joint(name)
        counts = joint.angle_to_counts(angle)
        row = "target_position" if joint.series == "seven_bot" else "goal_position"
        assert arm.board.wire[joint.servo_id].registers.get(row) == counts
        assert arm.shaft(joint.servo_id) == pytest.approx(counts, abs=2)
        assert state[name].position == pytest.approx(angle, abs=2 * joint.scale)
    assert arm.board.wire[4].registers.get("goal_torque") == ceiling
    check_old_board_survives(arm.link.written)


def test_a_target_outside_the_limits_is_refused_before_anything_is_sent() -> None:
    arm = Arm(1)
    arm.driver.torque(True)
    arm.driver.read()
    arm.link.written.clear()
    for name, angle in (("J1", 3.0), ("J7", -2.0), ("J2", math.pi)):
        with pytest.raises(LimitError, match="nothing was sent"):
            arm.driver.write(JointTarget.of({"J3": 0.0, name: angle}))
    assert arm.link.written == []


def test_without_torque_a_move_is_refused_with_the_joints() -> None:
    arm = Arm(1)
    arm.driver.torque(True, ["J1"])
    with pytest.raises(CommandRefusedError, match=r"J2, J5: no torque"):
        arm.driver.write(JointTarget.of({"J1": 0.0, "J2": 0.9, "J5": 0.1}))
    arm.wait(0.5)
    assert arm.torques() == [True] + [False] * 6
    assert arm.shafts() == pytest.approx([2053, 2043, 2035, 2039, 2083, 2046, 2047], abs=1)


def test_a_move_of_a_joint_that_never_said_where_it_is() -> None:
    arm = Arm(1, 0, ("silent:5",))
    assert math.isnan(arm.driver.read()["J6"].position)
    arm.board.faults = arm.board.wire.faults = FaultPlan()
    board = arm.driver._board
    assert isinstance(board, Board1)
    board._torque[5] = True
    sent = arm.driver.write(JointTarget.of({"J6": 0.1}, 1.0))
    assert [name for name, _ in sent.positions] == ["J6"]
    # As slowly as the second that was asked for would be with the whole range before it.
    low, high = HEX7BOT.joint("J6").count_limits
    assert arm.board.wire[5].registers.get("goal_speed") == math.ceil((high - low) / 50)


def test_hostile_moves_and_clocks_never_cut_a_frame_and_one_request_is_outstanding() -> None:
    dice = random.Random(4)
    arm = Arm(1, 0, ("sketch",))
    arm.driver.torque(True)
    link = arm.link
    outstanding = [0]
    write, read = link.write, link.read

    def watched_write(data: bytes, deadline: float | None = None) -> None:
        if data[38] != Command.SYNC_WRITE:
            outstanding[0] += 1
        assert outstanding[0] <= 1
        write(data, deadline)

    def watched_read(deadline: float | None) -> bytes:
        data = read(deadline)
        if data:
            outstanding[0] = 0
        return data

    link.write, link.read = watched_write, watched_read  # type: ignore[method-assign]  # spies
    hostile = [0x0D, 0x0A, 0x0A0D, 0x0D0A, 2573, 3338, 2570, 3341, 10, 13, 9, 0x0D0D]
    for _ in range(400):
        # Any clock: the host's wall clock and the board's.
        arm.driver.session.connection.epoch = dice.choice(
            [0x0A0D - arm.clock.time, 0x0D0A, 0x0A0D0A0D, dice.uniform(0, 2**31), dice.choice(hostile) / 1e6]
        )
        arm.driver.session.connection.sn = dice.choice([*hostile, dice.randrange(1 << 32)])
        names = dice.sample(HEX7BOT.names, dice.randint(1, 7))
        targets = {}
        for name in names:
            joint = HEX7BOT.joint(name)
            low, high = joint.count_limits
            targets[name] = joint.counts_to_angle(
                dice.choice([c for c in hostile if low + 3 < c < high - 3] or [low + 5])
                if dice.random() < 0.5
                else dice.randint(low, high)
            )
        ms = dice.choice([*hostile, dice.randint(9, 4000)])
        sent = arm.driver.write(JointTarget.of(targets, ms / 1000))
        for name, angle in sent.positions:
            assert abs(angle - targets[name]) <= 3.01 * HEX7BOT.joint(name).scale
        if dice.random() < 0.2:
            arm.driver.read()
    assert arm.board._sketch is not None
    assert not arm.board._sketch.hung
    assert arm.board._sketch.lost == 0
    check_old_board_survives(link.written)


COUNTS = st.integers(-10, 70000) | st.sampled_from([0x0A0D, 0x0D0A, 13, 10])


@given(
    st.dictionaries(st.integers(0, 3), COUNTS, min_size=1),
    st.integers(0, 70000) | st.sampled_from([0x0A0D, 0x0D0A, 13, 10, 2560, 3328]),
)
def test_a_legacy_move_has_no_marker_and_says_what_is_in_it(targets: dict[int, int], ms: int) -> None:
    packet, run_time, counts = make_legacy_move(targets, ms)
    assert b"\r\n" not in packet
    address, rows = parse_sync_write(parse_packet(packet))
    assert address == 0x2A
    assert {i: int.from_bytes(row[:2], "little") for i, row in rows} == counts
    assert {int.from_bytes(row[2:], "little") for _, row in rows} == {run_time}
    assert 9 <= run_time <= 0xFFFF
    assert abs(run_time - min(max(ms, 9), 0xFFFF)) <= 3
    for servo_id, wanted in targets.items():
        assert abs(counts[servo_id] - min(max(wanted, 0), 0xFFFF)) <= 2


@given(st.integers(4, 6), st.integers(-4000, 8000), st.integers(1, 4000), st.integers(1, 2047))
def test_an_hls_block_has_no_marker_and_all_four_fields(
    servo_id: int, counts: int, speed: int, ceiling: int
) -> None:
    packet, sent = make_hls_block(servo_id, counts, speed, ceiling)
    assert b"\r\n" not in packet
    assert 0 <= sent - counts <= 3
    params = parse_packet(packet).params
    assert (params[0], params[1], len(params)) == (0x29, 0, 8)
    assert Series.HLS.register("goal_position").decode(params[2:4]) == sent
    assert int.from_bytes(params[4:6], "little") == ceiling
    assert speed <= int.from_bytes(params[6:8], "little") <= speed + 3


# --- stop ------------------------------------------------------------------------------------------------------


def under_way(baud: int = 115200) -> Arm:
    arm = Arm(1, baud)
    arm.driver.torque(True)
    arm.driver.write(JointTarget.of({n: HEX7BOT.joint(n).offset + 0.7 for n in HEX7BOT.names}, 3.0))
    arm.wait(0.5)
    return arm


def test_stop_holds_each_joint_where_it_is_when_it_is_its_turn() -> None:
    arm = under_way()
    assert arm.driver.stop() == HEX7BOT.names
    stopped = arm.shafts()
    arm.wait(3)
    assert arm.shafts() == pytest.approx(stopped, abs=25)
    assert arm.torques() == [True] * 7
    assert arm.driver.read().stopped
    check_old_board_survives(arm.link.written)


def test_stop_with_torque_off_and_what_is_refused_after() -> None:
    arm = under_way()
    assert arm.driver.stop(StopMode.TORQUE_OFF) == HEX7BOT.names
    assert arm.torques() == [False] * 7
    arm.link.written.clear()
    for refused in (
        lambda: arm.driver.torque(True),
        lambda: arm.driver.write(JointTarget.of({"J1": 0.0})),
        lambda: arm.driver.transact(sp.make_write(4, 0x28, b"\1"), 6),
        lambda: arm.driver.ioctl(Command.TRANSACT, b"\6\0" + sp.make_write(4, 0x28, b"\1")),
    ):
        with pytest.raises(StoppedError, match="resume"):
            refused()
    assert [c for c in arm.commands() if c == Command.SYNC_WRITE] == []
    assert all(f.body[4] == 2 for f in arm.frames())
    assert arm.driver.torque(False) == HEX7BOT.names
    arm.driver.resume()
    assert arm.torques() == [False] * 7
    assert arm.driver.torque(True) == HEX7BOT.names


def test_a_joint_that_does_not_confirm_is_switched_off_twice() -> None:
    arm = Arm(1, 0, ("silent:5",))
    arm.driver.torque(True)
    arm.link.written.clear()
    assert arm.driver.torque(False) == (*HEX7BOT.names[:5], "J7")
    packets = [parse_packet(frame.body) for frame in arm.frames()]
    assert Counter(p.servo_id for p in packets if p.instruction == sp.Instruction.WRITE) == {
        joint.servo_id: 2 if joint.name == "J6" else 1 for joint in HEX7BOT.joints
    }


def test_a_stop_switches_no_torque_on_though_nothing_is_known_of_it_yet() -> None:
    arm = Arm(1, 115200)
    arm.board.wire[1].receive(parse_packet(sp.make_write(1, 0x28, b"\1")), arm.clock.time)
    assert arm.driver.stop() == HEX7BOT.names
    assert arm.torques() == [False, True, False, False, False, False, False]


def test_a_stop_between_two_writes_of_a_move_ends_the_move() -> None:
    for after in range(1, 4):
        arm = Arm(1)
        arm.driver.torque(True)
        arm.driver.read()
        write, count = arm.link.write, [0]

        def stopping(data: bytes, deadline: float | None = None, arm: Arm = arm, after: int = after) -> None:
            write(data, deadline)  # noqa: B023
            if data[38] == Command.SYNC_WRITE or data[44] == sp.Instruction.WRITE:
                count[0] += 1  # noqa: B023
                if count[0] == after:  # noqa: B023
                    arm.driver.session.epochs.assume_stopped()  # as another thread's stop does

        arm.link.write = stopping  # type: ignore[method-assign]  # a stop in the middle
        with pytest.raises((StoppedError, PreemptedError)):
            arm.driver.write(JointTarget.of({"J1": 0.1, "J5": 0.1, "J6": 0.1, "J7": 0.1}, 1.0))
        assert count[0] == after


# --- tools -----------------------------------------------------------------------------------------------------


def test_probe_pings_and_tells_the_families_apart() -> None:
    report = Arm(1, 115200, ("silent:5",)).driver.probe()
    assert (report.dialect, report.firmware, report.boot_id, report.capabilities) == (1, "", None, ())
    assert report.missing == ("J6",)
    assert [j.series for j in report.joints] == ["seven_bot"] * 4 + ["hls", "unknown", "hls"]
    assert report.counters["requests"] > 10


def test_ping_and_transact() -> None:
    arm = Arm(1, 0, ("silent:3",))
    assert arm.driver.ping(0) == 0
    assert arm.driver.ping(3) is None
    assert arm.driver.ping(99) is None
    assert arm.driver.transact(sp.make_read(4, 56, 2), 8)[:5] == bytes.fromhex("FF FF 04 04 00")
    with pytest.raises(NotSupportedError, match="2 bytes"):
        arm.driver.transact(sp.make_read(4, 56, 15), 21)


def test_an_answer_that_nobody_wants_is_not_returned() -> None:
    driver = Arm(1).driver
    assert len(driver.transact(sp.make_ping(4), 6)) == 6
    assert driver.transact(sp.make_ping(4), 0) == b""


@pytest.mark.parametrize("gone", [False, True], ids=["a ping", "the port"])
def test_a_ping_is_asked_again_after_a_loss(gone: bool) -> None:
    arm = Arm(1, 115200)
    write, lost = arm.link.write, []

    def lose_one(data: bytes, deadline: float | None = None) -> None:
        if not lost and parse_frame(data).cmd == Command.PING:
            lost.append(data)
            if gone:
                arm.link.close()
                raise LinkLostError("unplugged", url=arm.link.url)
        else:
            write(data, deadline)

    arm.link.write = lose_one  # type: ignore[method-assign]
    assert arm.driver.ping(0) == 0
    assert len(lost) == 1


@pytest.mark.parametrize("call", ["stream", "watchdog", "limits", "store_limits", "offsets"])
def test_what_only_dialect_2_can_do(call: str) -> None:
    driver = Arm(1).driver
    arguments = {"stream": (0.1,), "watchdog": (1.0,)}.get(call, ())
    with pytest.raises(NotSupportedError, match="needs a board with dialect 2"):
        list(getattr(driver, call)(*arguments))
    assert driver.board_counters() == {}
    with pytest.raises(NotSupportedError, match="ioctl 0x1B"):
        driver.ioctl(Command.STATS)


def test_ioctl_sends_the_chapters_own_commands() -> None:
    arm = Arm(1, 115200)
    driver = arm.driver
    status = driver.ioctl(Command.PING, sp.make_ping(4))
    assert sp.parse_status(status, as_it_is=True).servo_id == 4
    assert driver.ioctl(Command.READ, sp.make_read(4, 56, 2)) == driver.transact(sp.make_read(4, 56, 2), 8)
    assert driver.torque(True, ["J2"]) == ("J2",)
    before = arm.shaft(1)
    move = sp.make_sync_write(0x2A, {1: round(before - 20).to_bytes(2, "little") + (500).to_bytes(2, "little")})
    assert driver.ioctl(Command.SYNC_WRITE, move) == b""
    driver.read()
    arm.wait(1.0)
    assert arm.shaft(1) == pytest.approx(before - 20, abs=3)
    driver.stop()
    arm.link.written.clear()
    for cmd, packet in ((Command.SYNC_WRITE, move), (Command.READ, sp.make_write(4, 0x28, b"\1"))):
        with pytest.raises(StoppedError):
            driver.ioctl(cmd, packet)
    assert not arm.link.written
    assert driver.ioctl(Command.PING, sp.make_ping(4)) == status


def test_ioctl_refuses_what_would_overrun_the_chapters_board() -> None:
    arm = Arm(1, 115200)
    hls = next(joint.servo_id for joint in HEX7BOT.joints if joint.series == "hls")
    arm.link.written.clear()
    for cmd, packet, text in (
        (Command.PING, b"", "servo packets only"),
        (Command.PING, sp.make_read(4, 56, 2), "a ping only"),
        (Command.READ, sp.make_read(4, 56, 4), "other than 2 bytes"),
        (Command.READ, sp.make_ping(0xFE), "to all servos"),
        (Command.SYNC_WRITE, sp.make_ping(4), "a sync write only"),
        (Command.SYNC_WRITE, sp.make_sync_write(0x2A, {hls: bytes(4)}), "current ceiling"),
    ):
        with pytest.raises(UsageError, match=text):
            arm.driver.ioctl(cmd, packet)
    assert not arm.link.written
