from __future__ import annotations

import os
import resource
import select
import termios
import time
import tty
from pathlib import Path

import pytest
from tests.emulator.loopback import Loopback
from tests.emulator.terminals import serving
from tests.waits import PATIENCE, eventually

from hexwire.drivers.hex7bot import Hex7BotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.errors import (
    LinkLostError,
    ReplyTimeoutError,
    UsageError,
)
from hexwire.ipc import raised_line
from hexwire.link.open import make_link
from hexwire.link.serial import SerialLink
from hexwire.session.policy import ReconnectPolicy
from hexwire.testing.link import descriptors
from hexwire.wire.command_frame import Command, Frame, serialize_frame

# --- PacedLine -------------------------------------------------------------------------------------------------


def read_some(fd: int, count: int) -> bytes:
    data, end = b"", time.monotonic() + PATIENCE
    while len(data) < count and select.select([fd], [], [], max(0.0, end - time.monotonic()))[0]:
        data += os.read(fd, 4096)
    return data


pytestmark = pytest.mark.system


def test_a_driver_over_a_served_board(tmp_path: Path) -> None:
    link = tmp_path / "port"
    for dialect, baud in ((2, 0), (2, 115200), (1, 115200)):
        board = make_hex7bot_board(dialect=dialect, baud=baud, start=time.monotonic())
        with serving(PtyServer(board, link=link, baud=baud)) as path:
            assert path == str(link)
            with Hex7BotDriver.from_url(path) as driver:
                assert driver.dialect == dialect
                state = driver.read()
                assert state["J1"].position == pytest.approx(-0.078061)
        assert not link.is_symlink()


