"""Addresses of shared arms."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path

import pytest

from hexwire.errors import HexwireError, LinkNotFoundError, UsageError
from hexwire.fleet.address import (
    FLEET_VARIABLE,
    Address,
    address_text,
    read_fleet_file,
    router_network,
)
from hexwire.fleet.endpoints import local_socket, make_socket_folder
from hexwire.fleet.names import ClientRole
from hexwire.link.certs import issue_certificate, make_authority


def parse(text: str, **environ: str) -> Address:
    return Address.parse(text, environ)


@pytest.mark.parametrize("text", ["zenoh:lab/arm1", "zenoh://lab/arm1"])
def test_an_address_names_an_arm_of_this_machine_and_asks_for_every_right(text: str) -> None:
    assert parse(text) == Address("lab/arm1")
    assert parse(text).role_by("") is ClientRole.MAINTAINER
    assert parse(text).text == "zenoh:lab/arm1"


def test_options_say_the_way_and_the_role() -> None:
    address = parse("zenoh:lab/arm1?router=tls/pc:7447&ca=a&cert=b&key=c&role=observer&take=1")
    assert (address.router, address.ca, address.cert, address.key) == ("tls/pc:7447", "a", "b", "c")
    assert address.role is ClientRole.OBSERVER
    assert address.take
    assert "cert" not in address.text


def test_the_role_is_that_of_the_certificate_unless_it_is_named(tmp_path: Path) -> None:
    make_authority(tmp_path)
    for role in ("observer", "maintainer"):
        issue_certificate(tmp_path, role, "client", uris=[f"hexwire:{role}:lab/*"])
    issue_certificate(tmp_path, "none", "client")
    issue_certificate(tmp_path, "king", "client", uris=["hexwire:king:lab/*"])

    def role(name: str, more: str = "") -> ClientRole:
        return parse(f"zenoh:arm?{more}").role_by(str(tmp_path / f"{name}.pem"))

    assert role("observer") is ClientRole.OBSERVER
    assert role("maintainer") is ClientRole.MAINTAINER
    assert role("maintainer", "role=operator") is ClientRole.OPERATOR
    # A missing right shows when a request is denied.
    assert role("none") is ClientRole.OPERATOR
    with pytest.raises(UsageError, match=r"king\.pem: a role that this version does not know"):
        role("king")


def test_a_certificate_that_cannot_be_read_is_in_nobodys_way_until_it_is_used() -> None:
    assert parse("zenoh:arm?ca=a&cert=b&key=c").cert == "b"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("serial:///dev/ttyUSB0", "not the address"),
        ("zenoh", "not the address"),
        ("zenoh:", "name of an arm"),
        ("zenoh:lab/../arm", "name of an arm"),
        ("zenoh:*", "name of an arm"),
        ("zenoh:arm?speed=3", "unknown"),
        ("zenoh:arm?role=operator&role=maintainer", "doubled"),
        ("zenoh:arm?role=king", "not a role"),
        ("zenoh:arm?take=yes", "take is 0 or 1"),
        ("zenoh:arm?without-certificates=yes", "without-certificates is 0 or 1"),
    ],
)
def test_what_is_no_address_is_refused_with_what_to_write(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        parse(text)


def test_a_file_gives_what_the_address_leaves_out(tmp_path: Path) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(
        'router = "tls/pc:7447"\nca = "ca.pem"\ncert = "me.pem"\nkey = "/keys/me.key"\nrole = "observer"\n'
    )
    address = parse("zenoh:arm?role=operator", **{FLEET_VARIABLE: str(file)})
    assert address.router == "tls/pc:7447"
    assert (address.ca, address.key) == (str(tmp_path / "ca.pem"), "/keys/me.key")
    assert address.role is ClientRole.OPERATOR


@pytest.mark.parametrize("text", ["take = 1", "router = 5", "router =", 'rouetr = "x"'])
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, text: str) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    with pytest.raises(HexwireError, match=r"fleet\.toml"):
        read_fleet_file(str(file))


def test_an_arm_that_nobody_serves_here_needs_a_router(runtime: Path) -> None:
    with pytest.raises(LinkNotFoundError, match=r"hexwire serve --name lab/arm1.*router"):
        parse("zenoh:lab/arm1").network()
    network = parse("zenoh:lab/arm1?router=tcp/localhost:7447").network()
    assert network.connect == ("tcp/127.0.0.1:7447",)
    assert network.listen == ()


def test_a_router_of_another_machine_is_not_reached_without_certificates() -> None:
    with pytest.raises(UsageError, match="without certificates"):
        parse("zenoh:arm?router=tcp/lab-pc:7447").network()
    plain = parse("zenoh:arm?router=tcp/lab-pc:7447&without-certificates=1").network()
    assert plain.connect == ("tcp/lab-pc:7447",)
    with pytest.raises(UsageError, match="needs certificates"):
        parse("zenoh:arm?router=tls/lab-pc:7447").network()


# -- the way of the commands for many arms ----------------------------------------------------------------


def test_options_take_precedence_over_the_file(tmp_path: Path) -> None:
    make_authority(tmp_path)
    for name in ("anna", "bob"):
        issue_certificate(tmp_path, name, "client", uris=["hexwire:operator:lab/*"])
    file = tmp_path / "anna.toml"
    file.write_text('router = "tls/pc:7447"\nca = "ca.pem"\ncert = "anna.pem"\nkey = "anna.key"\n')
    environ = {FLEET_VARIABLE: str(file)}
    network = router_network(environ=environ)
    assert network is not None
    assert (network.connect, network.cert) == (("tls/pc:7447",), str(tmp_path / "anna.pem"))
    bob = {"cert": str(tmp_path / "bob.pem"), "key": str(tmp_path / "bob.key")}
    network = router_network("tls/hall:7447", **bob, environ=environ)
    assert network is not None
    assert (network.connect, network.ca, network.cert) == (
        ("tls/hall:7447",),
        str(tmp_path / "ca.pem"),
        bob["cert"],
    )
    assert router_network(environ={}) is None


def test_an_address_made_from_a_network_ignores_the_environment(tmp_path: Path) -> None:
    folder = tmp_path / "a +&%b"
    make_authority(folder)
    for name in ("anna", "bob"):
        issue_certificate(folder, name, "client", uris=["hexwire:operator:lab/*"])
    file = folder / "anna.toml"
    file.write_text('router = "tls/pc:7447"\nca = "ca.pem"\ncert = "anna.pem"\nkey = "anna.key"\n')
    files = {key: str(folder / name) for key, name in (("ca", "ca.pem"), ("cert", "bob.pem"), ("key", "bob.key"))}
    network = router_network("tls/[::1]:7447", **files, environ={})
    address = parse(address_text("lab/arm1", network), **{FLEET_VARIABLE: str(file)})
    assert (address.router, address.ca, address.cert, address.key) == ("tls/[::1]:7447", *files.values())
    assert address_text("lab/arm1", None) == "zenoh:lab/arm1"


def test_a_router_beyond_this_machine_without_certificates_needs_the_option() -> None:
    with pytest.raises(UsageError, match="without certificates"):
        router_network("tcp/lab-pc:7447", environ={})
    network = router_network("tcp/lab-pc:7447", without_certificates=True, environ={})
    assert network is not None
    assert parse(address_text("arm", network)).without_certificates


def test_a_network_that_cannot_be_used_is_an_error_of_its_options(tmp_path: Path) -> None:
    make_authority(tmp_path)
    files = {key: str(tmp_path / f"none.{key}") for key in ("cert", "key")} | {"ca": str(tmp_path / "ca.pem")}
    with pytest.raises(UsageError, match=r"none\.(cert|key)"):
        router_network("tls/pc:7447", **files, environ={})
    assert router_network("tls/pc:7447", **files, check=False, environ={}) is not None
    with pytest.raises(UsageError, match="--router tls/HOST:7447"):
        router_network(**files, environ={})
    with pytest.raises(UsageError, match="--router tls/HOST:7447"):
        router_network(without_certificates=True, environ={})


def test_an_unknown_name_gives_the_names_of_the_arms_served_here(runtime: Path) -> None:
    with closing(socket.socket(socket.AF_UNIX)) as served:
        make_socket_folder()
        served.bind(str(local_socket("lab/arm1")))
        served.listen()
        with pytest.raises(LinkNotFoundError, match=r"no arm lab/arm is served .* user, but lab/arm1: start"):
            parse("zenoh:lab/arm").network()
