"""What acts is void after a stop; what only asks is not."""

from __future__ import annotations

import pytest

from hexwire.session.effects import Effect, effect_of, packet_only_reads
from hexwire.wire import servo_packet as sp
from hexwire.wire.command_frame import Command

PING, WRITE = sp.make_ping(1), sp.make_write(1, 0x28, b"\1")


@pytest.mark.parametrize(
    ("cmd", "body", "effect"),
    [
        (Command.JOINT_STATE, b"\0", Effect.NONE),
        (Command.WATCHDOG, b"\0\0\0", Effect.NONE),
        (Command.LIMITS, b"", Effect.NONE),
        (Command.LIMITS, b"\7", Effect.ACT),
        (Command.JOINT_MOVE, b"", Effect.ACT),
        (Command.TORQUE, b"\1\x7f\0", Effect.ACT),
        (Command.TORQUE, b"\0\x7f\0", Effect.FREE),
        (Command.STOP, b"\0", Effect.STOP),
        (Command.RESUME, b"", Effect.RESUME),
        (Command.ROBOT_SIGNAL, b"\1", Effect.STOP),
        (Command.ROBOT_SIGNAL, b"\2", Effect.STOP),
        (Command.ROBOT_SIGNAL, b"\3", Effect.RESUME),
        (Command.ROBOT_SIGNAL, b"\4", Effect.ACT),
        (Command.ROBOT_SIGNAL, b"\5", Effect.FREE),
        (Command.ROBOT_SIGNAL, b"", Effect.ACT),
        (Command.IO, b"\0\0", Effect.NONE),
        (Command.IO, b"\1\1", Effect.ACT),
        (Command.TRANSACT, b"\6\x14" + PING, Effect.NONE),
        (Command.TRANSACT, b"\6\x14" + WRITE, Effect.ACT),
        (Command.TRANSACT, b"", Effect.ACT),
        (Command.READ, PING, Effect.NONE),
        (Command.READ, WRITE, Effect.ACT),
        (0x7E, b"", Effect.ACT),
    ],
)
def test_dialect_2(cmd: int, body: bytes, effect: Effect) -> None:
    assert effect_of(2, cmd, body) is effect


@pytest.mark.parametrize(
    ("cmd", "body", "effect"),
    [
        (Command.PING, PING, Effect.NONE),
        (Command.READ, sp.make_read(1, 56, 2), Effect.NONE),
        (Command.READ, WRITE, Effect.ACT),
        (Command.SYNC_WRITE, b"", Effect.ACT),
        (Command.IDENTIFY, b"", Effect.NONE),
    ],
)
def test_dialect_1(cmd: int, body: bytes, effect: Effect) -> None:
    assert effect_of(1, cmd, body) is effect


def test_requests_that_only_read_whatever_their_body() -> None:
    names = {
        "IDENTIFY", "JOINT_STATE", "REPORT", "WATCHDOG", "STATS", "ROBOT_PROBE", "JOINT_STATES", "JOYSTICK",
        "TRAJECTORY_STATUS", "HOST_BAUD",
    }  # fmt: skip
    for body in (b"\1", b"\1\2\3"):
        asks = {cmd.name for cmd in Command if effect_of(2, cmd, body) is Effect.NONE}
        assert asks == names
    assert {cmd.name for cmd in Command if effect_of(2, cmd, b"") is Effect.NONE} == names | {"LIMITS", "OFFSETS"}
    assert {cmd.name for cmd in Command if effect_of(1, cmd, b"\1") is Effect.NONE} == {"IDENTIFY"}


def test_a_packet_is_known_by_its_instruction_or_it_acts() -> None:
    for packet in (PING, sp.make_read(1, 56, 2), sp.make_sync_read(56, 2, (1,))):
        assert packet_only_reads(packet)
        assert packet_only_reads(packet[:5])
        assert not packet_only_reads(packet[:4])
    for packet in (WRITE, sp.make_reg_write(1, 40, b"\1"), sp.make_action(), sp.make_reboot(1), b""):
        assert not packet_only_reads(packet)
