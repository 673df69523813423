"""An open session: questions, programs that take nothing, and the end of a program."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path

import pytest
from tests.waits import PATIENCE, eventually

from hexwire.errors import LinkClosedError
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network
from hexwire.fleet.node import NoAnswerError, Question

# -- questions --------------------------------------------------------------------------------------------


def test_a_question_at_a_pattern_is_answered_for_the_own_key(runtime: Path) -> None:
    where = endpoints_of([local_socket("a")])
    server = Network(listen=where).open(wait=False)
    client = Network(connect=where).open()
    try:
        asked: list[bytes] = []
        server.answer("hexwire/a/ask", lambda question: (asked.append(question.payload), question.reply(b"yes")))
        assert client.ask("hexwire/*/ask", b"?", 5.0) == b"yes"
        assert asked == [b"?"]
        with pytest.raises(NoAnswerError) as absent:
            client.ask("hexwire/a/other", b"", 5.0)
        assert absent.value.absent
        held: list[Question] = []
        server.answer("hexwire/a/silent", held.append)
        with pytest.raises(NoAnswerError) as silent:
            client.ask("hexwire/a/silent", b"", 1.0)
        assert not silent.value.absent
        (question,) = held
        question.reply(b"")
        client.ask_neighbours(5.0)
        assert client.is_offered("hexwire/a/silent", 5.0)
        assert not client.is_offered("hexwire/a/other", 0.2)
    finally:
        client.close()
        server.close()
    assert not client.is_offered("hexwire/a/silent", 5.0)


# -- what is published --------------------------------------------------------------------------------------


def test_an_inbox_gives_what_is_published_to_the_thread_that_waits(runtime: Path) -> None:
    where = endpoints_of([local_socket("a")])
    server = Network(listen=where).open(wait=False)
    client = Network(connect=where).open()
    try:
        inbox, own = client.inbox("hexwire/a/state"), server.inbox("hexwire/a/state")
        put, ended = server.publisher("hexwire/a/state"), threading.Event()

        def publish() -> None:
            # Until the subscription has arrived, nothing does.
            while not ended.wait(0.05):
                put(b"state")

        thread = threading.Thread(target=publish)
        thread.start()
        assert inbox.wait() == b"state"
        ended.set()
        thread.join()
        # Behind all others, however late they arrive.
        put(b"last")
        for each in (own, inbox):
            while each.wait() != b"last":
                pass
        inbox.wake()
        assert inbox.wait() == b""
        assert own.poll() is None, "nobody else is woken"
        for number in range(200):
            put(b"%d" % number)
        while (first := inbox.poll()) is None:
            time.sleep(0.01)
        assert first in [b"%d" % number for number in range(200)]
        later = threading.Timer(0.2, client.close)
        later.start()
        with pytest.raises(LinkClosedError):
            deque(iter(inbox.wait, None), maxlen=0)
        with pytest.raises(LinkClosedError):
            inbox.poll()
        inbox.wake()
    finally:
        client.close()
        server.close()


# -- samples that wait for Zenoh's thread -------------------------------------------------------------------


def _let_little_wait_in_sockets() -> None:
    """A Unix socket takes but a few samples until it is read: as if Zenoh's thread got no processor."""
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # it has just been closed
            if str(path.readlink()).startswith("socket:"):
                with socket.socket(fileno=os.dup(int(path.name))) as end:
                    if end.family == socket.AF_UNIX:
                        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)


