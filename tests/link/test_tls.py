from __future__ import annotations

import contextlib
import os
import pty
import re
import select
import signal
import socket
import ssl
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from far_ends import free_port

from hexwire.errors import LinkError, LinkLostError, LinkPermissionError, LinkTimeoutError, UsageError
from hexwire.link import tls as tls_module
from hexwire.link.base import Link
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.link.listen import TcpListenLink
from hexwire.link.listener import Listener
from hexwire.link.open import make_link
from hexwire.link.tcp import PeerLink, TcpLink
from hexwire.link.tls import TlsFiles, TlsStream
from hexwire.testing.link import PATIENCE, Background, LinkConformance, descriptors, in_a_moment, soon

LONG_AGO = datetime.now(UTC) - timedelta(days=1000)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority with a server and a client; a second authority with the same; some that are not good."""
    folder = tmp_path_factory.mktemp("lab")
    for place in (folder, folder / "other"):
        make_authority(place)
        issue_certificate(place, "server", "server")
        issue_certificate(place, "client", "client")
    issue_certificate(folder, "expired", "client", days=10, now=LONG_AGO)
    issue_certificate(folder, "expired-server", "server", days=10, now=LONG_AGO)
    issue_certificate(folder, "early", "client", now=datetime.now(UTC) + timedelta(days=100))
    issue_certificate(folder, "elsewhere", "server", hosts=["arm.elsewhere"])
    return folder


def files(lab: Path, who: str, ca: str = "ca") -> TlsFiles:
    return TlsFiles(str(lab / f"{ca}.pem"), str(lab / f"{who}.pem"), str(lab / f"{who}.key"))


class _TlsConformance(LinkConformance):
    @pytest.fixture(autouse=True)
    def _lab(self, lab: Path) -> None:
        self.lab = lab

    def ends_of(self) -> tuple[TcpLink, TcpListenLink]:
        port = free_port()
        return (
            TcpLink("127.0.0.1", port, tls=files(self.lab, "client")),
            TcpListenLink(port=port, tls=files(self.lab, "server")),
        )

    def meet(self, caller: Link, waiting: Link) -> None:
        """Both ends have to be at it for the handshake."""
        waiting.open()
        opener = Background(caller.open)
        deadline = soon()
        while waiting._peer is None:  # type: ignore[attr-defined]  # whether the handshake is over
            waiting._meet(deadline)  # type: ignore[attr-defined]
        opener.outcome()
        self.greet(caller, waiting)

    def test_it_is_a_context_manager(self, tmp_path: Path) -> None:
        near, far = self.make_pair(tmp_path)
        self.open_pair(near, far)
        near.__exit__(None, None, None)
        assert not near.is_open
        far.close()


class TestTlsCaller(_TlsConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        return self.ends_of()

    def open_pair(self, near: Link, far: Link) -> None:
        self.meet(near, far)


class TestTlsListener(_TlsConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        caller, waiting = self.ends_of()
        return waiting, caller

    def wait_readable(self, link: Link) -> None:
        assert isinstance(link, TcpListenLink)
        assert link._peer is not None
        super().wait_readable(link._peer)

    def open_pair(self, near: Link, far: Link) -> None:
        self.meet(far, near)


def test_addresses(lab: Path) -> None:
    options = f"ca={lab}/ca.pem&cert={lab}/client.pem&key={lab}/client.key"
    caller = make_link(f"tcps://127.0.0.1:5?{options}&timeout=2&name=arm")
    assert isinstance(caller, TcpLink)
    assert caller.url == "tcps://127.0.0.1:5"
    assert caller._tls is not None
    assert (caller._tls.name, caller._tls.ca) == ("arm", f"{lab}/ca.pem")
    waiting = make_link(f"tcps-listen://:5?{options}")
    assert isinstance(waiting, TcpListenLink)
    assert waiting.url == "tcps-listen://127.0.0.1:5"
    for url, words in (
        ("tcps://h:5?ca=x&cert=y", r"the option key=FILE is missing; 'hexwire cert new' creates the files"),
        (
            f"tcps://h:5?{options}&verify=0",
            "unknown option 'verify'; options of tcps://: ca, cert, key, name, timeout",
        ),
        (f"tcps-listen://:5?{options}&timeout=1", "unknown option 'timeout'"),
        (f"tcps://h:5/x?{options}", "is not allowed"),
    ):
        with pytest.raises(UsageError, match=words):
            make_link(url)


def test_the_settings_are_strict(lab: Path) -> None:
    server, client = files(lab, "server").server_context(), files(lab, "client").client_context()
    for context in (server, client):
        assert context.minimum_version == ssl.TLSVersion.TLSv1_2
        assert context.verify_mode == ssl.CERT_REQUIRED
        usual = ssl.SSLContext(context.protocol).options
        assert context.options == usual | ssl.OP_NO_RENEGOTIATION, "Python's own settings, such as no compression"
    assert client.check_hostname


def test_a_key_with_a_pass_phrase_is_refused_and_nobody_is_asked_on_the_terminal(lab: Path, tmp_path: Path) -> None:
    """In a service nobody would answer. Only a program with a terminal is asked, so it has one here."""
    key = serialization.load_pem_private_key((lab / "client.key").read_bytes(), None)
    locked = serialization.BestAvailableEncryption(b"secret")
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, locked)
    (tmp_path / "locked.key").write_bytes(pem)
    files = f"{str(lab / 'ca.pem')!r}, {str(lab / 'client.pem')!r}, {str(tmp_path / 'locked.key')!r}"
    program = f"from hexwire.link.tls import TlsFiles; TlsFiles({files}).client_context()"
    child, terminal = pty.fork()
    if child == 0:
        os.execv(sys.executable, [sys.executable, "-c", program])
    said = b""
    try:
        # Linux ends the terminal of a program that has ended with EIO.
        with contextlib.suppress(OSError):
            while b"Enter" not in said and (more := os.read(terminal, 65536)):
                said += more
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(terminal)
    assert b"Enter" not in said
    assert b"without a pass phrase" in said


def test_files_that_cannot_be_used(lab: Path, tmp_path: Path) -> None:
    ca, cert, key = str(lab / "ca.pem"), str(lab / "client.pem"), str(lab / "client.key")
    (tmp_path / "junk").write_text("junk")
    junk = str(tmp_path / "junk")
    for wrong, words in (
        (TlsFiles(str(tmp_path / "no"), cert, key), "cannot read the authority .*no: cannot be read: No such file"),
        (TlsFiles(ca, str(tmp_path / "no"), key), "cannot read the certificate .*no: cannot be read: No such file"),
        (TlsFiles(ca, cert, str(tmp_path)), "cannot read the key .*: cannot be read: Is a directory"),
        (TlsFiles(junk, cert, key), "junk is not an authority's certificate in PEM form"),
        (TlsFiles(ca, junk, key), "are not a certificate and its key in PEM form"),
        (TlsFiles(ca, cert, str(lab / "server.key")), "are not a certificate and its key"),
    ):
        before = descriptors()
        with pytest.raises(UsageError, match=words):
            wrong.client_context()
        with pytest.raises(UsageError, match=words):
            Listener(tls=wrong).open()
        with pytest.raises(UsageError, match=words), Listener() as listener:
            TcpLink("127.0.0.1", listener.port, tls=wrong).open()
        assert descriptors() <= before


def attempt(listener: Listener, use: Callable[[], object]) -> tuple[PeerLink | None, BaseException | None]:
    """Let somebody try to get in while the listener waits; what came of it on both sides."""
    caller = Background(use)
    peer = None
    before = listener.refused
    while peer is None and listener.refused == before:
        peer = listener.accept(in_a_moment())
    error = None
    try:
        caller.outcome()
    except (OSError, ssl.SSLError) as caught:
        error = caught
    return peer, error


def use_link(link: TcpLink) -> None:
    """Open, and stay until the other end says something or hangs up."""
    with link:
        link.read(soon())


@pytest.mark.parametrize(
    ("who", "words"),
    [
        ("other/client", "certificate of the other end is not valid: (self-signed|unable to get local issuer)"),
        ("expired", "certificate of the other end is not valid: certificate has expired"),
        ("early", "certificate of the other end is not valid: certificate is not yet valid"),
        ("server", "certificate of the other end is not valid: unsuitable certificate purpose"),
    ],
)
def test_clients_that_are_not_let_in(lab: Path, who: str, words: str) -> None:
    with Listener(tls=files(lab, "server")) as listener:
        link = TcpLink("127.0.0.1", listener.port, tls=files(lab, who))
        peer, error = attempt(listener, lambda: use_link(link))
        assert peer is None
        assert isinstance(error, LinkError)
        assert "the other end refuses our certificate" in str(error)
        assert listener.last_refusal.startswith("127.0.0.1:")
        assert re.search(words, listener.last_refusal)
        served(listener, lab)


def served(listener: Listener, lab: Path) -> None:
    """A good client gets in and is answered."""
    link = TcpLink("127.0.0.1", listener.port, tls=files(lab, "client"))

    def talk() -> bytes:
        with link:
            link.write(b"hello", soon())
            return link.read(soon())

    talker = Background(talk)
    peer = None
    while peer is None:
        peer = listener.accept(soon())
    assert peer.read(soon()) == b"hello"
    peer.write(b"welcome", soon())
    assert talker.outcome() == b"welcome"
    peer.close()


def test_a_client_without_a_certificate(lab: Path) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(lab / "ca.pem")

    def call() -> bytes:
        with (
            socket.create_connection(("127.0.0.1", listener.port), PATIENCE) as plain,
            context.wrap_socket(plain, server_hostname="localhost") as tls,
        ):
            return tls.recv(1)

    with Listener(tls=files(lab, "server")) as listener:
        peer, error = attempt(listener, call)
        assert peer is None
        assert isinstance(error, ssl.SSLError)
        assert "the other end showed no certificate" in listener.last_refusal
        served(listener, lab)


@pytest.mark.parametrize(
    ("who", "ca", "words"),
    [
        ("other/server", "ca", "the certificate of the other end is not valid: "),
        ("expired-server", "ca", "certificate has expired"),
        ("client", "ca", "unsuitable certificate purpose"),
        ("elsewhere", "ca", "(IP address|Hostname) mismatch"),
    ],
)
def test_servers_that_are_not_trusted(lab: Path, who: str, ca: str, words: str) -> None:
    server = TlsFiles(str(lab / "ca.pem"), str(lab / f"{who}.pem"), str(lab / f"{who}.key"))
    with Listener(tls=server) as listener:
        link = TcpLink("127.0.0.1", listener.port, tls=files(lab, "client", ca))
        peer, error = attempt(listener, lambda: use_link(link))
        assert peer is None
        assert isinstance(error, LinkPermissionError)
        with pytest.raises(LinkPermissionError, match=words):
            raise error


def test_a_server_may_be_called_by_another_name(lab: Path) -> None:
    settings = files(lab, "client")
    named = TlsFiles(settings.ca, settings.cert, settings.key, "arm.elsewhere")
    with Listener(tls=files(lab, "elsewhere")) as listener:
        link = TcpLink("127.0.0.1", listener.port, tls=named)
        opener = Background(link.open)
        peer = None
        while peer is None:
            peer = listener.accept(soon())
        opener.outcome()
        link.close()
        peer.close()


def test_a_plain_client_on_a_tls_port(lab: Path) -> None:
    def call(words: bytes) -> bytes:
        with socket.create_connection(("127.0.0.1", listener.port), PATIENCE) as plain:
            plain.sendall(words)
            answer = b""
            while piece := plain.recv(1000):
                answer += piece
            return answer

    with Listener(tls=files(lab, "server")) as listener:
        for words in (b"GET / HTTP/1.0\r\n\r\n", b"\x5a\xfa\xfa\x5a" + bytes(48), bytes(100)):
            peer, _ = attempt(listener, lambda words=words: call(words))
            assert peer is None
            assert "the other end does not speak TLS" in listener.last_refusal
        served(listener, lab)


def test_a_tls_client_on_a_plain_port(lab: Path) -> None:
    with Listener() as listener:
        link = TcpLink("127.0.0.1", listener.port, tls=files(lab, "client"), timeout=PATIENCE)
        opener = Background(link.open)
        peer = listener.accept(soon())
        assert peer is not None
        peer.read(soon())
        peer.write(b"hexwire?", soon())
        with pytest.raises(LinkPermissionError, match="the other end does not speak TLS"):
            opener.outcome()
        peer.close()
        slow = TcpLink("127.0.0.1", listener.port, tls=files(lab, "client"), timeout=0.2)
        with pytest.raises(LinkTimeoutError, match=r"no TLS handshake within 0\.2 s; is that a TLS server"):
            slow.open()
        opener = Background(link.open)
        for _ in range(2):
            peer = listener.accept(soon())
            assert peer is not None
            peer.close()
        with pytest.raises(LinkPermissionError, match="the other end closed the connection"):
            opener.outcome()


def joined(lab: Path) -> tuple[TlsStream, TlsStream]:
    """Two ends after the handshake, over a socket pair that holds little."""
    ends = []
    for side in socket.socketpair():
        side.setblocking(False)
        side.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        ends.append(side)
    client = TlsStream(ends[0], files(lab, "client").client_context(), host="localhost")
    server = TlsStream(ends[1], files(lab, "server").server_context())
    for _ in range(100):
        if [client.handshake(), server.handshake()] == [True, True]:
            return client, server
    raise AssertionError("no handshake")


def take(stream: TlsStream) -> bytes:
    try:
        return stream.receive()
    except BlockingIOError:
        return b""


def test_a_write_that_was_given_up_does_not_break_the_line(lab: Path) -> None:
    client, server = joined(lab)
    with pytest.raises(BlockingIOError):
        client.send(b"a" * 16384)
    with pytest.raises(BlockingIOError):
        client.send(b"a" * 16384)
    client.given_up()
    received = take(server)
    sent = 0
    for _ in range(1000):
        try:
            sent = client.send(b"b" * 100)
        except BlockingIOError:
            received += take(server)
            continue
        break
    assert sent == 100, "what is given up is not counted as the next write"
    for _ in range(10):
        received += take(server)
    assert received == b"a" * 16384 + b"b" * 100
    client.close()
    server.close()


def test_a_farewell_is_told_after_what_came_with_it(lab: Path) -> None:
    client, server = joined(lab)
    client.send(b"last words")
    # The farewell is sent, and the socket stays open.
    with pytest.raises(ssl.SSLWantReadError):
        client._tls.unwrap()
    client._flush()
    assert server.receive() == b"last words"
    with pytest.raises(LinkLostError, match="closed the connection"):
        server.receive()
    client.close()
    server.close()


def test_a_farewell_alone(lab: Path) -> None:
    client, server = joined(lab)
    with pytest.raises(ssl.SSLWantReadError):
        client._tls.unwrap()
    client._flush()
    with pytest.raises(LinkLostError, match="closed the connection"):
        server.receive()
    client.close()
    server.close()


def test_bytes_that_are_not_tls_end_the_line(lab: Path) -> None:
    client, server = joined(lab)
    client.socket.send(b"\x17\x03\x03\x00\x20" + bytes(32))
    # OpenSSL from 3.5 on gives the second reason.
    with pytest.raises(LinkLostError, match=r"TLS failed|does not speak TLS"):
        server.receive()
    client.close()
    server.close()


def test_answers_that_a_peer_never_reads_are_bounded(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    client, server = joined(lab)
    monkeypatch.setattr(tls_module, "_MOST_UNSENT", 10)
    with pytest.raises(BlockingIOError):
        server.send(b"a" * 16384)
    client.send(b"x")
    with pytest.raises(LinkLostError, match="floods"):
        server.receive()
    client.close()
    server.close()


def test_a_caller_who_says_nothing_is_dropped_in_time(lab: Path) -> None:
    with (
        Listener(tls=files(lab, "server"), handshake_timeout=0.05) as listener,
        socket.create_connection(("127.0.0.1", listener.port), PATIENCE) as silent,
    ):
        while not listener.refused:
            assert listener.accept(in_a_moment()) is None
        assert "no TLS handshake in time" in listener.last_refusal
        assert silent.recv(1) == b""


def test_a_caller_who_says_nothing_is_waited_for_without_work(lab: Path) -> None:
    """A descriptor that is ready all the time would keep a processor busy."""
    with (
        Listener(tls=files(lab, "server")) as listener,
        socket.create_connection(("127.0.0.1", listener.port), PATIENCE),
    ):
        assert select.select([listener.fileno()], [], [], PATIENCE)[0], "a new client"
        assert listener.accept(0.0) is None
        assert not select.select([listener.fileno()], [], [], 0.0)[0]


def test_a_server_may_watch_the_listeners_descriptor(lab: Path) -> None:
    with Listener(tls=files(lab, "server")) as listener:
        link = TcpLink("127.0.0.1", listener.port, tls=files(lab, "client"))
        opener = Background(link.open)
        peer = None
        while peer is None:
            assert select.select([listener.fileno()], [], [], PATIENCE)[0]
            peer = listener.accept(0.0)
        opener.outcome()
        link.write(b"x", soon())
        assert peer.read(soon()) == b"x"
        assert not select.select([listener.fileno()], [], [], 0.0)[0], "who was let in is no business of the door"
        link.close()
        peer.close()


def test_the_line_between_two_turns_away_who_is_still_shaking_hands(lab: Path) -> None:
    with TcpListenLink(tls=files(lab, "server")) as waiting:
        port = waiting.listener.port
        early = [socket.create_connection(("127.0.0.1", port), PATIENCE) for _ in range(3)]
        caller = TcpLink("127.0.0.1", port, tls=files(lab, "client"))
        opener = Background(caller.open)
        while waiting._meet(in_a_moment()) is None:
            pass
        opener.outcome()
        late = socket.create_connection(("127.0.0.1", port), PATIENCE)
        assert waiting.read(in_a_moment()) == b""
        for other in (*early, late):
            assert other.recv(1) == b""
            other.close()
        assert waiting.listener.refused == 4
        caller.write(b"x", soon())
        assert waiting.read(soon()) == b"x"
        caller.close()
