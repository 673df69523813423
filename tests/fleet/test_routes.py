"""The ways to arms, in simulated time: when one is tried, what is seen on it, and who is silent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hexwire.errors import LinkNotFoundError
from hexwire.fleet import roster as module
from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.node import NoAnswerError
from hexwire.fleet.roster import HUNG, SLOW, Roster, _Route

ARM, OTHER = Keys("lab/arm1").token("1"), Keys("hall/arm1").token("1")
SOCKET = Path("/nowhere/lab+arm1.sock")


class FakeNode:
    """A session at which a test says what is visible.

    Attributes:
        tokens: What an answer to the question for tokens has.
        heard: What a subscriber hears.
        lasts: For how many looks the connection stays.
    """

    cert = ""

    def __init__(self, *tokens: str, lasts: int = 3) -> None:
        self.tokens, self.heard, self.lasts = list(tokens), list(tokens), lasts
        self.asked: list[str] = []
        self.closed = False
        self.neighbours: Exception | None = None

    @property
    def connections(self) -> int:
        self.lasts -= 1
        return int(self.lasts >= 0)

    def visible(self, key: str, timeout: float) -> list[str]:
        self.asked.append(key)
        return self.tokens

    def watch_visible(self, key: str, on_change: Callable[[str, bool], object]) -> None:
        for token in self.heard:
            on_change(token, True)

    def ask_neighbours(self, timeout: float) -> None:
        if self.neighbours is not None:
            raise self.neighbours

    def close(self) -> None:
        self.closed = True


class Bench:
    """A roster whose one route is run in this thread; time passes while it waits.

    Attributes:
        tries: What comes of each attempt to connect; the roster ends after the last one.
        when: When each was made, seconds.
        looks: What was seen and who was silent, each time that it waited.
    """

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        *tries: FakeNode | Exception,
        pattern: str = "lab/*",
        local: bool = False,
    ) -> None:
        self.now, self.tries = 100.0, list(tries)
        self.when: list[float] = []
        self.looks: list[tuple[list[str], dict[str, str]]] = []
        self.changes: list[tuple[str, bool]] = []
        monkeypatch.setattr(module, "time", self)
        self.roster = Roster(pattern, on_change=lambda name, there: self.changes.append((name, there)))
        self.roster._ending = self  # type: ignore[assignment]  # an event
        self.route = self.add("lab/arm1" if local else "the router", SOCKET if local else None)
        self.route.network = self  # type: ignore[assignment]

    def add(self, name: str, socket: Path | None) -> _Route:
        route = _Route(self.roster, Network(connect=("tcp/127.0.0.1:1",)), name, socket)
        self.roster._routes[str(socket or name)] = route
        return route

    def run(self) -> None:
        self.roster._run(self.route)

    # As a clock, an event and a network.

    def monotonic(self) -> float:
        return self.now

    def is_set(self) -> bool:
        return not self.tries

    def wait(self, seconds: float) -> bool:
        self.looks.append((list(self.roster.seen()), self.roster.silent()))
        self.now += seconds
        return self.is_set() and self.route.node is None

    def open(self) -> FakeNode:
        self.when.append(self.now)
        found = self.tries.pop(0)
        if isinstance(found, Exception):
            raise found
        return found


NOBODY = LinkNotFoundError("nobody answers", url="tcp/x")


# -- who is silent -------------------------------------------------------------------------------------------------


def test_a_route_is_silent_for_its_reason_or_if_it_is_tried_for_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    roster = bench.roster
    roster._routes.clear()
    for name, tried, error, age in (
        ("answers", True, "", 1.0),
        ("answers late", True, "", 100.0),
        ("refuses", True, "no right", 1.0),
        ("begins", False, "", SLOW - 0.01),
        ("begins again", False, "lost", SLOW - 0.01),
        ("hangs", False, "", SLOW),
        ("fails", False, "lost", SLOW),
    ):
        route = bench.add(name, None)
        route.error, route.began = error, bench.now - age
        if tried:
            route.tried.set()
    assert roster.silent() == {"refuses": "no right", "hangs": HUNG, "fails": "lost"}
    assert not roster.settled
    for route in roster._routes.values():
        route.tried.set()
    assert roster.settled
    assert roster.settle(0.0)


# -- a route -------------------------------------------------------------------------------------------------------


def test_a_router_that_is_not_there_is_tried_again_after_a_second_and_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = FakeNode(ARM)
    bench = Bench(monkeypatch, NOBODY, NOBODY, node)
    bench.run()
    assert bench.when == [100.0, 101.0, 102.0]
    assert bench.looks[0] == ([], {"the router": "nobody answers"})
    assert bench.looks[2] == (["lab/arm1"], {}), "once it is there, nothing is wrong"
    assert node.asked == [Keys("lab/*").alive]


def test_the_arms_of_a_connection_go_with_it_and_come_with_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = [FakeNode(ARM, OTHER), FakeNode(ARM)]
    bench = Bench(monkeypatch, *nodes)
    bench.run()
    assert bench.changes == [("lab/arm1", True), ("lab/arm1", False)] * 2
    assert [node.closed for node in nodes] == [True, True]
    assert bench.route.error == "the connection is lost; trying again"
    assert bench.roster.seen() == {}
    # A connection that stays is looked at every 0.2 s.
    assert bench.now == pytest.approx(100.0 + 2 * 3 * 0.2)


@pytest.mark.parametrize(
    ("error", "said"),
    [(None, {}), (NoAnswerError(absent=False), {"the router": HUNG}), (NOBODY, {"the router": "nobody answers"})],
)
def test_why_a_router_shows_no_arm(
    monkeypatch: pytest.MonkeyPatch, error: Exception | None, said: dict[str, str]
) -> None:
    node = FakeNode()
    node.neighbours = error
    bench = Bench(monkeypatch, node)
    bench.run()
    assert bench.looks[-1] == ([], said)
    assert bench.route.tried.is_set()


def test_a_server_of_this_machine_has_three_seconds_to_name_its_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "is_served", lambda path: True)
    node = FakeNode()
    bench = Bench(monkeypatch, node, local=True)
    bench.run()
    assert bench.looks[0] == ([], {})
    assert bench.looks[-1] == ([], {"lab/arm1": HUNG})
    hung = next(i for i, (_, silent) in enumerate(bench.looks) if silent)
    assert 0.01 * hung == pytest.approx(3.0, abs=0.03)
    assert set(node.asked) == {Keys("**").alive}, "its only arm, so that an empty answer comes too early"


@pytest.mark.parametrize("served", [True, False])
def test_a_socket_whose_program_ends_is_no_route_any_more(monkeypatch: pytest.MonkeyPatch, served: bool) -> None:
    monkeypatch.setattr(module, "is_served", lambda path: served)
    bench = Bench(monkeypatch, NOBODY, FakeNode(ARM), local=True)
    bench.run()
    assert len(bench.when) == (2 if served else 1)
    assert bench.route.error == ("the connection is lost; trying again" if served else "nobody answers")
    if served:
        # It is there, and does not take the connection.
        assert bench.looks[0] == ([], {"lab/arm1": HUNG})
    assert not bench.roster._routes


# -- one arm on two routes -----------------------------------------------------------------------------------------


def test_an_arm_on_two_routes_is_one_arm_and_the_near_way_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    near, far = FakeNode(), FakeNode()
    bench.route.node = far  # type: ignore[assignment]
    local = bench.add("lab/arm1", SOCKET)
    local.node = near  # type: ignore[assignment]
    roster, second = bench.roster, Keys("lab/arm1").token("2")
    roster._token(bench.route, ARM, True)
    assert (roster.seen()["lab/arm1"].node, roster.seen()["lab/arm1"].local) == (far, False)
    roster._token(local, ARM, True)
    assert (roster.seen()["lab/arm1"].node, roster.seen()["lab/arm1"].local) == (near, True)
    # Another server of it, and one that is not of interest.
    roster._token(local, second, True)
    roster._token(local, OTHER, True)
    roster._token(local, "hexwire/nonsense", True)
    roster._token(local, ARM, False)
    assert roster.seen()["lab/arm1"].local
    roster._token(local, second, False)
    assert not roster.seen()["lab/arm1"].local
    assert bench.changes == [("lab/arm1", True)]
    roster._lost(bench.route)
    assert bench.changes == [("lab/arm1", True), ("lab/arm1", False)]
    assert roster.seen() == {}
    # A route whose session is closed shows nothing.
    local.node = None
    roster._token(local, ARM, True)
    assert roster.seen() == {}
