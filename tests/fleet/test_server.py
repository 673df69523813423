"""The server of a shared arm without a network: who may do what, and that hostile messages change nothing."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import pytest
from tests.control.shared_bench import SharedBench
from tests.waits import PATIENCE

from hexwire.control.sharing.lease import Lease
from hexwire.drivers.values import StopMode
from hexwire.errors import LinkBusyError, RemoteProtocolError, UsageError
from hexwire.fleet import messages as m
from hexwire.fleet import server as module
from hexwire.fleet.names import ClientRole, Keys
from hexwire.fleet.server import ArmServer

KEYS = Keys("lab/arm1")
OPERATOR, MAINTAINER = ClientRole.OPERATOR, ClientRole.MAINTAINER


class Query:
    """A question that arrived."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.replies: list[m.Answer] = []
        self.answered = threading.Event()

    def reply(self, payload: bytes) -> None:
        self.replies.append(m.decode(payload, m.Answer))
        self.answered.set()


class Readers:
    """Those who read an arm's states, or nobody."""

    def __init__(self) -> None:
        self.states: list[m.State] = []
        self.is_wanted = True

    def __call__(self, payload: bytes) -> None:
        assert self.is_wanted
        self.states.append(m.decode(payload, m.State))


class Node:
    """A session that is nowhere."""

    def __init__(self) -> None:
        self.on: dict[str, Callable[[Any], object]] = {}
        self.lanes: dict[str, set[str]] = {}
        self.taken: dict[str, Callable[[bytes], object]] = {}
        self.readers = Readers()
        self.states = self.readers.states
        self.tokens: list[str] = []

    def visible(self, key: str, timeout: float) -> list[str]:
        return self.tokens

    def announce(self, key: str) -> None:
        self.tokens.append(key)

    def watch_visible(self, key: str, on_change: Callable[[str, bool], object], *, at_once: bool) -> None:
        self.on_token = on_change

    def answer(
        self,
        key: str,
        on_question: Callable[[Any], object],
        *,
        lane: str,
        at_once: Callable[[Any], bool] = lambda query: False,
    ) -> None:
        self.lanes.setdefault(lane, set()).add(key)
        self.on[key] = lambda query: at_once(query) or on_question(query)

    def take_at_once(self, key: str, on_payload: Callable[[bytes], object]) -> None:
        self.taken[key] = on_payload

    def publisher(self, key: str) -> Readers:
        return self.readers


