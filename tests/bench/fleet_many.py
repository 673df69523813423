"""The processes of the fleet's benchmark that make a fleet behind a router; see `fleet_worker`."""

from __future__ import annotations

import random
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import fleet_worker as w
from fleet_own import SWITCH, FakeRobot, make_fake_arm

from hexwire.fleet import messages as m
from hexwire.fleet.clock import ClockOffset
from hexwire.fleet.names import Keys
from hexwire.fleet.network import Network
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.fleet.states import ArrivedStates


@contextmanager
def router(endpoint: str) -> Iterator[w.Worker]:
    """A router."""
    node = Network(listen=(endpoint,), router=True).open()
    yield lambda what: w.cpu()
    node.close()


@contextmanager
def arms(endpoint: str, first: str, count: str, rate: str) -> Iterator[w.Worker]:
    """Arms with owner, lease and server, each with a fake robot."""
    sys.setswitchinterval(SWITCH)
    names = [f"fleet/arm{int(first) + i}" for i in range(int(count))]
    served = [make_fake_arm(name, publish_rate=float(rate)) for name in names]
    with Service(served, Network(connect=(endpoint,))):
        yield lambda what: w.cpu()


@contextmanager
def replay(endpoint: str, first: str, count: str, rate: str) -> Iterator[w.Worker]:
    """Arms of which there are only states, with nothing behind them; they share one session."""
    robot = FakeRobot(read_arms({"fleet/arm": {"robot": "sim"}})[0].driver)
    state = robot.read()
    columns = [getattr(state, name) for name in m.State.__struct_fields__[5:14]]
    ending = threading.Event()
    with ExitStack() as stack:
        puts = []
        node = Network(connect=(endpoint,)).open()
        stack.callback(node.close)
        for i in range(int(count)):
            name = f"fleet/arm{int(first) + i}"
            node.announce(Keys(name).token("0"))
            puts.append((random.getrandbits(53), node.publisher(Keys(name).state)))

        def run() -> None:
            # One after the other, as arms that nobody has synchronised.
            for number in w.beats(float(rate) * len(puts), lambda: not ending.is_set()):
                server, put = puts[number % len(puts)]
                now = time.monotonic()
                message = m.State(
                    server, number // len(puts) + 1, now, now, time.time(), *columns, now, False, False, False
                )
                put(m.encode(message))

        thread = threading.Thread(target=run)
        thread.start()
        yield lambda what: w.cpu()
        ending.set()
        thread.join()


@contextmanager
def watcher(endpoint: str) -> Iterator[w.Worker]:
    """A program that reads every arm."""
    node = Network(connect=(endpoint,)).open()
    seen: dict[str, ArrivedStates] = {}
    ages: list[float] = []

    def take(payload: bytes, key: str) -> None:
        states = seen.get(key)
        if states is None:
            states = seen[key] = ArrivedStates(key, ClockOffset())
        states.add(payload)
        if states.newest is not None:
            ages.append(states.arrived - states.newest.stamp)

    node.subscribe("hexwire/fleet/*/state", take)

    def work(what: str, seconds: float = 0.0) -> w.Row:
        before = {key: (states.seen, states.lost) for key, states in seen.items()}
        start = w.cpu()
        ages.clear()
        time.sleep(seconds)
        end = w.cpu()
        rows = [
            (states.seen - before.get(key, (0, 0))[0], states.lost - before.get(key, (0, 0))[1])
            for key, states in list(seen.items())
        ]
        return {"arms": rows, "ages": sorted(ages)[::10], "cpu": end["cpu"] - start["cpu"], "now": end["now"]}

    yield work
    node.close()


_ROLES: dict[str, Callable[..., Any]] = {role.__name__: role for role in (router, arms, replay, watcher)}

if __name__ == "__main__":
    w.main(_ROLES, *sys.argv[1:])
