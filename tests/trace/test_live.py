"""Verbose mode from the code: `connect(..., trace=...)` and HEXWIRE_TRACE=1, on every robot and link."""

from __future__ import annotations

import fcntl
import io
import itertools
import os
import random
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

import pytest
from tests.drivers.puma_server import served_puma
from tests.frames import frame_bytes
from tests.waits import eventually

from hexwire import connect
from hexwire.link.base import Link
from hexwire.link.memory import memory_pair
from hexwire.link.tap import Direction, Passed
from hexwire.trace.chapter_log import parse_log
from hexwire.trace.line_reader import LineReader
from hexwire.trace.live import Tracer
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import make_ping, make_read, make_status

LIMIT = 30.0
"""Seconds to wait for something that comes at once on a machine that is not stalled."""


def blocks(text: str) -> list[Passed]:
    found = list(parse_log(text.splitlines()))
    assert [item for item in found if isinstance(item, str)] == []
    return [item for item in found if isinstance(item, Passed)]


def assert_one_frame_each(passed: list[Passed]) -> None:
    reader = LineReader()
    for each in passed:
        found = [(reading.kind, reading.data) for reading in reader.feed(each)]
        assert found in ([("frame", each.data)], [("packet", each.data)]), each


# -- one block for each frame -------------------------------------------------------------------------

FRAMES = [frame_bytes(Command.STATS, bytes(range(n)), proto=2, seq=n, src=8, dst=7) for n in (0, 9, 100)]
CHAPTER = [
    frame_bytes(Command.READ, make_status(n, params=b"\1\2"), proto=1, seq=n, src=8, dst=0) for n in (1, 2, 3)
]
PACKETS = [make_status(1, params=b"\1\2"), make_status(2), make_status(3, params=bytes(15))]
PACKETS.append(make_status(0, params=b"\5\6", legacy=True))


@pytest.mark.parametrize(
    ("request_", "answers"),
    [(FRAMES[0], FRAMES), (CHAPTER[0], CHAPTER), (make_read(1, 56, 2), PACKETS)],
    ids=["dialect 2", "dialect 1", "servo bus"],
)
def test_a_frame_is_one_block_however_it_was_read(request_: bytes, answers: list[bytes]) -> None:
    """Byte by byte, all at once, and 40 random splits: every time the same blocks."""
    data = b"".join(answers)
    chance = random.Random(26)
    splits = [list(range(1, len(data))), []]
    splits += [sorted(chance.sample(range(1, len(data)), chance.randint(1, 9))) for _ in range(40)]
    for cuts in splits:
        stream = io.StringIO()
        tracer = Tracer(stream)
        host, board = memory_pair()
        link = tracer.tap(host)
        with link, board:
            link.write(request_)
            for start, end in itertools.pairwise([0, *cuts, len(data)]):
                board.write(data[start:end])
                assert link.read(None) == data[start:end]
        tracer.finish()
        shown = [(each.direction, each.data) for each in blocks(stream.getvalue())]
        assert shown == [(Direction.SENT, request_), *((Direction.RECEIVED, each) for each in answers)], cuts


def test_what_never_becomes_a_frame_is_shown_when_the_line_closes() -> None:
    stream = io.StringIO()
    tracer = Tracer(stream, explain=True)
    host, board = memory_pair()
    with tracer.tap(host) as link, board:
        board.write(FRAMES[2][:50])
        link.read(None)
    tracer.finish()
    (shown,) = blocks(stream.getvalue())
    assert shown.data == FRAMES[2][:50]
    assert f"cut short, 50 of {len(FRAMES[2])} bytes" in stream.getvalue()


# -- every robot --------------------------------------------------------------------------------------


