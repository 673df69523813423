"""Calls about servos, as a script sends them that keeps to no form of the page: the bounds of forms hold."""

from __future__ import annotations

import itertools
import json
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import Visitor, until

from hexwire.studio.access import Right
from hexwire.studio.calls import CallLane

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio

_names = itertools.count(1)
_Ask = Callable[..., Any]


@pytest.fixture
def bus(served: RunningStudio) -> Iterator[Any]:
    """An emulated SO-101's servos, opened without a search."""
    served.studio.source.silence = 5.0
    try:
        yield served.studio.source.open_bus(f"sim://so101?name=calls{next(_names)}")
    finally:
        served.studio.source.close()
        served.studio.access.end_all()


def _asker(line: Any) -> _Ask:
    """Makes calls; returns their value, or why they were refused."""
    numbers = itertools.count(1)

    def ask(name: str, /, **args: object) -> Any:
        number = next(numbers)
        line.send(json.dumps({"do": "call", "id": number, "name": name, "args": args}))
        found: dict[str, Any] = {}

        def heard() -> bool:
            message = line.recv(timeout=30)
            told = json.loads(message) if isinstance(message, str) else {}
            if told.get("kind") == "answer" and told["id"] == number:
                found.update(told)
            return found

        until(heard, f"the answer to {name}")
        return found["error"] if "error" in found else found["value"]

    return ask


def test_only_servos_that_were_found_are_asked_or_changed(served: RunningStudio, bus: Any) -> None:
    """At 254 all of them listen; of what a page still shows, one may have gone."""
    owner = Visitor(served, served.studio.access.operate_token)
    with owner.socket(f"/live?tab={owner.page()}") as line:
        ask = _asker(line)
        ask("take")
        assert ask("servos.search", rate=0, ids="1-7") == 6
        sent = bus.bus.link.device.wire
        before = {i: sent[i].registers.stored("id") for i in range(1, 7)}
        edit = {"register": "max_temperature", "text": "60", "raw": False}
        calls: list[tuple[str, dict[str, object]]] = [
            ("servos.torque", {"on": False}),
            ("servos.torque", {"on": True}),
            ("servos.recover", {}),
            ("servos.middle", {}),
            ("registers.read", {}),
            ("registers.edit", edit),
            ("identity.change", {"new_id": 30, "new_baud": 1_000_000}),
            ("backup.restore", {}),
        ]
        for servo in (254, 99, -1, 10**12):
            refusals = {f"{name} {args}": ask(name, servo=servo, **args) for name, args in calls}
            refusals["backup.take"] = ask("backup.take", servos=[1, servo])
            refusals["stress.run"] = ask("stress.run", count=5, servos=[servo])
            for name, words in refusals.items():
                assert words == f"servo {servo} was not found on this bus; search first", name
        assert {i: sent[i].registers.stored("id") for i in range(1, 7)} == before
        assert ask("backup.take", servos=[2, 2, 2])["servos"] == [2]


def test_a_servo_is_looked_for_at_rates_that_servos_have(served: RunningStudio, bus: Any) -> None:
    """At 1 baud the search would go on for minutes, in which the servos hear no stop."""
    owner = Visitor(served, served.studio.access.operate_token)
    with owner.socket(f"/live?tab={owner.page()}") as line:
        ask = _asker(line)
        ask("take")
        for baud in (-1, 0, 1, 10**9):
            assert ask("identity.look", ids=[1, 2], bauds=[1_000_000, baud]) == f"there is no rate of {baud} baud"
        for servo in (-1, 254, 10**12):
            assert "outside 0..253" in ask("identity.look", ids=[1, servo], bauds=[1_000_000, 115_200])
        assert bus.bus.timing.baud == 1_000_000
        assert ask("identity.look", ids=[1, 2], bauds=[1_000_000, 1_000_000])["servo"] == 1


def test_a_call_that_waits_is_not_carried_out_when_control_has_gone(
    served: RunningStudio, bus: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner, free, done = Visitor(served, served.studio.access.operate_token), threading.Event(), list[bool]()
    monkeypatch.setattr(bus, "switch_torque", lambda on, ids=None: done.append(on))
    monkeypatch.setattr(bus.bench, "servo_ids", (1,))
    workers = served.studio._lanes[CallLane.WAITS, Right.OPERATE]
    key, session = owner.page(), owner.cookie.partition("=")[2]
    with owner.socket(f"/live?tab={key}") as line:
        _asker(line)("take")
        tab, other = served.studio.tabs.find(key, session), served.studio.tabs.open("other", Right.OPERATE)
        assert tab is not None
        assert served.studio.source.has_control(tab)
        try:
            # All are busy: the call has to wait.
            for _ in range(workers._max_workers):
                workers.submit(free.wait)
            args = {"servo": 1, "on": False}
            line.send(json.dumps({"do": "call", "id": 90, "name": "servos.torque", "args": args}))
            until(workers._work_queue.qsize, "the call")
            served.studio.take(other, force=True)
        finally:
            free.set()
        heard = [""]
        until(lambda: heard.append(str(line.recv(timeout=30))) or '"answer"' in heard[-1], "the answer")
    assert "control" in heard[-1]
    assert not done


def test_a_wave_of_a_number_that_is_none_is_refused_in_words(served: RunningStudio, bus: Any) -> None:
    watcher = Visitor(served, served.studio.access.watch_token)
    wave = {"servo": 1, "shape": "sine", "period": 2.0, "seconds": 6.0}
    with watcher.socket(f"/live?tab={watcher.page()}") as line:
        ask = _asker(line)
        for amplitude in (10**400, float("inf"), float("nan")):
            assert ask("wave.check", args=wave | {"amplitude": amplitude}) == "amplitude must be a finite number"
        for amplitude, told in ((True, "true"), ("10", "the text '10'"), (None, "nothing")):
            said = ask("wave.check", args=wave | {"amplitude": amplitude})
            assert said == f"amplitude must be a number, not {told}"
        assert "°/s" in ask("wave.check", args=wave | {"amplitude": 10})
