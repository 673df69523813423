from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace

import pytest
from tests.frames import frame_bytes

from hexwire.bus.servo_bus import ServoBus
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator import serve as serve_module
from hexwire.emulator import serve_pty
from hexwire.emulator import serve_tcp as serve_tcp_module
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.emulator.serve import ServedDevice
from hexwire.emulator.serve_pty import PtyServer
from hexwire.emulator.serve_tcp import TcpServer, serve_queue
from hexwire.errors import LinkError, LinkLostError
from hexwire.link.open import make_link
from hexwire.wire.command_frame import Command
from hexwire.wire.registers import Series


@contextmanager
def serving(device: ServedDevice, **options: bool) -> Iterator[str]:
    """Serve a device in a thread; yields its address."""
    ended, ready, said = threading.Event(), threading.Event(), list[str]()

    def announce(url: str) -> None:
        said.append(url)
        ready.set()

    def run() -> None:
        TcpServer(device, "127.0.0.1", 0, **options).serve(ended.is_set, announce)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert ready.wait(30.0)
        yield said[0]
    finally:
        ended.set()
        thread.join()


def test_a_driver_over_a_served_board() -> None:
    with serving(make_hex7bot_board(start=time.monotonic())) as url:
        for _ in range(2):
            with Hex7BotDriver.from_url(url) as robot:
                assert robot.read().names


def test_a_bus_of_servos() -> None:
    servos = make_servos([Series.STS_SMS], [1, 2], start=time.monotonic())
    with serving(BusDevice(servos)) as url, ServoBus.from_url(url) as bus:
        first, bus.timing.allowance = bus.timing.allowance, 5.0
        assert bus.ping(2).ok
        bus.timing.allowance = first
        assert not bus.ping(3).ok


def test_one_host_at_a_time_and_a_lost_one_makes_room() -> None:
    with serving(make_hex7bot_board(start=time.monotonic())) as url:
        with make_link(url) as first:
            first.write(b"x")
            with make_link(url) as second, pytest.raises(LinkLostError):
                second.read(time.monotonic() + 30.0)
        deadline = time.monotonic() + 30.0
        while True:
            try:
                with Hex7BotDriver.from_url(url) as robot:
                    assert robot.read().names
                    break
            except LinkError:
                assert time.monotonic() < deadline


def test_bytes_before_its_end_do_not_let_a_host_keep_the_next_one_out() -> None:
    """As after a stall of the emulator, in which one program has ended and another one has begun."""
    server = TcpServer(make_hex7bot_board(start=time.monotonic()), "127.0.0.1", 0)
    url = server.open()
    try:
        with make_link(url) as first:
            while server._guest is None:
                server.run_once()
            first.write(b"x")
        with make_link(url) as second:
            for _ in range(3):
                server.run_once(0.01)
            # Else the end of its line would be read.
            assert second.read(time.monotonic() + 0.1) == b""
    finally:
        server.close()


def test_opening_resets_the_board_if_asked() -> None:
    board = make_hex7bot_board(start=time.monotonic())
    resets: list[float] = []
    board.reset = resets.append  # type: ignore[method-assign]
    with serving(board, reset_on_open=True) as url, make_link(url) as link:
        link.write(b"x")
        deadline = time.monotonic() + 30.0
        while not resets:
            assert time.monotonic() < deadline
            time.sleep(0.005)


def test_a_port_that_is_taken_is_an_error() -> None:
    board = make_hex7bot_board(start=time.monotonic())
    with serving(board) as url:
        taken = TcpServer(board, "127.0.0.1", int(url.rpartition(":")[2]))
        with pytest.raises(LinkError, match="that port is in use"):
            taken.open()
        taken.close()


