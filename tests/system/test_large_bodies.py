"""Bodies of a megabyte through the fragment layer, over each kind of link."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from tests.link.far_ends import PtyEnd, free_port
from tests.system.mirror import Mirror
from tests.waits import eventually

from hexwire.errors import DeviceError
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session
from hexwire.link.base import Link, LinkKind
from hexwire.link.impair import ImpairedLink, Impairment
from hexwire.link.memory import memory_pair
from hexwire.link.open import make_link
from hexwire.wire.modules import ModuleType

pytestmark = pytest.mark.system

ECHO = 0x7A
MEGABYTE = random.Random(3).randbytes(1 << 20)


@contextmanager
def mirrored(near: Link, far: Link) -> Iterator[tuple[Session, Mirror]]:
    handle = IpcHandle.from_link(near, ModuleType.ARM_7BOT_SERIAL_TRX, ModuleType.ARM_7BOT_ARDUINO_TRX)
    with ExitStack() as stack:
        if not far.is_open:
            stack.enter_context(far)
        else:
            stack.callback(far.close)
        session = stack.enter_context(Session(handle))
        # A serial line, and what counts as one, has frames of 253 bytes: a megabyte is over 5,000 of them.
        mirror = Mirror(far, session.connection.max_frame)
        thread = threading.Thread(target=mirror.run)
        thread.start()
        try:
            yield session, mirror
        finally:
            mirror.stop()
            thread.join(30)
            assert not thread.is_alive()


def serial_pair(tmp_path: Path) -> tuple[Link, Link]:
    far = PtyEnd(tmp_path / "tty")
    far.open()
    return make_link(f"serial://{tmp_path}/tty?baud=1000000"), far


def tcp_pair(tmp_path: Path) -> tuple[Link, Link]:
    far = make_link("tcp-listen://127.0.0.1:0")
    far.open()
    return make_link(far.url.replace("-listen", "")), far


def udp_pair(tmp_path: Path) -> tuple[Link, Link]:
    a, b = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    return make_link(f"udp://127.0.0.1:{a}?bind=127.0.0.1:{b}"), make_link(
        f"udp://127.0.0.1:{b}?bind=127.0.0.1:{a}"
    )


def queue_pair(tmp_path: Path) -> tuple[Link, Link]:
    name = f"hexwire-test-{tmp_path.name}-{time.monotonic_ns()}"
    return make_link(f"mq:///{name}"), make_link(f"mq:///{name}?role=server&unlink=1")


def memory_stream(tmp_path: Path) -> tuple[Link, Link]:
    return memory_pair()


def memory_datagrams(tmp_path: Path) -> tuple[Link, Link]:
    return memory_pair(LinkKind.DATAGRAM)


PAIRS = [serial_pair, tcp_pair, udp_pair, queue_pair, memory_stream, memory_datagrams]


@pytest.mark.parametrize("make", PAIRS)
def test_a_megabyte_there_and_back(make: Callable[[Path], tuple[Link, Link]], tmp_path: Path) -> None:
    with mirrored(*make(tmp_path)) as (session, mirror):
        reply = session.request(ECHO, MEGABYTE, window=5.0)
        assert reply.body == MEGABYTE
        assert mirror.got == [MEGABYTE]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_megabyte_over_udp_that_loses_doubles_and_reorders(tmp_path: Path, seed: int) -> None:
    near, far = udp_pair(tmp_path)
    bad = Impairment(drop=0.05, duplicate=0.05, reorder=0.05, flip=0.01, delay=0.02)
    link = ImpairedLink(near, sending=bad, receiving=bad, seed=seed)
    with mirrored(link, far) as (session, mirror):
        for _ in range(2):
            assert session.request(ECHO, MEGABYTE, window=5.0).body == MEGABYTE
        assert mirror.got == [MEGABYTE] * 2
        for lane in (link.sent.counters, link.received.counters):
            assert min(lane.dropped, lane.duplicated, lane.reordered) > 0


@pytest.mark.slow
def test_it_gives_up_in_bounded_time_and_memory(tmp_path: Path) -> None:
    near, far = udp_pair(tmp_path)
    # What goes to the board gets there; of what comes back, nothing does.
    link = ImpairedLink(near, receiving=Impairment(drop=1.0))
    with mirrored(link, far) as (session, mirror):
        for _ in range(6):
            with pytest.raises(DeviceError):
                session.request(ECHO, MEGABYTE, window=0.05)
            # A board puts at most four messages together at once, and forgets those whose host fell silent.
            assert len(mirror.end._fragments_in._in) <= 4
        eventually(lambda: mirror.end._fragments_in._in == {})
        assert session.connection._fragments_out._out == {}
        assert mirror.got == []


def test_more_than_a_receiver_takes_is_refused_at_once(tmp_path: Path) -> None:
    near, far = memory_pair()
    with mirrored(near, far) as (session, _):
        with pytest.raises(Exception, match="too long for fragments; at most 1048576"):
            session.request(ECHO, bytes((1 << 20) + 1))
        assert session.request(ECHO, b"still there").body == b"still there"
