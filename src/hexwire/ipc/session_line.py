"""The line of a session: bytes between link and connection, and the resulting events in order.

Owns the step that writes and reads once, the queues of unsolicited frames, and the lock of the line. Must not know
the requests, nor what to do when the port is lost: `Session` does.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import TypeVar

from hexwire.arguments import DATA, SECONDS, WHOLE, Wanted, check
from hexwire.epochs import Epochs, Token
from hexwire.errors import LinkClosedError, LinkLostError, LinkTimeoutError, LocalProtocolError, ReplyTimeoutError
from hexwire.session.connection import Connection
from hexwire.session.events import Answers, Event, Reply, Report, Request, TimedOut
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Frame, Status, command_name

from .connections import module_identity, random_number
from .handle import IpcHandle
from .raised_line import RaisedLine
from .turn import Turn

__all__ = ["SessionLine"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_LAST_COMMAND = 0xFF
_WRITE_TIMEOUT = 2.0
_KEPT = 256
_ORPHANS = 32
_IDS = Wanted("ids of servos", lambda value: isinstance(value, Collection) and all(map(WHOLE.fits, value)))
_DIALECT = Wanted("1 or 2", lambda value: value is None or (WHOLE.fits(value) and value in (1, 2)))
_GUARD = Wanted("a function", callable)
_REQUEST = Wanted("one of requests()", lambda value: isinstance(value, Request))
_STATUS = Wanted("a Status, 0 to 63", lambda value: WHOLE.fits(value) and 0 <= value <= tables.EXT_STATUS_MASK)
_NO_ANSWER = "has the board lost power, or is a plug loose?"
_NO_CONVERSATION = (
    "is the other end running? If it was restarted, or this machine was suspended, open the line again"
)


class SessionLine(ABC):
    """The base class of `Session`; see there.

    Args:
        ipc: The channel.
        clock: Monotonic seconds, until the link is open and may provide its own clock.
    """

    connection: Connection

    def __init__(self, ipc: IpcHandle, clock: Callable[[], float]) -> None:
        self.ipc = ipc
        self.epochs = Epochs()
        self.epochs.on_stop(self._look_up)
        self._now = clock
        self._turn = Turn()
        self._datagrams = False
        self._raised: RaisedLine | None = None
        self._stash: dict[int, Event] = {}
        self._reports: deque[tuple[Frame, float]] = deque(maxlen=_KEPT)
        self._requests: deque[Request] = deque(maxlen=_KEPT)
        self._frames: deque[Frame] = deque(maxlen=_KEPT)
        self._boot_id = random_number()
        self.board_restarts = 0
        self._board_sn = self._noted = 0

    @abstractmethod
    def _reopen(self, lost: LinkLostError) -> None:
        """Open the lost port again, or raise."""

    def now(self) -> float:
        """This session's clock, seconds."""
        return self._now()

    @property
    def is_open(self) -> bool:
        """Whether the channel is open."""
        return self.ipc.link.is_open

    @property
    def dialect(self) -> int:
        """Dialect of the requests."""
        return self.connection.dialect

    def share_stops(self, other: SessionLine) -> None:
        """Share the stops of two sessions of one arm: a stop on one cancels what waits on the other."""
        self.epochs = other.epochs
        self.epochs.on_stop(self._look_up)

    def _look_up(self) -> None:
        if self._turn.owner:
            self.ipc.link.wake()

    def _check_negotiation(self, boot_window: float, ping_ids: Sequence[int], dialect: int | None) -> None:
        check("negotiate", "boot_window", SECONDS, boot_window)
        check("negotiate", "ping_ids", _IDS, ping_ids)
        check("negotiate", "dialect", _DIALECT, dialect)
        self.ipc.check_sends("IDENTIFY")

    def _check_request(
        self,
        method: str,
        cmd: int,
        body: bytes,
        window: float | None = None,
        attempts: int | None = None,
        guard: Callable[[], None] | None = None,
    ) -> None:
        """Refuse what cannot be sent, before anything is done."""
        # The types first, since every request comes here.
        if type(cmd) is not int and type(cmd) is not Command:
            check(method, "cmd", WHOLE, cmd)
        if not 0 <= cmd <= _LAST_COMMAND:
            raise LocalProtocolError(f"there is no command {cmd}; commands are 0 to {_LAST_COMMAND}")
        if type(body) is not bytes:
            check(method, "body", DATA, body)
        if window is not None:
            check(method, "window", SECONDS, window)
        if attempts is not None:
            check(method, "attempts", WHOLE, attempts)
        if guard is not None:
            check(method, "guard", _GUARD, guard)
        self.ipc.check_sends(command_name(cmd))

    # -- answering ------------------------------------------------------------------------------------

    def requests(self, timeout: float | None = None) -> Iterator[Request]:
        """Yield the requests of the module at the other end; ends when none arrives for `timeout` seconds.

        Answer each by `reply`. Repeats are answered from store, and IDENTIFY is answered here, as long as this or
        another call drives the line.

        Raises:
            ConfigError: The channel only sends.
        """
        while (request := self._receive(self._requests, timeout)) is not None:
            yield request

    def reply(self, request: Request, body: bytes = b"", status: int = Status.OK) -> None:
        """Answer a request.

        Args:
            request: One of `requests`.
            body: Body of the answer; in dialect 1 a servo packet.
            status: Status code.

        Raises:
            LinkError: The line accepts no bytes.
            ConfigError: The channel only receives.
        """
        check("reply", "request", _REQUEST, request)
        check("reply", "body", DATA, body)
        check("reply", "status", _STATUS, status)
        self.ipc.check_sends("a reply")
        with self._turn.taken():
            if request.frame.proto == tables.PROTO_CHAPTER:
                self.connection.reply_dialect1(body, self.now(), dst=request.frame.src)
            else:
                self.connection.reply(request, status, body, self.now())
            self._write()

    def report(self, cmd: int, body: bytes = b"") -> None:
        """Send a frame unasked; `stream` of the other end yields it.

        Raises:
            LinkError: The line accepts no bytes, or over datagrams nobody has spoken yet.
            LocalProtocolError: The body does not fit one frame.
            ConfigError: The channel only receives.
        """
        self._check_request("report", cmd, body)
        with self._turn.taken():
            self._check_spoken()
            self.connection.report(cmd, body, self.now())
            self._write()

    def _check_spoken(self) -> None:
        """Over datagrams a server knows its peer only when that one has spoken."""
        if self.ipc.listens and not self.connection.in_conversation:
            raise LinkTimeoutError(f"{self.ipc.link.url}: nobody has spoken yet, so there is nobody to send to")

    # -- unsolicited frames ---------------------------------------------------------------------------

    def receive(self, timeout: float | None = None) -> Frame | None:
        """Wait for the next frame that is not an answer; None if none arrives within `timeout` seconds."""
        return self._receive(self._frames, timeout)

    def stream(self, timeout: float | None = None) -> Iterator[Frame]:
        """Yield unsolicited frames as they arrive; ends when none arrives for `timeout` seconds."""
        for frame, _ in self.reports(timeout):
            yield frame

    def reports(self, timeout: float | None = None) -> Iterator[tuple[Frame, float]]:
        """Like `stream`, each frame with its time of arrival: it may have waited during a request."""
        while (row := self._receive(self._reports, timeout)) is not None:
            yield row

    def poll_reports(self) -> Frame | None:
        """Process received bytes without waiting; returns the newest unsolicited frame, or None."""
        with self._turn.taken():
            self._step(self.now())
            self._sort_events()
            newest = self._reports[-1][0] if self._reports else None
            self._reports.clear()
            return newest

    def _receive(self, queue: deque[_T], timeout: float | None) -> _T | None:
        if timeout is not None:
            check("receive", "timeout", SECONDS, timeout)
        self.ipc.check_receives()
        deadline = None if timeout is None else self.now() + timeout
        looked = False
        while True:
            alone = self._turn.begin_listening(self.ipc.link.wake)
            try:
                # A stop or a request goes first; reading can continue after it without loss.
                while not (self._turn.urgent_waiting or (alone and self._turn.waiting)):
                    self._sort_events()
                    if queue:
                        return queue.popleft()
                    if looked and deadline is not None and self.now() >= deadline:
                        return None
                    looked = True
                    try:
                        self._step(deadline)
                    except LinkLostError as lost:
                        self._reopen(lost)
            finally:
                self._turn.end()

    # -- the loop -----------------------------------------------------------------------------------

    def _step(self, deadline: float | None, token: Token | None = None) -> None:
        """Write pending bytes and read once, until `deadline` or the connection's own next deadline.

        Args:
            deadline: Latest time to return.
            token: The call that waits here: after a stop, nothing of it is written.
        """
        connection = self.connection
        if self._raised is not None:
            self._raised.watch(connection)
        out = connection.data_to_send()
        due = connection.next_timeout()
        if due is None or (deadline is not None and deadline < due):
            due = deadline
        link = self.ipc.link
        if token is not None and not self.epochs.holds(token):
            return
        if len(out) == 1 and due is not None:
            # The fast path, one request and its answer: the link does both in one call.
            data = link.exchange(out[0], max(0.0, due - self._now()))
        else:
            for frame in out:
                if token is not None and not self.epochs.holds(token):
                    break
                link.write(frame, self._now() + _WRITE_TIMEOUT)
            data = link.read(due)
        now = self._now()
        if data:
            connection.receive(data, now, end_of_message=self._datagrams)
            if connection.conversations is not None and connection.conversations.has_news():
                link.confirm()
        if due is not None and now >= due:
            connection.handle_timeout(now)

    def _forget_rate(self) -> None:
        """A port opens at its own rate."""
        if self._raised is not None:
            self._raised.forget()
            self._raised = None

    def _write(self) -> None:
        for data in self.connection.data_to_send():
            self.ipc.link.write(data, self.now() + _WRITE_TIMEOUT)

    def _sort_events(self) -> None:
        while (event := self.connection.next_event()) is not None:
            self._sort(event)

    def _sort(self, event: Event) -> None:
        if isinstance(event, Report):
            self._reports.append((event.frame, self.now()))
        elif isinstance(event, Request):
            if event.frame.proto != tables.PROTO_CHAPTER and event.frame.cmd == Command.IDENTIFY:
                identity = module_identity(self.connection, self._boot_id)
                self.connection.reply(event, Status.OK, identity, self.now())
            else:
                self._requests.append(event)
        elif isinstance(event, Reply | TimedOut | Answers):
            if len(self._stash) >= _ORPHANS:
                del self._stash[next(iter(self._stash))]
            self._stash[event.ticket] = event
        else:
            frame = getattr(event, "frame", None)
            if frame is not None:
                self._frames.append(frame)
            _log.debug("%s: %s", self.ipc.link.url, event)

    def _note_number(self, reply: Reply) -> None:
        frame = reply.frame
        if frame is not None and reply.attempts == 1 and reply.ticket > self._noted and not self._datagrams:
            self._noted = reply.ticket
            # A restarted frame counter means a restarted board.
            self.board_restarts += frame.sn < self._board_sn
            self._board_sn = frame.sn

    def _timed_out(self, event: TimedOut) -> ReplyTimeoutError:
        if self.connection.dialect == tables.PROTO_CHAPTER:
            # Bytes that are still to come belong to the abandoned request.
            try:
                self.ipc.link.flush_input()
            except (LinkLostError, LinkClosedError):
                _log.debug("%s: nothing to flush, the link is gone", self.ipc.link.url)
        return ReplyTimeoutError(
            command_name(event.cmd),
            attempts=event.attempts,
            instead=event.instead,
            advice="" if event.instead else _NO_CONVERSATION if self._datagrams else _NO_ANSWER,
        )
