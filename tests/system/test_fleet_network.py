"""The network of a shared arm fails, or certificates are wrong: the three promises of `fleet_watch` hold.

Server, router, operator and reader are on hosts of their own, which are network namespaces, and meet by TLS. Each
test ends with the check of everything since the start.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from tests.soak import rounds
from tests.system.fleet_programs import NAME, STOPPED, ClientProgram, Lab, Program
from tests.system.fleet_watch import SAME, TIMEOUT
from tests.system.hosts import HUB, Hosts
from tests.system.programs import PATIENCE
from tests.waits import eventually

from hexwire.cli.main import cli
from hexwire.fleet.rights import Kind, Rights
from hexwire.link.certs import issue_certificate

pytestmark = [pytest.mark.system, pytest.mark.soak, pytest.mark.timeout(rounds(300, 3600))]

ROUNDS = rounds(1, 20)
SHAKE = """
import socket, ssl, sys
host, ca, cert, key = sys.argv[1:]
context = ssl.create_default_context(cafile=ca)
context.load_cert_chain(cert, key)
with context.wrap_socket(socket.create_connection((host, 7447), 10), server_hostname=host) as line:
    line.settimeout(3)
    try:
        print("refused" if line.recv(1) == b"" else "spoke")
    except TimeoutError:
        print("accepted")
    except OSError:
        print("refused")
"""
"""Shakes hands and says nothing: whether the router waits, or ends the connection."""


def hexwire(*words: str) -> None:
    """Run a command in this process, where a new one would take longer than the command."""
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, (words, done.output)


class Lines:
    """The lines of a program's output, for a `with` block, which ends the program."""

    def __init__(self, program: Program) -> None:
        self._lines: list[str] = []
        self._program = program
        self._reader = threading.Thread(target=self._read, name="lines", daemon=True)

    def __enter__(self) -> Lines:
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        # Its end is that of its output, which is read to the end before the pipe is closed.
        self._program.terminate()
        self._reader.join(PATIENCE)
        self._program.end()

    def __len__(self) -> int:
        return len(self._lines)

    def place(self, words: str, since: int) -> int:
        """Number of the first line from a number on that has some words, counted from 1; 0 if none has."""
        return next((i for i, line in enumerate(self._lines[since:], since + 1) if words in line), 0)

    def _read(self) -> None:
        assert self._program.process.stdout is not None
        for line in self._program.process.stdout:
            self._lines.append(line)


