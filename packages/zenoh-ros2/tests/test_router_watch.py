from __future__ import annotations

import logging

import pytest

from zenoh_ros2 import router_watch
from zenoh_ros2.router_watch import RouterWatch

LOG = logging.getLogger("test_router_watch")
REMEDY = "start one somewhere"


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(router_watch, "_PERIOD", 0.01)
    monkeypatch.setattr(router_watch, "_LOOK", 0.001)


def test_a_missing_router_is_told_with_what_to_do(caplog: pytest.LogCaptureFixture) -> None:
    watch = RouterWatch(lambda: 0, ["tcp/localhost:7447"], REMEDY, LOG)
    assert not watch.wait(2)
    text = (
        "Unable to connect to a Zenoh router at tcp/localhost:7447. Start one somewhere; until then other nodes do "
        "not see this one"
    )
    assert [record.getMessage() for record in caplog.records] == [text]
    assert not watch.wait(11)
    assert len(caplog.records) == 3


def test_a_router_that_is_there_is_not_mentioned(caplog: pytest.LogCaptureFixture) -> None:
    watch = RouterWatch(lambda: 1, ["tcp/localhost:7447"], REMEDY, LOG)
    assert watch.wait(1)
    watch.look()
    assert caplog.records == []


def test_waiting_without_limit_ends_when_the_router_comes() -> None:
    answers = iter([0] * 50 + [1] * 1000)
    assert RouterWatch(lambda: next(answers), [], REMEDY, LOG).wait(0)


def test_a_router_that_comes_or_goes_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    count = [0]
    watch = RouterWatch(lambda: count[0], ["tcp/a:1"], REMEDY, LOG)
    for number in (0, 1, 1, 0, 0, 1):
        count[0] = number
        watch.look()
    assert [record.getMessage() for record in caplog.records] == [
        "Connected to a Zenoh router",
        "The connection to the Zenoh router is lost; until tcp/a:1 is back, other nodes do not see this one",
        "Connected to a Zenoh router",
    ]


def test_the_thread_ends() -> None:
    looks: list[int] = []
    watch = RouterWatch(lambda: len(looks.append(1) or looks), [], REMEDY, LOG)
    watch.start()
    watch.stop()
    seen = len(looks)
    watch.stop()
    assert len(looks) == seen
