"""Certificates for a lab: a private authority, those that it signs for servers and clients, and what is in one.

Owns the files and their contents (P-256 keys, one purpose per certificate), and whether one can be used: its
authority, its key, its dates. Needs the `cryptography` package, imported when it is used, and only here. Must not
know how a link uses the files (`hexwire.link.tls` does), nor what the names in a certificate mean.

The authority's key decides who may move the robots: do not copy it to the robots.
"""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hexwire.errors import ConfigError, UsageError
from hexwire.folders import make_folder
from hexwire.inputs import read_bytes
from hexwire.new_file import OutputFile

from .tls import TlsFiles

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

__all__ = [
    "CertFacts",
    "CertFiles",
    "check_usable",
    "issue_certificate",
    "make_authority",
    "need_cryptography",
    "read_certificate",
]

AUTHORITY = "ca"
AUTHORITY_DAYS = 3650
# Other vendors' clients refuse server certificates that are valid longer.
CERTIFICATE_DAYS = 825
# The clock of a single-board computer without a real-time clock may be slow when it starts.
_BACKDATED = timedelta(days=1)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}")


@dataclass(frozen=True)
class CertFiles:
    """A certificate and its private key, both PEM.

    Attributes:
        cert: The certificate; public.
        key: Its key, readable only by its owner.
    """

    cert: Path
    key: Path


def make_authority(
    folder: str | Path,
    *,
    name: str = "hexwire lab",
    days: float = AUTHORITY_DAYS,
    now: datetime | None = None,
) -> CertFiles:
    """Create a private authority: ``ca.pem`` and ``ca.key`` in `folder`, which is created if necessary.

    Args:
        folder: Folder for the files.
        name: Name in the certificate.
        days: Validity in days.
        now: Time of creation; for tests.

    Raises:
        UsageError: The files already exist, cannot be written, or `cryptography` is not installed.
    """
    need_cryptography()
    from cryptography import x509

    key = _new_key()
    subject = _subject(name)
    usage = _key_usage(signs_certificates=True)
    builder = _builder(subject, subject, key, days, now)
    certificate = _sign(
        builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False),
        key,
    )
    return _write(Path(folder), AUTHORITY, certificate, key)


def issue_certificate(
    folder: str | Path,
    name: str,
    kind: Literal["server", "client", "both"],
    *,
    hosts: Sequence[str] = (),
    uris: Sequence[str] = (),
    subject: str = "",
    days: float = CERTIFICATE_DAYS,
    now: datetime | None = None,
) -> CertFiles:
    """Create a certificate signed by the authority in `folder`: ``NAME.pem`` and ``NAME.key`` in the same folder.

    Args:
        folder: Folder with ``ca.pem`` and ``ca.key``.
        name: Name of the files and of the subject: letters, digits, ``. _ -``.
        kind: Purpose: to listen, to connect, or both.
        hosts: Host names and addresses of what listens; without any, its name and loopback.
        uris: Names in the form of URIs, in ASCII, for programs that read rights from them.
        subject: Name of the subject, if it differs from that of the files.
        days: Validity in days, at most that of the authority.
        now: Time of creation; for tests.

    Raises:
        UsageError: There is no authority, a name is wrong, the files already exist or cannot be written, or
            `cryptography` is not installed.
    """
    need_cryptography()
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    if not _NAME.fullmatch(name) or name == AUTHORITY:
        raise UsageError(f"{name!r} cannot name a certificate: use letters, digits, '.', '_' and '-', and not 'ca'")
    authority, authority_key = _load_authority(Path(folder))
    key = _new_key()
    purposes = [ExtendedKeyUsageOID.SERVER_AUTH] if kind != "client" else []
    purposes += [ExtendedKeyUsageOID.CLIENT_AUTH] if kind != "server" else []
    issuer_id = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key())
    builder = (
        _builder(_subject(subject or name), authority.subject, key, days, now)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(issuer_id, critical=False)
    )
    if kind == "client" and hosts:
        raise UsageError("only a server's certificate has hosts: a client is identified by its name")
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(uri) for uri in uris]
    if kind != "client":
        names += [_alternative_name(host) for host in hosts or (name, "localhost", "127.0.0.1", "::1")]
    if names:
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    return _write(Path(folder), name, _sign(builder, authority_key), key)


def need_cryptography() -> None:
    """Raise `UsageError` if the package is not installed."""
    try:
        import cryptography  # noqa: F401 (imported here, so that the error names the remedy)
    except ImportError as error:
        raise UsageError("certificates need the package cryptography: pip install 'hexwire[tls]'") from error


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _subject(name: str) -> x509.Name:
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    if not 1 <= len(name) <= 64 or not name.isprintable():
        raise UsageError(f"{name!r} cannot name a certificate: 1 to 64 printable characters are needed")
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _alternative_name(host: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not re.fullmatch(r"(?!-)[A-Za-z0-9-]{1,63}(\.(?!-)[A-Za-z0-9-]{1,63})*", host.replace("_", "-")):
        raise UsageError(f"{host!r} is neither a host name nor an IP address")
    return x509.DNSName(host)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    from cryptography import x509

    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: EllipticCurvePrivateKey, days: float, now: datetime | None
) -> x509.CertificateBuilder:
    from cryptography import x509

    if not 0 < days <= 36500:
        raise UsageError(f"a certificate is valid for 1 to 36500 days, not {days:g}")
    start = now or datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(start - _BACKDATED)
        .not_valid_after(start + timedelta(days=days))
    )


