"""Where the studio may listen: elsewhere only with TLS and a password or client certificates."""

from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import UsageError
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.studio.access import Right
from hexwire.studio.listening import (
    check_protected,
    check_tls,
    host_names,
    is_local,
    parse_listen,
    read_password,
    right_of,
)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("8080", ("127.0.0.1", 8080)),
        (":0", ("127.0.0.1", 0)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
        ("[::1]:80", ("::1", 80)),
        ("lab:80", ("lab", 80)),
    ],
)
def test_an_address_is_read(text: str, found: tuple[str, int]) -> None:
    assert parse_listen(text) == found


@pytest.mark.parametrize("text", ["", "lab", "lab:", "::1", "::1:80", "lab:65536", "lab:-1", "lab:٣"])
def test_a_wrong_address_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parse_listen(text)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "lab", "127.0.0.1.example", "fe80::1"])
def test_other_machines_need_tls_and_a_password_or_certificates(host: str) -> None:
    assert not is_local(host)
    for cert, key, ca, password in (
        ("", "", "", False),
        ("", "", "", True),
        ("c", "k", "", False),
        ("c", "", "", True),
        ("", "", "a", True),
    ):
        with pytest.raises(UsageError):
            check_protected(host, cert=cert, key=key, ca=ca, password=password)
    check_protected(host, cert="c", key="k", ca="", password=True)
    check_protected(host, cert="c", key="k", ca="a", password=False)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_this_machine_needs_neither(host: str) -> None:
    check_protected(host, cert="", key="", ca="", password=False)


def test_names_of_the_host_are_those_of_address_and_certificate(tmp_path: Path) -> None:
    assert host_names("127.0.0.1", 81) == {"127.0.0.1:81", "localhost:81", "[::1]:81"}
    assert host_names("192.168.1.5", 80) == {"192.168.1.5:80", "192.168.1.5"}
    make_authority(tmp_path)
    files = issue_certificate(tmp_path, "arm", "server", hosts=("Arm.lab", "192.168.1.5"))
    assert host_names("0.0.0.0", 443, str(files.cert), secure=True) == {
        "arm.lab:443",
        "arm.lab",
        "192.168.1.5:443",
        "192.168.1.5",
    }
    check_tls(str(files.cert), str(files.key), "")
    with pytest.raises(UsageError, match=r"other\.key"):
        check_tls(str(files.cert), str(tmp_path / "other.key"), "")


def test_a_password_must_be_long_and_private(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("correct horse battery\n")
    file.chmod(0o644)
    with pytest.raises(UsageError, match="chmod 600"):
        read_password(str(file))
    file.chmod(0o600)
    assert read_password(str(file)) == "correct horse battery"
    file.write_text("short\n")
    with pytest.raises(UsageError, match="too short"):
        read_password(str(file))
    with pytest.raises(UsageError):
        read_password(str(tmp_path / "none"))


@pytest.mark.parametrize(
    ("uris", "right"),
    [
        ([], Right.OPERATE),
        (["hexwire:operator:lab/*"], Right.OPERATE),
        (["hexwire:maintainer:lab/*"], Right.OPERATE),
        (["hexwire:observer:lab/*"], Right.WATCH),
        (["hexwire:arm:lab/arm1"], None),
        (["hexwire:king:lab/arm1"], None),
    ],
)
def test_a_client_certificate_gives_the_right_of_its_role(uris: list[str], right: Right | None) -> None:
    assert right_of({"subjectAltName": [("URI", uri) for uri in uris]}) is right
