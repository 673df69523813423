"""Recordings of many arms: a topic each, clocks related, who came and went."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.waits import eventually

from hexwire.fleet import messages as m
from hexwire.fleet import recorder as module
from hexwire.fleet.endpoints import endpoints_of, local_socket
from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.node import NoAnswerError, Node
from hexwire.fleet.recorder import EVENTS, FleetRecorder
from hexwire.fleet.roster import Seen
from hexwire.trace.capture import read_messages
from hexwire.trace.recording import RecordingWriter, read_joint_states, topic_of

from .conftest import Serve

AHEAD = 1000.0
"""Seconds by which a far clock is ahead, and its wall clock behind."""


class Far:
    """The server of an arm whose clocks are others than here."""

    def __init__(self, name: str, server: int = 1) -> None:
        self.node: Node = Network(listen=endpoints_of([local_socket(name)])).open(wait=False)
        self.node.answer(Keys(name).ask, self._answer)
        self._put = self.node.publisher(Keys(name).state)
        self.node.announce(Keys(name).token("1"))
        self.server, self.sequence = server, 0

    def _answer(self, query: Any) -> None:
        query.reply(m.encode(m.Answer("", clock=time.monotonic() + AHEAD)))

    def send(self, age: float = 0.004, skip: int = 0) -> float:
        """Publish a state; returns when it was sampled, wall clock here."""
        self.sequence += 1 + skip
        # Both clocks here, since the machine may stall at the next line.
        (now, wall), row = (time.monotonic(), time.time()), (0.5,)
        sent = now + AHEAD
        head = (self.server, self.sequence, sent - age, sent, wall - AHEAD)
        state = m.State(*head, ("J1",), *(row,) * 6, (0,), (0.002,), 0.0, False, False, False, "Ann")
        self._put(m.encode(state))
        return wall - age


@pytest.fixture
def far(runtime: Path) -> Iterator[Far]:
    server = Far("lab/far")
    yield server
    server.node.close()


def messages(file: Path, topic: str) -> list[tuple[float, dict[str, Any]]]:
    with file.open("rb") as data:
        rows = [row for row in read_messages(data, "a") if not isinstance(row, str)]
    return [(row.time, json.loads(row.data)) for row in rows if row.topic == topic]


def test_states_have_the_recorders_time_and_the_owners(far: Far, tmp_path: Path) -> None:
    file, sampled = tmp_path / "a.mcap", []
    with RecordingWriter(file) as writer, FleetRecorder(writer, "lab/*") as recorder:
        ready = threading.Event()

        def publish() -> None:
            while not ready.wait(0.02):
                sampled.append(far.send())

        publisher = threading.Thread(target=publish)
        publisher.start()
        eventually(lambda: (recorder.run(0.1), recorder.counts.get("lab/far", (0, 0))[0] > 5)[1])
        ready.set()
        publisher.join()
    rows = messages(file, topic_of("lab/far"))
    clocks = [row for _, row in messages(file, "/lab/far/clock")]
    # Of the worst, since a state that came before the others has its stamp by that alone.
    doubt = max(row["uncertainty"] for row in clocks)
    # The log time is that of the sample on the clock here, whatever the clocks there say.
    for stamp, body in rows:
        assert min(abs(stamp - known) for known in sampled) < 0.005 + 2 * doubt
        assert body["timestamp"]["sec"] + body["timestamp"]["nsec"] / 1e9 == pytest.approx(stamp, abs=1e-6)
        assert body["owner"]["wall"] == pytest.approx(stamp - AHEAD, abs=0.05 + 2 * doubt)
        assert body["owner"]["holder"] == "Ann"
        assert body["joints"][0]["age"] == 0.002
        # The offset relates the two: that is what it is recorded for.
        assert any(
            abs(body["owner"]["clock"] - row["offset"] - stamp) <= row["uncertainty"] + 0.005 for row in clocks
        )
    assert len(clocks) >= 4
    assert [row.topic for row in read_joint_states(file)] == [topic_of("lab/far")] * len(rows)


def test_lost_states_and_a_new_server_are_noted(far: Far, tmp_path: Path) -> None:
    file, told = tmp_path / "a.mcap", []
    with RecordingWriter(file) as writer, FleetRecorder(writer, tell=told.append) as recorder:
        eventually(lambda: (far.send(), recorder.run(0.05), recorder.counts["lab/far"][0])[2])
        far.send(skip=3)
        eventually(lambda: (recorder.run(0.05), recorder.counts["lab/far"][1] == 3)[1])
        # Started anew, it counts anew: nothing is lost.
        far.server, far.sequence = 2, 0
        before = recorder.counts["lab/far"][0]
        eventually(lambda: (far.send(), recorder.run(0.05), recorder.counts["lab/far"][0] > before)[2])
        assert recorder.counts["lab/far"][1] == 3
        # Neither is a payload that is no state.
        far._put(b"\x01garbage")
        recorder.run(0.1)
    texts = [body["message"] for _, body in messages(file, EVENTS)]
    assert texts == ["lab/far recorded", "lab/far: 3 states were lost on the way"]
    assert told == ["lab/far recorded"]


def test_an_arm_that_vanishes_while_it_is_found_does_not_end_the_recording(
    far: Far, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = Network(connect=endpoints_of([local_socket("lab/far")])).open()
    closed.close()
    with RecordingWriter(tmp_path / "a.mcap") as writer, FleetRecorder(writer, "lab/*") as recorder:
        with monkeypatch.context() as patch:
            patch.setattr(recorder._roster, "seen", lambda: {"lab/far": Seen("lab/far", closed, True)})
            recorder.run(0.02)
        eventually(lambda: (far.send(), recorder.run(0.05), recorder.counts["lab/far"][0])[2])


class Near:
    """The way to an arm whose clock is 1000 s ahead of here."""

    def __init__(self) -> None:
        self.now, self.asked, self.subscribed = 50.0, 0, 0
        self.is_closed = self.is_silent = False

    def monotonic(self) -> float:
        return self.now

    def ask(self, key: str, payload: bytes, timeout: float) -> bytes:
        self.asked += 1
        if self.is_silent:
            raise NoAnswerError(absent=False)
        return m.encode(m.Answer("", clock=self.now + AHEAD))

    def subscribe(self, key: str, put: object) -> None:
        self.subscribed += 1


class Watched:
    """A recorder in simulated time, of the arms of which the test says that they are there."""

    def __init__(self, writer: RecordingWriter, monkeypatch: pytest.MonkeyPatch) -> None:
        self.told: list[str] = []
        self.node, self.there = Near(), {"lab/a"}
        self.recorder = FleetRecorder(writer, tell=self.told.append)
        self.recorder._roster.seen = lambda: {name: Seen(name, self.node, True) for name in self.there}  # type: ignore
        self.recorder._ending.wait = lambda timeout=None: True  # type: ignore[method-assign,assignment]
        monkeypatch.setattr(module, "time", self.node)

    def measure(self, after: float = 0.0) -> int:
        """How often its clock is asked for then."""
        self.node.now += after
        before = self.node.asked
        self.recorder._measure()
        return self.node.asked - before

    def take(self, node: Near, sequence: int) -> None:
        row, sent = (0.5,), self.node.now + AHEAD
        state = m.State(
            1, sequence, sent, sent + sequence, 0.0, ("J1",), *(row,) * 6, (0,), row, 0.0, False, False, False
        )
        self.recorder._take("hexwire/lab/a/state", node, m.encode(state))  # type: ignore[arg-type]


@pytest.fixture
def watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        yield Watched(writer, monkeypatch)


def test_an_arm_that_went_and_came_is_told_and_subscribed_once_on_each_way(watched: Watched) -> None:
    for there in ({"lab/a"}, {"lab/a"}, set[str](), {"lab/a"}):
        watched.there = there
        watched.recorder._follow()
    assert watched.told == ["lab/a recorded", "lab/a is gone", "lab/a is back"]
    assert watched.node.subscribed == 1
    watched.node.is_closed = True
    watched.recorder._follow()
    watched.node = Near()
    for _ in range(2):
        watched.recorder._follow()
    assert watched.node.subscribed == 1


def test_a_clock_is_asked_for_every_two_seconds_and_sooner_until_it_is_known(watched: Watched) -> None:
    watched.recorder._follow()
    watched.node.is_silent = True
    assert [watched.measure(), watched.measure(0.4), watched.measure(0.2)] == [4, 0, 4]
    watched.node.is_silent = False
    assert watched.measure(0.6) == 4
    assert [watched.measure(1.9), watched.measure(0.2)] == [0, 1]


def test_states_count_once_the_clock_is_known_and_on_one_way(watched: Watched) -> None:
    watched.recorder._follow()
    watched.take(watched.node, 1)
    assert watched.recorder.counts == {"lab/a": (0, 0)}
    watched.measure()
    watched.take(Near(), 2)
    assert watched.recorder.counts == {"lab/a": (0, 0)}
    watched.take(watched.node, 3)
    assert watched.recorder.counts == {"lab/a": (1, 0)}


@pytest.mark.slow
def test_arms_that_come_and_go_are_noted(far: Far, serve: Serve, tmp_path: Path) -> None:
    file, told = tmp_path / "a.mcap", []
    with RecordingWriter(file) as writer, FleetRecorder(writer, tell=told.append) as recorder:
        service = serve("lab/arm1", robot="sim")
        eventually(lambda: (recorder.run(0.1), recorder.counts.get("lab/arm1", (0, 0))[0] > 3)[1])
        far.node.close()
        eventually(lambda: (recorder.run(0.1), "lab/far is gone" in told)[1])
        service.close()
        eventually(lambda: (recorder.run(0.1), "lab/arm1 is gone" in told)[1])
        again = Far("lab/far")
        eventually(lambda: (recorder.run(0.1), "lab/far is back" in told)[1])
        again.node.close()
    # Losses, which a busy machine may have, are noted in the file only.
    events = [body for _, body in messages(file, EVENTS) if "lost on the way" not in body["message"]]
    assert [body["message"] for body in events] == told
    assert {body["level"] for body in events} == {2, 3}
    assert messages(file, topic_of("lab/arm1"))
