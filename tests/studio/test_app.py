"""The studio: a stop from anybody, control for those who may, and the end of a tab."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import PATIENCE, until

from hexwire.control.loop.outcomes import Outcome
from hexwire.control.loop.power import Stopped
from hexwire.control.motion.motion_run import RunProgress
from hexwire.errors import LeaseError
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.calls import Arguments, Asked, Call, CallLane, _calls
from hexwire.studio.source import Source

if TYPE_CHECKING:
    from pathlib import Path

    from tests.studio.running import RunningStudio


def test_a_watcher_cannot_take_control_but_stops_the_arm(studio: RunningStudio) -> None:
    tab = studio.studio.tabs.open("s", Right.WATCH)
    with pytest.raises(LeaseError, match="watching only"):
        studio.studio.take(tab)
    studio.studio.stop(tab.name)
    studio.until(lambda: studio.arm.owner.group.reason is not None, "the stop")


def test_the_end_of_a_motion_is_told_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may end in another thread while its beginning is being told."""
    studio = Studio(Access(frozenset()), tmp_path)
    told: list[dict[str, Any]] = []
    waiting: list[Callable[[], object]] = []
    monkeypatch.setattr(studio, "soon", waiting.append)
    monkeypatch.setattr(studio.live, "_tell", lambda message, key: told.append(message))
    progress = RunProgress("a motion")
    arm: Any = SimpleNamespace(motions=SimpleNamespace(progress=progress))
    studio._tell_run(arm)
    arm.motions.progress = replace(progress, outcome=Outcome.SUCCEEDED)
    studio._tell_run(arm)
    for tell in reversed(waiting):
        tell()
    studio.close()
    assert [row["outcome"] for row in told] == [Outcome.SUCCEEDED] * 2


def test_only_the_arm_of_the_demo_is_told_apart(studio: RunningStudio) -> None:
    arm = studio.studio.source.arm
    assert arm is not None
    assert studio.studio.emulated(arm) == ""
    studio.studio.demo = (arm.driver.url.partition("?")[0], "no weight")
    assert studio.studio.emulated(arm) == "no weight"
    studio.studio.demo = ("/dev/pts/99", "no weight")
    assert studio.studio.emulated(arm) == ""
    studio.studio.demo = ("", "")


def test_a_tab_that_is_gone_gives_control_back(studio: RunningStudio) -> None:
    tab = studio.studio.tabs.open("s", Right.OPERATE)
    studio.studio.take(tab)
    studio.studio.gone(tab)
    assert studio.studio.source.arm is not None
    shared = studio.studio.source.arm.shared
    studio.until(lambda: shared.holder is None, "the end of control")


def test_a_burst_of_stops_is_two_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, line, whys = threading.Event(), threading.Event(), list[str]()

    def stop(why: str) -> Stopped:
        whys.append(why)
        begun.set()
        line.wait(PATIENCE)
        return Stopped("arm", True)

    def opened() -> Any:
        return SimpleNamespace(name="arm", hold_to_run=SimpleNamespace(end_all=lambda why: None), stop=stop)

    studio = Studio(Access(frozenset()), tmp_path)
    present = opened()
    monkeypatch.setattr(Source, "present", property(lambda source: present))
    studio.stop("tab 1")
    assert begun.wait(PATIENCE)
    for number in range(2356):
        studio.stop(f"tab {number % 2}")
    # A stop of what is opened meanwhile does not wait for one that hangs.
    begun.clear()
    present = opened()
    studio.stop("tab 3")
    assert begun.wait(PATIENCE)
    line.set()
    monkeypatch.undo()
    until(lambda: len(whys) == 3, "the stops")
    studio.close()
    assert sorted(whys) == ["tab 0, tab 1 stopped it", "tab 1 stopped it", "tab 3 stopped it"]


def test_those_who_operate_wait_for_nobody_who_watches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    studio = Studio(Access(frozenset()), tmp_path)
    tabs: list[Any] = [SimpleNamespace(key=str(i), session=f"s{i % 9}", right=Right.WATCH) for i in range(64)]
    operator: Any = SimpleNamespace(key="o", session="o", right=Right.OPERATE)
    go = threading.Event()

    def act(asked: Asked, args: Arguments) -> object:
        return "done" if asked.tab is operator else go.wait(PATIENCE)

    monkeypatch.setitem(_calls, "wait", Call("wait", Arguments, act, Right.WATCH, False, lambda _: CallLane.WAITS))

    async def ask() -> None:
        watching = [asyncio.create_task(studio.call(tab, "wait", {})) for tab in tabs]
        await asyncio.sleep(0)
        assert await studio.call(operator, "wait", {}) == "done"
        go.set()
        assert all(await asyncio.gather(*watching))

    asyncio.run(ask())
    studio.close()


def test_what_pages_compute_takes_one_thread_of_each_right(tmp_path: Path) -> None:
    studio = Studio(Access(frozenset()), tmp_path)
    running, most, lock = Counter[str](), Counter[str](), threading.Lock()
    go, done = threading.Event(), list[Right]()

    def work(right: Right) -> None:
        with lock:
            for key in (right.name, "all"):
                running[key] += 1
                most[key] = max(most[key], running[key])
        # The first of those who watch takes long.
        assert right is Right.OPERATE or go.wait(PATIENCE)
        with lock:
            done.append(right)
            for key in (right.name, "all"):
                running[key] -= 1

    async def ask() -> None:
        watching = [
            asyncio.create_task(studio.run(CallLane.COMPUTES, Right.WATCH, partial(work, Right.WATCH)))
            for _ in range(64)
        ]
        for _ in range(10):
            await studio.run(CallLane.COMPUTES, Right.OPERATE, partial(work, Right.OPERATE))
        go.set()
        await asyncio.gather(*watching)

    asyncio.run(ask())
    studio.close()
    assert done == [Right.OPERATE] * 10 + [Right.WATCH] * 64
    assert most == {"WATCH": 1, "OPERATE": 1, "all": 2}