@pytest.mark.system
def test_every_robot_is_traced_by_connect() -> None:
    with served_puma() as puma:
        robots = {"sim://hex7bot": None, "sim://hex7bot?dialect=1": None, "sim://so100": None, "sim://so101": None}
        for url, robot in {**robots, puma.tcp: "puma260", puma.udp: "puma260"}.items():
            stream = io.StringIO()
            with connect(url, robot, trace=stream) as arm:
                state, name = arm.read(), arm.model.name
            # The end of the arm waits for what is printed, but only a second.
            eventually(lambda: not [thread for thread in threading.enumerate() if thread.name == "trace"])
            passed = blocks(stream.getvalue())
            assert {each.direction for each in passed} == set(Direction), url
            if not url.startswith("tcp"):  # several lines, each of which has its own pairing
                assert_one_frame_each(passed)
            assert f"{name}:: HW read (degree):\n{state.names[0]}=" in stream.getvalue(), url


# -- the whole program --------------------------------------------------------------------------------

PROGRAM = """
import sys, threading
from hexwire import ServoBus, Session, connect
def bus():
    with ServoBus.from_url("sim://so101") as line:
        line.ping(1)
thread = threading.Thread(target=bus)
thread.start()
thread.join()
with Session.from_url("sim://hex7bot") as session:
    session.negotiate()
with connect("sim://so100") as arm:
    arm.read()
print("arrived")
"""


def run(
    words: list[str], variable: str | None = None, stderr: int | TextIO = subprocess.PIPE
) -> subprocess.CompletedProcess[str]:
    """Run a program with that value of HEXWIRE_TRACE."""
    surroundings = {name: value for name, value in os.environ.items() if name != "HEXWIRE_TRACE"}
    surroundings |= {} if variable is None else {"HEXWIRE_TRACE": variable}
    return subprocess.run(
        words, env=surroundings, stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=120, check=False
    )


@pytest.mark.system
@pytest.mark.slow
def test_the_environment_traces_every_link_of_a_program_in_any_thread() -> None:
    done = run([sys.executable, "-c", PROGRAM], "1")
    assert (done.returncode, done.stdout) == (0, "arrived\n"), done.stderr
    passed = blocks(done.stderr)
    assert passed[0].data == make_ping(1)
    assert any(each.data[:4] == b"\x5a\xfa\xfa\x5a" for each in passed)
    assert done.stderr.count("so100:: HW read (degree):") == 1
    for off in (None, "0", "", "N"):
        assert run([sys.executable, "-c", PROGRAM], off).stderr == "", off


@pytest.mark.system
def test_a_command_traces_the_same_and_once() -> None:
    """By variable, by switch, by both: the blocks differ only in times and in what counts the frames."""
    command = [sys.executable, "-m", "hexwire.cli", "state", "--port", "sim://so101"]
    shown = []
    for words, variable in (([], "1"), (["--trace"], None), (["--trace"], "1")):
        done = run([*command, *words], variable)
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("so101:: HW read (degree):") == 1
        shown.append([each.data for each in blocks(done.stderr) if each.direction is Direction.SENT])
    assert shown[0] == shown[1] == shown[2]


@pytest.mark.system
@pytest.mark.parametrize(
    "stderr",
    ["closed", "full pipe", *(pytest.param(how, marks=pytest.mark.slow) for how in ("closed pipe", "/dev/full"))],
)
def test_no_standard_error_harms_a_program(stderr: str) -> None:
    program = [sys.executable, "-c", PROGRAM]
    if stderr == "closed":
        done = run(["sh", "-c", 'exec "$@" 2>&-', "sh", *program], "1")
    elif stderr == "/dev/full":
        with Path(stderr).open("w") as full:
            done = run(program, "1", full)
    else:
        reading, writing = os.pipe()
        if stderr == "closed pipe":
            os.close(reading)
        else:
            os.write(writing, b"-" * fcntl.fcntl(writing, fcntl.F_GETPIPE_SZ))
        done = run(program, "1", writing)
        os.close(writing)
        if stderr == "full pipe":
            os.close(reading)
    assert (done.returncode, done.stdout) == (0, "arrived\n")


# -- streams that are slow or broken ------------------------------------------------------------------


