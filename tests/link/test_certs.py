from __future__ import annotations

import builtins
import os
import stat
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hexwire.errors import UsageError
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.link.tls import TlsFiles

NOW = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)


def load(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def names_of(certificate: x509.Certificate) -> tuple[list[str], list[object]]:
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return names.get_values_for_type(x509.DNSName), names.get_values_for_type(x509.IPAddress)


def test_an_authority_and_what_it_signs(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "certs"
    authority = make_authority(folder, name="Lab 7", now=NOW)
    server = issue_certificate(folder, "arm-1", "server", hosts=["arm-1.lab", "10.0.0.5", "fd00::5"], now=NOW)
    client = issue_certificate(folder, "host", "client", days=30, now=NOW)
    assert sorted(path.name for path in folder.iterdir()) == [
        "arm-1.key",
        "arm-1.pem",
        "ca.key",
        "ca.pem",
        "host.key",
        "host.pem",
    ]
    ca, arm, host = load(authority.cert), load(server.cert), load(client.cert)
    arm.verify_directly_issued_by(ca)
    host.verify_directly_issued_by(ca)
    assert ca.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == "Lab 7"
    assert host.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == "host"
    assert ca.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert not host.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    purposes = [cert.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value for cert in (arm, host)]
    assert [list(purpose) for purpose in purposes] == [
        [ExtendedKeyUsageOID.SERVER_AUTH],
        [ExtendedKeyUsageOID.CLIENT_AUTH],
    ]
    assert names_of(arm) == (["arm-1.lab"], [ip_address("10.0.0.5"), ip_address("fd00::5")])
    assert host.not_valid_before_utc == NOW - timedelta(days=1)
    assert host.not_valid_after_utc == NOW + timedelta(days=30)
    assert arm.serial_number != host.serial_number
    for files in (authority, server, client):
        assert stat.S_IMODE(files.key.stat().st_mode) == 0o600


def test_the_ssl_module_takes_the_files(tmp_path: Path) -> None:
    authority = make_authority(tmp_path)
    server = issue_certificate(tmp_path, "server", "server")
    TlsFiles(str(authority.cert), str(server.cert), str(server.key)).server_context()
    TlsFiles(str(authority.cert), str(server.cert), str(server.key)).client_context()


def test_a_server_without_hosts_is_called_by_its_name_or_on_loopback(tmp_path: Path) -> None:
    make_authority(tmp_path)
    files = issue_certificate(tmp_path, "arm", "server")
    assert names_of(load(files.cert)) == (["arm", "localhost"], [ip_address("127.0.0.1"), ip_address("::1")])


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    first = make_authority(tmp_path)
    before = first.key.read_bytes()
    with pytest.raises(UsageError, match=r"ca\.pem already exists"):
        make_authority(tmp_path)
    issue_certificate(tmp_path, "arm", "server")
    with pytest.raises(UsageError, match=r"arm\.pem already exists"):
        issue_certificate(tmp_path, "arm", "client")
    (tmp_path / "arm.pem").unlink()
    with pytest.raises(UsageError, match=r"arm\.key already exists"):
        issue_certificate(tmp_path, "arm", "client")
    assert first.key.read_bytes() == before


@pytest.mark.parametrize("name", ["", "ca", "../ca", "a/b", "-x", "x" * 70, "é"])
def test_names_that_cannot_be_files(tmp_path: Path, name: str) -> None:
    make_authority(tmp_path)
    with pytest.raises(UsageError, match="cannot name a certificate"):
        issue_certificate(tmp_path, name, "client")


def test_other_wrong_wishes(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no authority in .*ca\.pem: cannot be read: No such file"):
        issue_certificate(tmp_path, "arm", "server")
    with pytest.raises(UsageError, match="1 to 64 printable characters"):
        make_authority(tmp_path, name="")
    with pytest.raises(UsageError, match="1 to 36500 days"):
        make_authority(tmp_path, days=0)
    with pytest.raises(UsageError, match="choose another place"):
        make_authority("/proc/certs")
    make_authority(tmp_path)
    with pytest.raises(UsageError, match="'a b' is neither a host name nor an IP address"):
        issue_certificate(tmp_path, "arm", "server", hosts=["a b"])
    with pytest.raises(UsageError, match="a client is identified by its name"):
        issue_certificate(tmp_path, "arm", "client", hosts=["arm"])


def test_an_invalid_authority_is_refused(tmp_path: Path) -> None:
    make_authority(tmp_path)
    make_authority(tmp_path / "other")
    (tmp_path / "ca.key").write_bytes((tmp_path / "other" / "ca.key").read_bytes())
    with pytest.raises(UsageError, match=r"ca\.key is not the key of"):
        issue_certificate(tmp_path, "arm", "server")
    (tmp_path / "ca.key").write_text("nonsense")
    with pytest.raises(UsageError, match="are not an authority's certificate and key"):
        issue_certificate(tmp_path, "arm", "server")


def test_without_the_package_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: object) -> object:
        if name == "cryptography":
            raise ImportError(name)
        return real(name, *rest)  # type: ignore[arg-type]  # passed on as it came

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(UsageError, match=r"pip install 'hexwire\[tls\]'"):
        make_authority(tmp_path)


def test_each_certificate_may_do_what_it_is_for_and_nothing_else(tmp_path: Path) -> None:
    authority = load(make_authority(tmp_path).cert)
    certificates = [load(issue_certificate(tmp_path, kind, kind).cert) for kind in ("server", "client")]  # type: ignore[arg-type]  # the two kinds
    for certificate in (authority, *certificates):
        signs = certificate is authority
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage)
        assert usage.critical
        value = usage.value
        assert (value.digital_signature, value.key_cert_sign, value.crl_sign) == (not signs, signs, signs)
        assert not any(
            (value.content_commitment, value.key_encipherment, value.data_encipherment, value.key_agreement)
        )
        limits = certificate.extensions.get_extension_for_class(x509.BasicConstraints)
        assert limits.critical
        assert (limits.value.ca, limits.value.path_length) == ((True, 0) if signs else (False, None))
        key = certificate.public_key()
        assert isinstance(key, EllipticCurvePublicKey)
        assert key.curve.name == "secp256r1"
        own = certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier)
        assert own.value == x509.SubjectKeyIdentifier.from_public_key(key)
        assert not own.critical
        assert isinstance(certificate.signature_hash_algorithm, SHA256)
    for certificate in certificates:
        issuer = certificate.extensions.get_extension_for_class(x509.AuthorityKeyIdentifier)
        authority_id = authority.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
        assert issuer.value.key_identifier == authority_id.digest
        assert not issuer.critical
        assert not certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).critical
    names = certificates[0].extensions.get_extension_for_class(x509.SubjectAlternativeName)
    assert not names.critical
    with pytest.raises(x509.ExtensionNotFound):
        certificates[1].extensions.get_extension_for_class(x509.SubjectAlternativeName)