class Site(Lab):
    """A lab whose programs are on hosts of their own."""

    def __init__(self, folder: Path, hosts: Hosts) -> None:
        super().__init__(folder)
        self.hosts, self.certs = hosts, folder / "certs"
        self.issue("hub", "router", hosts=[hosts.hub(name) for name in hosts.names])
        for name, role in (("arm", "arm"), ("twin", "arm"), ("op", "operator"), ("rd", "observer")):
            self.issue(name, role, NAME)
        self.issue("other", "arm", "lab/arm2")
        hexwire("fleet", "config", str(self.certs))

    def issue(self, name: str, role: str, *arms: str, hosts: list[str] | None = None) -> None:
        words = [
            *(w for arm in arms for w in ("--for", arm)),
            *(w for host in hosts or () for w in ("--host", host)),
        ]
        hexwire("cert", "issue", str(self.certs), name, "--role", role, *words)

    def files(self, name: str) -> dict[str, str]:
        folder = self.certs
        return {"ca": f"{folder}/ca.pem", "cert": f"{folder}/{name}.pem", "key": f"{folder}/{name}.key"}

    def start_router(self) -> None:
        words = ["--listen", "tls/0.0.0.0:7447", "--access", f"{self.certs}/access.json"]
        words += [word for key, file in self.files("hub").items() for word in (f"--{key}", file)]
        self.router = self.begin("fleet", "router", *words, where=self.hosts.at(HUB))
        self.router.line()

    def start_router_anew(self) -> None:
        """Write the rights again, and start the router with them; returns when states arrive again."""
        hexwire("fleet", "config", str(self.certs), "--force")
        self.router.end()
        ended = time.monotonic()
        self.start_router()
        started = time.monotonic()
        self.cuts.append((ended, started))
        came_back(self, started)

    def start_server(self, at: str = "arm", cert: str = "arm", port: str = "") -> Program:
        words = ["--router", f"tls/{self.hosts.hub(at)}:7447"]
        words += [word for key, file in self.files(cert).items() for word in (f"--{key}", file)]
        return self.serve(*words, where=self.hosts.at(at), port=port, extra=self.own(at))

    def start_client(self, name: str, cert: str = "", *, attach: bool = True) -> ClientProgram:
        options = {"router": f"tls/{self.hosts.hub(name)}:7447", **self.files(cert or name)}
        text = "&".join(f"{key}={value}" for key, value in options.items())
        return self.client(f"?{text}", self.hosts.at(name), self.own(name), attach=attach)

    def way(self, at: str, cert: str) -> list[str]:
        """The options for the way to the router."""
        rows = {"router": f"tls/{self.hosts.hub(at)}:7447", **self.files(cert)}
        return [word for key, value in rows.items() for word in (f"--{key}", value)]

    def beside(self, at: str) -> dict[str, Any]:
        """Where `begin` starts a program on a host."""
        return {"where": self.hosts.at(at), "extra": self.own(at)}

    def address(self, at: str, cert: str) -> str:
        """The address of the arm for a host."""
        rows = {"router": f"tls/{self.hosts.hub(at)}:7447", **self.files(cert)}
        return f"zenoh:{NAME}?{'&'.join(f'{key}={value}' for key, value in rows.items())}"

    def begin_all(self) -> None:
        if not hasattr(self, "router") or self.router.process.poll() is not None:
            self.start_router()
        super().begin_all()

    def own(self, name: str) -> dict[str, str]:
        """A host has sockets of its own."""
        return {"XDG_RUNTIME_DIR": str(self.folder / name)}


@pytest.fixture(scope="module")
def home() -> Iterator[Site]:
    with (
        tempfile.TemporaryDirectory(prefix="hw-", dir="/tmp") as folder,
        Hosts("arm", "op", "rd") as hosts,
        Site(Path(folder), hosts) as site,
    ):
        yield site


@pytest.fixture
def site(home: Site) -> Iterator[Site]:
    home.begin_all()
    yield home
    home.check()


def came_back(site: Site, since: float) -> None:
    """States arrive again at the reader."""
    eventually(lambda: site.last().get("t", 0) > since)


def gone(site: Site, since: float) -> bool:
    """Whether the reader has said since then that the arm is not there."""
    row = site.last("lost")
    return bool(row) and row["t"] > since and row["error"] == "LinkNotFoundError"


@pytest.mark.slow
def test_a_network_that_loses_every_fifth_packet_moves_nothing_unasked(site: Site) -> None:
    for _ in range(ROUNDS):
        site.operator.do("stream", 20.0, J1=0.3)
        begin = time.monotonic()
        with site.hosts.loss(*site.hosts.names, percent=20):
            time.sleep(4.0)
        end = time.monotonic()
        came_back(site, end)
        site.operator.do("rest")
        # Late, in bursts, but they come; every order was done or refused for one of these reasons: a connection
        # is silent for more than 5 s now and then, and counts as lost. Nobody lacks a right.
        assert [row for row in site.rows(0) if row["e"] == "state" and begin < row["t"] < end]
        refused = {row["error"] for row in site.rows() if row["e"] == "refused" and row["t"] > begin}
        lost = {"LinkLostError", "LinkNotFoundError"}
        assert refused <= {"LeaseError", "ReplyTimeoutError", "StoppedError"} | lost, refused
        site.check()
        site.begin_all()


@pytest.mark.slow
def test_an_operator_that_is_cut_off_loses_the_lease_and_no_stop_of_it_counts_as_done(site: Site) -> None:
    for _ in range(ROUNDS):
        site.swinging()
        with site.hosts.cut("op") as begin:
            eventually(lambda: "lost the lease" in str(site.last().get("held")))
            site.operator.send("stop")
            # Those that it sends meanwhile are too late as well.
            time.sleep(TIMEOUT)
            end = time.monotonic()
        site.cuts.append((begin, end))
        answer = site.operator.answer()
        # It arrives late or not at all, and nobody says otherwise.
        assert "error" in answer or answer["ended"] > end, answer
        time.sleep(1.0)
        site.operator.do("rest")
        # Orders that waited on the way are refused, like those that follow.
        eventually(lambda: site.operator.ask("move", 1.0, J1=0.0).get("error") in ("LeaseError", "StoppedError"))
        site.check()
        site.begin_all()


