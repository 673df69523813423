from __future__ import annotations

import errno
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from unittest.mock import Mock

import pytest
from interrupts import interrupted_at
from tests.soak import rounds

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkError,
    LinkLostError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link import base as base_module
from hexwire.link import poll_link as poll_link_module
from hexwire.link.base import LinkKind
from hexwire.link.poll_link import PollLink
from hexwire.link.serial import SerialLink
from hexwire.testing.link import PATIENCE, Background, descriptors, in_a_moment, soon


class ScriptedLink(PollLink):
    """A backend over a socket pair whose every step can be scripted."""

    kind = LinkKind.STREAM
    _lost_advice = "; look at the cable"

    def __init__(self) -> None:
        super().__init__("scripted://")
        self.read_error: OSError | None = None
        self.write_error: OSError | None = None
        self.open_error: Exception | None = None
        self.takes = 1 << 20
        self.given_up = 0
        self.closed = 0

    def _open(self) -> None:
        self.near, self.far = socket.socketpair()
        self.near.setblocking(False)
        # By name, so that a test may replace them later.
        self._read_now = lambda: self._read_ready()
        self._write_now = lambda data: self._write_ready(data)
        if self.open_error:
            raise self.open_error

    def _close(self) -> None:
        self.closed += 1
        self.near.close()
        self.far.close()

    def _fileno(self) -> int:
        return self.near.fileno()

    def _read_ready(self) -> bytes:
        if self.read_error:
            raise self.read_error
        return self.near.recv(100)

    def _write_ready(self, data: memoryview | bytes) -> int:
        if self.write_error:
            raise self.write_error
        return self.near.send(data[: self.takes])

    def _write_given_up(self) -> None:
        self.given_up += 1


def test_a_plain_os_error_becomes_a_lost_link_with_advice() -> None:
    with ScriptedLink() as link:
        link.read_error = OSError(errno.EIO, "Input/output error")
        link.far.send(b"x")
        with pytest.raises(LinkLostError) as caught:
            link.read(soon())
        assert str(caught.value) == "scripted:// was lost: Input/output error; look at the cable"
        assert caught.value.url == "scripted://"
        assert not link.is_open
        # Lost stays lost, with the same words, both ways.
        link.read_error = None
        for use in (lambda: link.read(soon()), lambda: link.write(b"x"), link.flush_input, link.fileno):
            with pytest.raises(LinkLostError, match="look at the cable"):
                use()


def test_losing_one_direction_ends_a_wait_in_the_other() -> None:
    with ScriptedLink() as link:
        reader = Background(lambda: link.read(None))
        reader.let_it_block()
        link.write_error = OSError(errno.ENXIO, "No such device or address")
        with pytest.raises(LinkLostError):
            link.write(b"x")
        with pytest.raises(LinkLostError, match="No such device"):
            reader.outcome()

    with ScriptedLink() as link:
        link.takes = 0
        writer = Background(lambda: link.write(b"x", None))
        time.sleep(0.05)
        link.read_error = OSError(errno.EIO, "Input/output error")
        link.far.send(b"x")
        with pytest.raises(LinkLostError):
            link.read(soon())
        with pytest.raises(LinkLostError):
            writer.outcome()


def test_false_alarms_are_waited_out() -> None:
    with ScriptedLink() as link:
        link.far.send(b"x")
        for error in (BlockingIOError(), InterruptedError()):
            link.read_error = error
            deadline = in_a_moment()
            assert link.read(deadline) == b""
            assert time.monotonic() >= deadline
        link.read_error = None
        assert link.read(soon()) == b"x"
        link.write_error = BlockingIOError()
        with pytest.raises(LinkTimeoutError, match="took none of 3 bytes"):
            link.write(b"abc", in_a_moment())
        assert link.given_up == 1


def test_a_write_continues_where_it_stopped() -> None:
    with ScriptedLink() as link:
        link.takes = 7
        data = bytes(range(100))
        link.write(data, soon())
        assert link.far.recv(1000) == data


def test_opening_that_fails_leaves_nothing_open() -> None:
    link = ScriptedLink()
    link.open_error = OSError(errno.EMFILE, "Too many open files")
    before = descriptors()
    with pytest.raises(LinkError, match="scripted:// cannot be opened: Too many open files"):
        link.open()
    link.open_error = ValueError("a fault of the backend passes as it is")
    with pytest.raises(ValueError, match="passes as it is"):
        link.open()
    assert descriptors() <= before
    assert not link.is_open
    link.open_error = None
    with link:
        assert link.is_open


