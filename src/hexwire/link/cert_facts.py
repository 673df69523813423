"""What stands in a certificate, and whether it can be used: its authority, its key, its dates.

Owns reading; `hexwire.link.certs` writes. Needs the `cryptography` package, imported when it is used. Must not know
what the names in a certificate mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import read_bytes

from .certs import need_cryptography
from .tls import TlsFiles

if TYPE_CHECKING:
    from cryptography import x509

__all__ = ["CertFacts", "check_usable", "read_certificate"]


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
