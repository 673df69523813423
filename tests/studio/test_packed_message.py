"""Messages that are packed once for all who get them: the bytes, and that none overtakes what was told before."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from websockets.frames import Frame, Opcode

from hexwire.studio.live import _Socket
from hexwire.studio.packed_message import pack_message


@given(st.one_of(st.integers(0, 300), st.sampled_from([65535, 65536, 70000])))
def test_the_bytes_are_those_of_a_message_from_a_server(size: int) -> None:
    payload = bytes(i % 251 for i in range(size))
    assert pack_message(payload) == Frame(Opcode.BINARY, payload).serialize(mask=False)


class _Line:
    """A browser's line, which takes what is sent while it is not full."""

    def __init__(self) -> None:
        self.got: list[str | bytes] = []
        self.free = asyncio.Event()
        self.free.set()

    def write(self, message: bytes) -> bool:
        if self.free.is_set():
            self.got.append(message)
        return self.free.is_set()

    async def send_text(self, text: str) -> None:
        await self.free.wait()
        self.got.append(text)

    async def send_bytes(self, frame: bytes) -> None:
        await self.free.wait()
        self.got.append(frame)


async def _turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def test_frames_are_written_at_once_and_overtake_nothing() -> None:
    async def watch() -> list[str | bytes]:
        line = _Line()
        stub: Any = line
        socket = _Socket(stub, SimpleNamespace(grant=0, key=""), 30.0, line.write)  # type: ignore[arg-type]
        sender = asyncio.create_task(socket.send_all())
        await _turns()
        socket.put_frame(b"1", b"packed 1")
        socket.put("of another arm")
        socket.put_frame(b"2", b"packed 2")
        await _turns()
        # A line that is full gets the newest one only, and that after what was before it.
        line.free.clear()
        socket.put_frame(b"3", b"packed 3")
        await _turns()
        socket.put("told")
        socket.put_frame(b"4", b"packed 4")
        socket.put_frame(b"5", b"packed 5")
        await _turns()
        line.free.set()
        await _turns()
        socket.put_frame(b"6", b"packed 6")
        sender.cancel()
        return line.got

    assert asyncio.run(watch()) == [b"packed 1", "of another arm", b"2", b"3", "told", b"5", b"packed 6"]
