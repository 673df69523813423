from __future__ import annotations

import errno
import os
import socket
import time
from pathlib import Path

import pytest
from far_ends import free_port

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkLostError,
    LinkNotFoundError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link import udp as udp_module
from hexwire.link.base import Link
from hexwire.link.open import make_link
from hexwire.link.udp import MAX_DATAGRAM, UdpLink, UdpListenLink, bind_udp
from hexwire.testing.link import LinkConformance, descriptors, in_a_moment, refused, soon


class TestUdp(LinkConformance):
    detects_loss = False
    back_pressure = False

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        port = free_port(socket.SOCK_DGRAM)
        return UdpLink("127.0.0.1", port), UdpListenLink(port=port)


class TestUdpBothPortsKnown(LinkConformance):
    detects_loss = False
    back_pressure = False

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        one, other = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
        return UdpLink("::1", one, bind_port=other), UdpLink("::1", other, bind="::1", bind_port=one)

    def second_owner(self, near: Link) -> Link:
        assert isinstance(near, UdpLink)
        return UdpLink("::1", 9, bind_port=near._bind_port)


class TestUdpListen(LinkConformance):
    detects_loss = False
    back_pressure = False

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        port = free_port(socket.SOCK_DGRAM)
        return UdpListenLink(port=port, silence=0.0), UdpLink("127.0.0.1", port)

    def greet(self, near: Link, far: Link) -> None:
        super().greet(far, near)  # it cannot answer before it was spoken to

    def second_owner(self, near: Link) -> Link:
        assert isinstance(near, UdpListenLink)
        return UdpListenLink(port=near.port)


