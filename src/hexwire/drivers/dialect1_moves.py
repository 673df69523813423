"""Packets that move servos through a board of the chapter's dialect, without 0D 0A inside.

Owns which value is changed to avoid the marker (PROTOCOL.md section 5). Pure: must not know sessions, joints or
limits.
"""

from __future__ import annotations

from collections.abc import Mapping

from hexwire.errors import LocalProtocolError
from hexwire.wire.registers import Series
from hexwire.wire.servo_packet import make_sync_write, make_write
from hexwire.wire.tables import TAIL

__all__ = ["MIN_RUN_TIME", "make_hls_block", "make_legacy_move"]

MIN_RUN_TIME = 9
"""Milliseconds; the 7Bot library accepts no run time of 8 ms or less."""
_POSITION = Series.SEVEN_BOT.register("target_position").address
_BLOCK = Series.HLS.register("acceleration").address


def make_legacy_move(targets: Mapping[int, int], run_time_ms: int) -> tuple[bytes, int, dict[int, int]]:
    """Build the sync write of dialect 1 for legacy servos, without 0D 0A inside.

    To avoid the marker, the run time is changed first, by 1 ms steps, then a position by one count (PROTOCOL.md
    section 5).

    Args:
        targets: Counts by servo id.
        run_time_ms: Duration of the motion, milliseconds.

    Returns:
        The packet, and the run time and counts in it.

    Raises:
        LocalProtocolError: No packet can be built; the ids themselves form the marker.
    """
    run_time = min(max(run_time_ms, MIN_RUN_TIME), 0xFFFF)
    for nudge in range(3):
        for extra in range(4):
            ms = run_time + extra if run_time + extra <= 0xFFFF else run_time - extra
            rows, counts_sent = {}, {}
            for servo_id, counts in targets.items():
                # Change a position only if the marker is in its bytes or next to them.
                value = min(max(counts, 0), 0xFFFF)
                if nudge and b"\x0d" in value.to_bytes(2, "little") + bytes((servo_id,)):
                    value += nudge if value < 0xFFFF - nudge else -nudge
                counts_sent[servo_id] = value
                rows[servo_id] = value.to_bytes(2, "little") + ms.to_bytes(2, "little")
            packet = make_sync_write(_POSITION, rows)
            if TAIL not in packet:
                return packet, ms, counts_sent
    raise LocalProtocolError("no sync write without 0D 0A inside can be built for these servos")


def make_hls_block(servo_id: int, counts: int, speed: int, ceiling: int) -> tuple[bytes, int]:
    """Build the write that moves one HLS servo: acceleration, position, current ceiling, speed at 0x29.

    Args:
        servo_id: Bus id.
        counts: Target position.
        speed: In units of 50 counts/s, at least 1.
        ceiling: Current ceiling in units of 6.5 mA.

    Returns:
        The packet, and the position in it.

    Raises:
        LocalProtocolError: No block without 0D 0A inside can be built.
    """
    hls = Series.HLS
    # Reduce the current by a unit if it is next to a position's high byte, which no small step changes.
    for less, nudge in ((0, 0), (0, 1), (1, 0), (1, 1)):
        for faster in range(4):
            block = (
                b"\0"
                + hls.register("goal_position").encode(counts + nudge)
                + hls.register("goal_torque").encode(ceiling - less)
                + hls.register("goal_speed").encode(speed + faster)
            )
            packet = make_write(servo_id, _BLOCK, block)
            if TAIL not in packet:
                return packet, counts + nudge
    raise LocalProtocolError(f"no write without 0D 0A inside can be built for servo {servo_id}")
