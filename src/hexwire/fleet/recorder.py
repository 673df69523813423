"""Records the states of many arms in one file, with their clocks related.

Owns the topics of such a recording, and the measurement of the clocks while it runs. `hexwire.trace` owns the file.
Must not know terminals.

For the arm lab/arm1 the file has

    /lab/arm1/joint_states    foxglove.JointStates    its states: `timestamp` and the log time are the time of the
                                                      sample on the recorder's clock; `owner` has its own clocks
    /lab/arm1/clock           hexwire.Clock           offset of its clock, with uncertainty, every 2 s
    /fleet                    foxglove.Log            arms that appeared, vanished or lost states
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
import time
from collections.abc import Callable
from typing import Any

from hexwire.errors import HexwireError, LinkClosedError, RemoteProtocolError, UsageError
from hexwire.trace.foxglove import INFO, WARNING, log_line, time_of
from hexwire.trace.recording import RecordingWriter, topic_of

from . import messages as m
from .clock import ClockOffset
from .names import ROOT, Keys, check_name
from .network import Network
from .node import NoAnswerError, Node
from .roster import Roster
from .rows import joint_state

__all__ = ["EVENTS", "FleetRecorder"]

EVENTS = "/fleet"
_CLOCK = 2.0
"""Seconds between two measurements of an arm's clock."""
_EXCHANGES = 4
"""Measurements at the beginning."""
_TIMEOUT = 0.5
"""Longest round trip that is used, seconds; a slower one is too inaccurate."""
_STEP = 0.1
_WAITING = 20_000
"""States that may wait for the disk: 20 s of ten arms."""
_PATIENCE = 5.0


