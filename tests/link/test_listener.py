from __future__ import annotations

import errno
import select
import signal
import socket
import threading
import time

import pytest
from far_ends import free_port

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkError,
    LinkNotFoundError,
    LinkPermissionError,
    UsageError,
)
from hexwire.link import listener as listener_module
from hexwire.link.listener import Listener, explain_bind, listen_address
from hexwire.link.tcp import PeerLink, TcpLink
from hexwire.link.url import parse_url
from hexwire.testing.link import PATIENCE, Background, descriptors, in_a_moment, soon


def call(listener: Listener) -> tuple[TcpLink, PeerLink]:
    caller = TcpLink("127.0.0.1", listener.port)
    caller.open()
    peer = listener.accept(soon())
    assert peer is not None
    return caller, peer


def test_several_callers_are_served_at_once() -> None:
    before = descriptors()
    with Listener() as listener:
        pairs = [call(listener) for _ in range(5)]
        for number, (caller, peer) in enumerate(pairs):
            caller.write(bytes([number]), soon())
            assert peer.read(soon()) == bytes([number])
            peer.write(bytes([100 + number]), soon())
            assert caller.read(soon()) == bytes([100 + number])
        assert len({peer.peer for _, peer in pairs}) == 5
        assert all(peer.peer.startswith("127.0.0.1:") for _, peer in pairs)
    # Those who were let in outlive the listener.
    caller, peer = pairs[0]
    caller.write(b"still here", soon())
    assert peer.read(soon()) == b"still here"
    for pair in pairs:
        for link in pair:
            link.close()
    assert descriptors() <= before


def test_it_binds_to_loopback_unless_told() -> None:
    with Listener() as listener:
        assert listener.url == f"tcp-listen://127.0.0.1:{listener.port}"
        assert listener.port > 0
        assert listener._socket is not None
        assert listener._socket.getsockname()[0] == "127.0.0.1"


def test_its_descriptor_says_when_there_is_something_to_do() -> None:
    with Listener() as listener:
        assert not select.select([listener.fileno()], [], [], 0.0)[0]
        with TcpLink("127.0.0.1", listener.port):
            assert select.select([listener.fileno()], [], [], PATIENCE)[0]
            peer = listener.accept(0.0)
            assert peer is not None
            peer.close()
        assert not select.select([listener.fileno()], [], [], 0.0)[0]


def test_accept_has_a_deadline_and_can_be_woken_and_closed() -> None:
    listener = Listener()
    with pytest.raises(LinkClosedError):
        listener.accept(0.0)
    with pytest.raises(LinkClosedError):
        listener.fileno()
    listener.open()
    deadline = in_a_moment()
    assert listener.accept(deadline) is None
    assert time.monotonic() >= deadline
    waiter = Background(lambda: listener.accept(None))
    waiter.let_it_block()
    assert listener.accept(in_a_moment()) is None, "another thread is at the door"
    listener.wake()
    assert waiter.outcome() is None
    listener.wake()
    listener.forget_wake()
    waiter = Background(lambda: listener.accept(None))
    waiter.let_it_block()
    listener.close()
    with pytest.raises(LinkClosedError):
        waiter.outcome()
    listener.close()


def test_an_accept_that_meets_a_close_under_way_says_so() -> None:
    with Listener() as listener, listener._accepting:  # as close() holds it
        listener._closing = True
        with pytest.raises(LinkClosedError):
            listener.accept(0.0)


def test_a_signal_handler_may_close_it_while_it_waits() -> None:
    before = descriptors()
    listener = Listener()
    listener.open()
    handler = signal.signal(signal.SIGUSR1, lambda *_: listener.close())
    timer = threading.Timer(0.05, lambda: signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGUSR1))
    timer.start()
    try:
        with pytest.raises(LinkClosedError):
            listener.accept(soon())
    finally:
        timer.join(PATIENCE)
        signal.signal(signal.SIGUSR1, handler)
    assert descriptors() <= before


