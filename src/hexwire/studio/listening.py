"""Where the studio may listen: on this machine, or elsewhere with TLS and a password or client certificates.

Owns these rules, and which names of hosts are those of the studio. Must not know sockets or pages.
"""

from __future__ import annotations

import ipaddress
import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import read_bytes, read_text
from hexwire.link.tls import TlsFiles

from .access import SHORTEST_PASSWORD, Right

__all__ = ["check_protected", "check_tls", "host_names", "is_local", "parse_listen", "read_password", "right_of"]

_LOCAL = ("127.0.0.1", "localhost", "[::1]")


def parse_listen(text: str) -> tuple[str, int]:
    """Read ``PORT``, ``HOST:PORT`` or ``[IPV6]:PORT``.

    Raises:
        UsageError: It is none of them.
    """
    host, _, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    if not port.isascii() or not port.isdigit() or int(port) > 65535 or (":" in host and not bracketed):
        raise UsageError(f"--listen {text}: write PORT, HOST:PORT or [IPV6]:PORT")
    return (host.strip("[]") or "127.0.0.1"), int(port)


def is_local(host: str) -> bool:
    """Whether only this machine can reach that address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_protected(host: str, *, cert: str, key: str, ca: str, password: bool) -> None:
    """Check that an address is protected as it must be; opens nothing.

    Args:
        host: The address.
        cert: File of the studio's certificate; empty for no TLS.
        key: File of its key.
        ca: File of the authority of client certificates; empty if none is required.
        password: A password is required.

    Raises:
        UsageError: It is not.
    """
    if bool(cert) != bool(key):
        raise UsageError("--cert and --key belong together")
    if ca and not cert:
        raise UsageError("--ca checks client certificates, which need TLS: add --cert and --key")
    if is_local(host):
        return
    if not cert:
        raise UsageError(
            f"{host} can be reached from other machines, where anybody could read the key of the page: add --cert "
            "and --key ('hexwire cert new DIR --host NAME' makes them), and --password-file or --ca"
        )
    if not (password or ca):
        raise UsageError(
            f"{host} can be reached from other machines: add --password-file FILE, or --ca FILE to require client "
            "certificates"
        )


def check_tls(cert: str, key: str, ca: str) -> None:
    """Check that the files can be used, so that an error names the file; raises `UsageError` if not."""
    # The check needs an authority; a certificate is one for this purpose, since nothing is verified here.
    TlsFiles(ca or cert, cert, key).server_context()


def host_names(host: str, port: int, cert: str = "", *, secure: bool = False) -> frozenset[str]:
    """Values of the Host header that name the studio.

    Args:
        host: Address at which it listens.
        port: Its port.
        cert: File of its certificate, whose names count too.
        secure: It is reached over TLS.
    """
    names = set(_LOCAL) if is_local(host) else set()
    if not _is_any(host):
        names.add(f"[{host}]" if ":" in host else host)
    names |= _names_in(cert) if cert else set()
    usual = 443 if secure else 80
    with_port = {f"{name.lower()}:{port}" for name in names}
    return frozenset(with_port | ({name.lower() for name in names} if port == usual else set()))


def _is_any(host: str) -> bool:
    """Whether it stands for all addresses of this machine, and so for no name."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False


def _names_in(cert: str) -> set[str]:
    from cryptography import x509

    found = x509.load_pem_x509_certificate(read_bytes(cert))
    try:
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return set()
    addresses = names.get_values_for_type(x509.IPAddress)
    return {
        *names.get_values_for_type(x509.DNSName),
        *(f"[{each}]" if each.version == 6 else str(each) for each in addresses),
    }


def read_password(file: str) -> str:
    """Read the password out of a file.

    Raises:
        UsageError: It cannot be read, others may read it, or the password is too short.
    """
    try:
        if os.name == "posix" and stat.S_IMODE(Path(file).stat().st_mode) & 0o077:
            raise UsageError(f"{file} can be read by others; run 'chmod 600 {file}'")
        password = read_text(file).rstrip("\r\n")
    except (OSError, ConfigError) as error:
        raise UsageError(f"the password cannot be read: {error}") from None
    if len(password) < SHORTEST_PASSWORD:
        raise UsageError(f"the password in {file} is too short: use at least {SHORTEST_PASSWORD} characters")
    return password


def right_of(peer: Mapping[str, Any]) -> Right | None:
    """What the holder of a client certificate may do; None for certificates of arms and routers.

    Args:
        peer: What stands in a verified certificate, as `ssl.SSLObject.getpeercert` returns it.
    """
    from hexwire.fleet.rights import Kind, Rights

    uris = [value for kind, value in peer.get("subjectAltName", ()) if kind == "URI"]
    try:
        rights = Rights.from_uris(uris)
    except UsageError:
        return None
    if rights is None or rights.kind in (Kind.OPERATOR, Kind.MAINTAINER):
        # A certificate without a role opens the line of an arm (tcps://), which is more than this.
        return Right.OPERATE
    return Right.WATCH if rights.kind is Kind.OBSERVER else None
