"""The fleet is watched while somebody looks, and says what to do where there is nothing to watch."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.defaults import default
from tests.fleet.conftest import Serve, runtime, serve
from tests.studio.running import until
from tests.waits import PATIENCE

from hexwire.control.loop.power import Stopped
from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.fleet.overview import stop_all
from hexwire.studio import fleet_watch
from hexwire.studio.fleet_watch import FleetWatch
from hexwire.testing.link import Background

__all__ = ["runtime", "serve"]


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def watch(runtime: Path, monkeypatch: pytest.MonkeyPatch, clock: Clock) -> Iterator[FleetWatch]:
    monkeypatch.delenv("HEXWIRE_FLEET", raising=False)
    # No arm hangs here; a busy machine lets its server.
    default(monkeypatch, stop_all, timeout=PATIENCE)
    made = FleetWatch(clock)
    yield made
    made.close()


def looked(watch: FleetWatch, true: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    found: dict[str, Any] = {}

    def look() -> object:
        found.clear()
        found.update(watch.look())
        return true(found)

    until(look, "the arms")
    return found


def stopped(watch: FleetWatch, name: str | None, who: str) -> list[Stopped]:
    return asyncio.run(watch.stop(name, who))


def test_arms_appear_are_stopped_and_vanish(serve: Serve, watch: FleetWatch) -> None:
    service = serve("lab/arm1", robot="sim")
    serve("lab/arm2", robot="sim")
    found = looked(watch, lambda found: [bool(row["robot"]) for row in found["arms"]] == [True, True])
    assert [(row["name"], row["torque"], row["stopped"], row["faults"]) for row in found["arms"]] == [
        ("lab/arm1", "off", False, ""),
        ("lab/arm2", "off", False, ""),
    ]
    assert "HEXWIRE_FLEET" in found["note"]
    (done,) = stopped(watch, "lab/arm2", "tab 1")
    assert (done.name, done.confirmed, done.torques.holding) == ("lab/arm2", True, ())
    assert str(done).startswith("lab/arm2: stopped, limp: J1 J2")
    # An arm that answered too late is not known to be stopped, nor to be not stopped.
    found = looked(watch, lambda found: found["arms"][1]["stopped"] and found["arms"][0]["robot"])
    assert "tab 1 of" in found["arms"][1]["why"]
    assert not found["arms"][0]["stopped"]
    assert {row.name for row in stopped(watch, None, "tab 1")} == {"lab/arm1", "lab/arm2"}
    assert watch.known("lab/arm1") == "zenoh:lab/arm1"
    with pytest.raises(UsageError, match="there is no arm"):
        watch.known("serial:///dev/x")
    with pytest.raises(LinkNotFoundError, match="there is no arm lab/arm9"):
        stopped(watch, "lab/arm9", "tab 1")
    # Whatever the page asks, a state that is old is not shown as the present.
    assert all(
        row["known"] for row in looked(watch, lambda found: all(row["known"] for row in found["arms"]))["arms"]
    )
    assert [watch._row(row, 1.0)["known"] for row in watch._rows or ()] == [False, False]
    service.close()
    assert looked(watch, lambda found: found["gone"])["gone"] == ["lab/arm1"]


def test_without_arms_it_says_how_to_share_one(watch: FleetWatch) -> None:
    found = looked(watch, lambda found: not found["looking"])
    assert "hexwire serve --name lab/arm1" in found["note"]
    with pytest.raises(LinkNotFoundError, match="hexwire serve"):
        stopped(watch, None, "tab 1")


def test_nobody_looks_nothing_is_watched(watch: FleetWatch, clock: Clock) -> None:
    looked(watch, lambda found: not found["looking"])
    thread = watch._thread
    assert thread is not None
    clock.now += 11.0
    thread.join(30)
    assert not thread.is_alive()
    assert looked(watch, lambda found: not found["looking"])["arms"] == []
    watch.rest()
    assert watch._thread is None


def test_watching_may_end_while_it_begins(watch: FleetWatch, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[Background] = []

    class Slow(threading.Thread):
        def start(self) -> None:
            ended.append(Background(watch.rest))
            until(watch._ending.is_set, "somebody ends it")
            ended[0].let_it_block()
            super().start()

    monkeypatch.setattr(fleet_watch, "threading", SimpleNamespace(Thread=Slow))
    watch.look()
    ended[0].outcome()


def test_without_zenoh_it_says_how_to_install_it(watch: FleetWatch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zenoh", None)
    found = looked(watch, lambda found: found["error"])
    assert "pip install 'hexwire[fleet]'" in found["error"]
    assert found["note"] == ""


def test_a_file_of_the_fleet_that_is_wrong_is_said(
    watch: FleetWatch, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HEXWIRE_FLEET", str(tmp_path / "none.toml"))
    assert "none.toml" in looked(watch, lambda found: found["error"])["error"]


def test_a_burst_of_names_does_not_keep_the_stop_of_all_away(
    watch: FleetWatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, line, names = threading.Event(), threading.Event(), list[object]()

    def slow(only: object, who: str) -> list[Stopped]:
        names.append(only)
        begun.set()
        assert line.wait(30)
        return [Stopped("lab/arm1", True)]

    monkeypatch.setattr(watch, "_stop_now", slow)

    async def burst() -> list[Stopped]:
        first = asyncio.ensure_future(watch.stop("x", "Eve"))
        await asyncio.to_thread(begun.wait, 30)
        others = [asyncio.ensure_future(watch.stop(f"x{number}", "Eve")) for number in range(1200)]
        await asyncio.sleep(0)
        last = asyncio.ensure_future(watch.stop(None, "Bob"))
        await asyncio.sleep(0)
        line.set()
        await asyncio.gather(first, *others, return_exceptions=True)
        return await last

    assert [row.name for row in asyncio.run(burst())] == ["lab/arm1"]
    assert names[-1] is None