class Served:
    """An emulated arm with a server, in simulated time: the owner turns while a question waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
        monkeypatch.setattr(module, "_SETTLE", 0.0)
        # A set-point is made by the test's thread, which may be slow while the owner turns: none is old by that.
        self.bench = SharedBench(**{"lease": Lease(max_age=PATIENCE)} | options)
        self.node = Node()
        self.server = ArmServer(self.bench.shared, "lab/arm1", self.node, server="test", started=1.0)  # type: ignore[arg-type]
        self.server.start()
        self._numbers = iter(range(1, 10**6))

    def put(self, key: str, message: Any) -> Query:
        query = Query(message if isinstance(message, bytes) else m.encode(message))
        self.node.on[key](query)
        return query

    def ask(self, key: str, message: Any) -> m.Answer:
        return self.wait(self.put(key, message))

    def wait(self, query: Query) -> m.Answer:
        # Time passes only while something waits for the owner, not while a thread is slow.
        for _ in range(30_000):
            if query.answered.wait(0.001):
                (answer,) = query.replies
                return answer
            if self.bench.owner._calls._waiting:
                self.bench.owner.turn()
        raise AssertionError("no answer")

    def take(self, client: str = "Ann", role: ClientRole = OPERATOR, **options: Any) -> m.Answer:
        return self.ask(KEYS.lease(role), m.Take(client, **options))

    def order(self, key: int, order: Any, *, role: ClientRole = OPERATOR, **changes: Any) -> m.Answer:
        return self.ask(KEYS.order(role), self.envelope(key, order, **changes))

    def envelope(self, key: int, order: Any, **changes: Any) -> m.Envelope:
        made = {"sequence": next(self._numbers), "made": self.bench.owner.now(), "doubt": 0.0} | changes
        return m.Envelope(key, made["sequence"], made["made"], made["doubt"], order)

    def publish(self, message: m.Envelope | bytes, *, role: ClientRole = OPERATOR) -> None:
        self.node.taken[KEYS.order(role)](message if isinstance(message, bytes) else m.encode(message))

    def told(self, done: Callable[[m.Stream], bool]) -> m.Stream:
        """What the first state tells of set-points of which this is true."""
        for _ in range(3000):
            self.bench.turn(0.02)
            stream = self.node.states[-1].stream
            if stream is not None and done(stream):
                return stream
            threading.Event().wait(0.001)
        raise AssertionError("no state tells it")

    def stop(self, client: str = "Bob", mode: int = 0) -> m.Answer:
        return self.ask(KEYS.stop, m.StopRequest(client, mode))

    def write(self, **goal: float) -> m.Write:
        return m.Write(tuple(goal), tuple(self.bench.where(name) + by for name, by in goal.items()), 5.0)


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    served = Served(monkeypatch)
    yield served
    served.server.close()


def test_an_order_of_the_holder_is_done_and_anybody_elses_refused_with_who_holds_it(served: Served) -> None:
    refused = served.order(5, served.write(J1=0.1))
    assert (refused.kind, refused.text) == ("LeaseError", "this program holds no lease")
    granted = served.take()
    assert granted.kind == ""
    assert served.order(granted.value, served.write(J1=0.1)).kind == ""
    refused = served.order(granted.value ^ 1, served.write(J1=0.1))
    assert (refused.kind, refused.details) == ("LeaseError", {"holder": "Ann, operator", "lost": True})
    assert len(served.bench.sent) == 1
    assert served.bench.shared.refusals()["lease_without_lease"] == 2


def test_the_role_is_that_of_the_key_and_a_maintainers_lease_is_not_an_operators_to_take(served: Served) -> None:
    key = served.take("Ann", MAINTAINER).value
    assert served.take("Bob", force=True).text == "Ann, maintainer holds the lease, and your role may not take it"
    assert served.take("Bob").text.startswith("Ann, maintainer holds the lease; wait")
    refused = served.order(key, m.Ioctl(0, b""))
    assert refused.text == "servo settings and firmware need the role maintainer"
    assert refused.details["lost"] is False, "the lease stays, so that its motion goes on"
    assert served.take("Eve", MAINTAINER, force=True).kind == ""


def test_a_heartbeat_is_answered_at_once_and_refused_to_a_former_holder(served: Served) -> None:
    key = served.take().value
    query = served.put(KEYS.lease(OPERATOR), m.Beat(key, 0.0))
    assert query.answered.is_set(), "in the thread that brought it"
    served.take("Eve", force=True)
    refused = served.put(KEYS.lease(OPERATOR), m.Beat(key, 0.0)).replies[0]
    assert refused.text == "Eve, operator holds the lease"


def test_a_stop_needs_no_lease_and_its_answer_names_what_confirmed_it(served: Served) -> None:
    served.take()
    answer = served.stop()
    assert answer.value == list(served.bench.robot.model.names)
    assert served.bench.board.state.stopped
    served.bench.turn(0.2)
    assert (served.node.states[-1].stopped, served.node.states[-1].reason) == (True, "Bob stopped it")


def test_torque_off_is_only_for_those_whose_key_proves_it_and_the_others_stop_the_arm(served: Served) -> None:
    for key, torque in ((KEYS.stop, True), (KEYS.off(OPERATOR), False), (KEYS.off(MAINTAINER), False)):
        holder = served.take().value
        assert served.order(holder, m.Resume()).kind == ""
        assert served.order(holder, m.Torque(True, None)).kind == ""
        answer = served.ask(key, m.StopRequest("Bob", 1))
        assert answer.value == list(served.bench.robot.model.names)
        assert served.bench.board.state.stopped
        assert served.bench.bench.torques() == [torque] * len(answer.value)
        served.bench.turn(1.0)


def test_a_stop_that_holds_may_come_by_the_key_of_torque_off(served: Served) -> None:
    assert served.ask(KEYS.off(OPERATOR), m.StopRequest("Bob", 0)).kind == ""
    assert all(served.bench.bench.torques())


@pytest.mark.parametrize("by", [KEYS.stop, KEYS.off(OPERATOR)])
def test_a_stop_voids_the_orders_of_its_own_program_that_it_overtakes(served: Served, by: str) -> None:
    key = served.take("Ann").value
    late = [served.envelope(key, served.write(J1=0.1)), served.envelope(key, m.Resume())]
    off = served.envelope(key, m.Torque(False, None))
    stop = served.ask(by, m.StopRequest("Ann", mode=1, key=key, sequence=off.sequence))
    assert stop.kind == ""
    for order in late:
        refused = served.ask(KEYS.order(OPERATOR), order)
        assert (refused.kind, refused.details["lost"]) == ("LeaseError", False)
        assert refused.text == f"order {order.sequence} was made before a stop of the same program; it is not done"
    assert served.bench.board.state.stopped
    assert not served.bench.sent
    assert served.ask(KEYS.order(OPERATOR), off).kind == "", "torque may always be taken off"
    assert served.order(key, m.Resume()).kind == "", "made after the stop"


def test_a_stop_of_ones_own_motion_stops_no_arm_that_another_program_has_taken(served: Served) -> None:
    key = served.take("Ann").value
    assert served.ask(KEYS.stop, m.StopRequest("Ann", key=key, own=True)).kind == "", "she has it"
    served.order(key, m.Resume())
    eve = served.take("Eve", force=True).value
    refused = served.ask(KEYS.stop, m.StopRequest("Ann", key=key, own=True))
    assert refused.kind == "LeaseError"
    assert "Eve" in refused.text
    assert not served.bench.board.state.stopped
    assert served.ask(KEYS.stop, m.StopRequest("Ann", key=key)).kind == "", "a stop that is meant for anybody"
    assert served.bench.board.state.stopped
    served.order(eve, m.Resume())


def test_the_stop_of_another_program_voids_no_later_order_of_the_holder(served: Served) -> None:
    key = served.take("Ann").value
    assert served.ask(KEYS.stop, m.StopRequest("Bob", key=key ^ 1, sequence=2**40)).kind == ""
    assert served.order(key, m.Resume()).kind == ""


def test_a_client_learns_whose_geometry_the_arm_has(served: Served) -> None:
    robot = served.bench.robot
    robot.model = replace(robot.model, geometry="so101")
    assert m.convert(served.ask(KEYS.ask, m.Ask("facts")).value, m.Facts).geometry == "so101"


def test_an_unconfirmed_stop_is_an_error_in_its_answer(served: Served) -> None:
    served.bench.bench.link.lost = True
    query = served.put(KEYS.stop, m.StopRequest("Bob"))
    assert query.answered.wait(30)
    assert query.replies[0].kind
    assert served.bench.owner.group.reason is not None, "nothing is decided any more all the same"


def test_a_stop_passes_slow_orders_probes_and_requests_for_the_lease(served: Served) -> None:
    key = served.take().value
    inside, release = threading.Event(), threading.Event()

    def hang(*_: object) -> Any:
        inside.set()
        release.wait(30)
        raise UsageError("the test ends")

    served.bench._write = hang  # type: ignore[method-assign]
    waiting = [served.put(KEYS.order(OPERATOR), served.envelope(key, served.write(J1=0.1)))]
    assert inside.wait(30)
    waiting += [
        served.put(KEYS.order(OPERATOR), served.envelope(key, m.Torque(True, None))),
        served.put(KEYS.ask, m.Ask("probe")),
        served.put(KEYS.lease(MAINTAINER), m.Take("Eve", True)),
    ]
    query = served.put(KEYS.stop, m.StopRequest("Bob"))
    assert query.answered.wait(30)
    assert query.replies[0].value == list(served.bench.robot.model.names)
    assert served.bench.board.state.stopped
    assert not any(other.answered.is_set() for other in waiting)
    release.set()
    kinds = [served.wait(other).kind for other in waiting]
    assert (kinds[0], kinds[3]) == ("UsageError", "")


def test_a_stop_that_switches_torque_off_does_not_wait_for_one_that_holds(served: Served) -> None:
    inside, release = threading.Event(), threading.Event()
    stop = served.bench.robot.stop

    def hang(mode: Any) -> Any:
        if not mode:
            inside.set()
            release.wait(30)
        return stop(mode)

    served.bench.robot.stop = hang  # type: ignore[method-assign]
    first = served.put(KEYS.stop, m.StopRequest("Ann", 0))
    assert inside.wait(30)
    second = served.put(KEYS.off(OPERATOR), m.StopRequest("Bob", 1))
    assert second.answered.wait(30)
    assert not any(served.bench.bench.torques())
    release.set()
    assert first.answered.wait(30)


def test_a_burst_of_stops_is_few_stops_and_all_are_answered(served: Served) -> None:
    calls, begun, line = list[Any](), threading.Event(), threading.Event()
    stop = served.bench.robot.stop

    def slow(mode: Any) -> Any:
        calls.append(mode)
        begun.set()
        assert line.wait(30)
        return stop(mode)

    served.bench.robot.stop = slow  # type: ignore[method-assign]
    queries = [served.put(KEYS.stop, m.StopRequest("client"))]
    assert begun.wait(30)
    queries += [served.put(KEYS.stop, m.StopRequest(f"client {i}")) for i in range(2356)]
    line.set()
    assert all(query.answered.wait(30) for query in queries)
    assert len(calls) == 2
    refused = [query.replies[0].text for query in queries if query.replies[0].kind]
    assert len(refused) == 2356 - 1000
    assert set(refused) == {"so many stop the arm that this is not answered; it is being stopped"}


@pytest.mark.parametrize(("what", "asks"), [("ping", "ping"), ("counters", "board_counters"), ("probe", "probe")])
def test_a_burst_of_questions_is_few_questions_and_all_are_answered(
    served: Served, monkeypatch: pytest.MonkeyPatch, what: str, asks: str
) -> None:
    calls, begun, line = list[Any](), threading.Event(), threading.Event()

    def slow(*args: Any) -> Any:
        calls.append(args)
        begun.set()
        assert line.wait(30)
        raise UsageError("that is all")

    monkeypatch.setattr(served.bench.shared, asks, slow)
    queries = [served.put(KEYS.ask, m.Ask(what, 1))]
    assert begun.wait(30)
    queries += [served.put(KEYS.ask, m.Ask(what, 1)) for _ in range(1000)]
    line.set()
    assert all(query.answered.wait(30) for query in queries)
    assert {query.replies[0].text for query in queries} == {"that is all"}
    assert len(calls) == 2


def test_a_request_for_the_lease_does_not_wait_for_a_slow_order(served: Served) -> None:
    key = served.take().value
    # It waits for the owner, who does not turn.
    slow = served.put(KEYS.order(OPERATOR), served.envelope(key, m.Torque(True, None)))
    taken = served.put(KEYS.lease(OPERATOR), m.Take("Eve", True))
    assert taken.answered.wait(30)
    assert taken.replies[0].kind == ""
    # Or "took the lease from", between the end of the one lease and the grant of the other.
    assert served.wait(slow).text.startswith("Eve, operator ")


def test_what_waits_for_the_owner_when_the_arm_is_stopped_is_void(served: Served) -> None:
    key = served.take().value
    slow = served.put(KEYS.order(OPERATOR), served.envelope(key, m.Torque(True, None)))
    query = served.put(KEYS.stop, m.StopRequest("Bob"))
    assert query.answered.wait(30)
    assert served.wait(slow).kind == "StoppedError"
    assert all(served.bench.bench.torques())


@pytest.mark.parametrize("first", ["torque off", "the stop"])
def test_torque_off_is_done_although_the_arm_is_stopped_meanwhile(served: Served, first: str) -> None:
    key = served.take().value
    off = served.envelope(key, m.Torque(False, None))
    orders = [(KEYS.order(OPERATOR), off), (KEYS.stop, m.StopRequest("Ann", key=key, sequence=99))]
    queries = [served.put(*order) for order in (orders if first == "torque off" else reversed(orders))]
    assert [served.wait(query).kind for query in queries] == ["", ""]
    assert not any(served.bench.bench.torques())


def test_a_state_counts_only_orders_that_were_done_before_its_values_were_sampled(served: Served) -> None:
    served.bench.turn(0.3)
    key = served.take().value
    before = served.node.states[-1]
    answer = served.order(key, served.write(J1=0.1))
    assert answer.done == 1
    # What was sampled before the order, and is sent after it.
    served.server._send(served.bench.owner.state)
    assert (served.node.states[-1].done, before.done) == (0, 0)
    served.bench.turn(0.3)
    later = served.node.states[-1]
    assert later.done == 1
    assert later.stamp >= answer.clock - 0.1


def test_states_tell_what_became_of_published_set_points(served: Served) -> None:
    taken = served.take()
    key, lease = taken.value, taken.details["lease"]
    assert lease != key, "what everybody reads proves nothing"
    beat = partial(served.ask, KEYS.lease(OPERATOR), m.Beat(key, 0.0))
    first = served.envelope(key, served.write(J1=0.1))
    served.publish(first)
    told = served.told(lambda stream: stream.dealt == first.sequence)
    assert (told.lease, told.refused, told.kind) == (lease, 0, "")
    assert len(served.bench.sent) == 1
    beat()
    # Each is refused for its own reason, and none is done.
    wrong: list[tuple[m.Order, dict[str, float], str]] = [
        (m.Write(("J1",), (9.0,), 0.02), {}, "LimitError"),
        (m.Write(("J1", "J2"), (0.0,), 0.02), {}, "UsageError"),
        (served.write(J1=0.1), {"made": served.bench.owner.now() - 60.0}, "LeaseError"),
        (served.write(J1=0.1), {"sequence": first.sequence}, "LeaseError"),
        (m.Resume(), {}, "UsageError"),
        (m.Torque(False, None), {}, "UsageError"),
    ]
    for refused, (order, changes, kind) in enumerate(wrong, 1):
        beat()
        served.publish(served.envelope(key, order, **changes))
        told = served.told(lambda stream, refused=refused: stream.refused == refused)  # type: ignore[misc]
        assert told.kind == kind
    assert len(served.bench.sent) == 1
    assert all(served.bench.bench.torques())


def test_a_published_set_point_of_nobody_who_holds_the_lease_changes_nothing(served: Served) -> None:
    former = served.take("Ann").value
    key = served.take("Eve", force=True).value
    own = served.envelope(key, served.write(J1=0.1))
    for payload in (
        *(m.encode(served.envelope(other, served.write(J1=0.1))) for other in (former, key ^ 1, 0)),
        *(b"", b"\x01", m.encode(own)[:3], m.encode(own)[:12], m.encode(own) + bytes(m.SHORT), bytes([2]) * 40),
    ):
        served.publish(payload)
    served.publish(own)
    told = served.told(lambda stream: stream.dealt == own.sequence)
    assert len(served.bench.sent) == 1
    assert told.refused == 1, "the one that has her key but is cut off; those of others are not hers"
    assert served.bench.shared.refusals()["lease_without_lease"] == 2


def test_a_stop_voids_the_set_points_that_it_overtakes_and_those_that_wait(served: Served) -> None:
    key = served.take("Ann").value
    late = served.envelope(key, served.write(J1=0.1))
    assert served.ask(KEYS.stop, m.StopRequest("Ann", key=key, sequence=late.sequence)).kind == ""
    served.publish(late)
    assert "before a stop of the same program" in served.told(lambda stream: stream.refused == 1).text
    assert served.order(key, m.Resume()).kind == ""
    assert served.stop().kind == ""
    served.publish(served.envelope(key, served.write(J1=0.1)))
    assert served.told(lambda stream: stream.refused == 2).kind == "StoppedError"
    assert not served.bench.sent


def test_a_robot_that_is_lost_after_an_order_shows_as_lost(served: Served) -> None:
    key = served.take().value
    answer = served.order(key, served.write(J1=0.1))
    served.bench.bench.link.lost = True
    served.bench.bench.until(lambda: not served.bench.owner.connected)
    served.server._send(None)
    assert served.node.states[-1].done == answer.done, "a client waits for no value from after it"
    assert "unplugged" in served.node.states[-1].error


def test_a_state_has_the_owners_clocks_and_a_number_that_rises(served: Served) -> None:
    served.bench.turn(0.5)
    states = served.node.states
    assert [state.sequence for state in states] == list(range(1, len(states) + 1))
    assert len({state.server for state in states}) == 1
    assert all(state.stamp <= state.sent <= served.bench.clock.time for state in states)
    assert all(state.wall > 1.7e9 for state in states)


def test_a_state_that_nobody_reads_is_not_sent(served: Served) -> None:
    states = served.node.states
    for wanted in (True, False, True):
        served.node.readers.is_wanted, before = wanted, len(states)
        for _ in range(10):
            served.bench.owner.turn()
        assert (len(states) > before) == wanted
    assert [b.sequence - a.sequence for a, b in pairwise(states) if b.sequence - a.sequence > 1] == [11]


def test_an_arm_that_holds_says_why_in_its_states(served: Served) -> None:
    key = served.take().value
    served.order(key, served.write(J1=0.3))
    served.bench.turn(0.3)
    assert served.node.states[-1].holder == "Ann, operator"
    served.bench.turn(0.5)
    assert served.node.states[-1].held == "Ann, operator lost the lease after 0.5 s of silence"
    assert served.node.states[-1].holder == ""


def test_a_mistake_in_this_program_is_answered_and_the_next_order_done(
    served: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    key = served.take().value
    with monkeypatch.context() as patch:
        patch.setattr(served.bench.shared, "write", lambda *_: 1 // 0)
        patch.setattr(module, "facts_of", lambda *_: 1 // 0)
        for answer in (served.order(key, served.write(J1=0.1)), served.ask(KEYS.ask, m.Ask("facts"))):
            assert (answer.kind, answer.text[:33]) == ("DeviceError", "the arm's server failed at this: ")
    assert served.order(key, served.write(J1=0.1)).kind == ""


def test_what_a_client_calls_itself_does_not_reach_a_terminal(served: Served) -> None:
    served.take("\x1b[2J\r\nAnn\u202e" + "x" * 4000)
    holder = served.bench.shared.holder
    assert holder is not None
    assert holder.client.startswith("?[2J??Ann?xxx")
    assert holder.client.isprintable()
    assert len(holder.client) < 250


# -- hostile, but well-formed -------------------------------------------------------------------------------------

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    "changes",
    [
        {"made": NAN},
        {"made": INF},
        {"made": -INF},
        {"made": 1e300},
        {"doubt": NAN},
        {"doubt": INF},
        {"doubt": -1.0},
        {"doubt": 1.1 * PATIENCE},
        {"made": -INF, "doubt": INF},
        {"made": 0.0, "doubt": 1e300},
        {"sequence": 0},
    ],
)
def test_a_set_point_that_nobody_can_date_is_refused(served: Served, changes: dict[str, float]) -> None:
    key = served.take().value
    answer = served.order(key, served.write(J1=0.1), **changes)
    assert (answer.kind, answer.details["lost"]) == ("LeaseError", False)
    assert not served.bench.sent
    assert served.order(key, served.write(J1=0.1)).kind == ""


def test_what_is_no_order_is_counted_and_told_to_the_holder(served: Served) -> None:
    key = served.take().value
    before = served.server.refused
    whole = m.encode(m.Envelope(key, 1, 0.0, 0.0, m.Torque(True, ())))
    for count in (1, 2):
        answer = served.ask(KEYS.order(OPERATOR), whole[:-1])
        assert answer.kind == "RemoteProtocolError"
        assert served.server.refused == before + count


@pytest.mark.parametrize(
    "order",
    [
        m.Write((), (), 1.0),
        m.Write(("J1",), (), 1.0),
        m.Write(("J1", "J1"), (0.0, 0.0), 1.0),
        m.Write(("J1",), (NAN,), 1.0),
        m.Write(("J1",), (INF,), 1.0),
        m.Write(("J1",), (1e300,), 1.0),
        m.Write(("J1",), (0.0,), NAN),
        m.Write(("J1",), (0.0,), -1.0),
        m.Write(("J1",), (0.0,), INF),
        m.Write(tuple(f"J{i}" for i in range(64)), (0.0,) * 64, 1.0),
        m.Write(("\x00",), (0.0,), 1.0),
        m.Torque(True, ("J9",)),
        m.Torque(True, ("J1",) * 64),
        m.Torque(False, ("",)),
        m.Watchdog(NAN),
        m.Watchdog(-1.0),
        m.Watchdog(INF),
        m.Watchdog(1e-300),
        m.Watchdog(0.5, 2**62),
        m.Ioctl(2**53, b"\xff" * 4096),
        m.Ioctl(0, b""),
    ],
)
def test_a_hostile_order_is_answered_and_moves_nothing(served: Served, order: Any) -> None:
    key = served.take("Ann", MAINTAINER).value
    answer = served.order(key, order, role=MAINTAINER)
    if not isinstance(order, m.Torque) and order != m.Watchdog(0.5, 2**62):
        assert answer.kind
    assert "failed at this" not in answer.text
    assert not served.bench.sent
    served.put(KEYS.lease(OPERATOR), m.Beat(key, 0.0))
    assert served.order(key, served.write(J1=0.01)).kind == "", "nothing is left locked"


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (KEYS.lease(OPERATOR), m.Take("Bob", False, NAN)),
        (KEYS.lease(OPERATOR), m.Take("Bob", True, -1.0)),
        (KEYS.lease(OPERATOR), m.Take("Bob", True, INF, -(2**62))),
        (KEYS.lease(OPERATOR), m.Beat(0, NAN)),
        (KEYS.lease(OPERATOR), m.Beat(2**53, -1e300)),
        (KEYS.ask, m.Ask("")),
        (KEYS.ask, m.Ask("ping", -1)),
        (KEYS.ask, m.Ask("ping", 2**62)),
        (KEYS.ask, m.Ask("ping", 10**6)),
        (KEYS.ask, m.StopRequest("Bob")),
        (KEYS.stop, m.Ask("clock")),
        (KEYS.order(OPERATOR), m.Beat(1)),
        (KEYS.order(OPERATOR), b""),
        (KEYS.order(OPERATOR), b"\x02\x91"),
        (KEYS.order(OPERATOR), b"\x01" + b"\x91" * 10_000),
    ],
)
def test_a_hostile_request_is_refused_and_the_holder_keeps_the_lease(
    served: Served, key: str, message: Any
) -> None:
    held = served.take().value
    assert served.ask(key, message).kind
    served.put(KEYS.lease(OPERATOR), m.Beat(held, 0.0))
    assert served.order(held, served.write(J1=0.01)).kind == ""


def test_leaving_with_another_key_changes_nothing(served: Served) -> None:
    held = served.take().value
    assert served.ask(KEYS.lease(OPERATOR), m.Leave(held ^ 1)).kind == ""
    assert served.bench.shared.holder is not None


def test_an_idle_time_that_is_none_does_not_keep_the_watchdog_from_tripping(served: Served) -> None:
    key = served.take("Ann", watchdog=0.3).value
    for idle in (INF, 1e300, 0.2, 0.3, 0.4):
        served.bench.turn(0.1)
        assert served.put(KEYS.lease(OPERATOR), m.Beat(key, idle)).replies[0].kind == ""
    served.bench.shared.check()
    assert served.bench.shared.tripped


def test_a_holder_that_uses_up_its_numbers_takes_the_lease_again(served: Served) -> None:
    key = served.take().value
    assert served.order(key, served.write(J1=0.01), sequence=2**53).kind == ""
    assert "came after" in served.order(key, served.write(J1=0.01)).text
    with pytest.raises(RemoteProtocolError):
        m.decode(m.encode(served.envelope(key, m.Resume(), sequence=2**53 + 1)), m.Envelope)
    key = served.take(force=True).value
    assert served.order(key, served.write(J1=0.01)).kind == ""


def test_a_long_order_without_a_lease_is_refused_before_it_is_decoded(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = served.take().value
    decoded = []
    decode = m.decode
    monkeypatch.setattr(m, "decode", lambda payload, kind: (decoded.append(kind), decode(payload, kind))[1])
    row = tuple(float(number) for number in range(10_000))
    refused = served.order(key ^ 1, m.Follow(("J1",), row, row))
    assert refused.text == "Ann, operator holds the lease"
    assert m.Envelope not in decoded
    assert served.bench.shared.refusals()["lease_without_lease"] == 1
    assert served.order(key, m.Follow(("J1",), row, row)).kind == "GoalError"
    assert m.Envelope in decoded


def test_ten_thousand_orders_without_a_lease_are_refused_counted_and_queued_nowhere(served: Served) -> None:
    key = served.take().value
    payload = m.encode(served.envelope(key ^ 1, served.write(J1=0.1)))
    for _ in range(10_000):
        query = served.put(KEYS.order(OPERATOR), payload)
        assert query.answered.is_set()
    assert served.bench.shared.refusals()["lease_without_lease"] == 10_000
    assert served.order(key, served.write(J1=0.01)).kind == ""
    assert len(served.bench.sent) == 1


# -- two servers of a name -----------------------------------------------------------------------------------------

SOON, LATE = (f"{int(1e6 * started):016x}-ff" for started in (9.9, 1_700_000_010.0))
"""Instances of servers that were started then."""


class TwoNodes(Node):
    """A session that another server's token becomes visible to.

    Args:
        before: What is visible before this server announces itself.
        after: And after.
    """

    def __init__(self, before: tuple[str, ...] = (), after: tuple[str, ...] = ()) -> None:
        super().__init__()
        self._before, self._after = before, after

    def visible(self, key: str, timeout: float) -> list[str]:
        assert key == KEYS.alive
        return [*self.tokens, *(self._after if self.tokens else self._before)]


def started(monkeypatch: pytest.MonkeyPatch, node: Node, when: float, **options: Any) -> ArmServer:
    monkeypatch.setattr(module, "_SETTLE", 0.0)
    server = ArmServer(SharedBench(on=False).shared, "lab/arm1", node, started=when, **options)  # type: ignore[arg-type]
    try:
        server.start()
    except BaseException:
        server.close()
        raise
    return server


@pytest.mark.parametrize("instance", [SOON, LATE])
def test_a_name_that_is_served_is_taken_whenever_its_server_was_started(
    monkeypatch: pytest.MonkeyPatch, instance: str
) -> None:
    node = TwoNodes((KEYS.token(instance),))
    with pytest.raises(LinkBusyError, match="the name lab/arm1 is already served by another program"):
        started(monkeypatch, node, 1_700_000_000.0)
    assert not node.tokens


def test_of_two_servers_that_start_together_the_older_one_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    others = (KEYS.token(LATE), Keys("lab/arm2").token(SOON), "hexwire/lab/arm1/nonsense")
    server = started(monkeypatch, TwoNodes(after=others), 1_700_000_000.0)
    assert not server.conflict
    server.close()
    with pytest.raises(LinkBusyError, match="already served"):
        started(monkeypatch, TwoNodes(after=(KEYS.token(LATE),)), 1_700_000_020.0)
    with pytest.raises(LinkBusyError, match="already served"):
        started(monkeypatch, TwoNodes(after=(KEYS.token(SOON),)), 10.0)


def test_when_a_network_is_joined_again_the_server_that_was_started_later_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = Node()
    server = started(monkeypatch, node, 1_700_000_000.0)
    (own,) = node.tokens
    # Itself, a later one, one that has gone, another name: no reason to end.
    for key, visible in (
        (own, True),
        (KEYS.token(LATE), True),
        (KEYS.token(SOON), False),
        (Keys("lab/arm2").token(SOON), True),
    ):
        node.on_token(key, visible)
        assert server.conflict == "", key
    node.on_token(KEYS.token(SOON), True)
    assert server.conflict == "another server offers lab/arm1, and was started earlier"
    server.close()


def test_of_two_that_start_at_the_same_moment_one_and_only_one_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = [Node(), Node()]
    servers = [started(monkeypatch, node, 5.0) for node in nodes]
    for node, other in zip(nodes, reversed(nodes), strict=True):
        node.on_token(other.tokens[0], True)
    assert sorted(bool(server.conflict) for server in servers) == [False, True]
    for server in servers:
        server.close()


def test_a_server_that_only_the_router_shows_counts_too(monkeypatch: pytest.MonkeyPatch) -> None:
    class Guard:
        """What is seen behind a router."""

        def visible(self) -> list[str]:
            return [KEYS.token(LATE)]

        def watch(self, on_token: Callable[[str, bool], object]) -> None:
            self.on_token = on_token

    with pytest.raises(LinkBusyError, match="already served"):
        started(monkeypatch, Node(), 1.0, guard=Guard())
    monkeypatch.setattr(Guard, "visible", lambda self: [])
    guard = Guard()
    server = started(monkeypatch, Node(), 1_700_000_000.0, guard=guard)
    guard.on_token(KEYS.token(SOON), True)
    assert server.conflict
    server.close()


def test_an_arm_that_somebody_else_stopped_is_said_to_be_stopped_without_a_reason(served: Served) -> None:
    state = served.bench.robot.read()
    assert served.server._message(state, 0.0).stopped is False
    message = served.server._message(replace(state, stopped=True), 0.0)
    assert (message.stopped, message.reason) == (True, "")
    assert served.server._message(None, 0.0).stopped is False
    served.stop()
    message = served.server._message(replace(state, stopped=False), 0.0)
    assert (message.stopped, message.reason) == (True, "Bob stopped it")


def test_a_server_that_nobody_closes_does_not_keep_its_program(served: Served) -> None:
    key = served.take().value
    served.order(key, served.write(J1=0.1))
    served.ask(KEYS.ask, m.Ask("ping", 1))
    names = {thread.name: thread.daemon for thread in threading.enumerate()}
    assert {name: names.get(name) for name in ("orders", "leases", "stops", "questions")} == {
        **dict.fromkeys(("orders", "leases", "stops", "questions"), True)
    }


def test_only_the_threads_of_stops_stay_where_nothing_is_asked(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = ("orders", "leases", "questions")
    assert not [thread for thread in threading.enumerate() if thread.name in others]
    assert [thread.name for thread in threading.enumerate()].count("stops") == len(StopMode)
    key = served.take().value

    def none(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none)
    assert "busy" in served.put(KEYS.order(OPERATOR), served.envelope(key, served.write(J1=0.1))).replies[0].text
    query = served.put(KEYS.stop, m.StopRequest("Bob"))
    assert query.answered.wait(30)
    assert served.bench.board.state.stopped, "a stop needs no new thread"


def test_stops_and_the_lease_wait_for_no_other_question(served: Served) -> None:
    lanes = served.node.lanes
    assert lanes.pop("stops") == {KEYS.stop, KEYS.off(OPERATOR), KEYS.off(MAINTAINER)}
    assert lanes.pop("leases") == {KEYS.lease(OPERATOR), KEYS.lease(MAINTAINER)}
    assert set(lanes) == {"questions"}
