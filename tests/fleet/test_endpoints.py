"""Endpoints: which are allowed without certificates, and the sockets of this user."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

import pytest

from hexwire.errors import UsageError
from hexwire.fleet.endpoints import (
    check_endpoint,
    endpoints_of,
    host_and_port,
    is_served,
    local_socket,
    local_sockets,
    make_socket_folder,
    socket_folder,
)


def plain(endpoint: str) -> str:
    return check_endpoint(endpoint, certificates=False, anywhere=False)


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"),
        ("tcp/127.8.9.10:1", "tcp/127.8.9.10:1"),
        ("tcp/localhost:7447", "tcp/127.0.0.1:7447"),
        ("tcp/LocalHost:7447", "tcp/127.0.0.1:7447"),
        ("tcp/[::1]:7447", "tcp/[::1]:7447"),
        ("tcp/[0:0:0:0:0:0:0:1]:7447", "tcp/[::1]:7447"),
    ],
)
def test_this_machine_needs_no_certificates(given: str, meant: str) -> None:
    assert plain(given) == meant


@pytest.mark.parametrize(
    "host",
    [
        "0.0.0.0",
        "[::]",
        "127.1",
        "0127.0.0.1",
        "2130706433",
        "0x7f.0.0.1",
        "[::ffff:127.0.0.1]",
        "[::ffff:10.0.0.5]",
        "10.0.0.5",
        "localhost.",
        "localhost.localdomain",
        "127.0.0.1.nip.io",
        "arm-pc",
        "128.0.0.1",
        "[fe80::1]",
    ],
)
def test_whatever_may_be_another_machine_needs_them(host: str) -> None:
    with pytest.raises(UsageError, match="without certificates"):
        plain(f"tcp/{host}:7447")
    assert check_endpoint(f"tcp/{host}:7447", certificates=False, anywhere=True) == f"tcp/{host}:7447"


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "tcp",
        "tcp/localhost",
        "tcp/localhost:",
        "tcp/:7447",
        "tcp/localhost:0",
        "tcp/localhost:65536",
        "tcp/localhost:٧٤٤٧",
        "TCP/localhost:7447",
        "udp/127.0.0.1:7447",
        "quic/127.0.0.1:7447",
        "ws/127.0.0.1:7447",
        "tcp/127.0.0.1:7447#iface=eth0",
        "tcp/127.0.0.1:7447?rel=0",
        "tcp/127.0.0.1#enable_mtls=false:7447",
        "tls/host#verify_name_on_connect=false:7447",
        "tls/host:7447#enable_mtls=false",
        "tcp/::1:7447",
        "tcp/127.0.0.1 :7447",
        "tcp/127.0.0.1:7447\n",
        "tcp/127.0.0.1/0.0.0.0:7447",
        "unixsock-stream/",
        "unixsock-stream/relative.sock",
    ],
)
def test_whatever_is_no_endpoint_is_refused_even_with_certificates(endpoint: str) -> None:
    for anywhere in (False, True):
        with pytest.raises(UsageError, match="is not an endpoint"):
            check_endpoint(endpoint, certificates=True, anywhere=anywhere)


def test_tls_needs_certificates_though_plain_tcp_is_allowed_anywhere() -> None:
    with pytest.raises(UsageError, match="needs certificates"):
        check_endpoint("tls/localhost:7447", certificates=False, anywhere=True)
    assert check_endpoint("tls/0.0.0.0:7447", certificates=True, anywhere=False) == "tls/0.0.0.0:7447"


def test_a_socket_is_in_a_folder_that_nobody_else_can_look_into(runtime: Path) -> None:
    assert plain(*endpoints_of([local_socket("lab/arm1")])) == f"unixsock-stream/{socket_folder()}/lab+arm1.sock"
    mine, all_see = runtime / "mine", runtime / "all"
    mine.mkdir(0o700)
    all_see.mkdir(0o755)
    assert plain(f"unixsock-stream/{mine}/a.sock")
    for path in (all_see / "a.sock", mine / "a.sock#x=1", mine / "none" / "a.sock"):
        with pytest.raises(UsageError, match="is not an endpoint"):
            plain(f"unixsock-stream/{path}")


def test_host_and_port_are_taken_apart() -> None:
    assert host_and_port("tls/[fe80::1]:7447") == ("tls", "fe80::1", 7447)
    assert host_and_port("tcp/lab-pc:1") == ("tcp", "lab-pc", 1)


def test_only_sockets_on_which_a_program_of_this_user_listens_are_found(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert local_sockets() == []
    make_socket_folder()
    assert socket_folder().stat().st_mode & 0o777 == 0o700
    path, left = local_socket("a"), local_socket("left")
    with socket.socket(socket.AF_UNIX) as server, socket.socket(socket.AF_UNIX) as gone:
        gone.bind(os.fspath(left))
        gone.listen()
        gone.close()
        server.bind(os.fspath(path))
        server.listen()
        assert local_sockets() == [path]
        assert is_served(path)
        assert not is_served(left)
        # Another user may have put a socket there, behind which is no arm.
        socket_folder().chmod(0o777)
        assert not is_served(path)
        assert local_sockets() == []
        socket_folder().chmod(0o700)
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert not is_served(path)


def test_a_program_that_takes_no_connection_any_more_is_still_there(runtime: Path) -> None:
    make_socket_folder()
    path, waiting = local_socket("hung"), []
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.socket(socket.AF_UNIX))
        server.bind(os.fspath(path))
        server.listen(0)
        for _ in range(3):
            waiting.append(stack.enter_context(socket.socket(socket.AF_UNIX)))
            waiting[-1].setblocking(False)
            with contextlib.suppress(BlockingIOError):
                waiting[-1].connect(os.fspath(path))
        assert is_served(path)
        assert local_sockets() == [path]


def test_a_long_name_has_a_short_socket(runtime: Path) -> None:
    names = ["/".join([letter * 32] * 4) for letter in "ab"]
    paths = [local_socket(name) for name in names]
    assert len(set(paths)) == 2
    assert all(len(os.fsencode(path)) <= 100 for path in paths)


def test_a_folder_that_others_can_look_into_is_closed(runtime: Path) -> None:
    make_socket_folder()
    socket_folder().chmod(0o755)
    make_socket_folder()
    assert socket_folder().stat().st_mode & 0o777 == 0o700