def test_addresses() -> None:
    link = make_link("udp://192.168.1.20:15030?bind=192.168.1.10:15031")
    assert isinstance(link, UdpLink)
    assert link.url == "udp://192.168.1.20:15030"
    assert make_link("udp://[fd00::1]:5?bind=[fd00::2]").url == "udp://[fd00::1]:5"
    listening = make_link("udp-listen://192.168.1.10:15030?peer=192.168.1.20")
    assert listening.url == "udp-listen://192.168.1.10:15030?peer=192.168.1.20"
    assert make_link("udp-listen://:5").url == "udp-listen://127.0.0.1:5?peer=127.0.0.1"


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udp://h:0", "the peer's port must be from 1 to 65535"),
        ("udp://h:1?bind=a:b", "must be a number from 0 to 65535, not 'b'"),
        ("udp://h:1?port=5", "unknown option 'port'; options of udp://: bind"),
        ("udp-listen://0.0.0.0:5", "name the host to accept, as in ?peer=192.168.1.20"),
        ("udp-listen://10.0.0.1:5?peer=10.0.0.2:7", "use udp://10.0.0.2:7?bind="),
        ("udp-listen://:5/x", "is not allowed"),
    ],
)
def test_wrong_addresses(url: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        make_link(url)
    assert words in str(caught.value)


def stranger() -> socket.socket:
    """A program on another address of this machine."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.2", 0))
    return made


def test_only_the_peer_is_heard_by_the_calling_side() -> None:
    port = free_port(socket.SOCK_DGRAM)
    with UdpListenLink(port=port) as far, UdpLink("127.0.0.1", port) as near, stranger() as other:
        near.write(b"hello", soon())
        assert far.read(soon()) == b"hello"
        with socket.socket(fileno=os.dup(near.fileno())) as view:
            address = view.getsockname()
        assert address[0] == "127.0.0.1", "loopback, since the peer is there"
        other.sendto(b"move!", address)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as same_host_other_port:
            same_host_other_port.sendto(b"move!", address)
        assert near.read(in_a_moment()) == b""
        far.write(b"yes", soon())
        assert near.read(soon()) == b"yes"


def test_only_the_peers_host_is_heard_by_the_waiting_side() -> None:
    with UdpListenLink() as near, stranger() as other:
        other.sendto(b"move!", ("127.0.0.1", near.port))
        assert near.read(in_a_moment()) == b""
        assert near.dropped == 1
        with pytest.raises(LinkTimeoutError, match="has not sent anything yet"):
            near.write(b"x", soon())
        assert near.is_open
        assert near.url == f"udp-listen://127.0.0.1:{near.port}?peer=127.0.0.1"
    with UdpListenLink("127.0.0.1", peer="127.0.0.2") as near, stranger() as other:
        other.sendto(b"hello", ("127.0.0.1", near.port))
        assert near.read(soon()) == b"hello"
        near.write(b"yes", soon())
        other.settimeout(30.0)
        assert other.recv(10) == b"yes"
    with pytest.raises(LinkClosedError):
        near.write(b"x", 0.0)


def test_the_peer_may_come_back_from_another_port() -> None:
    now = [5.0]
    with UdpListenLink(clock=lambda: now[0]) as near:
        for _ in range(2):
            with UdpLink("127.0.0.1", near.port) as caller:
                caller.write(b"x", soon())
                assert near.read(soon()) == b"x"
                near.write(b"y", soon())
                assert caller.read(soon()) == b"y"
            now[0] += 0.3
        near.write(b"nobody is there now", soon())
        assert near.read(in_a_moment()) == b""


def test_a_program_that_is_run_again_at_once_is_heard_before_it_gives_up() -> None:
    """A session asks three times, 0.2 s apart."""
    now = [5.0]
    with UdpListenLink(clock=lambda: now[0]) as near:
        with UdpLink("127.0.0.1", near.port) as first:
            first.write(b"x", soon())
            assert near.read(soon()) == b"x"
        with UdpLink("127.0.0.1", near.port) as again:
            heard = []
            for _ in range(3):
                again.write(b"identify", soon())
                heard.append(near.read(in_a_moment()))
                now[0] += 0.2
            near.write(b"answer", soon())
            assert again.read(soon()) == b"answer"
        assert heard == [b"", b"", b"identify"]


def test_another_port_of_the_host_neither_is_heard_nor_gets_the_answers() -> None:
    now = [5.0]
    with (
        UdpListenLink(clock=lambda: now[0]) as near,
        UdpLink("127.0.0.1", near.port) as caller,
        UdpLink("127.0.0.1", near.port) as thief,
    ):
        caller.write(b"hello", soon())
        assert near.read(soon()) == b"hello"
        for _ in range(20):
            thief.write(b"mine!", soon())
            assert near.read(in_a_moment()) == b""
            near.write(b"answer", soon())
            assert caller.read(soon()) == b"answer"
            assert thief.read(0.0) == b""
            # Whoever goes on making sense keeps his place, however long that is.
            now[0] += 0.29
            near.confirm()
        assert near.dropped == 20


def test_one_who_makes_no_sense_keeps_nobody_out() -> None:
    now = [5.0]
    with (
        UdpListenLink(clock=lambda: now[0]) as near,
        UdpLink("127.0.0.1", near.port) as noise,
        UdpLink("127.0.0.1", near.port) as caller,
    ):
        for _ in range(20):
            noise.write(b"?", soon())
            assert near.read(soon()) == b"?"
            now[0] += 0.1
        caller.write(b"hello", soon())
        assert near.read(soon()) == b"hello"
        near.write(b"answer", soon())
        assert caller.read(soon()) == b"answer"


def test_a_peer_that_is_away_loses_nothing_but_datagrams() -> None:
    port = free_port(socket.SOCK_DGRAM)
    with UdpLink("127.0.0.1", port) as near:
        for _ in range(5):  # each of these makes the system report an error at the next call
            near.write(b"lost", soon())
            assert near.read(in_a_moment()) == b""
        for _ in range(5):
            near.write(b"lost", soon())
        with UdpListenLink(port=port) as far:
            near.write(b"heard", soon())
            assert far.read(soon()) == b"heard"
        assert near.is_open


def test_network_errors_that_are_no_absence_are_a_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    class BrokenSocket:
        def __init__(self, *errors: int) -> None:
            self.errors = list(errors)

        def send(self, data: bytes) -> int:
            number = self.errors.pop(0)
            raise OSError(number, os.strerror(number))

    for errors in ((errno.EPERM,), (errno.ECONNREFUSED, errno.EPERM)):
        with UdpLink("127.0.0.1", 9) as near, monkeypatch.context() as patch:
            real = near._socket
            patch.setattr(near, "_socket", BrokenSocket(*errors))
            with pytest.raises(LinkLostError, match="Operation not permitted"):
                near.write(b"x", soon())
            near._socket = real
    with UdpLink("127.0.0.1", 9) as near, monkeypatch.context() as patch:
        patch.setattr(near, "_socket", BrokenSocket(errno.ECONNREFUSED, errno.EHOSTUNREACH))
        near.write(b"x", soon())  # lost on the way, as datagrams are
        patch.undo()
        assert near.is_open


def test_a_datagram_that_is_too_long_is_dropped_and_counted() -> None:
    with UdpListenLink() as near, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as caller:
        caller.sendto(bytes(MAX_DATAGRAM + 1), ("127.0.0.1", near.port))
        caller.sendto(b"", ("127.0.0.1", near.port))
        caller.sendto(bytes(MAX_DATAGRAM), ("127.0.0.1", near.port))
        assert near.read(soon()) == bytes(MAX_DATAGRAM)
        assert near.dropped == 1
        assert near.read(0.0) == b""


def test_what_cannot_be_bound_or_reached() -> None:
    with pytest.raises(LinkNotFoundError, match="this machine has no such address"):
        UdpLink("127.0.0.1", 9, bind="192.0.2.1").open()
    with pytest.raises(UsageError, match="one IPv4 and one IPv6"):
        UdpLink("127.0.0.1", 9, bind="::1").open()
    with pytest.raises(LinkNotFoundError, match="there is no host"):
        UdpLink("x" * 70, 9).open()
    with pytest.raises(LinkNotFoundError, match=r"no route to that host \(.*\); check the address and bind="):
        UdpLink("192.0.2.7", 9, bind="127.0.0.1").open()
    with UdpListenLink() as near, pytest.raises(LinkBusyError, match="that port is in use"):
        UdpListenLink(port=near.port).open()


def test_a_deadline_in_the_past_still_takes_what_is_there() -> None:
    with UdpListenLink() as near, UdpLink("127.0.0.1", near.port) as caller:
        caller.write(b"1", time.monotonic() - 1.0)
        caller.write(b"2", time.monotonic() - 1.0)
        assert near.read(soon()) == b"1"
        assert near.read(0.0) == b"2"


@pytest.mark.parametrize(
    ("peer", "bind", "own", "family"),
    [
        ("127.0.0.1", "", "127.0.0.1", socket.AF_INET),
        ("127.0.0.9", "", "127.0.0.1", socket.AF_INET),
        ("192.0.2.7", "", "0.0.0.0", socket.AF_INET),
        ("192.0.2.7", "192.0.2.1", "192.0.2.1", socket.AF_INET),
        ("::1", "", "::1", socket.AF_INET6),
        ("2001:db8::7", "", "::", socket.AF_INET6),
    ],
)
def test_the_own_address_is_loopback_only_if_the_peer_is_there(
    peer: str, bind: str, own: str, family: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bound: list[tuple[object, ...]] = []

    def note(*args: object) -> None:
        bound.append(args)
        raise LinkNotFoundError("not in this test")

    monkeypatch.setattr(udp_module, "bind_udp", note)
    link = UdpLink(peer, 9, bind=bind, bind_port=5)
    with pytest.raises(LinkNotFoundError):
        link.open()
    assert bound == [(own, 5, link.url, family)]


def test_errors_of_opening_name_the_link_and_leave_no_descriptor() -> None:
    before = descriptors()
    for link in (
        UdpLink("127.0.0.1", 9, bind="192.0.2.1"),
        UdpLink("x" * 70, 9),
        UdpLink("192.0.2.7", 9, bind="127.0.0.1"),
        UdpListenLink("192.0.2.1", 9, peer="127.0.0.1"),
    ):
        with refused(LinkNotFoundError, link):
            link.open()
    with UdpListenLink() as near:
        second = UdpListenLink(port=near.port)
        with refused(LinkBusyError, second):
            second.open()
        with refused(LinkTimeoutError, near):
            near.write(b"x", 0.0)
    assert descriptors() <= before


def test_the_socket_has_room_for_a_burst_and_ipv6_leaves_ipv4_alone() -> None:
    with bind_udp("127.0.0.1", 0, "udp-listen://x") as made:
        limit = int(Path("/proc/sys/net/core/rmem_max").read_text())
        assert made.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= min(1 << 20, limit)
        assert not made.getblocking()
    with bind_udp("::1", 0, "udp-listen://x") as made:
        assert made.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY) == 1


def test_a_peer_by_name_and_a_second_opening() -> None:
    with UdpListenLink("127.0.0.1", peer="localhost") as near:
        for _ in range(2):
            with UdpLink("127.0.0.1", near.port) as caller:
                caller.write(b"x", soon())
                assert near.read(soon()) == b"x"
            near.close()
            near.open()
            # Whoever was the peer of the line before is not the peer of this one.
            with pytest.raises(LinkTimeoutError, match="has not sent anything yet"):
                near.write(b"y", soon())
            near.confirm()


def test_addresses_give_all_their_parts() -> None:
    link = make_link("udp://127.0.0.1:15030?bind=[::1]:15031")
    assert isinstance(link, UdpLink)
    assert (link._host, link._port, link._bind, link._bind_port) == ("127.0.0.1", 15030, "::1", 15031)
    plain = make_link("udp://127.0.0.1:15030")
    assert isinstance(plain, UdpLink)
    assert (plain._bind, plain._bind_port) == ("", 0)
    for url in ("udp://h:1/x", "udp-listen://:5?peers=x"):
        with pytest.raises(UsageError):
            make_link(url)
