"""The board learns which servos cannot answer a sync read, and asks them alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.avr.client import Client
from tests.avr.machines import CoreBoard

from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import Instruction

# The first one builds.

OLD = 5


class Arm:
    """A board whose servo OLD has a firmware that does not know SYNC_READ."""

    def __init__(self) -> None:
        self.machine = CoreBoard(())
        self.client = Client(self.machine)
        self.knows = False
        servo = self.machine.wire[OLD]
        answer = servo._do_sync_read
        servo._do_sync_read = lambda packet, own: answer(packet, own) if self.knows else None  # type: ignore[method-assign]  # as that firmware
        self.machine.settle(0.3)
        self.client.ask(Command.REPORT, b"\x05\0\0")

    def asked(self, seconds: float) -> tuple[int, int, int]:
        """Sync reads with OLD, sync reads without, and reads of OLD alone, in so much time."""
        self.machine.line.sent.clear()
        self.client.run(seconds)
        packets = [packet for _, packet in self.machine.line.sent]
        many = [packet for packet in packets if packet[4] == Instruction.SYNC_READ]
        alone = [packet for packet in packets if packet[4] == Instruction.READ and packet[2] == OLD]
        with_it = sum(OLD in packet[7:-1] for packet in many)
        return with_it, len(many) - with_it, len(alone)


@pytest.fixture
def arm() -> Iterator[Arm]:
    made = Arm()
    yield made
    made.machine.close()


def test_a_servo_that_does_not_know_it_is_asked_alone(arm: Arm) -> None:
    arm.client.run(1.0)
    with_it, without, alone = arm.asked(2.0)
    # Once in 256 cycles it is tried again.
    assert with_it <= 3
    assert without > 100
    assert alone > 100


def test_its_positions_come_as_often_as_those_of_the_others(arm: Arm) -> None:
    arm.client.run(1.0)
    wire = arm.machine.wire
    wire[OLD].registers.put("torque_enable", 0)
    state = arm.client.ask(Command.JOINT_STATE, b"\x20").body
    ages = [int.from_bytes(state[8 + 5 * i + 3 : 8 + 5 * i + 5], "little") for i in range(7)]
    assert max(ages) <= 60


def test_one_that_learns_it_is_asked_with_the_others_again(arm: Arm) -> None:
    arm.client.run(1.0)
    arm.knows = True
    arm.client.run(5.0)
    with_it, without, alone = arm.asked(1.0)
    assert with_it > 50
    assert without == 0
    assert alone <= 5


def test_noise_does_not_make_it_forget(arm: Arm) -> None:
    arm.knows = True
    arm.client.run(1.0)
    for _ in range(20):
        # Never more than a few in a row.
        arm.knows = False
        arm.client.run(0.03)
        arm.knows = True
        arm.client.run(0.05)
    with_it, without, _ = arm.asked(1.0)
    assert with_it > 50
    assert without == 0
