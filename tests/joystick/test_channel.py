from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes
from tests.link.far_ends import free_port

from hexwire.errors import ConfigError, LinkError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.joystick.channel import JoystickReceiver, JoystickSender
from hexwire.link.base import Link, LinkKind
from hexwire.link.memory import memory_pair
from hexwire.wire.command_frame import Command
from hexwire.wire.modules import ModuleType
from hexwire.wire.robot_bodies import JoystickState

STATES = [JoystickState((0.0, i / 40), i) for i in range(40)]


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


class Ends(NamedTuple):
    sender: JoystickSender
    receiver: JoystickReceiver
    clock: Clock
    wire: Link


@contextmanager
def joined(kind: LinkKind) -> Iterator[Ends]:
    near, far = memory_pair(kind)
    clock = Clock()
    sender = JoystickSender(Session(IpcHandle.from_link(near, ModuleType.JOY_STICK, ModuleType.ROS1_HOST)))
    receiver = JoystickReceiver(IpcHandle.from_link(far, ModuleType.ROS1_HOST, ModuleType.JOY_STICK), clock)
    with sender, receiver:
        yield Ends(sender, receiver, clock, near)


def introduce(ends: Ends) -> None:
    """Over datagrams the sender asks who is there, and takes the answer at the next state."""
    if ends.wire.kind is LinkKind.DATAGRAM:
        ends.sender.send(STATES[0])
        assert ends.receiver.poll() is None


@pytest.fixture(params=[LinkKind.STREAM, LinkKind.DATAGRAM])
def ends(request: pytest.FixtureRequest) -> Iterator[Ends]:
    with joined(request.param) as both:
        yield both


@pytest.fixture
def stream() -> Iterator[Ends]:
    with joined(LinkKind.STREAM) as both:
        yield both


@pytest.fixture
def datagrams() -> Iterator[Ends]:
    with joined(LinkKind.DATAGRAM) as both:
        yield both


def frame(sn: int, body: bytes, *, cmd: int = Command.JOYSTICK, src: int = 1, proto: int = 2) -> bytes:
    return frame_bytes(cmd, body, proto=proto, seq=sn, src=src, dst=0, type=2)


def test_nothing_yet(ends: Ends) -> None:
    assert ends.receiver.poll() is None
    assert ends.receiver.state is None
    assert math.isinf(ends.receiver.age)


def test_the_newest_state_and_its_age(ends: Ends) -> None:
    introduce(ends)
    for state in STATES:
        ends.sender.send(state)
    assert ends.receiver.poll() == JoystickState.parse(STATES[-1].serialize())
    assert ends.receiver.received == len(STATES)
    ends.clock.now += 0.3
    assert ends.receiver.poll() is None
    assert ends.receiver.age == pytest.approx(0.3)
    # The same again is news too: the channel lives.
    ends.sender.send(STATES[-1])
    assert ends.receiver.poll() is not None
    assert ends.receiver.age == 0.0


def test_more_states_than_sequence_numbers(ends: Ends) -> None:
    introduce(ends)
    for i in range(600):
        ends.sender.send(STATES[i % 2])
        assert ends.receiver.poll() is not None
    assert ends.receiver.ignored == 0


def test_an_older_state_does_not_undo_a_newer_one(stream: Ends) -> None:
    body = [state.serialize() for state in STATES]
    for sn in (1, 3, 2):
        stream.wire.write(frame(sn, body[sn]))
    assert stream.receiver.poll() == JoystickState.parse(body[3])
    assert stream.receiver.ignored == 1
    # A sender that starts again counts from the beginning, and is heard after a second.
    stream.clock.now += 1.1
    stream.wire.write(frame(1, body[5]))
    assert stream.receiver.poll() == JoystickState.parse(body[5])


def test_counting_wraps(stream: Ends) -> None:
    for i, sn in enumerate((0x7FFFFFFF, 0xFFFFFFFE, 0xFFFFFFFF, 0, 1)):
        stream.wire.write(frame(sn, STATES[i].serialize()))
        assert stream.receiver.poll() is not None, hex(sn)


def test_frames_that_are_not_joystick_states_are_ignored(stream: Ends) -> None:
    stream.wire.write(frame(1, STATES[1].serialize(), src=2))
    stream.wire.write(frame(2, b"", cmd=Command.IDENTIFY))
    stream.wire.write(frame(3, b"\xff\0\0\0\0"))
    stream.wire.write(frame(4, STATES[1].serialize(), proto=1))
    damaged = bytearray(frame(5, STATES[1].serialize()))
    damaged[44] ^= 1
    stream.wire.write(bytes(damaged))
    assert stream.receiver.poll() is None
    assert stream.receiver.ignored == 4
    assert math.isinf(stream.receiver.age)
    stream.clock.now += 0.1
    stream.sender.send(STATES[2])
    assert stream.receiver.poll() is not None


def test_a_datagram_that_was_cut_off_does_not_hold_up_the_next(datagrams: Ends) -> None:
    introduce(datagrams)
    datagrams.wire.write(frame(9, bytes(200))[:100])
    datagrams.sender.send(STATES[1])
    assert datagrams.receiver.poll() == JoystickState.parse(STATES[1].serialize())


