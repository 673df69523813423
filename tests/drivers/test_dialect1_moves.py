"""Moves of dialect 1: no target, run time or current ceiling can put 0D 0A into the packet."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.drivers.board1 import make_hls_block, make_legacy_move
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import parse_packet, parse_sync_write

BYTES = st.sampled_from((0x0A, 0x0D)) | st.integers(0, 255)
HIGH = st.sampled_from((0x0A, 0x0D)) | st.integers(0, 15)
WORDS = st.builds(lambda high, low: high << 8 | low, HIGH, BYTES)
CEILINGS = st.builds(lambda high, low: high << 8 | low, st.integers(0, 7), BYTES)


@given(st.dictionaries(st.integers(0, 6), WORDS, min_size=1), WORDS)
def test_a_sync_write_avoids_the_marker_by_a_count_or_a_millisecond(targets: dict[int, int], run_time: int) -> None:
    packet, sent_time, sent = make_legacy_move(targets, run_time)
    assert b"\r\n" not in packet
    assert abs(sent_time - max(run_time, 9)) <= 3
    assert all(abs(sent[servo_id] - counts) <= 2 for servo_id, counts in targets.items())
    address, rows = parse_sync_write(parse_packet(packet))
    assert address == 0x2A
    assert rows == tuple(
        (servo_id, counts.to_bytes(2, "little") + sent_time.to_bytes(2, "little"))
        for servo_id, counts in sent.items()
    )


@given(st.integers(0, 6), WORDS, st.integers(1, 700), CEILINGS)
def test_a_block_avoids_the_marker_by_little_and_never_by_more_current(
    servo_id: int, counts: int, speed: int, ceiling: int
) -> None:
    packet, sent = make_hls_block(servo_id, counts, speed, ceiling)
    assert b"\r\n" not in packet
    assert 0 <= sent - counts <= 1
    params = parse_packet(packet).params
    assert params[:2] == b"\x29\x00"
    hls = Series.HLS
    assert hls.register("goal_position").decode(params[2:4]) == sent
    assert 0 <= ceiling - hls.register("goal_torque").decode(params[4:6]) <= 1
    assert 0 <= hls.register("goal_speed").decode(params[6:8]) - speed <= 3


def test_a_position_high_byte_beside_a_ceiling_low_byte() -> None:
    # 0x0D00 and 0x010A: no nearby position helps, a unit of current does.
    packet, sent = make_hls_block(4, 0x0D00, 1, 0x010A)
    assert sent == 0x0D00
    assert packet[9:11] == b"\x09\x01"
