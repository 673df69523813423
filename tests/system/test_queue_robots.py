"""Robots behind a POSIX queue: every command that works over another line works over this one."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from click.testing import CliRunner
from tests.cli.shared_arm import patient
from tests.defaults import patient_line
from tests.gateway.tcp_boards import tcp_boards

from hexwire.cli.main import cli

pytestmark = pytest.mark.system

HEXWIRE = (sys.executable, "-m", "hexwire.cli")


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is taken neither for a program that has died nor for a board that is silent."""
    patient(monkeypatch)
    patient_line(monkeypatch, 5.0)


@contextmanager
def serving(*words: str) -> Iterator[list[str]]:
    """A server in a process of its own; yields what it offers, the queue last."""
    program = subprocess.Popen([*HEXWIRE, *words], stdout=subprocess.PIPE, text=True)
    try:
        assert program.stdout is not None
        urls = [program.stdout.readline().strip()]
        while not urls[-1].startswith("mq:"):
            assert urls[-1], "it has ended"
            urls.append(program.stdout.readline().strip())
        yield urls
    finally:
        program.terminate()
        program.communicate()


def run(*words: str) -> str:
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, f"{words}: {done.output}"
    return done.stdout


def name(of: str) -> str:
    return f"hexwire-{of}-{os.getpid()}"


def test_a_board_behind_a_queue() -> None:
    with serving("sim", "board", "--queue", name("board")) as (url,):
        assert url == f"mq:///{name('board')}"
        run("torque", "on", "--port", url)
        assert "arrived" in run("move", "J1=10", "--wait", "--port", url)
        # A path in fragments.
        assert "arrived" in run("goto", "0", "220", "200", "--port", url)
        assert "stopped" in run("stop", "--port", url)
        run("resume", "--port", url)


@pytest.mark.slow
def test_a_puma_behind_a_queue_and_tcp_at_once() -> None:
    robot = ("--robot", "puma260")
    with serving("sim", "puma260", "--tcp", "127.0.0.1:0", "--queue", name("puma")) as (tcp, url):
        run(*robot, "torque", "on", "--port", url)
        assert "arrived" in run(*robot, "move", "J1=10", "--wait", "--port", url)
        assert abs(float(run(*robot, "state", "--port", tcp).split("J1")[1].split()[0]) - 10.0) < 0.1
        assert "stopped" in run(*robot, "stop", "--port", url)


KILLED = """
import sys, time
from hexwire.ipc.session import Session
from hexwire.wire.command_frame import Command
session = Session.from_url(sys.argv[1])
session.open()
session.negotiate(look=False)
session.request(Command.WATCHDOG, bytes((0x60, 0xEA, 0)))
print("ready", flush=True)
time.sleep(600)
"""


@pytest.mark.slow
def test_a_host_of_a_gateway_that_is_killed_stops_its_board() -> None:
    with tcp_boards(2) as boards:
        urls = [f"--board={url}" for url in boards.urls]
        with serving("gateway", "--listen", f"mq:///{name('gateway')}", *urls) as (url,):
            run("torque", "on", "--port", f"{url}?to=9")
            assert "arrived" in run("move", "J1=10", "--wait", "--port", f"{url}?to=9")
            assert "stopped" in run("stop", "--port", f"{url}?to=8")
            assert boards.stopped() == [True, False]
            with subprocess.Popen(
                [sys.executable, "-c", KILLED, f"{url}?to=9"], stdout=subprocess.PIPE, text=True
            ) as host:
                assert host.stdout is not None
                assert host.stdout.readline() == "ready\n"
                # Another board is another program's at the same time; this one is told who has it.
                run("resume", "--port", f"{url}?to=8")
                assert "arrived" in run("move", "J1=5", "--wait", "--port", f"{url}?to=8")
                done = CliRunner().invoke(cli, ["state", "--port", f"{url}?to=9"])
                assert done.exit_code != 0
                assert f"module 9 has another host, {url}, " in done.stderr
                assert f"(pid {host.pid})" in done.stderr
                host.kill()
            boards.wait_until_stopped(1)
            run("resume", "--port", f"{url}?to=9")
            assert boards.stopped() == [False, False]


def test_a_queue_excludes_what_a_port_has() -> None:
    for more in (["--tcp", ":0"], ["--link", "x"], ["--reset-on-open"], ["--dialect", "1"]):
        done = CliRunner().invoke(cli, ["sim", "board", "--queue", "x", *more])
        assert done.exit_code == 2, (more, done.output)
        assert done.stderr.startswith("error: --queue")
