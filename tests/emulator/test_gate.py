"""The table of PROTOCOL.md section 6.4, row by row."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator.gate import (
    Admitted,
    Gate,
    JointFacts,
    RefusedError,
    check_packet,
    speed_cap,
    time_needed,
)
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Status

LEGACY = JointFacts(True, True, True, 2000, 0, 0, 1000, 3000, 1000)
HLS = JointFacts(False, True, True, 2000, 0, 154, 1000, 3000, 1000)
JOINTS = {0: LEGACY, 1: LEGACY, 4: HLS, 5: replace(HLS, torque_on=False)}
OPEN = Gate(JOINTS)
CHAPTER = Gate(JOINTS, chapter=True)
UPKEEP = Gate(JOINTS, maintenance=True)


def le(value: int) -> bytes:
    return value.to_bytes(2, "little")


def be(value: int) -> bytes:
    return value.to_bytes(2, "big")


def judge(gate: Gate, packet: bytes) -> Admitted | Status:
    try:
        return gate.judge(check_packet(packet))
    except RefusedError as refused:
        return refused.status


def packets(gate: Gate, packet: bytes) -> tuple[bytes, ...]:
    passed = judge(gate, packet)
    assert isinstance(passed, Admitted), passed
    return passed.packets


@pytest.mark.parametrize("gate", [OPEN, CHAPTER, UPKEEP, Gate(JOINTS, stopped=True)])
@pytest.mark.parametrize(
    "packet",
    [
        sp.make_ping(0),
        sp.make_read(9, 0x38, 2),
        sp.make_sync_read(0x38, 15, [4, 5]),
        sp.make_sync_read(0x38, 14, list(range(6))),
    ],
)
def test_packets_that_change_nothing_always_pass(gate: Gate, packet: bytes) -> None:
    assert packets(gate, packet) == (packet,)


@pytest.mark.parametrize(
    "packet",
    [
        sp.make_packet(0, sp.Instruction.READ, b"\x38"),
        sp.make_packet(0, sp.Instruction.READ, b"\x38\0"),
        sp.make_packet(0, sp.Instruction.READ, b"\x38\xff"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_READ, b"\x38\2"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_READ, b"\x38\xff\4\5"),
        sp.make_sync_read(0x38, 15, list(range(6))),
        sp.make_packet(4, sp.Instruction.WRITE, b""),
        sp.make_packet(4, sp.Instruction.WRITE, b"\x28"),
        sp.make_packet(4, sp.Instruction.WRITE, b"\xff\0\0"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b""),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a\2"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a\0\4"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a\2\4\0"),
        # A row of 255 bytes: 256 with its id, which is 0 in a byte.
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a\xff\4\0\0\0"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\x2a\2\4\0\x08\4\0\x08"),
        sp.make_packet(0xFE, sp.Instruction.SYNC_WRITE, b"\xff\2\4\0\x08"),
        b"\xff\xff\4\5\3\x2a",
        b"",
    ],
)
@pytest.mark.parametrize("gate", [OPEN, UPKEEP, Gate(JOINTS, stopped=True)])
def test_a_malformed_packet_is_bad_range_in_every_state(gate: Gate, packet: bytes) -> None:
    assert judge(gate, packet) == Status.BAD_RANGE


WRITES = [
    sp.make_write(4, 0x2A, le(2100)),
    sp.make_write(4, 0x28, b"\0"),
    sp.make_write(0xFE, 0x28, b"\0"),
    sp.make_sync_write(0x2A, {4: le(2100)}),
    sp.make_write(4, 0x30, le(500)),
    sp.make_action(),
    sp.make_reboot(4),
    sp.make_packet(4, 0x77),
]


@pytest.mark.parametrize("packet", WRITES)
@pytest.mark.parametrize("chapter", [False, True])
def test_nothing_else_passes_while_stopped(chapter: bool, packet: bytes) -> None:
    assert judge(Gate(JOINTS, chapter, stopped=True), packet) == Status.STOPPED


@pytest.mark.parametrize("gate", [OPEN, CHAPTER, UPKEEP])
@pytest.mark.parametrize("servo_id", [0, 4, 9, 0xFE])
def test_torque_can_always_be_taken(gate: Gate, servo_id: int) -> None:
    packet = sp.make_write(servo_id, 0x28, b"\0")
    passed = judge(gate, packet)
    assert isinstance(passed, Admitted)
    assert passed.packets == (packet,)
    expected = {servo_id} & set(JOINTS) if servo_id != 0xFE else set(JOINTS)
    assert passed.torque == dict.fromkeys(expected, False)
    rows = sp.make_sync_write(0x28, {0: b"\0", 9: b"\0"})
    assert packets(gate, rows) == (rows,)


def test_torque_is_given_in_dialect_1_only_and_where_the_joint_stands() -> None:
    packet = sp.make_write(5, 0x28, b"\1")
    assert judge(OPEN, packet) == Status.FORBIDDEN
    assert judge(UPKEEP, packet) == Status.FORBIDDEN
    assert judge(Gate(JOINTS, chapter=True, maintenance=True), packet) == Status.FORBIDDEN
    assert judge(CHAPTER, packet) == Admitted((packet,), (5,), {5: True})
    assert judge(CHAPTER, sp.make_write(9, 0x28, b"\1")) == Status.FORBIDDEN
    assert judge(CHAPTER, sp.make_write(0xFE, 0x28, b"\1")) == Status.FORBIDDEN
    silent = Gate({4: replace(HLS, position=None)}, chapter=True)
    assert judge(silent, sp.make_write(4, 0x28, b"\1")) == Status.SERVO_SILENT
    turning = Gate({4: replace(HLS, positioning=False)}, chapter=True)
    assert judge(turning, sp.make_write(4, 0x28, b"\1")) == Status.SERVO_FAULT
    for value in (2, 128):
        assert judge(CHAPTER, sp.make_write(4, 0x28, bytes((value,)))) == Status.FORBIDDEN
        assert judge(UPKEEP, sp.make_write(4, 0x28, bytes((value,)))) != Status.FORBIDDEN


TARGETS = [
    (sp.make_write(4, 0x2A, le(3001)), Status.BAD_RANGE),
    (sp.make_write(4, 0x2A, le(999)), Status.BAD_RANGE),
    (sp.make_write(4, 0x2A, le(0x8000 | 2000)), Status.BAD_RANGE),
    (sp.make_write(0, 0x2A, le(2000)), Status.BAD_RANGE),  # legacy is big-endian
    (sp.make_write(4, 0x2A, b"\x08"), Status.BAD_RANGE),
    (sp.make_write(4, 0x2B, b"\x08"), Status.BAD_RANGE),
    (sp.make_write(4, 0x29, b"\0\x08"), Status.BAD_RANGE),
    (sp.make_write(4, 0x2A, le(2000) + b"\0"), Status.BAD_RANGE),
    (sp.make_write(4, 0x2A, le(2000) + le(154) + b"\1"), Status.BAD_RANGE),
    (sp.make_write(0, 0x2A, be(2000) + b"\0"), Status.BAD_RANGE),
    (sp.make_write(9, 0x2A, le(2000)), Status.FORBIDDEN),
    (sp.make_write(0xFE, 0x2A, le(2000)), Status.FORBIDDEN),
    (sp.make_write(5, 0x2A, le(2000)), Status.TORQUE_OFF),
    (sp.make_write(5, 0x2A, le(4000)), Status.BAD_RANGE),
    (sp.make_sync_write(0x2A, {4: le(2000), 5: le(4000)}), Status.BAD_RANGE),
    (sp.make_sync_write(0x2A, {5: le(2000), 4: le(4000)}), Status.TORQUE_OFF),
    (sp.make_sync_write(0x29, {4: b"\0" + le(2000), 0: b"\0" + be(2000)}), Status.FORBIDDEN),
    (sp.make_write(4, 0x2E, le(20)), Status.FORBIDDEN),
    (sp.make_write(4, 0x29, b"\5"), Status.FORBIDDEN),
    (sp.make_write(0, 0x2C, be(0)), Status.FORBIDDEN),
    (sp.make_write(0, 0x2C, b"\0"), Status.BAD_RANGE),
    (sp.make_reg_write(4, 0x2A, le(2000)), Status.FORBIDDEN),
    (sp.make_action(), Status.FORBIDDEN),
]


@pytest.mark.parametrize(("packet", "status"), TARGETS)
def test_targets_that_the_gate_refuses(packet: bytes, status: Status) -> None:
    assert judge(OPEN, packet) == status


def test_targets_of_joints_that_cannot_be_judged() -> None:
    packet = sp.make_write(4, 0x2A, le(2000))
    assert judge(Gate({4: replace(HLS, position=None)}), packet) == Status.SERVO_SILENT
    assert judge(Gate({4: replace(HLS, positioning=False)}), packet) == Status.SERVO_FAULT
    assert judge(UPKEEP, packet) == Status.FORBIDDEN
    # In dialect 1 it is the only way to move, and gives torque.
    passed = judge(CHAPTER, sp.make_write(5, 0x2A, le(2000)))
    assert isinstance(passed, Admitted)
    assert (passed.torque, passed.targets, passed.hold) == ({5: True}, {5: 2000}, ())


def test_a_joint_that_follows_a_trajectory_takes_no_other_target() -> None:
    busy = {0: replace(LEGACY, following=True, torque_on=False), 4: replace(HLS, following=True), 1: LEGACY}
    for chapter in (False, True):
        gate = Gate(busy, chapter=chapter)
        assert judge(gate, sp.make_write(0, 0x2A, be(2000))) == Status.BUSY
        assert judge(gate, sp.make_write(4, 0x2A, le(2000))) == Status.BUSY
        assert judge(gate, sp.make_write(4, 0x2A, le(3001))) == Status.BAD_RANGE
        assert judge(gate, sp.make_sync_write(0x2A, {1: be(2000), 0: be(2000)})) == Status.BUSY
        assert isinstance(judge(gate, sp.make_write(1, 0x2A, be(2000))), Admitted)
        assert isinstance(judge(gate, sp.make_write(4, 0x28, b"\0")), Admitted)
        assert isinstance(judge(gate, sp.make_write(4, 0x30, b"\1")), Admitted)
    assert judge(Gate(busy, chapter=True), sp.make_write(4, 0x28, b"\1")) == Status.BUSY
    assert judge(Gate(busy), sp.make_write(4, 0x28, b"\1")) == Status.FORBIDDEN


def test_a_target_keeps_the_speed_limit() -> None:
    # Legacy: run time, added or lengthened: 500 counts at 1000 counts/s.
    assert packets(OPEN, sp.make_write(0, 0x2A, be(2500))) == (sp.make_write(0, 0x2A, be(2500) + be(500)),)
    assert packets(OPEN, sp.make_write(0, 0x2A, be(2500) + be(1))) == (sp.make_write(0, 0x2A, be(2500) + be(500)),)
    slow = sp.make_write(0, 0x2A, be(2500) + be(900))
    assert packets(OPEN, slow) == (slow,)
    # HLS: speed in units of 50 counts/s, put in or lowered.
    block = b"\0" + le(2500) + le(154) + le(20)
    whole = (sp.make_write(4, 0x29, block),)
    assert packets(OPEN, sp.make_write(4, 0x2A, le(2500))) == whole
    assert packets(OPEN, sp.make_write(4, 0x29, block[:-2] + le(0))) == whole
    assert packets(OPEN, sp.make_write(4, 0x29, block[:-2] + le(500))) == whole
    assert packets(OPEN, sp.make_write(4, 0x29, block[:-2] + le(0x8000 | 500))) == whole
    own = b"\7" + le(2500) + le(99) + le(3)
    assert packets(OPEN, sp.make_write(4, 0x29, own + le(400))) == (sp.make_write(4, 0x29, own + le(400)),)
    unknown = Gate({4: replace(HLS, ceiling=0)})
    assert packets(unknown, sp.make_write(4, 0x2A, le(2500))) == whole


def test_a_joint_that_moves_may_be_further_away() -> None:
    assert time_needed(LEGACY, 2500) == 500
    assert time_needed(replace(LEGACY, late_ms=30), 2500) == 530
    assert time_needed(replace(LEGACY, speed=1), 1000) == 0xFFFF
    assert time_needed(replace(LEGACY, speed=1), 2007) == 7000
    assert time_needed(replace(LEGACY, speed=0), 2007) == 7000
    assert [speed_cap(limit) for limit in (1, 49, 50, 99, 4096)] == [1, 1, 1, 1, 81]


def test_a_sync_write_of_targets_goes_out_as_whole_blocks_of_each_kind() -> None:
    packet = sp.make_sync_write(0x2A, {4: le(2500), 0: be(2500)})
    assert packets(OPEN, packet) == (
        sp.make_sync_write(0x29, {4: b"\0" + le(2500) + le(154) + le(20)}),
        sp.make_sync_write(0x2A, {0: be(2500) + be(500)}),
    )


RAM = [sp.make_write(4, 0x30, le(500)), sp.make_write(4, 0x32, b"\1\2\3"), sp.make_write(4, 0x2C, le(99))]
SETTINGS = [
    sp.make_write(4, 5, b"\x09"),
    sp.make_write(4, 0x21, b"\1"),
    sp.make_write(4, 0x37, b"\0"),
    sp.make_write(0, 9, be(0) + be(100)),
    sp.make_write(0, 0x2E, be(0)),
    sp.make_write(0, 0x30, be(500)),
    sp.make_write(4, 0x36, b"\0"),
    sp.make_write(4, 0x38, le(0)),
    sp.make_write(4, 0x50, b"\0"),
    sp.make_write(4, 0x35, b"\0\0"),
    sp.make_write(9, 5, b"\4"),
    sp.make_sync_write(0x21, {4: b"\1", 5: b"\1"}),
    sp.make_write(0xFE, 0x21, b"\0"),
    sp.make_restore(4),
    sp.make_reboot(4),
    sp.make_calibrate(4),
    sp.make_backup(4),
    sp.make_reset_state(4),
    sp.make_packet(4, 0x77),
]


@pytest.mark.parametrize("packet", RAM)
def test_other_ram_is_for_joints(packet: bytes) -> None:
    for gate in (OPEN, CHAPTER, UPKEEP):
        assert packets(gate, packet) == (packet,)
        other = sp.make_packet(9, packet[4], packet[5:-1])
        assert judge(gate, other) == Status.FORBIDDEN
    all_servos = sp.make_packet(0xFE, packet[4], packet[5:-1])
    assert judge(OPEN, all_servos) == Status.FORBIDDEN
    assert packets(UPKEEP, all_servos) == (all_servos,)


@pytest.mark.parametrize("packet", SETTINGS)
def test_settings_are_for_maintenance(packet: bytes) -> None:
    assert judge(OPEN, packet) == Status.FORBIDDEN
    assert judge(CHAPTER, packet) == Status.FORBIDDEN
    assert packets(UPKEEP, packet) == (packet,)


@pytest.mark.parametrize(
    "packet",
    [
        sp.make_write(4, 0x2A, le(2000)),
        sp.make_write(4, 0x21, bytes(7) + b"\1"),
        sp.make_write(0xFE, 0x2A, le(2000)),
        sp.make_write(9, 0x2A, le(2000)),
        sp.make_write(4, 0x2E, le(20)),
        sp.make_reg_write(4, 0x2A, le(2000)),
        sp.make_action(4),
    ],
)
def test_nothing_moves_in_maintenance(packet: bytes) -> None:
    assert judge(UPKEEP, packet) == Status.FORBIDDEN


@given(
    st.integers(0, 0xFE),
    st.sampled_from([*sp.Instruction, 0x77]),
    st.binary(max_size=40),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)
def test_any_packet_has_a_verdict(
    servo_id: int, instruction: int, params: bytes, chapter: bool, stopped: bool, maintenance: bool
) -> None:
    gate = Gate(JOINTS, chapter, stopped, maintenance)
    verdict = judge(gate, sp.make_packet(servo_id, instruction, params))
    if isinstance(verdict, Admitted):
        for packet in verdict.packets:
            sp.parse_packet(packet)
