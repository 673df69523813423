"""A shared arm around an emulated board in simulated time, and its clients."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from tests.control.arm_bench import Bench, Service

from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order, SharedArm
from hexwire.model.state import JointTarget, SentTarget

_T = TypeVar("_T")


class SharedBench:
    """Nothing supervises the lease but the owner's turns, unless a test calls `check`."""

    def __init__(self, *, on: bool = True, lease: Lease | None = None, **options: Any) -> None:
        self.bench = Bench(**({"check_table": False, "watchdog": 0.0, "publish_rate": 20.0} | options))
        self.clock, self.owner, self.robot = self.bench.clock, self.bench.owner, self.bench.owner.robot
        self.board, self.turn, self.where = self.bench.board, self.bench.turn, self.bench.where
        self.changes = 0
        self.sent: list[JointTarget] = []
        self.shared = SharedArm(self.bench.arm, lease or Lease(), on_change=self._note, clock=self.clock)
        self._write = self.robot.write
        self.robot.write = self._watch  # type: ignore[method-assign]  # a test looks at what reaches the robot
        self._numbers = itertools.count(1)
        if on:
            self.ask(lambda: self.owner.torque(True, self.robot.model.names))

    def _note(self) -> None:
        self.changes += 1

    def _watch(self, target: JointTarget) -> SentTarget:
        sent = self._write(target)
        self.sent.append(target)
        return sent

    def order(self, key: int, *, age: float | None = None, doubt: float = 0.0) -> Order:
        """As it arrives now."""
        made = None if age is None else self.owner.now() - age
        return Order(key, next(self._numbers), self.robot.epochs.mark(), made, doubt)

    def take(self, client: str = "Ann", rank: int = 1, **options: Any) -> int:
        return self.shared.take(client, rank, **options).key

    def move(self, key: int, seconds: float = 10.0, **by: float) -> SentTarget:
        """Send joints on their way by some radians."""
        goal = {name: self.where(name) + way for name, way in by.items()}
        return self.shared.write(self.order(key, age=0.0), JointTarget.of(goal, seconds))

    def ask(self, call: Callable[[], _T]) -> _T:
        """What another thread asks for. Time passes only while it waits for the owner, not while it is slow."""
        service = Service(call)
        self.settle(service)
        return service.answer()

    def settle(self, service: Service[Any]) -> None:
        self.settle_thread(service.thread)

    def settle_thread(self, thread: threading.Thread) -> None:
        while thread.is_alive():
            if self.owner._calls._waiting:
                self.owner.turn()
            else:
                thread.join(0.001)

    def keep(self, key: int, seconds: float) -> None:
        """Time passes, and the holder's heartbeat goes on."""
        end = self.clock.time + seconds
        while self.clock.time < end:
            self.shared.beat(key, 0.0)
            self.turn(0.1)

    def travel(self, joint: str, seconds: float = 1.0) -> float:
        """How far a joint moves meanwhile, radians."""
        before = self.where(joint)
        self.turn(seconds)
        return abs(self.where(joint) - before)