class _Recorded:
    """What is known of one arm."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.clock = ClockOffset()
        self.next_clock = 0.0
        self.server = self.sequence = self.lost = self.count = 0
        self.sent = -math.inf
        self.there = True


class FleetRecorder:
    """Records for a `with` block; `run` does the work.

    Args:
        writer: The file; closed by the caller.
        pattern: Names of the arms.
        router: As in `Roster`.
        tell: Called with a text for each arm that appears, vanishes or loses states.
    """

    def __init__(
        self,
        writer: RecordingWriter,
        pattern: str = "**",
        router: Network | None = None,
        *,
        tell: Callable[[str], object] = lambda text: None,
    ) -> None:
        self.overflows = 0
        self._writer, self._tell = writer, tell
        # Seconds since 1970 minus monotonic seconds; constant, so that a jump of the wall clock leaves no gap.
        self._wall = time.time() - time.monotonic()
        self._arms: dict[str, _Recorded] = {}
        self._queue: queue.Queue[tuple[str, Node, bytes]] = queue.Queue(_WAITING)
        self._roster = Roster(pattern, router)
        self._subscribed: set[tuple[str, Node]] = set()
        self._ending = threading.Event()
        # Guards the writer.
        self._lock = threading.Lock()
        self._measurer = threading.Thread(target=self._measure, name="clocks", daemon=True)

    def __enter__(self) -> FleetRecorder:
        self._roster.__enter__()
        self._roster.settle(_PATIENCE)
        self._follow()
        self._measurer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._measurer.join(_PATIENCE)
        self._roster.__exit__()

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        """Recorded and lost states, by arm."""
        return {name: (arm.count, arm.lost) for name, arm in sorted(self._arms.items())}

    @property
    def silent(self) -> dict[str, str]:
        """As `Roster.silent`."""
        return self._roster.silent()

    def run(self, seconds: float) -> None:
        """Write what arrives in that time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._follow()
            try:
                name, node, payload = self._queue.get(timeout=min(left, _STEP))
            except queue.Empty:
                continue
            self._take(name, node, payload)
            while not self._queue.empty():
                self._take(*self._queue.get())

    # -- arms -------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """Follow which arms are there."""
        seen = self._roster.seen()
        for name, one in seen.items():
            arm = self._arms.get(name)
            if arm is None or not arm.there:
                words = "recorded" if arm is None else "is back"
                fresh = _Recorded(one.node)
                if arm is not None:
                    fresh.lost, fresh.count = arm.lost, arm.count
                self._arms[name] = fresh
                self._event(f"{name} {words}")
            elif arm.node is not one.node:
                arm.node = one.node
            if (name, one.node) not in self._subscribed:
                # It may have vanished in this moment, and its session with it.
                with contextlib.suppress(LinkClosedError):
                    self._subscribe(name, one.node)
                    self._subscribed.add((name, one.node))
        for name, arm in self._arms.items():
            if arm.there and name not in seen:
                arm.there = False
                self._event(f"{name} is gone", warning=True)
        self._subscribed = {(name, node) for name, node in self._subscribed if not node.is_closed}

    def _subscribe(self, name: str, node: Node) -> None:
        def put(payload: bytes, key: str) -> None:
            try:
                self._queue.put_nowait((key, node, payload))
            except queue.Full:
                self.overflows += 1

        # Separately for each arm: a pattern may exceed what the certificate allows.
        node.subscribe(Keys(name).state, put)

    def _event(self, text: str, *, warning: bool = False, tell: bool = True) -> None:
        now = time.monotonic() + self._wall
        with self._lock:
            line = log_line(WARNING if warning else INFO, text, "", now)
            self._writer.message(EVENTS, "foxglove.Log", now, line)
        if tell:
            self._tell(text)

    # -- states -----------------------------------------------------------------------------------------

    def _take(self, key: str, node: Node, payload: bytes) -> None:
        try:
            name = check_name(key.removeprefix(f"{ROOT}/").removesuffix("/state"))
            state = m.decode(payload, m.State)
            joints = joint_state(state, state.stamp)
        except (RemoteProtocolError, UsageError):
            return
        arm = self._arms.get(name)
        # An arm may be reached on two ways; of its states each counts once.
        if arm is None or arm.node is not node or not arm.clock.known:
            return
        if state.server != arm.server:
            # It was restarted, and its count restarts.
            arm.server, arm.sequence, arm.sent = state.server, 0, -math.inf
        if state.sent <= arm.sent:
            return
        if arm.sequence and state.sequence > arm.sequence + 1:
            gap = state.sequence - arm.sequence - 1
            arm.lost += gap
            self._event(f"{name}: {gap} states were lost on the way", warning=True, tell=False)
        arm.sequence, arm.sent = state.sequence, state.sent
        if not state.names:
            return
        offset, _ = arm.clock.at(time.monotonic())
        stamp = state.stamp - offset + self._wall
        owner = {
            "clock": state.stamp,
            "wall": state.wall - (state.sent - state.stamp),
            "sequence": state.sequence,
            "holder": state.holder,
            "stopped": state.stopped,
        }
        with self._lock:
            self._writer.joint_state(joints, stamp, topic=topic_of(name), extra={"owner": owner})
        arm.count += 1

    # -- clocks, in a thread of their own ---------------------------------------------------------------

    def _measure(self) -> None:
        while True:
            for name, arm in list(self._arms.items()):
                now = time.monotonic()
                if arm.there and now >= arm.next_clock and not self._ending.is_set():
                    for _ in range(1 if arm.clock.known else _EXCHANGES):
                        self._exchange(name, arm)
                    arm.next_clock = now + (_CLOCK if arm.clock.known else _TIMEOUT)
            if self._ending.wait(_STEP):
                return

    def _exchange(self, name: str, arm: _Recorded) -> None:
        sent = time.monotonic()
        try:
            answer = m.decode(arm.node.ask(Keys(name).ask, m.encode(m.Ask("clock")), _TIMEOUT), m.Answer)
        except (NoAnswerError, HexwireError):
            return
        received = time.monotonic()
        arm.clock.add(sent, answer.clock, received)
        offset, doubt = arm.clock.at(received)
        now = received + self._wall
        body: dict[str, Any] = {
            "timestamp": time_of(now),
            "offset": offset - self._wall,
            "uncertainty": doubt,
            "round_trip": received - sent,
            "jumps": arm.clock.jumps,
        }
        with self._lock:
            self._writer.message(f"/{name}/clock", "hexwire.Clock", now, body)
