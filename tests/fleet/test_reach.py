"""Why a server or router cannot be reached: each reason in one line."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.link.far_ends import free_port

from hexwire.errors import LinkNotFoundError
from hexwire.fleet import network
from hexwire.fleet.network import Network, why_unreachable
from hexwire.fleet.rights import Kind
from hexwire.link import certs
from hexwire.link.tls import TlsFiles

from .lab import LONG_AGO, Lab


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    lab.issue("elsewhere", Kind.ROUTER, hosts=["lab-pc"])
    lab.issue("old", Kind.ROUTER, now=LONG_AGO, days=1)
    return lab


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two seconds may be short for a handshake on a busy machine.
    monkeypatch.setattr(network, "_PATIENCE", 30.0)


@contextmanager
def listening(files: TlsFiles) -> Iterator[str]:
    """Somebody who shakes hands and says nothing more."""
    context = files.server_context()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(30)

        def serve() -> None:
            try:
                connection, _ = server.accept()
                with connection, context.wrap_socket(connection, server_side=True) as tls:
                    tls.recv(1)
            except (OSError, ssl.SSLError):
                pass

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"tls/localhost:{server.getsockname()[1]}"
        finally:
            thread.join()


def of(lab: Lab, name: str) -> TlsFiles:
    return TlsFiles(**lab.files(name))


@pytest.mark.parametrize(
    ("server", "words"),
    [
        ("elsewhere", "its certificate is not for the host localhost"),
        ("old", "its certificate has expired"),
        ("router", "it accepts the certificate, but does not answer"),
    ],
)
def test_what_its_certificate_says(lab: Lab, server: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if server == "router":
        monkeypatch.setattr(network, "_PATIENCE", 1.0)
    with listening(of(lab, server)) as endpoint:
        text = why_unreachable(endpoint, of(lab, "anna"))
    assert text.startswith(f"{endpoint}: {words}")


def test_the_authority_of_another_lab(lab: Lab, tmp_path: Path) -> None:
    other = Lab(tmp_path)
    other.issue("anna", Kind.OPERATOR, "lab/*")
    with lab.routing():
        with pytest.raises(LinkNotFoundError, match="its certificate is not of the authority") as raised:
            Network(connect=(lab.endpoint,), **other.files("anna")).open()
        assert "\n" not in str(raised.value)


def test_it_refuses_ours(lab: Lab, tmp_path: Path) -> None:
    other = Lab(tmp_path)
    other.issue("anna", Kind.OPERATOR, "lab/*")
    other.issue("old", Kind.OPERATOR, "lab/*", now=LONG_AGO, days=1)
    (tmp_path / "ca.pem").write_bytes((lab.folder / "ca.pem").read_bytes())
    lab.issue("expired", Kind.OPERATOR, "lab/*", now=LONG_AGO, days=1)
    with lab.routing():
        for files, words in (
            (of(other, "anna"), "it refuses the certificate"),
            (of(lab, "expired"), "has expired by its clock"),
        ):
            assert words in why_unreachable(lab.endpoint, files)


def test_no_session_opens_with_a_certificate_of_another_authority_an_expired_one_or_none(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As a program would that does not look at its own certificate.
    monkeypatch.setattr(certs, "check_usable", lambda files: None)
    other = Lab(tmp_path)
    other.issue("anna", Kind.OPERATOR, "lab/*")
    (tmp_path / "ca.pem").write_bytes((lab.folder / "ca.pem").read_bytes())
    lab.issue("ended", Kind.OPERATOR, "lab/*", now=LONG_AGO, days=1)
    with lab.routing():
        for files in (other.files("anna"), lab.files("ended")):
            with pytest.raises(LinkNotFoundError, match="it refuses the certificate") as raised:
                Network(connect=(lab.endpoint,), **files).open()
            assert "\n" not in str(raised.value)
        nothing = ssl.create_default_context(cafile=lab.files("anna")["ca"])
        with socket.create_connection(("127.0.0.1", lab.port), 5) as plain:
            tls = nothing.wrap_socket(plain, server_hostname="localhost")
            with tls, pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"):
                tls.recv(1)


def test_nobody_and_nothing(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert why_unreachable(endpoint, None).startswith(f"nobody answers at {endpoint} (Connection refused)")
    assert "no computer" in why_unreachable("tcp/no-such-host.invalid:1", None)
    assert "does not answer" in why_unreachable(f"unixsock-stream/{tmp_path}/a", None)
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert "does it want tls/?" in why_unreachable(f"tcp/127.0.0.1:{server.getsockname()[1]}", None)


def test_a_plain_router_asked_for_tls(lab: Lab) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(30)

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"this is no TLS at all")

        thread = threading.Thread(target=serve)
        thread.start()
        text = why_unreachable(f"tls/localhost:{server.getsockname()[1]}", of(lab, "anna"))
        thread.join()
    assert "no TLS" in text or "ends the connection" in text


def test_what_is_no_tls_is_told_in_a_word(lab: Lab) -> None:
    near, far = socket.socketpair()
    with near, far:
        far.sendall(b"this is no TLS at all" * 10)
        near.settimeout(30.0)
        text = network._handshake(near, "localhost", of(lab, "anna"))
    assert text == "no TLS (WRONG_VERSION_NUMBER); is it a router for tcp/ only?"
