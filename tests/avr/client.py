"""Just enough of a host to ask a simulated board: frames with fresh numbers out, decoded frames in."""

from __future__ import annotations

from tests.avr.machines import Machine
from tests.frames import frame_bytes

from hexwire.session.decoder import FrameDecoder
from hexwire.wire.command_frame import Frame

BOARD, HOST = 8, 7


class Client:
    """A host on a machine's line."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.seq = 0
        self.sn = 0
        self.heard = bytearray()
        self._decoder = FrameDecoder()

    def frame(
        self,
        cmd: int,
        body: bytes = b"",
        *,
        proto: int = 2,
        seq: int | None = None,
        dst: int = BOARD,
        cmd_ext: int = 0,
    ) -> bytes:
        """A request; the next sequence number unless one is given."""
        if seq is None:
            self.seq = seq = (self.seq + 1) & 0xFF
        self.sn += 1
        return frame_bytes(
            cmd, body, proto=proto, seq=seq, sn=self.sn, src=HOST, dst=dst, time_nsec=self.sn, cmd_ext=cmd_ext
        )

    def frames(self) -> list[Frame]:
        """What has come since the last call."""
        data = self.machine.take()
        self.heard += data
        self._decoder.receive(data, self.machine.now)
        found = []
        while (event := self._decoder.next_event()) is not None:
            if isinstance(event, Frame):
                found.append(event)
        return found

    def run(self, seconds: float) -> list[Frame]:
        """Let time pass; what came meanwhile."""
        self.machine.advance(seconds)
        return self.frames()

    def ask(self, cmd: int, body: bytes = b"", *, within: float = 0.4) -> Frame:
        """The dialect-2 reply to a request; whatever else comes is passed over."""
        self.machine.send(self.frame(cmd, body))
        return self.reply(within)

    def reply(self, within: float = 0.4) -> Frame:
        """The reply to the request sent last."""
        end = self.machine.now + within
        while self.machine.now < end:
            for frame in self.run(0.001):
                if frame.is_reply and frame.seq == self.seq:
                    return frame
        raise AssertionError(f"no reply to request {self.seq} within {within} s")

    def ask_chapter(self, cmd: int, body: bytes) -> bytes:
        """The body of the dialect-1 answer; empty if there is none within 200 ms."""
        self.machine.send(self.frame(cmd, body, proto=1))
        end = self.machine.now + 0.2
        while self.machine.now < end:
            for frame in self.run(0.001):
                if frame.proto == 1:
                    return frame.body
        return b""
