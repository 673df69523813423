"""Cameras: open only while somebody looks, and what a picture must be before anybody gets it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.studio.fake_camera import JPEG, FakeCamera
from tests.waits import eventually

from hexwire.errors import UsageError
from hexwire.studio.cameras import LARGEST, Camera, CameraPicture, Cameras, is_whole


@pytest.fixture
def fake() -> Iterator[FakeCamera]:
    made = FakeCamera(silent=0.05)
    yield made
    made.camera.close()
    assert not made.is_open


class Looker:
    """Keeps what it is shown."""

    def __init__(self) -> None:
        self.pictures: list[CameraPicture] = []
        self.words: list[str] = []

    def __call__(self, picture: CameraPicture | None, why: str) -> None:
        if picture is None:
            self.words.append(why)
        else:
            self.pictures.append(picture)


def test_it_is_open_while_somebody_looks_and_only_then() -> None:
    fake = FakeCamera()
    assert not fake.is_open
    first, second = Looker(), Looker()
    ends = [fake.camera.look(first), fake.camera.look(second)]
    for stamp in (1.0, 2.0):
        fake.put(stamp=stamp)
    eventually(lambda: len(second.pictures) == 2)
    assert [picture.stamp for picture in first.pictures] == [1.0, 2.0]
    ends[0]()
    fake.put(stamp=3.0)
    eventually(lambda: len(second.pictures) == 3)
    assert fake.opened == 1
    assert len(first.pictures) == 2
    ends[1]()
    eventually(lambda: not fake.is_open)
    # Again, also while the thread of before is about to end.
    end = fake.camera.look(first)
    fake.put(stamp=4.0)
    eventually(lambda: len(first.pictures) == 3)
    end()
    fake.camera.close()
    assert not fake.is_open
    assert fake.camera.problem == ""


def test_what_is_no_whole_picture_reaches_nobody(fake: FakeCamera) -> None:
    looker = Looker()
    fake.camera.look(looker)
    bad = (b"", b"\xff\xd8", JPEG[:-2], JPEG[7:], JPEG[: len(JPEG) // 2], b"garbage" * 99, JPEG[:-2] + b"\0" * 9)
    for jpeg in (*bad, JPEG[:-2] + b"\0" * 10_000_000 + b"\xff\xd9"):
        assert not is_whole(jpeg)
        fake.put(jpeg)
    fake.put(JPEG + b"\0\0\0")
    eventually(lambda: looker.pictures)
    assert fake.camera.refused == len(bad) + 1
    assert is_whole(JPEG[:-2] + b"\0" * (LARGEST - len(JPEG)) + b"\xff\xd9")


def test_one_that_is_unplugged_or_stalls_is_told_in_words_and_opened_again(fake: FakeCamera) -> None:
    looker = Looker()
    fake.camera.look(looker)
    # It is open and sends nothing.
    eventually(lambda: "the camera /dev/video0 has sent no picture for 0.05 s" in looker.words)
    fake.unplug()
    eventually(lambda: "no camera is connected at /dev/video0" in looker.words)
    assert "no camera is connected at /dev/video0" in fake.camera.problem
    late = Looker()
    fake.camera.look(late)
    assert late.words
    fake.missing = ""
    fake.put()
    eventually(lambda: looker.pictures and late.pictures)


def test_one_that_sends_too_many_is_thinned_out_and_whoever_fails_harms_nobody(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def fails(picture: CameraPicture | None, why: str) -> None:
        raise ZeroDivisionError

    fake, looker = FakeCamera(), Looker()
    for call in (fails, looker):
        fake.camera.look(call)
    for at in range(90):
        fake.put(stamp=100.0 + at / 30)
    # Its clock begins anew.
    fake.put(stamp=1.0)
    eventually(lambda: looker.pictures and looker.pictures[-1].stamp == 1.0)
    fake.camera.close()
    assert len(looker.pictures) <= 46
    assert "could not be passed on" in caplog.text


def test_which_cameras_there_are() -> None:
    def cameras(*devices: str) -> Cameras:
        return Cameras(Camera(device, lambda device: FakeCamera()) for device in devices)

    made = cameras("/dev/video0", "/dev/v4l/by-id/usb-Acme Cam: 1")
    assert list(made.rows) == ["video0", "usb-Acme-Cam-1"]
    assert made.find("video0").device == "/dev/video0"
    with pytest.raises(UsageError, match="there is no camera 'video1'"):
        made.find("video1")
    with pytest.raises(UsageError, match="two cameras are named video0"):
        cameras("/dev/video0", "/elsewhere/video0")
    with pytest.raises(UsageError, match="there are 4 cameras already"):
        cameras(*map(str, range(5)))
    with pytest.raises(UsageError):
        Cameras().find("video0")