def test_recorded_states_move_nothing_later(datagrams: Ends) -> None:
    recorded: list[bytes] = []
    write = datagrams.wire.write

    def record(data: bytes, deadline: float | None = None) -> None:
        recorded.append(data)
        write(data, deadline)

    datagrams.wire.write = record  # type: ignore[method-assign]  # somebody listens
    introduce(datagrams)
    for state in STATES:
        datagrams.sender.send(state)
        assert datagrams.receiver.poll() is not None
    received, heard = datagrams.receiver.received, datagrams.receiver.age
    for pause in (0.0, 2.0, 120.0):
        datagrams.clock.now += pause
        heard += pause
        for data in recorded:
            write(data)
            assert datagrams.receiver.poll() is None
    assert datagrams.receiver.received == received
    assert datagrams.receiver.age == pytest.approx(heard), "the channel is silent all the same"
    # A receiver that is started later takes none of it either.
    datagrams.receiver.close()
    datagrams.receiver.open()
    datagrams.sender.session.close()
    datagrams.sender.session.open()
    for data in recorded:
        write(data)
        assert datagrams.receiver.poll() is None
    assert datagrams.receiver.received == received


def test_a_receiver_that_is_started_anew_is_found_again(datagrams: Ends) -> None:
    introduce(datagrams)
    datagrams.sender.send(STATES[1])
    assert datagrams.receiver.poll() is not None
    # As if started anew: it knows nothing of the conversation.
    datagrams.receiver._connection = datagrams.receiver._make_connection()
    datagrams.sender.send(STATES[2])
    assert datagrams.receiver.poll() is None
    datagrams.sender.session._introduction._asked -= 0.5
    datagrams.sender.send(STATES[2])
    assert datagrams.receiver.poll() is None
    datagrams.sender.send(STATES[3])
    assert datagrams.receiver.poll() == JoystickState.parse(STATES[3].serialize())


@given(st.lists(st.binary(max_size=200), max_size=10))
def test_any_bytes_are_no_state(pieces: list[bytes]) -> None:
    near, far = memory_pair()
    clock = Clock()
    receiver = JoystickReceiver(IpcHandle.from_link(far, ModuleType.ROS1_HOST, ModuleType.JOY_STICK), clock)
    with near, receiver:
        for piece in pieces:
            near.write(piece)
            assert receiver.poll() is None
            clock.now += 0.02
        clock.now += 0.1
        receiver.poll()
        near.write(frame(1, STATES[3].serialize()))
        receiver.poll()
        clock.now += 0.1
        receiver.poll()
        near.write(frame(2, STATES[3].serialize()))
        receiver.poll()
        assert receiver.state is not None


@pytest.mark.system
def test_a_sender_that_goes_and_comes_back() -> None:
    port = free_port()
    with JoystickReceiver.from_url(f"tcp-listen://127.0.0.1:{port}") as receiver:
        for _ in range(3):
            with JoystickSender.from_url(f"tcp://127.0.0.1:{port}") as sender:
                sender.send(STATES[1])
                assert _wait(receiver) is not None
            sender.session.close()


def _wait(receiver: JoystickReceiver) -> JoystickState | None:
    end = time.monotonic() + 30
    while time.monotonic() < end:
        if (state := receiver.poll(time.monotonic() + 0.1)) is not None:
            return state
    return None


@pytest.mark.system
def test_over_the_channels_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    port = free_port()
    file.write_text(
        f"JOY_STICK CLIENT_TX ROS1_HOST UDP 127.0.0.1 {port}\nROS1_HOST SERVER_RX JOY_STICK UDP 127.0.0.1 {port}\n"
    )
    with JoystickReceiver.from_conf(file) as receiver, JoystickSender.from_conf(file) as sender:
        assert _send_until_taken(sender, receiver) == JoystickState.parse(STATES[7].serialize())


def _send_until_taken(sender: JoystickSender, receiver: JoystickReceiver) -> JoystickState | None:
    end = time.monotonic() + 30
    while time.monotonic() < end:
        sender.send(STATES[7])
        if (state := receiver.poll(time.monotonic() + 0.02)) is not None:
            return state
    return None


def test_a_receiver_that_cannot_open_says_so() -> None:
    with pytest.raises(LinkError), JoystickReceiver.from_url("serial:///dev/none"):
        pass


def test_the_direction_of_a_record_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "ipc_msg.conf"
    port = free_port()
    file.write_text(
        f"ROS1_HOST SERVER_TX JOY_STICK UDP 127.0.0.1 {port}\nJOY_STICK CLIENT_RX ROS1_HOST UDP 127.0.0.1 {port}\n"
    )
    with pytest.raises(ConfigError, match="ROS1_HOST is SERVER_TX, which only sends"):
        JoystickReceiver.from_conf(file).open()
    with (
        JoystickSender.from_conf(file) as sender,
        pytest.raises(ConfigError, match="JOY_STICK is CLIENT_RX, which only receives"),
    ):
        sender.send(STATES[0])
