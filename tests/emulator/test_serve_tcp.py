from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from hexwire.bus.servo_bus import ServoBus
from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_device import BusDevice, make_servos
from hexwire.emulator.serve import ServedDevice
from hexwire.emulator.serve_tcp import TcpServer, serve_tcp
from hexwire.errors import LinkError, LinkLostError
from hexwire.link.open import make_link
from hexwire.wire.registers import Series


@contextmanager
def serving(device: ServedDevice, **options: bool) -> Iterator[str]:
    """Serve a device in a thread; yields its address."""
    ended, ready, said = threading.Event(), threading.Event(), list[str]()

    def announce(url: str) -> None:
        said.append(url)
        ready.set()

    def run() -> None:
        serve_tcp(device, "127.0.0.1", 0, stop=ended.is_set, announce=announce, **options)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert ready.wait(10.0)
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
                second.read(time.monotonic() + 10.0)
        deadline = time.monotonic() + 10.0
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
        deadline = time.monotonic() + 10.0
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
