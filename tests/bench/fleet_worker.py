"""The processes of the fleet's benchmark, in pairs: an owner, and programs that read and command its arm.

A worker prints ``ready``, then answers each line on its standard input, a table in JSON, by such a line. This file
has bare Zenoh and PhysicalAI, which may live in an environment of its own: it imports nothing that is not there.
"""

from __future__ import annotations

import json
import os
import random
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, ClassVar

CLOCK = "HEXWIRE_BENCH_CLOCK"
"""Environment variable: seconds by which the clock of a worker is ahead, and millionths by which it is fast."""
if CLOCK in os.environ:
    # As on another machine. Before anything else is imported that takes the clock at its import.
    _ahead, _fast = map(float, os.environ[CLOCK].split())
    _true = time.monotonic
    time.monotonic = lambda: _ahead + _true() * (1.0 + 1e-6 * _fast)

Row = dict[str, Any]
Worker = Callable[..., Row]

JOINTS = tuple(f"J{i}" for i in range(1, 8))
RATE = 100.0
STEP = 1e-5
"""Radians from one target to the next, so that each can be recognised."""
_TARGETS = 10_000
"""Targets of `answer_states` that can be told apart."""
_GAP = (0.015, 0.035)
"""Seconds between two targets; random, so that they meet every phase of an owner's cycle."""


def beats(rate: float, go_on: Callable[[], bool] = lambda: True) -> Iterator[int]:
    """Yield at a steady rate, without making up for what was missed."""
    due, number = time.monotonic(), 0
    while go_on():
        yield number
        number += 1
        due = max(due + 1.0 / rate, time.monotonic() - 1.0 / rate)
        time.sleep(max(0.0, due - time.monotonic()))


def gaps(seconds: float) -> Iterator[int]:
    """Yield for so many seconds, with random gaps."""
    ends, number = time.monotonic() + seconds, 0
    while time.monotonic() < ends:
        time.sleep(random.uniform(*_GAP))
        number += 1
        yield number


def cpu() -> Row:
    """CPU time of this process with all its threads, the time, and the number of these threads."""
    threads = sum(1 for _ in Path("/proc/self/task").iterdir()) if sys.platform == "linux" else 0
    return {"cpu": time.process_time(), "now": time.monotonic(), "threads": threads}


def answer_states(following: Callable[[], float], send: Callable[[float], object], seconds: float) -> Row:
    """Send a target after each state, as a control loop does.

    Args:
        following: Waits for the next state, and gives its age on arrival, seconds.
        send: Sends a target, which is a multiple of `STEP`.
        seconds: For how long.
    """
    following()
    ages, sent, before = [], [], cpu()
    while time.monotonic() < before["now"] + seconds:
        ages.append(following())
        target = (len(ages) % _TARGETS) * STEP
        sent.append((time.monotonic(), target))
        send(target)
    after = cpu()
    spent = {"cpu": after["cpu"] - before["cpu"], "seconds": after["now"] - before["now"]}
    return {"ages": ages, "sent": sent, **spent}


class Targets:
    """The targets that arrived at a robot, with their times."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, float]] = []

    def add(self, value: float) -> None:
        self._rows.append((time.monotonic(), float(value)))

    def take(self) -> Row:
        rows, self._rows = self._rows, []
        return {"targets": rows}


class Readers:
    """Programs that read one arm, each with a session and a thread of its own.

    Args:
        open_one: Opens a session; returns what waits for the next state and gives its age on arrival, seconds, and
            what closes the session.
    """

    def __init__(self, open_one: Callable[[], tuple[Callable[[], float], Callable[[], object]]]) -> None:
        self._open_one = open_one
        self._open = ExitStack()
        self._nexts: list[Callable[[], float]] = []

    def __call__(self, what: str, count: int = 0, seconds: float = 0.0) -> Row:
        if what == "open":
            for _ in range(count):
                following, close = self._open_one()
                self._nexts.append(following)
                self._open.callback(close)
            return {}
        if what == "close":
            self._nexts = []
            self._open.close()
            return {}
        ages: list[list[float]] = [[] for _ in self._nexts]
        threads = [
            threading.Thread(target=self._read, args=(following, seconds, rows))
            for following, rows in zip(self._nexts, ages, strict=True)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return {"ages": ages}

    @staticmethod
    def _read(following: Callable[[], float], seconds: float, ages: list[float]) -> None:
        following()
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            ages.append(following())


# -- bare Zenoh -------------------------------------------------------------------------------------------------


def _session(role: str, endpoint: str) -> Any:
    import zenoh

    config = zenoh.Config()
    for key, value in {
        "mode": "peer" if role == "listen" else "client",
        f"{role}/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


@contextmanager
def bare_owner(endpoint: str, size: str) -> Iterator[Worker]:
    """Puts so many bytes at the rate of the states, with the time of the put, and takes targets."""
    import zenoh

    targets = Targets()

    def work(what: str) -> Row:
        return cpu() if what == "cpu" else targets.take()

    rest = bytes(int(size) - 8)
    with _session("listen", endpoint) as session:
        publisher = session.declare_publisher(
            "bare",
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            reliability=zenoh.Reliability.BEST_EFFORT,
        )
        ending = threading.Event()

        def run() -> None:
            for _ in beats(RATE, lambda: not ending.is_set()):
                publisher.put(struct.pack("d", time.monotonic()) + rest)

        session.declare_subscriber(
            "target", lambda sample: targets.add(*struct.unpack("d", sample.payload.to_bytes()))
        )
        thread = threading.Thread(target=run)
        thread.start()
        yield work
        ending.set()
        thread.join()


@contextmanager
def bare_client(endpoint: str) -> Iterator[Worker]:
    """Waits for each state, and puts a target."""
    with _session("connect", endpoint) as session:
        subscriber, publisher = (
            session.declare_subscriber("bare"),
            session.declare_publisher("target", express=True),
        )

        def following() -> float:
            payload = subscriber.recv().payload.to_bytes()
            return time.monotonic() - struct.unpack_from("d", payload)[0]

        def work(what: str, seconds: float) -> Row:
            if what == "wait":
                time.sleep(seconds)
                return {}
            while subscriber.try_recv() is not None:
                pass
            return answer_states(following, lambda target: publisher.put(struct.pack("d", target)), seconds)

        yield work


@contextmanager
def bare_reader(endpoint: str) -> Iterator[Worker]:
    """Subscribes with a callback, the fastest way that there is."""
    ages: list[float] = []
    opened = ExitStack()

    def work(what: str, count: int = 0, seconds: float = 0.0) -> Row:
        if what == "open":
            session = opened.enter_context(_session("connect", endpoint))

            def on_sample(sample: Any) -> None:
                ages.append(time.monotonic() - struct.unpack_from("d", sample.payload.to_bytes())[0])

            session.declare_subscriber("bare", on_sample)
        elif what == "close":
            opened.close()
        else:
            ages.clear()
            time.sleep(seconds)
            return {"ages": [list(ages)]}
        return {}

    yield work


# -- PhysicalAI's SharedRobot --------------------------------------------------------------------------------------


class PhysicalObservation:
    """What PhysicalAI calls an observation: positions only, less than hexwire's states."""

    sensor_data = images = None

    def __init__(self, positions: Any) -> None:
        self.joint_positions = self.state = positions
        self.timestamp = time.monotonic()


