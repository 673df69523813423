"""Frames for one module, several and all (PROTOCOL.md section 6.9), of the firmware's core."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import CoreBoard

from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status

# The first one builds.

ALL = tables.ADDRESS_BROADCAST
SEVERAL = tables.ADDRESS_MULTICAST | 1 << 8 | 1 << 3
OTHERS = tables.ADDRESS_MULTICAST | (1 << 30) - 1 & ~(1 << 8)

MAY_GO_TO_SEVERAL = {
    Command.SYNC_WRITE,
    Command.IDENTIFY,
    Command.JOINT_STATE,
    Command.REPORT,
    Command.JOINT_MOVE,
    Command.TORQUE,
    Command.STOP,
    Command.RESUME,
    Command.WATCHDOG,
    Command.STATS,
    Command.TRAJECTORY_START,
    Command.TRAJECTORY_STATUS,
    Command.TRAJECTORY_ABORT,
}


@pytest.fixture
def client() -> Iterator[Client]:
    board = CoreBoard()
    board.settle()
    yield Client(board)
    board.close()


def replies(client: Client, cmd: int, body: bytes = b"", *, dst: int, seq: int | None = None) -> list[Frame]:
    client.frames()
    client.machine.send(client.frame(cmd, body, dst=dst, seq=seq))
    return [frame for frame in client.run(0.02) if frame.is_reply]


@pytest.mark.parametrize("dst", [ALL, SEVERAL, tables.ADDRESS_MULTICAST | (1 << 30) - 1])
def test_a_command_for_several_is_executed_as_one_for_this_board(client: Client, dst: int) -> None:
    (reply,) = replies(client, Command.STATS, dst=dst)
    assert (reply.src, reply.dst, reply.cmd, reply.seq) == (8, 7, Command.STATS, client.seq)
    assert (reply.status, len(reply.body)) == (Status.OK, 60)


@pytest.mark.parametrize(
    "dst", [0, 7, 9, 29, 30, 0x3FFFFFFF, tables.ADDRESS_MULTICAST, OTHERS, -2, -(1 << 31) | 1 << 8]
)
def test_a_frame_for_others_is_as_if_it_had_not_come(client: Client, dst: int) -> None:
    client.ask(Command.WATCHDOG, b"\x64\0\0")  # 100 ms
    for _ in range(8):
        assert replies(client, Command.STATS, dst=dst) == []
    assert client.ask(Command.RESUME).body[0] & tables.BOARD_FLAGS_WATCHDOG_TRIPPED == 0
    client.run(0.12)
    state = client.ask(Command.JOINT_STATE, b"\0")
    assert state.body[5] & tables.BOARD_FLAGS_WATCHDOG_TRIPPED


@pytest.mark.parametrize("dst", [ALL, SEVERAL])
def test_a_frame_for_several_feeds_the_watchdog(client: Client, dst: int) -> None:
    client.ask(Command.WATCHDOG, b"\x64\0\0")
    for _ in range(10):
        assert replies(client, Command.STATS, dst=dst)
    assert client.ask(Command.JOINT_STATE, b"\0").body[5] == tables.BOARD_FLAGS_SETTINGS_DEFAULT


def test_only_some_commands_may_go_to_several(client: Client) -> None:
    # A body of 100 bytes is right for no command: nothing is executed.
    answered = {}
    for cmd in range(256):
        client.machine.send(client.frame(cmd, bytes(100), dst=ALL))
        (answered[cmd],) = [frame.status for frame in client.run(0.02) if frame.is_reply] or [None]
    for cmd, status in answered.items():
        assert (status == Status.NOT_SUPPORTED) == (cmd not in MAY_GO_TO_SEVERAL), f"{cmd:02X}: {status}"
    # Not stored: a refusal does not take the place of a reply.
    (stored,) = replies(client, Command.STATS, dst=8)
    for _ in range(8):
        (refusal,) = replies(client, Command.LIMITS, dst=ALL)
        assert refusal.status == Status.NOT_SUPPORTED
    (again,) = replies(client, Command.STATS, dst=8, seq=stored.seq)
    assert again.body == stored.body


def test_a_repeat_may_have_another_destination(client: Client) -> None:
    (first,) = replies(client, Command.STATS, dst=ALL)
    for dst in (SEVERAL, 8):
        (again,) = replies(client, Command.STATS, dst=dst, seq=first.seq)
        assert again.body == first.body
    (other,) = replies(client, Command.STATS, dst=ALL)
    assert other.body != first.body


def test_a_stop_for_all_stops_at_once(client: Client) -> None:
    client.ask(Command.TORQUE, b"\1\x7f\0")
    client.machine.send(client.frame(Command.STOP, b"\1", dst=ALL))
    stop = client.reply()
    assert (stop.status, stop.body) == (Status.OK, b"\1\x7f\0")
    assert client.ask(Command.TORQUE, b"\1\x7f\0").status == Status.STOPPED


def test_the_chapters_dialect_ignores_the_destination(client: Client) -> None:
    packet = bytes.fromhex("FF FF 00 02 01 FC")
    client.machine.send(client.frame(Command.PING, packet, proto=1, dst=5))
    (reply,) = client.run(0.03)
    assert (reply.proto, reply.body[:4]) == (1, bytes.fromhex("FF F5 00 06"))