def test_a_datagram_limit_is_checked_before_anything_is_sent() -> None:
    with ScriptedLink() as link:
        link.max_message = 4
        with pytest.raises(UsageError, match="at most 4 bytes, not 5"):
            link.write(b"12345")
        link.write(b"1234")
        assert link.far.recv(10) == b"1234"


def test_a_second_reader_waits_its_turn_and_keeps_its_deadline() -> None:
    with ScriptedLink() as link:
        first = Background(lambda: link.read(None))
        first.let_it_block()
        deadline = in_a_moment()
        assert link.read(deadline) == b""
        assert time.monotonic() >= deadline
        with pytest.raises(LinkBusyError, match="another thread is reading"):
            link.flush_input()
        second = Background(lambda: link.read(None))
        second.let_it_block()
        link.far.send(b"1")
        assert first.outcome() == b"1"
        link.far.send(b"2")
        assert second.outcome() == b"2"


def test_a_reader_that_comes_again_keeps_its_deadline_though_another_waits() -> None:
    def twice() -> tuple[bytes, bytes]:
        # The one that waits gets the turn at the end of the first, before its thread runs.
        return link.read(None), link.read(in_a_moment())

    with ScriptedLink() as link:
        first = Background(twice)
        first.let_it_block()
        second = Background(lambda: link.read(None))
        second.let_it_block()
        link.far.send(b"1")
        assert first.outcome() == (b"1", b"")
        link.far.send(b"2")
        assert second.outcome() == b"2"


def test_a_second_writer_keeps_its_deadline() -> None:
    with ScriptedLink() as link:
        link.takes = 0
        first = Background(lambda: link.write(b"first", None))
        first.let_it_block()
        with pytest.raises(LinkTimeoutError):
            link.write(b"second", in_a_moment())
        link.takes = 100
        assert first.outcome() is None
        assert link.far.recv(100) == b"first"


def test_a_read_or_write_that_meets_a_close_under_way_says_so() -> None:
    link = ScriptedLink()
    link.open()
    in_close, go_on = threading.Event(), threading.Event()
    real = link._close

    def slow_close() -> None:
        in_close.set()
        assert go_on.wait(PATIENCE)
        real()

    link._close = slow_close  # type: ignore[method-assign]  # close() stops while it holds both directions
    closer = Background(link.close)
    assert in_close.wait(PATIENCE)
    link._close = real  # type: ignore[method-assign]
    try:
        for use in (lambda: link.read(0.0), lambda: link.write(b"x", 0.0)):
            with pytest.raises(LinkClosedError):
                use()
    finally:
        go_on.set()
        closer.outcome()


def test_what_ends_the_line_while_it_is_being_closed_is_no_loss() -> None:
    uses: list[Callable[[ScriptedLink], object]] = [
        lambda link: link.read(None),
        lambda link: link.collect(PATIENCE),
        lambda link: link.flush_input(),
        lambda link: link.write(b"x"),
        lambda link: link.post(b"x"),
        lambda link: link.exchange(b"x", PATIENCE),
    ]
    for use in uses:
        for error in (OSError(errno.EIO, "Input/output error"), LinkLostError("it went away")):
            link = ScriptedLink()
            begun = threading.Event()

            def ends(
                *_: object, link: ScriptedLink = link, begun: threading.Event = begun, error: OSError = error
            ) -> int:
                begun.set()
                for _ in iter(lambda: link._closing, True):
                    time.sleep(0.001)
                raise error

            link._read_ready = link._write_ready = ends  # type: ignore[assignment,method-assign]
            link.open()
            link.far.send(b"x")
            user = Background(lambda link=link, use=use: use(link))  # type: ignore[misc]
            assert begun.wait(PATIENCE)
            link.close()
            with pytest.raises(LinkClosedError):
                user.outcome()


def test_flush_input_ends_even_if_the_peer_never_does(monkeypatch: pytest.MonkeyPatch) -> None:
    with ScriptedLink() as link:
        monkeypatch.setattr(link, "_read_ready", lambda: bytes(1000))
        assert 1_000_000 < link.flush_input() < 1_100_000


