from __future__ import annotations

import errno
import signal
import socket
import threading
import time

import pytest
from conformance import PATIENCE, Background, descriptors, in_a_moment, soon

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkError,
    LinkLostError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.ipc.link import Link, LinkKind, PollLink


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


def test_the_contract_cannot_be_built_without_a_backend() -> None:
    with pytest.raises(TypeError):
        Link()  # type: ignore[abstract]  # that is the point


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


def test_a_write_goes_on_where_it_stopped() -> None:
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
    assert descriptors() == before
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


def test_flush_input_ends_even_if_the_peer_never_does(monkeypatch: pytest.MonkeyPatch) -> None:
    with ScriptedLink() as link:
        monkeypatch.setattr(link, "_read_ready", lambda: bytes(1000))
        assert 1_000_000 < link.flush_input() < 1_100_000


@pytest.mark.parametrize("direction", ["read", "write"])
def test_a_signal_handler_may_close_the_link_it_interrupts(direction: str) -> None:
    """As a ROS shutdown hook does, in the thread that waits."""
    link = ScriptedLink()
    link.open()
    link.takes = 0
    before = signal.signal(signal.SIGUSR1, lambda *_: link.close())
    timer = threading.Timer(0.05, lambda: signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGUSR1))
    timer.start()
    try:
        with pytest.raises(LinkClosedError):
            link.read(soon()) if direction == "read" else link.write(b"x", soon())
    finally:
        timer.join(PATIENCE)
        signal.signal(signal.SIGUSR1, before)
    assert link.closed == 1, "its descriptors are freed by the call that was interrupted"
    assert not link.is_open


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


def test_repr_shows_address_and_state() -> None:
    link = ScriptedLink()
    assert repr(link) == "<ScriptedLink scripted:// closed>"
    with link:
        assert repr(link) == "<ScriptedLink scripted:// open>"
