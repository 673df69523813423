"""TLS for TCP links: both ends show a certificate of the lab's own authority.

Owns the settings (TLS 1.2 or later, client certificates required) and TLS over a non-blocking socket. Must not
know what the bytes mean. `hexwire.link.certs` makes the certificates.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
from collections.abc import Sequence
from dataclasses import dataclass

from hexwire.errors import ConfigError, LinkLostError, UsageError
from hexwire.inputs import read_bytes
from hexwire.system import READABLE, WRITABLE

from .url import LinkUrl

__all__ = ["TlsFiles", "TlsStream"]

_READ_SIZE = 65536
_RECORD = 16384  # a TLS record carries no more
_RECORD_HEADER = 5  # type, version, length
# Maximum bytes of the protocol's own answers (to key updates) that a peer may leave unread.
_MOST_UNSENT = 65536
# OpenSSL's errors when a peer refuses our certificate.
_REFUSALS = (
    "CERTIFICATE_REQUIRED",
    "UNKNOWN_CA",
    "BAD_CERTIFICATE",
    "CERTIFICATE_EXPIRED",
    "CERTIFICATE_REVOKED",
    "CERTIFICATE_UNKNOWN",
    "UNSUPPORTED_CERTIFICATE",
    "HANDSHAKE_FAILURE",
    "ACCESS_DENIED",
)
_NOT_TLS = (
    "WRONG_VERSION_NUMBER",
    "HTTP_REQUEST",
    "UNEXPECTED_MESSAGE",
    "RECORD_LAYER_FAILURE",
    "HTTPS_PROXY_REQUEST",
)


@dataclass(frozen=True)
class TlsFiles:
    """Paths of the certificates.

    Attributes:
        ca: The authority whose signature is trusted, PEM.
        cert: Our own certificate, PEM.
        key: Its private key, PEM, without a pass phrase.
        name: Name that the server's certificate must have; if empty, the host of the connection.
    """

    ca: str
    cert: str
    key: str
    name: str = ""

    @classmethod
    def from_url(cls, url: LinkUrl, also_known: Sequence[str] = ()) -> TlsFiles:
        """Read the paths from ``?ca=...&cert=...&key=...``."""
        url.check_keys(("ca", "cert", "key", "name", *also_known))
        url.check_no_path()
        for key in ("ca", "cert", "key"):
            if key not in url.query:
                raise UsageError(
                    f"{url.text}: the option {key}=FILE is missing; 'hexwire cert new' creates the files"
                )
        return cls(url.query["ca"], url.query["cert"], url.query["key"], url.query.get("name", ""))

    def client_context(self) -> ssl.SSLContext:
        """Settings of the client side.

        Raises:
            UsageError: A file cannot be read or used.
        """
        return self._load(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT))

    def server_context(self) -> ssl.SSLContext:
        """Settings of the listening side.

        Raises:
            UsageError: A file cannot be read or used.
        """
        context = self._load(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER))
        context.num_tickets = 0  # lines are long-lived; there is nothing to resume
        return context

    def _load(self, context: ssl.SSLContext) -> ssl.SSLContext:
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.verify_mode = ssl.CERT_REQUIRED
        context.options |= ssl.OP_NO_RENEGOTIATION
        for what, file in (("authority", self.ca), ("certificate", self.cert), ("key", self.key)):
            # OpenSSL would wait for a pipe, and read a device forever.
            try:
                read_bytes(file)
            except ConfigError as error:
                raise UsageError(f"cannot read the {what} {error}") from None
        try:
            context.load_verify_locations(self.ca)
        except ssl.SSLError as error:
            raise UsageError(f"{self.ca} is not an authority's certificate in PEM form") from error
        try:
            # With an empty pass phrase, OpenSSL does not ask on the terminal.
            context.load_cert_chain(self.cert, self.key, password="")
        except (ssl.SSLError, OSError) as error:
            raise UsageError(
                f"{self.cert} and {self.key} are not a certificate and its key in PEM form, without a pass phrase"
            ) from error
        return context


class TlsStream:
    """TLS over a connected, non-blocking socket.

    It has its own buffers between TLS and the socket, so that a write abandoned half-way does not break the
    protocol, and one thread may receive while another sends.
    """

    def __init__(self, connected: socket.socket, context: ssl.SSLContext, *, host: str | None = None) -> None:
        """Wrap a socket; `host` is the name that the server must have, None on the listening side."""
        self.socket = connected
        self._incoming = ssl.MemoryBIO()
        self._outgoing = ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=host is None, server_hostname=host)
        self._lock = threading.Lock()
        self._unsent = b""
        self._in_flight = 0
        self._shaken = False
        self._record = b""

    @property
    def wants(self) -> int:
        """Events that poll should wait for during the handshake."""
        return READABLE | WRITABLE if self._unsent else READABLE

    def handshake(self) -> bool:
        """Continue the handshake with the available bytes; True when it is complete.

        Raises:
            LinkLostError: It failed; the text gives the reason.
        """
        with self._lock:
            while not self._shaken:
                try:
                    self._tls.do_handshake()
                    self._shaken = True
                except ssl.SSLWantReadError:
                    self._flush()
                    # No byte beyond a record: later bytes must stay in the socket, where poll can see them.
                    if self._unsent or not self._fetch(self._record_rest()):
                        return False
                except ssl.SSLError as error:
                    self._flush()  # the alert that tells the other end
                    self._drain()
                    raise LinkLostError(_explain(error)) from error
            self._flush()
            return not self._unsent

    def receive(self) -> bytes:
        with self._lock:
            if not self._fetch(_READ_SIZE):
                return b""
            pieces = []
            ended = False
            try:
                # Read everything, since poll sees only the socket and not the bytes inside TLS.
                while piece := self._tls.read(_READ_SIZE):
                    pieces.append(piece)
                ended = True  # the other end has closed the session
            except ssl.SSLWantReadError:
                pass
            except ssl.SSLError as error:
                raise LinkLostError(_explain(error)) from error
            if ended:
                if not pieces:
                    raise LinkLostError("the other end closed the connection")
                # Reported next time, even if the other end keeps the socket open.
                with contextlib.suppress(OSError):
                    self.socket.shutdown(socket.SHUT_RD)
            self._flush()
            if len(self._unsent) > _MOST_UNSENT:
                raise LinkLostError("the other end floods the line with TLS key updates")
            return b"".join(pieces)

    def send(self, data: memoryview | bytes) -> int:
        with self._lock:
            self._flush()
            if not self._unsent and not self._in_flight:
                try:
                    self._in_flight = self._tls.write(data[:_RECORD])
                except ssl.SSLError as error:
                    raise LinkLostError(_explain(error)) from error
                self._flush()
            if self._unsent:
                raise BlockingIOError
            sent, self._in_flight = self._in_flight, 0
            return sent

    def given_up(self) -> None:
        """Data that TLS has encrypted must still be sent first, but no longer belong to a write."""
        with self._lock:
            self._in_flight = 0

    def close(self) -> None:
        with self._lock, contextlib.suppress(OSError):
            if self._shaken:
                with contextlib.suppress(ssl.SSLError):
                    self._tls.unwrap()
            self._flush()
        self.socket.close()

    def _fetch(self, most: int) -> bool:
        """Move bytes from the socket to TLS; False if there were none."""
        try:
            data = self.socket.recv(most)
        except BlockingIOError:
            return False
        except ConnectionError:
            data = b""
        if not data:
            raise LinkLostError("the other end closed the connection")
        self._incoming.write(data)
        if not self._shaken:
            self._record += data
        return True

    def _record_rest(self) -> int:
        """Number of bytes missing from the header, or otherwise from the body, of the incoming record."""
        if len(self._record) >= _RECORD_HEADER:
            whole = _RECORD_HEADER + int.from_bytes(self._record[3:5], "big")
            if len(self._record) < whole:
                return whole - len(self._record)
            self._record = b""
        return _RECORD_HEADER - len(self._record)

    def _drain(self) -> None:
        """Read pending bytes; otherwise closing would reset the connection and the alert would be lost."""
        with contextlib.suppress(OSError):
            self.socket.recv(_READ_SIZE)

    def _flush(self) -> None:
        """Move encrypted bytes to the socket, as far as possible."""
        if self._outgoing.pending:
            self._unsent += self._outgoing.read()
        while self._unsent:
            try:
                sent = self.socket.send(self._unsent)
            except BlockingIOError:
                return
            except ConnectionError as error:
                raise LinkLostError("the other end closed the connection") from error
            self._unsent = self._unsent[sent:]


def _explain(error: ssl.SSLError) -> str:
    reason = error.reason or str(error)
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of the other end is not valid: {error.verify_message}"
    if "PEER_DID_NOT_RETURN_A_CERTIFICATE" in reason:
        return "the other end showed no certificate"
    if any(refusal in reason for refusal in _REFUSALS):
        said = reason.lower().replace("_", " ")
        return f"the other end refuses our certificate ({said}); is it signed by the same authority, and in date?"
    if any(word in reason for word in _NOT_TLS):
        return "the other end does not speak TLS"
    return f"TLS failed: {reason.lower().replace('_', ' ')}"
