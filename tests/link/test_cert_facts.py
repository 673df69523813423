"""What stands in a certificate, and whether it can be used."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from hexwire.errors import UsageError
from hexwire.link.certs import check_usable, issue_certificate, make_authority, read_certificate
from hexwire.link.tls import TlsFiles

NOW = datetime(2026, 5, 1, tzinfo=UTC)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    make_authority(folder, now=NOW)
    issue_certificate(
        folder, "a", "both", hosts=["arm-pc", "10.0.0.5"], uris=["x:1", "x:2"], subject="a 1", now=NOW, days=10
    )
    issue_certificate(folder, "b", "client", now=NOW)
    return folder


def test_it_is_read_as_it_was_issued(folder: Path) -> None:
    facts = read_certificate(folder / "a.pem", folder / "ca.pem")
    assert (facts.common_name, facts.uris, facts.authority, facts.signed) == ("a 1", ("x:1", "x:2"), False, True)
    assert facts.expires == NOW + timedelta(days=10)
    assert read_certificate(folder / "b.pem").uris == ()
    assert read_certificate(folder / "ca.pem").authority


def test_the_name_of_an_authority_does_not_make_a_signature(folder: Path, tmp_path: Path) -> None:
    make_authority(tmp_path, now=NOW)
    assert not read_certificate(folder / "a.pem", tmp_path / "ca.pem").signed
    assert not read_certificate(folder / "ca.pem", folder / "b.pem").signed


def test_what_is_no_certificate_is_named(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "x.pem"
    file.write_text("nothing")
    for path, words in (
        (file, "is not a certificate in PEM form"),
        (tmp_path / "none", "cannot read the certificate"),
    ):
        with pytest.raises(UsageError, match=words):
            read_certificate(path)


def test_a_certificate_can_be_used_until_it_expires(folder: Path, tmp_path: Path) -> None:
    def files(name: str, ca: Path = folder) -> TlsFiles:
        return TlsFiles(str(ca / "ca.pem"), str(folder / f"{name}.pem"), str(folder / f"{name}.key"))

    assert check_usable(files("a"), now=NOW).common_name == "a 1"
    with pytest.raises(UsageError, match=r"expired on 2026-05-11 00:00 UTC; issue a new one"):
        check_usable(files("a"), now=NOW + timedelta(days=11))
    make_authority(tmp_path, now=NOW)
    with pytest.raises(UsageError, match="was not signed by the authority"):
        check_usable(files("a", tmp_path), now=NOW)
    with pytest.raises(UsageError, match="are not a certificate and its key"):
        check_usable(TlsFiles(str(folder / "ca.pem"), str(folder / "a.pem"), str(folder / "b.key")), now=NOW)
