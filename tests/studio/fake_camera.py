"""A camera without a camera: what a test puts into it comes out as pictures."""

from __future__ import annotations

import base64
import queue
import time

from hexwire.errors import HexwireError
from hexwire.studio.cameras import Camera, CameraPicture

__all__ = ["JPEG", "FakeCamera"]

JPEG = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDACgcHiMeGSgjISMtKygwPGRBPDc3PHtYXUlkkYCZlo+AjIqgtObDoKrarYqMyP/L2u71////m8H////6"
    "/+b9//j/2wBDASstLTw1PHZBQXb4pYyl+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj4+Pj/wAARCAAM"
    "ABADASIAAhEBAxEB/8QAFQABAQAAAAAAAAAAAAAAAAAAAAT/xAAUEAEAAAAAAAAAAAAAAAAAAAAA/8QAFQEBAQAAAAAAAAAAAAAAAAAAAwT/xAAU"
    "EQEAAAAAAAAAAAAAAAAAAAAA/9oADAMBAAIRAxEAPwCcAS9//9k="
)
"""A whole JPEG of 16 x 12 pixels, red."""


class FakeCamera:
    """A camera, as `hexwire.studio.cameras.CameraSource`, and what opens it.

    Args:
        name: Its name.
        streams: It sends pictures as a camera does, without being given any.
        silent: As for `Camera`.

    Attributes:
        camera: The `Camera` that reads it.
        opened: How often it was opened.
        is_open: Whether it is open now.
        missing: Why it cannot be opened; empty if it can.
    """

    def __init__(self, name: str = "video0", *, streams: bool = False, silent: float = 30.0) -> None:
        self.opened, self.is_open, self.missing = 0, False, ""
        self.camera = Camera(f"/dev/{name}", self._open, silent=silent, again=0.05)
        self._streams = streams
        self._waiting: queue.SimpleQueue[CameraPicture | HexwireError] = queue.SimpleQueue()

    def _open(self, device: str) -> FakeCamera:
        if self.missing:
            raise HexwireError(self.missing)
        assert not self.is_open, "it is open already"
        self.opened, self.is_open = self.opened + 1, True
        return self

    def put(self, jpeg: bytes = JPEG, stamp: float | None = None) -> None:
        """Let a picture come."""
        self._waiting.put(CameraPicture(jpeg, time.monotonic() if stamp is None else stamp))

    def unplug(self) -> None:
        """Pull it out."""
        self.missing = "no camera is connected at /dev/video0"
        self._waiting.put(HexwireError("the camera /dev/video0 was unplugged"))

    def read(self, timeout: float) -> CameraPicture | None:
        """What was put in."""
        try:
            found = self._waiting.get(timeout=0.01)
        except queue.Empty:
            return CameraPicture(JPEG, time.monotonic()) if self._streams else None
        if isinstance(found, HexwireError):
            raise found
        return found

    def close(self) -> None:
        """Close it."""
        self.is_open = False
