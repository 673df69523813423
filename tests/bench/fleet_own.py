"""The processes of the fleet's benchmark that run hexwire; see `fleet_worker`."""

from __future__ import annotations

import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import fleet_worker as w  # noqa: E402

from hexwire.control.requests.controlled_arm import ControlledArm  # noqa: E402
from hexwire.control.sharing.lease import Lease  # noqa: E402
from hexwire.control.sharing.shared import Order, SharedArm  # noqa: E402
from hexwire.drivers import registry  # noqa: E402
from hexwire.drivers.base import RobotDriver  # noqa: E402
from hexwire.drivers.values import ProbeReport, StopMode  # noqa: E402
from hexwire.emulator.board import make_hex7bot_board  # noqa: E402
from hexwire.emulator.serve_pty import PtyServer  # noqa: E402
from hexwire.emulator.servo_wire import ServoWire  # noqa: E402
from hexwire.fleet.address import Address  # noqa: E402
from hexwire.fleet.names import Keys  # noqa: E402
from hexwire.fleet.network import Network  # noqa: E402
from hexwire.fleet.service import Service  # noqa: E402
from hexwire.fleet.service_file import ServedArm, read_arms  # noqa: E402
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget  # noqa: E402

SWITCH = 0.001
"""As `hexwire serve` sets it."""
_DURATION = 0.02
_WRITES = (0x03, 0x83)
"""Instructions that carry targets: write and synchronous write."""


class FakeRobot(RobotDriver):
    """An arm without a line, so that what is measured is the sharing; as the fake one of the peer.

    Args:
        like: A driver whose model it has.
    """

    def __init__(self, like: RobotDriver) -> None:
        super().__init__()
        self.model = like.model
        self.targets = w.Targets()
        self._attached = False
        n = len(self.model.names)
        self._columns: dict[str, tuple[Any, ...]] = {
            "position": tuple(joint.offset for joint in self.model.joints),
            "velocity": (0.0,) * n,
            "load": (0.0,) * n,
            "current": (math.nan,) * n,
            "voltage": (7.4,) * n,
            "temperature": (31.0,) * n,
            "flags": (int(JointFlag.TORQUE_ON),) * n,
            "age": (0.0,) * n,
        }

    @property
    def url(self) -> str:
        return "fake://"

    @property
    def is_attached(self) -> bool:
        return self._attached

    @classmethod
    def from_url(cls, url: str, **options: Any) -> FakeRobot:
        raise NotImplementedError

    def attach(self) -> None:
        self._attached = True

    def detach(self, *, torque_off: bool = False) -> None:
        self._attached = False

    def probe(self) -> ProbeReport:
        return ProbeReport(self.model.name, self.url, 2, "", None, (), False, (), {})

    def read(self) -> JointState:
        state = JointState(names=self.model.names, stamp=0.0, **self._columns)
        # Last of all, as the other owners do: what is measured begins when the state is there.
        object.__setattr__(state, "stamp", time.monotonic())
        return state

    def write(self, target: JointTarget) -> SentTarget:
        self.targets.add(target.positions[0][1])
        return SentTarget(target.positions, target.duration)

    def ioctl(self, sub_cmd: int, data: bytes = b"") -> bytes:
        return b""

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        return self.model.names

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        return self.model.names

    def resume(self) -> None:
        """It is never stopped."""


def make_fake_arm(name: str, **settings: object) -> ServedArm:
    # Its model, geometry and limits, so that targets are checked as always.
    given = read_arms({name: {"robot": "sim", **settings}})[0]
    return ServedArm(name, given.settings, FakeRobot(given.driver))


@contextmanager
def owner(name: str, port: str, *listen: str) -> Iterator[w.Worker]:
    """An arm shared as `hexwire serve` does; without a port, a fake one; with ``host:`` before it, host-timed."""
    sys.setswitchinterval(SWITCH)
    timed, port = port.startswith("host:"), port.removeprefix("host:")
    arm = read_arms({name: {"port": port, "host_timed": timed}})[0] if port else make_fake_arm(name)
    robot = arm.driver
    with Service([arm], Network(listen=listen)):
        yield lambda what: w.cpu() if what == "cpu" else robot.targets.take()  # type: ignore[attr-defined]


@contextmanager
def several(rate: str, *ports: str) -> Iterator[w.Worker]:
    """Arms at these ports, shared by one process, which publish so many states a second each."""
    sys.setswitchinterval(SWITCH)
    rows = {f"lab/arm{i}": {"port": port, "publish_rate": float(rate)} for i, port in enumerate(ports)}
    with Service(read_arms(rows)):
        yield lambda what: w.cpu()


