"""The gateway as a machine: frames of one host to the boards that they name, and answers back.

Owns who is named, and what the loss of either side means. No I/O; time comes in as `now`. Must not know links.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hexwire.errors import RemoteProtocolError
from hexwire.session.decoder import FrameDecoder
from hexwire.session.effects import Effect, effect_of
from hexwire.session.fragments import FragmentReceiver
from hexwire.wire import tables
from hexwire.wire.addresses import Multicast, Unicast, address_of
from hexwire.wire.command_frame import Command, Frame, serialize_frame
from hexwire.wire.tables import PROTO_HEXWIRE

from .line import BoardLine

__all__ = ["Gateway", "GatewayCounters"]


@dataclass(slots=True)
class GatewayCounters:
    """What happened to frames of the host.

    Attributes:
        received: Frames of the host.
        unknown: Frames for nobody here, or in a form that no board takes.
        stale: Frames that had waited while this program was suspended.
    """

    received: int = 0
    unknown: int = 0
    stale: int = 0


class Gateway:
    """One host above, several boards below.

    Args:
        lines: The boards, each with its own module id.

    Attributes:
        lines: The boards by module id.
        counters: What happened to frames.
    """

    def __init__(self, lines: Iterable[BoardLine]) -> None:
        self.lines = {line.module: line for line in lines}
        self.counters = GatewayCounters()
        self._out: list[bytes] = []
        self._begin()

    def _begin(self) -> None:
        self.decoder = FrameDecoder(tables.MAX_NETWORK_FRAME)
        self._messages = {module: FragmentReceiver() for module in self.lines}
        self._asker: Frame | None = None

    # -- the host -------------------------------------------------------------------------------------

    def receive_host(self, data: bytes, now: float, *, stale: bool = False) -> None:
        """Process bytes of the host.

        Args:
            data: The bytes.
            now: Seconds, monotonic.
            stale: They may have waited for long, while this program was suspended: only stops are obeyed.
        """
        self.decoder.receive(data, now)
        while (event := self.decoder.next_event()) is not None:
            if isinstance(event, Frame):
                self.counters.received += 1
                self._route(event, now, stale=stale)

    def _route(self, frame: Frame, now: float, *, stale: bool) -> None:
        to = address_of(frame.dst)
        if frame.proto != PROTO_HEXWIRE or frame.cmd_ext or to is None:
            self.counters.unknown += 1
            return
        if stale and effect_of(PROTO_HEXWIRE, frame.cmd, frame.body) is not Effect.STOP:
            self.counters.stale += 1
            return
        if frame.cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            self._take_fragment(frame, now)
            return
        single = isinstance(to, Unicast)
        named = [line for module, line in self.lines.items() if to.names(module)]
        self.counters.unknown += not named
        for line in named:
            if effect_of(PROTO_HEXWIRE, frame.cmd, frame.body) is Effect.STOP:
                self._messages[line.module].forget()
            # A board decides by this whether a command may go to several.
            dst = line.local if single else Multicast((line.local,)).dst
            self._send_up(line.request(frame._replace(dst=dst), now))

    def _take_fragment(self, frame: Frame, now: float) -> None:
        """A chunk of a message that the host itself has split; the boards get it whole, or split anew."""
        receiver = self._messages.get(frame.dst)
        if receiver is None or frame.cmd == Command.FRAGMENT_MISSING:
            self.counters.unknown += 1
            return
        self._asker = frame
        try:
            message, asks = receiver.receive(frame.body, now)
        except RemoteProtocolError:
            self.counters.unknown += 1
            return
        self._ask(frame, asks)
        if message is not None and message.cmd not in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            seq = message.message_id & 0xFF
            whole = frame._replace(cmd=message.cmd, cmd_ext=message.cmd_ext, body=message.body, seq=seq)
            self._route(whole, now, stale=False)

    def _ask(self, frame: Frame, bodies: Iterable[bytes]) -> None:
        for body in bodies:
            ask = frame._replace(src=frame.dst, dst=frame.src, cmd=Command.FRAGMENT_MISSING, body=body)
            self._send_up([ask])

    def _send_up(self, frames: Iterable[Frame]) -> None:
        self._out += (serialize_frame(frame, tables.MAX_NETWORK_FRAME) for frame in frames)

    def host_data(self) -> bytes:
        """Take the bytes for the host."""
        data, self._out = b"".join(self._out), []
        return data

    def host_came(self) -> None:
        """A host has connected."""
        self._out.clear()
        self._begin()

    def host_gone(self, now: float, *, broken: bool) -> list[int]:
        """The host's link has ended: what it left unfinished is stopped.

        A host leaves in order if no watchdog of a board is armed, no path runs, and everything that acts is
        answered. Otherwise, or if the link broke, every board is stopped. A board that is to finish a path without
        its host does so; its watchdog stops it at the end.

        Args:
            now: Seconds, monotonic.
            broken: The link failed, rather than being closed.

        Returns:
            The modules that are stopped.
        """
        self._out.clear()
        uses = {module: line.use for module, line in self.lines.items()}
        stop = broken or not all(use.in_order for use in uses.values())
        for line in self.lines.values():
            line.forget_host(now)
        stopped = [module for module, use in uses.items() if stop and not use.finishes]
        for module in stopped:
            self.lines[module].stop(uses[module].mode, now)
        return stopped

    # -- boards ---------------------------------------------------------------------------------------

    def receive_board(self, module: int, data: bytes, now: float) -> None:
        """Process bytes of a board."""
        self._send_up(self.lines[module].receive(data, now))

    # -- time -----------------------------------------------------------------------------------------

    def next_timeout(self) -> float | None:
        """Time at which something is due, or None."""
        times = [self.decoder.next_timeout(), *(line.next_timeout() for line in self.lines.values())]
        times += [receiver.next_timeout() for receiver in self._messages.values()]
        return min((when for when in times if when is not None), default=None)

    def handle_timeout(self, now: float) -> None:
        """Do what is due."""
        while self.decoder.handle_timeout(now) is not None:
            self.receive_host(b"", now)
        for module, receiver in self._messages.items():
            asks = receiver.handle_timeout(now)
            if self._asker is not None:
                self._ask(self._asker._replace(dst=module), asks)
        for line in self.lines.values():
            self._send_up(line.handle_timeout(now))