def interrupt_inside(link: ScriptedLink) -> threading.Thread:
    """Send SIGUSR1 to this thread while it waits in a call of the link, however late it gets there."""

    def interrupt() -> None:
        deadline = soon()
        while not (link._reading.taken or link._writing.taken) and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.05)
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGUSR1)

    thread = threading.Thread(target=interrupt)
    thread.start()
    return thread


@pytest.mark.parametrize("use", ["read", "write", "exchange"])
def test_a_signal_handler_may_close_the_link_it_interrupts(use: str) -> None:
    """As a ROS shutdown hook does, in the thread that waits."""
    link = ScriptedLink()
    link.open()
    if use == "write":
        link.takes = 0
    calls: dict[str, Callable[[], object]] = {
        "read": lambda: link.read(soon()),
        "write": lambda: link.write(b"x", soon()),
        "exchange": lambda: link.exchange(b"x", PATIENCE),
    }
    released_by_the_handler: list[int] = []

    def close(*_: object) -> None:
        link.close()
        released_by_the_handler.append(link.closed)

    before = signal.signal(signal.SIGUSR1, close)
    timer = interrupt_inside(link)
    try:
        with pytest.raises(LinkClosedError):
            calls[use]()
    finally:
        timer.join(PATIENCE)
        signal.signal(signal.SIGUSR1, before)
    assert released_by_the_handler == [0], "the call that was interrupted still uses its descriptors"
    assert link.closed == 1, "it frees them"
    assert not link.is_open


EACH_USE = pytest.mark.parametrize(
    "use",
    [
        "link.exchange(b'x', 0.0)",
        *(pytest.param(use, marks=pytest.mark.slow) for use in ("link.read(0.0)", "link.write(b'x', 0.0)")),
    ],
)


@pytest.mark.soak
@EACH_USE
def test_a_signal_handler_may_close_the_link_at_any_moment(use: str) -> None:
    """Also where a call has taken its turn this moment, or is about to give it back.

    A call that forgets the close which interrupted it shows within three rounds.
    """
    code = f"""
import os, random, signal
from hexwire.errors import LinkClosedError
from hexwire.link.serial import SerialLink

master, slave = os.openpty()
os.set_blocking(master, False)
random.seed(1)
for _ in range({rounds(300, 20_000)}):
    link = SerialLink(os.ttyname(slave))
    link.open()
    signal.signal(signal.SIGALRM, lambda *_: link.close())
    signal.setitimer(signal.ITIMER_REAL, random.uniform(0.00002, 0.0004))
    try:
        while True:
            {use}
            try:
                os.read(master, 4096)
            except BlockingIOError:
                pass
    except LinkClosedError:
        pass
    assert not link.is_open
    assert link._fd == -1
"""
    # In a process of its own: what hangs in a lock cannot be ended from inside.
    subprocess.run([sys.executable, "-c", code], check=True, timeout=rounds(60, 600))


_USES: dict[str, Callable[[ScriptedLink], object]] = {
    "read": lambda link: link.read(0.0),
    "exchange": lambda link: link.exchange(b"x", 0.0, lambda data: 0.0),
    "write": lambda link: link.write(b"x", 0.0),
    "post": lambda link: link.post(b"x"),
    "flush_input": lambda link: link.flush_input(),
}


def _use_all(link: ScriptedLink) -> None:
    link.flush_input()
    link.far.send(b"answer")
    assert link.exchange(b"x", PATIENCE) == b"answer"
    link.far.send(b"answer")
    link.write(b"x", soon())
    assert link.read(soon()) == b"answer"


@pytest.mark.parametrize("marked", [False, True], ids=["free", "after waiting"])
@pytest.mark.parametrize("name", _USES)
def test_ctrl_c_at_any_step_leaves_a_link_that_can_be_used_and_closed(name: str, marked: bool) -> None:
    use, step = _USES[name], 0
    while True:
        step += 1
        link = ScriptedLink()
        link.open()
        link.far.send(b"answer")
        # With the turns marked as taken, the call goes the way of one that finds another thread's call.
        link._reading.taken = link._writing.taken = int(marked)
        where = interrupted_at(step, lambda use=use, link=link: use(link))  # type: ignore[misc]  # of this turn
        if not where:
            assert step > 3
            link.close()
            return
        assert link._reading.taken == link._writing.taken == marked, where
        link._reading.taken = link._writing.taken = 0
        Background(lambda link=link: _use_all(link)).outcome()
        _use_all(link)
        Background(link.close).outcome()
        assert (link.is_open, link.near.fileno()) == (False, -1), where


