"""Cameras for pages: who may look, how many, and that a slow page gets the newest picture."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Iterator
from typing import Any

import pytest
from tests.studio.fake_camera import JPEG, FakeCamera
from tests.studio.running import PATIENCE, RunningStudio, Visitor, until
from websockets.exceptions import InvalidStatus

from hexwire.studio.camera_views import _Slot
from hexwire.studio.cameras import CameraPicture


@pytest.fixture
def fake(served: RunningStudio) -> Iterator[FakeCamera]:
    """The only camera of the studio."""
    made = FakeCamera()
    served.studio.cameras.rows[made.camera.name] = made.camera
    try:
        yield made
    finally:
        made.camera.close()
        served.studio.cameras.rows.clear()


def test_a_watcher_sees_each_picture_and_the_camera_is_off_when_nobody_looks(
    studio: RunningStudio, fake: FakeCamera
) -> None:
    with Visitor(studio, studio.studio.access.watch_token) as visitor:
        with visitor.socket("/camera/video0") as viewer:
            for number in range(3):
                jpeg = JPEG + number * b"\0"
                fake.put(jpeg, stamp=number)
                assert viewer.recv(PATIENCE) == jpeg
                viewer.send("shown")
            fake.unplug()
            assert json.loads(viewer.recv(PATIENCE))["problem"] == "the camera /dev/video0 was unplugged"
        until(lambda: not fake.is_open, "its end")
        with visitor.socket("/camera/none") as viewer:
            assert "there is no camera 'none'" in json.loads(viewer.recv(PATIENCE))["refused"]


def test_nobody_from_elsewhere_looks(studio: RunningStudio, fake: FakeCamera) -> None:
    watch = studio.studio.access.watch_token
    for token, options in (("", {}), (watch, {"origin": "http://evil.example"}), (watch, {"host": "evil.example"})):
        with Visitor(studio, token) as visitor:
            for name, value in options.items():
                setattr(visitor, name, value)
            with pytest.raises(InvalidStatus):
                visitor.socket("/camera/video0")
    # The key in the address is for programs that speak Foxglove's protocol.
    with Visitor(studio) as visitor, pytest.raises(InvalidStatus):
        visitor.socket(f"/camera/video0?token={watch}")
    assert fake.opened == 0


def test_a_flood_of_viewers_has_a_bound_and_a_stop_gets_through(studio: RunningStudio, fake: FakeCamera) -> None:
    studio.torque()
    with Visitor(studio, studio.studio.access.watch_token) as visitor, contextlib.ExitStack() as stack:
        viewers = [stack.enter_context(visitor.socket("/camera/video0")) for _ in range(8)]
        for number in range(40):
            fake.put(JPEG + b"\0" * 200_000, stamp=number)
            for viewer in viewers:
                viewer.send("shown" * 1000)
        with visitor.socket("/camera/video0") as one_more:
            assert "8 pages look at cameras already" in json.loads(one_more.recv(PATIENCE))["refused"]
        # Nobody reads, and those who operate have places of their own.
        with Visitor(studio, studio.studio.access.operate_token) as operator:
            with operator.socket("/camera/video0") as viewer:
                fake.put(stamp=100.0)
                while viewer.recv(PATIENCE) != JPEG:
                    viewer.send("shown")
            assert operator.ask("/stop", "POST")[0] == 200
            studio.stopped("the stop")
        assert fake.opened == 1


def test_a_page_sends_pictures_of_its_own_camera_while_somebody_looks(served: RunningStudio) -> None:
    access, rows = served.studio.access, served.studio.cameras.rows
    with Visitor(served, access.watch_token) as watcher, Visitor(served, access.operate_token) as operator:
        with watcher.socket(f"/camera?tab={watcher.page('/move')}") as own:
            assert "for watching only" in json.loads(own.recv(PATIENCE))["refused"]
        with operator.socket(f"/camera?tab={watcher.page('/move')}") as own:
            assert "refused" in json.loads(own.recv(PATIENCE))
        tab = operator.page("/move")
        with operator.socket(f"/camera?tab={tab}") as own, operator.socket(f"/camera?tab={tab}"):
            first, second = rows
            assert (first[-9:], second) == ("-camera-1", first[:-1] + "2")
            with watcher.socket(f"/camera/{first}") as viewer:
                assert json.loads(own.recv(PATIENCE)) == {"wanted": True}
                for sent in (b"garbage", JPEG[:-2], "text"):
                    own.send(sent)
                own.send(JPEG)
                assert viewer.recv(PATIENCE) == JPEG
            assert json.loads(own.recv(PATIENCE)) == {"wanted": False}
            with watcher.socket(f"/camera/{first}"):
                assert json.loads(own.recv(PATIENCE)) == {"wanted": True}
                own.close()
                until(lambda: list(rows) == [second], "its end")
        until(lambda: not rows, "the end of the other one")


async def _slow(slot: _Slot) -> list[Any]:
    """What a page gets that shows nothing for a while."""
    taken: list[Any] = []

    async def read() -> None:
        while True:
            taken.append(await slot.take())

    reader = asyncio.create_task(read())
    for stamp in range(6):
        slot.put(CameraPicture(JPEG, float(stamp)), "")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    assert [picture.stamp for picture in taken] == [0.0, 1.0]
    slot.shown()
    await asyncio.sleep(0)
    slot.put(None, "it was unplugged")
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    reader.cancel()
    # More than it was sent it cannot have shown.
    for _ in range(99):
        slot.shown()
    return taken


def test_a_slow_page_gets_the_newest_picture_and_while_the_loop_hangs_nothing_is_queued() -> None:
    async def run() -> list[Any]:
        slot = _Slot(asyncio.get_running_loop())
        # The loop does not look meanwhile.
        for stamp in range(1000):
            slot.put(CameraPicture(JPEG, float(stamp)), "")
        return await _slow(slot)

    taken = asyncio.run(run())
    assert [getattr(one, "stamp", one) for one in taken] == [0.0, 1.0, 5.0, "it was unplugged"]
