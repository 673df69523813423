"""Several emulated boards on one channel, in simulated time."""

from __future__ import annotations

from collections.abc import Iterable

from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve import BoardLink, FakeClock
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session

START = 1000.0


class SharedChannel:
    """A device made of boards that all hear the host; what they send comes one after the other.

    Args:
        modules: Their module ids.

    Attributes:
        boards: By module id.
        deaf: Boards that hear nothing.
    """

    def __init__(self, modules: Iterable[int]) -> None:
        self.boards: dict[int, EmulatedBoard] = {m: make_hex7bot_board(module=m, start=START) for m in modules}
        self.deaf: set[int] = set()

    def receive(self, data: bytes, now: float) -> None:
        for module, board in self.boards.items():
            if module not in self.deaf:
                board.receive(data, now)

    def step(self, now: float) -> None:
        for board in self.boards.values():
            board.step(now)

    def data_to_send(self) -> bytes:
        return b"".join(board.data_to_send() for board in self.boards.values())

    def next_event_time(self) -> float | None:
        return min((t for b in self.boards.values() if (t := b.next_event_time()) is not None), default=None)

    def reset(self, now: float) -> None:
        for board in self.boards.values():
            board.reset(now)


def open_channel(*modules: int) -> tuple[SharedChannel, BoardLink, Session]:
    """A channel with these boards, and an open session with the first."""
    channel = SharedChannel(modules)
    link = BoardLink(channel, FakeClock(START))
    handle = IpcHandle.from_link(link)
    session = Session(handle, dst=modules[0])  # type: ignore[arg-type]  # a module of one's own
    session.open()
    session.negotiate()
    return channel, link, session