def test_a_certificate_can_be_read_by_all_and_is_valid_from_yesterday(tmp_path: Path) -> None:
    before = datetime.now(UTC)
    files = make_authority(tmp_path)
    assert stat.S_IMODE(files.cert.stat().st_mode) & 0o644 == 0o644 & ~current_umask()
    certificate = load(files.cert)
    start = certificate.not_valid_before_utc + timedelta(days=1)
    assert before - timedelta(seconds=1) <= start <= datetime.now(UTC)
    assert certificate.not_valid_after_utc - start == timedelta(days=3650)
    arm = load(issue_certificate(tmp_path, "arm", "server").cert)
    assert arm.not_valid_after_utc - arm.not_valid_before_utc == timedelta(days=826)


def current_umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


@pytest.mark.parametrize(("days", "possible"), [(0.5, True), (36500, True), (36500.5, False), (-1, False)])
def test_how_long_a_certificate_may_be_valid(tmp_path: Path, days: float, possible: bool) -> None:
    if possible:
        certificate = load(make_authority(tmp_path, days=days, now=NOW).cert)
        assert certificate.not_valid_after_utc == NOW + timedelta(days=days)
    else:
        with pytest.raises(UsageError, match="1 to 36500 days"):
            make_authority(tmp_path, days=days)


@pytest.mark.parametrize(("name", "possible"), [("x" * 64, True), ("x" * 65, False), ("a\nb", False)])
def test_names_of_an_authority(tmp_path: Path, name: str, possible: bool) -> None:
    if possible:
        assert load(make_authority(tmp_path, name=name).cert).subject.rfc4514_string() == f"CN={name}"
    else:
        with pytest.raises(UsageError, match="1 to 64 printable characters"):
            make_authority(tmp_path, name=name)


@pytest.mark.parametrize(
    ("host", "possible"),
    [
        ("arm_1.lab", True),
        ("a" * 63, True),
        ("a" * 64, False),
        ("-arm", False),
        ("arm.-lab", False),
        ("a..b", False),
    ],
)
def test_names_of_hosts(tmp_path: Path, host: str, possible: bool) -> None:
    make_authority(tmp_path)
    if possible:
        assert names_of(load(issue_certificate(tmp_path, "arm", "server", hosts=[host]).cert)) == ([host], [])
    else:
        with pytest.raises(UsageError, match="neither a host name nor an IP address"):
            issue_certificate(tmp_path, "arm", "server", hosts=[host])