@contextmanager
def client(url: str) -> Iterator[w.Worker]:
    """Programs that read an arm, and one that commands it."""

    def open_one() -> tuple[Callable[[], float], Callable[[], object]]:
        robot = registry.connect(url)

        def following() -> float:
            robot.read()
            now = time.monotonic()
            # The owner's own stamp: owner and reader have one clock here, and its measured offset would count too.
            return now - robot._states.newest.stamp  # type: ignore[attr-defined]

        return following, robot.detach

    readers = w.Readers(open_one)

    def work(what: str, **options: Any) -> w.Row:
        if what == "size":
            return {"size": _size(url)}
        if what == "wait":
            time.sleep(options["seconds"])
            return {}
        if what == "work":
            return _work(url, options["seconds"], options.get("torque", False))
        if what != "write":
            return readers(what, **options)
        with registry.connect(url) as robot:
            return _write(robot.write, robot, options["seconds"])

    yield work


def _size(url: str) -> int:
    """Bytes of a state."""
    address, found = Address.parse(url), queue.SimpleQueue[int]()
    node = address.network().open()
    node.subscribe(Keys(address.name).state, lambda payload, key: found.put(len(payload)))
    size = found.get(timeout=5.0)
    node.close()
    return size


def _work(url: str, seconds: float, torque: bool) -> w.Row:
    with registry.connect(url) as robot:
        joint = robot.model.names[0]

        def following() -> float:
            robot.read()
            return time.monotonic() - robot._states.newest.stamp  # type: ignore[attr-defined]

        def send(angle: float) -> None:
            robot.write(JointTarget(((joint, angle),), _DURATION))

        if not torque:
            send(0.0)
            return w.answer_states(following, send, seconds)
        robot.torque(True)
        start = robot.read()[joint].position
        send(start)
        try:
            return w.answer_states(following, lambda angle: send(start + angle), seconds)
        finally:
            robot.torque(False)


def _write(send: Callable[[JointTarget], object], robot: RobotDriver, seconds: float) -> w.Row:
    robot.torque(True)
    joint = robot.model.names[0]
    start = robot.read()[joint].position
    send(JointTarget(((joint, start),), _DURATION))
    rows = []
    for number in w.gaps(seconds):
        # Back and forth: the arm of an emulated board moves a little.
        target = start + number * w.STEP
        sent = time.monotonic()
        send(JointTarget(((joint, target),), _DURATION))
        rows.append((sent, target, time.monotonic()))
    return {"sent": rows, "start": start}


@contextmanager
def driver(port: str) -> Iterator[w.Worker]:
    """A driver that one program has for itself."""
    with registry.connect(port) as robot:
        yield lambda what, seconds: _write(robot.write, robot, seconds)


@contextmanager
def local(port: str) -> Iterator[w.Worker]:
    """The owner of an arm in one process, with lease and checks, but without Zenoh."""
    sys.setswitchinterval(SWITCH)
    given = read_arms({"local": {"port": port}})[0]
    arm = ControlledArm(given.driver, given.settings)
    shared = SharedArm(arm, Lease(timeout=60.0))
    arm.connect()
    arm.start()
    shared.start()
    sequence = 0

    def send(target: JointTarget) -> None:
        nonlocal sequence
        sequence += 1
        now = shared.now()
        shared.write(Order(key, sequence, arm.owner.robot.epochs.mark(), now, 0.0), target)

    class Robot:
        """What `_write` needs of it."""

        model = arm.owner.robot.model
        read = staticmethod(arm.owner.newest)

        @staticmethod
        def torque(on: bool) -> None:
            nonlocal sequence
            sequence += 1
            shared.torque(Order(key, sequence, arm.owner.robot.epochs.mark()), on, None)

    def work(what: str, seconds: float) -> w.Row:
        nonlocal key, sequence
        sequence = 0
        key = shared.take("bench", 1).key
        time.sleep(0.2)
        try:
            return _write(send, Robot, seconds)  # type: ignore[arg-type]
        finally:
            shared.leave(key, finish=True)

    key = 0
    try:
        yield work
    finally:
        shared.shutdown()
        arm.shutdown()


@contextmanager
def board(link: str) -> Iterator[w.Worker]:
    """An emulated board at a pseudo-terminal; notes when the first byte of a write is on its servo line."""
    times: list[float] = []
    transact = ServoWire.transact

    def noted(wire: ServoWire, packet: bytes, now: float) -> tuple[bytes, float]:
        if len(packet) > 4 and packet[4] in _WRITES:
            times.append(time.monotonic())
        return transact(wire, packet, now)

    ServoWire.transact = noted  # type: ignore[method-assign]
    ending = threading.Event()
    device = make_hex7bot_board(dialect=2, baud=0, start=time.monotonic())
    server = PtyServer(device, link=link)
    server.open()

    def run() -> None:
        while not ending.is_set():
            server.run_once()

    thread = threading.Thread(target=run)
    thread.start()

    def work(what: str) -> w.Row:
        found, times[:] = list(times), []
        # When its path was to start, in the time of the terminal, which is this machine's.
        return {"times": found, "start": device.trajectory.start_at}

    yield work
    ending.set()
    thread.join()
    server.close()


_ROLES: dict[str, Callable[..., Any]] = {
    role.__name__: role for role in (owner, several, client, driver, local, board)
}

if __name__ == "__main__":
    w.main(_ROLES, *sys.argv[1:])
