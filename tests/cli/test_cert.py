from __future__ import annotations

import threading
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from hexwire.cli.main import cli
from hexwire.link.certs import read_certificate
from hexwire.link.open import make_link


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, ["cert", "new", *map(str, words)])


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_one_of_each(tmp_path: Path) -> None:
    result = run(tmp_path / "lab")
    assert (result.exit_code, result.stderr) == (0, "")
    assert files(tmp_path / "lab") == ["ca.key", "ca.pem", "client.key", "client.pem", "server.key", "server.pem"]
    for path in (tmp_path / "lab").glob("*.key"):
        assert path.stat().st_mode & 0o777 == 0o600
    assert "tcps://HOST:PORT?ca=" in result.stdout


@pytest.mark.system
def test_they_let_each_other_in(tmp_path: Path) -> None:
    assert run(tmp_path, "--server", "arm1", "--client", "pc1", "--client", "pc2").exit_code == 0
    options = f"?ca={tmp_path}/ca.pem&cert={tmp_path}/%s.pem&key={tmp_path}/%s.key"
    with make_link("tcps-listen://127.0.0.1:0" + options % ("arm1", "arm1")) as server:
        heard: list[bytes] = []
        reader = threading.Thread(target=lambda: heard.append(server.read(None)))
        reader.start()
        with make_link(server.url.replace("-listen", "") + options % ("pc2", "pc2")) as client:
            client.write(b"hello")
            reader.join(30)
    assert heard == [b"hello"]


def test_more_from_the_same_authority(tmp_path: Path) -> None:
    assert run(tmp_path).exit_code == 0
    authority = (tmp_path / "ca.pem").read_bytes()
    result = run(tmp_path, "--server", "arm2", "--host", "192.168.1.20", "--host", "arm2.lab", "--days", "30")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "ca.pem").read_bytes() == authority
    assert "arm2.pem" in files(tmp_path)
    assert "authority" not in result.stdout


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--client", "a", "--server", "a"), "a is named twice"),
        (("--host", "10.0.0.1", "--client", "a"), "--host needs --server"),
        (("--days", "-1"), "is not above 0"),
        (("--client", "../x"), "cannot name a certificate"),
    ],
)
def test_mistakes(tmp_path: Path, words: tuple[str, ...], text: str) -> None:
    result = run(tmp_path, *words)
    assert result.exit_code == 2
    assert text in result.stderr
    assert result.stderr.count("\n") == 1


def test_nothing_is_written_over(tmp_path: Path) -> None:
    assert run(tmp_path).exit_code == 0
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for words in ((), ("--client", "new", "--client", "client"), ("--host", "10.0.0.1")):
        assert run(tmp_path, *words).exit_code == 2
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


# -- with a role ------------------------------------------------------------------------------------------


def issue(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, ["cert", "issue", *map(str, words)])


def test_a_role_and_its_arms_stand_in_the_certificate(tmp_path: Path) -> None:
    words = ("--role", "operator", "--for", "lab/*", "--for", "hall/arm1")
    result = issue(tmp_path / "lab", "anna", *words)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "anna.key  operator for lab/*, hall/arm1" in result.stdout
    assert files(tmp_path / "lab") == ["anna.key", "anna.pem", "ca.key", "ca.pem"]
    facts = read_certificate(tmp_path / "lab" / "anna.pem", tmp_path / "lab" / "ca.pem")
    assert facts.uris == ("hexwire:operator:lab/*", "hexwire:operator:hall/arm1")
    assert facts.signed
    for path in (tmp_path / "lab").glob("*.key"):
        assert path.stat().st_mode & 0o777 == 0o600


def test_the_name_in_a_certificate_with_a_role_is_unique(tmp_path: Path) -> None:
    names = set()
    for _ in range(3):
        assert issue(tmp_path, "n" * 60, "--role", "observer", "--for", "**").exit_code == 0
        names.add(read_certificate(tmp_path / f"{'n' * 60}.pem").common_name)
        for end in ("pem", "key"):
            (tmp_path / f"{'n' * 60}.{end}").unlink()
    assert len(names) == 3


def test_arms_and_routers_carry_host_names(tmp_path: Path) -> None:
    from cryptography.x509 import DNSName, IPAddress, SubjectAlternativeName, load_pem_x509_certificate

    assert issue(tmp_path, "pc", "--role", "router", "--host", "lab-pc", "--host", "10.0.0.5").exit_code == 0
    certificate = load_pem_x509_certificate((tmp_path / "pc.pem").read_bytes())
    names = certificate.extensions.get_extension_for_class(SubjectAlternativeName).value
    assert names.get_values_for_type(DNSName) == ["lab-pc"]
    assert [str(address) for address in names.get_values_for_type(IPAddress)] == ["10.0.0.5"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("anna",), "Missing option '--role'"),
        (("anna", "--role", "king"), "king"),
        (("anna", "--role", "operator"), "needs 1 to 64 names or patterns"),
        (("anna", "--role", "operator", "--for", "lab/arm*"), "matches no arm"),
        (("pc", "--role", "router", "--for", "lab/*"), "leave out --for"),
        (("anna", "--role", "observer", "--for", "**", "--host", "pc"), "is for the roles arm, router and ros"),
        (("ca", "--role", "router"), "cannot name a certificate"),
        (("../x", "--role", "router"), "cannot name a certificate"),
    ],
)
def test_mistakes_with_roles(tmp_path: Path, words: tuple[str, ...], text: str) -> None:
    result = issue(tmp_path / "lab", *words)
    assert result.exit_code == 2
    assert text in result.stderr
    assert result.stderr.count("\n") == 1