def _sign(builder: x509.CertificateBuilder, key: EllipticCurvePrivateKey) -> x509.Certificate:
    from cryptography.hazmat.primitives import hashes

    return builder.sign(key, hashes.SHA256())


def _load_authority(folder: Path) -> tuple[x509.Certificate, EllipticCurvePrivateKey]:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    files = (folder / f"{AUTHORITY}.pem", folder / f"{AUTHORITY}.key")
    try:
        cert_text, key_text = (read_bytes(path) for path in files)
    except ConfigError as error:
        raise UsageError(f"no authority in {folder} ({error}); create one first, and keep its key") from None
    try:
        key = load_pem_private_key(key_text, password=None)
        certificate = x509.load_pem_x509_certificate(cert_text)
    except (ValueError, TypeError) as error:
        raise UsageError(f"{files[0]} and {files[1]} are not an authority's certificate and key") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or certificate.public_key() != key.public_key():
        raise UsageError(f"{files[1]} is not the key of {files[0]}")
    return certificate, key


def _write(folder: Path, name: str, certificate: x509.Certificate, key: EllipticCurvePrivateKey) -> CertFiles:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    files = CertFiles(folder / f"{name}.pem", folder / f"{name}.key")
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        make_folder(folder)
        for path in (files.cert, files.key):
            if os.path.lexists(path):
                raise UsageError(f"{path} already exists; remove it first, or choose another name")
        # A certificate is public, its key is not.
        with OutputFile(files.key) as key_file, OutputFile(files.cert, mode=0o644) as cert_file:
            key_file.file.write(secret)
            cert_file.file.write(certificate.public_bytes(Encoding.PEM))
    except OSError as error:
        raise UsageError(f"cannot write {error.filename or folder}: {error.strerror}") from error
    return files


@dataclass(frozen=True, slots=True)
class CertFacts:
    """What stands in a certificate.

    Attributes:
        path: Its file.
        common_name: Common name of its subject; empty if there is none.
        uris: Its names in the form of URIs.
        expires: End of its validity.
        signed: Whether the given authority signed it; True if none was given.
        authority: Whether it can sign others.
    """

    path: Path
    common_name: str
    uris: tuple[str, ...]
    expires: datetime
    signed: bool
    authority: bool


def read_certificate(path: str | Path, ca: str | Path | None = None) -> CertFacts:
    """Read a certificate.

    Args:
        path: A PEM file.
        ca: Certificate of the authority that should have signed it.

    Raises:
        UsageError: It is not a certificate, or `cryptography` is not installed.
    """
    need_cryptography()
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature
    from cryptography.x509.oid import NameOID

    certificate = _load(path)
    signed = True
    if ca is not None:
        try:
            certificate.verify_directly_issued_by(_load(ca))
        except (ValueError, TypeError, InvalidSignature):
            signed = False
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        extensions = certificate.extensions
        uris: list[str] = []
        authority = False
        for extension in extensions:
            if isinstance(extension.value, x509.SubjectAlternativeName):
                uris += extension.value.get_values_for_type(x509.UniformResourceIdentifier)
            elif isinstance(extension.value, x509.BasicConstraints):
                authority = extension.value.ca
    except ValueError as error:
        raise UsageError(f"{path} is not a valid certificate: {error}") from None
    return CertFacts(
        Path(path),
        str(names[0].value) if names else "",
        tuple(uris),
        certificate.not_valid_after_utc,
        signed,
        authority,
    )


def _load(path: str | Path) -> x509.Certificate:
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(read_bytes(path))
    except ConfigError as error:
        raise UsageError(f"cannot read the certificate {error}") from None
    except ValueError:
        raise UsageError(f"{path} is not a certificate in PEM form") from None


def check_usable(files: TlsFiles, now: datetime | None = None) -> CertFacts:
    """Check that a program can use certificate and key, so that an error names the file and not a connection.

    Args:
        files: The files.
        now: The time; for tests.

    Raises:
        UsageError: A file cannot be read, the key belongs to another certificate, or the certificate has expired or
            is not of that authority.
    """
    files.client_context()
    facts = read_certificate(files.cert, files.ca)
    if not facts.signed:
        raise UsageError(f"{files.cert} was not signed by the authority {files.ca}")
    if facts.expires < (now or datetime.now(UTC)):
        raise UsageError(
            f"the certificate {files.cert} expired on {facts.expires:%Y-%m-%d %H:%M} UTC; issue a new one"
        )
    return facts
