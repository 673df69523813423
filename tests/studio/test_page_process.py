"""The process for the files of pages: what it inherits, and that each of its ends is one line and no more."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from tests.studio.running import PATIENCE, until

from hexwire.errors import HexwireError
from hexwire.studio.page_process import PageProcess


@pytest.fixture
def process(tmp_path: Path) -> Iterator[PageProcess]:
    made = PageProcess(lambda: (str(tmp_path), str(1 << 20)))
    yield made
    made.close()


@pytest.fixture
def endless(tmp_path: Path) -> Path:
    """A file whose reading never ends."""
    path = tmp_path / "endless"
    os.mkfifo(path)
    return path


def _pid(process: PageProcess) -> int:
    process.ask("wire_close", "")
    assert process.pid is not None
    return process.pid


def _is_gone(pid: int) -> bool:
    """It has ended with all its threads, also if nobody has asked for its status."""
    try:
        ended = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
        return ended and len(list(Path(f"/proc/{pid}/task").iterdir())) == 1
    except OSError:
        return True


def test_it_begins_when_it_is_needed_and_stays(process: PageProcess) -> None:
    assert process.pid is None
    first = _pid(process)
    assert _pid(process) == first


def test_it_goes_after_the_arm_and_inherits_neither_ports_nor_sockets(process: PageProcess) -> None:
    master, slave = os.openpty()
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        pid = _pid(process)
    os.close(master)
    os.close(slave)
    assert os.getpriority(os.PRIO_PROCESS, pid) >= os.getpriority(os.PRIO_PROCESS, 0) + 10
    assert os.getsid(pid) != os.getsid(0), "Ctrl-C does not reach it"
    files = [str(each.readlink()) for each in Path(f"/proc/{pid}/fd").iterdir()]
    # Two pipes, one of them under two numbers; errors go where those of this program go.
    assert 3 <= len(files) <= 4, files
    assert not [name for name in files if name.startswith(("socket:", "/dev/pt"))], files


def test_a_refusal_and_a_file_that_fails_are_told(process: PageProcess, tmp_path: Path) -> None:
    with pytest.raises(HexwireError, match=r"there is no recording 'a\.mcap'"):
        process.ask("find", "a.mcap")
    with pytest.raises(OSError, match="No such file") as failed:
        process.ask("wire_open", "tab", str(tmp_path / "none"), "x", "board")
    assert failed.value.filename is None, "the names of files of this machine are nobody's business"
    with pytest.raises(HexwireError, match="the studio failed at this: TypeError"):
        process.ask("find")


def test_an_order_that_cannot_be_sent_leaves_nothing_behind(process: PageProcess) -> None:
    _pid(process)
    with pytest.raises(Exception, match=r"pickle|local object"):
        process.ask("csv", [bytes(1 << 20)], lambda: None)
    _pid(process)


def test_after_it_was_killed_another_one_begins(process: PageProcess) -> None:
    pid = _pid(process)
    os.kill(pid, signal.SIGKILL)
    until(lambda: _is_gone(pid), "its end")
    assert _pid(process) != pid


@contextmanager
def _asked_for_long(process: PageProcess, endless: Path) -> Iterator[list[str]]:
    """Another thread has an order under way, which this block ends; what it is told."""
    told = list[str]()

    def ask() -> None:
        with pytest.raises(HexwireError) as failed:
            process.ask("wire_open", "tab", str(endless), "x", "board")
        told.append(str(failed.value))

    writers = list[int]()

    def reads() -> bool:
        # Before somebody reads from it, nobody can open it for this. While it is open, reading never ends.
        with suppress(OSError):
            writers.append(os.open(endless, os.O_WRONLY | os.O_NONBLOCK))
        return bool(writers)

    thread = threading.Thread(target=ask)
    thread.start()
    until(reads, "the order")
    try:
        yield told
        thread.join(PATIENCE)
    finally:
        os.close(writers[0])


def test_killed_at_work_it_tells_whoever_waits(process: PageProcess, endless: Path) -> None:
    pid = _pid(process)
    with _asked_for_long(process, endless) as told:
        os.kill(pid, signal.SIGKILL)
    assert told == ["the process that reads and writes files for pages has ended with status -9; try again"]
    assert _pid(process) != pid


def test_a_suspended_one_is_ended(process: PageProcess) -> None:
    pid = _pid(process)
    process._silence = 1.0
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(HexwireError, match="was silent for 1 s and was ended; try again"):
        process.ask("wire_close", "")
    assert _is_gone(pid)
    assert _pid(process) != pid


def test_one_that_takes_no_more_orders_is_ended_although_they_fill_its_pipe(process: PageProcess) -> None:
    pid, process._silence = _pid(process), 1.0
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(HexwireError, match="was silent"):
        process.ask("csv", "", [bytes(1 << 20)] * 8)


def test_what_takes_too_long_is_ended_although_it_gives_signs_of_life(process: PageProcess, endless: Path) -> None:
    _pid(process)
    process._longest = 3.0
    with pytest.raises(HexwireError, match="worked for 3 s and was ended"):
        process.ask("wire_open", "tab", str(endless), "x", "board")


def test_memory_is_bounded(process: PageProcess, tmp_path: Path) -> None:
    pid = _pid(process)
    with (tmp_path / "large").open("wb") as file:
        file.truncate(3 << 30)
    with pytest.raises(HexwireError, match="needs more than 2 GiB of memory"):
        process.ask("wire_open", "tab", str(tmp_path / "large"), "x", "board")
    until(lambda: _is_gone(pid), "the end of the process, which frees all of it")
    assert _pid(process) != pid


_PROGRAM = """
import sys, threading
from hexwire.studio.page_process import PageProcess

process = PageProcess(lambda: ("/nowhere", "1"))
process.ask("wire_close", "")
print(process.pid, flush=True)
if len(sys.argv) > 1:
    process.ask("wire_open", "tab", sys.argv[1], "x", "board")
sys.stdin.read()
"""


@pytest.mark.parametrize("busy", [False, True])
def test_it_ends_with_a_program_that_is_killed(busy: bool, endless: Path) -> None:
    words = [sys.executable, "-c", _PROGRAM, *([str(endless)] if busy else [])]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        pid = int(program.stdout.readline())
        assert not _is_gone(pid)
        program.kill()
        until(lambda: _is_gone(pid), "the end of its process")


def test_closing_ends_it_also_at_work(process: PageProcess, endless: Path) -> None:
    pid = _pid(process)
    with _asked_for_long(process, endless) as told:
        process.close()
    assert told
    assert _is_gone(pid)
    with pytest.raises(HexwireError, match="the studio ends"):
        process.ask("wire_close", "")


def test_an_order_is_written_without_a_copy_of_what_is_large() -> None:
    """The pickler passes large bytes on as they are, so that no step of it takes long."""
    sizes = list[int]()

    class Out:
        def write(self, data: bytes) -> None:
            sizes.append(len(data))

    blocks = [bytes(100_000) for _ in range(100)]
    pickle.dump(("csv", blocks), Out(), pickle.HIGHEST_PROTOCOL)
    assert sizes.count(100_000) == 100
    assert max(sizes) == 100_000
