from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from hexwire.emulator.board_bus import BoardBus, Transaction
from hexwire.emulator.board_orders import BoardOrders
from hexwire.emulator.board_state import BoardSettings, BoardState
from hexwire.emulator.gate import RefusedError
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Status
from hexwire.wire.commands import LimitRow


def orders(**changes: Any) -> tuple[BoardState, BoardOrders]:
    """Orders of a board with seven joints that have torque, stand at 2048 and were sampled now."""
    state = BoardState(1, 0.0, BoardSettings(limits=[LimitRow(1000, 3000, 4000)] * 7))
    for name, value in changes.items():
        setattr(state, name, value)
    for joint in state.joints:
        joint.present, joint.torque_on, joint.unsure = True, True, False
        joint.position, joint.sampled_at, joint.ceiling = 2048, 0.0, 100
    return state, BoardOrders(state, BoardBus(state, lambda: 0.0, paced=True), lambda: 0.0)


def done(job: Generator[Any, bytes | None, Any]) -> tuple[list[bytes], Any]:
    """Packets that a job puts on the bus, which answers none, and what it returns."""
    packets: list[bytes] = []
    answer = None
    while True:
        try:
            wait = job.send(answer)
        except StopIteration as end:
            return packets, end.value
        assert isinstance(wait, Transaction)
        packets.append(wait.packet)
        answer = b""


@pytest.mark.parametrize(
    ("changes", "status"), [({"stopped": True}, Status.STOPPED), ({"maintenance": True}, Status.FORBIDDEN)]
)
def test_motion_is_refused(changes: dict[str, bool], status: Status) -> None:
    _, refused = orders(**changes)
    with pytest.raises(RefusedError) as caught:
        done(refused.chapter_move([(0, 2100, 0)], chapter=True))
    assert caught.value.status == status


def test_a_sync_write_for_a_joint_that_follows_a_trajectory_is_refused() -> None:
    state, made = orders()
    state.joints[0].following = True
    for chapter in (False, True):
        with pytest.raises(RefusedError) as caught:
            done(made.chapter_move([(1, 2100, 0), (0, 2100, 0)], chapter=chapter))
        assert caught.value.status == Status.BUSY
        assert done(made.chapter_move([(1, 2100, 0)], chapter=chapter))[1]


def test_a_target_is_clamped_and_the_joint_says_so() -> None:
    state, made = orders()
    assert made.clamp(state.joints[0], 2500) == 2500
    assert not state.joints[0].clamped
    assert made.clamp(state.joints[0], 3500) == 3000
    assert state.joints[0].clamped


def test_a_sync_write_takes_as_long_as_the_slowest_joint_needs() -> None:
    state, made = orders()
    needed = made.slowest([(state.joints[0], 2448), (state.joints[1], 2048)])
    assert needed >= 100, "400 counts at 4000 a second"
    packets, whole = done(made.chapter_move([(0, 2448, 0), (1, 2100, 5000), (9, 0, 0)], chapter=True))
    assert whole
    assert packets == [
        sp.make_sync_write(0x2A, {0: (2448).to_bytes(2, "big") + needed.to_bytes(2, "big")}),
        sp.make_sync_write(0x2A, {1: (2100).to_bytes(2, "big") + (5000).to_bytes(2, "big")}),
    ]


def test_a_joint_without_torque_moves_in_dialect_1_only() -> None:
    state, made = orders()
    state.joints[0].torque_on = False
    with pytest.raises(RefusedError) as caught:
        done(made.chapter_move([(0, 2100, 0)], chapter=False))
    assert caught.value.status == Status.TORQUE_OFF
    assert len(done(made.chapter_move([(0, 2100, 0)], chapter=True))[0]) == 1


def test_a_packet_that_changes_nothing_passes_as_it_is() -> None:
    _, made = orders(stopped=True)
    packet = sp.make_read(0, 56, 2)
    packets, passed = done(made.let_through(sp.parse_packet(packet), chapter=False))
    assert (packets, passed.packets) == ([], (packet,))
    with pytest.raises(RefusedError) as caught:
        done(made.let_through(sp.parse_packet(sp.make_write(0, 0x28, b"\1")), chapter=False))
    assert caught.value.status == Status.STOPPED