def test_a_burst_of_samples_waits_and_nothing_of_it_is_lost(runtime: Path) -> None:
    way = endpoints_of([local_socket("a")])
    server, client = Network(listen=way).open(wait=False), Network(connect=way).open()
    begun, reads, taken = threading.Event(), threading.Event(), list[bytes]()

    def take(payload: bytes) -> None:
        begun.set()
        reads.wait(PATIENCE)
        taken.append(payload)

    client.take_at_once("hexwire/a/state", take)
    put = server.publisher("hexwire/a/state")
    eventually(lambda: put.is_wanted)
    _let_little_wait_in_sockets()
    # States of seven joints, 0.6 s of them.
    sent = [bytes([number]) * 650 for number in range(60)]
    put(sent[0])
    assert begun.wait(PATIENCE)
    for payload in sent[1:]:
        put(payload)
    reads.set()
    # What would be lost is lost by then.
    eventually(lambda: (put(b"end"), b"end" in taken)[1])
    assert taken[: taken.index(b"end")] == sent
    client.close()
    server.close()


# -- programs that take nothing ----------------------------------------------------------------------------

_ASKS_MUCH = """
import time
import zenoh
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network
nodes = [Network(connect=endpoints_of([local_socket("a")])).open() for _ in range(8)]
for _ in range(600):
    for node in nodes:
        node._session.get(
            "much", lambda reply: None, timeout=60.0, congestion_control=zenoh.CongestionControl.BLOCK
        )
time.sleep(0.5)
print("asked", flush=True)
time.sleep(60)
"""


def test_a_publisher_knows_whether_somebody_subscribes(runtime: Path) -> None:
    server = Network(listen=endpoints_of([local_socket("a")])).open(wait=False)
    put = server.publisher("hexwire/a/state")
    assert not put.is_wanted
    for _ in range(2):
        client = Network(connect=endpoints_of([local_socket("a")])).open()
        inbox = client.inbox("hexwire/a/state")
        eventually(lambda: put.is_wanted)
        put(b"x")
        assert inbox.wait() == b"x"
        # One that begins later knows it at once.
        assert server.publisher("hexwire/a/state").is_wanted
        client.close()
        eventually(lambda: not put.is_wanted)
    server.close()
    put(b"x")


@pytest.mark.slow
def test_a_program_that_asks_much_and_then_takes_nothing_delays_nobody_else(runtime: Path) -> None:
    frozen = threading.Event()

    def much(question: Question) -> None:
        frozen.wait(PATIENCE)
        question.reply(bytes(60_000))

    way = endpoints_of([local_socket("a")])
    server = Network(listen=way).open(wait=False)
    server.answer("much", much)
    server.answer("stop", lambda question: question.reply(b"stopped"))
    client = Network(connect=way).open()
    asker = subprocess.Popen([sys.executable, "-c", _ASKS_MUCH], stdout=subprocess.PIPE, text=True)
    try:
        assert asker.stdout is not None
        assert asker.stdout.readline() == "asked\n"
        asker.send_signal(signal.SIGSTOP)
        frozen.set()
        # Each connection of the frozen program is closed meanwhile. By Zenoh's own limit that takes 40 s.
        assert client.ask("stop", b"", PATIENCE) == b"stopped"
    finally:
        asker.kill()
        asker.communicate()
        client.close()
        server.close()


# -- the end of a program ---------------------------------------------------------------------------------

_FORGETFUL = """
import time
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network
node = Network(connect=endpoints_of([local_socket("a")])).open()
arrived = []
node.subscribe("hexwire/a/state", lambda payload, key: arrived.append(payload))
while not arrived:
    time.sleep(0.01)
print("received")
"""


def test_a_program_that_forgets_to_close_its_session_ends(runtime: Path) -> None:
    node = Network(listen=endpoints_of([local_socket("a")])).open(wait=False)
    put, ending = node.publisher("hexwire/a/state"), threading.Event()

    def publish() -> None:
        # Also while the other program ends.
        while not ending.wait(0.005):
            put(b"state")

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        run = subprocess.run(
            [sys.executable, "-c", _FORGETFUL], capture_output=True, text=True, timeout=PATIENCE, check=False
        )
    finally:
        ending.set()
        thread.join()
        node.close()
    assert (run.returncode, run.stdout, run.stderr) == (0, "received\n", "")
