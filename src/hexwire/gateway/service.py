"""The gateway's loop: bytes between the connections of hosts, the machine and the links to the boards.

Owns links and their loss. Over a queue no end is seen: a host is gone when it has let go of the queue. A board's
link that is lost is opened again in a thread, since opening may take seconds. Must not know frames: `router` does.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.errors import HexwireError, LinkError, LinkTimeoutError, UsageError
from hexwire.link.base import Link, LinkKind
from hexwire.link.listener import Listener
from hexwire.link.poll_link import PollLink
from hexwire.link.tcp import PeerLink
from hexwire.link.waker import Waker
from hexwire.session.conversation import Numbers
from hexwire.system import READABLE, make_poll
from hexwire.wire.tables import MAX_NETWORK_FRAME

from .host import Host, QueueHost
from .line import BoardLine
from .router import Gateway

if TYPE_CHECKING:
    from hexwire.link.mqueue import QueueLink

__all__ = ["GatewayService"]

_log = logging.getLogger(__name__)

_IDLE = 0.25
_OPEN_AGAIN = 0.5
"""Seconds between two attempts to open a board's link."""
_STALL = 0.5
"""Seconds between two rounds after which this program was suspended: what has waited meanwhile may be old."""
_WRITE = 0.05
"""Seconds in which a side must take its bytes; one that does not would hold up all others."""
_END = 1.0
_MOST_HOSTS = 64
"""Connections at once: more than there can be boards, so that one that has none can always make room."""


_LOOK = 0.05
"""Seconds between two looks at whether the host of a queue is still there."""
_MOST_MESSAGES = 256
"""Messages of a queue that are read in one round: who goes on sending holds up no other."""


@dataclass(slots=True)
class _Queue:
    link: QueueLink
    host: QueueHost
    owner: str = ""
    look_at: float = 0.0


@dataclass(slots=True)
class _Board:
    line: BoardLine
    link: PollLink
    opener: threading.Thread | None = None
    opened: bool = False
    again_at: float = 0.0
    said: str = ""


@dataclass(slots=True)
class _Guest:
    fd: int
    link: PeerLink
    host: Host