@pytest.mark.slow
def test_an_arm_that_is_cut_off_holds_and_is_missed_and_a_second_one_of_its_name_gives_way(site: Site) -> None:
    twin_board = site.second_board()
    for _ in range(ROUNDS):
        site.setting_out()
        first = site.last()["booted"]
        with site.hosts.cut("arm") as begin:
            # What the operator sends does not arrive, so the arm has nobody who commands it.
            eventually(lambda begin=begin: gone(site, begin))
            there = site.position(0)
            # Now the name is free, as far as anybody can see.
            alone = time.monotonic()
            twin = site.start_server(at="rd", cert="twin", port=twin_board)
            site.cuts.append((begin, time.monotonic()))
        # The first has not ended: when both see each other, the one that was started later ends.
        assert twin.process.wait(PATIENCE) != 0
        # Only until then anybody read the second one, and what has arrived of it.
        eventually(lambda first=first: abs(site.last()["booted"] - first) < SAME)
        site.others.append((alone, time.monotonic()))
        assert "another server offers lab/arm1, and was started earlier" in site.errors()
        assert site.server.process.poll() is None
        came_back(site, time.monotonic())
        assert site.position(0) == pytest.approx(there, abs=1.5)
        site.check()
        site.begin_all()


@pytest.mark.slow
def test_an_arm_that_is_cut_off_shows_before_it_is_gone_and_comes_back(site: Site) -> None:
    """Within which times, tests/fleet prove in simulated time."""
    with Lines(site.begin("fleet", "watch", NAME, *site.way("rd", "rd"), **site.beside("rd"))) as watch:
        eventually(lambda: watch.place("hex7bot at", 0))
        for _ in range(ROUNDS):
            reader = site.begin("state", "--watch", "--port", site.address("rd", "rd"), **site.beside("rd"))
            with Lines(reader) as states:
                eventually(lambda states=states: states.place("deg", 0))
                told, said = len(site.errors()), len(watch)
                with site.hosts.cut("arm") as begin:
                    eventually(lambda told=told: "its states have stopped arriving" in site.errors()[told:])
                    shown = eventually(lambda said=said: watch.place(f"{NAME}: no answer", said))
                    gone = eventually(lambda said=said: watch.place(f"{NAME}: gone", said))
                    # It has ended meanwhile, and said why.
                    assert reader.process.wait(PATIENCE) == 1
                    site.cuts.append((begin, time.monotonic()))
            assert shown < gone
            eventually(lambda gone=gone: watch.place("hex7bot at", gone))
            came_back(site, time.monotonic())
            site.check()
            site.begin_all()


@pytest.mark.slow
def test_a_router_that_is_killed_leaves_an_arm_that_holds_and_is_found_again(site: Site) -> None:
    for _ in range(ROUNDS):
        site.swinging()
        killed = site.router.kill()
        eventually(lambda killed=killed: site.last("lost").get("t", 0) > killed)
        assert site.last("lost")["error"] == "LinkLostError"
        site.cuts.append((killed, time.monotonic()))
        there = site.resting(0)
        site.start_router()
        started = time.monotonic()
        came_back(site, started)
        assert site.resting(0) == there
        site.operator.do("rest")
        site.check()
        site.begin_all()


@pytest.mark.slow
def test_a_router_that_is_stopped_lets_nothing_old_through_when_it_goes_on(site: Site) -> None:
    for _ in range(ROUNDS):
        site.swinging()
        with site.router.stopped() as begin:
            there = site.resting(0)
            time.sleep(STOPPED)
            end = time.monotonic()
        site.cuts.append((begin, end))
        came_back(site, end)
        assert site.resting(0) == there
        site.operator.do("rest")
        site.check()
        site.begin_all()


