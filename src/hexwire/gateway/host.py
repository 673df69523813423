"""One host of a gateway: what it has sent so far, and what waits for it.

No I/O; time comes in as `now`. Must not know boards, nor the link to the host.
"""

from __future__ import annotations

from collections.abc import Iterable

from hexwire.session.decoder import FrameDecoder
from hexwire.session.fragments import FragmentReceiver
from hexwire.wire import tables
from hexwire.wire.command_frame import Frame, serialize_frame

__all__ = ["Host"]


class Host:
    """One host's side of a stream.

    Args:
        name: Who it is, for those whom it keeps out.
        modules: Ids of the boards.

    Attributes:
        in_messages: Its link keeps messages and their boundaries, so that it has conversations.
    """

    in_messages = False

    def __init__(self, name: str, modules: Iterable[int]) -> None:
        self.name = name
        self.decoder = FrameDecoder(tables.MAX_NETWORK_FRAME)
        self.messages = {module: FragmentReceiver() for module in modules}
        self.asker: Frame | None = None
        self.out: list[bytes] = []

    @property
    def generation(self) -> int:
        """Number of hosts that this side has had before: another number is another host."""
        return 0

    def forget(self) -> None:
        """The host is gone, and another one may take its side: nothing of it continues."""
        for receiver in self.messages.values():
            receiver.forget()
        self.asker = None
        self.out.clear()

    def takes(self, frame: Frame, now: float) -> bool:
        """Whether a frame counts that has arrived; a stream carries none that is old."""
        return True

    def send(self, frames: Iterable[Frame]) -> None:
        """Queue frames for it."""
        self.out += (serialize_frame(frame, tables.MAX_NETWORK_FRAME) for frame in frames)
