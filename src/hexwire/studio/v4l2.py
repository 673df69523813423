"""Cameras of Linux by the package ``linuxpy`` (extra ``camera``): JPEG pictures as the camera compresses them.

Owns which devices are cameras, how one is opened, and what its errors mean in words. The package is imported when
cameras are asked for, before an arm is open: its import takes 0.2 s.
"""

from __future__ import annotations

import errno
import selectors
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hexwire.errors import HexwireError, UsageError
from hexwire.extras import extras_named

from .cameras import HEIGHT, LARGEST, RATE, WIDTH, Camera, CameraPicture, Cameras

__all__ = ["ALL", "V4l2Source", "find_cameras"]

ALL = "all"
"""In place of a device: all cameras that are there."""
_BUFFERS = 4
"""Pictures that the kernel keeps until they are read."""
_CLOCKS = 5.0
"""Seconds by which a picture may be older than it is when it comes; otherwise it counts by another clock."""
_WORDS = {
    errno.ENOENT: "no camera is connected at {}",
    errno.ENODEV: "the camera {} was unplugged",
    errno.ENXIO: "the camera {} was unplugged",
    errno.EIO: "the camera {} was unplugged, or its cable is bad",
    errno.EACCES: "this user may not use the camera {}: add it to the group 'video', and log in again",
    errno.EPERM: "this user may not use the camera {}: add it to the group 'video', and log in again",
    errno.EBUSY: "another program uses the camera {}",
    errno.ENOSPC: "the USB line of the camera {} is full: plug it into another port than the other cameras",
    errno.ENOTTY: "{} is no camera",
    errno.EINVAL: "{} is no camera",
}


def _library() -> Any:
    """``linuxpy.video.device``.

    Raises:
        UsageError: It is not installed, or this is not Linux.
    """
    if sys.platform != "linux":
        raise UsageError("cameras of this computer need Linux; a page shows those of the computer of its browser")
    with extras_named():
        from linuxpy.video import device

        return device


def _failed(device: str, error: OSError) -> HexwireError:
    words = _WORDS.get(error.errno or 0)
    return HexwireError(words.format(device) if words else f"the camera {device}: {error.strerror or error}")


def find_cameras(devices: Sequence[str], library: Any = None) -> Cameras:
    """The cameras that are asked for.

    Args:
        devices: Such as ``/dev/video0``, or `ALL`.
        library: What reads cameras; ``linuxpy.video.device`` if None.

    Raises:
        UsageError: There is none; the text names those that are there. Or the package is not installed.
    """
    library = library or _library()
    wanted = list(dict.fromkeys(devices))
    for device in wanted:
        if device != ALL and not Path(device).exists():
            there = ", ".join(_present(library)) or "none"
            raise UsageError(f"no camera is connected at {device}; cameras that this user may use: {there}")
    if ALL in wanted:
        wanted = _present(library)
        if not wanted:
            raise UsageError(
                "no camera is connected that sends MJPEG and that this user may use; users of cameras are in the "
                "group 'video'"
            )
    return Cameras(Camera(device, lambda device: V4l2Source(device, library)) for device in wanted)


def _present(library: Any) -> list[str]:
    """The devices that are cameras with MJPEG, and that this user may open."""
    found = []
    for path in sorted(library.iter_video_files()):
        try:
            with library.Device(path) as device:
                if _has_mjpeg(library, device):
                    found.append(str(path))
        except (OSError, library.V4L2Error):
            continue
    return found


def _has_mjpeg(library: Any, device: Any) -> bool:
    kind = library.BufferType.VIDEO_CAPTURE
    if library.Capability.VIDEO_CAPTURE not in device.info.device_capabilities:
        return False
    return any(row.type == kind and row.pixel_format == library.PixelFormat.MJPEG for row in device.info.formats)


class V4l2Source:
    """An open camera, as `cameras.CameraSource`.

    Args:
        device: Such as ``/dev/video0``.
        library: As for `find_cameras`.

    Raises:
        HexwireError: It cannot be opened; the text says why.
    """

    def __init__(self, device: str, library: Any = None) -> None:
        self._library = library = library or _library()
        self._name = device
        self._device = library.Device(device)
        self._capture: Any = None
        self._selector = selectors.DefaultSelector()
        try:
            self._device.open()
            if not _has_mjpeg(library, self._device):
                raise HexwireError(f"{device} sends no MJPEG: it is another kind of camera, or none")
            capture = library.VideoCapture(self._device, size=_BUFFERS)
            capture.set_format(WIDTH, HEIGHT, "MJPG")
            if capture.get_format().pixel_format != library.PixelFormat.MJPEG:
                raise HexwireError(f"{device} sends no MJPEG of {WIDTH} x {HEIGHT} pixels")
            self._set_rate(capture)
            capture.open()
            self._capture = capture
            self._selector.register(self._device.fileno(), selectors.EVENT_READ)
        except OSError as error:
            self.close()
            raise _failed(device, error) from None
        except library.V4L2Error as error:
            self.close()
            raise HexwireError(f"{device} is no camera: {error}") from None
        except BaseException:
            self.close()
            raise

    def _set_rate(self, capture: Any) -> None:
        try:
            capture.set_fps(RATE)
        except OSError as error:
            # A camera that has one rate only; what is too much is left out.
            if error.errno not in (errno.EINVAL, errno.ENOTTY):
                raise

    def read(self, timeout: float) -> CameraPicture | None:
        """As `cameras.CameraSource.read`."""
        try:
            if not self._selector.select(timeout):
                return None
            frame = self._capture.buffer.raw_read()
        except BlockingIOError:
            return None
        except OSError as error:
            raise _failed(self._name, error) from None
        now = time.monotonic()
        damaged = bool(frame.flags & self._library.BufferFlag.ERROR)
        by_this_clock = frame.flags & self._library.BufferFlag.TIMESTAMP_MONOTONIC
        stamp = frame.timestamp if by_this_clock and 0 <= now - frame.timestamp < _CLOCKS else now
        # What the driver itself calls damaged, or is longer than anybody wants, is none.
        return CameraPicture(b"" if damaged or len(frame) > LARGEST else frame.data, stamp)

    def close(self) -> None:
        """As `cameras.CameraSource.close`."""
        self._selector.close()
        for part in (self._capture, self._device):
            try:
                if part is not None:
                    part.close()
            except (OSError, ValueError, self._library.V4L2Error):
                # Of a camera that was unplugged; the descriptor goes with it.
                continue