def test_one_port_has_one_listener() -> None:
    with Listener() as listener:
        with pytest.raises(LinkBusyError, match="is already listening"):
            listener.open()
        with pytest.raises(LinkBusyError, match="that port is in use; stop the other program"):
            Listener(port=listener.port).open()
        caller, peer = call(listener)
        port = listener.port
    # Open again at once, though a connection to the port is still open or winding down.
    with Listener(port=port) as again:
        assert again.port == port
    caller.close()
    peer.close()


def test_addresses_that_cannot_be_bound() -> None:
    before = descriptors()
    with pytest.raises(LinkNotFoundError, match="this machine has no such address"):
        Listener("192.0.2.1", free_port()).open()
    with pytest.raises(LinkNotFoundError, match="there is no host"):
        Listener("x" * 70, 1).open()
    for number, kind in (
        (errno.EADDRINUSE, LinkBusyError),
        (errno.EADDRNOTAVAIL, LinkNotFoundError),
        (errno.EACCES, LinkPermissionError),
        (errno.EPERM, LinkPermissionError),
        (errno.EIO, LinkError),
    ):
        error = explain_bind(OSError(number, "x"), "u")
        assert (type(error), error.url) == (kind, "u")
    assert (
        str(explain_bind(OSError(errno.EIO, "Input/output error"), "u")) == "u cannot be opened: Input/output error"
    )
    assert str(explain_bind(OSError("no number"), "u")) == "u cannot be opened: no number"
    assert descriptors() <= before


def test_listen_addresses() -> None:
    assert listen_address(parse_url("tcp-listen://:5")) == ("127.0.0.1", 5)
    assert listen_address(parse_url("tcp-listen://[::]:5")) == ("::", 5)
    with pytest.raises(UsageError, match="in brackets"):
        listen_address(parse_url("tcp-listen://::1:5"))


def test_without_a_free_descriptor_callers_wait_and_nobody_spins(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0

    def no_room(self: socket.socket) -> object:
        nonlocal calls
        calls += 1
        raise OSError(errno.EMFILE, "Too many open files")

    with Listener() as listener, TcpLink("127.0.0.1", listener.port) as caller:
        with monkeypatch.context() as patch:
            patch.setattr(socket.socket, "accept", no_room)
            assert listener.accept(time.monotonic() + 0.1) is None
        assert 1 <= calls <= 50
        assert listener.refused == calls
        assert "Too many open files" in listener.last_refusal
        peer = listener.accept(soon())
        assert peer is not None
        caller.write(b"x", soon())
        assert peer.read(soon()) == b"x"
        peer.close()


def test_a_caller_for_whom_nothing_is_left_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_wakers(*_: object) -> object:
        raise LinkError("no descriptor left")

    with Listener() as listener, TcpLink("127.0.0.1", listener.port):
        monkeypatch.setattr(listener_module, "PeerLink", no_wakers)
        assert listener.accept(in_a_moment()) is None
        assert listener.last_refusal == "no descriptor left"


def test_a_caller_that_left_before_it_was_let_in(monkeypatch: pytest.MonkeyPatch) -> None:
    def left(*_: object) -> object:
        raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")

    with Listener() as listener, TcpLink("127.0.0.1", listener.port):
        monkeypatch.setattr(listener_module, "prepare", left)
        assert listener.accept(in_a_moment()) is None
        assert listener.refused == 1
        assert listener.last_refusal.endswith("disconnected at once")


def test_turning_away_serves_nobody_and_ends() -> None:
    with Listener() as listener:
        listener.turn_away()
        assert listener.refused == 0
        callers = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(3)]
        listener.turn_away()
        assert listener.refused == 3
        for caller in callers:
            caller.settimeout(PATIENCE)
            assert caller.recv(1) == b""
            caller.close()
    listener.turn_away()