@pytest.mark.parametrize("pending", [False, True], ids=["another thread", "the handler"])
def test_ctrl_c_while_a_link_closes_leaves_the_rest_to_the_next_close(pending: bool) -> None:
    def close(link: ScriptedLink) -> None:
        if pending:
            # A handler closes the link, and the call that it interrupted does it on leaving.
            link._read_now = lambda: (link.close(), b"x")[1]
            link.far.send(b"x")
            link.exchange(b"x", PATIENCE)
        else:
            link.close()

    before, step = descriptors(), 0
    while True:
        step += 1
        link = ScriptedLink()
        link.open()
        where = interrupted_at(step, lambda link=link: close(link))  # type: ignore[misc]  # of this turn
        Background(link.close).outcome()
        assert (link.is_open, link.near.fileno()) == (False, -1), where
        assert descriptors() <= before, where
        link.open()
        assert link.exchange(b"x", 0.0) == b"", where
        link.close()
        if not where:
            return


@pytest.mark.soak
@EACH_USE
def test_a_signal_handler_may_raise_at_any_moment(use: str) -> None:
    """As Ctrl-C does: afterwards another thread can use the link, and close it."""
    code = f"""
import os, random, signal, threading
from hexwire.link.serial import SerialLink

master, slave = os.openpty()
os.set_blocking(master, False)
link = SerialLink(os.ttyname(slave))
random.seed(1)

def interrupt(*_):
    raise KeyboardInterrupt

def finish():
    link.flush_input()
    link.exchange(b"x", 0.0)
    link.close()

signal.signal(signal.SIGALRM, interrupt)
for _ in range({rounds(150, 10_000)}):
    link.open()
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, random.uniform(0.00002, 0.0004))
            while True:
                {use}
                try:
                    os.read(master, 4096)
                except BlockingIOError:
                    pass
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    except KeyboardInterrupt:
        pass
    thread = threading.Thread(target=finish)
    thread.start()
    thread.join()
    assert not link.is_open
"""
    # In a process of its own: what hangs in a lock cannot be ended from inside.
    subprocess.run([sys.executable, "-c", code], check=True, timeout=rounds(60, 600))


def test_closing_ends_an_opening_that_waits() -> None:
    waits = threading.Event()

    class SlowLink(ScriptedLink):
        def _open(self) -> None:
            super()._open()
            waits.set()
            assert not self._wait_for(self.near.fileno(), 1, soon())

    link = SlowLink()
    opener = Background(link.open)
    assert waits.wait(PATIENCE)
    link.wake()  # not meant for an opening
    opener.let_it_block()
    link.close()
    with pytest.raises(LinkClosedError):
        opener.outcome()
    assert not link.is_open
    assert link.near.fileno() == -1


def test_waiting_during_an_opening_has_a_deadline() -> None:
    class WaitingLink(ScriptedLink):
        def _open(self) -> None:
            super()._open()
            self.outcomes = [self._wait_for(self.near.fileno(), 1, in_a_moment())]
            self.far.send(b"x")
            self.outcomes.append(self._wait_for(self.near.fileno(), 1, soon()))

    with WaitingLink() as link:
        assert link.outcomes == [False, True]


def test_a_reader_that_comes_late_does_not_close_a_link_that_was_opened_again() -> None:
    link = ScriptedLink()
    link.open()
    link.close()
    link.open()
    link.far.send(b"x")
    assert link.read(soon()) == b"x"
    link.close()


def test_watched_descriptors_are_served_by_the_reader() -> None:
    class WatchingLink(ScriptedLink):
        def _open(self) -> None:
            super()._open()
            self.bell, self.rope = socket.socketpair()
            self.rang = 0
            self._watched[self.bell.fileno()] = self.ring

        def ring(self) -> None:
            self.rang += len(self.bell.recv(10))

        def _close(self) -> None:
            super()._close()
            self.bell.close()
            self.rope.close()

    with WatchingLink() as link:
        link.rope.send(b"!")
        assert link.read(in_a_moment()) == b""
        assert link.rang == 1
        link.rope.send(b"!")
        link.far.send(b"x")
        assert link.read(soon()) == b"x"


