from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from hexwire.control.loop.shutdown import Shutdown

PATIENCE = 60.0


@pytest.fixture
def shutdown() -> Iterator[Shutdown]:
    """One that may be requested in this process."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    # As `nohup make test` leaves it; a program that is started like that does not end by it.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield Shutdown(600.0)
    faulthandler.cancel_dump_traceback_later()
    signal.alarm(0)
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


def child(code: str, status: int) -> str:
    """Run a program with a `Shutdown` to its end; returns what it wrote."""
    head = "import os, random, signal, threading, time\nfrom hexwire.control.loop.shutdown import Shutdown\n"
    done = subprocess.run([sys.executable, "-c", head + code], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == status, done.stderr
    return done.stdout + done.stderr


def test_nobody_requests_it(shutdown: Shutdown) -> None:
    assert not shutdown.wait(0.01)
    assert not shutdown.requested


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_wait(shutdown: Shutdown, number: signal.Signals) -> None:
    shutdown.listen()
    timer = threading.Timer(0.05, os.kill, (os.getpid(), number))
    timer.start()
    assert shutdown.wait(PATIENCE)
    timer.join()
    os.kill(os.getpid(), number)
    assert shutdown.wait(PATIENCE), "and once more changes nothing"


def test_another_thread_ends_the_waits_of_all(shutdown: Shutdown) -> None:
    waits = [threading.Thread(target=shutdown.wait, args=(PATIENCE,)) for _ in range(3)]
    for thread in waits:
        thread.start()
    timer = threading.Timer(0.05, shutdown.request)
    timer.start()
    assert shutdown.wait(PATIENCE)
    for thread in (*waits, timer):
        thread.join(PATIENCE)
        assert not thread.is_alive()


def test_interruptible_work_is_interrupted(shutdown: Shutdown) -> None:
    shutdown.listen()
    shutdown.interrupts = True
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGTERM)
    assert shutdown.wait(0.0)


def test_a_program_started_by_nohup_continues(shutdown: Shutdown) -> None:
    for number in (signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    shutdown.listen()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not shutdown.wait(0.01)
    os.kill(os.getpid(), signal.SIGINT)
    assert shutdown.wait(0.01), "roslaunch ends its nodes by it"


def test_a_signal_at_any_moment_of_the_wait_ends_it() -> None:
    code = """
random.seed(1)
for _ in range(2000):
    shutdown = Shutdown(600.0)
    signal.signal(signal.SIGALRM, lambda *_: shutdown.request())
    signal.setitimer(signal.ITIMER_REAL, random.uniform(0.00002, 0.0006))
    while not shutdown.wait(0.0001):
        pass
"""
    assert child(code, 0) == ""


def test_a_hung_program_is_ended_and_says_where() -> None:
    code = """
def hangs():
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()

shutdown = Shutdown(1.0)
shutdown.listen()
os.kill(os.getpid(), signal.SIGTERM)
hangs()
"""
    assert "in hangs" in child(code, 1)


@pytest.mark.slow
@pytest.mark.parametrize("trouble", ["sys.stderr = None; os.close(2)", "os.dup2(full(), 2)"])
def test_a_hung_program_is_ended_even_if_it_cannot_say_where(trouble: str) -> None:
    code = f"""
import sys

def full():
    read, write = os.pipe()
    os.set_blocking(write, False)
    try:
        while True:
            os.write(write, bytes(4096))
    except BlockingIOError:
        os.set_blocking(write, True)
    return write

{trouble}
shutdown = Shutdown(1.0)
shutdown.request()
assert shutdown.wait(0.0)
lock = threading.Lock()
lock.acquire()
lock.acquire()
"""
    assert child(code, -signal.SIGALRM) == ""
