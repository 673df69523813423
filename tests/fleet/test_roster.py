"""Which arms are there: those with a server, as soon as it is there and as long as it is."""

from __future__ import annotations

import socket
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.few import few
from tests.link.far_ends import free_port
from tests.waits import PATIENCE, eventually

from hexwire.errors import UsageError
from hexwire.fleet import roster as module
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.node import NoAnswerError, Node
from hexwire.fleet.rights import Kind
from hexwire.fleet.roster import HUNG, Roster

from .lab import Lab


def offer(name: str, *instances: str, endpoint: str = "") -> Node:
    """A server as others see it: a socket and a token."""
    network = Network(listen=(endpoint,)) if endpoint else Network(listen=endpoints_of([local_socket(name)]))
    node = network.open(wait=False)
    for instance in instances or ("1",):
        node.announce(Keys(name).token(instance))
    return node


def test_arms_appear_and_vanish_with_their_servers(runtime: Path) -> None:
    changes: list[tuple[str, bool]] = []
    with Roster(on_change=lambda name, there: changes.append((name, there))) as roster:
        assert roster.settle(PATIENCE)
        assert roster.seen() == {}
        one = offer("lab/arm1")
        two = offer("arm2")
        eventually(lambda: len(roster.seen()) == 2)
        assert [seen.local for seen in roster.seen().values()] == [True, True]
        one.close()
        eventually(lambda: list(roster.seen()) == ["arm2"])
        # The same name, another server.
        one = offer("lab/arm1", "2")
        eventually(lambda: len(roster.seen()) == 2)
        one.close()
        two.close()
        eventually(lambda: not roster.seen())
        eventually(lambda: changes.count(("lab/arm1", False)) == 2)
    assert changes.count(("lab/arm1", True)) == changes.count(("lab/arm1", False)) == 2


def test_a_pattern_selects_arms(runtime: Path) -> None:
    nodes = [offer(name) for name in ("lab/arm1", "lab/arm2", "hall/arm1")]
    with Roster("lab/*") as roster:
        assert roster.settle(PATIENCE)
        assert list(roster.seen()) == ["lab/arm1", "lab/arm2"]
    for node in nodes:
        node.close()
    with pytest.raises(UsageError, match="matches no arm"):
        Roster("lab/arm*")


@pytest.mark.parametrize(
    ("pattern", "allowed", "asked"),
    [
        ("lab/arm1", None, ["lab/arm1"]),
        ("lab/arm1", ("lab/*", "hall/*"), ["lab/arm1"]),
        ("lab/arm1", ("hall/*",), ["hall/*"]),
        ("**", ("lab/*", "hall/*"), ["lab/*", "hall/*"]),
        ("**", ("**",), ["**"]),
        ("lab/*", ("**", "hall/*"), ["lab/*"]),
    ],
)
def test_nobody_is_asked_for_more_than_the_certificate_allows(
    pattern: str, allowed: tuple[str, ...] | None, asked: list[str]
) -> None:
    roster = Roster(pattern)
    roster._rights = allowed and SimpleNamespace(arms=allowed)  # type: ignore[assignment]
    far, near = SimpleNamespace(socket=None), SimpleNamespace(socket=Path("a"))
    assert roster._patterns(far) == asked  # type: ignore[arg-type]
    assert roster._patterns(near) == ["**"]  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_server_that_hangs_is_named_and_delays_no_other(runtime: Path) -> None:
    path = local_socket("lab/hung")
    node = offer("lab/arm1")
    with socket.socket(socket.AF_UNIX) as hung:
        hung.bind(str(path))
        hung.listen()
        with Roster() as roster:
            eventually(roster.seen)
            assert not roster.settled
            assert roster.settle(PATIENCE)
            assert roster.silent() == {"lab/hung": HUNG}
            assert list(roster.seen()) == ["lab/arm1"]
    node.close()