# --- exchange -----------------------------------------------------------------------------------------


def test_an_exchange_takes_the_answer_that_is_there_or_comes() -> None:
    with ScriptedLink() as link:
        link.far.send(b"early")
        assert link.exchange(b"request", 5.0) == b"early"
        assert link.far.recv(100) == b"request"
        answerer = Background(lambda: link.far.send(link.far.recv(100)[::-1]))
        assert link.exchange(b"abc", PATIENCE) == b"cba"
        answerer.outcome()
        start = time.monotonic()
        assert link.exchange(b"abc", 0.05) == b""
        assert time.monotonic() >= start + 0.05
        assert link.exchange(b"abc", -1.0) == b""


def test_an_exchange_continues_until_all_has_arrived_or_nothing_more_comes() -> None:
    pieces, seen = [b"cd", b"ef"], []

    def rest(data: bytes) -> float:
        seen.append(data)
        if not pieces:
            return 0.0
        link.far.send(pieces.pop(0))
        return PATIENCE

    with ScriptedLink() as link:
        link.far.send(b"ab")
        assert link.exchange(b"request", PATIENCE, rest) == b"abcdef"
        assert seen == [b"ab", b"abcd", b"abcdef"]
        link.far.send(b"ab")
        start = time.monotonic()
        assert link.exchange(b"request", PATIENCE, lambda data: 0.05) == b"ab"
        assert time.monotonic() >= start + 0.05
        assert link.exchange(b"request", 0.0, rest) == b""


def test_waking_ends_an_exchange_with_what_has_come() -> None:
    def rest(data: bytes) -> float:
        link.wake()
        return PATIENCE

    with ScriptedLink() as link:
        link.far.send(b"ab")
        assert link.exchange(b"request", PATIENCE, rest) == b"ab"
        assert link.read(soon()) == b"", "the wake is still to be told"


def test_an_exchange_waits_out_false_alarms_and_full_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    with ScriptedLink() as link:
        alarms = [b"", BlockingIOError(), b"answer"]

        def read() -> bytes:
            outcome = alarms.pop(0)
            if isinstance(outcome, Exception):
                raise outcome
            return outcome

        monkeypatch.setattr(link, "_read_ready", read)
        link.far.send(b"x")
        assert link.exchange(b"request", PATIENCE) == b"answer"
        monkeypatch.undo()
        link.near.recv(10)
        link.far.recv(100)
        refusals = [BlockingIOError(), None]
        real = link._write_ready

        def write(data: memoryview | bytes) -> int:
            refusal = refusals.pop(0)
            if refusal:
                raise refusal
            return real(data)

        monkeypatch.setattr(link, "_write_ready", write)
        link.far.send(b"answer")
        assert link.exchange(b"request", PATIENCE) == b"answer"
        assert link.far.recv(100) == b"request"


def test_an_error_of_the_callers_own_ends_an_exchange_and_not_the_link() -> None:
    def rest(data: bytes) -> float:
        raise OSError(errno.ENOSPC, "No space left on device")

    with ScriptedLink() as link:
        link.far.send(b"ab")
        with pytest.raises(OSError, match="No space left") as caught:
            link.exchange(b"request", PATIENCE, rest)
        assert not isinstance(caught.value, LinkLostError)
        assert link.is_open
        link.far.send(b"cd")
        assert link.exchange(b"request", PATIENCE) == b"cd"


def test_an_exchange_may_wait_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poll_link_module, "LONGEST_POLL", 0.01)
    with ScriptedLink() as link:
        for window in (math.inf, PATIENCE):
            waiter = Background(lambda window=window: link.exchange(b"request", window, lambda data: 0.0))
            waiter.let_it_block()
            link.far.send(b"late")
            assert waiter.outcome() == b"late"
        monkeypatch.undo()
        link.far.send(b"early")
        assert link.exchange(b"request", math.inf) == b"early"
        link.far.send(b"more")
        assert link.exchange(b"request", PATIENCE, lambda data: math.nan if data else 0.0) == b"more"


