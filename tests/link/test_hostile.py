"""A server on a listener, and callers who mean no good: nobody gets in, nothing grows, others are served."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.frames import frame_bytes
from tests.soak import rounds

from hexwire.errors import LinkClosedError, LinkError
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.link.listener import Listener
from hexwire.link.tcp import PeerLink, TcpLink
from hexwire.link.tls import TlsFiles
from hexwire.session.decoder import FrameDecoder
from hexwire.testing.link import PATIENCE, Background, descriptors, in_a_moment, read_bytes, soon
from hexwire.wire import tables
from hexwire.wire.command_frame import Frame


def frame(number: int) -> bytes:
    return frame_bytes(1, bytes(8), seq=number, src=0, dst=3, type=1)


class EchoServer:
    """Answers every good frame with itself, for at most `places` callers at once, each in a thread of its own."""

    def __init__(self, listener: Listener, places: int = 8) -> None:
        self.listener = listener
        self.decoders: list[FrameDecoder] = []
        self.let_in = 0
        self.most_held = 0
        self._places = threading.BoundedSemaphore(places)
        self._threads: set[threading.Thread] = set()
        self._door = threading.Thread(target=self._keep_door)

    def __enter__(self) -> EchoServer:
        self.listener.open()
        self._door.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.listener.close()
        self._door.join(PATIENCE)
        for thread in list(self._threads):
            thread.join(PATIENCE)

    def _keep_door(self) -> None:
        while True:
            try:
                peer = self.listener.accept(None)
            except LinkClosedError:
                return
            if peer is None:
                continue
            self.let_in += 1
            if not self._places.acquire(blocking=False):
                peer.close()
                continue
            thread = threading.Thread(target=self._serve, args=(peer,))
            self._threads.add(thread)
            thread.start()

    def _serve(self, peer: PeerLink) -> None:
        decoder = FrameDecoder(tables.MAX_NETWORK_FRAME)
        self.decoders = [*self.decoders[-9:], decoder]
        try:
            with peer_closing(peer):
                while True:
                    now = time.monotonic()
                    timeout = decoder.next_timeout()
                    data = peer.read(now + 1.0 if timeout is None else timeout)
                    now = time.monotonic()
                    decoder.receive(data, now)
                    self.most_held = max(self.most_held, len(decoder._data))
                    while event := decoder.next_event() or decoder.handle_timeout(now):
                        if isinstance(event, Frame):
                            peer.write(frame(event.sn), now + 1.0)
                    if self.listener._closing:
                        return
        except LinkError:
            pass
        finally:
            self._places.release()
            self._threads.discard(threading.current_thread())


class peer_closing:  # noqa: N801 (a context manager named like those of contextlib)
    def __init__(self, peer: PeerLink) -> None:
        self._peer = peer

    def __enter__(self) -> PeerLink:
        return self._peer

    def __exit__(self, *_: object) -> None:
        self._peer.close()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    make_authority(folder)
    issue_certificate(folder, "server", "server")
    issue_certificate(folder, "client", "client")
    return folder


def files(lab: Path, who: str) -> TlsFiles:
    return TlsFiles(str(lab / "ca.pem"), str(lab / f"{who}.pem"), str(lab / f"{who}.key"))


@pytest.fixture
def plain() -> Iterator[EchoServer]:
    with EchoServer(Listener()) as server:
        yield server


def is_served(server: EchoServer, number: int, tls: TlsFiles | None = None) -> None:
    request = frame(number)
    with TcpLink("127.0.0.1", server.listener.port, timeout=PATIENCE, tls=tls) as link:
        link.write(request, soon())
        assert read_bytes(link, len(request)) == request


def call(server: EchoServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.listener.port), PATIENCE)


@pytest.mark.soak
@pytest.mark.slow
def test_thousands_of_callers_one_after_another(plain: EchoServer) -> None:
    reset = struct.pack("ii", 1, 0)
    half = frame(1)[:20]

    def visit(number: int) -> None:
        # Not faster than they are let in, or the kernel makes callers wait a second each.
        while number - plain.let_in - plain.listener.refused > 64:
            time.sleep(0.001)
        with call(plain) as caller:
            if number % 3 == 1:
                caller.sendall(half)
            elif number % 3 == 2:
                caller.sendall(b"\xff" * 100)
            if number % 2:
                caller.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)

    def settled() -> frozenset[tuple[str, str]]:
        deadline = soon()
        while (plain._threads or plain.let_in + plain.listener.refused < visits) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not plain._threads
        return descriptors()

    visits = 0
    for _ in range(1000):
        visit(visits)
        visits += 1
    before, threads = settled(), set(threading.enumerate())
    tracemalloc.start()
    grown = tracemalloc.get_traced_memory()[0]
    more = rounds(2_000, 9_000)
    for _ in range(more):
        visit(visits)
        visits += 1
    assert settled() <= before
    grown = tracemalloc.get_traced_memory()[0] - grown
    tracemalloc.stop()
    assert threads.issuperset(threading.enumerate())
    assert grown < 110 * more, "memory grows with the callers"
    assert plain.let_in + plain.listener.refused == visits
    is_served(plain, 7)


def test_a_frame_of_four_gigabytes_is_announced(plain: EchoServer) -> None:
    huge = bytearray(frame(1))
    struct.pack_into("<I", huge, 28, 0xFFFFFFFF)
    with call(plain) as caller:
        caller.sendall(huge)
        for _ in range(64):
            caller.sendall(bytes(65536))
        is_served(plain, 2)
        # And the same caller may still come to reason.
        caller.sendall(frame(3))
        answer = b""
        while len(answer) < len(frame(3)):
            piece = caller.recv(1000)
            assert piece
            answer += piece
        assert answer == frame(3)
    assert plain.most_held <= 131072


def test_the_longest_frame_that_is_believed_and_never_ends(plain: EchoServer) -> None:
    long = bytearray(frame(1))
    struct.pack_into("<I", long, 28, tables.MAX_NETWORK_FRAME)
    with call(plain) as caller:
        for _ in range(200):
            caller.sendall(long)
        is_served(plain, 2)
    assert plain.most_held <= 131072


def test_a_slow_drip_holds_nobody_up(plain: EchoServer) -> None:
    request = frame(9)
    with call(plain) as slow:
        for number, byte in enumerate(request):
            slow.sendall(bytes([byte]))
            if number % 10 == 0:
                is_served(plain, number)
        # A frame whose bytes come too slowly, as from a machine that stalls, is dropped; the next one is not.
        slow.sendall(request)
        slow.settimeout(PATIENCE)
        answers = b""
        while len(answers) < len(request):
            answers += slow.recv(1000)
    assert (2 * request).startswith(answers)


def test_a_full_house_turns_away_and_recovers() -> None:
    with EchoServer(Listener(), places=2) as server:
        idle = [call(server), call(server)]
        deadline = soon()
        while server.let_in < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        with call(server) as third:
            assert third.recv(1) == b"", "hung up on, not left waiting"
        for caller in idle:
            caller.close()
        while server._threads and time.monotonic() < deadline:
            time.sleep(0.01)
        is_served(server, 1)


def test_silent_and_dripping_callers_of_a_tls_port(lab: Path) -> None:
    before = descriptors()
    listener = Listener(tls=files(lab, "server"), max_handshakes=4)
    with EchoServer(listener) as server:
        silent = [call(server) for _ in range(20)]
        # The start of a TLS greeting that announces a long record, a byte at a time.
        greeting = b"\x16\x03\x01\x3f\xff\x01\x00\x3f\xfb\x03\x03" + bytes(200)
        with call(server) as drip:
            for number, byte in enumerate(greeting[:60]):
                drip.sendall(bytes([byte]))
                if number % 10 == 0:
                    is_served(server, number, files(lab, "client"))
                    assert len(listener._handshakes) <= 4
        # Only from here on, or good clients of a slow machine would be too slow as well.
        patience, listener._handshake_timeout = listener._handshake_timeout, 0.3
        with call(server) as drip:

            def drip_on() -> None:
                for byte in greeting:
                    drip.sendall(bytes([byte]))
                    time.sleep(0.05)

            with pytest.raises(ConnectionError):  # dropped in time, however lively it is
                drip_on()
        listener._handshake_timeout = patience
        assert server.let_in == 6, "none but the six good ones"
        assert listener.refused >= 17
        for caller in silent:
            caller.close()
        is_served(server, 1, files(lab, "client"))
    assert descriptors() <= before


def test_many_callers_without_a_certificate(lab: Path) -> None:
    listener = Listener(tls=files(lab, "server"))
    with EchoServer(listener) as server:
        is_served(server, 0, files(lab, "client"))
        before, visits = descriptors(), 300
        for number in range(visits):
            with call(server) as caller:
                caller.sendall((b"GET / HTTP/1.1\r\n\r\n", frame(number), b"\x16\x03\x01\x00\x05hello")[number % 3])
        deadline = soon()
        while listener.refused < visits and time.monotonic() < deadline:
            time.sleep(0.01)
        assert listener.refused == visits
        assert server.let_in == 1
        while server._threads and time.monotonic() < deadline:
            time.sleep(0.01)
        assert descriptors() <= before
        is_served(server, 1, files(lab, "client"))


def test_a_client_is_not_hurt_by_a_server_that_floods_or_stalls() -> None:
    with Listener() as listener, TcpLink("127.0.0.1", listener.port) as link:
        peer = listener.accept(soon())
        assert peer is not None

        def flood() -> None:
            try:
                while True:
                    peer.write(b"\xff" * 65536, None)
            except LinkError:
                pass

        flooder = Background(flood)
        flooder.let_it_block()
        decoder = FrameDecoder()
        for _ in range(50):
            decoder.receive(link.read(soon()), 0.0)
            while decoder.next_event():
                pass
            assert len(decoder._data) <= 131072
        assert link.flush_input() > 0
        peer.close()
        flooder.outcome()
        assert link.is_open or link.read(in_a_moment()) == b""


def test_a_host_that_connects_endlessly_ends_no_others_handshake(lab: Path) -> None:
    listener = Listener(tls=files(lab, "server"), max_handshakes=4)
    with listener, socket.socket() as slow:
        slow.bind(("127.0.0.2", 0))
        slow.connect(("127.0.0.1", listener.port))
        flood = []
        try:
            for _ in range(40):
                flood.append(socket.create_connection(("127.0.0.1", listener.port)))
                while select.select([listener.fileno()], [], [], 0.0)[0]:
                    assert listener.accept(0.0) is None
            assert len(listener._handshakes) == 4
            assert sum(shake.peer.startswith("127.0.0.2:") for shake in listener._handshakes.values()) == 1
        finally:
            for caller in flood:
                caller.close()
