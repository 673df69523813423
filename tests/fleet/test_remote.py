"""A shared arm as a driver: its authority in one process over a socket, and hostile answers without a network."""

from __future__ import annotations

import math
import queue
import random
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate, pairwise
from typing import Any

import pytest
from tests.fleet.conftest import Serve
from tests.fleet.fake_inbox import FakeInbox
from tests.fleet.fake_server import FACTS, SENT, TARGET, FakeServer, attached
from tests.motion.arms import rest_to_rest
from tests.test_arguments import assert_told
from tests.waits import eventually

from hexwire.drivers import registry
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    HexwireError,
    LeaseError,
    LinkPermissionError,
    RemoteProtocolError,
    StoppedError,
    UsageError,
)
from hexwire.fleet import messages as m
from hexwire.fleet import remote
from hexwire.fleet.address import Address
from hexwire.fleet.names import ClientRole
from hexwire.fleet.remote import RemoteRobot, whoami
from hexwire.fleet.states import ArrivedStates
from hexwire.model.state import JointState, JointTarget

# -- over a socket ------------------------------------------------------------------------------------------------


@pytest.fixture
def connect(serve: Serve) -> Iterator[Callable[..., RemoteRobot]]:
    """Drivers of the same arm, whose lease lasts 2 s: these machines stall."""
    serve("lab/arm1", lease=2.0)
    robots: list[RemoteRobot] = []

    def connected(options: str = "") -> RemoteRobot:
        robot = registry.connect(f"zenoh:lab/arm1{options}")
        assert isinstance(robot, RemoteRobot)
        robots.append(robot)
        return robot

    yield connected
    for robot in robots:
        robot.abort()


def near(robot: RemoteRobot, by: float = 0.02, seconds: float = 0.2) -> JointTarget:
    return JointTarget.of({"J1": robot.read()["J1"].position + by}, seconds)


