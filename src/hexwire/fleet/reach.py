"""Why a server or router cannot be reached, in one line.

Owns the questions that Zenoh does not answer: does anybody listen, is its certificate the expected one, does it
accept ours. Must not know Zenoh.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import closing

from hexwire.errors import UsageError
from hexwire.link.tls import TlsFiles

from .endpoints import UNIX, host_and_port

__all__ = ["why_unreachable"]

_PATIENCE = 2.0
"""Seconds for each step."""
# OpenSSL's names of what the other side says of our certificate.
_REFUSED = ("ALERT_UNKNOWN_CA", "CERTIFICATE", "ALERT_ACCESS_DENIED", "ALERT_DECRYPT_ERROR")
_EXPIRED = ("CERTIFICATE_EXPIRED",)
_RIGHT_NAME = "running, and the address right?"


def why_unreachable(endpoint: str, files: TlsFiles | None) -> str:
    """Why no session could be opened to an endpoint.

    Args:
        endpoint: As in ``tls/lab-pc:7447``.
        files: Own certificates, for TLS.
    """
    kind, _, rest = endpoint.partition("/")
    if kind == UNIX:
        return f"the server behind {rest} does not answer; is its program stopped?"
    try:
        kind, host, port = host_and_port(endpoint)
    except UsageError as error:
        return str(error)
    try:
        connection = socket.create_connection((host, port), _PATIENCE)
    except socket.gaierror:
        return f"{endpoint}: there is no computer {host} in this network"
    except TimeoutError:
        return f"{endpoint}: no answer; is the computer on, and does its firewall let this port through?"
    except OSError as error:
        return f"nobody answers at {endpoint} ({error.strerror}); is the server or router {_RIGHT_NAME}"
    with closing(connection):
        if kind == "tcp" or files is None:
            return f"{endpoint} answers, but not as a server or router: is it stopped, or does it want tls/?"
        return f"{endpoint}: {_handshake(connection, host, files)}"


def _handshake(connection: socket.socket, host: str, files: TlsFiles) -> str:
    try:
        context = files.client_context()
    except UsageError as error:
        return str(error)
    try:
        with context.wrap_socket(connection, server_hostname=host) as tls:
            # In TLS 1.3 the other side refuses our certificate after the handshake.
            tls.recv(1)
    except ssl.SSLCertVerificationError as error:
        why = error.verify_message
        if "expired" in why:
            return "its certificate has expired; issue a new one for it"
        if "mismatch" in why or "not valid for" in why:
            return f"its certificate is not for the host {host}; issue one with --host {host}, or use its name"
        return f"its certificate is not of the authority {files.ca} ({why})"
    except ssl.SSLError as error:
        reason = error.reason or str(error)
        if any(word in reason for word in _EXPIRED):
            return f"it refuses the certificate {files.cert}, which has expired by its clock"
        if any(word in reason for word in _REFUSED):
            return f"it refuses the certificate {files.cert}: another authority's, or not for connecting"
        return f"no TLS ({reason}); is it a router for tcp/ only?"
    except TimeoutError:
        return "it accepts the certificate, but does not answer; is its program stopped, or not a router?"
    except OSError as error:
        return f"it ends the connection ({error.strerror})"
    return "it ends the connection; is it a server or router?"
