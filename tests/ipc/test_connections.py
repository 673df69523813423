from __future__ import annotations

import pytest

from hexwire.ipc.connections import Introduction, host_connection, random_number
from hexwire.ipc.handle import IpcHandle
from hexwire.session.policy import RetryPolicy
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, parse_frame
from hexwire.wire.modules import ModuleType


@pytest.mark.parametrize(
    ("url", "longest", "datagrams"),
    [
        ("serial:///dev/ttyUSB0", tables.MAX_SERIAL_FRAME, False),
        ("tcp://127.0.0.1:5", tables.MAX_NETWORK_FRAME, False),
        ("udp://127.0.0.1:5", tables.MAX_NETWORK_FRAME, True),
        ("mq:///arm", tables.MAX_NETWORK_FRAME, True),
    ],
)
def test_as_the_link_needs_it(url: str, longest: int, datagrams: bool) -> None:
    ipc = IpcHandle.from_url(url, ModuleType.JOY_STICK, ModuleType.ROS1_HOST)
    made = host_connection(ipc, None, None, None, policy=RetryPolicy(), epoch=5.0)
    assert (made.local, made.remote, made.type, made.epoch) == (1, 0, ipc.type, 5.0)
    assert made.max_frame == longest
    assert (made.conversations is not None) == datagrams
    other = host_connection(ipc, 7, 8, 3, policy=RetryPolicy(), epoch=0.0)
    assert (other.local, other.remote, other.type) == (7, 8, 3)


def test_random_numbers_fit_and_differ() -> None:
    numbers = [random_number() for _ in range(100)]
    assert all(0 <= number < 1 << 31 for number in numbers)
    assert len(set(numbers)) > 90


def test_identify_is_repeated_eight_times_per_second() -> None:
    ipc = IpcHandle.from_url("udp://127.0.0.1:5")
    made, asking, asked = host_connection(ipc, None, None, None, policy=RetryPolicy(), epoch=0.0), Introduction(), 0
    for tick in range(11):
        asking.ask(made, tick * 0.0625)
        frames = [parse_frame(data) for data in made.data_to_send()]
        assert all(frame.cmd == Command.IDENTIFY for frame in frames)
        asked += len(frames)
    assert asked == 6


def test_an_identify_is_not_repeated_by_itself() -> None:
    ipc = IpcHandle.from_url("udp://127.0.0.1:5")
    made, asking = host_connection(ipc, None, None, None, policy=RetryPolicy(), epoch=0.0), Introduction()
    asking.ask(made, 0.0)
    assert len(made.data_to_send()) == 1
    made.handle_timeout(60.0)
    assert made.data_to_send() == []
