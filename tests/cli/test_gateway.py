"""`hexwire gateway` as a process that is suspended and killed, and its arguments."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from click.testing import CliRunner, Result
from tests.gateway.tcp_boards import LONG, TcpBoards, tcp_boards

from hexwire.cli.channel import _listener
from hexwire.cli.main import cli
from hexwire.errors import HexwireError
from hexwire.ipc.session import Session
from hexwire.session.policy import ReconnectPolicy
from hexwire.wire.command_frame import Command

HALF_A_SECOND = b"\xf4\1\0"


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


@pytest.fixture(scope="module")
def boards() -> Iterator[TcpBoards]:
    with tcp_boards(2) as made:
        yield made


@pytest.fixture
def gateway(boards: TcpBoards) -> Iterator[tuple[subprocess.Popen[str], str]]:
    command = [sys.executable, "-m", "hexwire.cli", "gateway", "--listen", "tcp://127.0.0.1:0"]
    command += [f"--board={boards.urls[0]}", f"--board=12={boards.urls[1]}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait(LONG)
        process.stdout.close()
        process.stderr.close()


def connect(url: str) -> Session:
    session = Session.from_url(url)
    session.reconnect = ReconnectPolicy(enabled=False)
    session.open()
    session.negotiate(look=False)
    end = time.monotonic() + LONG
    while session.modules != {8, 12}:
        assert time.monotonic() < end, session.modules
        session.request_all(Command.IDENTIFY, window=0.3, attempts=1)
    assert not session.request_all(Command.RESUME, attempts=20).silent
    return session


@pytest.mark.slow
@pytest.mark.system
def test_a_gateway_that_hangs_or_dies_leaves_the_boards_to_their_watchdogs(
    gateway: tuple[subprocess.Popen[str], str], boards: TcpBoards
) -> None:
    process, url = gateway
    session = connect(url)
    assert not session.request_all(Command.WATCHDOG, HALF_A_SECOND, attempts=20).silent
    os.kill(process.pid, signal.SIGSTOP)
    boards.wait_until_stopped(0, 1)
    assert all(board.state.watchdog_tripped for board in boards.boards)
    # What waits in the suspended program is old when it goes on: it must not end the stop.
    session.send(Command.RESUME)
    time.sleep(0.8)
    os.kill(process.pid, signal.SIGCONT)
    assert not session.request_all(Command.STATS, attempts=20).silent
    assert boards.stopped() == [True, True]
    assert not session.request_all(Command.RESUME, attempts=20).silent
    assert boards.stopped() == [False, False]
    process.kill()
    boards.wait_until_stopped(0, 1)
    session.close()


@pytest.mark.system
def test_it_ends_when_asked_and_stops_what_is_watched(
    gateway: tuple[subprocess.Popen[str], str], boards: TcpBoards
) -> None:
    process, url = gateway
    session = connect(url)
    assert not session.request_all(Command.WATCHDOG, b"\x60\xea\0", attempts=20).silent
    process.terminate()
    assert process.wait(LONG) == 0
    assert boards.stopped() == [True, True]
    with pytest.raises(HexwireError):
        session.request(Command.STATS)
    session.close()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--listen", "udp://127.0.0.1:0", "--board", "tcp://127.0.0.1:1"), "tcp://, tcps:// or mq://"),
        (("--listen", "tcps://127.0.0.1:0", "--board", "tcp://127.0.0.1:1"), "ca=FILE"),
        (("--listen=mq:///a", "--listen=mq:///a", "--board", "tcp://127.0.0.1:1"), "given twice"),
        (("--listen=tcp://:0", "--listen=tcp://:1", "--board", "tcp://127.0.0.1:1"), "has one port"),
        (("--board", "29=tcp://127.0.0.1:1"), "0 to 28"),
        (("--board", "nobody=tcp://127.0.0.1:1"), "no module"),
        (("--board", "9=tcp://127.0.0.1:1", "--board", "9=tcp://127.0.0.1:2"), "already"),
        (("--board", "tcp://127.0.0.1:1", "--board", "tcp://127.0.0.1:1"), "twice"),
        (("--board", "mq:///arm"), "serial or TCP"),
        (("--board=/dev/ttyUSB0?raise=500000",), "a gateway does not raise the rate of a line"),
    ],
)
def test_wrong_arguments(words: tuple[str, ...], why: str) -> None:
    result = run("gateway", *words)
    assert result.exit_code == 2
    assert why in result.stderr


@pytest.mark.parametrize("scheme", ["tcp", "tcps"])
@pytest.mark.parametrize(
    ("address", "bound"),
    [("0.0.0.0:15031", "0.0.0.0:15031"), (":15032", "127.0.0.1:15032"), ("[::1]:15033", "[::1]:15033")],
)
def test_it_listens_where_it_was_told_to(scheme: str, address: str, bound: str) -> None:
    files = "?ca=ca.pem&cert=arm.pem&key=arm.key" if scheme == "tcps" else ""
    assert _listener(f"{scheme}://{address}{files}").url == f"{scheme}-listen://{bound}"


def test_it_needs_a_board() -> None:
    assert run("gateway").exit_code == 2
