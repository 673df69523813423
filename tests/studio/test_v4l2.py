"""Cameras by linuxpy: what its answers and errors become. The library itself is asked where no camera is needed."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from typing import Any

import pytest
from linuxpy.video import device as real

from hexwire.errors import HexwireError, UsageError
from hexwire.studio.cameras import LARGEST
from hexwire.studio.v4l2 import V4l2Source, find_cameras

_pipes: list[int] = []


@pytest.fixture(autouse=True)
def _pipes_closed() -> Iterator[None]:
    yield
    while _pipes:
        os.close(_pipes.pop())


class Frame:
    def __init__(self, data: bytes, timestamp: float, flags: int) -> None:
        self.data, self.timestamp, self.flags = data, timestamp, flags

    def __len__(self) -> int:
        return len(self.data)


class Library:
    """In place of ``linuxpy.video.device``, with one camera; `fails` maps a step to its error number."""

    BufferFlag, BufferType, Capability = real.BufferFlag, real.BufferType, real.Capability
    PixelFormat, V4L2Error = real.PixelFormat, real.V4L2Error

    def __init__(self, fails: dict[str, int] | None = None, sends: str = "MJPEG") -> None:
        self.fails, self.sends = fails or {}, sends
        self.frames: list[Frame] = []
        self.closed = 0
        self.ends = os.pipe()
        _pipes.extend(self.ends)

    def step(self, name: str) -> None:
        if name in self.fails:
            raise OSError(self.fails[name], os.strerror(self.fails[name]))

    def Device(self, path: Any) -> Any:  # noqa: N802
        return _Device(self)

    def VideoCapture(self, device: Any, size: int) -> Any:  # noqa: N802
        return _Capture(self)

    def iter_video_files(self) -> list[str]:
        return ["/dev/video0"]


class _Device:
    def __init__(self, library: Library) -> None:
        self.library = library
        self.info = self
        self.device_capabilities = real.Capability.VIDEO_CAPTURE
        self.formats = [
            real.ImageFormat(real.BufferType.VIDEO_CAPTURE, "", 0, getattr(real.PixelFormat, library.sends))
        ]

    def open(self) -> None:
        self.library.step("open")

    def __enter__(self) -> _Device:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.library.closed += 1

    def fileno(self) -> int:
        return self.library.ends[0]


class _Capture:
    def __init__(self, library: Library) -> None:
        self.library, self.buffer = library, self

    def set_format(self, width: int, height: int, pixel_format: str) -> None:
        assert (width, height, pixel_format) == (640, 480, "MJPG")
        self.library.step("format")

    def get_format(self) -> Any:
        return real.Format(640, 480, real.PixelFormat.MJPEG, 0, 0)

    def set_fps(self, rate: int) -> None:
        self.library.step("rate")

    def open(self) -> None:
        self.library.step("start")

    def close(self) -> None:
        self.library.step("close")

    def raw_read(self) -> Frame:
        self.library.step("read")
        os.read(self.library.ends[0], 1)
        return self.library.frames.pop(0)


def test_whatever_keeps_a_camera_from_opening_is_one_line() -> None:
    for fails, words in (
        ({"open": errno.ENOENT}, "no camera is connected at /dev/video0"),
        ({"open": errno.EACCES}, "group 'video'"),
        ({"format": errno.EBUSY}, "another program uses the camera /dev/video0"),
        ({"start": errno.ENOSPC}, "USB line"),
        ({"start": errno.ENODEV}, "was unplugged"),
        ({"start": errno.ENOMEM}, "the camera /dev/video0: Cannot allocate memory"),
        ({"rate": errno.EIO}, "unplugged, or its cable is bad"),
    ):
        library = Library(fails)
        with pytest.raises(HexwireError) as caught:
            V4l2Source("/dev/video0", library)
        assert words in str(caught.value), fails
        assert "\n" not in str(caught.value)
        assert library.closed == 1, fails
    with pytest.raises(HexwireError, match="sends no MJPEG"):
        V4l2Source("/dev/video0", Library(sends="YUYV"))
    # One rate only is none of its faults, nor is one that was unplugged when it is closed.
    source = V4l2Source("/dev/video0", Library({"rate": errno.EINVAL, "close": errno.ENODEV}))
    source.close()


def test_pictures_come_as_they_are_with_their_time() -> None:
    library = Library()
    source = V4l2Source("/dev/video0", library)
    assert source.read(0.0) is None
    by_clock, now = real.BufferFlag.TIMESTAMP_MONOTONIC, time.monotonic()
    rows = (
        (Frame(b"jpeg", now - 0.1, by_clock), b"jpeg", now - 0.1),
        (Frame(b"jpeg", 7.0, 0), b"jpeg", None),
        (Frame(b"jpeg", now - 999.0, by_clock), b"jpeg", None),
        (Frame(b"jpeg", now, by_clock | real.BufferFlag.ERROR), b"", now),
        (Frame(b"x" * (LARGEST + 1), now, by_clock), b"", now),
    )
    for frame, jpeg, stamp in rows:
        library.frames.append(frame)
        os.write(library.ends[1], b"x")
        found = source.read(30.0)
        assert found is not None
        assert found.jpeg == jpeg
        assert found.stamp == stamp if stamp is not None else found.stamp >= now, frame.timestamp
    os.write(library.ends[1], b"x")
    for number, words in ((errno.ENODEV, "was unplugged"), (errno.EAGAIN, "")):
        library.fails["read"] = number
        if words:
            with pytest.raises(HexwireError, match=words):
                source.read(30.0)
        else:
            assert source.read(30.0) is None
    source.close()


def test_which_cameras_are_asked_for() -> None:
    assert list(find_cameras(["all"], Library()).rows) == ["video0"]
    with pytest.raises(UsageError, match="no camera is connected that sends MJPEG"):
        find_cameras(["all"], Library(sends="YUYV"))
    with pytest.raises(UsageError, match="at /dev/video99; cameras that this user may use: /dev/video0"):
        find_cameras(["/dev/video99"], Library())
    with pytest.raises(UsageError, match="/dev/video99; cameras that this user may use: none"):
        find_cameras(["/dev/video99"], Library({"open": errno.EACCES}))


def test_the_library_has_what_is_used_of_it_and_says_what_is_no_camera() -> None:
    for kind, names in (
        (real.Device, ("open", "close", "fileno")),
        (real.VideoCapture, ("set_format", "get_format", "set_fps", "open", "close")),
        (real.MemoryMap, ("raw_read",)),
        (real.Frame, ("flags", "timestamp", "data")),
    ):
        for name in names:
            assert hasattr(kind, name), (kind, name)
    for device, words in (
        ("/dev/null", "/dev/null is no camera"),
        ("/dev/hexwire-none", "no camera is connected at /dev/hexwire-none"),
        ("/", "the camera /: Is a directory"),
    ):
        with pytest.raises(HexwireError) as caught:
            V4l2Source(device)
        assert words in str(caught.value)