class PhysicalRobot:
    """A robot without hardware, as PhysicalAI wants it."""

    targets = Targets()
    joint_names: ClassVar = list(JOINTS)
    device_ids = ()

    def __init__(self) -> None:
        import numpy

        self._positions = numpy.zeros(7)

    def connect(self) -> None:
        """There is nothing to connect."""

    def disconnect(self) -> None:
        """Nor to disconnect."""

    def is_connected(self) -> bool:
        return True

    def get_observation(self) -> PhysicalObservation:
        return PhysicalObservation(self._positions)

    def send_action(self, action: Any, *, goal_time: float = 0.1) -> None:
        self.targets.add(action[0])


@contextmanager
def physical_owner(name: str) -> Iterator[Worker]:
    """Its owner's own loop, in a thread of this process."""
    import fleet_worker  # the module that the owner imports, not this program
    from physicalai.robot.transport import RobotOwnerConfig, run_owner

    ready, ending = threading.Event(), threading.Event()
    robot = {"class_path": "fleet_worker.PhysicalRobot", "init_args": {}}
    config = RobotOwnerConfig(name, robot, rate_hz=RATE, idle_timeout=None)
    thread = threading.Thread(target=run_owner, args=(config, ending), kwargs={"ready": ready.set})
    thread.start()
    if not ready.wait(20.0):
        raise TimeoutError("its owner does not start")
    yield lambda what: cpu() if what == "cpu" else fleet_worker.PhysicalRobot.targets.take()
    ending.set()
    thread.join()


@contextmanager
def physical_client(name: str, own_call: str = "") -> Iterator[Worker]:
    """Its clients. They wait for a state inside the driver: its own call only looks whether there is one.

    Args:
        name: Of the robot.
        own_call: If not empty, they look by its own call instead, in a loop at the rate of the states.
    """
    import numpy
    from physicalai.robot.transport import SharedRobot
    from physicalai.robot.transport._codec import decode_state

    def open_one() -> tuple[Callable[[], float], Callable[[], object]]:
        robot = SharedRobot.attach(name)
        robot.connect()

        def following() -> float:
            if own_call:
                next(loop)
                return time.monotonic() - robot.get_observation().timestamp
            state = decode_state(robot._state_sub.recv().payload.to_bytes())
            return time.monotonic() - state.timestamp

        loop = beats(RATE)
        # The loop of a program and that of the owner know nothing of each other.
        time.sleep(random.uniform(0.0, 1.0 / RATE))
        return following, robot.disconnect

    readers = Readers(open_one)

    def work(what: str, **options: Any) -> Row:
        if what != "write":
            return readers(what, **options)
        robot = SharedRobot.attach(name)
        robot.connect()
        rows = []
        for number in gaps(options["seconds"]):
            sent = time.monotonic()
            robot.send_action(numpy.full(7, number * STEP))
            rows.append((sent, number * STEP, time.monotonic()))
        time.sleep(0.1)
        robot.disconnect()
        return {"sent": rows}

    yield work


def main(roles: dict[str, Callable[..., Any]], role: str, *args: str) -> None:
    """Be a worker until the end of the standard input."""
    with roles[role](*args) as work:
        print("ready", flush=True)
        for line in sys.stdin:
            print(json.dumps(work(**json.loads(line))), flush=True)


_ROLES = {
    "bare-owner": bare_owner,
    "bare-reader": bare_reader,
    "bare-client": bare_client,
    "physical-owner": physical_owner,
    "physical-client": physical_client,
}

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    main(_ROLES, *sys.argv[1:])
