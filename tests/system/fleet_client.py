"""A program: a client of a shared arm that does what its standard input says and writes down what it sees.

    python -m tests.system.fleet_client URL LOG

A line of input is a list with the name of a method of `Client` and its arguments; each is answered by a line with
the result or the error. LOG gets a line for every message that it sends for its lease, the answer, and every state,
with the time of CLOCK_MONOTONIC. In a time namespace FLEET_SHIFT says by how much that clock is ahead.
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from hexwire.errors import HexwireError
from hexwire.fleet import messages as m
from hexwire.fleet.node import Node
from hexwire.fleet.remote import RemoteRobot
from hexwire.fleet.set_points import SharedSetPoints
from hexwire.model.state import JointTarget

SHIFT = float(os.environ.get("FLEET_SHIFT", "0"))
_PLAIN_ASK = Node.ask
_HEARD = 0.5
"""Seconds for which a published set-point of which no state tells may be on its way; an older one is refused."""


def clock() -> float:
    """The clock that the programs of this machine share."""
    return time.monotonic() - SHIFT


class Client:
    """What a test may ask for."""

    def __init__(self, url: str, log: Path) -> None:
        self._url = url
        self._log = log.open("a", buffering=1)
        self._robot: RemoteRobot | None = None
        self._numbers = iter(range(1, 1 << 62))
        self._streams: list[threading.Thread] = []
        self._ending = threading.Event()
        # Every message passes one of these.
        Node.ask = self._watched_ask()  # type: ignore[method-assign]
        self._published: dict[int, int] = {}
        Node.publisher_in_order = self._watched_publisher()  # type: ignore[method-assign]
        SharedSetPoints.look = self._watched_look()  # type: ignore[method-assign]

    def note(self, **row: object) -> None:
        self._log.write(json.dumps(row) + "\n")

    def _watched_ask(self) -> Any:
        def ask(node: Node, key: str, payload: bytes, timeout: float, **more: Any) -> bytes:
            last = key.rpartition("/")[2]
            kinds = {"lease": m.LeaseRequest, "order": m.Envelope, "stop": m.StopRequest, "off": m.StopRequest}
            if last not in kinds:
                return _PLAIN_ASK(node, key, payload, timeout, **more)
            message = m.decode(payload, kinds[last])
            what = type(message.order if isinstance(message, m.Envelope) else message).__name__
            number = next(self._numbers)
            length = getattr(getattr(message, "order", None), "duration", 0.0)
            finish = bool(getattr(message, "finish", False))
            self.note(e="sent", n=number, what=what, t=clock(), wait=timeout, duration=length, finish=finish)
            data = _PLAIN_ASK(node, key, payload, timeout, **more)
            self.note(e="answered", n=number, t=clock(), refused=m.decode(data, m.Answer).kind)
            return data

        return ask

    def _watched_publisher(self) -> Any:
        plain = Node.publisher_in_order

        def made(node: Node, key: str) -> Any:
            publisher = plain(node, key)
            publish = publisher._publisher.put

            def put(payload: bytes) -> None:
                message = m.decode(payload, m.Envelope)
                number = self._published[message.sequence] = next(self._numbers)
                row = {"duration": message.order.duration, "finish": False}
                self.note(e="sent", n=number, what="Write", t=clock(), wait=_HEARD, **row)
                publish(payload)

            publisher._publisher = SimpleNamespace(put=put)
            return publisher

        return made

    def _watched_look(self) -> Any:
        plain, published = SharedSetPoints.look, self._published

        def look(stream: SharedSetPoints, state: m.State | None, arrived: float) -> None:
            told = None if state is None else state.stream
            if told is not None and told.lease == stream.lease:
                for sequence in [one for one in published if one <= told.dealt]:
                    refused = told.kind if sequence == told.last else ""
                    self.note(e="answered", n=published.pop(sequence), t=clock(), refused=refused)
            plain(stream, state, arrived)

        return look

    @property
    def robot(self) -> RemoteRobot:
        assert self._robot is not None
        return self._robot

    # -- what a test may ask for ------------------------------------------------------------------------

    def connect(self) -> None:
        self._robot = RemoteRobot.from_url(self._url)
        self._robot.attach()

    def take(self, force: bool = False) -> None:
        self.robot.take(force=force)

    def move(self, duration: float, **joints: float) -> float:
        return self.robot.write(JointTarget.of(joints, duration)).duration

    def stop(self) -> None:
        self.robot.stop()

    def resume(self) -> None:
        self.robot.resume()

    def torque(self, on: bool) -> None:
        self.robot.torque(on)

    def release(self, finish: bool = False) -> None:
        self.robot.release(finish=finish)

    def watch(self, period: float = 0.02) -> None:
        """Write down every state from now on; what goes wrong, too."""
        self._start(self._watch, period)

    def stream(self, rate: float, **joints: float) -> None:
        """Send set-points from now on: each joint swings by so many radians to each side of a place nearby.

        It begins towards 0, so that many streams one after the other do not lead to a limit.
        """
        state = self.robot.read()
        here = {name: state[name].position for name in joints}
        rows = {name: (here[name], math.copysign(by, -here[name])) for name, by in joints.items()}
        self._start(self._swing, rate, rows)

    def rest(self) -> dict[str, int]:
        """End `watch` and `stream`; counts what was refused."""
        self._ending.set()
        for thread in self._streams:
            thread.join(30)
        self._streams.clear()
        self._ending.clear()
        return self.robot.host_counters()

    def flood(self, rate: float, seconds: float) -> dict[str, int]:
        """Send orders without a lease, as fast as that, without waiting for the answers."""
        import zenoh

        node = self.robot._node
        assert node is not None
        keys = self.robot._keys
        key = keys.order(self.robot._role)
        offset, doubt = self.robot.clock_offset
        counts = {"sent": 0, "refused": 0, "done": 0}

        def answered(reply: Any) -> None:
            done = reply.ok is not None and not m.decode(bytes(reply.ok.payload.to_bytes()), m.Answer).kind
            counts["done" if done else "refused"] += 1

        names = self.robot.model.names
        begun = time.monotonic()
        while (now := time.monotonic()) < begun + seconds:
            while counts["sent"] < rate * (now - begun):
                counts["sent"] += 1
                target = m.Write(names, tuple(0.3 for _ in names), 0.5)
                envelope = m.Envelope(1, counts["sent"], time.monotonic() + offset, doubt, target)
                node._session.get(
                    key,
                    answered,
                    payload=m.encode(envelope),
                    timeout=30.0,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
            time.sleep(0.002)
        deadline = time.monotonic() + 30.0
        while counts["refused"] + counts["done"] < counts["sent"] and time.monotonic() < deadline:
            time.sleep(0.02)
        return counts

    def facts(self) -> dict[str, Any]:
        robot = self.robot
        return {"holder": robot.holder, "held": robot.held, "offset": robot.clock_offset[0]}

    def wall(self) -> float:
        """The owner's wall clock, as the newest state says."""
        newest = self.robot._states.newest
        assert newest is not None
        return newest.wall

    def counters(self) -> dict[str, int]:
        return self.robot.board_counters()

    def close(self) -> None:
        self.robot.detach()

    # -- threads ------------------------------------------------------------------------------------------

    def _start(self, target: Any, *args: Any) -> None:
        thread = threading.Thread(target=target, args=args, daemon=True)
        self._streams.append(thread)
        thread.start()

    def _watch(self, period: float) -> None:
        while not self._ending.is_set():
            try:
                for state in self.robot.stream(period):
                    self.note(
                        e="state",
                        t=clock(),
                        stamp=state.stamp - SHIFT,
                        doubt=self.robot.clock_offset[1],
                        ids=[self.robot.model.joint(name).servo_id for name in state.names],
                        counts=[self._counts(name, state[name].position) for name in state.names],
                        age=list(state.age),
                        booted=state.stamp - SHIFT - state.board_time,
                        stopped=state.stopped,
                        holder=self.robot.holder,
                        held=self.robot.held,
                    )
                    if self._ending.is_set():
                        return
            except HexwireError as error:
                self.note(e="lost", t=clock(), error=type(error).__name__, text=str(error))
                time.sleep(0.1)

    def _counts(self, name: str, angle: float) -> float:
        joint = self.robot.model.joint(name)
        return joint.sign * (angle - joint.offset) / joint.scale + joint.neutral

    def _swing(self, rate: float, joints: dict[str, tuple[float, float]]) -> None:
        begun = time.monotonic()
        while not self._ending.is_set():
            phase = 1.0 - math.cos(2.0 * (time.monotonic() - begun))
            target = {name: here + by * phase for name, (here, by) in joints.items()}
            try:
                self.robot.write(JointTarget.of(target, 2 / rate))
            except HexwireError as error:
                self.note(e="refused", t=clock(), error=type(error).__name__, text=str(error))
            time.sleep(1 / rate)


def main() -> None:
    client = Client(sys.argv[1], Path(sys.argv[2]))
    print("ready", flush=True)
    for line in sys.stdin:
        name, args, named = json.loads(line)
        begun = clock()
        try:
            row = {"value": getattr(client, name)(*args, **named)}
        except Exception as error:  # noqa: BLE001  # the test judges it
            row = {"error": type(error).__name__, "text": str(error)}
        print(json.dumps({**row, "begun": begun, "ended": clock()}), flush=True)


if __name__ == "__main__":
    main()
