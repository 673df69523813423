"""A session: what it listens on, whom it reaches, and why it does not open."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from tests.link.far_ends import free_port
from tests.waits import eventually

from hexwire.errors import ConfigError, LinkNotFoundError, LinkPermissionError, UsageError
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network, read_access
from hexwire.fleet.rights import Kind

from .lab import LONG_AGO, Lab


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    return lab


# -- what it listens on -----------------------------------------------------------------------------------

_LOOK = """
import os, sys
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network
server = Network(listen=endpoints_of([local_socket("a")])).open(wait=False)
client = Network(connect=endpoints_of([local_socket("a")])).open()
assert client.connections == 1
inodes = set()
for fd in os.listdir("/proc/self/fd"):
    try:
        inodes.add(os.readlink(f"/proc/self/fd/{fd}"))
    except OSError:
        pass
for kind in ("tcp", "tcp6", "udp", "udp6", "raw", "raw6"):
    for line in open(f"/proc/self/net/{kind}").readlines()[1:]:
        if f"socket:[{line.split()[9]}]" in inodes:
            print(kind, line)
print("looked", flush=True)
os._exit(0)
"""


_THREADS = """
import os
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.network import Network
server = Network(listen=endpoints_of([local_socket("a")])).open(wait=False)
client = Network(connect=endpoints_of([local_socket("a")])).open()
assert client.connections == 1
names = [open(f"/proc/self/task/{each}/comm").read().strip() for each in os.listdir("/proc/self/task")]
print(*sorted({name.partition("-")[0] for name in names if "-" in name}), flush=True)
os._exit(0)
"""


@pytest.mark.parametrize(
    ("given", "kinds"), [({}, "net rx"), ({"ZENOH_RUNTIME": "(rx: (handover: net))"}, "acc app net tx")]
)
def test_zenoh_has_few_threads_unless_its_own_setting_says_otherwise(
    runtime: Path, given: dict[str, str], kinds: str
) -> None:
    env = {key: value for key, value in os.environ.items() if key != "ZENOH_RUNTIME"} | given
    out = subprocess.run(
        [sys.executable, "-c", _THREADS], capture_output=True, text=True, timeout=60, check=False, env=env
    )
    assert set(out.stdout.split()) <= set(kinds.split()), out.stdout + out.stderr
    assert "net" in out.stdout.split(), out.stdout + out.stderr
    assert ("acc" in out.stdout.split()) == bool(given), out.stdout + out.stderr


def test_by_default_nothing_listens_on_a_network(runtime: Path) -> None:
    out = subprocess.run([sys.executable, "-c", _LOOK], capture_output=True, text=True, timeout=60, check=False)
    assert out.stdout == "looked\n", out.stderr


def test_it_listens_only_where_configured() -> None:
    port = free_port()
    node = Network(listen=(f"tcp/LOCALHOST:{port}",), router=True).open()
    try:
        with socket.create_connection(("127.0.0.1", port), 30):
            pass
        found = re.findall(rf"([0-9A-F]+):{port:04X} [0-9A-F:]+ 0A", Path("/proc/self/net/tcp").read_text())
        assert found == ["0100007F"]
    finally:
        node.close()


def test_the_settings_leave_no_way_to_be_found() -> None:
    rows = Network()._settings(wait=True)
    assert rows["scouting/multicast/enabled"] is rows["scouting/gossip/enabled"] is False
    assert rows["adminspace/enabled"] is False
    assert rows["transport/link/protocols"] == ["tls", "unixsock-stream"]


@pytest.mark.parametrize("role", [{}, {"router": True}])
def test_a_connection_is_lost_after_five_seconds_of_silence_which_five_signs_of_life_break(
    role: dict[str, bool],
) -> None:
    rows = Network(**role)._settings(wait=True)  # type: ignore[arg-type]
    assert rows["transport/link/tx/lease"] == 5000, "milliseconds"
    assert rows["transport/link/tx/keep_alive"] == 5


def test_who_listens_waits_a_quarter_of_a_second_for_a_program_that_takes_nothing(runtime: Path) -> None:
    """That nobody else is delayed then, only a frozen program proves: tests/fleet/test_node.py."""
    key = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    served = Network(listen=endpoints_of([local_socket("a")]))
    assert served._settings(wait=True)[key] == 250_000, "microseconds"
    served.open().close()


# -- what is refused before anything is opened -----------------------------------------------------------


def test_plain_endpoints_beyond_this_machine_need_the_flag() -> None:
    for rows in ({"listen": ("tcp/0.0.0.0:7447",)}, {"connect": ("tcp/10.0.0.5:7447",)}):
        with pytest.raises(UsageError, match="anybody there could move the arm"):
            Network(**rows)
        Network(**rows, reachable_without_certificates=True)


def test_who_listens_with_certificates_needs_rights_for_them(lab: Lab) -> None:
    with pytest.raises(UsageError, match="--access"):
        Network(listen=(lab.endpoint,), **lab.files("router"))


@pytest.mark.parametrize("left_out", ["ca", "cert", "key"])
def test_certificates_are_given_together(lab: Lab, left_out: str) -> None:
    files = lab.files("anna") | {left_out: ""}
    with pytest.raises(UsageError, match=r"all of ca, cert and key|needs certificates"):
        Network(connect=(lab.endpoint,), **files)


def test_certificates_that_cannot_be_used_are_named(lab: Lab, tmp_path: Path) -> None:
    other = Lab(tmp_path)
    other.issue("anna", Kind.OPERATOR, "lab/*")
    other.issue("old", Kind.OPERATOR, "lab/*", now=LONG_AGO, days=1)
    good = other.files("anna")
    unreadable = tmp_path / "unreadable.key"
    unreadable.write_text("no key")
    for files, words in (
        (good | {"key": lab.files("anna")["key"]}, "are not a certificate and its key"),
        (good | {"key": str(tmp_path / "none.key")}, "cannot read the key"),
        (good | {"key": str(unreadable)}, "are not a certificate and its key"),
        (good | {"ca": good["key"]}, "not an authority's certificate"),
        (good | {"ca": lab.files("anna")["ca"]}, "was not signed by the authority"),
        (other.files("old"), "expired on 2020-01-02"),
    ):
        with pytest.raises(UsageError, match=words) as raised:
            Network(connect=(lab.endpoint,), **files).open()
        assert "\n" not in str(raised.value)


def test_access_that_denies_nothing_is_refused(tmp_path: Path, lab: Lab) -> None:
    file = tmp_path / "access.json"
    for text, words in (
        ("{}", "is missing"),
        ("[]", "table"),
        (
            '{"enabled":false,"default_permission":"deny","rules":[],"subjects":[],"policies":[]}',
            "switched off",
        ),
        (
            '{"enabled":true,"default_permission":"allow","rules":[],"subjects":[],"policies":[]}',
            "allows what no rule names",
        ),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=words):
            read_access(str(file))


def test_access_that_zenoh_does_not_understand_is_an_error_in_one_line() -> None:
    port = free_port()
    empty = {"enabled": True, "default_permission": "deny", "rules": [], "subjects": []}
    for wrong in ({"policies": [{"rules": ["none"], "subjects": ["none"]}]}, {"policies": 5}):
        access = empty | wrong
        if wrong["policies"] != 5:
            access |= {"rules": [_RULE], "subjects": [{"id": "x", "zids": ["1"]}]}
        with pytest.raises(UsageError, match="access") as raised:
            Network(listen=(f"tcp/localhost:{port}",), access=access).open()
        assert "\n" not in str(raised.value)


_RULE = {"id": "a", "messages": ["put"], "flows": ["ingress"], "permission": "allow", "key_exprs": ["a"]}


# -- why it does not open ---------------------------------------------------------------------------------


def test_a_port_that_is_taken_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(LinkPermissionError, match="another program listens there") as raised:
            Network(listen=(endpoint,), router=True).open()
        assert "\n" not in str(raised.value)


def test_a_missing_peer_is_reported_at_once() -> None:
    with pytest.raises(LinkNotFoundError, match="nobody answers at tcp/127"):
        Network(connect=(f"tcp/127.0.0.1:{free_port()}",)).open()


# -- a connection that stands -----------------------------------------------------------------------------


def test_a_connection_ends_when_its_certificate_does(lab: Lab) -> None:
    lab.issue("long", Kind.OPERATOR, "lab/*", subject="of brief")
    with lab.routing(), lab.session("anna") as stays, contextlib.ExitStack() as stack:
        # Not earlier: it lasts from here on.
        options: dict[str, Any] = {"now": datetime.now(UTC), "days": 2.5 / 86400, "subject": "of brief"}
        lab.issue("brief", Kind.OPERATOR, "lab/*", known=False, **options)
        brief = stack.enter_context(lab.session("brief"))
        brief.ask_neighbours(5.0)
        eventually(lambda: brief.connections == 0)
        stays.ask_neighbours(5.0)
        with pytest.raises(UsageError, match="expired on"):
            lab.network("brief").open()