def test_the_first_order_takes_the_lease_and_others_hear_who_has_it(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    assert ann.holder == ""
    ann.torque(True)
    assert set(ann.read().torque_on) == set(ann.model.names)
    assert ann.holder.startswith(whoami())
    for call in (lambda: bob.torque(False), lambda: bob.write(near(bob)), bob.take):
        with pytest.raises(LeaseError, match=r"holds the lease") as caught:
            call()
        assert caught.value.holder == ann.holder
    assert set(bob.read().torque_on) == set(ann.model.names)
    # Reading, asking and the counters need no lease.
    assert bob.ping(1) == 0
    assert bob.probe().link == "zenoh:lab/arm1"
    assert bob.board_counters()["lease_without_lease"] == 0


@pytest.mark.slow
def test_a_read_after_an_order_is_never_older(connect: Callable[..., RemoteRobot]) -> None:
    robot = connect()
    for on in (True, False) * 10:
        robot.torque(on)
        assert bool(robot.read().torque_on) is on


def test_everybody_stops_and_only_the_holder_ends_it(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    ann.torque(True)
    ann.write(near(ann, 0.5, 10.0))
    assert bob.stop() == ann.model.names
    assert bob.read().stopped
    with pytest.raises(StoppedError):
        ann.write(near(ann))
    with pytest.raises(LeaseError):
        bob.resume()
    assert bob.read().stopped
    ann.resume()
    assert not ann.read().stopped
    ann.write(near(ann))


def test_pre_emption_tells_the_former_holder_who_does_not_take_it_back_by_itself(
    connect: Callable[..., RemoteRobot],
) -> None:
    ann, eve = connect(), connect("?take=1")
    ann.torque(True)
    ann.write(near(ann, 0.5, 10.0))
    eve.take()
    # By the answer to the order, or by that to a heartbeat before.
    with pytest.raises(LeaseError, match=r"holds the lease|took the lease"):
        ann.write(near(ann))
    eve.release()
    with pytest.raises(LeaseError, match="take the lease again"):
        ann.write(near(ann))
    # The arm holds where it was.
    here = ann.read()["J1"].position
    ann.take()
    ann.write(near(ann))
    assert ann.read()["J1"].position == pytest.approx(here, abs=0.05)


def test_taking_the_lease_again_has_no_effect(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    ann.torque(True)
    before = ann.board_counters()["lease_preempted"]
    for force in (None, True):
        ann.take(force=force)
        ann.write(near(ann))
    assert not ann.held
    bob.take(force=True)
    # The key of a former holder is worth nothing.
    with pytest.raises(LeaseError, match="holds the lease; wait"):
        ann.take()
    ann.take(force=True)
    ann.write(near(ann))
    assert ann.board_counters()["lease_preempted"] == before + 2


@pytest.mark.slow
def test_a_silent_holder_loses_it_and_a_resume_takes_it_again(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    ann.torque(True)
    ann._ending.set()
    eventually(lambda: bob.held)
    assert "lost the lease after 2 s of silence" in bob.held
    assert bob.holder == ""
    with pytest.raises(LeaseError, match="lost the lease"):
        ann.write(near(ann))
    with pytest.raises(LeaseError, match="take the lease again"):
        ann.write(near(ann))
    ann.resume()
    ann.write(near(ann))
    eventually(lambda: not bob.held)


@pytest.mark.slow
def test_a_heartbeat_keeps_it_for_a_program_that_does_nothing(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    ann.torque(True)
    for _ in range(5):
        time.sleep(0.6)
        assert bob.read()
    assert not bob.held
    ann.write(near(ann))


def test_who_detaches_gives_it_back(connect: Callable[..., RemoteRobot]) -> None:
    ann, bob = connect(), connect()
    ann.torque(True)
    ann.detach()
    bob.write(near(bob))
    assert not bob.held


def test_the_offset_of_the_owners_clock_has_an_uncertainty(connect: Callable[..., RemoteRobot]) -> None:
    robot = connect()
    offset, doubt = robot.clock_offset
    assert abs(offset) <= doubt, "it is the same clock"
    assert doubt < 1.0
    before = time.monotonic()
    state = robot.read()
    assert before - 1.0 < state.stamp <= time.monotonic()


@pytest.mark.slow
def test_two_threads_of_a_program_order_one_after_the_other(connect: Callable[..., RemoteRobot]) -> None:
    robot = connect()
    robot.torque(True)
    target = near(robot)
    failed: list[HexwireError] = []

    def order() -> None:
        for _ in range(20):
            try:
                robot.write(target)
            except HexwireError as error:
                failed.append(error)

    threads = [threading.Thread(target=order) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not failed
    assert robot.board_counters()["lease_out_of_order"] == 0


def test_an_observer_reads_and_stops_and_nothing_else(connect: Callable[..., RemoteRobot]) -> None:
    robot = connect("?role=observer")
    assert robot.read()
    for call in (robot.take, robot.resume, lambda: robot.torque(True)):
        with pytest.raises(LinkPermissionError, match="observer"):
            call()
    assert robot.stop()


# -- without a network --------------------------------------------------------------------------------------------


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[RemoteRobot, FakeServer]]:
    robot, node = attached(monkeypatch)
    node.asked.clear()
    yield robot, node
    robot.abort()


def test_orders_carry_lease_number_time_and_its_uncertainty(fake: tuple[RemoteRobot, FakeServer]) -> None:
    robot, node = fake
    node.answers = [lambda: m.Answer("", value=99, clock=time.monotonic()), SENT, SENT]
    before = time.monotonic()
    robot.write(TARGET)
    robot.write(TARGET)
    first, second = node.orders()
    assert (first.key, first.sequence, second.sequence) == (99, 1, 2)
    assert 0.0 < first.doubt < 10.0
    assert before - first.doubt <= first.made <= time.monotonic() + first.doubt


def test_the_newest_state_is_there_at_once_with_its_age_and_a_read_waits_for_the_next(
    fake: tuple[RemoteRobot, FakeServer],
) -> None:
    robot, _ = fake
    inbox = robot._states._inbox
    assert isinstance(inbox, FakeInbox)
    columns = [tuple([0.0] * len(robot.model.names))] * 6

    def arrives(number: int, ago: float) -> None:
        at = time.monotonic() - ago
        flags, age = (0,) * len(robot.model.names), columns[0]
        row = m.State(1, number, at, at, 1.7e9, robot.model.names, *columns, flags, age, 0.0, False, False, False)
        inbox.rows.put(m.encode(row))

    arrives(1, ago=0.5)
    first, again = robot.newest(), robot.newest()
    assert first.state.stamp == again.state.stamp
    assert 0.4 < first.age <= again.age
    read: queue.SimpleQueue[JointState] = queue.SimpleQueue()
    thread = threading.Thread(target=lambda: read.put(robot.read()))
    thread.start()
    assert inbox.waiting.acquire(timeout=30)
    assert robot.newest().state.stamp == first.state.stamp, "also while another thread waits"
    assert read.empty()
    arrives(2, ago=0.0)
    assert read.get(timeout=30).stamp > first.state.stamp
    thread.join(30)


def test_a_watchdog_stops_as_it_was_armed_to(fake: tuple[RemoteRobot, FakeServer]) -> None:
    robot, node = fake
    robot.watchdog(0.5, StopMode.TORQUE_OFF)
    robot.take()
    robot.watchdog(1.0, StopMode.TORQUE_OFF)
    taken = next(message for key, message in node.asked if key.endswith("lease"))
    assert (taken.watchdog, taken.mode) == (0.5, StopMode.TORQUE_OFF)
    assert [envelope.order for envelope in node.orders()] == [m.Watchdog(1.0, StopMode.TORQUE_OFF)]


def test_the_first_order_after_the_restart_of_the_owners_computer_carries_its_new_clock(
    fake: tuple[RemoteRobot, FakeServer],
) -> None:
    robot, node = fake
    node.answers = [lambda: m.Answer("", value=99, clock=time.monotonic() - 1000.0), SENT]
    robot.write(TARGET)
    (order,) = node.orders()
    assert abs(order.made - (time.monotonic() - 1000.0)) < 600.0


def test_an_order_that_came_late_does_not_cost_the_lease(fake: tuple[RemoteRobot, FakeServer]) -> None:
    robot, node = fake
    late = m.Answer("LeaseError", "the set-point is 300 ms old", {"holder": "somebody", "lost": False})
    node.answers = [m.Answer("", value=99), late, SENT]
    with pytest.raises(LeaseError, match="300 ms"):
        robot.write(TARGET)
    robot.write(TARGET)
    assert [order.sequence for order in node.orders()] == [1, 2]


def test_a_lease_that_was_lost_is_not_taken_by_an_order(fake: tuple[RemoteRobot, FakeServer]) -> None:
    robot, node = fake
    node.answers = [
        m.Answer("", value=99),
        m.Answer("LeaseError", "Eve holds the lease", {"holder": "Eve", "lost": True}),
    ]
    for _ in range(3):
        with pytest.raises(LeaseError, match="Eve holds the lease"):
            robot.write(TARGET)
    assert len(node.orders()) == 1
    node.answers = [m.Answer("", value=100), m.Answer(""), SENT]
    robot.resume()
    robot.write(TARGET)
    assert [order.key for order in node.orders()] == [99, 100, 100]


def test_what_was_asked_before_a_stop_of_this_program_is_not_sent(fake: tuple[RemoteRobot, FakeServer]) -> None:
    robot, node = fake
    node.answers = [m.Answer("", value=99), SENT]
    robot.write(TARGET)
    reached, go = threading.Event(), threading.Event()

    class Slow:
        """Another thread's order is being answered."""

        def __enter__(self) -> None:
            reached.set()
            go.wait(30)

        def __exit__(self, *_: object) -> None:
            pass

    robot._ordering = Slow()  # type: ignore[assignment]
    caught: list[HexwireError] = []

    def write() -> None:
        try:
            robot.write(TARGET)
        except HexwireError as error:
            caught.append(error)

    thread = threading.Thread(target=write)
    thread.start()
    assert reached.wait(30)
    node.answers = [m.Answer("", value=["J1"])]
    assert robot.stop() == ("J1",), "it does not wait for the order"
    go.set()
    thread.join(30)
    assert len(node.orders()) == 1
    assert isinstance(caught[0], StoppedError)


CALLS: list[Callable[[RemoteRobot], object]] = [
    lambda robot: robot.write(TARGET),
    lambda robot: robot.torque(True),
    lambda robot: robot.ioctl(1, b""),
    RemoteRobot.stop,
    RemoteRobot.resume,
    RemoteRobot.take,
    RemoteRobot.release,
    RemoteRobot.probe,
    lambda robot: robot.ping(1),
    RemoteRobot.board_counters,
    lambda robot: robot.watchdog(1.0),
]


def hostile(rng: random.Random) -> bytes:
    """An answer with a value of any kind."""
    plain: list[Any] = [
        None,
        True,
        -1,
        0,
        17,
        2**63,
        -(2**63),
        math.nan,
        math.inf,
        1e300,
        "",
        "J1",
        "x" * 300,
        b"\xff",
    ]

    def value(depth: int) -> Any:
        if depth == 0 or rng.random() < 0.4:
            return rng.choice(plain)
        if rng.random() < 0.5:
            return [value(depth - 1) for _ in range(rng.randrange(6))]
        return {rng.choice(["joints", "capabilities", "counters", "J1"]): value(depth - 1) for _ in range(3)}

    kind = rng.choice(["", "", "", "LeaseError", "StoppedError", "ServoError", "Nothing", "x" * 64])
    if rng.random() < 0.1:
        return rng.choice([b"", b"\x01", b"\x02\x90", b"\x01" + rng.randbytes(40)])
    answer = m.Answer(kind, "text", {"holder": value(1), "status": value(1), "lost": value(0)}, value(3))
    answer.clock = rng.choice([0.0, math.nan, math.inf, -1e308])
    return m.encode(answer)


def test_whatever_a_server_answers_is_a_value_or_an_error_of_this_program(
    fake: tuple[RemoteRobot, FakeServer],
) -> None:
    robot, node = fake
    rng = random.Random(17)
    node.usual = lambda: hostile(rng)
    outcomes = {"value": 0, "error": 0}
    for _ in range(2000):
        for call in CALLS:
            try:
                call(robot)
            except HexwireError:
                outcomes["error"] += 1
            else:
                outcomes["value"] += 1
    assert min(outcomes.values()) > 500, outcomes
    # Nothing is left locked, and the heartbeat lives.
    node.usual = lambda: m.encode(m.Answer("", value=99, clock=time.monotonic()))
    robot.take()
    robot.resume()
    node.answers = [SENT]
    assert robot.write(TARGET).duration == 1.0
    assert robot._keeper is not None
    assert robot._keeper.is_alive()


@pytest.mark.parametrize("value", [0, -5, True, None, "17", 1.5])
def test_a_lease_without_a_key_is_none(fake: tuple[RemoteRobot, FakeServer], value: object) -> None:
    robot, node = fake
    node.answers = [m.Answer("", value=value)]
    with pytest.raises(RemoteProtocolError, match="not a lease"):
        robot.write(TARGET)
    assert not node.orders()


@pytest.mark.slow
def test_whatever_a_program_passes_is_told_in_one_line(connect: Callable[..., RemoteRobot]) -> None:
    robot = connect()
    own = {"path": rest_to_rest(["J1"], [0.0], [0.1], 2.0), "start": 0.0}
    assert assert_told(robot, {"joint": "J1", "target": near(robot), "mode": 0} | own) > 25
    # And it is as it was.
    robot.take()
    robot.resume()
    assert robot.read().positions
    for call, text in (
        (lambda: robot.cancel("1"), "cancel(number) takes a whole number; this is '1'"),
        (lambda: robot.follow({"J1": 0.1}, 0.0), "follow(path) takes a Spline; this is {'J1': 0.1}"),
        (lambda: robot.path("J1"), "path(joints) takes several names, as in ['J1']; this is 'J1'"),
        (lambda: robot.take(force="yes"), "take(force) takes True or False; this is 'yes'"),
    ):
        with pytest.raises(UsageError) as told:
            call()
        assert str(told.value) == text


def test_a_model_or_an_option_that_does_not_fit_is_refused() -> None:
    facts = m.decode(m.encode(FACTS), m.Facts)
    facts.timeout = math.nan
    with pytest.raises(RemoteProtocolError, match="impossible"):
        RemoteRobot(Address("lab/arm1"), facts)
    with pytest.raises(UsageError, match="has no option baud"):
        RemoteRobot.from_url("zenoh:lab/arm1", baud=3)


def test_only_orders_that_take_no_time_are_answered_soon(
    connect: Callable[..., RemoteRobot], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, given = connect(), list[tuple[str, float]]()
    exchange = robot._exchange

    def note(key: str, message: Any, timeout: float) -> m.Answer:
        if isinstance(message, m.Envelope):
            given.append((type(message.order).__name__, timeout))
        return exchange(key, message, timeout)

    monkeypatch.setattr(robot, "_exchange", note)
    robot.torque(True)
    robot.write(near(robot))
    assert given == [("Torque", 25.0), ("Write", 2.0)]


# -- a stream, in simulated time -----------------------------------------------------------------------------------


class Arrivals:
    """States that arrive after gaps, and the clock that they move on; all that have arrived are there at once.

    Args:
        gaps: Seconds before each.
    """

    def __init__(self, gaps: Iterable[float]) -> None:
        self.now = 1000.0
        self._due = list(accumulate(gaps, initial=self.now))[1:]
        self._sequence = 0

    def monotonic(self) -> float:
        return self.now

    def wait(self) -> bytes:
        self.now = max(self.now, self._due[0])
        payload = self.poll()
        assert payload is not None
        return payload

    def poll(self) -> bytes | None:
        if not self._due or self._due[0] > self.now:
            return None
        stamp, self._sequence = self._due.pop(0), self._sequence + 1
        row = (0.0,)
        values = (*(row,) * 6, (0,), row)
        return m.encode(m.State(9, self._sequence, stamp, stamp, 0.0, ("J1",), *values, 0.0, False, False, False))

    def wake(self) -> None:
        pass


@pytest.mark.parametrize("stalls", [False, True])
def test_a_stream_keeps_its_period_and_after_a_stall_makes_up_for_one(
    monkeypatch: pytest.MonkeyPatch, stalls: bool
) -> None:
    draw = random.Random(3)
    for period in (0.05, 0.1, 0.5):
        robot = RemoteRobot(Address("lab/arm1", role=ClientRole.OPERATOR), FACTS)
        # As after `attach`, but without its thread.
        robot._node = FakeServer()  # type: ignore[assignment]
        gaps = (draw.uniform(0.1, 2.0) if stalls and draw.random() < 0.05 else 0.02 for _ in range(900))
        arrivals = Arrivals(gaps)
        monkeypatch.setattr(remote, "time", arrivals)
        robot._states = ArrivedStates(robot.url, robot._clock, arrivals, now=arrivals.monotonic)
        begun, times = arrivals.now, []
        for _, _ in zip(range(int(15 / period)), robot.stream(period), strict=False):
            times.append(arrivals.now)
        steps = [b - a for a, b in pairwise(times)]
        # A state that comes half a period early is in time.
        assert min(steps) > 0.5 * period - 1e-9, (period, min(steps))
        if not stalls:
            assert max(steps) < period + 0.021, (period, max(steps))
        # One that a stall delayed is made up for, not all that it left out.
        assert len(times) <= (times[-1] - begun) / period + 2, period
        assert len(times) > 20, period