class GatewayService:
    """A gateway between a TCP port, or queues, and the links of several boards.

    Args:
        listener: Accepts the hosts; opened and closed here. None for queues alone.
        boards: The link of each board by the module id that hosts use for it; opened and closed here.
        local: Module id of each board on its own line.
        before_open: Called with a board's link before each attempt to open it.
        queues: The server's ends of queues, each for one host at a time; opened and closed here. One that is
            `further` is left out where the system has no room for it.
        numbers: Source of random numbers for conversations, as `Connection` takes it; needed for queues.

    Raises:
        UsageError: A link cannot be watched together with others.
    """

    def __init__(
        self,
        listener: Listener | None,
        boards: Mapping[int, Link],
        *,
        local: int,
        before_open: Callable[[Link], object] = lambda link: None,
        queues: Sequence[QueueLink] = (),
        numbers: Numbers = lambda: 0,
    ) -> None:
        self._listener = listener
        self._before_open = before_open
        self._boards: dict[int, _Board] = {}
        for module, link in boards.items():
            if not isinstance(link, PollLink) or link.kind is not LinkKind.STREAM:
                raise UsageError(f"{link.url}: a gateway needs a serial or TCP link for each board")
            line = BoardLine(module, local=local, baud=getattr(link, "baud", 0))
            self._boards[module] = _Board(line, link)
        self.machine = Gateway(board.line for board in self._boards.values())
        self._guests: dict[int, _Guest] = {}
        self._queues = [
            _Queue(link, self.machine.add(QueueHost(_address(link), self._boards, numbers))) for link in queues
        ]
        self._waker = Waker()
        self._ended = False
        self._round = time.monotonic()

    @property
    def url(self) -> str:
        """The first address, once it is open."""
        return self.urls[0]

    @property
    def urls(self) -> list[str]:
        """Where hosts connect, once that is open."""
        port = [] if self._listener is None else [self._listener.url]
        return [*port, *(_address(queue.link) for queue in self._queues if not queue.link.further)]

    def open(self) -> None:
        """Open port, queues and every board's link; a board that is not there is looked for again and again.

        Raises:
            LinkError: The port or a queue cannot be opened.
            UsageError: A queue has no room for a frame.
        """
        self._waker.open()
        if self._listener is not None:
            self._listener.open()
        for queue in list(self._queues):
            try:
                queue.link.open()
            except LinkError as error:
                if not queue.link.further:
                    raise
                _log.warning("fewer hosts at once: %s", error)
                self._queues.remove(queue)
                continue
            room = queue.link.max_message
            if room is not None and room < MAX_NETWORK_FRAME:
                raise UsageError(
                    f"{_address(queue.link)} has messages of {room} bytes; a gateway needs {MAX_NETWORK_FRAME}: "
                    "leave out size, or choose another name"
                )
        for board in self._boards.values():
            try:
                self._before_open(board.link)
                board.link.open()
            except HexwireError as error:
                self._lose(board, str(error))
        self._round = time.monotonic()

    def close(self) -> None:
        """Stop the boards unless their hosts have left in order, and close everything."""
        for guest in list(self._guests.values()):
            self._host_gone(guest, "the gateway ends", broken=False)
        for queue in self._queues:
            self._host_left(queue, "the gateway ends")
        end = time.monotonic() + _END
        while any(board.line.stopping for board in self._boards.values()) and time.monotonic() < end:
            self._boards_round(self._wait(end))
        self._ended = True
        for board in self._boards.values():
            board.link.close()
            if board.opener is not None:
                board.opener.join(_END)
                # It may have opened the link after all.
                board.link.close()
        if self._listener is not None:
            self._listener.close()
        for queue in self._queues:
            queue.link.close()
        self._waker.close()

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until told to stop.

        Args:
            stop: Called at least every quarter of a second; True ends it.
        """
        while not stop():
            self.run_once()

    def run_once(self) -> None:
        """Wait for something to do, and do it."""
        ready = self._wait(time.monotonic() + _IDLE)
        now = time.monotonic()
        stale = now - self._round > _STALL + _IDLE
        self._round = now
        if stale:
            _log.warning("suspended for more than %.1f s: only stops of what waited are obeyed", _STALL)
        # The hosts first: their stops overtake everything. In the order in which they came: who has left makes room
        # for the next.
        for fd, guest in list(self._guests.items()):
            if stale or fd in ready:
                self._host_round(guest, stale=stale)
        for queue in self._queues:
            self._queue_round(queue, ready, stale=stale)
        self._boards_round(ready)
        if self._listener is not None and self._listener.fileno() in ready:
            self._let_in(self._listener)
        for guest in list(self._guests.values()):
            self._to_host(guest)
        for queue in self._queues:
            self._to_queue(queue)

    # -- waiting --------------------------------------------------------------------------------------

    def _wait(self, until: float) -> set[int]:
        """Wait for bytes, a host or the next time-out; returns what is ready."""
        poll, now = make_poll(), time.monotonic()
        due = self.machine.next_timeout()
        again = [board.again_at for board in self._boards.values() if not board.line.up and board.opener is None]
        again += [queue.look_at for queue in self._queues if queue.host.is_heard]
        until = min([until, *again] if due is None else [until, due, *again])
        if self._listener is not None:
            poll.register(self._listener.fileno(), READABLE)
        for queue in self._queues:
            poll.register(queue.link.fileno(), READABLE)
        poll.register(self._waker.fileno(), READABLE)
        for fd in self._guests:
            poll.register(fd, READABLE)
        for board in self._boards.values():
            if board.line.up:
                poll.register(board.link.fileno(), READABLE)
        return {fd for fd, _ in poll.poll(max(0.0, until - now) * 1000.0)}

    # -- the hosts ------------------------------------------------------------------------------------

    def _let_in(self, listener: Listener) -> None:
        link = listener.accept(time.monotonic())
        if link is None:
            return
        if len(self._guests) >= _MOST_HOSTS:
            idle = next(guest for guest in self._guests.values() if not self.machine.held(guest.host))
            self._host_gone(idle, "there are too many connections, and it has no board", broken=False)
        fd = link.fileno()
        self._guests[fd] = _Guest(fd, link, self.machine.host_came(link.peer))
        _log.info("%s: %s is a host", listener.url, link.peer)

    def _host_round(self, guest: _Guest, *, stale: bool) -> None:
        try:
            if stale:
                # All of what waited is as old as its first byte.
                while data := guest.link.read(time.monotonic()):
                    self.machine.receive_host(guest.host, data, time.monotonic(), stale=True)
                return
            # To its end: who comes next must find the boards free that this one has left.
            for _ in guest.link.leftovers():
                data = guest.link.read(time.monotonic())
                self.machine.receive_host(guest.host, data, time.monotonic())
        except LinkError as error:
            cause = error.__cause__
            broken = isinstance(cause, OSError) and not isinstance(cause, LinkError)
            self._host_gone(guest, str(error), broken=broken)

    def _to_host(self, guest: _Guest) -> None:
        data = self.machine.host_data(guest.host)
        if data:
            try:
                guest.link.write(data, time.monotonic() + _WRITE)
            except LinkError as error:
                self._host_gone(guest, str(error), broken=True)

    def _host_gone(self, guest: _Guest, why: str, *, broken: bool) -> None:
        del self._guests[guest.fd]
        guest.link.close()
        _say_gone(guest.host.name, why, self.machine.host_gone(guest.host, time.monotonic(), broken=broken))

    # -- the queues -----------------------------------------------------------------------------------

    def _queue_round(self, queue: _Queue, ready: set[int], *, stale: bool) -> None:
        now = time.monotonic()
        owner = queue.owner
        if (queue.host.is_heard and now >= queue.look_at) or queue.link.fileno() in ready:
            # Before its messages: all that who has left has sent is among them.
            owner, queue.look_at = queue.link.other_end(), now + _LOOK
        if queue.host.is_heard and (not owner or owner != queue.owner):
            self._read_queue(queue, stale=stale)
            self._host_left(queue, "it has let go of the queue")
        queue.owner = owner
        queue.host.name = f"{_address(queue.link)}, {owner}" if owner else _address(queue.link)
        if queue.link.fileno() in ready:
            self._read_queue(queue, stale=stale)

    def _read_queue(self, queue: _Queue, *, stale: bool) -> None:
        for _ in range(_MOST_MESSAGES):
            data = queue.link.read(time.monotonic())
            if not data:
                break
            stopped = self.machine.receive_host(queue.host, data, time.monotonic(), stale=stale)
            if stopped:
                _say_gone(queue.host.name, "another conversation has begun", stopped)

    def _to_queue(self, queue: _Queue) -> None:
        for frame in self.machine.host_frames(queue.host):
            try:
                queue.link.write(frame, time.monotonic())
            except LinkTimeoutError:
                # What nobody takes is lost; the host asks again.
                break

    def _host_left(self, queue: _Queue, why: str) -> None:
        if queue.host.is_heard:
            _say_gone(queue.host.name, why, self.machine.host_left(queue.host, time.monotonic()))

    # -- the boards -----------------------------------------------------------------------------------

    def _boards_round(self, ready: set[int]) -> None:
        now = time.monotonic()
        if self._waker.fileno() in ready:
            self._waker.clear()
        self.machine.handle_timeout(now)
        for module, board in self._boards.items():
            if not board.line.up:
                self._look_for(board, now)
                continue
            try:
                if board.link.fileno() in ready:
                    self.machine.receive_board(module, board.link.read(now), now)
                while data := board.line.next_frame(time.monotonic()):
                    board.link.write(data, time.monotonic() + _WRITE)
            except LinkError as error:
                self._lose(board, str(error))

    def _lose(self, board: _Board, why: str) -> None:
        if why != board.said:
            _log.warning("module %d is not there: %s", board.line.module, why)
            board.said = why
        board.link.close()
        board.line.lost()
        board.again_at = time.monotonic() + _OPEN_AGAIN

    def _look_for(self, board: _Board, now: float) -> None:
        if board.opener is None and now >= board.again_at:
            board.opener = threading.Thread(target=self._open, args=(board,), name="gateway-open", daemon=True)
            board.opener.start()
        elif board.opener is not None and not board.opener.is_alive():
            board.opener = None
            board.again_at = now + _OPEN_AGAIN
            if board.opened:
                board.opened, board.said = False, ""
                _log.warning("module %d is back", board.line.module)
                board.line.back(now)

    def _open(self, board: _Board) -> None:
        try:
            self._before_open(board.link)
            board.link.open()
        except HexwireError as error:
            _log.debug("module %d: %s", board.line.module, error)
        else:
            board.opened = True
        if not self._ended:
            self._waker.set()


def _address(queue: QueueLink) -> str:
    """The address of a queue for hosts."""
    return queue.url.partition("?")[0]


def _say_gone(name: str, why: str, stopped: list[int]) -> None:
    if stopped:
        _log.warning("host %s is gone: %s; stopping modules %s", name, why, ", ".join(map(str, stopped)))
    else:
        _log.info("host %s has left", name)
