"""The gateway as a machine: frames of hosts to the boards that they name, and answers back.

Owns who is named, which host has which board, and what the loss of either side means. No I/O; time comes in as
`now`. Must not know links.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

from hexwire.errors import RemoteProtocolError
from hexwire.session.effects import Effect, effect_of
from hexwire.session.events import BadFrame, Garbage
from hexwire.wire.addresses import Multicast, Unicast, address_of
from hexwire.wire.command_frame import Command, Frame
from hexwire.wire.tables import PROTO_HEXWIRE

from .host import Host
from .line import BoardLine

__all__ = ["Gateway", "GatewayCounters"]


HostT = TypeVar("HostT", bound=Host)


@dataclass(slots=True)
class GatewayCounters:
    """What happened to frames of the hosts.

    Attributes:
        received: Frames of hosts.
        unknown: Frames for nobody here, or in a form that no board takes.
        stale: Frames that had waited while this program was suspended.
        refused: Frames of a queue that are old, or of no conversation here.
    """

    received: int = 0
    unknown: int = 0
    stale: int = 0
    refused: int = 0


class Gateway:
    """Hosts above, boards below.

    A board has one host: the first that names it, until that one is gone. So each watchdog is fed by its own host
    alone. Everybody else may stop it, and nothing more. Who stops a board, or asks several who they are, does not
    become a host by that.

    Args:
        lines: The boards, each with its own module id.

    Attributes:
        lines: The boards by module id.
        hosts: Those who are connected.
        counters: What happened to frames.
    """

    def __init__(self, lines: Iterable[BoardLine]) -> None:
        self.lines = {line.module: line for line in lines}
        self.hosts: list[Host] = []
        self.counters = GatewayCounters()
        self._held: dict[int, Host] = {}

    # -- hosts ----------------------------------------------------------------------------------------

    def host_came(self, name: str) -> Host:
        """A host has connected."""
        return self.add(Host(name, self.lines))

    def add(self, host: HostT) -> HostT:
        """Add a side at which hosts are."""
        self.hosts.append(host)
        return host

    def held(self, host: Host) -> list[int]:
        """The modules that a host has."""
        return [module for module, holder in self._held.items() if holder is host]

    def receive_host(self, host: Host, data: bytes, now: float, *, stale: bool = False) -> list[int]:
        """Process bytes of a host.

        Args:
            host: Whose.
            data: The bytes.
            now: Seconds, monotonic.
            stale: They may have waited for long, while this program was suspended: only stops are obeyed.

        Returns:
            The modules that are stopped, since another host has taken the place of theirs.
        """
        host.decoder.receive(data, now)
        stopped: list[int] = []
        while (event := self._next_event(host)) is not None:
            if isinstance(event, Frame):
                self.counters.received += 1
                before = host.generation
                taken = host.takes(event, now)
                if host.generation != before:
                    stopped += self._release(host, now, broken=False)
                if taken:
                    self._route(host, event, now, stale=stale)
                else:
                    self.counters.refused += 1
        return stopped

    @staticmethod
    def _next_event(host: Host) -> Frame | BadFrame | Garbage | None:
        event = host.decoder.next_event()
        return host.decoder.end_of_message() if event is None and host.in_messages else event

    def _route(self, host: Host, frame: Frame, now: float, *, stale: bool) -> None:
        to = address_of(frame.dst)
        if frame.proto != PROTO_HEXWIRE or frame.cmd_ext or to is None:
            self.counters.unknown += 1
            return
        stops = effect_of(PROTO_HEXWIRE, frame.cmd, frame.body) is Effect.STOP
        if stale and not stops:
            self.counters.stale += 1
            return
        if frame.cmd in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            self._take_fragment(host, frame, now)
            return
        single = isinstance(to, Unicast)
        named = [line for module, line in self.lines.items() if to.names(module)]
        self.counters.unknown += not named
        for line in named:
            if stops:
                for other in self.hosts:
                    other.messages[line.module].forget()
            holder = self._held.get(line.module)
            if holder is None and not single and frame.cmd == Command.IDENTIFY:
                line.seek_for(host, frame, now)
                self._lift(line.module, (), now)
                continue
            if holder is None and not stops:
                holder = self._held[line.module] = host
                line.introduce(frame.src, now)
            if holder is host and not (stops and line.stops_itself):
                # A board decides by this whether a command may go to several.
                dst = line.local if single else Multicast((line.local,)).dst
                host.send(line.request(frame._replace(dst=dst), now))
            elif stops:
                # One stop answers all who ask before it leaves, so that no burst outlasts its host.
                void = line.stop_for(host, frame, now)
                if holder is not None:
                    holder.send(void)
            elif holder is not None:
                host.send([line.refuse_stranger(frame, holder.name, several=not single)])

    def _take_fragment(self, host: Host, frame: Frame, now: float) -> None:
        """A chunk of a message that the host itself has split; the boards get it whole, or split anew."""
        receiver = host.messages.get(frame.dst)
        if receiver is None or frame.cmd == Command.FRAGMENT_MISSING:
            self.counters.unknown += 1
            return
        host.asker = frame
        try:
            message, asks = receiver.receive(frame.body, now)
        except RemoteProtocolError:
            self.counters.unknown += 1
            return
        self._ask(host, frame, asks)
        if message is not None and message.cmd not in (Command.FRAGMENT, Command.FRAGMENT_MISSING):
            seq = message.message_id & 0xFF
            whole = frame._replace(cmd=message.cmd, cmd_ext=message.cmd_ext, body=message.body, seq=seq)
            self._route(host, whole, now, stale=False)

    @staticmethod
    def _ask(host: Host, frame: Frame, bodies: Iterable[bytes]) -> None:
        for body in bodies:
            ask = frame._replace(src=frame.dst, dst=frame.src, cmd=Command.FRAGMENT_MISSING, body=body)
            host.send([ask])

    @staticmethod
    def host_frames(host: Host) -> list[bytes]:
        """Take the frames for a host."""
        frames, host.out = host.out, []
        return frames

    def host_data(self, host: Host) -> bytes:
        """Take the frames for a host, as the bytes of a stream."""
        return b"".join(self.host_frames(host))

    def host_gone(self, host: Host, now: float, *, broken: bool) -> list[int]:
        """A host's link has ended: what it left unfinished is stopped, and its boards are free.

        A host leaves in order if no watchdog of a board is armed, no path runs, and everything that acts is
        answered. Otherwise, or if the link broke, each of its boards is stopped. A board that is to finish a path
        without its host does so; its watchdog stops it at the end.

        Args:
            host: Which.
            now: Seconds, monotonic.
            broken: The link failed, rather than being closed.

        Returns:
            The modules that are stopped.
        """
        self.hosts.remove(host)
        return self._release(host, now, broken=broken)

    def host_left(self, host: Host, now: float) -> list[int]:
        """The host at a side that stays is gone; the same as of `host_gone` happens."""
        stopped = self._release(host, now, broken=False)
        host.forget()
        return stopped

    def _release(self, host: Host, now: float, *, broken: bool) -> list[int]:
        modules = self.held(host)
        uses = {module: self.lines[module].use for module in modules}
        stop = broken or not all(use.in_order for use in uses.values())
        for module in modules:
            self.lines[module].forget_host(now)
            del self._held[module]
        stopped = [module for module, use in uses.items() if stop and not use.finishes]
        for module in stopped:
            self.lines[module].stop(uses[module].mode, now)
        return stopped

    # -- boards ---------------------------------------------------------------------------------------

    def receive_board(self, module: int, data: bytes, now: float) -> None:
        """Process bytes of a board."""
        self._lift(module, self.lines[module].receive(data, now), now)

    def _lift(self, module: int, frames: Iterable[Frame], now: float) -> None:
        """Pass frames of a board to its host, and answers to others who have stopped it."""
        holder, line = self._held.get(module), self.lines[module]
        restarted = line.take_restart()
        if holder is not None:
            if restarted and holder.in_messages:
                # It would not notice: what goes up to it is numbered here.
                self.host_left(holder, now)
            holder.send(frames)
        for who, frame in line.said:
            for host in self.hosts:
                if host is who:
                    host.send([frame])
        line.said.clear()

    # -- time -----------------------------------------------------------------------------------------

    def next_timeout(self) -> float | None:
        """Time at which something is due, or None."""
        times = [line.next_timeout() for line in self.lines.values()]
        for host in self.hosts:
            times.append(host.decoder.next_timeout())
            times += [receiver.next_timeout() for receiver in host.messages.values()]
        return min((when for when in times if when is not None), default=None)

    def handle_timeout(self, now: float) -> None:
        """Do what is due."""
        for host in self.hosts:
            while host.decoder.handle_timeout(now) is not None:
                self.receive_host(host, b"", now)
            for module, receiver in host.messages.items():
                asks = receiver.handle_timeout(now)
                if host.asker is not None:
                    self._ask(host, host.asker._replace(dst=module), asks)
        for module, line in self.lines.items():
            self._lift(module, line.handle_timeout(now), now)