class Broken(io.StringIO):
    def write(self, text: str) -> int:
        raise RuntimeError("no")


class Stuck(io.StringIO):
    """Its `write` does not return before it is freed."""

    def __init__(self) -> None:
        super().__init__()
        self.free = threading.Event()

    def write(self, text: str) -> int:
        self.free.wait(LIMIT)
        return super().write(text)


def closed() -> TextIO:
    stream = io.StringIO()
    stream.close()
    return stream


@pytest.fixture
def stuck() -> Iterator[Stuck]:
    stream = Stuck()
    yield stream
    stream.free.set()


@pytest.mark.system
@pytest.mark.parametrize("make", [Broken, closed])
def test_a_stream_that_fails_does_not_reach_the_arm(make: Callable[[], TextIO]) -> None:
    for url in ("sim://hex7bot", "sim://so101"):
        with connect(url, trace=make()) as arm:
            assert arm.read().names == arm.model.names, url


@pytest.mark.system
def test_the_arm_waits_for_no_stream(stuck: Stuck) -> None:
    """A thousand transfers pass while the first line is still being written."""
    with connect("sim://so101", trace=stuck) as arm:
        for _ in range(100):
            arm.read()
        assert not stuck.free.is_set()
        assert stuck.getvalue() == ""


def test_lines_for_which_there_is_no_room_are_counted_and_said(stuck: Stuck) -> None:
    tracer = Tracer(stuck)
    host, board = memory_pair()
    link: Link = tracer.tap(host)
    with link, board:
        for _ in range(3000):
            link.write(FRAMES[0])
            board.read(None)
        stuck.free.set()
    tracer.finish()
    text = stuck.getvalue()
    assert tracer.missed.count > 1000
    assert "lines are left out here" in text
    # What is shown is whole.
    assert {each.data for each in blocks(text)} == {FRAMES[0]}


# -- signals and forked processes ----------------------------------------------------------------------


def test_a_signal_between_the_look_for_the_thread_and_its_start_makes_no_second_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two would decode one line at once, and only one of them would end."""
    stream = io.StringIO()
    tracer = Tracer(stream)
    made: list[threading.Thread] = []
    plain = threading.Thread

    def make(**options: object) -> threading.Thread:
        new = plain(**options)  # type: ignore[arg-type]  # as they are given
        made.append(new)
        if len(made) == 1:
            # As a handler that stops the arm does, which is traced too.
            tracer._put(lambda: ["nested"])
        return new

    monkeypatch.setattr(threading, "Thread", make)
    tracer._put(lambda: ["outer"])
    monkeypatch.undo()
    tracer.finish()
    assert sum(thread.ident is not None for thread in made) == 1
    for thread in made:
        if thread.ident is not None:
            thread.join(LIMIT)
            assert not thread.is_alive()
    assert sorted(stream.getvalue().split()) == ["nested", "outer"]


FORKS = """
import os, sys, threading
from hexwire.link.memory import memory_pair
from hexwire.trace.live import Tracer

tracer = Tracer(sys.stdout)
host, board = memory_pair()
link = tracer.tap(host)
held, go = threading.Event(), threading.Event()

def hold():
    with tracer._lock:
        held.set()
        go.wait()

with link, board:
    link.write(bytes.fromhex(sys.argv[1]))
    threading.Thread(target=hold).start()
    held.wait()
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        near, far = memory_pair()
        with tracer.tap(near) as mine, far:
            mine.write(bytes.fromhex(sys.argv[1]))
        tracer.finish()
        sys.stdout.flush()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    go.set()
"""


@pytest.mark.system
def test_a_forked_process_traces_its_own_links_whatever_its_parent_was_doing() -> None:
    done = subprocess.run(
        # Python from 3.12 on warns of a fork beside threads, which this is about.
        (sys.executable, "-W", "ignore:This process", "-c", FORKS, FRAMES[0].hex()),
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert [each.data for each in blocks(done.stdout)] == [FRAMES[0]] * 2