def test_a_server_that_does_not_name_its_arm_in_time_is_named_as_silent(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_OWN_TOKEN", 0.2)
    slow = Network(listen=endpoints_of([local_socket("lab/arm1")])).open(wait=False)
    with Roster("lab/*") as roster:
        assert roster.settle(PATIENCE)
        assert (roster.seen(), roster.silent()) == ({}, {"lab/arm1": HUNG})
        slow.announce(Keys("lab/arm1").token("1"))
        eventually(lambda: list(roster.seen()) == ["lab/arm1"])
        assert roster.silent() == {}
    slow.close()


@pytest.mark.slow
def test_arms_behind_a_router_and_a_router_that_is_lost(runtime: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    way = Network(connect=(endpoint,))
    with Roster(router=way) as roster:
        assert roster.settle(PATIENCE)
        assert "nobody answers" in roster.silent()[endpoint]
        router = Network(listen=(endpoint,), router=True).open()
        far = Network(connect=(endpoint,)).open()
        far.announce(Keys("lab/far").token("1"))
        seen = eventually(roster.seen)["lab/far"]
        assert not seen.local
        assert roster.silent() == {}
        # The same arm on two ways is one arm, and the near way counts.
        near = offer("lab/far")
        eventually(lambda: roster.seen()["lab/far"].local)
        near.close()
        eventually(lambda: not roster.seen()["lab/far"].local)
        router.close()
        eventually(lambda: not roster.seen())
        assert eventually(roster.silent)
    far.close()


@few("pattern", ["**", "lab/*", "lab/**", "*/arm1", "lab/arm1"], "**", "*/arm1")
def test_whoever_asks_for_more_than_the_certificate_is_for_sees_what_it_is_for(
    runtime: Path, tmp_path: Path, pattern: str
) -> None:
    lab = Lab(tmp_path)
    lab.issue("one", Kind.ARM, "lab/arm1")
    lab.issue("two", Kind.ARM, "hall/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*", "cellar/x")
    with lab.routing(), lab.session("one") as one, lab.session("two") as two:
        one.announce(Keys("lab/arm1").token("1"))
        two.announce(Keys("hall/arm1").token("1"))
        eventually(lambda: one.visible(Keys("lab/arm1").alive, 1.0) and two.visible(Keys("hall/arm1").alive, 1.0))
        with Roster(pattern, lab.network("anna")) as roster:
            assert roster.settle(PATIENCE)
            assert list(roster.seen()) == ["lab/arm1"]


def test_many_looks_see_all_arms_at_once(runtime: Path) -> None:
    """Zenoh's answer is complete only if nothing subscribes to the same at that moment."""
    nodes = [offer(f"lab/arm{i}") for i in range(5)]
    for _ in range(10):
        with Roster("lab/*") as roster:
            assert roster.settle(PATIENCE)
            assert len(roster.seen()) == len(nodes)
    for node in nodes:
        node.close()


def test_a_router_that_does_not_know_the_certificate_is_named_as_the_reason(runtime: Path, tmp_path: Path) -> None:
    lab = Lab(tmp_path)
    lab.issue("one", Kind.ARM, "lab/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    lab.issue("new", Kind.OPERATOR, "lab/*", known=False)
    with lab.routing():
        with Roster("**", lab.network("new")) as roster:
            assert roster.settle(PATIENCE)
            assert "the router does not know the certificate" in roster.silent()[lab.endpoint]
        with Roster("**", lab.network("anna")) as roster:
            assert roster.settle(PATIENCE)
            # Nobody is there, and that is all.
            assert (roster.seen(), roster.silent()) == ({}, {})
            with lab.session("one") as one:
                one.announce(Keys("lab/arm1").token("1"))
                eventually(roster.seen)


def test_a_router_that_does_not_answer_is_reported_until_an_arm_is_seen(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = Network(listen=(endpoint,), router=True).open()

    def silent(node: Node, timeout: float) -> None:
        raise NoAnswerError(absent=False)

    monkeypatch.setattr(Node, "ask_neighbours", silent)
    with Roster(router=Network(connect=(endpoint,))) as roster:
        assert roster.settle(PATIENCE)
        assert roster.silent() == {endpoint: HUNG}
        far = Network(connect=(endpoint,)).open()
        far.announce(Keys("lab/far").token("1"))
        eventually(roster.seen)
        assert roster.silent() == {}
    far.close()
    router.close()