def test_a_packet_without_an_answer_is_written_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    with ScriptedLink() as link:
        link.takes = 3
        link.post(b"packet")
        assert link.far.recv(100) == b"packet"
        # While another thread writes, it waits its turn as `write` does.
        link.takes = 0
        writer = Background(lambda: link.write(b"first", None))
        writer.let_it_block()
        monkeypatch.setattr(base_module, "WRITE_TIME", 0.05)
        with pytest.raises(LinkTimeoutError, match="none of 6 bytes"):
            link.post(b"packet")
        link.takes = 100
        writer.outcome()
        assert link.far.recv(100) == b"first"


def test_a_packet_without_an_answer_on_a_line_that_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poll_link_module, "WRITE_TIME", 0.05)
    with ScriptedLink() as link:
        link.takes = 0
        with pytest.raises(LinkTimeoutError):
            link.post(b"packet")
        monkeypatch.setattr(link, "_write_ready", Mock(side_effect=BlockingIOError))
        with pytest.raises(LinkTimeoutError):
            link.post(b"packet")
        assert link.is_open


def test_a_packet_without_an_answer_on_a_line_that_is_closed_or_lost() -> None:
    link = ScriptedLink()
    with pytest.raises(LinkClosedError):
        link.post(b"packet")
    with link:
        link.write_error = OSError(errno.EIO, "Input/output error")
        with pytest.raises(LinkLostError, match="look at the cable"):
            link.post(b"packet")
        with pytest.raises(LinkLostError, match="look at the cable"):
            link.post(b"packet")


def test_an_exchange_on_a_line_that_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poll_link_module, "WRITE_TIME", 0.05)
    with ScriptedLink() as link:
        link.takes = 0
        with pytest.raises(LinkTimeoutError):
            link.exchange(b"request", 5.0)
        assert link.is_open


def test_an_exchange_on_a_line_that_is_closed_or_lost() -> None:
    link = ScriptedLink()
    with pytest.raises(LinkClosedError):
        link.exchange(b"request", 5.0)
    with link:
        link.write_error = OSError(errno.EIO, "Input/output error")
        with pytest.raises(LinkLostError, match="Input/output error; look at the cable"):
            link.exchange(b"request", 5.0)
        assert not link.is_open
    with link:
        link.write_error = None
        link.read_error = LinkLostError("it went away")
        link.far.send(b"x")
        with pytest.raises(LinkLostError, match="it went away"):
            link.exchange(b"request", 5.0)
        with pytest.raises(LinkLostError, match="it went away"):
            link.exchange(b"request", 5.0)


def test_an_exchange_is_ended_by_waking_and_closing() -> None:
    with ScriptedLink() as link:
        waiter = Background(lambda: link.exchange(b"request", PATIENCE))
        waiter.let_it_block()
        link.wake()
        assert waiter.outcome() == b""
        waiter = Background(lambda: link.exchange(b"request", PATIENCE))
        waiter.let_it_block()
        link.close()
        with pytest.raises(LinkClosedError):
            waiter.outcome()


def test_an_exchange_waits_its_turn() -> None:
    with ScriptedLink() as link:
        reader = Background(lambda: link.read(None))
        reader.let_it_block()
        waiter = Background(lambda: link.exchange(b"request", PATIENCE))
        assert link.far.recv(100) == b"request", "sent at once, though another thread is reading"
        link.far.send(b"1")
        assert reader.outcome() == b"1"
        link.far.send(b"2")
        assert waiter.outcome() == b"2"
        link.takes = 0
        writer = Background(lambda: link.write(b"long", soon()))
        writer.let_it_block()
        waiter = Background(lambda: link.exchange(b"request", PATIENCE))
        waiter.let_it_block()
        link.takes = 100
        writer.outcome()
        assert link.far.recv(4) == b"long"
        link.far.send(b"3")
        assert waiter.outcome() == b"3"


def test_opening_and_losing_a_line_are_logged_below_the_layers_name(caplog: pytest.LogCaptureFixture) -> None:
    master, slave = os.openpty()
    link = SerialLink(os.ttyname(slave))
    with caplog.at_level("DEBUG", logger="hexwire.link"), link:
        os.close(slave)
        os.close(master)
        with pytest.raises(LinkLostError):
            link.read(time.monotonic() + 30)
    assert [record.message.split(" ", 1)[1].split(";")[0] for record in caplog.records] == ["is open", "went away"]
    assert {record.name for record in caplog.records} == {"hexwire.link.poll_link"}