@pytest.mark.slow
def test_certificates_that_are_wrong_move_nothing(site: Site) -> None:
    site.operator.do("release")
    before = site.resting(0)
    # Of another authority, under the name that the right one has.
    away = site.folder / "away"
    hexwire("cert", "issue", str(away), "op", "--role", "operator", "--for", NAME)
    for end in ("pem", "key"):
        shutil.copy(away / f"op.{end}", site.certs / f"strange.{end}")
    # Expired.
    rights = Rights(Kind.OPERATOR, (NAME,))
    long_ago = datetime(2024, 1, 1, tzinfo=UTC)
    issue_certificate(site.certs, "old", "client", uris=rights.uris(), subject="old 1", days=30, now=long_ago)
    for name, word in (("strange", "not signed by the authority"), ("old", "expired")):
        client = site.start_client("op", name, attach=False)
        answer = client.ask("connect")
        assert word in answer.get("text", ""), (name, answer)
        client.end()
    # A program that does not look is refused by the router.
    refusals = [
        subprocess.run(
            [*site.hosts.at("op"), sys.executable, "-c", SHAKE, site.hosts.hub("op"), *site.files(name).values()],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=True,
        ).stdout.strip()
        for name in ("op", "strange", "old")
    ]
    assert refusals == ["accepted", "refused", "refused"]
    # Of the wrong role: it reads, but does not move.
    observer = site.start_client("op", "rd")
    answer = observer.ask("move", 1.0, J1=0.3)
    assert answer["error"] == "LinkPermissionError", answer
    observer.do("stop")
    observer.end()
    assert site.resting(0) == before


@pytest.mark.slow
def test_a_certificate_that_is_revoked_loses_the_lease_when_the_router_starts_again(site: Site) -> None:
    site.issue("bob", "operator", NAME)
    # He has copies of his own.
    (site.folder / "bob").mkdir()
    for end in ("pem", "key"):
        shutil.copy(site.certs / f"bob.{end}", site.folder / "bob")
    site.start_router_anew()
    bob = site.start_client("op", "../bob/bob")
    bob.do("take", force=True)
    site.setting_out(bob)
    for end in ("pem", "key"):
        (site.certs / f"bob.{end}").unlink()
    site.start_router_anew()
    eventually(lambda: "lost the lease" in str(site.last().get("held")))
    there = site.resting(0)
    for what in (("move", 1.0), ("take", True), ("stop",)):
        answer = bob.ask(*what, **({"J1": 0.0} if what[0] == "move" else {}))
        assert answer.get("error") == "LinkPermissionError", (what, answer)
        assert "does not know the certificate" in answer["text"]
    # Nor does he read, and nobody else is concerned.
    answer = site.start_client("op", "../bob/bob", attach=False).ask("connect")
    assert answer.get("error") == "LinkPermissionError", answer
    assert site.position(0) == there
    assert not site.last()["stopped"]
    bob.end()
    site.operator.do("take", force=True)
    site.setting_out()


@pytest.mark.slow
def test_a_certificate_for_another_arm_gives_nobody_a_state_of_this_one(site: Site) -> None:
    """A program with it offers this arm's name, and is not seen."""
    begin = time.monotonic()
    impostor = site.begin(
        "serve",
        *("--port", site.second_board(), "--name", NAME, "--router", f"tls/{site.hosts.hub('op')}:7447"),
        *(word for key, file in site.files("other").items() for word in (f"--{key}", file)),
        where=site.hosts.at("op"),
        extra={"XDG_RUNTIME_DIR": str(site.folder / "impostor")},
    )
    site.operator.do("stream", 20.0, J1=0.3)
    time.sleep(3.0)
    eventually(lambda: len(site.states(begin)) > 100)
    site.operator.do("rest")
    impostor.end()
    assert not site.refused(begin)
    assert not site.lost(begin)
    assert site.server.process.poll() is None


def test_where_no_namespace_can_be_made_the_test_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent / "nothing"))
    with pytest.raises(AssertionError, match="this test needs ip and nft: apt-get install iproute2 nftables"):
        Hosts("arm").__enter__()