@pytest.mark.parametrize("baud", [0, 115200])
def test_what_came_while_the_server_stalled_is_read_before_silence_is_judged(
    baud: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pty(board: ServedDevice) -> tuple[PtyServer, ModuleType]:
        return PtyServer(board, baud=baud), serve_pty

    def tcp(board: ServedDevice) -> tuple[TcpServer, ModuleType]:
        return TcpServer(board, "127.0.0.1", 0, baud=baud), serve_tcp_module

    def until(true: Callable[[], bool], server: PtyServer | TcpServer) -> None:
        end = time.monotonic() + 30.0
        while not true():
            assert time.monotonic() < end
            server.run_once(0.01)

    def ask(number: int, body: bytes = b"") -> bytes:
        return frame_bytes(Command.WATCHDOG if body else Command.IDENTIFY, body, seq=number, sn=number)

    for kind in (pty, tcp):
        board = make_hex7bot_board(start=time.monotonic())
        server, module = kind(board)
        stalled = [0.0]
        clock = SimpleNamespace(monotonic=lambda stalled=stalled: time.monotonic() + stalled[0], sleep=time.sleep)
        for each in (module, serve_module):
            monkeypatch.setattr(each, "time", clock)
        url = server.open()
        try:
            with make_link(url if "://" in url else f"serial://{url}") as host:
                host.write(ask(1, (10_000).to_bytes(2, "little") + b"\0"))
                until(lambda board=board: board.state.watchdog_due is not None, server)
                # The server does not run for longer than the watchdog waits; the host asks meanwhile.
                host.write(ask(2))
                stalled[0] += 11.0
                for _ in range(20):
                    server.run_once(0.001)
                assert not board.state.watchdog_tripped, kind.__name__
                stalled[0] += 11.0
                until(lambda board=board: board.state.watchdog_tripped, server)
        finally:
            server.close()


class Heard:
    """A device that only listens."""

    def __init__(self) -> None:
        self.heard = b""

    def receive(self, data: bytes, now: float) -> None:
        self.heard += data

    def step(self, now: float) -> None:
        pass

    def data_to_send(self) -> bytes:
        return b""

    def next_event_time(self) -> float | None:
        return None

    def reset(self, now: float) -> None:
        raise AssertionError("nobody resets it")


@pytest.mark.slow
def test_a_burst_does_not_outlast_its_host() -> None:
    device = Heard()
    server = TcpServer(device, "127.0.0.1", 0, baud=9600)
    url = server.open()
    try:
        with make_link(url) as first:
            server.run_once(1.0)
            first.write(bytes(100_000))
        # The burst would take 104 s on this line; 4096 bytes take 4.3 s, and are not lost because their host left.
        begun = time.monotonic()
        for _ in range(20):
            server.run_once(0.01)
        with make_link(url) as second:
            second.write(b"stop")
            while not device.heard.endswith(b"stop"):
                server.run_once(0.01)
                assert time.monotonic() < begun + 30.0
        assert len(device.heard) >= 4096 + len(b"stop")
    finally:
        server.close()


class StallingClock:
    """The time of a server that does not run for a while, right before it looks at the clock."""

    def __init__(self) -> None:
        self.looks, self.at, self.later = 0, -1, 0.0
        self.meanwhile: Callable[[], object] = lambda: None
        self.sleep = time.sleep

    def monotonic(self) -> float:
        self.looks += 1
        if self.looks == self.at:
            self.meanwhile()
            self.later += 11.0
        return time.monotonic() + self.later


@pytest.mark.parametrize("kind", ["pty", "tcp"])
@pytest.mark.parametrize("baud", [0, 115200])
def test_wherever_a_server_stalls_what_came_meanwhile_ends_the_silence(
    kind: str, baud: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also between the look that found nothing and the judgement, and while it writes."""
    for place in range(1, 12):
        board, clock = make_hex7bot_board(start=time.monotonic()), StallingClock()
        for module in (serve_pty if kind == "pty" else serve_tcp_module, serve_module):
            monkeypatch.setattr(module, "time", clock)
        server = PtyServer(board, baud=baud) if kind == "pty" else TcpServer(board, "127.0.0.1", 0, baud=baud)
        url = server.open()
        try:
            with make_link(url if "://" in url else f"serial://{url}") as host:
                host.write(frame_bytes(Command.WATCHDOG, (10_000).to_bytes(2, "little") + b"\0", seq=1, sn=1))
                end = time.monotonic() + 30.0
                while board.state.watchdog_due is None:
                    assert time.monotonic() < end
                    server.run_once(0.01)
                clock.meanwhile = lambda host=host: host.write(frame_bytes(Command.IDENTIFY, b"", seq=2, sn=2))  # type: ignore[misc]
                clock.at = clock.looks + place
                while clock.later == 0.0:
                    server.run_once(0.001)
                for _ in range(20):
                    server.run_once(0.001)
                assert not board.state.watchdog_tripped, place
        finally:
            server.close()


class Queue:
    """A queue in simulated time, whose server does not run for a while after it has waited for nothing."""

    url = "mq:///board"

    def __init__(self) -> None:
        self.now, self.reads, self.waiting = 100.0, 0, b""

    def monotonic(self) -> float:
        return self.now

    def __enter__(self) -> Queue:
        return self

    def __exit__(self, *_: object) -> None: ...

    def read(self, deadline: float) -> bytes:
        self.reads += 1
        if self.reads == 1:
            return frame_bytes(Command.WATCHDOG, (10_000).to_bytes(2, "little") + b"\0", seq=1, sn=1)
        found, self.waiting = self.waiting, b""
        if not found:
            self.now = max(self.now, deadline)
        if self.reads == 2:
            self.now += 11.0
            self.waiting = frame_bytes(Command.IDENTIFY, b"", seq=2, sn=2)
        return found

    def write(self, data: bytes, deadline: float) -> None: ...


def test_a_server_of_a_queue_that_stalls_reads_what_came_before_it_judges_silence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    queue = Queue()
    monkeypatch.setattr(serve_tcp_module, "time", queue)
    board = make_hex7bot_board(start=queue.now)
    tripped: list[bool] = []

    def stop() -> bool:
        tripped.append(board.state.watchdog_tripped)
        return tripped[-1] or len(tripped) > 100

    serve_queue(board, queue, stop=stop, announce=lambda url: None)  # type: ignore[arg-type]
    # It is fed at the end of the stall, and trips ten seconds later, since nothing more comes.
    assert tripped[-1]
    assert queue.now == pytest.approx(100.0 + 0.25 + 11.0 + 10.0, abs=0.6)