def test_a_request_reaches_the_device_after_it_was_sent_although_the_server_stalls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Else the clock of an emulated board would be wrong by the length of the stall."""
    device, sent, taken = Loopback(), list[float](), list[float]()
    plain_read, plain_receive = os.read, device.receive

    def stalled(fd: int, count: int) -> bytes:
        # While the server is between its wait and this.
        sent.append(time.monotonic())
        return plain_read(fd, count)

    def receive(data: bytes, now: float) -> None:
        taken.append(now)
        plain_receive(data, now)

    monkeypatch.setattr(device, "receive", receive)
    server = PtyServer(device)
    fd = os.open(server.open(), os.O_RDWR | os.O_NOCTTY)
    monkeypatch.setattr(os, "read", stalled)
    os.write(fd, b"question")
    server.run_once(1.0)
    os.close(fd)
    server.close()
    assert len(sent) == 1
    assert taken[0] >= sent[0]


def test_the_link_of_a_served_terminal_is_not_taken_and_an_old_one_is(tmp_path: Path) -> None:
    link = tmp_path / "port"
    link.symlink_to("/dev/pts/1048576")
    before = descriptors()
    server = PtyServer(Loopback(), link=link)
    server.open()
    assert str(link.readlink()) == server.path
    other = PtyServer(Loopback(), link=link)
    with pytest.raises(UsageError, match="is in use by another emulator"):
        other.open()
    other.close()
    assert str(link.readlink()) == server.path
    server.close()
    assert list(tmp_path.iterdir()) == []
    assert descriptors() <= before


def test_no_descriptor_is_left() -> None:
    before = descriptors()
    for reset in (False, True):
        with PtyServer(Loopback(), reset_on_open=reset) as server:
            server.run_once(0.0)
        server.close()
    assert descriptors() <= before


@pytest.mark.parametrize("reset", [False, True])
def test_every_byte_goes_through_raw(reset: bool) -> None:
    device = Loopback()
    with serving(PtyServer(device, reset_on_open=reset)) as path:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            everything = bytes(range(256)) * 4
            os.write(fd, everything)
            assert read_some(fd, len(everything)) == everything
        finally:
            os.close(fd)


def test_opening_resets_the_board_each_time() -> None:
    device = Loopback()
    server = PtyServer(device, reset_on_open=True)
    with serving(server) as path:
        time.sleep(0.1)
        assert device.resets == 0
        for count in (1, 2, 3):
            fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
            eventually(lambda count=count: device.resets == count)
            os.close(fd)
            # As a board does that gets no power in between: who opens it sooner finds it running.
            eventually(lambda: server._hung_up)
        time.sleep(0.1)
        assert device.resets == 3


@pytest.mark.parametrize("reset", [False, True])
def test_no_busy_loop_while_nobody_has_the_port_open(reset: bool) -> None:
    server = PtyServer(Loopback(), reset_on_open=reset)
    server.open()
    try:
        begun = resource.getrusage(resource.RUSAGE_THREAD)
        turns = 0
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            server.run_once()
            turns += 1
        used = resource.getrusage(resource.RUSAGE_THREAD)
        assert turns < 120
        assert used.ru_utime + used.ru_stime - begun.ru_utime - begun.ru_stime < 0.4
    finally:
        server.close()


def test_another_rate_at_the_hosts_end_garbles_both_directions() -> None:
    device = Loopback()
    with serving(PtyServer(device, baud=115200)) as path:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            tty.setraw(fd)
            settings = termios.tcgetattr(fd)
            settings[4] = settings[5] = termios.B9600
            termios.tcsetattr(fd, termios.TCSANOW, settings)
            os.write(fd, bytes(range(120)))
            eventually(lambda: device.heard)
            assert bytes(range(8)) not in device.heard
            settings[4] = settings[5] = termios.B115200
            termios.tcsetattr(fd, termios.TCSANOW, settings)
            # The last of what was garbled may still be on its way.
            os.write(fd, b"plain text")
            heard = b""
            while not heard.endswith(b"plain text"):
                more = read_some(fd, 1)
                assert more, heard
                heard += more
        finally:
            os.close(fd)


@pytest.mark.parametrize("rate", [250_000, 128_000, 100_000, 76_800])
def test_a_rate_without_a_name_is_another_rate_too(rate: int) -> None:
    device = Loopback()
    with serving(PtyServer(device, baud=115200)) as path, SerialLink(path, rate) as link:
        link.write(bytes(range(120)))
        eventually(lambda: device.heard)
        assert bytes(range(8)) not in device.heard
        link.set_baud(115200)
        link.write(b"plain text")
        heard = b""
        # The last of what was garbled may still be on its way.
        while not heard.endswith(b"plain text"):
            more = link.read(time.monotonic() + 30)
            assert more, heard
            heard += more


@pytest.mark.parametrize("baud", [9600, 115200])
def test_a_program_that_sets_no_rate_is_understood(baud: int) -> None:
    device = Loopback()
    with serving(PtyServer(device, baud=baud)) as path:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(fd, b"plain text")
            assert read_some(fd, 10) == b"plain text"
        finally:
            os.close(fd)


def test_a_wrong_baud_rate_is_named_as_the_cause() -> None:
    board = make_hex7bot_board(baud=115200, start=time.monotonic(), faults=["host.junk:1"])
    with serving(PtyServer(board, baud=115200)) as path:
        driver = Hex7BotDriver.from_url(f"serial://{path}?baud=9600", boot_window=1.5)
        with pytest.raises(ReplyTimeoutError, match="IDENTIFY"):
            driver.attach()


def test_unplugging_is_a_lost_link_and_a_replug_continues(tmp_path: Path) -> None:
    path = tmp_path / "port"
    board = make_hex7bot_board(start=time.monotonic())
    driver = Hex7BotDriver.from_url(str(path))
    driver.session.reconnect = ReconnectPolicy(give_up_after=20, interval=0.05)
    with serving(PtyServer(board, link=path)):
        driver.attach()
        driver.read()
    with serving(PtyServer(board, link=path)):
        driver.read()
        assert driver.session.generation == 1
    driver.session.reconnect = ReconnectPolicy(enabled=False)
    with pytest.raises(LinkLostError):
        driver.read()
    driver.detach()


def test_unread_bytes_do_not_accumulate() -> None:
    board = make_hex7bot_board(start=time.monotonic())
    server = PtyServer(board)
    path = server.open()
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        body = (5).to_bytes(2, "little") + b"\x3f"
        frame = {"proto": 2, "seq": 1, "sn": 1, "src": 7, "dst": 8, "type": 3, "time_sec": 0, "time_nsec": 0}
        os.write(fd, serialize_frame(Frame(cmd=Command.REPORT, body=body, **frame)))
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            server.run_once(0.005)
        assert len(server._unsent) < 1000
    finally:
        os.close(fd)
        server.close()


def test_a_server_announces_and_stops_and_cleans_up(tmp_path: Path) -> None:
    link = tmp_path / "port"
    said: list[str] = []
    turns = iter(range(5))
    PtyServer(Loopback(), link=link).serve(lambda: next(turns, None) is None, said.append)
    assert said == [str(link)]
    assert not link.is_symlink()
    with pytest.raises(ValueError, match="boom"):
        PtyServer(Loopback(), link=link).serve(_boom, said.append)
    assert not link.is_symlink()


def _boom() -> bool:
    raise ValueError("boom")


def test_a_link_made_by_url_opens_it() -> None:
    with serving(PtyServer(Loopback())) as path, make_link(path) as link:
        link.write(b"ping")
        data = b""
        while len(data) < 4:
            data += link.read(time.monotonic() + 30)
        assert data == b"ping"


def test_a_host_raises_the_rate_and_the_next_one_finds_the_old_one(monkeypatch: pytest.MonkeyPatch) -> None:
    # Nearly as late as the board allows: after a second without a frame it is back at its own rate.
    for name, seconds in (("_ANSWER", 5.0), ("_SWITCHED", 0.2), ("_CHECK", 0.8)):
        monkeypatch.setattr(raised_line, name, seconds)
    board = make_hex7bot_board(baud=115200, host_rate=115200, start=time.monotonic())
    with serving(PtyServer(board, baud=115200, rate=lambda: board.host_rate)) as path:

        def raises() -> bool:
            with Hex7BotDriver.from_url(f"{path}?raise=1000000") as robot:
                raised = board.host_rate
                assert len(robot.read().position) == 7
            return raised == 1_000_000

        # A line that stalls while it is checked stays at the old rate, as it should: the machine may do that.
        eventually(raises)
        with Hex7BotDriver.from_url(path) as robot:
            assert board.host_rate == 115200
            assert len(robot.read().position) == 7


def test_an_unpaced_line_has_no_rate() -> None:
    board = make_hex7bot_board(host_rate=115200, start=time.monotonic())
    with (
        serving(PtyServer(board, rate=lambda: board.host_rate)) as path,
        Hex7BotDriver.from_url(f"{path}?raise=1000000") as robot,
    ):
        assert len(robot.read().position) == 7
