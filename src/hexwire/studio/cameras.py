"""Cameras of the studio's computer: their pictures for whoever looks, and nothing while nobody does.

Owns when a camera is open, what counts as a picture, how often one is passed on, and the words for a camera that
gives none. Pictures stay JPEG as they come; nothing is decoded. Must not know pages, sockets or files, nor which
library reads a camera: a `CameraSource` does, such as `v4l2.V4l2Source`.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePath
from typing import Protocol

from hexwire.errors import HexwireError, UsageError

__all__ = [
    "HEIGHT",
    "LARGEST",
    "RATE",
    "WIDTH",
    "Camera",
    "CameraPicture",
    "CameraSource",
    "Cameras",
    "OnPicture",
    "Pushed",
    "is_whole",
]

_log = logging.getLogger(__name__)

WIDTH, HEIGHT, RATE = 640, 480, 15
"""Pixels, and pictures a second, that a camera is asked for."""
LARGEST = 700_000
"""Bytes of a picture; a message of a recording has at most 1 MiB. One of 640 x 480 has 20 to 100 kB."""
_MOST = 4
"""Cameras."""
_SHORTEST = 0.9 / RATE
"""Seconds between two pictures that are passed on, also of a camera that makes more than it is asked for."""
_LOOK = 0.2
"""Seconds after which a camera that nobody looks at any more is closed."""
_SILENT = 3.0
"""Seconds without a whole picture after which a camera is opened anew, and its viewers are told."""
_AGAIN = 1.0
"""Seconds until a camera that cannot be opened is tried again."""
_PATIENCE = 2.0
"""Seconds for the thread of a camera to end."""


@dataclass(frozen=True, slots=True)
class CameraPicture:
    """One picture.

    Attributes:
        jpeg: A whole JPEG.
        stamp: When it was taken, seconds of `time.monotonic`, as for the states of an arm.
    """

    jpeg: bytes
    stamp: float


class CameraSource(Protocol):
    """An open camera. One thread uses it."""

    def read(self, timeout: float) -> CameraPicture | None:
        """The next picture as it comes, perhaps damaged; None if there is none within so many seconds.

        Raises:
            HexwireError: It is gone.
        """

    def close(self) -> None:
        """Close it; never raises."""


OnPicture = Callable[[CameraPicture | None, str], object]
"""Called in the thread of a camera with a picture, or with None and why there is none; it never waits."""


def is_whole(jpeg: bytes) -> bool:
    """Whether bytes begin and end as a JPEG does, and are not too many. Some cameras append zeros."""
    if not 4 < len(jpeg) <= LARGEST or not jpeg.startswith(b"\xff\xd8\xff"):
        return False
    return jpeg.endswith(b"\xff\xd9") or (jpeg[-1] == 0 and jpeg.rstrip(b"\0").endswith(b"\xff\xd9"))


class Camera:
    """One camera. It is open while somebody looks. Any thread may call its methods.

    Args:
        device: What `make` opens, such as ``/dev/video0``.
        make: Opens it; raises `HexwireError` if it cannot.
        silent: Seconds without a whole picture after which it is opened anew.
        again: Seconds until one that cannot be opened is tried again: it may be plugged in meanwhile.

    Attributes:
        name: For topics and pages: that of its device.
        device: What is opened.
        refused: Pictures that were not whole.
    """

    def __init__(
        self, device: str, make: Callable[[str], CameraSource], *, silent: float = _SILENT, again: float = _AGAIN
    ) -> None:
        self.name = re.sub(r"[^A-Za-z0-9_-]+", "-", PurePath(device).name).strip("-")[:60] or "camera"
        self.device, self.refused = device, 0
        self._make, self._silent, self._again = make, silent, again
        self._lock = threading.Lock()
        self._lookers: tuple[OnPicture, ...] = ()
        self._gone = threading.Event()
        self._why = ""
        self._thread: threading.Thread | None = None

    @property
    def problem(self) -> str:
        """Why there is no picture now; empty if there is one, or nobody looks."""
        return self._why if self._lookers else ""

    def look(self, call: OnPicture) -> Callable[[], None]:
        """Begin to look; returns what ends it."""
        with self._lock:
            self._gone.clear()
            if self._thread is None:
                self._why = ""
                thread = threading.Thread(target=self._run, name=f"camera {self.name}", daemon=True)
                # A system that has no thread left refuses: then nobody looks, and the next one may.
                thread.start()
                self._thread = thread
            elif self._why:
                call(None, self._why)
            self._lookers = (*self._lookers, call)

        def end() -> None:
            with self._lock:
                self._lookers = tuple(one for one in self._lookers if one is not call)
                if not self._lookers:
                    self._gone.set()

        return end

    def close(self) -> None:
        """End for everybody who looks."""
        with self._lock:
            self._lookers = ()
            self._gone.set()
            thread = self._thread
        if thread is not None:
            thread.join(_PATIENCE)

    # -- its thread -------------------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            try:
                self._show()
            except HexwireError as error:
                self._tell(str(error))
                self._gone.wait(self._again)
            except Exception as error:  # noqa: BLE001  # logged and told; the camera is tried again
                _log.exception("the camera %s failed", self.name)
                self._tell(f"the camera {self.device}: {error}")
                self._gone.wait(self._again)
            with self._lock:
                # Whoever looks from here on begins another thread; this one has closed the camera.
                if not self._lookers:
                    self._thread = None
                    return

    def _show(self) -> None:
        """Pass pictures on while somebody looks."""
        source = self._make(self.device)
        try:
            passed, heard = float("-inf"), time.monotonic()
            while not self._gone.is_set():
                picture = source.read(_LOOK)
                now = time.monotonic()
                if picture is None or not is_whole(picture.jpeg):
                    self.refused += picture is not None
                    if now - heard > self._silent:
                        what = "no picture" if picture is None else "no whole picture"
                        raise HexwireError(f"the camera {self.device} has sent {what} for {self._silent:g} s")
                    continue
                heard = now
                if picture.stamp - passed >= _SHORTEST or picture.stamp < passed:
                    passed = picture.stamp
                    self._why = ""
                    self._pass(self._lookers, picture, "")
        finally:
            source.close()

    def _tell(self, why: str) -> None:
        if why != self._why:
            _log.warning("%s", why)
            # Whoever begins to look meanwhile either is among those told here or finds the words.
            with self._lock:
                self._why = why
                lookers = self._lookers
            self._pass(lookers, None, why)

    def _pass(self, lookers: tuple[OnPicture, ...], picture: CameraPicture | None, why: str) -> None:
        for call in lookers:
            try:
                call(picture, why)
            except Exception:  # noqa: BLE001  # logged; the others see it
                _log.exception("a picture of %s could not be passed on", self.name)


class Pushed:
    """A camera whose pictures come from elsewhere, as `CameraSource`: of a browser that sends them.

    Args:
        wanted: Called with whether somebody looks, in the thread of the camera; it never waits.
    """

    def __init__(self, wanted: Callable[[bool], object]) -> None:
        self._wanted, self._come = wanted, threading.Event()
        self._newest: CameraPicture | None = None

    def open(self, device: str) -> Pushed:
        """Begin to take pictures."""
        self._wanted(True)
        return self

    def put(self, jpeg: bytes) -> None:
        """Let a picture come; it takes the place of one that nobody has read. Any thread may call it."""
        self._newest = CameraPicture(jpeg, time.monotonic())
        self._come.set()

    def read(self, timeout: float) -> CameraPicture | None:
        """As `CameraSource.read`."""
        self._come.wait(timeout)
        self._come.clear()
        found, self._newest = self._newest, None
        return found

    def close(self) -> None:
        """As `CameraSource.close`."""
        self._newest = None
        self._wanted(False)


class Cameras:
    """The cameras that somebody has asked for.

    Args:
        cameras: The cameras.

    Attributes:
        rows: The cameras by name.

    Raises:
        UsageError: These are too many, or two have one name.
    """

    def __init__(self, cameras: Iterable[Camera] = ()) -> None:
        self.rows: dict[str, Camera] = {}
        for camera in cameras:
            self.add(camera)

    def add(self, camera: Camera) -> None:
        """Add a camera; raises as the constructor."""
        if camera.name in self.rows:
            raise UsageError(f"two cameras are named {camera.name}: name each once")
        if len(self.rows) >= _MOST:
            raise UsageError(f"there are {_MOST} cameras already, which is the most")
        self.rows[camera.name] = camera

    def find(self, name: str) -> Camera:
        """The camera of that name.

        Raises:
            UsageError: There is none.
        """
        with suppress(KeyError):
            return self.rows[name]
        raise UsageError(f"there is no camera {name[:60]!r}")

    def close(self) -> None:
        """Close all."""
        for camera in list(self.rows.values()):
            camera.close()
